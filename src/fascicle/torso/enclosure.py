"""Whether heart, lungs and skin lie within one another as those of a body do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.validate import check_units
from fascicle.mesh.quality import intersections, self_intersections
from fascicle.mesh.topology import directed_edges, unique_edges
from fascicle.torso.surfaces import Surface, signed_distance

# Largest extents; a child's is above the first, no adult's above the second.
TORSO_EXTENT = (200.0, 2500.0)  # mm
LUNG_EXTENT = (70.0, 450.0)  # mm
LEAST_GAP = 0.5  # mm, between one surface and another


def check_within(
    mesh: LabelledMesh, skin: Surface, lungs: Sequence[Surface] = (), names: Sequence[str] = ()
) -> None:
    """Refuse surfaces between which no tetrahedra fit.

    Parameters
    ----------
    mesh : LabelledMesh
        The heart (mm).
    skin, lungs : Surface and sequence of Surface
        The torso's (mm).
    names : sequence of str
        What to call skin and lungs in an error, where they come from files.

    Raises
    ------
    InputError
        If the torso is not in mm, a surface is open, crosses itself or has triangles turned the
        wrong way, heart or lungs reach out of the torso, or heart and lungs or two lungs overlap.
    """
    names = names or ["torso", *(f"lung {number}" for number in range(1, len(lungs) + 1))]
    for name, surface in zip(names, (skin, *lungs), strict=True):
        check_units(name, surface.vertices, TORSO_EXTENT if surface is skin else LUNG_EXTENT)
        check_closed(name, surface)
        where = crossing(surface, surface)
        if where is not None:
            raise InputError(
                f"{name}: the surface crosses itself at {_place(where)}; repair it or smooth it "
                "there"
            )
    heart = Surface(mesh.vertices, mesh.triangles)
    check_closed(mesh.name, heart)
    _check_inside(mesh.name, mesh.vertices[np.unique(mesh.triangles)], skin)
    for k, lung in enumerate(lungs):
        _check_inside(names[k + 1], lung.vertices, skin)
        _check_apart(names[k + 1], lung, mesh.name, heart)
        for other in range(k):
            _check_apart(names[k + 1], lung, names[other + 1], lungs[other])


def check_closed(name: str, surface: Surface) -> None:
    """Refuse a surface with holes, with several sheets on one edge, or turned inside out."""
    edges, count = unique_edges(surface.triangles)
    for bad, what, remedy in (
        (count == 1, "an open edge", "close the hole"),
        (count > 2, "an edge of more than two triangles", "make it one closed surface"),
    ):
        if bad.any():
            where = _place(surface.vertices[edges[bad][0]].mean(axis=0))
            raise InputError(f"{name}: the surface has {what} at {where}; {remedy}")
    directed, count = np.unique(directed_edges(surface.triangles), axis=0, return_counts=True)
    if (count > 1).any():
        where = _place(surface.vertices[directed[count > 1][0]].mean(axis=0))
        raise InputError(
            f"{name}: neighbouring triangles at {where} are wound against each other; turn one"
        )
    if surface.litres < 0:
        raise InputError(f"{name}: the surface is inside out; reverse its triangles")


def _check_inside(name: str, points: Floats, skin: Surface) -> None:
    beyond = signed_distance(points, skin)
    worst = int(np.argmax(beyond))
    if beyond.min() > 0:
        raise InputError(
            f"{name}: lies outside the torso, {beyond.min():.0f} mm from its skin; give both in "
            "the same frame and in mm"
        )
    if beyond[worst] > 0:
        raise InputError(
            f"{name}: pokes {beyond[worst]:.1f} mm through the torso's skin at "
            f"{_place(points[worst])}; give both in the same frame, or a torso that holds it"
        )
    if beyond[worst] > -LEAST_GAP:
        raise InputError(
            f"{name}: touches the torso's skin at {_place(points[worst])}; leave "
            f"{LEAST_GAP:g} mm between them"
        )


def _check_apart(name: str, one: Surface, other_name: str, other: Surface) -> None:
    """Refuse surfaces that overlap, one within the other included, or touch."""
    points = np.concatenate([one.vertices, other.vertices])
    gap = np.concatenate(
        [signed_distance(one.vertices, other), signed_distance(other.vertices, one)]
    )
    deepest = points[np.argmin(gap)]
    crossed = crossing(one, other)
    if gap.min() < 0 or crossed is not None:
        where = deepest if crossed is None or gap.min() < 0 else crossed
        raise InputError(
            f"{name}: overlaps {other_name} by {max(-gap.min(), 0):.1f} mm at {_place(where)}; "
            "cut it back there"
        )
    if gap.min() < LEAST_GAP:
        raise InputError(
            f"{name}: touches {other_name} at {_place(deepest)}; leave {LEAST_GAP:g} mm between"
        )


def _place(point: Floats) -> str:
    return "({:.1f}, {:.1f}, {:.1f})".format(*point)


def crossing(one: Surface, other: Surface) -> Floats | None:
    """A place (3,) where two surfaces, or one given twice, pass through each other, if any."""
    pairs = self_intersections(*one) if one is other else intersections(one, other)
    return np.asarray(one.corners[pairs[0, 0]].mean(axis=0)) if len(pairs) else None
