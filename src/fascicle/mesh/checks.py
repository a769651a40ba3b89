"""Checks of meshes for shared edges, several pieces or openings; messages give first places."""

from __future__ import annotations

import igl
import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.mesh.topology import boundary_loops, directed_edges, unique_edges


def place(point: Floats) -> str:
    """A position (mm) as messages give it."""
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*point)


def first_places(bad: Integers, points: Floats) -> str:
    """Numbers and places of the first three offending elements or vertices, for messages.

    `bad` are numbers (k,), or the corners (k, c) of elements that have none; `points` (k, 3) or
    (k, c, 3) are the positions (mm) of the k of them, or of their corners.
    """
    at = [np.reshape(point, (-1, 3)).mean(axis=0) for point in points[:3]]
    names = ["-".join(map(str, np.ravel(number))) for number in bad[:3]]
    return ", ".join(f"{name} at {place(point)}" for name, point in zip(names, at, strict=True))


def refuse(
    name: str,
    bad: Booleans,
    fault: str,
    remedy: str,
    vertices: Floats,
    cells: Integers | None = None,
    numbers: Integers | None = None,
) -> None:
    """Refuse vertices (n, 3) (mm), or cells (m, c) of them, of which some are bad.

    `bad` (n,) or (m,) says which. The message is of the form "heart.vtu: 3 of 80 tetrahedra are
    inverted (first: ...); remesh them"; `numbers`, (m,) or (m, c), are what each is called, by
    default its row.
    """
    if not (at := np.flatnonzero(bad)).size:
        return
    called = at if numbers is None else numbers[at]
    where = first_places(called, vertices[at if cells is None else cells[at]])
    raise InputError(f"{name}: {at.size} of {len(bad)} {fault} (first: {where}); {remedy}")


def check_edges(name: str, vertices: Floats, triangles: Integers, closed: str = "") -> None:
    """Refuse edges of more than two triangles, and open ones of a surface that is to be closed.

    `closed` says what to do about open edges, which are no fault without it.
    """
    edges, count = unique_edges(triangles)
    remedy = "remove what meets there, such as sheets inside the tissue, or remesh"
    for bad, fault, advice in (
        (count > 2, "edges have more than two triangles", remedy),
        ((count < 2) & bool(closed), "edges are open", closed),
    ):
        refuse(name, bad, fault, advice, vertices, edges, edges)


def oriented_piece(
    name: str, vertices: Floats, triangles: Integers, which: str = "one"
) -> Integers:
    """Triangles (m, 3) all turned the same way; several pieces or one side alone are refused.

    No edge has more than two triangles. `which` says in the message which piece to keep.
    """
    oriented, piece = igl.bfs_orient(triangles)
    sizes = np.bincount(np.asarray(piece))
    if len(sizes) > 1:
        listed = ", ".join(
            f"{sizes[k]} triangles about {place(vertices[triangles[piece == k]].mean(axis=(0, 1)))}"
            for k in np.argsort(-sizes, kind="stable")[:3]
        )
        raise InputError(
            f"{name}: the surface falls into {len(sizes)} pieces ({listed}"
            f"{', ...' if len(sizes) > 3 else ''}); keep {which}"
        )
    edges, times = np.unique(directed_edges(oriented), axis=0, return_counts=True)
    fault = "edges join triangles that cannot face one way: the surface is one-sided"
    refuse(name, times > 1, fault, "remesh or repair it", vertices, edges, edges)
    return np.ascontiguousarray(oriented, dtype=np.int64)


def open_loops(name: str, vertices: Floats, triangles: Integers, needed: int = 1) -> list[Integers]:
    """Boundary loops of an oriented surface: one at the base, or three of a base itself.

    Any other number of loops is refused, and so are loops that touch themselves.
    """
    if not (loops := sorted(boundary_loops(triangles), key=len, reverse=True)):
        raise InputError(f"{name}: the surface is closed; cut it open at the base")
    where = ", ".join(
        f"{len(loop)} vertices about {place(vertices[loop].mean(axis=0))}" for loop in loops[:4]
    )
    if len(loops) != needed:
        remedy = "close all but the one at the base"
        if needed == 3:
            remedy = "give one towards the epicardium and one around each cavity"
        raise InputError(
            f"{name}: the surface has {len(loops)} boundary loops ({where}"
            f"{', ...' if len(loops) > 4 else ''}), and {needed} needed; {remedy}"
        )
    if touching := sum(np.unique(loop).size != loop.size for loop in loops):
        raise InputError(
            f"{name}: {touching} of its boundary loops ({where}) touch themselves; trim or remesh "
            "the surface there"
        )
    return loops
