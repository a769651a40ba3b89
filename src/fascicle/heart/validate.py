"""Checks on a heart: everything that would make the physics silently wrong.

Every function takes a name for its error messages.
"""

from __future__ import annotations

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.heart import Heart
from fascicle.mesh.checks import refuse
from fascicle.mesh.measures import signed_volumes, winding_number
from fascicle.mesh.topology import faces_in_order, pieces_of


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
            raise InputError(
                f"{name}: the largest extent is {extent:.3g}, so it seems to be in {unit}; "
                f"multiply the coordinates by {factor:g} to get mm"
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
        "keep one piece or join them",
        vertices,
    )


def check_volumes(name: str, vertices: Floats, tetrahedra: Integers) -> None:
    """Refuse flat, inverted or overlapping tetrahedra."""
    volumes = signed_volumes(vertices, tetrahedra)
    # the third tetrahedron on one face, or a further one, counts tissue twice
    order, same = faces_in_order(tetrahedra)
    overlapping = np.zeros(len(tetrahedra), dtype=bool)
    overlapping[order[2:][same[1:] & same[:-1]] // 4] = True
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
    extent, whole = (float(np.ptp(points, axis=0).max()) for points in (surface, vertices))
    if extent < 0.2 * whole:
        raise InputError(
            f"{name}: its largest extent is {extent:.3g} mm, that of the tissue {whole:.3g} mm; "
            "give both in mm, and the whole endocardium"
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


def check_electrodes(name: str, heart: Heart) -> None:
    """Refuse electrodes in other units, inside the tissue, or far from any torso."""
    electrodes = heart.electrodes
    off = np.linalg.norm(electrodes - np.median(electrodes, axis=0), axis=1)
    # the two furthest may be misplaced; those of the chest alone span 150 to 250 mm on an adult
    check_units(f"{name} (electrodes)", electrodes[np.argsort(off)[:7]], (120.0, 1200.0))
    electrodes = heart.electrode_positions
    tree = igl.AABB()
    tree.init(heart.vertices, heart.tetrahedra)
    inside = np.asarray(igl.in_element(heart.vertices, heart.tetrahedra, electrodes, tree))
    distance = np.linalg.norm(electrodes - heart.vertices.mean(axis=0), axis=1)
    for k, electrode in enumerate(heart.electrode_names):
        where = "lies inside the tissue" if inside[k] >= 0 else ""
        if distance[k] > 1500:  # mm
            where = f"is {distance[k]:.0f} mm from the heart"
        if where:
            raise InputError(
                f"{name}: electrode {electrode} {where}; check its position, and that electrodes "
                "and heart share frame and units (mm)"
            )
