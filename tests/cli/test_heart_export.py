"""`fascicle heart export` of a built heart, read back by `fascicle` and by others."""

import anatomies
import meshio
import numpy as np
import pytest
import pyvista as pv
from anatomies import LV, RV

from fascicle.heart.folder import load_heart
from fascicle.mesh.mesh_file import TETRAHEDRON
from fascicle.mesh.read import read_mesh


@pytest.fixture
def heart(ventricles):
    return load_heart(ventricles)


@pytest.fixture
def export(run, ventricles, outside):
    def call(name, kind):
        ended = run("heart", "export", ventricles, "--format", kind, "--out", outside / name)
        assert (ended.status, ended.err) == (0, "")
        assert ended.out == f"written to {outside / name}\n"
        return outside / name

    return call


def assert_same(mesh, heart, exact):
    """Tetrahedra, fibres, sheets and regions are the heart's."""
    count = len(heart.vertices)
    np.testing.assert_allclose(mesh.points[:count], heart.vertices, rtol=0, atol=exact)
    np.testing.assert_array_equal(mesh.cells[TETRAHEDRON], heart.tetrahedra)
    arrays = mesh.cell_data[TETRAHEDRON]
    np.testing.assert_allclose(arrays["fibre"], heart.fibres, atol=1e-14)
    np.testing.assert_allclose(arrays["sheet"], heart.sheets, atol=1e-14)
    np.testing.assert_array_equal(arrays["region"], heart.regions)
    assert 20 < heart.regions.sum() < len(heart.regions) / 2


def test_vtu(export, heart):
    path = export("heart.vtu", "vtu")
    assert_same(read_mesh(path), heart, 0.0)
    other = pv.read(path)
    assert other.n_cells == len(heart.tetrahedra)
    sizes = other.compute_cell_sizes(length=False, area=False)["Volume"]
    np.testing.assert_allclose(sizes, heart.volumes, rtol=1e-9)


def test_gmsh(export, heart):
    path = export("heart.msh", "gmsh")
    mesh = read_mesh(path)
    assert_same(mesh, heart, 0.0)
    assert set(mesh.groups) == {"region 0", "region 1", "lv_endo", "rv_endo", "epi", "base"}
    content = path.read_bytes()
    bare = path.with_name("bare.msh")  # meshio cannot read its element data
    bare.write_bytes(content[: content.index(b"$ElementData")])
    cells = meshio.gmsh.read(bare).cells_dict
    np.testing.assert_array_equal(cells["tetra"], heart.tetrahedra)
    assert len(cells["triangle"]) == len(heart.boundary[0])


def test_opencarp(export, heart):
    out = export("carp", "opencarp")
    assert_same(read_mesh(out / "heart.pts"), heart, 1e-9)
    lines = (out / "heart.pts").read_text().split("\n")
    assert int(lines[0]) == len(heart.vertices)
    first = [float(word) for word in lines[1].split()]
    np.testing.assert_allclose(first, heart.vertices[0] * 1000, atol=1e-5)  # µm
    known = anatomies.tissue()
    for name, label in (("lv", LV), ("rv", RV)):
        rows = (out / f"heart_{name}_endo.surf").read_text().split("\n")[1:-1]
        found = np.sort([[int(word) for word in row.split()[1:]] for row in rows], axis=1)
        there = np.sort(known.having(label), axis=1)
        assert {*map(tuple, found)} == {*map(tuple, there)}


@pytest.mark.parametrize(
    ("name", "kind", "mesh"),
    [
        ("carp", "opencarp", "carp/heart.pts"),
        ("heart.msh", "gmsh", "heart.msh"),
        ("heart.vtu", "vtu", "heart.vtu"),  # without labels, which are then found by shape
    ],
)
def test_what_went_out_builds_the_same_heart(
    export, ventricles, heart, run, outside, name, kind, mesh
):
    export(name, kind)
    around = ["--torso", "none", "--electrodes", ventricles / "electrodes.csv"]
    ended = run("heart", "build", outside / mesh, *around, "--out", outside / "again")
    assert ended.status == 0, ended
    again = load_heart(outside / "again")
    np.testing.assert_array_equal(again.tetrahedra, heart.tetrahedra)
    np.testing.assert_allclose(again.vertices, heart.vertices, rtol=0, atol=1e-9)
    np.testing.assert_allclose(again.fibres, heart.fibres, atol=1e-12)
    np.testing.assert_allclose(again.sheets, heart.sheets, atol=1e-12)
    np.testing.assert_array_equal(again.electrodes, heart.electrodes)
    for side in ("lv", "rv"):
        assert getattr(again, side).area == pytest.approx(getattr(heart, side).area, rel=1e-6)
    np.testing.assert_array_equal(again.regions, heart.regions)
