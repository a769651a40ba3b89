"""Hearts and trees in other software's files read back equal; damaged ones are refused."""

from dataclasses import replace

import numpy as np
import pytest
from builders import block_of_random_tissue
from shapes import read_labelled_mesh

from fascicle.build.export import export_heart, write_opencarp
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.heart import LeadFields
from fascicle.heart.labelled_surface import NEEDED_LABELS, Label, LabelledMesh, labelled_mesh
from fascicle.mesh.mesh_file import GROUP, LINE, TETRAHEDRON, TRIANGLE
from fascicle.mesh.opencarp import read_opencarp_mesh, read_surf, read_vtx
from fascicle.mesh.read import read_mesh
from fascicle.purkinje.tree import PurkinjeTree
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


def labelled(heart):
    """The left face of the block is the LV, its right the RV, all else epicardium."""
    triangles = heart.boundary[0]
    x = heart.vertices[triangles].mean(axis=1)[:, 0]
    labels = np.full(len(triangles), int(Label.EPICARDIUM))
    labels[x == 0] = Label.LV_ENDOCARDIUM
    labels[x == SIZE] = Label.RV_ENDOCARDIUM
    return LabelledMesh(heart.vertices, heart.tetrahedra, triangles, labels)


@pytest.fixture
def tree():
    """Bundle of three segments, a fork into three, curved segments; the root is node 2."""
    nodes = np.array(
        [[0, 0, 30], [0, 0, 20], [0, 0, 40.0], [5, 8, 12], [-6, 9, 11], [1, -9, 10.123456789]]
    )
    parents = np.array([2, 0, -1, 1, 1, 1])
    lengths = np.linalg.norm(nodes - nodes[parents], axis=1) * [1.001, 1.01, 0, 1.02, 1.03, 1.04]
    return PurkinjeTree("lv", nodes, parents, lengths)


@pytest.fixture
def folder(tmp_path, heart, tree):
    write_opencarp(heart, labelled(heart), tmp_path / "heart", [tree])
    return tmp_path


@pytest.mark.parametrize("kind", OUT)
def test_a_heart_comes_back(tmp_path, heart, tree, kind):
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
        read = read_tree(tmp_path / "carp" / "lv_tree.pts", "lv", tree.nodes[tree.root])
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


def test_files_are_in_micrometres_and_the_whole_boundary_is_there(folder, heart):
    """The base, which is missing in this one, has no files."""
    lines = (folder / "heart.pts").read_text().splitlines()
    assert lines[0] == "125"
    assert [float(x) for x in lines[-1].split()] == [60000.0, 60000.0, 60000.0]
    for name, axis, level in (("lv_endo", 0, 0.0), ("rv_endo", 0, SIZE), ("epi", 2, SIZE)):
        triangles = read_surf(folder / f"heart_{name}.surf", len(heart.vertices))
        there = (heart.vertices[triangles][:, :, axis] == level).all(axis=1)
        assert there.sum() == 32
        assert len(triangles) == (128 if name == "epi" else 32)
        vertices = read_vtx(folder / f"heart_{name}.vtx", len(heart.vertices))
        np.testing.assert_array_equal(vertices, np.unique(triangles))
    assert not list(folder.glob("heart_base.*"))
    assert not list(folder.glob("heart_*_endocardium.*"))


def test_endocardia_of_their_own_less_their_valves(tmp_path, heart):
    moved = replace(heart.lv, vertices=heart.lv.vertices + 0.4, valves=np.arange(32) < 2)
    write_opencarp(replace(heart, lv=moved), labelled(heart), tmp_path / "heart")
    assert not (tmp_path / "heart_rv_endocardium.pts").exists()
    assert len(read_surf(tmp_path / "heart_lv_endo.surf", len(heart.vertices))) == 32
    mesh = read_opencarp_mesh(tmp_path / "heart_lv_endocardium")
    corners = mesh.points[mesh.cells[TRIANGLE]]
    assert np.abs(corners - moved.vertices[moved.triangles[2:]]).max() < 1e-9


def test_elements_of_all_kinds(tmp_path):
    (tmp_path / "mixed.pts").write_text("5\n0 0 0\n9000 0 0\n0 9000 0\n0 0 9000\n9000 9000 0\n")
    (tmp_path / "mixed.elem").write_text(
        "5\nTr 0 1 2 7\nTt 0 1 2 3 1\nLn 0 4\nQd 0 1 4 2 3\n  Tr 1 4 2 8\n"
    )
    (tmp_path / "mixed.lon").write_text("1\n1 0 0\n0 1 0\n0 0 1\n1 0 0\n0 .6 .8\n")
    mesh = read_opencarp_mesh(tmp_path / "mixed.elem")
    np.testing.assert_array_equal(mesh.cells[TRIANGLE], [[0, 1, 2], [1, 4, 2]])
    np.testing.assert_array_equal(mesh.cell_data[TRIANGLE]["region"], [7, 8])
    np.testing.assert_array_equal(mesh.cell_data[TRIANGLE]["fibre"], [[1, 0, 0], [0, 0.6, 0.8]])
    np.testing.assert_array_equal(mesh.cell_data[TETRAHEDRON]["fibre"], [[0, 1, 0]])
    assert "region" not in mesh.cell_data[LINE]
    assert mesh.other_cells == {"quadrangles": 1}


