"""Surfaces much coarser than the wanted edge: smooth finer ones that keep volume and labels."""

import igl
import numpy as np
import pytest

from fascicle.build.meshing import subdivided
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.heart.labelled_surface import NEEDED_LABELS, LabelledSurface
from fascicle.mesh.measures import (
    mean_edge_length,
    quality,
    self_intersections,
    signed_volumes,
    triangle_areas,
)
from tests.anatomies import write_surface
from tests.build.shapes import biventricular_surface, volume_of

POINTS = 257
EDGE = 4.0  # mm
SCALE = 1.3


@pytest.fixture(scope="module")
def fine():
    surface = biventricular_surface(3.0)
    outwards = surface.triangles[:, ::-1]
    return LabelledSurface(SCALE * surface.vertices, outwards, surface.labels, "fine")


@pytest.fixture(scope="module")
def coarse(fine):
    """The same ventricles with 257 points, as programs that simulate ECGs ship them."""
    vertices, triangles, born, _ = igl.qslim(fine.vertices, fine.triangles, 2 * POINTS - 4, True)
    made = LabelledSurface(
        np.asarray(vertices), np.asarray(triangles, np.int64), fine.labels[born], "coarse"
    )
    assert len(made.vertices) == POINTS
    return made


def distances(fine, surface):
    """From the true surface's vertices (mm), but for those within 8 mm of its sharp rim."""
    deep = fine.vertices[fine.vertices[:, 2] < fine.vertices[:, 2].max() - 8.0]
    return np.sqrt(igl.point_mesh_squared_distance(deep, surface.vertices, surface.triangles)[0])


def test_smooth_and_of_the_same_volume(fine, coarse):
    finer, note = subdivided(coarse, EDGE)
    assert mean_edge_length(finer.vertices, finer.triangles) <= 1.1 * 2 * EDGE
    assert volume_of(finer) == pytest.approx(volume_of(coarse), rel=1e-4)
    assert not len(self_intersections(finer.vertices, finer.triangles))
    assert "subdivided 2 times (Loop)" in note
    # plain Loop subdivision, which this corrects, comes to lie 0.9 mm inside
    loop = igl.loop(coarse.vertices, coarse.triangles, 2)
    plain = LabelledSurface(*loop, np.repeat(coarse.labels, 16))
    assert volume_of(plain) < 0.98 * volume_of(coarse)
    assert distances(fine, finer).mean() < 0.7 * distances(fine, plain).mean()
    assert distances(fine, finer).mean() < distances(fine, coarse).mean()


def test_each_part_keeps_its_label_and_nearly_its_area(coarse):
    finer, _ = subdivided(coarse, EDGE)
    areas = [
        [triangle_areas(s.vertices, s.having(label)).sum() for label in NEEDED_LABELS]
        for s in (coarse, finer)
    ]
    assert np.allclose(*areas, rtol=0.1)
    middle = coarse.vertices[coarse.triangles].mean(axis=1)
    nearest = igl.point_mesh_squared_distance(middle, finer.vertices, finer.triangles)[1]
    assert (finer.labels[nearest] == coarse.labels).mean() > 0.97


@pytest.mark.parametrize("labelled", [True, False])
def test_it_becomes_a_mesh_with_a_note(tmp_path, coarse, labelled):
    arrays = {"class": coarse.labels} if labelled else {}
    path = write_surface(tmp_path / "h.vtp", coarse.vertices, coarse.triangles, **arrays)
    anatomy = read_anatomy(Source(path), EDGE)
    assert "subdivided 2 times (Loop)" in anatomy.notes[0]
    mesh = anatomy.mesh
    volume = signed_volumes(mesh.vertices, mesh.tetrahedra).sum()
    assert volume == pytest.approx(volume_of(coarse), rel=0.01)
    assert quality(mesh.vertices, mesh.tetrahedra).angles.min() > 8.0
    assert set(mesh.labels) == set(NEEDED_LABELS)
