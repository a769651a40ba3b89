"""`fascicle heart import` on the small heart: what must work."""

import json

import numpy as np
import pytest
import pyvista as pv

from fascicle.heart.folder import load_heart

pytestmark = pytest.mark.usefixtures("blank_pictures")


def test_import(materials, outside, run):
    ended = run(*materials.command(outside / "heart"))
    assert ended.well
    assert "729 vertices, 3072 tetrahedra" in ended.out
    heart = load_heart(outside / "heart")
    np.testing.assert_allclose(np.abs(heart.fibres @ [0.6, 0, 0.8]), 1, atol=1e-4)
    assert heart.volumes.sum() == pytest.approx(60.0**3)
    assert np.ptp(heart.electrodes, axis=0).max() > 250
    # seeds that are found face the other ventricle, near the base
    for endocardium, sign in ((heart.lv, 1), (heart.rv, -1)):
        centre = 15.0 if sign == 1 else 45.0
        root, direction = (
            endocardium.vertices[k] for k in (endocardium.root, endocardium.direction)
        )
        assert sign * (root[0] - centre) > 8  # towards the other cup
        assert sign * (direction[0] - centre) > 5
        assert 45 < root[2] < 55  # the rim is at 55 mm, the apex at 10 mm
        assert direction[2] < root[2] - 10
    # what was written imports to an equal heart, as do electrodes in JSON, in any order and case
    table = [line.split(",") for line in materials.files["electrodes"].read_text().split()[1:]]
    content = {name.lower(): [float(x) for x in place] for name, *place in reversed(table)}
    (electrodes := materials.folder / "electrodes.json").write_text(json.dumps(content))
    first = outside / "heart"
    files = {"mesh": first / "mesh.vtu", "fibres": first / "mesh.vtu", "electrodes": electrodes}
    files |= {f"{side}-endocardium": first / f"{side}_endocardium.vtu" for side in ("lv", "rv")}
    assert run(*materials.command(outside / "second", **files)).status == 0
    assert load_heart(outside / "second").digest == heart.digest


def test_fibres_per_cell_and_in_another_order(materials, outside, run):
    rng = np.random.default_rng(0)
    order = rng.permutation(len(materials.tetrahedra))
    centre = materials.points[materials.tetrahedra].mean(axis=1)
    fibres = np.column_stack([np.ones(len(centre)), centre[:, 1] / 60, centre[:, 2] / 60])
    mesh = pv.UnstructuredGrid(
        {pv.CellType.TETRA: materials.tetrahedra[order]}, materials.points.astype(np.float32)
    )
    mesh.cell_data["lon"] = fibres[order]
    file = materials.save("per_cell.vtk", mesh)
    assert run(*materials.command(outside / "heart", fibres=file)).status == 0
    expected = fibres / np.linalg.norm(fibres, axis=1, keepdims=True)
    np.testing.assert_allclose(load_heart(outside / "heart").fibres, expected, atol=1e-12)


def test_fibres_per_point_in_another_order(materials, outside, run):
    rng = np.random.default_rng(1)
    order = rng.permutation(len(materials.points))
    fibres = np.zeros_like(materials.points)
    fibres[:, 0], fibres[:, 1] = 1, np.where(materials.points[:, 2] > 30, 1.5, 0)
    cloud = pv.PolyData(materials.points[order])
    cloud.point_data["fiber"] = fibres[order]
    cloud.point_data["something else"] = fibres[order]
    file = materials.save("cloud.vtp", cloud)
    assert run(*materials.command(outside / "heart", fibres=file)).status == 0
    heart = load_heart(outside / "heart")
    high = (heart.vertices[heart.tetrahedra][:, :, 2] > 30.1).all(axis=1)
    low = (heart.vertices[heart.tetrahedra][:, :, 2] < 29.9).all(axis=1)
    assert (np.abs(heart.fibres[low] @ [1, 0, 0]) > 1 - 1e-12).all()
    assert (np.abs(heart.fibres[high] @ np.array([1, 1.5, 0]) / np.sqrt(3.25)) > 1 - 1e-12).all()


def test_surface_with_mixed_up_orientation(materials, outside, run):
    points, triangles = materials.lv_surface
    mixed = triangles.copy()
    mixed[::3] = mixed[::3, ::-1]
    file = materials.save("mixed.vtp", materials.surface(points, mixed))
    assert run(*materials.command(outside / "heart", lv_endocardium=file)).status == 0
    lv = load_heart(outside / "heart").lv
    corners = lv.vertices[lv.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.array([15.0, 30.0, 0.0]) - corners.mean(axis=1)
    inward[:, 2] = 0
    assert (np.einsum("ij,ij->i", normals, inward) > 0).all()


def test_given_seeds_are_kept_and_nothing_of_an_import_before(materials, outside, run):
    out = outside / "heart"
    for root in (199, 200):
        seeds = ["--lv-root", root, "--lv-direction", 0, "--rv-root", 180, "--rv-direction", 5]
        assert run(*materials.command(out, *seeds)).status == 0
    heart = load_heart(out)
    assert (heart.lv.root, heart.lv.direction) == (200, 0)
    assert (heart.rv.root, heart.rv.direction) == (180, 5)
    assert sorted(p.name for p in outside.iterdir()) == ["heart"]


@pytest.mark.parametrize("name", ["Herz Größe ♥ 心臓", 'a"quote', "odd\x7f"])
def test_odd_names_and_paths(materials, outside, run, name):
    moved = outside / name
    moved.mkdir()
    files = {key: path.rename(moved / path.name) for key, path in materials.files.items()}
    for key, path in files.items():
        materials.files[key] = path
    out = outside / f"{name} out" / name
    assert run(*materials.command(out)).status == 0
    ended = run("heart", "check", out)
    assert ended.well
    assert load_heart(out).name == name
