"""Ray travel times: from the endocardia once per heart, and from sites."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.progress import StageProgress, no_progress
from fascicle.core.threads import blas_threads
from fascicle.kernels.arrays import (
    CORNERS,
    FACES,
    EikonalMesh,
    LocatedSites,
    RayTravelTimes,
    TravelTimeTable,
)
from fascicle.kernels.ray_travel_times import POINTS, rays_to_sites, rays_to_vertices, trace_rays

LONGEST_RAY = 50.0  # ms; longer travel times along rays are left to the elements


def build_travel_time_table(
    mesh: EikonalMesh,
    surface: Integers,
    owner: Integers,
    triangles: Integers,
    progress: StageProgress = no_progress,
) -> TravelTimeTable:
    """Trace rays from boundary triangles to the vertices around them.

    Parameters
    ----------
    mesh : EikonalMesh
        The myocardium.
    surface, owner : (b, 3) and (b,) arrays
        Its boundary triangles, and the tetrahedron of each.
    triangles : (r,) array
        Boundary triangles to trace rays from.
    progress : callable
        Called with the triangles done and their number, once it is clear that it takes a while.
    """
    missing = ~(mesh.corners[owner][:, :, None] == surface[:, None, :]).any(axis=2)
    opposite = missing.argmax(axis=1)
    vertices = KDTree(mesh.vertices)
    centres = mesh.vertices[surface[triangles]].mean(axis=1)
    reach = _how_far(centres, vertices)
    none = np.zeros(1, np.int64), np.empty(0, np.int32), np.empty((0, len(POINTS)), np.float32)
    parts_of_rows = [none]
    begin, done = time.monotonic(), 0
    # chunks of triangles bound the memory
    chunks = [triangles[first : first + 256] for first in range(0, len(triangles), 256)]
    with ThreadPoolExecutor(blas_threads()) as pool:
        for rows in pool.map(
            lambda chunk: _rows(mesh, owner[chunk], opposite[chunk], vertices, reach), chunks
        ):
            parts_of_rows.append(rows)
            done += len(rows[0])
            if time.monotonic() - begin > 1.0:  # s
                progress(done, len(triangles))
    row = np.full(len(surface), -1, dtype=np.int32)
    row[triangles] = np.arange(len(triangles))
    sizes, vertex, square = (np.concatenate(parts) for parts in zip(*parts_of_rows, strict=True))
    start, opposite = np.cumsum(sizes), opposite.astype(np.int8)
    return TravelTimeTable(row, opposite, start, vertex, square, reach, LONGEST_RAY)


def _how_far(centres: Floats, vertices: KDTree) -> float:
    """Reach of the table (mm), from the triangles' centres."""
    some = centres[:: max(1, len(centres) // 500)]  # sample that estimates the number of rays
    # limits the time to trace rays, and their memory (28 bytes each); 20 mm at most
    most, reach = min(8_000_000, 150 * vertices.n), 20.0
    for _ in range(3 if len(some) else 0):  # as their number is not exactly cubic in the reach
        around = vertices.query_ball_point(some, reach, return_length=True)
        rays = len(centres) * float(np.mean(around))
        reach *= float(np.cbrt(min(1.0, most / max(rays, 1.0))))
    return reach


def _rows(
    mesh: EikonalMesh, elements: Integers, opposite: Integers, vertices: KDTree, reach: float
) -> tuple[Integers, NDArray[np.int32], NDArray[np.float32]]:
    """Rows of the table for the faces opposite a corner of some elements.

    Number of vertices of each row, the vertices, and the squared times. Vertices to which not all
    six points have a ray are left out, and so are the element's own corners, whose times are exact
    without rays.
    """
    at = mesh.vertices[mesh.corners[elements[:, None], FACES[opposite]]]
    pairs = KDTree(at.mean(axis=1)).sparse_distance_matrix(vertices, reach, output_type="ndarray")
    order = np.lexsort((pairs["j"], pairs["i"]))
    row, vertex = pairs["i"][order], pairs["j"][order].astype(np.int32)
    start = np.searchsorted(row, np.arange(len(elements) + 1))
    square = np.full((len(vertex), len(POINTS)), np.inf)
    trace_rays(POINTS @ at, elements, start, vertex, LONGEST_RAY, mesh, square)
    reached = np.isfinite(square).all(axis=1)
    reached &= (vertex[:, None] != mesh.corners[elements[row]]).all(axis=1)
    size = np.bincount(row[reached], minlength=len(elements))
    return size, vertex[reached], square[reached].astype(np.float32)


class SiteNeighbourhood(NamedTuple):
    """Sites, and their ray travel times to the vertices around them.

    Attributes
    ----------
    sites : LocatedSites
        Locations of the sites in the mesh.
    to_vertices : RayTravelTimes
        Ray travel times to the vertices around each site.
    """

    sites: LocatedSites
    to_vertices: RayTravelTimes

    def joined_with(self, other: SiteNeighbourhood) -> SiteNeighbourhood:
        """Join with another neighbourhood, whose sites come last."""
        first, second = self.to_vertices, other.to_vertices
        to_vertices = RayTravelTimes(
            np.concatenate([first.start, first.start[-1] + second.start[1:]]),
            np.concatenate([first.target, second.target]),
            np.concatenate([first.time, second.time]),
        )
        pairs = zip(self.sites, other.sites, strict=True)
        return SiteNeighbourhood(LocatedSites(*(np.concatenate(p) for p in pairs)), to_vertices)


def find_neighbourhood(
    positions: Floats,
    elements: Integers,
    triangles: Integers | None,
    mesh: EikonalMesh,
    table: TravelTimeTable,
) -> SiteNeighbourhood:
    """Find the ray travel times from sites to the vertices around them.

    Parameters
    ----------
    positions, elements : (j, 3) and (j,) arrays
        Where the sites lie (mm), and the tetrahedron of each, -1 where there is none.
    triangles : (j,) array or None
        The boundary triangle that each site lies in, -1 for none: times are read from the table;
        where it lacks the triangle, rays are traced as far as it reaches. If None, rays from all
        sites are traced, to every vertex.
    mesh, table : EikonalMesh, TravelTimeTable
        The myocardium, and the ray travel times from its endocardia.
    """
    count = len(elements)
    unknown = np.zeros((count, CORNERS)), np.full((count, CORNERS), np.inf)
    sites = LocatedSites(positions, elements, *unknown)
    rows, opposite = np.full(count, -1, np.int32), np.zeros(count, np.int8)
    reach = longest = np.inf
    if triangles is not None:
        rows = np.where(triangles >= 0, table.row[triangles], np.int32(-1))
        opposite = table.opposite[triangles]
        reach, longest = table.reach, table.longest
    room = np.where(rows >= 0, table.start[rows + 1] - table.start[rows], len(mesh.vertices))
    off = np.flatnonzero((rows < 0) & (elements >= 0))
    if off.size and reach < np.inf:
        room[off] = KDTree(mesh.vertices).query_ball_point(
            positions[off], reach * (1 + 1e-9), return_length=True
        )
    rays = _room(count, int((room + CORNERS)[elements >= 0].sum()))
    rays_to_vertices(sites, rows, opposite, mesh, table, reach, longest, rays)
    return SiteNeighbourhood(sites, _used(rays))


def rays_between_sites(neighbourhood: SiteNeighbourhood, mesh: EikonalMesh) -> RayTravelTimes:
    """Find the ray travel times from sites to the other sites around them."""
    sites, to_vertices = neighbourhood
    attached = np.flatnonzero(sites.elements >= 0)
    first = mesh.corners[sites.elements[attached], 0]
    order = np.argsort(first, kind="stable")
    time_to = np.full(len(mesh.vertices), np.inf)
    room = _room(len(sites.elements), 16 * len(attached) + 1)  # usually enough
    return _used(
        rays_to_sites(sites, attached[order], first[order], mesh, to_vertices, time_to, room)
    )


def _room(sites: int, most: int) -> RayTravelTimes:
    return RayTravelTimes(np.empty(sites + 1, np.int64), np.empty(most, np.int32), np.empty(most))


def _used(rays: RayTravelTimes) -> RayTravelTimes:
    used = rays.start[-1]
    return RayTravelTimes(rays.start, rays.target[:used], rays.time[:used])


def grouped(groups: NDArray[np.integer], count: int) -> tuple[Integers, Integers]:
    """Sort items by their group; those of one group stay in the order in which they came.

    Parameters
    ----------
    groups : (n,) array
        The group of each item.
    count : int
        How many groups there are.

    Returns
    -------
    start, order : (count + 1,) and (n,) arrays
        Where each group starts in the order, and the order.
    """
    sizes = np.bincount(groups, minlength=count)
    return np.concatenate([[0], np.cumsum(sizes)]), np.argsort(groups, kind="stable")
