"""Endocardia with one opening, two, or none."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista as pv
from shapes import in_mesh

from fascicle.build.endocardia import endocardia
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import oriented_into_cavity
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledMesh
from fascicle.mesh.measures import triangle_areas
from fascicle.mesh.topology import boundary_loops

SIZE = 16  # squares along the sides of a box


def box(openings: dict[str, list[tuple[int, int, int, int]]]) -> LabelledMesh:
    """Boundary of two flat boxes, whose tops have openings (rows and columns) labelled base."""
    vertices, triangles, labels = [], [], []
    cube = pv.Box((0, 1, 0, 1, 0, 1), level=SIZE - 1, quads=False).clean()
    points = np.asarray(cube.points, float)
    faces = np.asarray(cube.regular_faces, np.int64)[:, ::-1]  # inwards, as tissue lies around
    middle = points[faces].mean(axis=1)
    for place, (label, side) in enumerate(zip(ENDOCARDIA, ("lv", "rv"), strict=True)):
        given = np.full(len(faces), int(label))
        on_top = middle[:, 2] > 1 - 1e-9
        row, column = (np.floor(middle[:, k] * SIZE).astype(int) for k in (0, 1))
        for low, high, first, last in openings[side]:
            inside = (row >= low) & (row < high) & (column >= first) & (column < last)
            given[on_top & inside] = Label.BASE
        triangles.append(faces + sum(map(len, vertices)))
        vertices.append(40 * points + [60 * place, 0, 0])
        labels.append(given)
    tetrahedra = np.empty((0, 4), dtype=np.int64)
    return LabelledMesh(*map(np.concatenate, (vertices, [tetrahedra], triangles, labels)))


ONE = [(4, 12, 4, 12)]
TWO = [(2, 14, 2, 8), (5, 10, 10, 14)]


def test_the_smaller_of_two_openings_is_closed_and_marked():
    mesh = box({"lv": TWO, "rv": ONE})
    lv, rv = endocardia(mesh)
    assert not rv.valve.any()
    loops = boundary_loops(lv.triangles)
    assert [len(loop) for loop in loops] == [2 * (12 + 6)]
    assert lv.valve.sum() == 2 * (5 + 4) - 2  # a polygon of n sides has n - 2 triangles
    area = triangle_areas(lv.vertices, lv.triangles[lv.valve]).sum()
    assert area == pytest.approx(5 * 4 * (40 / SIZE) ** 2)
    assert (lv.vertices == mesh.vertices[in_mesh(mesh, lv)]).all()
    again = oriented_into_cavity(lv.vertices, lv.triangles, "lv")
    assert (again == lv.triangles).all()


def test_one_opening_is_left_as_it_is_and_an_island_of_another_label_is_none():
    mesh = box({"lv": ONE, "rv": ONE})
    at = np.flatnonzero(mesh.labels == Label.LV_ENDOCARDIUM)
    lowest = at[mesh.vertices[mesh.triangles[at]][..., 2].max(axis=1) < 1e-9]
    mesh.labels[lowest[100:103]] = Label.RV_ENDOCARDIUM
    for surface in endocardia(mesh):
        assert len(surface.triangles) == 12 * SIZE**2 - 2 * 8 * 8
        assert not surface.valve.any()


def test_a_closed_endocardium_and_a_missing_one_are_refused():
    with pytest.raises(InputError, match=r"LV endocardium: the surface is closed"):
        endocardia(box({"lv": [], "rv": ONE}))
    mesh = box({"lv": ONE, "rv": ONE})
    mesh.labels[mesh.labels == Label.RV_ENDOCARDIUM] = Label.EPICARDIUM
    with pytest.raises(InputError, match="RV endocardium: no triangle"):
        endocardia(mesh)
