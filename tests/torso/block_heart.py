"""A heart of cubes: two square cavities in a block, open at the top; and simple bodies for it."""

from __future__ import annotations

import numpy as np
from anatomies import body
from builders import KUHN

from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import boundary_triangles
from fascicle.torso.surfaces import Surface

CUBE = 8.0  # mm
CELLS = (9, 5, 7)
# first and one past the last cube of each cavity along x, y and z
LV, RV = ((5, 1, 1), (8, 4, 7)), ((1, 1, 2), (4, 4, 7))


def block_heart() -> LabelledMesh:
    """The LV on the side of larger x, the base at the top, as in a body of LPS axes."""
    cells = np.stack(np.meshgrid(*map(np.arange, CELLS), indexing="ij"), axis=-1).reshape(-1, 3)
    for low, high in (LV, RV):
        cells = cells[~((cells >= low) & (cells < high)).all(axis=1)]
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    corners = (cells[:, None] + bits)[:, KUHN].reshape(-1, 3)
    vertices, tetrahedra = np.unique(corners, axis=0, return_inverse=True)
    vertices, tetrahedra = vertices * CUBE, tetrahedra.reshape(-1, 4).astype(np.int64)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [0, 2, 1, 3]]
    triangles, _ = boundary_triangles(tetrahedra)
    middle = vertices[triangles].mean(axis=1) / CUBE
    labels = np.full(len(triangles), int(Label.EPICARDIUM))
    labels[middle[:, 2] == CELLS[2]] = Label.BASE
    for (low, high), label in ((LV, Label.LV_ENDOCARDIUM), (RV, Label.RV_ENDOCARDIUM)):
        inside = (middle >= low) & (middle <= high)
        labels[inside.all(axis=1) & (middle[:, 2] < CELLS[2])] = label
    return LabelledMesh(vertices, tetrahedra, triangles, labels, name="block")


HEART_CENTRE = CUBE * np.array(CELLS) / 2
SKIN = (150.0, 110.0, 180.0)  # half-axes (mm)


def skin() -> Surface:
    return body(SKIN, HEART_CENTRE, 3)


def lung(side: int = 1) -> Surface:
    """Beside the heart: 13 mm from it, and from the skin."""
    return body((35.0, 45.0, 60.0), HEART_CENTRE + np.array([side * 85.0, 0, 0]), 2)
