"""The myocardium as prepared for the sweep, once per heart."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import igl
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import reverse_cuthill_mckee

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.progress import StageProgress, no_progress
from fascicle.forward.eikonal.nearest_triangles import Candidates, find_candidates
from fascicle.forward.eikonal.ray_travel_times import (
    SiteNeighbourhood,
    build_travel_time_table,
    grouped,
)
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.kernels.arrays import (
    AT_ORIGIN,
    CELL_COLUMNS,
    CORNERS,
    FACES,
    LINK,
    PRODUCTS,
    SQUARES,
    STAR,
    XX,
    EikonalMesh,
    TravelTimeTable,
    aligned,
)
from fascicle.kernels.nearest_triangle import nearest_of
from fascicle.kernels.star import number_neighbours
from fascicle.mesh.measures import barycentric_gradients
from fascicle.mesh.topology import TETRAHEDRON_EDGES, boundary_triangles


class LocatedPoints(NamedTuple):
    """Points of the myocardium: where they lie, in which element.

    Attributes
    ----------
    positions : (n, 3) array
        Positions in the tissue (mm).
    elements : (n,) array
        Tetrahedron of each; -1 where it does not conduct.
    triangles : (n,) array
        The boundary triangle that is nearest to each.
    distances : (n,) array
        Distances from the requested points to these (mm).
    """

    positions: Floats
    elements: Integers
    triangles: Integers
    distances: Floats


@dataclass(frozen=True)
class Myocardium:
    """The myocardium, prepared for the sweep.

    Attributes
    ----------
    mesh : EikonalMesh
        Geometry, metric and adjacency of what conducts, renumbered.
    travel_times : TravelTimeTable
        Ray travel times from the endocardia.
    order : (n,) array
        Number in the heart of each vertex of `mesh`.
    conducts : (m,) bool array
        Which tetrahedra of `mesh` conduct.
    surface, owner : (b, 3) and (b,) arrays
        Boundary triangles of all tetrahedra, conducting or not, in the numbers of `mesh`, and the
        tetrahedron of each.
    tree : igl.AABB
        Finds the nearest boundary triangle.
    candidates : dict of side to Candidates
        The boundary triangles that can be nearest to each triangle of an endocardium.
    last_stimuli : dict
        Cache of the last stimuli and their neighbourhood: those of a scenario are the same for
        every network.
    """

    mesh: EikonalMesh
    travel_times: TravelTimeTable
    order: Integers
    conducts: Booleans
    surface: Integers
    owner: Integers
    tree: igl.AABB
    candidates: dict[str, Candidates]
    last_stimuli: dict[tuple[bytes, int], tuple[LocatedPoints, SiteNeighbourhood]] = field(
        default_factory=dict
    )

    def on_surface(self, points: Floats) -> LocatedPoints:
        """Nearest points of the tissue's surface to `points` of shape (n, 3) in mm."""
        square, triangle, nearest = self.tree.squared_distance(
            self.mesh.vertices, self.surface, np.ascontiguousarray(points)
        )
        return self._located(np.asarray(nearest), np.asarray(triangle), square)

    def on_surface_from(self, triangles: Integers, points: Floats) -> LocatedPoints:
        """Nearest surface points to `points` in or near triangles of an endocardium.

        Without a search, unless one of them lies elsewhere.
        """
        positions, nearest = np.empty_like(points), np.empty(len(points), np.int64)
        squares, surface = np.empty(len(points)), (self.mesh.vertices, self.surface)
        for candidates in self.candidates.values():  # they lie on one side or on none
            if nearest_of(points, triangles, candidates, *surface, positions, nearest, squares):
                return self._located(positions, nearest, squares)
        return self.on_surface(points)

    def _located(self, positions: Floats, triangles: Integers, squares: Floats) -> LocatedPoints:
        elements = self.owner[triangles]
        elements = np.where(self.conducts[elements], elements, -1)
        return LocatedPoints(positions, elements, triangles, np.sqrt(squares))

    @cached_property
    def _cells(self) -> tuple[Integers, Any]:
        """Corners of the elements, and the search tree of these."""
        corners, cells = self.mesh.corners.astype(np.int64), igl.AABB()
        cells.init(self.mesh.vertices, corners)
        return corners, cells

    def inside(self, points: Floats) -> LocatedPoints:
        """Points in the tissue; those outside are moved to the nearest point of its surface."""
        site = self.on_surface(points)
        if not len(points):
            return site
        positions, elements, distances = site.positions.copy(), site.elements, site.distances
        corners, cells = self._cells
        for k, point in enumerate(points):
            around = np.array(cells.find(self.mesh.vertices, corners, point), dtype=np.int64)
            if around.size:
                conducting = around[self.conducts[around]]
                elements[k] = conducting[0] if conducting.size else -1
                positions[k], distances[k] = point, 0.0
        return LocatedPoints(positions, elements, site.triangles, distances)


