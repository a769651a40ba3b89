"""Preparation of a heart's myocardium for the sweep, once per heart and conduction."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import igl
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import KDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.progress import StageProgress, no_progress
from fascicle.core.threads import blas_threads
from fascicle.forward.eikonal.myocardium import Candidates, Myocardium, grouped, search_tree
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.kernels.arrays import (
    CORNERS,
    FACES,
    LINK,
    SQUARES,
    STAR,
    Column,
    EikonalMesh,
    TravelTimeTable,
    aligned,
)
from fascicle.kernels.ray_travel_times import POINTS, trace_rays
from fascicle.mesh.measures import barycentric_gradients
from fascicle.mesh.topology import TETRAHEDRON_EDGES, boundary_triangles


def build_myocardium(
    heart: Heart,
    conduction: Conduction,
    progress: StageProgress = no_progress,
    gradients: Floats | None = None,
    table: TravelTimeTable | None = None,
    like: Myocardium | None = None,
    rays: int = 150,
) -> Myocardium:
    """Precompute metric, squared travel times, adjacency and ray travel times of a heart.

    Vertices and elements are renumbered along the mesh, so that what is near in space is near in
    memory; `Myocardium.order` leads back. `progress` counts the triangles from which rays are
    traced, if that takes a while. `gradients` (m, 4, 3) are those of the barycentric coordinates in
    the heart's tetrahedra (1/mm), `table` the ray travel times, if at hand; `like` is
    the myocardium of the same heart with another conduction. `rays` is the number of rays a vertex
    of the mesh in the table, at most: fewer are faster, and activation is later.
    """
    if gradients is None:
        gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
    if like is None:
        rows, columns = np.concatenate([heart.edges, heart.edges[:, ::-1]]).T
        entries = np.ones(len(rows), dtype=np.int8)
        links = sp.coo_array((entries, (rows, columns)), shape=2 * (len(heart.vertices),)).tocsr()
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
    faces = np.asarray(igl.tet_tet_adjacency(corners.astype(np.int64))[0])
    neighbours = faces[:, [2, 3, 1, 0]]  # libigl's faces are 012, 013, 123, 203
    neighbours[(neighbours >= 0) & ~conducts[neighbours]] = -1
    edges = _edges(corners[conducts], solver[conducts, SQUARES:], len(vertices))
    mesh = EikonalMesh(
        vertices,
        corners,
        cells,
        neighbours.astype(np.int32),
        aligned(solver),
        *_stars(corners, conducts, least, *edges),
        *edges,
        slowness=float(1 / (max(conduction.speeds) * np.sqrt(scale.max()))),
    )
    if like is None:
        surface, owner = boundary_triangles(corners)
        tree = search_tree(vertices, surface)
        candidates = {
            e.side: find_candidates(e.vertices[e.triangles], vertices, surface, tree)
            for e in heart.endocardia
        }
    else:
        surface, owner, tree, candidates = like.surface, like.owner, like.tree, like.candidates
    if table is None:
        endocardia = _triangles_at(heart, vertices, surface, tree)
        endocardia = endocardia[conducts[owner[endocardia]]]
        # of finer meshes a third: tables of all tissues would fill the memory
        most = min(rays * len(vertices), max(3_000_000, rays // 3 * len(vertices)))
        table = build_travel_time_table(mesh, surface, owner, endocardia, progress, most)
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
    cells, solver = np.empty((count, 22)), np.empty((count, 2 * len(TETRAHEDRON_EDGES)))
    least = np.empty((count, CORNERS, CORNERS - 1), np.float32)
    i, j = TETRAHEDRON_EDGES.T
    chunk = 1 << 16  # elements at a time, which bounds the memory
    for first in range(0, count, chunk):
        part = slice(first, first + chunk)
        points = vertices[corners[part]]
        metric = conduction.metric(fibres[place[part]]) / scale[part, None, None]
        slopes = gradients[place[part]]
        cells[part, : Column.AT_ORIGIN] = np.swapaxes(slopes, 1, 2).reshape(len(slopes), -1)
        cells[part, Column.AT_ORIGIN : Column.XX] = -np.einsum("mki,mi->mk", slopes, points[:, 0])
        cells[part, Column.AT_ORIGIN] += 1
        cells[part, Column.XX :] = metric[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        steered = np.einsum("mij,mkj->mki", np.linalg.inv(metric), slopes)
        products = np.einsum("mei,mei->me", slopes[:, i], steered[:, j])
        solver[part, :SQUARES] = products
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
        triangles = endocardium.triangles
        if endocardium.bare is not None:  # no tree grows there
            triangles = triangles[~endocardium.bare]
        square, _, _ = search_tree(endocardium.vertices, triangles).squared_distance(
            endocardium.vertices, triangles, centres
        )
        # within a quarter of an edge
        near.append(np.flatnonzero(square < (0.25 * heart.edge_length) ** 2))
        corners = endocardium.vertices[triangles]
        sides = (corners + np.roll(corners, 1, axis=1)) / 2
        points = [corners.reshape(-1, 3), sides.reshape(-1, 3), corners.mean(axis=1)]
        near.append(tree.squared_distance(vertices, surface, np.concatenate(points))[1])
    return np.unique(np.concatenate(near))


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
    # links are in the order of both their ends, so pairs of these find the corners among them
    count = len(link_start) - 1
    links = np.repeat(np.arange(count), np.diff(link_start)) * count + link["vertex"]
    node = np.repeat(np.arange(count), np.diff(start))
    for name, face in zip("abc", FACES[corner].T, strict=True):
        place = np.searchsorted(links, node * count + corners[tetrahedron, face])
        star[name] = place - link_start[node]
    star["least_a"], star["least_b"], star["least_c"] = least[tetrahedron, corner].T
    return start, star


def _reach(squares: Floats) -> Floats:
    """Least delays (ms) of the three other corners after each corner, if reached through it.

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


