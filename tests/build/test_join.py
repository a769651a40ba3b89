"""A heart taken apart by its labels, degraded in known ways, and joined again."""

import igl
import numpy as np
import pytest
from shapes import read_labelled_surface, volume_of

from fascicle.build.join import JoinedPart, join_surfaces, label_map_beside_lv
from fascicle.build.segmentation import SegmentationLabels
from fascicle.build.segmentation_surface import surface_from_segmentation
from fascicle.build.surface_checks import volumes, wall_thickness
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label
from fascicle.mesh.measures import closed_by_fan, triangle_areas
from fascicle.mesh.mesh_file import TRIANGLE
from fascicle.mesh.meshing import remeshed_triangles
from fascicle.mesh.read import read_mesh
from fascicle.mesh.topology import directed_edges, unique_edges, without_unused_vertices

LV, RV, EPI, BASE = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.EPICARDIUM, Label.BASE)


@pytest.fixture(scope="module")
def geo1(data_folder):
    """The statistical mean heart."""
    return read_labelled_surface(data_folder / "hearts" / "cobiveco-geo1" / "heart.vtp")


@pytest.fixture(scope="module")
def parts(geo1):
    """Its parts, by label."""
    return {
        label: without_unused_vertices(geo1.vertices, geo1.having(label))
        for label in (LV, RV, EPI, BASE)
    }


@pytest.fixture(scope="module")
def coarse(parts):
    """The parts, each remeshed at its own resolution."""
    result = {}
    for label, edge in ((EPI, 5.0), (LV, 3.0), (RV, 4.0), (BASE, 2.5)):
        sizes = {"hmax": 1.3 * edge, "hmin": 0.6 * edge, "hausd": 0.15}
        same = np.zeros(len(parts[label][1]), dtype=int)
        result[label] = remeshed_triangles(*parts[label], same, **sizes)[:2]
    return result


def joined(parts, base=True):
    given = {LV: "lv", RV: "rv", EPI: "epicardium"} | ({BASE: "base"} if base else {})
    return join_surfaces(
        {part: JoinedPart(f"{part}.stl", *parts[label]) for label, part in given.items()}
    )


def jittered(parts, size):
    """Rims moved at random by up to `size` mm along each axis."""
    rng = np.random.default_rng(5)
    result = {}
    for label, (vertices, triangles) in parts.items():
        rims = np.concatenate(igl.boundary_loop_all(triangles))
        moved = vertices.copy()
        moved[rims] += rng.uniform(-size, size, (len(rims), 3))
        result[label] = moved, triangles
    return result


def area(surface, label):
    return triangle_areas(surface.vertices, surface.having(label)).sum()


def assert_heart(surface, geo1, tolerance):
    """Closed, one piece, outwards, each label with its rims, volume and areas as they were."""
    vertices, triangles = surface.vertices, surface.triangles
    assert len(np.unique(directed_edges(triangles), axis=0)) == 3 * len(triangles)
    assert (unique_edges(triangles)[1] == 2).all()
    assert np.max(igl.bfs_orient(triangles)[1]) == 0
    assert len(vertices) - len(triangles) // 2 == 2  # Euler characteristic of a sphere
    assert volume_of(surface) == pytest.approx(volume_of(geo1), rel=tolerance)
    for label, rims in ((LV, 1), (RV, 1), (EPI, 1), (BASE, 3)):
        assert len(igl.boundary_loop_all(surface.having(label))) == rims
        if label != BASE:
            assert area(surface, label) == pytest.approx(area(geo1, label), rel=0.01)


def test_parts_that_weld_do_not_move(parts, geo1):
    surface = joined(parts)
    assert_heart(surface, geo1, 1e-9)
    assert sorted(map(tuple, surface.vertices)) == sorted(map(tuple, geo1.vertices))
    assert np.bincount(surface.labels).tolist() == np.bincount(geo1.labels).tolist()


@pytest.mark.parametrize("base", [True, False])
def test_jittered_rims_of_different_resolution(coarse, geo1, base):
    assert_heart(joined(jittered(coarse, 0.5), base), geo1, 0.02)


def test_made_base_keeps_the_parts(parts, geo1):
    surface = joined(parts, base=False)
    assert_heart(surface, geo1, 0.01)
    given = np.vstack([parts[label][0] for label in (LV, RV, EPI)])
    kept = set(map(tuple, surface.vertices))
    assert all(tuple(point) in kept for point in given)
    assert area(surface, BASE) == pytest.approx(1400, rel=0.1)


def test_gap_is_named_measured_and_placed(coarse):
    away = coarse[BASE][0] + np.array([0, 0, 4.0]), coarse[BASE][1]
    words = r"base\.stl .* that of epicardium\.stl .* are up to [34]\.\d mm apart \(at \(-?\d.* mm"
    with pytest.raises(InputError, match=f"^.*{words}.*$"):
        joined({**coarse, BASE: away})


def test_blood_beside_the_lv_becomes_a_label_map_that_gets_a_wall(parts, data_folder):
    """The RV's blood lies 1.4 mm from the epicardium, which is the LV's alone."""
    given = {}
    for part, name in (("lv", "lv_endo"), ("epicardium", "lv_epi"), ("rv", "rv")):
        mesh = read_mesh(data_folder / "cases" / f"nowall_{name}.stl")
        given[part] = JoinedPart(str(mesh.path), mesh.points, mesh.require(TRIANGLE, "triangles"))
    label_map, notes = label_map_beside_lv(given), []
    numbers = SegmentationLabels()
    surface, _ = surface_from_segmentation(label_map, numbers, notes=notes, edge_length=3.0)
    assert "100% of the RV blood borders on no tissue, so an RV wall of 4.5" in str(notes)
    assert np.median(wall_thickness(surface).rv) == pytest.approx(4.5, abs=0.2)
    # the file's RV crosses itself where its sides meet
    for side, volume, off in (("lv", volumes(surface).lv, 0.02), ("rv", volumes(surface).rv, 0.06)):
        exact = abs(closed_by_fan(*given[side][1:3])[0]) / 1e3
        assert volume == pytest.approx(exact, rel=off)
    named = zip(("lv", "rv", "epicardium"), (LV, RV, EPI), strict=True)
    assert label_map_beside_lv({k: JoinedPart(k, *parts[label]) for k, label in named}) is None