def build_myocardium(
    heart: Heart,
    conduction: Conduction,
    progress: StageProgress = no_progress,
    gradients: Floats | None = None,
    table: TravelTimeTable | None = None,
    like: Myocardium | None = None,
) -> Myocardium:
    """Precompute metric, squared travel times, adjacency and ray travel times of a heart.

    Vertices and elements are renumbered along the mesh, so that what is near in space is near in
    memory; `Myocardium.order` leads back. `progress` counts the triangles from which rays are
    traced, if that takes a while. `gradients` (m, 4, 3) are those of the barycentric coordinates in
    the heart's tetrahedra (1/mm), `table` the ray travel times, if at hand; `like` is
    the myocardium of the same heart with another conduction.
    """
    if gradients is None:
        gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
    if like is None:
        links = _links(heart.edges, len(heart.vertices))
        order = reverse_cuthill_mckee(links, symmetric_mode=True)
    else:
        order = like.order
    number = np.argsort(order)  # its inverse
    vertices, renumbered = np.ascontiguousarray(heart.vertices[order]), number[heart.tetrahedra]
    place = np.argsort(renumbered.min(axis=1), kind="stable")
    corners = np.ascontiguousarray(renumbered[place], dtype=np.int32)
    scale = conduction.diffusion_scale(heart)[place]
    conducts = scale > 0
    whole_scale = np.where(conducts, scale, 1.0)
    cells, solver, least = _elements(
        vertices, corners, place, heart.fibres, gradients, conduction, whole_scale
    )
    edges = _edges(corners[conducts], solver[conducts, SQUARES:], len(vertices))
    mesh = EikonalMesh(
        vertices,
        corners,
        cells,
        _face_neighbours(corners, conducts),
        aligned(solver),
        *_stars(corners, conducts, least, *edges),
        *edges,
        slowness=float(1 / (max(conduction.speeds) * np.sqrt(scale.max()))),
    )
    if like is None:
        surface, owner = boundary_triangles(corners)
        tree = find_on_surface(vertices, surface)
        candidates = {
            e.side: find_candidates(e.vertices[e.triangles], vertices, surface, tree)
            for e in heart.endocardia
        }
    else:
        surface, owner, tree, candidates = like.surface, like.owner, like.tree, like.candidates
    if table is None:
        endocardia = _triangles_at(heart, vertices, surface, tree)
        endocardia = endocardia[conducts[owner[endocardia]]]
        table = build_travel_time_table(mesh, surface, owner, endocardia, progress)
    return Myocardium(mesh, table, order, conducts, surface, owner, tree, candidates)