def find_candidates(
    triangles: Floats, vertices: Floats, surface: Integers, tree: igl.AABB
) -> Candidates:
    """Find the boundary triangles that can be nearest to points of an endocardium.

    With a triangle in a ball of radius r, and the surface at a distance d from the centre, the
    surface point nearest to any point of the ball is d + 2r from the centre at most.

    `triangles` (m, 3, 3) are corners of the endocardium's triangles (mm). The tissue's boundary has
    vertices (v, 3) (mm) and triangles `surface` (b, 3), of which the tree finds the nearest.
    """
    centres, radii = _balls(triangles)
    surface_centres, surface_radii = _balls(vertices[surface])
    square, _, _ = tree.squared_distance(vertices, surface, centres)
    a_little, chunk = 1 + 1e-9, 1 << 12  # more than rounding; triangles at a time, for memory
    radii *= a_little
    reach = (np.sqrt(square) + 2 * radii) * a_little
    surface_tree, parts = KDTree(surface_centres), []
    for first in range(0, len(centres), chunk):
        part = slice(first, first + chunk)
        around = surface_tree.query_ball_point(centres[part], reach[part] + surface_radii.max())
        row = np.repeat(np.arange(len(around)) + first, [len(near) for near in around])
        near = np.concatenate([np.array(numbers, dtype=np.int64) for numbers in around])
        least = np.linalg.norm(surface_centres[near] - centres[row], axis=1) - surface_radii[near]
        close = np.flatnonzero(least <= reach[row])
        order = close[np.lexsort((least[close], row[close]))]
        parts.append((row[order], near[order], least[order]))
    row, triangle, least = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    start = np.searchsorted(row, np.arange(len(centres) + 1))
    return Candidates(start, triangle, least, centres, radii**2)


def _balls(triangles: Floats) -> tuple[Floats, Floats]:
    """Centres and radii of balls around triangles (m, 3, 3)."""
    centres = triangles.mean(axis=1)
    return centres, np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)


def build_travel_time_table(
    mesh: EikonalMesh,
    surface: Integers,
    owner: Integers,
    triangles: Integers,
    progress: StageProgress = no_progress,
    most: int = 8_000_000,
    longest: float = 50.0,
) -> TravelTimeTable:
    """Trace rays from boundary triangles (r,) to the vertices around them.

    The boundary triangles of the mesh are `surface` (b, 3), of the tetrahedra `owner` (b,). There
    are about `most` rays at most, and 8 million; travel times (ms) above `longest` are left to the
    elements. `progress` counts the triangles, once it is clear that it takes a while.
    """
    missing = ~(mesh.corners[owner][:, :, None] == surface[:, None, :]).any(axis=2)
    opposite = missing.argmax(axis=1)
    vertices = KDTree(mesh.vertices)
    centres = mesh.vertices[surface[triangles]].mean(axis=1)
    reach = _how_far(centres, vertices, most)
    none = np.zeros(1, np.int64), np.empty(0, np.int32), np.empty((0, len(POINTS)), np.float32)
    parts_of_rows = [none]
    begin, done = time.monotonic(), 0
    # chunks of triangles bound the memory
    chunks = [triangles[first : first + 256] for first in range(0, len(triangles), 256)]
    with ThreadPoolExecutor(blas_threads()) as pool:
        for rows in pool.map(
            lambda chunk: _rows(mesh, owner[chunk], opposite[chunk], vertices, reach, longest),
            chunks,
        ):
            parts_of_rows.append(rows)
            done += len(rows[0])
            if time.monotonic() - begin > 1.0:  # s
                progress(done, len(triangles))
    row = np.full(len(surface), -1, dtype=np.int32)
    row[triangles] = np.arange(len(triangles))
    sizes, vertex, square = (np.concatenate(parts) for parts in zip(*parts_of_rows, strict=True))
    start, opposite = np.cumsum(sizes), opposite.astype(np.int8)
    return TravelTimeTable(row, opposite, start, vertex, square, reach, longest)


def _how_far(centres: Floats, vertices: KDTree, most: int) -> float:
    """Reach of the table (mm), from the triangles' centres."""
    some = centres[:: max(1, len(centres) // 500)]  # sample that estimates the number of rays
    # limits the time to trace rays, and their memory (28 bytes each); 20 mm at most
    most, reach = min(8_000_000, most), 20.0
    for _ in range(3 if len(some) else 0):  # as their number is not exactly cubic in the reach
        around = vertices.query_ball_point(some, reach, return_length=True)
        rays = len(centres) * float(np.mean(around))
        reach *= float(np.cbrt(min(1.0, most / max(rays, 1.0))))
    return reach


def _rows(
    mesh: EikonalMesh,
    elements: Integers,
    opposite: Integers,
    vertices: KDTree,
    reach: float,
    longest: float,
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
    trace_rays(POINTS @ at, elements, start, vertex, longest, mesh, square)
    reached = np.isfinite(square).all(axis=1)
    reached &= (vertex[:, None] != mesh.corners[elements[row]]).all(axis=1)
    size = np.bincount(row[reached], minlength=len(elements))
    return size, vertex[reached], square[reached].astype(np.float32)
