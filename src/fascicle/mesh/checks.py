"""Checks of meshes: units, tetrahedra, directions, edges, pieces; messages give positions."""

from __future__ import annotations

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.mesh.measures import signed_volumes, winding_number
from fascicle.mesh.topology import (
    boundary_loops,
    directed_edges,
    faces_in_order,
    pieces_of,
    unique_edges,
)


def place(point: Floats) -> str:
    """Position (mm) in words, for messages."""
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


def check_units(name: str, points: Floats, limits: tuple[float, float] = (35.0, 400.0)) -> None:
    """Refuse an anatomy whose largest extent (mm) is outside the limits: it is not in mm.

    The largest extent of human ventricles is 70 to 200 mm; the default leaves room for a dog's
    heart and for a dilated one.
    """
    extent = float(np.ptp(points, axis=0).max())
    low, high = limits
    if low <= extent <= high:
        return
    for unit, factor in (("metres", 1e3), ("centimetres", 10.0), ("micrometres", 1e-3)):
        if low <= extent * factor <= high:
            animal = " (in mm it would be of a small animal, for which this model is not made)"
            raise InputError(
                f"{name}: the largest extent is {extent:.3g}, so it seems to be in {unit}"
                f"{animal if unit == 'centimetres' else ''}; multiply the coordinates by "
                f"{factor:g} to get mm"
            )
    raise InputError(
        f"{name}: the largest extent is {extent:.3g}; in mm it would be {low:g} to {high:g}; "
        "check the units"
    )


def check_tetrahedra(name: str, vertices: Floats, tetrahedra: Integers) -> None:
    """Refuse flat, inverted or overlapping tetrahedra and tissue in several pieces.

    Every vertex (n, 3) belongs to one of the tetrahedra (m, 4).
    """
    check_volumes(name, vertices, tetrahedra)
    piece = pieces_of(tetrahedra, len(vertices))
    refuse(
        f"{name}: the tissue falls into {piece.max() + 1} unconnected pieces",
        piece != np.bincount(piece).argmax(),
        "vertices are outside the largest",
        "keep one piece, or 'fascicle heart build' joins them",
        vertices,
    )


def check_volumes(name: str, vertices: Floats, tetrahedra: Integers) -> None:
    """Refuse flat, inverted or overlapping tetrahedra."""
    volumes = signed_volumes(vertices, tetrahedra)
    # the third tetrahedron on one face, or a further one, counts tissue twice
    order, shared = faces_in_order(tetrahedra)
    overlapping = np.zeros(len(tetrahedra), dtype=bool)
    overlapping[order[2:][shared[1:] & shared[:-1]] // 4] = True
    flat = 1e-9 * float(np.abs(volumes).mean())
    inverted = volumes < -flat
    mend = "swap two vertices of every one" if inverted.all() else "remove them or remesh"
    for fault, remedy, bad in (
        ("have zero volume", mend, np.abs(volumes) <= flat),
        ("are inverted", mend, inverted),
        ("overlap others", "remove what is there twice", overlapping),
    ):
        refuse(name, bad, f"tetrahedra {fault}", remedy, vertices, tetrahedra)


def check_fibres(
    name: str,
    fibres: Floats,
    vertices: Floats,
    cells: Integers | None = None,
    remedy: str = "give every vertex or element a direction",
) -> None:
    """Refuse directions of vertices (n, 3) or cells (m, 3) whose length is not finite, or 0."""
    # any length serves, as long as its square is a number
    usable = np.all(np.abs(fibres) < 1e100, axis=1, keepdims=True)
    length = np.linalg.norm(np.where(usable, fibres, 1.0), axis=1)
    for fault, bad in (
        ("are not finite, or longer than 1e+100", ~usable[:, 0]),
        ("have zero length", length < 1e-6),
    ):
        refuse(name, bad, f"fibres {fault}", remedy, vertices, cells)


def check_endocardium_in_place(
    name: str, surface: Floats, triangles: Integers, vertices: Floats, tetrahedra: Integers
) -> None:
    """Refuse an endocardium far from the tissue, around it, or much smaller.

    Its vertices (k, 3) are in mm, its triangles face the cavity.
    """
    extent, tissue_extent = (float(np.ptp(points, axis=0).max()) for points in (surface, vertices))
    if extent < 0.2 * tissue_extent:
        raise InputError(
            f"{name}: its largest extent is {extent:.3g} mm, that of the tissue "
            f"{tissue_extent:.3g} mm; give both in mm, and the whole endocardium"
        )
    if (distance := float(np.median(cKDTree(vertices).query(surface)[0]))) > 5:  # mm
        raise InputError(
            f"{name}: its vertices lie {distance:.1f} mm (median) from the tissue's; "
            "give both in the same frame and in mm"
        )
    within = winding_number(surface, triangles, vertices[tetrahedra].mean(axis=1)) > 0.5
    if within.mean() > 0.5:
        raise InputError(
            f"{name}: {within.mean():.0%} of the tissue lies in the cavity that it lines, so it "
            "seems to be the epicardium; give the endocardium"
        )


def check_edges(name: str, vertices: Floats, triangles: Integers, closed: str = "") -> None:
    """Refuse edges of more than two triangles, and open ones of a surface that is to be closed.

    `closed` says what to do about open edges, which are no fault without it.
    """
    edges, count = unique_edges(triangles)
    remedy = (
        "remove what meets there, such as sheets inside the tissue (in MeshLab: Filters, Cleaning "
        "and Repairing, Repair non Manifold Edges)"
    )
    for bad, fault, advice in (
        (count > 2, "edges have more than two triangles", remedy),
        ((count < 2) & bool(closed), "edges are open", closed),
    ):
        refuse(name, bad, fault, advice, vertices, edges, edges)


def oriented_piece(
    name: str, vertices: Floats, triangles: Integers, which: str = "one"
) -> Integers:
    """Triangles (m, 3) consistently oriented; refuse several pieces or a non-orientable surface.

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
