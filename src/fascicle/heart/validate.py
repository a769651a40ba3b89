"""Checks on a heart: everything that would make the physics silently wrong."""

from __future__ import annotations

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import TETRAHEDRON_FACES, components_of

# The largest extent of human ventricles is 70 to 200 mm; the limits leave room for a dog's heart
# and for a dilated one.
HEART_EXTENT = (35.0, 400.0)  # mm
# A tetrahedron flatter than this fraction of a regular one with its mean edge counts as flat.
FLATNESS = 1e-9
SMALLEST_ENDOCARDIUM = 0.2  # of the largest extent of the tissue
FURTHEST_ENDOCARDIUM = 5.0  # mm, median distance of an endocardium to the tissue
ELECTRODES_EXTENT = (120.0, 1200.0)  # mm, of most; the chest's alone 150 to 250 on an adult
MOST_ELECTRODES = 7  # the two furthest may be misplaced
FURTHEST_ELECTRODE = 1500.0  # mm
LONGEST_FIBRE = 1e100  # any length serves, as long as its square is a number


def check_units(name: str, points: Floats, limits: tuple[float, float] = HEART_EXTENT) -> None:
    """Refuse an anatomy whose size says that it is not in mm.

    Parameters
    ----------
    name : str
        What to call it in an error.
    points : (n, 3) array
        Its points.
    limits : (low, high), optional
        The largest extent that such an anatomy has (mm); that of hearts if not given.

    Raises
    ------
    InputError
        If its largest extent is outside the limits.
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

    Parameters
    ----------
    name : str
        What to call it in an error.
    vertices, tetrahedra : (n, 3) and (m, 4) arrays
        The mesh (mm); every vertex belongs to a tetrahedron.
    """
    volumes = signed_volumes(vertices, tetrahedra)
    size = float(np.abs(volumes).mean())
    for kind, bad in (
        ("have zero volume", np.flatnonzero(np.abs(volumes) <= FLATNESS * size)),
        ("are inverted", np.flatnonzero(volumes < -FLATNESS * size)),
    ):
        if bad.size:
            remedy = (
                "swap two vertices of every one"
                if bad.size == len(tetrahedra) and kind == "are inverted"
                else "remove them or remesh"
            )
            raise InputError(
                f"{name}: {bad.size} of {len(tetrahedra)} tetrahedra {kind} "
                f"(first: {bad[0]}); {remedy}"
            )
    _check_no_overlap(name, tetrahedra)
    linked = tetrahedra[:, [(0, 1), (0, 2), (0, 3)]].reshape(-1, 2)
    sizes = np.bincount(components_of(linked, len(vertices)))
    if len(sizes) > 1:
        raise InputError(
            f"{name}: the tissue falls into {len(sizes)} unconnected pieces "
            f"({len(vertices) - sizes.max()} vertices outside the largest); keep one piece or join "
            "them"
        )


def _check_no_overlap(name: str, tetrahedra: Integers) -> None:
    """Refuse tetrahedra that are there twice, or lie within one another: they would count twice."""
    faces = np.sort(tetrahedra[:, TETRAHEDRON_FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    crowded = order[2:][same[1:] & same[:-1]]  # the third tetrahedron on one face, and further ones
    if crowded.size:
        raise InputError(
            f"{name}: {np.unique(crowded // 4).size} tetrahedra overlap others (first: "
            f"{(crowded // 4).min()}); remove what is there twice"
        )


def check_fibres(name: str, fibres: Floats) -> None:
    """Refuse fibre directions that are not finite, far too long, or have no length."""
    bad = np.flatnonzero(~(np.abs(fibres) < LONGEST_FIBRE).all(axis=1))
    if bad.size:
        raise InputError(
            f"{name}: {bad.size} of {len(fibres)} fibres are not finite, or longer than "
            f"{LONGEST_FIBRE:g} (first: {bad[0]}); correct them"
        )
    bad = np.flatnonzero(np.linalg.norm(fibres, axis=1) < 1e-6)
    if bad.size:
        raise InputError(
            f"{name}: {bad.size} of {len(fibres)} fibres have zero length (first: {bad[0]}); "
            "give every vertex or element a direction"
        )


def check_endocardium_in_place(name: str, surface: Floats, vertices: Floats) -> None:
    """Refuse an endocardium that does not lie on the tissue, or is of another size.

    Parameters
    ----------
    name : str
        What to call it in an error.
    surface, vertices : (k, 3) and (n, 3) arrays
        Points of the endocardium and of the tissue (mm).
    """
    extent, whole = (float(np.ptp(points, axis=0).max()) for points in (surface, vertices))
    if extent < SMALLEST_ENDOCARDIUM * whole:
        raise InputError(
            f"{name}: its largest extent is {extent:.3g} mm, that of the tissue {whole:.3g} mm; "
            "give both in mm, and the whole endocardium"
        )
    distance = float(np.median(cKDTree(vertices).query(surface)[0]))
    if distance > FURTHEST_ENDOCARDIUM:
        raise InputError(
            f"{name}: its vertices lie {distance:.1f} mm (median) from the tissue's; "
            "give both in the same frame and in mm"
        )


def check_electrodes(name: str, electrodes: Floats, heart: Heart) -> None:
    """Refuse electrodes in other units, inside the tissue, or far from any torso.

    Parameters
    ----------
    name : str
        What to call them in an error.
    electrodes : (9, 3) array
        Positions in the order of `fascicle.core.leads.ELECTRODES` (mm).
    heart : Heart
        The tissue.
    """
    off = np.linalg.norm(electrodes - np.median(electrodes, axis=0), axis=1)
    most = electrodes[np.argsort(off)[:MOST_ELECTRODES]]
    check_units(f"{name} (electrodes)", most, ELECTRODES_EXTENT)
    tree = igl.AABB()
    tree.init(heart.vertices, heart.tetrahedra)
    inside = np.asarray(igl.in_element(heart.vertices, heart.tetrahedra, electrodes, tree))
    distance = np.linalg.norm(electrodes - heart.vertices.mean(axis=0), axis=1)
    for k, electrode in enumerate(ELECTRODES):
        if inside[k] >= 0:
            raise InputError(
                f"{name}: electrode {electrode} lies inside the tissue; check its position, and "
                "that electrodes and heart share frame and units (mm)"
            )
        if distance[k] > FURTHEST_ELECTRODE:
            raise InputError(
                f"{name}: electrode {electrode} is {distance[k]:.0f} mm from the heart; check that "
                "electrodes and heart share frame and units (mm)"
            )
