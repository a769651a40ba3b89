"""Every tetrahedron in eight: no gaps, what is inherited, and the same model."""

from dataclasses import replace

import numpy as np
import pytest
from builders import block_of_random_tissue, box

from fascicle.build.refinement import in_eight, refined
from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.electrocardiogram import nodal_gradients
from fascicle.forward.model import ForwardModel
from fascicle.heart.conduction import Conduction
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import LeadFields
from fascicle.mesh.measures import barycentric_gradients, signed_volumes
from fascicle.mesh.topology import TETRAHEDRON_FACES, boundary_triangles
from fascicle.torso.lead_fields import is_up_to_date, key_of


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


def test_tetrahedra_inherit_what_their_parent_has_and_all_else_stays(block, finer):
    assert len(finer.tetrahedra) == 8 * len(block.tetrahedra)
    for name in ("fibres", "sheets", "regions"):
        expected = np.repeat(getattr(block, name), 8, axis=0)
        np.testing.assert_array_equal(getattr(finer, name), expected)
    np.testing.assert_allclose(finer.volumes, np.repeat(block.volumes / 8, 8))
    assert finer.lv is block.lv
    assert finer.rv is block.rv
    assert (finer.name, finer.values) == (block.name, block.values)
    assert finer.electrodes is block.electrodes
    assert 0.5 * block.edge_length == pytest.approx(finer.edge_length, rel=0.05)


def test_gradients_of_the_lead_fields_stay_and_they_are_accepted_without_a_torso(block, finer):
    def gradients(heart):
        slopes = barycentric_gradients(heart.vertices, heart.tetrahedra)
        return nodal_gradients(heart.lead_fields.values, heart.tetrahedra, slopes)

    expected = np.repeat(gradients(block), 8, axis=1)
    np.testing.assert_allclose(gradients(finer), expected, atol=1e-12)
    assert finer.torso is None
    assert is_up_to_date(finer, Conduction.of(finer))
    assert not is_up_to_date(replace(finer, fibres=-finer.fibres), Conduction())


def test_old_lead_fields_and_a_mesh_too_large_for_the_memory_are_refused(block, monkeypatch):
    with pytest.raises(InputError, match=r"^block: its lead fields are for other electrodes"):
        refined(replace(block, electrodes=block.electrodes + 1.0))
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


def test_children_lie_in_their_parent_fill_it_and_conform():
    """Every face belongs to two tetrahedra, or to one and the boundary, which is the old one's."""
    cells = box((20.0, 15.0, 10.0), (4, 3, 3), jitter=0.2)
    cut = in_eight(cells.vertices, cells.tetrahedra)
    volumes = signed_volumes(cut.vertices, cut.tetrahedra)
    np.testing.assert_allclose(volumes, np.repeat(cells.volumes / 8, 8), rtol=1e-11)
    corners = cells.vertices[cells.tetrahedra]
    centres = cut.vertices[cut.tetrahedra].mean(axis=1).reshape(-1, 8, 3)
    offset = (centres - corners[:, :1])[..., None]
    axes = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inner = np.linalg.solve(axes[:, None], offset)[..., 0]
    assert inner.min() > 0
    assert inner.sum(axis=2).max() < 1
    faces = np.sort(cut.tetrahedra[:, TETRAHEDRON_FACES].reshape(-1, 3), axis=1)
    _, count = np.unique(faces, axis=0, return_counts=True)
    old, _ = boundary_triangles(cells.tetrahedra)
    assert set(count) == {1, 2}
    assert (count == 1).sum() == 4 * len(old)
    assert np.unique(cut.tetrahedra).tolist() == list(range(len(cut.vertices)))
    middle = cells.vertices[cut.edges].mean(axis=1)
    np.testing.assert_array_equal(cut.vertices, np.concatenate([cells.vertices, middle]))
    at_all = cut.at_vertices(np.stack([cells.vertices[:, 0], 3 * cells.vertices[:, 1]]))
    np.testing.assert_allclose(at_all, [cut.vertices[:, 0], 3 * cut.vertices[:, 1]])


@pytest.mark.parametrize("longest", [0, 1, 2])
def test_octahedron_is_cut_along_its_shortest_diagonal(longest):
    """The regular one's three are alike; stretched along one of them, the others are shorter."""
    tetrahedron = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    tetrahedron[:, longest] *= 3.0
    cut = in_eight(tetrahedron, np.array([[0, 2, 1, 3]]))
    pairs = cut.tetrahedra[:, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]].reshape(-1, 2)
    inner = cut.vertices[pairs].mean(axis=1)
    through_the_middle = pairs[np.abs(inner).max(axis=1) < 1e-12]
    ends = cut.vertices[through_the_middle]
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 2.0)
    assert len(ends) == 4
