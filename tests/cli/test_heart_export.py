"""`fascicle heart export` of a built heart, read back by `fascicle` and by others."""

from dataclasses import replace

import meshio
import numpy as np
import pytest
import pyvista as pv

from fascicle.heart.folder import load_heart, write_heart


@pytest.fixture(scope="module")
def folder(ventricles, tmp_path_factory):
    """Ventricles whose fibres are no rule's: their sheets, exchanged with them."""
    known = load_heart(ventricles)
    turned = replace(known, fibres=known.sheets, sheets=known.fibres)
    folder = tmp_path_factory.mktemp("turned") / "heart"
    write_heart(turned, folder)
    return folder


@pytest.fixture
def heart(folder):
    return load_heart(folder)


@pytest.fixture
def export(run, folder, outside):
    def call(name, kind):
        ended = run("heart", "export", folder, "--format", kind, "--out", outside / name)
        assert (ended.status, ended.err) == (0, "")
        assert ended.out == f"written to {outside / name}\n"
        return outside / name

    return call


def test_vtu(export, heart):
    other = pv.read(export("heart.vtu", "vtu"))
    assert other.n_cells == len(heart.tetrahedra)
    sizes = other.compute_cell_sizes(length=False, area=False)["Volume"]
    np.testing.assert_allclose(sizes, heart.volumes, rtol=1e-9)


def test_gmsh(export, heart):
    path = export("heart.msh", "gmsh")
    content = path.read_bytes()
    bare = path.with_name("bare.msh")  # meshio cannot read its element data
    bare.write_bytes(content[: content.index(b"$ElementData")])
    cells = meshio.gmsh.read(bare).cells_dict
    np.testing.assert_array_equal(cells["tetra"], heart.tetrahedra)
    assert len(cells["triangle"]) == len(heart.boundary[0])


@pytest.mark.parametrize(
    ("name", "kind", "mesh"),
    [
        ("carp", "opencarp", "carp/heart.pts"),
        ("heart.msh", "gmsh", "heart.msh"),
        ("heart.vtu", "vtu", "heart.vtu"),  # without labels, which are then found by shape
    ],
)
def test_what_went_out_builds_the_same_heart(export, folder, heart, run, outside, name, kind, mesh):
    export(name, kind)
    around = ["--torso", "none", "--electrodes", folder / "electrodes.csv"]
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
    assert 20 < heart.regions.sum() < len(heart.regions) / 2
