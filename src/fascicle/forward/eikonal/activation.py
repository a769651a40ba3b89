"""Activation of trees and myocardium together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.ranges import short_repr
from fascicle.forward.eikonal.myocardium import LocatedPoints, Myocardium
from fascicle.forward.eikonal.ray_travel_times import (
    SiteNeighbourhood,
    find_neighbourhood,
    grouped,
    rays_between_sites,
)
from fascicle.kernels.arrays import (
    CORNERS,
    NEAR,
    STATE,
    EikonalMesh,
    Forest,
    Front,
    JunctionSites,
    Queue,
    Surroundings,
)
from fascicle.kernels.coupled import solve_trees, sweep
from fascicle.kernels.queue import LAST, NOT_QUEUED, RING
from fascicle.kernels.star import FACES_BLOCK, LANES, VERTICES_AT_ONCE
from fascicle.purkinje.tree import PurkinjeTree

FROM_ROOT = -1  # origin of a node that no site has fired: fired from a root, or not at all


@dataclass(frozen=True)
class HisBundle:
    """Bundle that joins the roots of the trees and conducts both ways.

    Attributes
    ----------
    fires : float
        Time of its activation from outside (ms); inf if there is none.
    branches : sequence of float
        Travel time to the root of each tree (ms); inf where it is blocked, or goes to none.
    """

    fires: float
    branches: Sequence[float]

    def slowed(self, factor: float) -> HisBundle:
        """Bundle with all times multiplied by `factor`."""
        return HisBundle(factor * self.fires, [factor * time for time in self.branches])


@dataclass(frozen=True)
class Coupling:
    """Trees and stimuli attached to the myocardium: all that does not depend on when they fire.

    Sites are numbered junctions first, tree by tree, then stimuli. On the last node, the His
    bundle, hang the roots of all trees; nothing passes there unless `solve` is given a bundle.

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


@dataclass(frozen=True)
class Activation:
    """Activation times of trees and myocardium, and the sites that the fronts come from.

    Attributes
    ----------
    myocardium : (n,) array
        Time at each vertex of the mesh (ms); inf where no front arrives.
    trees : tuple of (n_nodes,) arrays
        Time at each node of each tree (ms); inf where no front arrives.
    origin : (n,) array
        Which site fired each vertex: junctions are counted tree by tree, stimuli after them; -1
        where no front arrives.
    retrograde : tuple of (n_junctions,) bool arrays
        Which junctions the myocardium fired before their tree could.
    entered_by : tuple of (n_junctions,) arrays
        For a retrograde junction the site whose front entered it, else -1.
    stimuli, stimulus_times : (n_stimuli, 3) and (n_stimuli,) arrays
        Where (mm) and when (ms) the myocardium was stimulated.
    captured : (n_stimuli,) bool array
        Which of the stimuli came before any front was there.
    junction_distances : tuple of (n_junctions,) arrays
        How far each junction lies from where it meets the tissue (mm).
    his : float
        Time at the His bundle (ms); inf where there is none, or no front arrives.
    """

    myocardium: Floats
    trees: tuple[Floats, ...] = ()
    origin: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    retrograde: tuple[Booleans, ...] = ()
    entered_by: tuple[Integers, ...] = ()
    stimuli: Floats = field(default_factory=lambda: np.empty((0, 3)))
    stimulus_times: Floats = field(default_factory=lambda: np.empty(0))
    captured: Booleans = field(default_factory=lambda: np.empty(0, bool))
    junction_distances: tuple[Floats, ...] = ()
    his: float = np.inf

    __repr__ = short_repr

    def with_clock(self, speed: float) -> Activation:
        """Activation on a time scale `speed` times as fast: all times divided by it."""
        return replace(
            self,
            myocardium=self.myocardium / speed,
            trees=tuple(times / speed for times in self.trees),
            stimulus_times=self.stimulus_times / speed,
            his=self.his / speed,
        )


