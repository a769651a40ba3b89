"""Hearts in other software's files read back equal, as meshes and as hearts."""

from dataclasses import replace

import numpy as np
import pytest
from builders import block_of_random_tissue, line_tree
from shapes import read_labelled_mesh

from fascicle.build.export import export_heart
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.heart import LeadFields
from fascicle.heart.labelled_surface import NEEDED_LABELS, labelled_mesh
from fascicle.mesh.mesh_file import GROUP, TETRAHEDRON, TRIANGLE
from fascicle.mesh.read import read_mesh
from fascicle.purkinje.tree_files import read_tree

SIZE = 60.0  # mm
OUT = {"opencarp": "carp", "vtu": "heart.vtu", "gmsh": "heart.msh"}
MESH = {**OUT, "opencarp": "carp/heart.pts"}
TOLERANCE = {"opencarp": 1e-9, "vtu": 0.0, "gmsh": 0.0}  # mm


@pytest.fixture
def heart():
    """A block with random fibres, sheets, regions, electrodes and lead fields."""
    rng = np.random.default_rng(5)
    block = block_of_random_tissue(SIZE, rng)
    return replace(
        block,
        electrodes=300 * rng.standard_normal((9, 3)),
        lead_fields=LeadFields(rng.standard_normal((9, len(block.vertices))), "key", ""),
    )


@pytest.mark.parametrize("kind", OUT)
def test_a_heart_comes_back(tmp_path, heart, kind):
    tree = line_tree([[5, 5, 50], [5, 15, 40], [5, 25, 20.0]])
    trees = [tree] if kind == "opencarp" else []
    export_heart(heart, tmp_path / OUT[kind], kind, trees)
    mesh = read_mesh(tmp_path / MESH[kind])
    count = len(heart.vertices)
    assert np.abs(mesh.points[:count] - heart.vertices).max() <= TOLERANCE[kind]
    np.testing.assert_array_equal(mesh.cells[TETRAHEDRON], heart.tetrahedra)
    arrays = mesh.cell_data[TETRAHEDRON]
    assert np.abs(arrays["fibre"] - heart.fibres).max() <= 1e-14
    assert np.abs(arrays["sheet"] - heart.sheets).max() <= 1e-14
    np.testing.assert_array_equal(arrays["region"], heart.regions)
    if kind == "vtu":
        for electrode, values in zip(ELECTRODES, heart.lead_fields.values, strict=True):
            np.testing.assert_array_equal(mesh.point_data[f"lead_field_{electrode}"], values)
    if kind == "opencarp":
        read, _ = read_electrodes(tmp_path / "carp" / "electrodes.csv")
        np.testing.assert_array_equal(read, heart.electrodes)
        read = read_tree(tmp_path / "carp" / "lv_tree.pts", "lv", tree.nodes[0])
        np.testing.assert_allclose(read.nodes, tree.nodes, atol=1e-9)
    plain = replace(heart, sheets=None, regions=None, lead_fields=None)
    export_heart(plain, tmp_path / OUT[kind], kind, trees)
    arrays = read_mesh(tmp_path / MESH[kind]).cell_data[TETRAHEDRON]
    assert "sheet" not in arrays
    assert (arrays.get("region", np.ones(1)) == 1).all()


def test_gmsh_groups(tmp_path, heart):
    export_heart(heart, tmp_path / "heart.msh", "gmsh")
    mesh = read_mesh(tmp_path / "heart.msh")
    groups = dict.fromkeys(("lv_endo", "rv_endo", "epi", "base"), 2)
    groups |= {f"region {k}": 3 for k in range(-1, 4)}
    assert {name: of for name, (of, _) in mesh.groups.items()} == groups
    numbers = mesh.cell_data[TETRAHEDRON][GROUP]
    for region in range(-1, 4):
        there = numbers == mesh.groups[f"region {region}"][1]
        np.testing.assert_array_equal(there, heart.regions == region)
    for side, level in (("lv", 0.0), ("rv", SIZE)):
        rows = mesh.cell_data[TRIANGLE][GROUP] == mesh.groups[f"{side}_endo"][1]
        assert rows.sum() == 32
        assert (mesh.points[mesh.cells[TRIANGLE][rows]][:, :, 0] == level).all()
    assert len(mesh.points) == len(heart.vertices)


@pytest.mark.parametrize("kind", ["opencarp", "gmsh"])
def test_what_goes_out_has_every_label(tmp_path, default_heart, kind):
    export_heart(default_heart, tmp_path / OUT[kind], kind)
    anatomy = read_labelled_mesh(tmp_path / MESH[kind])
    read = anatomy.mesh
    known = labelled_mesh(default_heart)
    order = [np.lexsort(np.sort(mesh.triangles).T) for mesh in (read, known)]
    same = [np.sort(mesh.triangles)[at] for mesh, at in zip((read, known), order, strict=True)]
    np.testing.assert_array_equal(*same)
    np.testing.assert_array_equal(read.labels[order[0]], known.labels[order[1]])
    assert np.unique(read.labels).tolist() == sorted(NEEDED_LABELS)
    np.testing.assert_array_equal(read.tetrahedra, default_heart.tetrahedra)
    assert anatomy.notes == ()


def test_bad_places_are_refused(tmp_path, heart):
    (tmp_path / "taken.vtu").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    for out, kind, words in (
        ("heart.stl", "stl", "format 'stl' is unknown"),
        ("heart.vtk", "vtu", "must end in .vtu"),
        ("taken.vtu", "vtu", "is a folder"),
        ("full", "opencarp", "holds 'mine.txt', which would be lost"),
    ):
        with pytest.raises(InputError, match=f"^.*{words}.*$"):
            export_heart(heart, tmp_path / out, kind)
    assert sorted(tmp_path.rglob("*")) == before


def test_nothing_is_left_of_a_failed_export(tmp_path, heart, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("meshio.gmsh.write", full)
    with pytest.raises(InputError, match="No space left"):
        export_heart(heart, tmp_path / "heart.msh", "gmsh")
    monkeypatch.setattr("fascicle.build.export.write_electrodes", full)
    with pytest.raises(InputError, match="No space left"):
        export_heart(heart, tmp_path / "carp", "opencarp")
    assert list(tmp_path.iterdir()) == []
