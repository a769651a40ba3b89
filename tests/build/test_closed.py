"""Defects of a surface are repaired, or refused with their position."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from shapes import LV_WALL, RV_WALL, biventricular_surface, volume_of

from fascicle.build.endocardia import cleaned_labels, labels_from_points
from fascicle.build.surface_checks import check_edge_length, wall_thickness
from fascicle.build.surface_repair import prepared_surface
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledSurface
from fascicle.mesh.measures import self_intersections, triangle_areas
from fascicle.mesh.topology import boundary_loops, unique_edges

EDGE = 4.0  # mm
APEX = np.array([0.0, 0.0, -72.0])


@cache
def ventricles() -> LabelledSurface:
    return prepared_surface(biventricular_surface(EDGE))


def without(surface: LabelledSurface, gone: np.ndarray) -> LabelledSurface:
    return replace(surface, triangles=surface.triangles[~gone], labels=surface.labels[~gone])


def around_apex(surface: LabelledSurface, radius: float) -> np.ndarray:
    middle = surface.vertices[surface.triangles].mean(axis=1)
    outer = surface.labels == Label.EPICARDIUM
    return outer & (np.linalg.norm(middle - APEX, axis=1) < radius)


def test_an_edge_length_is_too_coarse_for_the_right_wall_by_its_thickness():
    walls = wall_thickness(ventricles())
    thickness = list(map(np.median, walls))
    assert thickness == pytest.approx([LV_WALL, LV_WALL, RV_WALL], rel=0.07)
    check_edge_length(walls, 3.4, "heart.vtp")
    with pytest.raises(InputError, match=r"3\.6 mm is too coarse for the right .* 4\.\d mm thick"):
        check_edge_length(walls, 3.6, "heart.vtp")


def test_flipped_repeated_and_unwelded_triangles_are_repaired():
    surface = ventricles()
    soup = surface.vertices[surface.triangles].reshape(-1, 3)
    triangles = np.arange(len(soup)).reshape(-1, 3)
    flipped = np.random.default_rng(1).random(len(triangles)) < 0.3
    triangles[flipped] = triangles[flipped][:, ::-1]
    triangles = np.concatenate([triangles, triangles[:50]])
    labels = np.concatenate([surface.labels, surface.labels[:50]])
    repaired = prepared_surface(LabelledSurface(soup, triangles, labels))
    assert len(repaired.vertices) == len(surface.vertices)
    assert len(repaired.triangles) == len(surface.triangles)
    assert volume_of(repaired) == pytest.approx(volume_of(surface), rel=1e-9)


def test_a_small_hole_is_closed_and_a_large_one_refused_with_its_place():
    surface = ventricles()
    open_one = without(surface, around_apex(surface, 1.8))
    assert len(open_one.triangles) < len(surface.triangles)
    repaired = prepared_surface(open_one)
    assert volume_of(repaired) == pytest.approx(volume_of(surface), rel=1e-3)
    assert boundary_loops(repaired.triangles) == []
    with pytest.raises(InputError, match=r"not closed: 1 of 1 holes .* \(.*, .*, -6\d\.\d\) mm"):
        prepared_surface(without(surface, around_apex(surface, 15)))


def moved(surface: LabelledSurface, step: float, along: int) -> LabelledSurface:
    """With one vertex of the epicardium, at the left, moved by so much (mm) along an axis."""
    outer = np.unique(surface.having(Label.EPICARDIUM))
    vertices = surface.vertices.copy()
    at = outer[np.argmin(np.linalg.norm(vertices[outer] - [-32.0, 0, -10], axis=1))]
    vertices[at, along] += step
    return replace(surface, vertices=vertices)


def test_a_surface_that_cuts_itself_is_drawn_around_its_inside():
    broken = moved(moved(ventricles(), 9.0, along=2), 2.0, along=0)
    assert len(self_intersections(broken.vertices, broken.triangles)) > 0
    repaired, again = prepared_surface(broken), prepared_surface(broken)
    assert len(self_intersections(repaired.vertices, repaired.triangles)) == 0
    np.testing.assert_array_equal(again.vertices, repaired.vertices)
    assert volume_of(repaired) == pytest.approx(volume_of(broken), rel=0.02)
    for label in ENDOCARDIA:
        assert len(boundary_loops(repaired.having(label))) == 1
        before, after = (
            triangle_areas(surface.vertices, surface.having(label)).sum()
            for surface in (broken, repaired)
        )
        assert after == pytest.approx(before, rel=0.05)
    spiked = moved(ventricles(), 14.0, along=0)  # through the wall into the left cavity
    with pytest.raises(InputError, match=r"repair failed: there would be a hole .*there$"):
        prepared_surface(spiked)


def test_small_components_and_spurs_are_cleaned():
    surface = ventricles()
    middle = surface.vertices[surface.triangles].mean(axis=1)
    labels = surface.labels.copy()
    inside = np.flatnonzero(labels == Label.LV_ENDOCARDIUM)
    deepest = inside[np.argsort(middle[inside, 2])[:5]]
    labels[deepest] = Label.RV_ENDOCARDIUM
    outside = np.flatnonzero(labels == Label.EPICARDIUM)
    labels[outside[np.argsort(middle[outside, 2])[:5]]] = Label.BASE
    assert (labels != surface.labels).sum() == 10
    cleaned = cleaned_labels(surface.vertices, surface.triangles, labels)
    assert (cleaned[labels != surface.labels] == surface.labels[labels != surface.labels]).all()
    # of the rest only spurs at the base change
    changed = cleaned != surface.labels
    assert changed.sum() < 15
    assert (cleaned[changed] == Label.BASE).all()


@pytest.mark.parametrize("rim_is_base", [True, False])
def test_labels_of_points_give_clean_borders(rim_is_base):
    surface = ventricles()
    basal = surface.labels == Label.BASE
    at_points = np.zeros(len(surface.vertices), dtype=np.int64)
    first, last = (~basal, basal) if rim_is_base else (basal, ~basal)
    for rows in (first, last):
        at_points[surface.triangles[rows]] = surface.labels[rows][:, None]
    labels = labels_from_points(surface.vertices, surface.triangles, at_points)
    assert (labels != surface.labels).mean() < 0.02
    for label in ENDOCARDIA:
        assert len(boundary_loops(surface.triangles[labels == label])) == 1


def grown(surface: LabelledSurface, at: str) -> tuple[LabelledSurface, int]:
    """The surface with small tetrahedra outside or inside it, and the vertices that they share.

    One stands on an ``"edge"`` of the epicardium, three on ``"vertices"``, or one lies free in the
    tissue (``"void"``).
    """
    outer = surface.having(Label.EPICARDIUM)
    far = outer[np.abs(surface.vertices[outer][:, :, 2] + 35).max(axis=1) < 12]
    vertices, triangles = [surface.vertices], [surface.triangles]
    shared = {"vertices": 1, "edge": 2, "void": 0}[at]
    chosen = far[:: len(far) // 3][: 3 if at == "vertices" else 1]
    for corners in chosen:
        a, b, c = surface.vertices[corners]
        out = np.cross(b - a, c - a)
        out *= (-2.0 if at == "void" else 2.0) / np.linalg.norm(out)
        start = sum(map(len, vertices))
        tip = a + out + [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        vertices.append(tip[: 4 - shared])
        tetrahedron = np.array([*corners[:shared], *range(start, start + 4 - shared)])
        triangles.append(tetrahedron[[(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]])
    added = sum(map(len, triangles[1:]))
    labels = np.append(surface.labels, np.full(added, Label.EPICARDIUM))
    new = LabelledSurface(np.concatenate(vertices), np.concatenate(triangles), labels)
    return new, shared * len(chosen)


@pytest.mark.parametrize("at", ["vertices", "edge", "void"])
def test_crumbs_and_voids_are_left_out_and_said(at):
    sound = ventricles()
    given, shared = grown(sound, at)
    found = prepared_surface(given)
    before, after = (each.vertices[each.triangles] for each in (sound, found))
    # a vertex that was shared goes a tenth of the way to its neighbours
    step = np.linalg.norm(after - before, axis=2)
    assert len(np.unique(before[step > 0], axis=0)) == shared
    assert step.max() < 0.1 * EDGE
    pieces = 3 if at == "vertices" else 1
    assert f"left out: {pieces} (" in found.notes[-1]
    assert f"with {4 * pieces} of {len(given.triangles)} triangles" in found.notes[-1]
    assert len(found.notes) == 1 + (shared > 0)


@pytest.mark.parametrize("corners", [1, 2])
def test_sheets_that_touch_in_vertices_or_edges_are_moved_apart(corners):
    """The left side of the septum meets the right one in a vertex or an edge."""
    sound = ventricles()
    left, right = (np.unique(sound.having(label)) for label in ENDOCARDIA)
    start = left[np.argmin(np.linalg.norm(sound.vertices[left] - [22.0, 0, -25], axis=1))]
    ring = np.unique(sound.triangles[(sound.triangles == start).any(axis=1)])
    chosen = [start, *np.setdiff1d(ring, start)[: corners - 1]]
    into = np.arange(len(sound.vertices))
    vertices = sound.vertices.copy()
    edges, _ = unique_edges(sound.having(Label.RV_ENDOCARDIUM))
    partners = _path(edges, right, sound.vertices, sound.vertices[chosen])
    vertices[chosen] = (vertices[chosen] + vertices[partners]) / 2
    into[partners] = chosen
    given = replace(sound, vertices=vertices, triangles=into[sound.triangles])
    found = prepared_surface(given)
    assert len(found.vertices) == len(sound.vertices)
    assert np.bincount(found.labels).tolist() == np.bincount(sound.labels).tolist()
    assert len(self_intersections(found.vertices, found.triangles)) == 0
    assert volume_of(found) == pytest.approx(volume_of(sound), rel=0.02)
    assert f"doubled and moved apart: {corners} of {len(sound.vertices) - corners}" in str(
        found.notes
    )


def test_a_sheet_that_ends_on_the_surface_is_left_out():
    """Two triangles stand on two edges of the left endocardium, as a papillary muscle's skin."""
    sound = ventricles()
    first, middle, last = sound.having(Label.LV_ENDOCARDIUM)[40][[0, 1, 2]]
    tip = sound.vertices[middle] + [0.0, 0.0, 5.0]
    fin = [[first, middle, len(sound.vertices)], [middle, last, len(sound.vertices)]]
    given = replace(
        sound,
        vertices=np.vstack([sound.vertices, tip]),
        triangles=np.vstack([sound.triangles, fin]),
        labels=np.append(sound.labels, [Label.LV_ENDOCARDIUM] * 2),
    )
    found = prepared_surface(given)
    assert volume_of(found) == pytest.approx(volume_of(sound), rel=1e-9)
    assert "sheets that ended on it were left out: 1 (first: " in found.notes[0]
    assert f"with 2 of {len(given.triangles)} triangles" in found.notes[0]


def _path(edges, right, positions, wanted):
    """Vertices of the right endocardium opposite to some of the left one, linked as these are."""
    first = right[np.argmin(np.linalg.norm(positions[right] - wanted[0], axis=1))]
    around = np.setdiff1d(edges[(edges == first).any(axis=1)], first)
    path = [first]
    for point in wanted[1:]:
        free = np.setdiff1d(around, path)
        path.append(free[np.argmin(np.linalg.norm(positions[free] - point, axis=1))])
    return path
