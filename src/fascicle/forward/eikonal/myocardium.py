"""Myocardium prepared for the eikonal solver, and trees and stimuli attached to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.kernels.arrays import (
    CORNERS,
    EikonalMesh,
    Forest,
    JunctionSites,
    RayTravelTimes,
    TravelTimeTable,
)
from fascicle.kernels.nearest_triangle import nearest_of
from fascicle.kernels.ray_travel_times import rays_to_sites, rays_to_vertices
from fascicle.purkinje.tree import PurkinjeTree


class Candidates(NamedTuple):
    """Boundary triangles that can be nearest to each triangle of an endocardium.

    Attributes
    ----------
    start : (m + 1,) array
        Where the candidates of each triangle begin in the list.
    triangle, least : (c,) arrays
        The list, and a lower bound of the distance of each from its ball's centre (mm), ascending.
    centre, square : (m, 3) and (m,) arrays
        A ball around each triangle: its centre (mm) and its squared radius (mm²). The boundary
        triangle nearest to any point of the ball is among the candidates.
    """

    start: Integers
    triangle: Integers
    least: Floats
    centre: Floats
    square: Floats


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
    barycentric, to_corner : (n, 4) arrays
        Barycentric coordinates in the tetrahedron, and squared travel times (ms²) to its corners;
        `rays_to_mesh` fills them in.
    """

    positions: Floats
    elements: Integers
    triangles: Integers
    distances: Floats
    barycentric: Floats
    to_corner: Floats


