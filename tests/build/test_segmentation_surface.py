"""Surfaces of segmented ellipsoids: where they should be, of the right volume, with sharp borders.

Volumes are compared with the label map's and positions with the exact ellipsoids'.
"""

from dataclasses import replace

import igl
import numpy as np
import pytest
from phantoms import (
    BASE,
    LABELS,
    LV_OUTER,
    OBLIQUE,
    SCAR_CENTRE,
    counted,
    ellipsoid_segmentation,
    exact_distance,
    exact_volumes,
    labels_at,
)
from scipy.ndimage import binary_dilation
from shapes import ellipsoid

from fascicle.build.segmentation import Segmentation, SegmentationLabels, regions_at
from fascicle.build.segmentation_files import read_segmentation
from fascicle.build.segmentation_surface import surface_from_segmentation
from fascicle.build.surface_checks import check_edge_length, compared, volumes, wall_thickness
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label
from fascicle.mesh.topology import boundary_loops, unique_edges

MAPS = {
    "isotropic, oblique": ((1.5, 1.5, 1.5), {"slices": OBLIQUE}),
    "thick slices": ((1.5, 1.5, 10.0), {}),
}
SIDES = {"lv": Label.LV_ENDOCARDIUM, "rv": Label.RV_ENDOCARDIUM, "epi": Label.EPICARDIUM}


@pytest.fixture(scope="module", params=MAPS)
def extracted(request):
    """A phantom's map, its surface, and the surface's vertices in the heart's frame."""
    spacing, how = MAPS[request.param]
    phantom = ellipsoid_segmentation(spacing, **how)
    surface, _ = surface_from_segmentation(phantom.segmentation, LABELS)
    return phantom, surface, phantom.to_heart(surface.vertices)


