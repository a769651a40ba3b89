"""Activation of trees and myocardium together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fascicle.forward.eikonal.myocardium import Site, Tissue
from fascicle.forward.eikonal.ray_travel_times import Around, grouped, look_around, look_beside
from fascicle.kernels.arrays import Forest, Queue, Sites, Ways
from fascicle.kernels.coupled import settle_trees, sweep
from fascicle.purkinje.tree import PurkinjeTree

FROM_ROOT = -1  # origin of what no site has fired: a tree's own root, or nothing at all


@dataclass(frozen=True)
class Coupling:
    """Trees and stimuli attached to a tissue: all that does not depend on when they fire.

    Sites are numbered junctions first, tree by tree, then stimuli.

    Attributes
    ----------
    trees : tuple of PurkinjeTree
        Any number of trees.
    site : Site
        Where junctions and stimuli lie in the tissue.
    nodes : (k + 1,) array
        Where each tree's nodes start, counting on from the mesh's vertices; after them come the
        stimuli, a node each.
    junctions : (k + 1,) array
        Where each tree's junctions start among the sites.
    lengths : (n_nodes,) array
        Length of the segment that ends in each node (mm), tree by tree, then stimuli.
    forest, sites : Forest, Sites
        As the sweep wants them, with neither travel times nor delays.
    """

    trees: tuple[PurkinjeTree, ...]
    site: Site
    nodes: NDArray[np.int64]
    junctions: NDArray[np.int64]
    lengths: NDArray[np.float64]
    forest: Forest
    sites: Sites


@dataclass(frozen=True)
class Activation:
    """When the front arrives, and from where.

    Attributes
    ----------
    myocardium : (n,) array
        Time at each vertex of the mesh (ms); inf where no front arrives.
    trees : tuple of (n_nodes,) arrays
        Time at each node of each tree (ms); inf where no front arrives.
    origin : (n,) array
        Which site fired each vertex: junctions are counted tree by tree, stimuli after them; -1
        where no front arrives.
    antidromic : tuple of (n_junctions,) bool arrays
        Which junctions the myocardium fired before their tree could.
    entered_by : tuple of (n_junctions,) arrays
        For an antidromic junction the site whose front entered it, else -1.
    stimuli, stimulus_times : (n_stimuli, 3) and (n_stimuli,) arrays
        Where (mm) and when (ms) the myocardium was stimulated.
    captured : (n_stimuli,) bool array
        Which of the stimuli came before any front was there.
    junction_distances : tuple of (n_junctions,) arrays
        How far each junction lies from where it meets the tissue (mm).
    """

    myocardium: NDArray[np.float64]
    trees: tuple[NDArray[np.float64], ...]
    origin: NDArray[np.int64]
    antidromic: tuple[NDArray[np.bool_], ...]
    entered_by: tuple[NDArray[np.int64], ...]
    stimuli: NDArray[np.float64]
    stimulus_times: NDArray[np.float64]
    captured: NDArray[np.bool_]
    junction_distances: tuple[NDArray[np.float64], ...]


def attach(
    tissue: Tissue, trees: Sequence[PurkinjeTree], points: NDArray[np.float64] | None = None
) -> Coupling:
    """Find where trees and stimuli meet the tissue.

    Parameters
    ----------
    tissue : Tissue
        The myocardium.
    trees : sequence of PurkinjeTree
        Any number of trees; junctions are moved to the nearest point of the tissue's surface.
    points : (s, 3) array, optional
        Stimuli in the myocardium (mm); those outside are moved to its surface.
    """
    stimuli = np.empty((0, 3)) if points is None else np.asarray(points, float).reshape(-1, 3)
    leaves = np.concatenate([*(tree.nodes[tree.junctions] for tree in trees), np.empty((0, 3))])
    site = tissue.on_surface(leaves)
    around = look_around(site.positions, site.elements, site.triangles, tissue.mesh, tissue.table)
    if len(stimuli):
        site, around = _with_stimuli(tissue, site, around, stimuli)
    nodes = _starts([len(tree.nodes) for tree in trees])
    junctions = _starts([len(tree.junctions) for tree in trees])
    count = int(nodes[-1]) + len(stimuli)
    site_node = np.concatenate(
        [
            *(t.junctions + first for t, first in zip(trees, nodes[:-1], strict=True)),
            np.arange(nodes[-1], count),
        ]
    ).astype(np.int64)
    node_site = np.full(count, -1, dtype=np.int64)
    node_site[site_node] = np.arange(len(site_node))
    parents, lengths = _joined(trees, nodes, count)
    no_delay = np.zeros(len(site_node))
    sites = Sites(
        site.elements,
        around.to_corner,
        site_node + len(tissue.mesh.vertices),
        no_delay,
        no_delay,
        *_readers(tissue, site),
        around.near,
        look_beside(site.positions, site.elements, around, tissue.mesh),
    )
    forest = Forest(_parents_first(parents), parents, no_delay[:0], *_children(parents), node_site)
    return Coupling(tuple(trees), site, nodes, junctions, lengths, forest, sites)


def solve(
    tissue: Tissue,
    coupling: Coupling,
    root_times: Sequence[float],
    cv: float,
    *,
    stimuli: Sequence[float] = (),
    node_times: Sequence[tuple[int, int, float]] = (),
    speed: ArrayLike = 1.0,
    orthodromic_delay: ArrayLike = 0.0,
    antidromic_delay: ArrayLike = 0.0,
) -> Activation:
    """Solve the coupled eikonal problem, orthodromic and antidromic, in one sweep.

    Equivalent to the limit of the paper's alternation between trees and myocardium.

    Parameters
    ----------
    tissue : Tissue
        The myocardium.
    coupling : Coupling
        Trees and stimuli attached to it.
    root_times : sequence of float
        When each root fires (ms); inf for a root that never does.
    cv : float
        Speed in the trees (mm/ms).
    stimuli : sequence of float
        When each stimulus in the myocardium fires (ms).
    node_times : sequence of (tree, node, time)
        Stimuli in the trees (ms).
    speed : float or (n_nodes,) array
        Factor on the speed of the segment that ends in each node, tree by tree; 0 blocks it.
    orthodromic_delay, antidromic_delay : float or (n_junctions,) arrays
        Delays of the junctions (ms), tree by tree; inf blocks that way.
    """
    if len(root_times) != len(coupling.trees):
        raise ValueError(f"{len(root_times)} root times for {len(coupling.trees)} trees")
    vertices, count = len(tissue.mesh.vertices), len(coupling.lengths)
    time = np.full(vertices + count, np.inf)
    firing = time[vertices:]
    for tree, first, root_time in zip(coupling.trees, coupling.nodes[:-1], root_times, strict=True):
        firing[first + tree.root] = root_time
    for tree_number, node, moment in node_times:
        first = coupling.nodes[tree_number]
        firing[first + node] = min(moment, firing[first + node])
    firing[coupling.nodes[-1] :] = stimuli
    stimulated = firing[coupling.nodes[-1] :].copy()
    sites, junctions = len(coupling.sites.node), int(coupling.junctions[-1])
    delays = np.zeros((2, sites))
    delays[:, :junctions] = (
        np.broadcast_to(orthodromic_delay, junctions),
        np.broadcast_to(antidromic_delay, junctions),
    )
    factor = np.ones(count)
    factor[: coupling.nodes[-1]] = speed
    travel = np.full(count, np.inf)  # what is blocked takes forever
    np.divide(coupling.lengths, cv * factor, out=travel, where=factor > 0)
    forest = coupling.forest._replace(time=travel)
    settle_trees(firing, forest)
    origin = np.full(vertices + count, FROM_ROOT)
    entered_by = np.full(sites, -1)
    sweep(
        time,
        origin,
        entered_by,
        coupling.sites.node[np.isfinite(time[coupling.sites.node])],
        tissue.mesh,
        forest,
        coupling.sites._replace(orthodromic=delays[0], antidromic=delays[1]),
        _queue(len(time)),
    )
    # a site that a front has entered passes it on under its own number; the front is another's
    front = np.arange(sites)
    for _ in range(sites):  # as often as a front can be passed on
        if not (entered_by[front] >= 0).any():
            break
        front = np.where(entered_by[front] >= 0, entered_by[front], front)
    origin = np.where(origin >= 0, front[origin], FROM_ROOT) if sites else origin
    entered_by = np.where(entered_by >= 0, front, -1)
    entered = _pieces(entered_by, coupling.junctions)
    myocardium, fired_by = np.empty(vertices), np.empty(vertices, dtype=np.int64)
    myocardium[tissue.order], fired_by[tissue.order] = time[:vertices], origin[:vertices]
    return Activation(
        myocardium,
        _pieces(firing, coupling.nodes),
        fired_by,
        tuple(by >= 0 for by in entered),
        entered,
        coupling.site.positions[junctions:],
        stimulated,
        (firing[coupling.nodes[-1] :] == stimulated) & (coupling.site.elements[junctions:] >= 0),
        _pieces(coupling.site.distances, coupling.junctions),
    )


def solve_from_vertices(tissue: Tissue, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve the eikonal equation in the myocardium alone, from times at vertices.

    First order: without a site there is no straight way.

    Parameters
    ----------
    tissue : Tissue
        The myocardium.
    times : (n,) array
        When each vertex of the heart is fired (ms); inf where it is not.

    Returns
    -------
    (n,) array
        Activation times (ms); inf where no front arrives.
    """
    count = len(times)
    time = np.ascontiguousarray(times[tissue.order])
    none, zero, nothing = np.empty(0, np.int64), np.zeros(1, np.int64), np.empty(0)
    nowhere = Ways(zero, np.empty(0, np.int32), nothing)
    sites = Sites(
        none, np.empty((0, 4)), none, nothing, nothing, np.zeros(count + 1, np.int64), none,
        nowhere, nowhere,
    )  # fmt: skip
    sweep(
        time, np.full(count, FROM_ROOT), none, np.flatnonzero(np.isfinite(time)), tissue.mesh,
        Forest(none, none, nothing, zero, none, none), sites, _queue(count),
    )  # fmt: skip
    solved = np.empty(count)
    solved[tissue.order] = time
    return solved


