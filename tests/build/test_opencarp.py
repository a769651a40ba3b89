"""Hearts and trees for openCARP: what is written reads back; damaged files are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import block_of_random_tissue, line_tree

from fascicle.build.export import write_opencarp
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.formats.mesh_file import LINE, TETRAHEDRON, TRIANGLE
from fascicle.mesh.formats.opencarp import read_opencarp_mesh, read_surf, read_vtx, write_vtx
from fascicle.mesh.formats.read import read_mesh
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import read_tree, write_opencarp_tree

SIZE = 60.0  # mm
TREE = [".pts", ".elem", ".lon", "_length.dat"]


@pytest.fixture
def heart():
    """A block of 384 tetrahedra with random fibres, sheets and regions."""
    return block_of_random_tissue(SIZE, np.random.default_rng(3))


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


def test_a_heart_comes_back(folder, heart):
    mesh = read_opencarp_mesh(folder / "heart")
    assert np.abs(mesh.points - heart.vertices).max() < 1e-9
    np.testing.assert_array_equal(mesh.cells[TETRAHEDRON], heart.tetrahedra)
    arrays = mesh.cell_data[TETRAHEDRON]
    assert np.abs(arrays["fibre"] - heart.fibres).max() < 1e-14
    assert np.abs(arrays["sheet"] - heart.sheets).max() < 1e-14
    np.testing.assert_array_equal(arrays["region"], heart.regions)


def test_every_file_of_it_names_the_mesh(folder):
    whole = read_opencarp_mesh(folder / "heart")
    for name in ("heart.pts", "heart.elem", "heart.lon"):
        np.testing.assert_array_equal(read_opencarp_mesh(folder / name).points, whole.points)
    np.testing.assert_array_equal(read_mesh(folder / "heart.pts").points, whole.points)


def test_the_files_are_in_micrometres(folder):
    lines = (folder / "heart.pts").read_text().splitlines()
    assert lines[0] == "125"
    assert [float(x) for x in lines[-1].split()] == [60000.0, 60000.0, 60000.0]


def test_without_regions_the_tag_is_one(tmp_path, heart):
    plain = replace(heart, regions=None, sheets=None)
    write_opencarp(plain, labelled(plain), tmp_path / "plain")
    mesh = read_opencarp_mesh(tmp_path / "plain")
    assert set(mesh.cell_data[TETRAHEDRON]) == {"fibre", "region"}
    assert (mesh.cell_data[TETRAHEDRON]["region"] == 1).all()
    assert (tmp_path / "plain.lon").read_text().startswith("1\n")


def test_the_whole_boundary_is_there(folder, heart):
    """The base, which is missing in this one, has no files."""
    for name, axis, level in (("lv_endo", 0, 0.0), ("rv_endo", 0, SIZE), ("epi", 2, SIZE)):
        triangles = read_surf(folder / f"heart_{name}.surf", len(heart.vertices))
        there = (heart.vertices[triangles][:, :, axis] == level).all(axis=1)
        assert there.sum() == 32
        assert len(triangles) == (128 if name == "epi" else 32)
        vertices, domain = read_vtx(folder / f"heart_{name}.vtx")
        assert domain == "intra"
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


def test_a_mesh_in_mm_is_noticed(folder, heart):
    path = folder / "heart.pts"
    rows = [" ".join(map(repr, row)) for row in heart.vertices.tolist()]
    path.write_text("\n".join(["125", *rows]) + "\n")
    np.testing.assert_array_equal(read_opencarp_mesh(path).points, heart.vertices)


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
    assert mesh.others == {"quadrangles": 1}


@pytest.mark.parametrize("suffix", [".pts", ".elem"])
def test_a_tree_comes_back_with_its_lengths(folder, tree, suffix):
    read = read_tree(folder / f"lv_tree{suffix}", "lv", tree.nodes[tree.root] + 0.1)
    assert np.abs(read.nodes - tree.nodes).max() < 1e-9
    np.testing.assert_array_equal(read.parents, tree.parents)
    assert np.abs(read.lengths - tree.lengths).max() < 1e-9
    np.testing.assert_array_equal(read.junctions, tree.junctions)


def test_a_tree_says_where_root_junctions_and_parts_are(folder, tree):
    np.testing.assert_array_equal(read_vtx(folder / "lv_tree_root.vtx")[0], [2])
    np.testing.assert_array_equal(read_vtx(folder / "lv_tree_junctions.vtx")[0], [3, 4, 5])
    mesh = read_opencarp_mesh(folder / "lv_tree")
    np.testing.assert_array_equal(mesh.cells[LINE][:, 1], [0, 1, 3, 4, 5])
    np.testing.assert_array_equal(mesh.cell_data[LINE]["region"], [0, 0, 1, 2, 3])
    along = tree.nodes[3] - tree.nodes[1]
    fibre = mesh.cell_data[LINE]["fibre"][2]
    np.testing.assert_allclose(fibre, along / np.linalg.norm(along), atol=1e-14)


def test_a_tree_without_lengths_takes_them_from_its_ends(folder, tree):
    (folder / "lv_tree_length.dat").unlink()
    read = read_tree(folder / "lv_tree.pts", "lv", tree.nodes[2])
    chords = np.linalg.norm(tree.nodes - tree.nodes[tree.parents], axis=1)
    chords[2] = 0
    np.testing.assert_allclose(read.lengths, chords, atol=1e-9)


def test_a_grown_tree_comes_back(tmp_path):
    turn = np.linspace(0, 9, 200)
    nodes = np.column_stack([20 * np.cos(turn), 20 * np.sin(turn), 5 * turn])
    tree = line_tree(nodes, side="rv")
    write_opencarp_tree(tmp_path / "rv_tree", tree)
    read = read_tree(tmp_path / "rv_tree.pts", "rv", nodes[0])
    assert np.abs(read.nodes - nodes).max() < 1e-9
    np.testing.assert_array_equal(read.parents, tree.parents)


def test_vertices_come_back(tmp_path):
    write_vtx(tmp_path / "sites.vtx", np.array([4, 0, 7]), "extra")
    indices, domain = read_vtx(tmp_path / "sites.vtx")
    assert (indices.tolist(), domain) == ([4, 0, 7], "extra")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("heart.pts", "", "empty"),
        ("heart.pts", "x\n1 2 3\n", "the first line is 'x'"),
        ("heart.pts", "3\n1 2 3\n4 5 6\n", "the first line is '3', and 2 lines follow"),
        ("heart.pts", "1\n1 2 3", "no line end"),
        ("heart.pts", "2\n1 2 3\n4 5\n", "truncated or damaged"),
        ("heart.pts", "2\n\n4 5 6\n", "a line without numbers"),
        ("heart.elem", "1\nTt\n", "a line without numbers"),
        ("heart.pts", "2\n1 2\n4 5\n", "2 lines with 2 numbers; need 2 with 3"),
        ("heart.pts", "2\n1 2 3\nnan 5 6\n", "not finite (first: 'nan 5 6')"),
        ("heart.pts", "1\n1 2 3\n", "indices are out of range"),
        ("heart.elem", "1\nTt 0 1 2 125 1\n", "1 indices are out of range (first: 125)"),
        ("heart.elem", "1\nTt 0 1 2 -1 1\n", "(first: -1)"),
        ("heart.elem", "1\nTt 0 1 2 3.5 1\n", "3.5 stands where a whole number should"),
        ("heart.elem", "1\nT4 0 1 2 3 1\n", "unknown element type 'T4'"),
        ("heart.elem", "1\nTt 0 1 2\n", "need 1 with 4 or 5"),
        ("heart.elem", "1\nTt 0 1 2 3 1\n", "384 lines of fibres for 1 elements"),
        ("heart.lon", "1 0 0\n", "the first line is '1 0 0'"),
        ("heart.lon", "3\n1 0 0\n", "the first line is '3'"),
        ("heart.lon", "1\n1 0 0\n", "1 lines of fibres for 384 elements"),
    ],
)
def test_contradictions_are_refused(folder, name, content, words):
    (folder / name).write_text(content)
    with pytest.raises(InputError) as caught:
        read_mesh(folder / "heart.elem")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{folder / 'heart'}.")


@pytest.mark.parametrize("missing", [".pts", ".elem"])
def test_a_missing_file_is_named(folder, missing):
    (folder / f"heart{missing}").unlink()
    with pytest.raises(InputError, match=rf"heart\{missing}: no such file"):
        read_opencarp_mesh(folder / "heart.lon")


def test_binary_files_are_refused(folder):
    (folder / "heart.pts").write_bytes(b"125\n" + bytes(range(128, 256)) + b"\n")
    with pytest.raises(InputError, match="not a text file"):
        read_mesh(folder / "heart.pts")


def test_lengths_must_be_as_many_as_segments(folder, tree):
    path = folder / "lv_tree_length.dat"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(InputError, match="4 lengths for 5 lines"):
        read_tree(folder / "lv_tree.elem", "lv", tree.nodes[2])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("2\n1\n2\n", "must be 'intra' or 'extra'"),
        ("2\nintra\n1\n", "the first line is '2', and 1 lines follow"),
        ("1\nextra\n-4\n", "out of range \\(first: -4\\)"),
        ("1\nextra\n1 2\n", "1 lines with 2 numbers"),
    ],
)
def test_bad_vertices_are_refused(tmp_path, content, words):
    (tmp_path / "bad.vtx").write_text(content)
    with pytest.raises(InputError, match=words):
        read_vtx(tmp_path / "bad.vtx")


def test_surfaces_are_made_of_triangles(tmp_path):
    (tmp_path / "bad.surf").write_text("2\nTr 0 1 2\nQd 0 1 2 3\n")
    with pytest.raises(InputError, match="line 3 is 'Qd 0 1 2 3'"):
        read_surf(tmp_path / "bad.surf", 4)


def readers(folder, name, tree):
    """What reads this file."""
    if name.startswith("lv_tree"):
        return lambda: read_tree(folder / "lv_tree.pts", "lv", tree.nodes[2])
    if name.endswith(".surf"):
        return lambda: read_surf(folder / name, 125)
    return lambda: read_mesh(folder / "heart.pts")


def why_refused(read):
    """The message of an InputError; None if the file was read."""
    try:
        read()
    except InputError as error:
        return str(error)
    return None


NAMES = ["heart.pts", "heart.elem", "heart.lon", "heart_lv_endo.surf"]
NAMES += [f"lv_tree{suffix}" for suffix in TREE]


@pytest.mark.parametrize("name", NAMES)
def test_every_cut_is_refused(folder, tree, name):
    path, read = folder / name, readers(folder, name, tree)
    whole = path.read_bytes()
    for end in np.unique(np.linspace(0, len(whole) - 1, 60).astype(int)):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError) as caught:
            read()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", NAMES)
def test_flipped_bytes_are_refused_or_harmless(folder, tree, name):
    path, read = folder / name, readers(folder, name, tree)
    whole, rng = path.read_bytes(), np.random.default_rng(len(name))
    refused = 0
    for _ in range(80):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        message = why_refused(read)
        refused += message is not None
        assert message is None or "\n" not in message
    assert refused >= 20  # a bit of a digit makes another digit, which nobody can notice
