"""Refusing surfaces that are not one manifold piece, and saying where."""

from __future__ import annotations

import igl
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.mesh.topology import unique_edges

SHOWN = 3  # pieces that a message lists


def place(point: Floats) -> str:
    """A position as messages give it."""
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*point)


def check_edges(name: str, vertices: Floats, triangles: Integers, *, closed: bool = False) -> None:
    """Refuse edges that more than two triangles share.

    Parameters
    ----------
    name : str
        What to call the surface in messages.
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices.
    closed : bool
        Whether edges that only one triangle has are refused too.
    """
    edges, count = unique_edges(triangles)
    for bad, fault, remedy in (
        (
            edges[count > 2],
            "have more than two triangles",
            "remove sheets inside the tissue or the cavities, or remesh the surface",
        ),
        (edges[count < 2], "are open", "close the surface, or give its parts one by one"),
    )[: 1 + closed]:
        if len(bad):
            raise InputError(
                f"{name}: {len(bad)} of {len(edges)} edges {fault} (the first at "
                f"{place(vertices[bad[0]].mean(axis=0))}); {remedy}"
            )


def oriented_piece(name: str, vertices: Floats, triangles: Integers) -> Integers:
    """Triangles (m, 3) all turned the same way; a surface in several pieces is refused.

    Parameters
    ----------
    name : str
        What to call the surface in messages.
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices.
    """
    oriented, piece = igl.bfs_orient(triangles)
    sizes = np.bincount(np.asarray(piece))
    if len(sizes) > 1:
        listed = ", ".join(
            f"{sizes[k]} triangles about {place(vertices[triangles[piece == k]].mean(axis=(0, 1)))}"
            for k in np.argsort(-sizes, kind="stable")[:SHOWN]
        )
        raise InputError(
            f"{name}: the surface falls into {len(sizes)} pieces ({listed}"
            f"{', ...' if len(sizes) > SHOWN else ''}); keep one (cavities must be open at the "
            "base)"
        )
    return np.ascontiguousarray(oriented, dtype=np.int64)