def test_a_tree_comes_back_with_its_lengths_or_those_of_chords(folder, tree):
    chords = np.linalg.norm(tree.nodes - tree.nodes[tree.parents], axis=1)
    chords[2] = 0
    for name, lengths in (("lv_tree.pts", tree.lengths), ("lv_tree.elem", chords)):
        read = read_tree(folder / name, "lv", tree.nodes[tree.root] + 0.1)
        assert np.abs(read.nodes - tree.nodes).max() < 1e-9
        np.testing.assert_array_equal(read.parents, tree.parents)
        assert np.abs(read.lengths - lengths).max() < 1e-9
        np.testing.assert_array_equal(read.junctions, tree.junctions)
        (folder / "lv_tree_length.dat").unlink(missing_ok=True)
    np.testing.assert_array_equal(read_vtx(folder / "lv_tree_root.vtx", 6), [2])
    np.testing.assert_array_equal(read_vtx(folder / "lv_tree_junctions.vtx", 6), [3, 4, 5])
    mesh = read_opencarp_mesh(folder / "lv_tree")
    np.testing.assert_array_equal(mesh.cells[LINE][:, 1], [0, 1, 3, 4, 5])
    np.testing.assert_array_equal(mesh.cell_data[LINE]["region"], [0, 0, 1, 2, 3])
    along = tree.nodes[3] - tree.nodes[1]
    fibre = mesh.cell_data[LINE]["fibre"][2]
    np.testing.assert_allclose(fibre, along / np.linalg.norm(along), atol=1e-14)


def test_counts_and_the_last_line_end_may_be_missing(folder):
    before = read_mesh(folder / "heart.pts"), read_surf(folder / "heart_epi.surf", 125)
    numbers = read_vtx(folder / "heart_epi.vtx", 125)
    for name in ("heart.pts", "heart.elem", "heart.lon", "heart_epi.surf", "heart_epi.vtx"):
        count, lines = (folder / name).read_text().split("\n", 1)
        assert count.isdecimal()
        (folder / name).write_text(lines.rstrip())
    after = read_mesh(folder / "heart.pts")
    np.testing.assert_array_equal(after.points, before[0].points)
    np.testing.assert_array_equal(after.cells[TETRAHEDRON], before[0].cells[TETRAHEDRON])
    for name, values in before[0].cell_data[TETRAHEDRON].items():
        np.testing.assert_array_equal(after.cell_data[TETRAHEDRON][name], values)
    np.testing.assert_array_equal(read_surf(folder / "heart_epi.surf", 125), before[1])
    np.testing.assert_array_equal(read_vtx(folder / "heart_epi.vtx", 125), numbers)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("heart.pts", "3\n1 2 3\n4 5 6\n", "the first line is '3', and 2 lines follow"),
        ("heart.pts", "2\n\n4 5 6\n", "a line without numbers"),
        ("heart.pts", "2\n1 2 3\nnan 5 6\n", "not finite (first: 'nan 5 6')"),
        ("heart.pts", b"125\n\x80\xff\n", "not a text file"),
        ("heart.elem", "1\nTt 0 1 2 125 1\n", "1 indices are out of range (first: 125)"),
        ("heart.elem", "1\nTt 0 1 2 3.5 1\n", "3.5 is not a whole number"),
        ("heart.elem", "1\nT4 0 1 2 3 1\n", "element 0 is of an unknown type 'T4'"),
        ("heart.elem", "1\nTt 0 1 2\n", "need 1 with 4 or 5"),
        ("heart.lon", "1\n1 0 0\n", "1 lines of fibres for 384 elements"),
        ("heart_epi.surf", "2\nTr 0 1 2\nQd 0 1 2 3\n", "triangle 1 is 'Qd 0 1 2 3'"),
        ("heart_epi.vtx", "2\n1\n2\n", "must be 'intra' or 'extra'"),
        ("heart_epi.vtx", "1\nextra\n-4\n", "out of range (first: -4)"),
        ("lv_tree_length.dat", "1\n1\n1\n1\n", "4 lengths for 5 lines"),
    ],
)
def test_contradictions_are_refused(folder, tree, name, content, words):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    readers = {
        ".surf": lambda: read_surf(path, 125),
        ".vtx": lambda: read_vtx(path, 125),
        ".dat": lambda: read_tree(folder / "lv_tree.pts", "lv", tree.nodes[2]),
    }
    with pytest.raises(InputError) as caught:
        readers.get(path.suffix, lambda: read_mesh(folder / "heart.pts"))()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
