"""Closed triangle surfaces of the torso: reading them from files, and checks on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import igl
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.checks import (
    check_edges,
    check_units,
    first_places,
    oriented_piece,
    place,
    refuse,
)
from fascicle.mesh.measures import closed_volume, intersections, self_intersections, turned_outwards
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE
from fascicle.mesh.meshing import remeshed_triangles
from fascicle.mesh.read import read_mesh
from fascicle.mesh.topology import boundary_triangles, directed_edges, without_unused_vertices

EDGES = {"torso": 11.0, "lung": 9.0}  # mm, of the triangles of each surface
LEAST_GAP = 0.5  # mm, between one surface and another


class Surface(NamedTuple):
    """Vertices (n, 3) (mm) and triangles (m, 3); if closed, counter-clockwise seen from outside."""

    vertices: Floats
    triangles: Integers

    @property
    def corners(self) -> Floats:
        """Corners of every triangle (mm), shape (m, 3, 3)."""
        return np.asarray(self.vertices[self.triangles])

    @property
    def litres(self) -> float:
        """Enclosed volume of a closed surface."""
        return closed_volume(*self) / 1e6


@dataclass(frozen=True)
class TorsoSurfaces:
    """Closed surfaces around a heart, in its coordinates (mm), and electrodes on the skin (9, 3).

    Electrodes are None for the user's own torso. Lungs are the left, then the right one.
    """

    skin: Surface
    lungs: tuple[Surface, ...]
    electrodes: Floats | None = None


def signed_distance(points: Floats, surface: Surface) -> Floats:
    """Distance to a closed surface (mm), negative inside, shape (n,)."""
    return np.asarray(igl.signed_distance(np.ascontiguousarray(points), *surface)[0], dtype=float)


def remeshed(surface: Surface, edge: float) -> Surface:
    """Triangulate a closed surface again, with edges of about this length (mm)."""
    alike = np.zeros(len(surface.triangles), dtype=np.int64)
    vertices, triangles, _ = remeshed_triangles(
        *surface, alike, hsiz=edge, hausd=0.25 * edge, angle=0
    )
    return Surface(vertices, triangles)


def read_torso_surfaces(
    skin: Path | str, lungs: Sequence[Path | str], mesh: LabelledMesh
) -> TorsoSurfaces:
    """Read the user's own torso: closed skin around the heart, and lungs, in its coordinates (mm).

    Surfaces are welded (STL repeats every point), turned outwards, and remeshed if they are far
    finer than a torso needs. Of a volume mesh the outer surface is used; lungs are separate files.
    An error if a file cannot be read, or its surface is missing, open, in several pieces, not in mm
    or out of place.
    """
    outer = _read_surface(Path(skin), "torso")
    inner = tuple(_read_surface(Path(lung), "lung") for lung in lungs)
    check_within(mesh, outer, inner, [str(skin), *map(str, lungs)])
    return TorsoSurfaces(outer, inner)


def _read_surface(path: Path, purpose: str) -> Surface:
    """Triangles of a file, or the boundary of its tetrahedra; a too fine surface is remeshed."""
    mesh = read_mesh(path, purpose)
    if len(mesh.cells.get(TETRAHEDRON, ())):
        triangles, _ = boundary_triangles(mesh.require(TETRAHEDRON, "tetrahedra"))
    else:
        triangles = mesh.require(TRIANGLE, "triangles")
    points, number = np.unique(mesh.points, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[triangles]
    triangles = triangles[(np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)]
    vertices, triangles = without_unused_vertices(points, triangles)
    check_edges(str(path), vertices, triangles)
    oriented = oriented_piece(str(path), vertices, triangles, "the outer one")
    surface = Surface(vertices, turned_outwards(vertices, oriented))
    if len(triangles) > 20_000:
        check_closed(str(path), surface, purpose)
        surface = remeshed(surface, EDGES[purpose])
    return surface


def check_within(
    mesh: LabelledMesh, skin: Surface, lungs: Sequence[Surface] = (), names: Sequence[str] = ()
) -> None:
    """Refuse surfaces of heart, skin and lungs between which no tetrahedra fit.

    A surface must not be open, inside out, in other units than mm, cross itself, reach out of the
    torso or overlap another. `names` are those of skin and lungs from files.
    """
    names = names or ["torso", *(f"lung {number}" for number in range(1, len(lungs) + 1))]
    for name, surface in zip(names, (skin, *lungs), strict=True):
        check_closed(name, surface, "torso" if surface is skin else "lung")
        if len(pairs := self_intersections(*surface)):
            where = first_places(pairs, surface.corners[pairs])
            raise InputError(
                f"{name}: the surface crosses itself in {len(pairs)} pairs of triangles (first: "
                f"{where}); repair it or smooth it there"
            )
    heart = Surface(mesh.vertices, mesh.triangles)
    check_closed(mesh.name, heart)
    _check_inside(mesh.name, mesh.vertices[np.unique(mesh.triangles)], skin)
    placed = {mesh.name: heart}
    for name, lung in zip(names[1:], lungs, strict=True):
        _check_inside(name, lung.vertices, skin)
        for other in placed.items():
            _check_apart(name, lung, *other)
        placed[name] = lung


def check_closed(name: str, surface: Surface, organ: str = "heart") -> None:
    """Refuse a surface that is not in mm, open, of several sheets on an edge, or inside out."""
    # largest extents (mm): a child's is above the lower, no adult's above the upper limit
    extents = {"torso": (200.0, 2500.0), "lung": (70.0, 450.0), "heart": (35.0, 400.0)}
    check_units(name, surface.vertices, extents[organ])
    check_edges(name, surface.vertices, surface.triangles, "close the hole")
    edges, times = np.unique(directed_edges(surface.triangles), axis=0, return_counts=True)
    fault = "edges are of triangles wound against each other"
    refuse(name, times > 1, fault, "turn one of each two", surface.vertices, edges, edges)
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
    if beyond[worst] > -LEAST_GAP:
        how = f"pokes {beyond[worst]:.1f} mm through" if beyond[worst] > 0 else "touches"
        raise InputError(
            f"{name}: {how} the torso's skin at {place(points[worst])}; give both in the same "
            f"frame, or a torso that holds it and {LEAST_GAP:g} mm around it"
        )


def _check_apart(name: str, surface: Surface, other_name: str, other: Surface) -> None:
    """Refuse surfaces that touch, overlap or lie one within the other."""
    points = np.concatenate([surface.vertices, other.vertices])
    gap = np.append(
        signed_distance(surface.vertices, other), signed_distance(other.vertices, surface)
    )
    pairs = intersections(surface, other)
    crossed = surface.corners[pairs[0, 0]].mean(axis=0) if len(pairs) else None
    if gap.min() < LEAST_GAP or crossed is not None:
        overlaps = gap.min() < 0 or crossed is not None
        where = crossed if crossed is not None and gap.min() >= 0 else points[np.argmin(gap)]
        how = f"overlaps {other_name} by {max(-gap.min(), 0):.1f} mm"
        raise InputError(
            f"{name}: {how if overlaps else f'touches {other_name}'} at {place(where)}; cut it "
            f"back there, with {LEAST_GAP:g} mm between"
        )