def _elements(
    vertices: Floats,
    corners: NDArray[np.int32],
    place: Integers,
    fibres: Floats,
    gradients: Floats,
    conduction: Conduction,
    scale: Floats,
) -> tuple[Floats, Floats, NDArray[np.float32]]:
    """Arrays `cells` and `solver` of an `EikonalMesh`, and the least delays of `STAR`, (m, 4, 3).

    `place` is the heart's number of each tetrahedron, by which fibres and gradients are found.
    """
    count = len(corners)
    cells, solver = np.empty((count, CELL_COLUMNS)), np.empty((count, 2 * len(TETRAHEDRON_EDGES)))
    least = np.empty((count, CORNERS, CORNERS - 1), np.float32)
    i, j = TETRAHEDRON_EDGES.T
    chunk = 1 << 16  # elements at a time, which bounds the memory
    for first in range(0, count, chunk):
        part = slice(first, first + chunk)
        points = vertices[corners[part]]
        metric = conduction.metric(fibres[place[part]]) / scale[part, None, None]
        slopes = gradients[place[part]]
        cells[part, :AT_ORIGIN] = np.swapaxes(slopes, 1, 2).reshape(-1, AT_ORIGIN)
        cells[part, AT_ORIGIN:XX] = -np.einsum("mki,mi->mk", slopes, points[:, 0])
        cells[part, AT_ORIGIN] += 1
        cells[part, XX:] = metric[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        steered = np.einsum("mij,mkj->mki", np.linalg.inv(metric), slopes)
        products = np.einsum("mei,mei->me", slopes[:, i], steered[:, j])
        solver[part, PRODUCTS:SQUARES] = products
        edges = points[:, j] - points[:, i]
        solver[part, SQUARES:] = np.einsum("mei,mij,mej->me", edges, metric, edges)
        reached = _reach(solver[part, SQUARES:]).astype(np.float32)
        least[part] = np.nextafter(reached, np.float32(-np.inf))  # rounded down
    return cells, solver, least


def _edges(
    corners: NDArray[np.int32], squares: Floats, count: int
) -> tuple[Integers, NDArray[np.void]]:
    """Neighbours of each vertex along edges, as starts and list, with least travel times."""
    i, j = TETRAHEDRON_EDGES.T
    tail = np.concatenate([corners[:, i], corners[:, j]]).ravel().astype(np.int64)
    head = np.concatenate([corners[:, j], corners[:, i]]).ravel()
    pair = tail * count + head
    order = np.argsort(pair, kind="stable")
    first = np.flatnonzero(np.diff(pair[order], prepend=-1))
    edge = order[first]
    link = np.empty(len(edge), LINK)
    link["vertex"] = head[edge]
    link["time"] = np.sqrt(np.minimum.reduceat(np.tile(squares.ravel(), 2)[order], first))
    start = np.concatenate([[0], np.cumsum(np.bincount(tail[edge], minlength=count))])
    return start, link


def _triangles_at(heart: Heart, vertices: Floats, surface: Integers, tree: igl.AABB) -> Integers:
    """Boundary triangles that the endocardia lie on.

    They have their centre near an endocardium, or are nearest to its vertices or triangles.
    """
    centres = vertices[surface].mean(axis=1)
    near = []
    for endocardium in heart.endocardia:
        square, _, _ = find_on_surface(
            endocardium.vertices, endocardium.triangles
        ).squared_distance(endocardium.vertices, endocardium.triangles, centres)
        # within a quarter of an edge
        near.append(np.flatnonzero(square < (0.25 * heart.edge_length) ** 2))
        corners = endocardium.vertices[endocardium.triangles]
        sides = (corners + np.roll(corners, 1, axis=1)) / 2
        points = [corners.reshape(-1, 3), sides.reshape(-1, 3), corners.mean(axis=1)]
        near.append(tree.squared_distance(vertices, surface, np.concatenate(points))[1])
    return np.unique(np.concatenate(near))


def find_on_surface(vertices: Floats, surface: Integers) -> igl.AABB:
    """Search tree that finds the nearest of a surface's triangles."""
    tree = igl.AABB()
    tree.init(vertices, surface)
    return tree


def _stars(
    corners: NDArray[np.int32],
    conducts: Booleans,
    least: NDArray[np.float32],
    link_start: Integers,
    link: NDArray[np.void],
) -> tuple[Integers, NDArray[np.void]]:
    """Conducting elements around each vertex, as starts and list."""
    flat = np.flatnonzero(np.repeat(conducts, CORNERS))  # CORNERS·tetrahedron + corner
    start, order = grouped(corners.ravel()[flat], len(link_start) - 1)
    star = np.empty(len(flat), STAR)
    star["item"] = flat[order]
    tetrahedron, corner = np.divmod(flat[order], CORNERS)
    link_numbers = np.empty((len(flat), CORNERS - 1), np.uint16)
    at = corners[tetrahedron[:, None], FACES[corner]]
    number_neighbours(start, at, link_start, link["vertex"], link_numbers)
    star["a"], star["b"], star["c"] = link_numbers.T
    star["least_a"], star["least_b"], star["least_c"] = least[tetrahedron, corner].T
    return start, star


def _reach(squares: Floats) -> Floats:
    """Least delay (ms) between a corner and another one that is reached through it; (m, 4, 3).

    A front that comes to corner x from direction v, through the face that corner s belongs to,
    reaches x later than s by the projection of the edge from s to x on v, in the metric. Its least
    value over the face's cone of directions is on one of its edges, or inside the side that is
    opposite to s where the projection on that side's plane points away from it.
    """
    square = np.zeros((len(squares), 4, 4))
    for k, (i, j) in enumerate(TETRAHEDRON_EDGES):
        square[:, i, j] = square[:, j, i] = squares[:, k]
    least = np.empty((len(squares), 4, 3))
    for s in range(4):
        for turn, x in enumerate(FACES[s]):
            j, k = (c for c in FACES[s] if c != x)
            ss, jj, kk = square[:, s, x], square[:, j, x], square[:, k, x]
            sj, sk = (ss + jj - square[:, s, j]) / 2, (ss + kk - square[:, s, k]) / 2
            jk = (jj + kk - square[:, j, k]) / 2
            on_edges = np.minimum(np.sqrt(ss), np.minimum(sj / np.sqrt(jj), sk / np.sqrt(kk)))
            det = jj * kk - jk * jk
            along_j, along_k = (sj * kk - sk * jk) / det, (sk * jj - sj * jk) / det
            away = (along_j <= 0) & (along_k <= 0)
            projection = np.sqrt(np.maximum(along_j * sj + along_k * sk, 0))
            least[:, s, turn] = np.where(away, -projection, on_edges)
    return least


def _links(edges: Integers, count: int) -> sp.csr_array:
    """Symmetric pattern of the vertices that share an edge."""
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    entries = np.ones(len(rows), dtype=np.int8)
    return sp.coo_array((entries, (rows, columns)), shape=(count, count)).tocsr()


def _face_neighbours(corners: NDArray[np.int32], conducts: Booleans) -> NDArray[np.int32]:
    """Tetrahedron across the face opposite each corner, -1 where none conducts; shape (m, 4)."""
    faces = np.asarray(igl.tet_tet_adjacency(corners.astype(np.int64))[0])
    neighbours = faces[:, [2, 3, 1, 0]]  # libigl's faces are 012, 013, 123, 203
    neighbours[(neighbours >= 0) & ~conducts[neighbours]] = -1
    return neighbours.astype(np.int32)