def attach(
    myocardium: Myocardium,
    trees: Sequence[PurkinjeTree],
    points: Floats | None = None,
    sources: int | None = None,
) -> Coupling:
    """Find where trees and stimuli meet the myocardium.

    Parameters
    ----------
    myocardium : Myocardium
        The myocardium.
    trees : sequence of PurkinjeTree
        Any number of trees; junctions are moved to the nearest point of the tissue's surface.
    points : (s, 3) array, optional
        Stimuli in the myocardium (mm); those outside are moved to its surface.
    sources : int, optional
        Number of points, the first ones, with rays to every vertex; rays from the others, vertices
        that a stimulus captures, reach as far as from junctions. By default all points.
    """
    stimuli = np.empty((0, 3)) if points is None else np.asarray(points, float).reshape(-1, 3)
    located = _locate_junctions(myocardium, trees)
    neighbourhood = _neighbourhood(located, located.triangles, myocardium)
    if len(stimuli):
        sources = len(stimuli) if sources is None else sources
        located_stimuli, around_them = _locate_stimuli(myocardium, stimuli, sources)
        located = LocatedPoints._make(
            map(np.concatenate, zip(located, located_stimuli, strict=True))
        )
        neighbourhood = neighbourhood.joined_with(around_them)
    nodes = _starts([len(tree.nodes) for tree in trees])
    junctions = _starts([len(tree.junctions) for tree in trees])
    his = int(nodes[-1]) + len(stimuli)
    junction_nodes = [t.junctions + first for t, first in zip(trees, nodes[:-1], strict=True)]
    site_node = np.concatenate([*junction_nodes, np.arange(nodes[-1], his)]).astype(np.int64)
    node_site = np.full(his + 1, -1, dtype=np.int64)
    node_site[site_node] = np.arange(len(site_node))
    parents, lengths = _joined(trees, nodes, his)
    order = np.concatenate([[his], _parents_first(parents[:his])])
    roots = nodes[:-1] + np.array([tree.root for tree in trees], dtype=np.int64)
    parents[roots] = his
    no_delay = np.zeros(len(site_node))
    reader_start, reader = _readers(myocardium, located)
    sites = JunctionSites(
        element=located.elements,
        to_corner=neighbourhood.sites.to_corner,
        node=site_node + len(myocardium.mesh.vertices),
        anterograde=no_delay,
        retrograde=no_delay,
        reader_start=reader_start,
        reader=reader,
        to_vertices=neighbourhood.to_vertices,
        to_sites=rays_between_sites(neighbourhood, myocardium.mesh),
    )
    forest = Forest(order, parents, no_delay[:0], *_children(parents), node_site)
    return Coupling(
        myocardium, tuple(trees), located, nodes, roots, junctions, lengths, forest, sites
    )


def solve(
    coupling: Coupling,
    root_times: Sequence[float],
    cv: float,
    *,
    stimuli: Sequence[float] = (),
    node_times: Sequence[tuple[int, int, float]] = (),
    speed: ArrayLike = 1.0,
    anterograde_delay: ArrayLike = 0.0,
    retrograde_delay: ArrayLike = 0.0,
    tissue_speed: float = 1.0,
    his: HisBundle | None = None,
) -> Activation:
    """Solve the coupled eikonal problem, anterograde and retrograde, in one sweep.

    Equivalent to the limit of the paper's alternation between trees and myocardium (equations
    `eikotree`, `eikomyo` and `eikoiter`).

    Parameters
    ----------
    coupling : Coupling
        Trees and stimuli attached to the myocardium.
    root_times : sequence of float
        When each root fires (ms); inf for a root that never does.
    cv : float
        Purkinje conduction velocity (mm/ms).
    stimuli : sequence of float
        When each stimulus in the myocardium fires (ms).
    node_times : sequence of (tree, node, time)
        Stimuli in the trees (ms).
    speed : float or (n_nodes,) array
        Factor on the speed of the segment that ends in each node, tree by tree; 0 blocks it.
    anterograde_delay, retrograde_delay : float or (n_junctions,) arrays
        Delays of the junctions (ms), tree by tree; inf blocks that direction.
    tissue_speed : float
        Factor c on all speeds of the myocardium, by time scaling: all other times are multiplied by
        c, the unchanged myocardium is activated, and all times are divided by c. Nothing needs to
        be prepared again.
    his : HisBundle, optional
        Joins the roots; without it a front that comes to a root ends there.
    """
    if tissue_speed != 1.0:
        slowed = solve(
            coupling,
            [tissue_speed * time for time in root_times],
            cv / tissue_speed,
            stimuli=[tissue_speed * time for time in stimuli],
            node_times=[(tree, node, tissue_speed * time) for tree, node, time in node_times],
            speed=speed,
            anterograde_delay=tissue_speed * np.asarray(anterograde_delay),
            retrograde_delay=tissue_speed * np.asarray(retrograde_delay),
            his=his.slowed(tissue_speed) if his is not None else None,
        )
        return slowed.with_clock(tissue_speed)
    if len(root_times) != len(coupling.trees):
        raise ValueError(f"{len(root_times)} root times for {len(coupling.trees)} trees")
    mesh, sites = coupling.myocardium.mesh, coupling.sites
    vertices, nodes = len(mesh.vertices), len(coupling.lengths)
    front = initial_front(mesh, nodes, len(sites.node))
    in_trees = _firing_times(coupling, root_times, stimuli, node_times)
    stimulus_times = in_trees[coupling.stimulus_nodes].copy()
    travel = _segment_times(coupling, cv, speed)
    travel[coupling.roots] = his.branches if his is not None else np.inf
    in_trees[-1] = his.fires if his is not None else np.inf
    forest = coupling.forest._replace(time=travel)
    solve_trees(in_trees, forest)
    front.nodes["time"][vertices:] = in_trees
    sources = sites.node[np.isfinite(in_trees[sites.node - vertices])]
    anterograde, retrograde = (
        _site_delays(coupling, d) for d in (anterograde_delay, retrograde_delay)
    )
    sites = sites._replace(anterograde=anterograde, retrograde=retrograde)
    sweep(front, sources, mesh, forest, sites)
    return _activation(coupling, front, stimulus_times)


