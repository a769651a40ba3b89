"""A block of tissue with two wells for cavities, where every area is known."""

import numpy as np
import pytest

from fascicle.heart.endocardium import Endocardium, oriented_into_cavity
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import signed_volumes

CELL = 5.0  # mm
CELLS = (8, 4, 6)  # x from right to left of the patient, y from front to back, z upwards
WELLS = {"rv": ((1, 3), (1, 3), (3, 6)), "lv": ((5, 7), (1, 3), (2, 6))}
KUHN = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)


def in_well(side, vertices, triangles):
    """Which boundary triangles are walls and floor of a well."""
    spans = CELL * np.array(WELLS[side], dtype=float)
    centres = vertices[triangles].mean(axis=1)
    inside = ((centres >= spans[:, 0] - 1e-9) & (centres <= spans[:, 1] + 1e-9)).all(axis=1)
    return inside & (centres[:, 2] < CELL * CELLS[2] - 1e-9)


@pytest.fixture(scope="package")
def block():
    nodes = np.array([n + 1 for n in CELLS])
    vertices = CELL * np.indices(nodes).reshape(3, -1).T
    solid = np.ones(CELLS, dtype=bool)
    for spans in WELLS.values():
        solid[tuple(slice(*span) for span in spans)] = False
    strides = np.array([nodes[1] * nodes[2], nodes[2], 1])
    corner = np.array([strides @ [c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
    tetrahedra = ((np.argwhere(solid) @ strides)[:, None] + corner)[:, KUHN].reshape(-1, 4)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    blank = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    fibres = np.tile([1.0, 0, 0], (len(tetrahedra), 1))
    draft = Heart(vertices, tetrahedra, fibres, blank, blank, np.zeros((9, 3)))
    triangles, sides = draft.boundary[0], {}
    for side in WELLS:
        chosen = triangles[in_well(side, vertices, triangles)]
        used, local = np.unique(chosen, return_inverse=True)
        faces = oriented_into_cavity(vertices[used], local.reshape(-1, 3), side)
        sides[side] = Endocardium(side, vertices[used], faces, 0, 1)
    return Heart(vertices, tetrahedra, fibres, sides["lv"], sides["rv"], np.zeros((9, 3)))


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
