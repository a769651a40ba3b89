"""Whatever is wrong with a mesh: the message says how often, and where the first three are."""

from pathlib import Path

import numpy as np
import pytest
from builders import box

from fascicle.build.labelled_files import labelled_tetrahedra
from fascicle.core.errors import InputError
from fascicle.heart.assembly import _endocardium
from fascicle.mesh.checks import check_edges, check_fibres, check_tetrahedra, first_places
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.topology import boundary_triangles, unique_edges

BLOCK = box(60.0, 4, jitter=0.1)
P, T = BLOCK.vertices, BLOCK.tetrahedra
SKIN = boundary_triangles(T)[0]
INNER = np.setdiff1d(np.arange(len(P)), SKIN)
BAD = np.array([7, 40, 41, 90])


def edited(cells, change):
    cells = cells.copy()
    cells[BAD] = change(cells[BAD])
    return cells


def labelled(triangles):
    """Read the block with these triangles labelled."""
    labels = {"label": np.resize([1.0, 2, 3, 4], len(triangles))}
    cells = {TETRAHEDRON: T, TRIANGLE: triangles}
    labelled_tetrahedra(MeshFile(Path("m"), P, cells, {}, {TRIANGLE: labels}))


def zero(values):
    return edited(np.ones((len(values), 3)), lambda rows: 0 * rows)


INVERTED = edited(T, lambda rows: rows[:, [1, 0, 2, 3]])
FLAT = edited(T, lambda rows: rows[:, [0, 1, 2, 2]])
TWO = np.concatenate([P, P[np.unique(T[BAD])] + 200])
OPEN = SKIN[np.setdiff1d(np.arange(len(SKIN)), BAD[:1])]
FINS = np.concatenate([SKIN, np.column_stack([SKIN[BAD, :2], INNER[:4]])])
SHARED = np.sort(SKIN[BAD, :2])
WITHIN = np.column_stack([SKIN[BAD, :2], INNER[:4]])
FAULTS = {
    "inverted": (lambda: check_tetrahedra("m", P, INVERTED), BAD, P[T[BAD]]),
    "flat": (lambda: check_tetrahedra("m", P, FLAT), BAD, P[FLAT[BAD]]),
    "pieces": (
        lambda: check_tetrahedra("m", TWO, np.concatenate([T, _renumbered(T[BAD]) + len(P)])),
        np.arange(len(P), len(TWO)),
        TWO[len(P) :],
    ),
    "fibres of points": (lambda: check_fibres("m", zero(P), P), BAD, P[BAD]),
    "fibres of cells": (lambda: check_fibres("m", zero(T), P, T), BAD, P[T[BAD]]),
    "open edges": (
        lambda: check_edges("m", P, OPEN, "close it"),
        *(lambda edges: (edges, P[edges]))(np.sort(unique_edges(SKIN[BAD[:1]])[0], axis=1)),
    ),
    "shared edges": (
        lambda: check_edges("m", P, FINS),
        *(lambda edges: (edges, P[edges]))(SHARED[np.lexsort(SHARED.T[::-1])]),
    ),
    "unused points": (
        lambda: _endocardium("lv", MeshFile(Path("m"), P, {TRIANGLE: SKIN})), INNER, P[INNER],
    ),
    "no faces": (lambda: labelled(np.concatenate([SKIN, WITHIN])), WITHIN, P[WITHIN]),
    "not labelled": (lambda: labelled(SKIN[9:]), SKIN[:9], P[SKIN[:9]]),
    "two labels": (
        lambda: labelled(np.concatenate([SKIN, SKIN[BAD]])), SKIN[BAD], P[SKIN[BAD]],
    ),
}  # fmt: skip


def _renumbered(cells):
    return np.unique(cells, return_inverse=True)[1].reshape(cells.shape)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_first_three_are_told(fault):
    check, numbers, places = FAULTS[fault]
    with pytest.raises(InputError) as refused:
        check()
    assert f" (first: {first_places(numbers, places)}); " in str(refused.value)


def test_a_place_is_the_middle_of_an_element():
    assert first_places(np.array([[3, 12]]), np.array([[[0, 0, 0], [2, -4, 1.0]]])) == (
        "3-12 at (1.0, -2.0, 0.5) mm"
    )
