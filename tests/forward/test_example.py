"""The example network grows on any heart."""

import numpy as np
import pytest

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_AREAS, EXAMPLE_PARAMETERS
from fascicle.purkinje.tree import FEW_JUNCTIONS, InvalidTree


def test_areas_are_those_of_the_packaged_heart(default_heart):
    for endocardium in default_heart.endocardia:
        assert endocardium.area == pytest.approx(EXAMPLE_AREAS[endocardium.side], rel=1e-3)


def test_on_the_packaged_heart_it_is_the_example(default_model):
    assert fascicle.example_parameters(default_model) == EXAMPLE_PARAMETERS


def test_on_the_published_demonstration_heart(crtdemo):
    """Whose left endocardium has half the area; with the lengths as they are nothing grows."""
    model = fascicle.ForwardModel(crtdemo)
    assert isinstance(model.simulate(EXAMPLE_PARAMETERS), InvalidTree)
    found = fascicle.example_parameters(model)
    simulation = model.simulate(found)
    assert all(len(tree.junctions) >= FEW_JUNCTIONS for tree in simulation.trees)
    changed = {name for name, value in found.items() if value != EXAMPLE_PARAMETERS[name]}
    assert changed
    assert all("length" in name for name in changed)
    assert 60 < simulation.total_activation_time < 200
    assert np.isfinite(simulation.ecg).all()


def test_a_heart_with_no_room_is_refused(default_model, monkeypatch):
    invalid = InvalidTree("rv", 2, 0.0, 10.0, (0.0, 0.0, 0.0))
    monkeypatch.setattr(default_model, "grow", lambda parameters: invalid)
    with pytest.raises(InputError, match="no example network was found that fits; choose other"):
        fascicle.example_parameters(default_model)
