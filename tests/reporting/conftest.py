"""A block of tissue with two wells for cavities, where every area is known."""

from dataclasses import replace

import numpy as np
import pytest
from builders import box

from fascicle.heart.endocardium import Endocardium, oriented_into_cavity

# x from right to left of the patient, y from front to back, z upwards, in cells of 5 mm
WELLS = {"rv": ((1, 3), (1, 3), (3, 6)), "lv": ((5, 7), (1, 3), (2, 6))}


def in_well(side, places):
    """Which places (n, 3), in cells, lie in a well, or on its walls and floor."""
    low, high = np.array(WELLS[side], dtype=float).T
    return ((places >= low - 1e-9) & (places <= high + 1e-9)).all(axis=1)


@pytest.fixture(scope="package")
def block():
    whole = box((40.0, 20.0, 30.0), (8, 4, 6))
    centres = whole.vertices[whole.tetrahedra].mean(axis=1) / 5
    solid = ~np.any([in_well(side, centres) for side in WELLS], axis=0)
    draft = replace(whole, tetrahedra=whole.tetrahedra[solid], fibres=whole.fibres[solid])
    triangles, sides = draft.boundary[0], {}
    centres = draft.vertices[triangles].mean(axis=1) / 5
    for side in WELLS:
        chosen = triangles[in_well(side, centres) & (centres[:, 2] < 6 - 1e-9)]
        used, local = np.unique(chosen, return_inverse=True)
        faces = oriented_into_cavity(draft.vertices[used], local.reshape(-1, 3), side)
        sides[side] = Endocardium(side, draft.vertices[used], faces, 0, 1)
    return replace(draft, **sides)


@pytest.fixture(scope="package")
def pixels():
    """The colour (0 to 1) that a panel shows at places (n, 2) in mm."""

    def colours(axes, places):
        image = axes.images[0]
        left, right, bottom, top = image.get_extent()
        picture = np.asarray(image.get_array())[::-1, :, :3] / 255
        share = (np.asarray(places) - [left, bottom]) / [right - left, top - bottom]
        column, row = (share * [picture.shape[1], picture.shape[0]]).astype(int).T
        return picture[row, column]

    return colours


def edges(polygon):
    """Times of a `fill_between` polygon, and its lower and upper edge."""
    outline = polygon.get_paths()[0].vertices
    at = np.unique(outline[:, 0])
    values = [outline[outline[:, 0] == t, 1] for t in at]
    return at, np.array([v.min() for v in values]), np.array([v.max() for v in values])