def initial_front(mesh: EikonalMesh, tree_nodes: int, sites: int) -> Front:
    """Make a front that has not started: nothing has fired."""
    nodes = len(mesh.vertices) + tree_nodes
    state = np.empty(nodes, STATE)
    state["time"], state["origin"], state["bucket"] = np.inf, FROM_ROOT, NOT_QUEUED
    return Front(state, np.full(sites, -1), empty_queue(), _room_around(mesh))


def empty_queue() -> Queue:
    """A queue that holds no node."""
    return Queue(head=np.full(RING, -1, np.int32), now=np.array([LAST], np.int64))


def _room_around(mesh: EikonalMesh) -> Surroundings:
    """Buffers for the surroundings of any batch of vertices, and for one spare element."""
    neighbours = VERTICES_AT_ONCE * int(np.diff(mesh.link_start).max(initial=0))
    elements = VERTICES_AT_ONCE * int(np.diff(mesh.star_start).max(initial=0)) + 1
    faces = (CORNERS - 1) * elements
    return Surroundings(
        batch=np.empty(VERTICES_AT_ONCE, dtype=np.int64),
        now=np.empty(VERTICES_AT_ONCE),
        time=np.empty(neighbours),
        near=np.empty(neighbours, NEAR),
        chosen=np.empty(elements, np.uint64),
        face=np.empty(faces, np.uint32),
        faces=np.zeros(-(-faces // LANES) * FACES_BLOCK),
    )


def _firing_times(
    coupling: Coupling,
    root_times: Sequence[float],
    stimuli: Sequence[float],
    node_times: Sequence[tuple[int, int, float]],
) -> Floats:
    """External activation time of each tree node and stimulus (ms), inf where there is none."""
    firing = np.full(len(coupling.lengths), np.inf)
    firing[coupling.roots] = root_times
    for tree_number, node, moment in node_times:
        first = coupling.nodes[tree_number]
        firing[first + node] = min(moment, firing[first + node])
    firing[coupling.stimulus_nodes] = stimuli
    return firing


def _segment_times(coupling: Coupling, cv: float, speed: ArrayLike) -> Floats:
    """Travel time (ms) of the segment that ends in each node, inf where it is blocked."""
    factor = np.ones(len(coupling.lengths))
    factor[: coupling.nodes[-1]] = speed
    travel = np.full(len(factor), np.inf)
    np.divide(coupling.lengths, cv * factor, out=travel, where=factor > 0)
    return travel


def _site_delays(coupling: Coupling, of_junctions: ArrayLike) -> Floats:
    """Delay of each site (ms): of stimuli, none."""
    delays = np.zeros(len(coupling.sites.node))
    delays[: coupling.junctions[-1]] = of_junctions
    return delays


def _activation(coupling: Coupling, front: Front, stimulus_times: Floats) -> Activation:
    """Result of the sweep, in the heart's vertex numbers and tree by tree."""
    order, vertices = coupling.myocardium.order, len(coupling.myocardium.order)
    times = np.ascontiguousarray(front.nodes["time"])
    in_trees, origin, entered_by = times[vertices:], front.nodes["origin"], front.entered_by
    if len(entered_by):
        first = _first_sites(entered_by)
        origin = np.where(origin >= 0, first[origin], FROM_ROOT)
        entered_by = np.where(entered_by >= 0, first, -1)
    entered = _pieces(entered_by, coupling.junctions)
    myocardium, fired_by = np.empty(vertices), np.empty(vertices, dtype=np.int64)
    myocardium[order], fired_by[order] = times[:vertices], origin[:vertices]
    stimuli = coupling.stimuli
    return Activation(
        myocardium=myocardium,
        trees=_pieces(in_trees, coupling.nodes),
        origin=fired_by,
        retrograde=tuple(by >= 0 for by in entered),
        entered_by=entered,
        stimuli=stimuli.positions,
        stimulus_times=stimulus_times,
        captured=(in_trees[coupling.stimulus_nodes] == stimulus_times) & (stimuli.elements >= 0),
        junction_distances=_pieces(coupling.located.distances, coupling.junctions),
        his=float(in_trees[-1]),
    )


def _first_sites(entered_by: Integers) -> Integers:
    """Site at which the front that each site passes on first came into the myocardium.

    A site that a front has entered passes it on under its own number, not that of the first site.
    """
    first = np.arange(len(entered_by))
    for _ in range(len(entered_by)):  # at most as often as a front can be passed on
        if not (entered_by[first] >= 0).any():
            break
        first = np.where(entered_by[first] >= 0, entered_by[first], first)
    return first


def _neighbourhood(
    located: LocatedPoints, triangles: Integers | None, myocardium: Myocardium
) -> SiteNeighbourhood:
    return find_neighbourhood(
        located.positions, located.elements, triangles, myocardium.mesh, myocardium.travel_times
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
    return LocatedPoints._make(map(np.concatenate, zip(*located, strict=True)))


def _locate_stimuli(
    myocardium: Myocardium, points: Floats, sources: int
) -> tuple[LocatedPoints, SiteNeighbourhood]:
    """Find points in the myocardium and their neighbourhood; the last result is cached."""
    key = points.tobytes(), sources
    stimuli = myocardium.last_stimuli.get(key)
    if stimuli is None:
        located = myocardium.inside(points)
        centres = LocatedPoints._make(values[:sources] for values in located)
        captured = LocatedPoints._make(values[sources:] for values in located)
        nowhere = np.full(len(captured.elements), -1)  # in no triangle: their rays are traced
        around = _neighbourhood(centres, None, myocardium)
        stimuli = located, around.joined_with(_neighbourhood(captured, nowhere, myocardium))
        myocardium.last_stimuli.clear()
        myocardium.last_stimuli[key] = stimuli
    return stimuli


def _starts(sizes: Sequence[int]) -> Integers:
    """Starts of consecutive pieces, and the end of the last one."""
    return np.concatenate([[0], np.cumsum(np.asarray(sizes, dtype=np.int64))])


def _pieces(values: NDArray[Any], starts: Integers) -> tuple[NDArray[Any], ...]:
    return tuple(values[a:b] for a, b in pairwise(starts))


def _joined(trees: Sequence[PurkinjeTree], nodes: Integers, his: int) -> tuple[Integers, Floats]:
    """Parents and lengths of the trees as one, up to the node of the His bundle."""
    parents, lengths = np.full(his + 1, -1, dtype=np.int64), np.zeros(his + 1)
    for tree, first in zip(trees, nodes[:-1], strict=True):
        part = slice(first, first + len(tree.nodes))
        parents[part] = np.where(tree.parents >= 0, tree.parents + first, -1)
        lengths[part] = tree.lengths
    return parents, lengths


def _children(parents: Integers) -> tuple[Integers, Integers]:
    """Children of each node, as starts and list."""
    child = np.flatnonzero(parents >= 0)
    start, order = grouped(parents[child], len(parents))
    return start, child[order]


def _parents_first(parents: Integers) -> Integers:
    """Order of the nodes with parents first; that of their numbers if it is so already."""
    order = np.arange(len(parents))
    if (parents < order).all():
        return order
    depth, above = np.zeros(len(parents), dtype=np.int64), parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, parents[above], -1)
    return np.argsort(depth, kind="stable")


def _readers(myocardium: Myocardium, located: LocatedPoints) -> tuple[Integers, Integers]:
    """Sites whose element has a vertex as a corner, for each vertex, as starts and list."""
    attached = np.flatnonzero(located.elements >= 0)
    corners = myocardium.mesh.corners[located.elements[attached]].ravel()
    start, order = grouped(corners, len(myocardium.mesh.vertices))
    return start, attached[order // CORNERS]
