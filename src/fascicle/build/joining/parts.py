"""One part of the ventricles' surface, read from anywhere: vertices merged, one piece, open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.build.surface_checks import check_edges, oriented_piece, place
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.validate import check_units
from fascicle.mesh.topology import (
    boundary_loops,
    merged_vertices,
    whole_triangles,
    without_unused_vertices,
)

SAME_POINT = 1e-3  # mm; points closer than this are one (STL repeats them)
SHOWN = 4  # boundary loops that a message lists


@dataclass(frozen=True)
class OpenSurface:
    """An open surface that is one manifold piece.

    Attributes
    ----------
    what : str
        What it is, in messages.
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices, consistently oriented.
    """

    what: str
    vertices: Floats
    triangles: Integers

    @property
    def loops(self) -> list[Integers]:
        """Boundary loops, as vertex indices."""
        return boundary_loops(self.triangles)


def clean_part(vertices: Floats, triangles: Integers, what: str, loops: int) -> OpenSurface:
    """Merge the repeated points of a part, orient its triangles, and check what it is.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices; points may be repeated, orientations mixed.
    what : str
        What to call the part in messages.
    loops : int
        How many boundary loops it must have.

    Returns
    -------
    OpenSurface
        Vertices that are not used are dropped.

    Raises
    ------
    InputError
        If the part is not in mm, or not one manifold piece with that many boundary loops.
    """
    if not len(triangles):
        raise InputError(f"{what}: the surface has no triangles; export it again")
    vertices = np.asarray(vertices, dtype=float)
    check_units(what, vertices[np.unique(triangles)])
    merged = merged_vertices(vertices, SAME_POINT)[triangles]
    points, triangles = without_unused_vertices(vertices, merged[whole_triangles(merged)])
    check_edges(what, points, triangles)
    part = OpenSurface(what, points, oriented_piece(what, points, triangles))
    _check_loops(part, loops)
    return part


def _check_loops(part: OpenSurface, needed: int) -> None:
    loops = sorted(part.loops, key=len, reverse=True)
    touching = sum(np.unique(loop).size != loop.size for loop in loops)
    if len(loops) == needed and not touching:
        return
    where = ", ".join(
        f"{len(loop)} vertices about {place(part.vertices[loop].mean(axis=0))}"
        for loop in loops[:SHOWN]
    )
    found = f"{len(loops)} boundary loops ({where}{', ...' if len(loops) > SHOWN else ''})"
    if not loops:
        found = "no boundary loop (it is closed)"
    elif touching:
        found += f", {touching} of which touch themselves"
    kind = (
        "it must be open at the base, with one boundary loop"
        if needed == 1
        else "it must have three: one towards the epicardium and one around each cavity"
    )
    raise InputError(f"{part.what}: the surface has {found}; {kind}")