@dataclass(frozen=True)
class Myocardium:
    """Myocardium, prepared for the eikonal solver.

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
        Cache of the last stimuli and the rays from them: those of a scenario are the same for every
        network.
    """

    mesh: EikonalMesh
    travel_times: TravelTimeTable
    order: Integers
    conducts: Booleans
    surface: Integers
    owner: Integers
    tree: igl.AABB
    candidates: dict[str, Candidates]
    last_stimuli: dict[tuple[bytes, int], tuple[LocatedPoints, RayTravelTimes]] = field(
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

        No search of the whole surface is needed unless one of the points is not near its triangle.
        """
        positions, nearest = np.empty_like(points), np.empty(len(points), np.int64)
        squares, surface = np.empty(len(points)), (self.mesh.vertices, self.surface)
        for candidates in self.candidates.values():  # sites are on one side or on none
            if nearest_of(points, triangles, candidates, *surface, positions, nearest, squares):
                return self._located(positions, nearest, squares)
        return self.on_surface(points)

    def _located(self, positions: Floats, triangles: Integers, squares: Floats) -> LocatedPoints:
        elements = self.owner[triangles]
        elements = np.where(self.conducts[elements], elements, -1)
        unknown = np.zeros((len(elements), 4)), np.full((len(elements), 4), np.inf)
        return LocatedPoints(positions, elements, triangles, np.sqrt(squares), *unknown)

    @cached_property
    def _cells(self) -> tuple[Integers, Any]:
        """Corners of the elements, and the search tree of these."""
        corners = self.mesh.corners.astype(np.int64)
        return corners, search_tree(self.mesh.vertices, corners)

    def inside(self, points: Floats) -> LocatedPoints:
        """Points in the tissue; those outside are moved to the nearest point of its surface."""
        site = self.on_surface(points)
        positions = site.positions.copy()
        for k, point in enumerate(points):
            corners, cells = self._cells
            around = np.array(cells.find(self.mesh.vertices, corners, point), dtype=np.int64)
            if around.size:
                conducting = around[self.conducts[around]]
                site.elements[k] = conducting[0] if conducting.size else -1
                positions[k], site.distances[k] = point, 0.0
        return site._replace(positions=positions)


@dataclass(frozen=True)
class Coupling:
    """Trees and stimuli attached to the myocardium: all that does not depend on when they fire.

    Sites are numbered junctions first, tree by tree, then stimuli. The last node is the His bundle,
    whose children are the roots of all trees; it does not conduct unless `activation.solve` is
    given a bundle.

    Attributes
    ----------
    myocardium : Myocardium
        Myocardium that they are attached to.
    trees : tuple of PurkinjeTree
        Any number of trees.
    located : LocatedPoints
        Where junctions and stimuli lie in the myocardium.
    nodes : (k + 1,) array
        Where each tree's nodes start, counting on from the mesh's vertices; after them come the
        stimuli, a node each, and the His bundle.
    roots : (k,) array
        The node of each tree's root.
    junctions : (k + 1,) array
        Where each tree's junctions start among the sites.
    lengths : (n_nodes,) array
        Length of the segment that ends in each node (mm), tree by tree, then stimuli and the
        His bundle.
    forest, sites : Forest, JunctionSites
        Input of the sweep, with neither travel times nor delays.
    """

    myocardium: Myocardium
    trees: tuple[PurkinjeTree, ...]
    located: LocatedPoints
    nodes: Integers
    roots: Integers
    junctions: Integers
    lengths: Floats
    forest: Forest
    sites: JunctionSites

    @property
    def stimuli(self) -> LocatedPoints:
        """Locations of the stimuli in the myocardium."""
        return LocatedPoints._make(values[self.junctions[-1] :] for values in self.located)

    @property
    def stimulus_nodes(self) -> slice:
        """The nodes of the stimuli."""
        return slice(self.nodes[-1], len(self.lengths) - 1)


def attach(
    myocardium: Myocardium,
    trees: Sequence[PurkinjeTree],
    points: Floats | None = None,
    sources: int | None = None,
) -> Coupling:
    """Find where any number of trees, and stimuli at points (s, 3) (mm), meet the myocardium.

    Junctions are moved to the nearest point of the tissue's surface, and so are stimuli outside.
    Rays from the first points, `sources` of them or all, go to every vertex; those from the others,
    vertices that a stimulus captures, reach as far as from junctions.
    """
    stimuli = np.empty((0, 3)) if points is None else np.asarray(points, float).reshape(-1, 3)
    located = _locate_junctions(myocardium, trees)
    to_vertices = rays_to_mesh(located, located.triangles, myocardium)
    if len(stimuli):
        sources = len(stimuli) if sources is None else sources
        located_stimuli, from_stimuli = _locate_stimuli(myocardium, stimuli, sources)
        located = _joined(located, located_stimuli)
        to_vertices = _joined_rays(to_vertices, from_stimuli)
    nodes, junctions = (
        np.cumsum([0, *map(len, parts)])
        for parts in ([tree.nodes for tree in trees], [tree.junctions for tree in trees])
    )
    his = int(nodes[-1]) + len(stimuli)
    junction_nodes = [t.junctions + first for t, first in zip(trees, nodes[:-1], strict=True)]
    site_node = np.concatenate([*junction_nodes, np.arange(nodes[-1], his)]).astype(np.int64)
    node_site = np.full(his + 1, -1, dtype=np.int64)
    node_site[site_node] = np.arange(len(site_node))
    parents, lengths = np.full(his + 1, -1, dtype=np.int64), np.zeros(his + 1)
    for tree, first in zip(trees, nodes[:-1], strict=True):
        part = slice(first, first + len(tree.nodes))
        parents[part] = np.where(tree.parents >= 0, tree.parents + first, -1)
        lengths[part] = tree.lengths
    order = np.concatenate([[his], _parents_first(parents[:his])])
    roots = nodes[:-1] + np.array([tree.root for tree in trees], dtype=np.int64)
    parents[roots] = his
    child = np.flatnonzero(parents >= 0)
    child_start, by_parent = grouped(parents[child], len(parents))
    no_delay = np.zeros(len(site_node))
    attached = np.flatnonzero(located.elements >= 0)
    corners = myocardium.mesh.corners[located.elements[attached]].ravel()
    reader_start, by_corner = grouped(corners, len(myocardium.mesh.vertices))
    sites = JunctionSites(
        element=located.elements,
        to_corner=located.to_corner,
        node=site_node + len(myocardium.mesh.vertices),
        anterograde=no_delay,
        retrograde=no_delay,
        reader_start=reader_start,
        reader=attached[by_corner // CORNERS],
        to_vertices=to_vertices,
        to_sites=_rays_between(located, to_vertices, myocardium.mesh),
    )
    forest = Forest(order, parents, no_delay[:0], child_start, child[by_parent], node_site)
    return Coupling(
        myocardium, tuple(trees), located, nodes, roots, junctions, lengths, forest, sites
    )


def _locate_junctions(myocardium: Myocardium, trees: Sequence[PurkinjeTree]) -> LocatedPoints:
    """Find the points of the tissue's surface that are nearest to the trees' junctions."""
    located = [myocardium.on_surface(np.empty((0, 3)))] if not trees else []
    for tree in trees:
        points = tree.nodes[tree.junctions]
        if tree.triangles is None or len(tree.triangles) != len(tree.nodes):
            located.append(myocardium.on_surface(points))
        else:
            located.append(myocardium.on_surface_from(tree.triangles[tree.junctions], points))
    return _joined(*located)


def _locate_stimuli(
    myocardium: Myocardium, points: Floats, sources: int
) -> tuple[LocatedPoints, RayTravelTimes]:
    """Find points in the myocardium and the rays from them; the last result is cached."""
    key = points.tobytes(), sources
    stimuli = myocardium.last_stimuli.get(key)
    if stimuli is None:
        located = myocardium.inside(points)
        centres = LocatedPoints._make(values[:sources] for values in located)
        captured = LocatedPoints._make(values[sources:] for values in located)
        nowhere = np.full(len(captured.elements), -1)  # in no triangle, so their rays are traced
        rays = rays_to_mesh(centres, None, myocardium)
        rays = _joined_rays(rays, rays_to_mesh(captured, nowhere, myocardium))
        stimuli = located, rays
        myocardium.last_stimuli.clear()
        myocardium.last_stimuli[key] = stimuli
    return stimuli


def rays_to_mesh(
    located: LocatedPoints, triangles: Integers | None, myocardium: Myocardium
) -> RayTravelTimes:
    """Find the ray travel times from sites to the vertices around them.

    `barycentric` and `to_corner` of the sites are filled in. Times are read from the myocardium's
    table by the boundary triangle (j,) that each site lies in, -1 for none; where the table lacks
    the triangle, rays are traced as far as it reaches. Without triangles, rays from all sites are
    traced, to every vertex.
    """
    mesh, table, elements = myocardium.mesh, myocardium.travel_times, located.elements
    count = len(elements)
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
            located.positions[off], reach * (1 + 1e-9), return_length=True
        )
    rays = _room(count, int((room + CORNERS)[elements >= 0].sum()))
    rays_to_vertices(located, rows, opposite, mesh, table, reach, longest, rays)
    return _used(rays)


def _rays_between(
    sites: LocatedPoints, to_vertices: RayTravelTimes, mesh: EikonalMesh
) -> RayTravelTimes:
    """Find the ray travel times from sites to the other sites around them."""
    attached = np.flatnonzero(sites.elements >= 0)
    first = mesh.corners[sites.elements[attached], 0]
    order = np.argsort(first, kind="stable")
    time_to = np.full(len(mesh.vertices), np.inf)
    room = _room(len(sites.elements), 16 * len(attached) + 1)  # usually enough
    return _used(
        rays_to_sites(sites, attached[order], first[order], mesh, to_vertices, time_to, room)
    )


def _joined(*located: LocatedPoints) -> LocatedPoints:
    return LocatedPoints._make(map(np.concatenate, zip(*located, strict=True)))


def _joined_rays(first: RayTravelTimes, second: RayTravelTimes) -> RayTravelTimes:
    """Rays of some sites, then of others."""
    return RayTravelTimes(
        np.concatenate([first.start, first.start[-1] + second.start[1:]]),
        np.concatenate([first.target, second.target]),
        np.concatenate([first.time, second.time]),
    )


def _room(sites: int, most: int) -> RayTravelTimes:
    return RayTravelTimes(np.empty(sites + 1, np.int64), np.empty(most, np.int32), np.empty(most))


def _used(rays: RayTravelTimes) -> RayTravelTimes:
    used = rays.start[-1]
    return RayTravelTimes(rays.start, rays.target[:used], rays.time[:used])


def _parents_first(parents: Integers) -> Integers:
    """Order of the nodes with parents first; by number if parents have lower numbers already."""
    order = np.arange(len(parents))
    if (parents < order).all():
        return order
    depth, above = np.zeros(len(parents), dtype=np.int64), parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, parents[above], -1)
    return np.argsort(depth, kind="stable")


def grouped(groups: NDArray[np.integer], count: int) -> tuple[Integers, Integers]:
    """Items sorted by group (n,), stably: starts (count + 1,) of the groups, and the order (n,)."""
    sizes = np.bincount(groups, minlength=count)
    return np.concatenate([[0], np.cumsum(sizes)]), np.argsort(groups, kind="stable")


def search_tree(vertices: Floats, cells: Integers) -> igl.AABB:
    """Search tree that finds the triangle or tetrahedron nearest to a point."""
    tree = igl.AABB()
    tree.init(vertices, cells)
    return tree
