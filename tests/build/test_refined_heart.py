"""A heart on a finer mesh: what is inherited, and that its model is the coarse one's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import block_of_random_tissue

from fascicle.build.refinement import refined
from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.ecg.lead_field import nodal_gradients
from fascicle.forward.model import ForwardModel
from fascicle.heart.conduction import Conduction
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import LeadFields
from fascicle.mesh.measures import barycentric_gradients
from fascicle.torso.lead_fields import is_up_to_date, key_of

PER_PARENT = 8


@pytest.fixture(scope="module")
def block():
    """A block with sheets, regions, a patient's value, and lead fields of its own."""
    rng = np.random.default_rng(3)
    heart = replace(
        block_of_random_tissue(40.0, rng), name="block", values={"region_1_conductivity": 0.5}
    )
    values = rng.standard_normal((9, len(heart.vertices)))
    return replace(heart, lead_fields=LeadFields(values, key_of(heart, Conduction()), "a torso"))


@pytest.fixture(scope="module")
def finer(block):
    return refined(block)


def test_tetrahedra_inherit_what_their_parent_has(block, finer):
    assert len(finer.tetrahedra) == PER_PARENT * len(block.tetrahedra)
    for name in ("fibres", "sheets", "regions"):
        expected = np.repeat(getattr(block, name), PER_PARENT, axis=0)
        np.testing.assert_array_equal(getattr(finer, name), expected)
    np.testing.assert_allclose(finer.volumes, np.repeat(block.volumes / 8, PER_PARENT))


def test_the_rest_stays(block, finer):
    assert finer.lv is block.lv
    assert finer.rv is block.rv
    assert (finer.name, finer.values) == (block.name, block.values)
    assert finer.electrodes is block.electrodes
    assert 0.5 * block.edge_length == pytest.approx(finer.edge_length, rel=0.05)


def test_gradients_of_the_lead_fields_stay(block, finer):
    def gradients(heart):
        slopes = barycentric_gradients(heart.vertices, heart.tetrahedra)
        return nodal_gradients(heart.lead_fields.values, heart.tetrahedra, slopes)

    expected = np.repeat(gradients(block), PER_PARENT, axis=1)
    np.testing.assert_allclose(gradients(finer), expected, atol=1e-12)


def test_lead_fields_are_accepted_without_a_torso(block, finer):
    assert finer.torso is None
    assert is_up_to_date(finer, Conduction.of(finer))
    assert not is_up_to_date(replace(finer, fibres=-finer.fibres), Conduction())


def test_lead_fields_that_are_out_of_date_are_refused(block):
    with pytest.raises(InputError, match=r"^block: its lead fields are for other electrodes"):
        refined(replace(block, electrodes=block.electrodes + 1.0))


def test_a_mesh_too_large_for_the_memory_is_refused(block, monkeypatch):
    monkeypatch.setattr("fascicle.build.refinement.available_memory", lambda: 1e6)
    with pytest.raises(InputError, match=r"^block: with eight times its 384 tetrahedra .* GB"):
        refined(block)


@pytest.mark.slow
def test_the_model_of_the_finer_packaged_heart(default_heart, default_model, tmp_path):
    """Read back from its folder: the same trees, and an ECG within the coarse mesh's error."""
    write_heart(refined(default_heart), tmp_path / "fine")
    model = ForwardModel(load_heart(tmp_path / "fine"))
    coarse = default_model.simulate(EXAMPLE_PARAMETERS)
    fine = model.simulate(EXAMPLE_PARAMETERS)
    for one, other in zip(coarse.trees, fine.trees, strict=True):
        np.testing.assert_array_equal(one.nodes, other.nodes)
        np.testing.assert_array_equal(one.parents, other.parents)
    length = min(coarse.leads.shape[1], fine.leads.shape[1])
    difference = coarse.leads[:, :length] - fine.leads[:, :length]
    share = np.linalg.norm(difference) / np.linalg.norm(fine.leads)
    assert 0.01 < share < 0.07
