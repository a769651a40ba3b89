"""The example network grows on any heart."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from anatomies import NETWORK
from scipy.spatial import cKDTree

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.parameters import Infeasible
from fascicle.heart.sites import SEGMENTS
from fascicle.purkinje.tree import FEW_JUNCTIONS


@pytest.fixture(scope="module")
def subject():
    """Whose network is scaled to other hearts."""
    return fascicle.load_heart("camps-dti004")


@pytest.fixture(scope="module")
def trees(small_model):
    return small_model.grow(NETWORK)


def test_that_of_the_packaged_heart_is_activated_as_mapped_hearts_are(default_model):
    found = default_model.simulate(fascicle.example_parameters(default_model))
    sequence = default_model.surfaces.sequence(found.activation)
    assert sequence.is_mapped
    assert sequence.first == "left septum"
    assert sequence.last == "basal lateral left ventricle"
    assert not any(criterion.met for criterion in found.conventional_criteria)


def test_that_of_the_subject_has_a_normal_ecg(subject):
    """Left middle septum first, mapped, no Q wave in V2 to V6, R waves that grow up to V5."""
    model = fascicle.ForwardModel(subject)
    found = model.simulate(fascicle.example_parameters(model))
    heart, first = model.heart, found.activation.argmin()
    (elements,) = np.nonzero((heart.tetrahedra == first).any(axis=1))
    (most,) = Counter(model.sites.places.segment[elements]).most_common(1)
    assert SEGMENTS[most[0] - 1] == "mid anteroseptal"
    assert model.surfaces.sequence(found.activation).is_mapped
    away = [cKDTree(e.vertices).query(heart.vertices[first])[0] for e in heart.endocardia]
    assert away[0] < away[1]
    assert 60 <= found.qrs_duration <= 100
    assert 0 <= found.frontal_axis <= 75
    assert not any(criterion.met for criterion in found.conventional_criteria)
    for lead in found.leads[7:12]:
        assert lead[: np.argmax(lead > 0.05)].min() > -0.04
    waves = found.leads[6:11].max(axis=1)
    assert waves.min() > 0.1
    assert np.all(np.diff(waves) > 0)


def test_on_the_published_demonstration_heart(crtdemo, subject):
    """Whose left endocardium has half the area: lengths go with its root, all else stays."""
    model = fascicle.ForwardModel(crtdemo)
    found = fascicle.example_parameters(model)
    simulation = model.simulate(found)
    assert all(len(tree.junctions) >= FEW_JUNCTIONS for tree in simulation.trees)
    for ours, its in zip(crtdemo.endocardia, subject.endocardia, strict=True):
        lengths = {n for n in found if n.startswith(f"{ours.side}_") and "length" in n}
        factors = {round(found.pop(n) / subject.example[n], 6) for n in lengths}
        assert factors == {round(np.sqrt(ours.area / its.area), 2)}
    assert found.items() <= subject.example.items()
    sequence = model.surfaces.sequence(simulation.activation)
    assert sequence.first == "left septum"
    assert 60 < simulation.total_activation_time < 200
    assert np.isfinite(simulation.ecg).all()


def smaller(heart, factor):
    """A heart scaled by a factor, whose right ventricle is also a fifth as wide."""
    centre = heart.lv.vertices.mean(axis=0)
    across = heart.rv.vertices.mean(axis=0) - centre
    across /= np.linalg.norm(across)
    septum = ((heart.rv.vertices - centre) @ across).min()

    def moved(points):
        beyond = np.maximum((points - centre) @ across - septum, 0)
        return centre + factor * (points - centre - np.outer(0.8 * beyond, across))

    lv, rv = (replace(e, vertices=moved(e.vertices)) for e in heart.endocardia)
    return replace(heart, vertices=moved(heart.vertices), lv=lv, rv=rv)


@pytest.mark.parametrize(("factor", "ml"), [(0.95, (35, 8)), (0.55, (7, 2))])
def test_on_small_hearts(small_heart, subject, factor, ml):
    """Lengths go with the endocardium, but for what does not fit, and junctions with its area."""
    heart = smaller(small_heart, factor)
    model = fascicle.ForwardModel(heart)
    found = fascicle.example_parameters(model)
    for ours, its, tree in zip(
        heart.endocardia, subject.endocardia, model.grow(found), strict=True
    ):
        share = ours.area / its.area
        name = f"{ours.side}_initial_length"
        assert len(tree.junctions) >= FEW_JUNCTIONS * min(1, 2 * share)
        assert 0.5 < found[name] / subject.example[name] / round(np.sqrt(share), 2) < 1.0001


def test_the_most_junctions_where_there_are_few(small_model, trees, monkeypatch):
    lengths = []

    def grow(parameters):
        lengths.append(parameters["lv_initial_length"])
        count = 9 if len(lengths) == 3 else 4
        return [SimpleNamespace(side=tree.side, junctions=range(count)) for tree in trees]

    monkeypatch.setattr(small_model, "grow", grow)
    assert fascicle.example_parameters(small_model)["lv_initial_length"] == lengths[2]


def test_a_heart_with_no_room_is_refused(small_model, monkeypatch):
    invalid = Infeasible("", "", "rv_fascicle_length_2", 0.0)
    monkeypatch.setattr(small_model, "grow", lambda parameters: invalid)
    with pytest.raises(InputError, match="no example network was found that fits; choose other"):
        fascicle.example_parameters(small_model)