def volume(vertices, triangles):
    """Volume (ml) between triangles and the plane z = BASE, which closes them."""
    a, b, c = (vertices[triangles[:, k]] - [0, 0, BASE] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6 / 1000


def euler(triangles):
    return len(np.unique(triangles)) - len(unique_edges(triangles)[0]) + len(triangles)


def check_topology(surface):
    assert len(boundary_loops(surface.triangles)) == 0
    assert igl.is_edge_manifold(surface.triangles)[0]
    assert euler(surface.triangles) == 2
    for label, n_loops in ((Label.BASE, 3), *((side, 1) for side in SIDES.values())):
        assert len(boundary_loops(surface.having(label))) == n_loops
        assert euler(surface.having(label)) == 2 - n_loops


def test_volumes_are_the_label_maps_and_the_exact_ones(extracted):
    phantom, surface, vertices = extracted
    check_topology(surface)
    found = {
        "lv": -volume(vertices, surface.having(Label.LV_ENDOCARDIUM)),
        "rv": -volume(vertices, surface.having(Label.RV_ENDOCARDIUM)),
        "myocardium": volume(vertices, surface.triangles),
    }
    of_map = counted(phantom.segmentation.labels, phantom.segmentation.voxel_volume)
    exact = exact_volumes()
    for part, ml in found.items():
        assert ml == pytest.approx(of_map[part], rel=0.01)
        assert ml == pytest.approx(exact[part], rel=0.03)


def test_surfaces_are_smooth_and_in_place(extracted):
    """Within 0.3 voxels of the exact surface, where a staircase would be off by 0.3 to 0.5.

    A staircase's normals are off by 30 to 50 degrees on average.
    """
    phantom, surface, vertices = extracted
    for side, label in SIDES.items():
        own = vertices[np.unique(surface.having(label))]
        distance = exact_distance(own, side)
        assert np.sqrt(np.mean(distance**2)) < 0.3 * phantom.segmentation.spacing.min()
        assert abs(distance.mean()) < (0.15 if phantom.segmentation.spacing.max() > 8 else 0.05)
    own = surface.having(Label.LV_ENDOCARDIUM)
    a, b, c = (vertices[own[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    middle = (a + b + c) / 3
    step = 1e-4 * np.eye(3)
    exact = np.stack(
        [exact_distance(middle + e, "lv") - exact_distance(middle - e, "lv") for e in step]
    )
    cosine = -np.einsum("im,mi->m", exact, normals) / (area * np.linalg.norm(exact, axis=0))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.average(angle, weights=area) < 8


def test_base_is_flat_and_at_the_base(extracted):
    phantom, surface, vertices = extracted
    base = vertices[np.unique(surface.having(Label.BASE))]
    assert np.abs(base[:, 2] - BASE).max() < 0.1
    a, b, c = (surface.vertices[surface.having(Label.BASE)[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a) @ phantom.turn
    assert (normals[:, 2] > 0.999 * np.linalg.norm(normals, axis=1)).all()
    below = np.setdiff1d(np.arange(len(vertices)), np.unique(surface.having(Label.BASE)))
    assert vertices[below, 2].max() < BASE


def test_without_rv_wall_one_is_added():
    """In maps of LV muscle alone, the wall is 3 mm thick, and nothing else changes."""

    def lv_muscle_alone(points):
        labels = labels_at(points)
        labels[(labels >= 3) & (ellipsoid(points, LV_OUTER) > 0)] = 0
        return labels

    phantom = ellipsoid_segmentation((1.25, 1.25, 8.0), labels=lv_muscle_alone)
    notes = []
    surface, _ = surface_from_segmentation(phantom.segmentation, LABELS, notes=notes)
    check_topology(surface)
    assert notes[0].startswith("map: 66% of the RV blood borders on no tissue, so an RV wall of 3 ")
    vertices = phantom.to_heart(surface.vertices)
    free = vertices[np.unique(surface.having(Label.EPICARDIUM))]
    free = free[(free[:, 0] > 48) & (free[:, 2] > -15)]
    assert len(free) > 100
    thickness = exact_distance(free, "rv")
    assert np.median(thickness) == pytest.approx(3.0, abs=0.1)


def with_atria(points):
    """Blood goes on above an uneven rim of tissue, as in maps of the whole heart."""
    labels = labels_at(points, base=40.0)
    rim = BASE + 3 * np.sin(np.arctan2(points[..., 1], points[..., 0]))
    labels[(points[..., 2] > rim) & (labels >= 3)] = 0
    labels[(labels == 1) & (points[..., 2] > 18 + 0.3 * points[..., 0])] = 6
    labels[(labels == 2) & (points[..., 2] > 28)] = 7
    return labels


def closed_over(points):
    """Tissue closes over both cavities at the base."""
    labels = labels_at(points, base=22.0)
    labels[(points[..., 2] > BASE) & (labels > 0)] = 3
    return labels


@pytest.mark.parametrize(
    ("labels", "lowest", "how"),
    [(with_atria, 4, "the highest complete ring"), (closed_over, 8, "tissue closes over")],
)
def test_maps_that_are_not_cut_are_cut_below_the_rim(labels, lowest, how):
    phantom = ellipsoid_segmentation((1.5, 1.5, 1.5), slices=OBLIQUE, labels=labels)
    notes = []
    surface, _ = surface_from_segmentation(phantom.segmentation, LABELS, notes=notes)
    check_topology(surface)
    assert how in notes[0]
    base = phantom.to_heart(surface.vertices[np.unique(surface.having(Label.BASE))])
    assert base[:, 2].min() > lowest
    assert base[:, 2].max() < BASE + 0.5


def with_open_ring(labels, x, y):
    """The LV's wall is missing over part of the circumference, as below the aortic valve."""
    return np.where((labels == 3) & (x < 0) & (y > -10), 0, labels)


@pytest.mark.parametrize(
    ("change", "upside_down"),
    [
        (lambda labels, *_: np.where(labels == 1, 3, labels), False),
        (lambda labels, *_: np.where(labels == 2, 0, labels), False),
        (with_open_ring, True),
    ],
    ids=["LV closed over", "no RV blood", "open ring, upside down"],
)
def test_thick_slices_are_cut_at_the_end_of_one(change, upside_down):
    """Where the basal slice does not open both cavities in a wall, that below it does."""

    def in_slices(points):
        labels = labels_at(points)
        top = (points[..., 2] > BASE - 10) & (points[..., 2] < BASE)
        return np.where(top, change(labels, points[..., 0], points[..., 1]), labels)

    phantom = ellipsoid_segmentation((2.0, 2.0, 10.0), labels=in_slices)
    labels, affine = phantom.segmentation.labels, phantom.segmentation.affine.copy()
    if upside_down:  # the first slice is the basal one
        affine[:3, 3] += (labels.shape[2] - 1) * affine[:3, 2]
        labels, affine[:3, 2] = labels[:, :, ::-1], -affine[:3, 2]
    notes = []
    surface, given = surface_from_segmentation(
        Segmentation(labels, affine, "map"), LABELS, notes=notes
    )
    check_topology(surface)
    vertices = phantom.to_heart(surface.vertices)
    base = vertices[np.unique(surface.having(Label.BASE))]
    np.testing.assert_allclose(base[:, 2], BASE - 10, atol=0.01)
    above = labels[:, :, 1 if upside_down else -2]  # the slice that was changed
    assert set(np.unique(above)) > {0}
    for side, number, ml in (("LV", 1, given.lv), ("RV", 2, given.rv)):
        left_out = (above == number).sum() * 0.04
        assert f"{left_out:.1f} ml of {side} blood" in notes[-1]
        built = -volume(vertices + np.array([0, 0, 10]), surface.having(SIDES[side.lower()]))
        assert built == pytest.approx(ml - left_out, rel=0.01)
    _, warnings = compared(volumes(surface), given, "map")
    assert ["RV cavity" in warning for warning in warnings].count(True) == 1 - (left_out == 0)


def test_short_axis_map_of_a_real_shape(data_folder):
    """A map without an RV wall, whose slices are 10 mm apart; the wall added fits the mesh."""
    given = read_segmentation(data_folder / "cases" / "c22_acdc10.nii.gz")
    surface, wanted = surface_from_segmentation(
        given, SegmentationLabels(lv=3, rv=1, myocardium=2), edge_length=3.0
    )
    _, warnings = compared(volumes(surface), wanted, "map")
    assert warnings == ()
    for number, ml in ((3, volumes(surface).lv), (1, volumes(surface).rv)):
        of_map = (given.labels == number).sum() * given.voxel_volume / 1e3
        assert ml == pytest.approx(of_map, rel=0.01)
    check_edge_length(wall_thickness(surface), 3.0, "map")
    base = surface.vertices[np.unique(surface.having(Label.BASE))]
    assert np.ptp(base[:, 2]) < 0.01  # along the normal of the slices


def test_papillary_muscle_across_the_cavity_is_given_to_the_blood():
    def with_strand(points):
        labels = labels_at(points)
        strand = np.hypot(points[..., 1], points[..., 2] + 15) < 3
        labels[(labels == 1) & strand] = 3
        return labels

    phantom = ellipsoid_segmentation((1.5, 1.5, 1.5), slices=OBLIQUE, labels=with_strand)
    notes = []
    surface, _ = surface_from_segmentation(phantom.segmentation, LABELS, notes=notes)
    check_topology(surface)
    assert any("lv endocardium: gaps up to" in note for note in notes)


def test_incomplete_maps_are_refused_and_small_components_dropped():
    phantom = ellipsoid_segmentation((3.0, 3.0, 3.0))
    plain = phantom.segmentation

    def refused(labels, words):
        with pytest.raises(InputError, match=words):
            surface_from_segmentation(Segmentation(labels, plain.affine, "map"), LABELS)

    # labels are exchanged in a map without an RV wall, as ACDC's are
    without_wall = plain.labels.copy()
    far = ~binary_dilation(without_wall == 1, iterations=4)
    without_wall[(without_wall >= 3) & far] = 0
    words = r"% of the LV blood's surface borders on no tissue, .*labels"
    refused(np.array([0, 2, 1, 3, 4])[without_wall], words)
    without_apex = plain.labels.copy()
    without_apex[:, :, :14] = 0
    words = r"ends at the apex in an opening of [\d.]+ cm² .*add the missing slices"
    refused(without_apex, words)
    thick = ellipsoid_segmentation((2.0, 2.0, 16.0)).segmentation
    with pytest.raises(InputError, match="up to 16 mm long; give a map with slices at most 15 mm"):
        surface_from_segmentation(thick, LABELS)
    crumb, notes = plain.labels.copy(), []
    crumb[1:3, 1:3, 1:3] = 3
    made = Segmentation(crumb, plain.affine, "map")
    surface, _ = surface_from_segmentation(made, LABELS, notes=notes)
    assert notes[0].startswith("map: 1 small components of tissue (0.22 ml in all)")
    assert phantom.to_heart(surface.vertices).min(axis=0)[0] > -LV_OUTER[0] - 1.5


def test_scar_is_where_it_was_segmented():
    """Points spread evenly over the tissue, as centroids of tetrahedra are."""
    phantom = ellipsoid_segmentation((1.5, 1.5, 1.5), slices=OBLIQUE)
    low, high = np.array([-40.0, -15.0, -25.0]), np.array([-15.0, 15.0, 5.0])
    points = np.random.default_rng(0).uniform(low, high, (100_000, 3))
    ml = np.prod(high - low) / 1000 / len(points)
    points = points[np.isin(labels_at(points), (3, 4))]
    tagged = regions_at(phantom.segmentation, LABELS, points @ phantom.turn.T + phantom.centre)
    exact = labels_at(points) == 4
    of_map = counted(phantom.segmentation.labels, phantom.segmentation.voxel_volume)["scar"]
    assert tagged.sum() * ml == pytest.approx(of_map, rel=0.03)
    assert tagged.sum() == pytest.approx(exact.sum(), rel=0.05)
    off = points[tagged == 1].mean(axis=0) - points[exact].mean(axis=0)
    assert np.abs(off).max() < 0.3


def test_outside_the_map_there_is_no_scar():
    phantom = ellipsoid_segmentation((3.0, 3.0, 3.0))
    scar = SCAR_CENTRE @ phantom.turn.T + phantom.centre
    points = np.array([scar, scar + 500, scar - 500])
    assert regions_at(phantom.segmentation, LABELS, points).tolist() == [1, 0, 0]


def test_a_hole_in_the_septum_is_refused_or_said(data_folder):
    """One of 30 mm is 707 mm²; of 6 x 6 mm a thin wall is made, and the notes say where."""
    cases = data_folder / "cases"
    with pytest.raises(InputError, match=r"blood touch over 710 mm² about \(32, 0, -10\)"):
        surface_from_segmentation(
            read_segmentation(cases / "septum_hole.nii.gz"), SegmentationLabels(), edge_length=3.0
        )
    # whole numbers times a factor, which nibabel reads as 3 and some 1e-5
    whole = read_segmentation(cases / "labels_rescaled.nii.gz")
    assert whole.labels.dtype.kind == "i"
    assert np.unique(whole.labels).tolist() == [0, 1, 2, 3]
    labels = whole.labels.copy()
    inside = np.round(np.linalg.inv(whole.affine) @ [32, 0, -10, 1]).astype(int)[:3]
    j, k = (slice(middle - 1, middle + 2) for middle in inside[1:])
    septum = labels[inside[0] - 8 : inside[0] + 8, j, k]
    septum[septum == 3] = 1
    notes = []
    surface_from_segmentation(
        replace(whole, labels=labels), SegmentationLabels(), notes=notes, edge_length=3.0
    )
    assert any("touch over 36 mm²" in note for note in notes)