def _queue(nodes: int) -> Queue:
    return Queue(np.empty(nodes, dtype=np.int64), np.full(nodes, -1))


def _with_stimuli(
    tissue: Tissue, site: Site, around: Around, points: NDArray[np.float64]
) -> tuple[Site, Around]:
    """Add points in the myocardium to sites; those of last time are remembered."""
    key = points.tobytes()
    known = tissue.remembered.get(key)
    if known is None:
        there = tissue.inside(points)
        around_them = look_around(there.positions, there.elements, None, tissue.mesh, tissue.table)
        known = there, around_them
        tissue.remembered.clear()
        tissue.remembered[key] = known
    return site.joined_with(known[0]), around.joined_with(known[1])


def _starts(sizes: Sequence[int]) -> NDArray[np.int64]:
    """Where each of several consecutive pieces starts, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(np.asarray(sizes, dtype=np.int64))])


def _pieces(values: NDArray[Any], starts: NDArray[np.int64]) -> tuple[NDArray[Any], ...]:
    return tuple(values[a:b] for a, b in pairwise(starts))


def _joined(
    trees: Sequence[PurkinjeTree], nodes: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Parents and lengths of the trees as one."""
    parents, lengths = np.full(count, -1, dtype=np.int64), np.zeros(count)
    for tree, first in zip(trees, nodes[:-1], strict=True):
        part = slice(first, first + len(tree.nodes))
        parents[part] = np.where(tree.parents >= 0, tree.parents + first, -1)
        lengths[part] = tree.lengths
    return parents, lengths


def _children(parents: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each node's children start, and the children."""
    child = np.flatnonzero(parents >= 0)
    start, order = grouped(parents[child], len(parents))
    return start, child[order]


def _parents_first(parents: NDArray[np.int64]) -> NDArray[np.int64]:
    """The nodes, each after its parent; in their own order if that is so."""
    order = np.arange(len(parents))
    if (parents < order).all():
        return order
    depth, above = np.zeros(len(parents), dtype=np.int64), parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, parents[above], -1)
    return np.argsort(depth, kind="stable")


def _readers(tissue: Tissue, site: Site) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The sites whose element has each vertex as a corner, as start and list."""
    attached = np.flatnonzero(site.elements >= 0)
    corners = tissue.mesh.corners[site.elements[attached]].ravel()
    start, order = grouped(corners, len(tissue.mesh.vertices))
    return start, attached[order // 4]
