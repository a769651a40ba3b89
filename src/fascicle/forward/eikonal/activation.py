"""Activation times of trees and myocardium by the coupled eikonal problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.ranges import short_repr
from fascicle.forward.eikonal.myocardium import Coupling
from fascicle.kernels.arrays import (
    CHOSEN,
    CORNERS,
    NEAR,
    STATE,
    EikonalMesh,
    Front,
    Queue,
    Surroundings,
)
from fascicle.kernels.coupled import LANES, LAST, Bucket, FaceRow, solve_trees, sweep


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
        Site whose front activated each vertex, counted by junctions tree by tree, then stimuli; -1
        where no front arrives.
    retrograde : tuple of (n_junctions,) bool arrays
        Masks of the junctions that the myocardium activated before their tree could.
    entered_by : tuple of (n_junctions,) arrays
        For a retrograde junction the site whose front entered it, else -1.
    stimuli, stimulus_times : (n_stimuli, 3) and (n_stimuli,) arrays
        Where (mm) and when (ms) the myocardium was stimulated.
    captured : (n_stimuli,) bool array
        Mask of the stimuli that came before any front arrived there.
    junction_distances : tuple of (n_junctions,) arrays
        Distance of each junction from the point where it is attached to the tissue (mm).
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

    The result is the limit of the alternation between trees and myocardium of Álvarez-Barrientos et
    al. (their equations `eikotree`, `eikomyo` and `eikoiter`).

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
        Bundle that joins the roots; without it a front that arrives at a root ends there.
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
            his=None
            if his is None
            else HisBundle(tissue_speed * his.fires, [tissue_speed * t for t in his.branches]),
        )
        return replace(
            slowed,
            myocardium=slowed.myocardium / tissue_speed,
            trees=tuple(times / tissue_speed for times in slowed.trees),
            stimulus_times=slowed.stimulus_times / tissue_speed,
            his=slowed.his / tissue_speed,
        )
    if len(root_times) != len(coupling.trees):
        raise ValueError(f"{len(root_times)} root times for {len(coupling.trees)} trees")
    mesh, sites = coupling.myocardium.mesh, coupling.sites
    vertices, nodes = len(mesh.vertices), len(coupling.lengths)
    front = initial_front(mesh, nodes, len(sites.node))
    in_trees = np.full(nodes, np.inf)
    in_trees[coupling.roots] = root_times
    for tree, node, moment in node_times:
        place = coupling.nodes[tree] + node
        in_trees[place] = min(moment, in_trees[place])
    in_trees[coupling.stimulus_nodes] = stimuli
    stimulus_times = in_trees[coupling.stimulus_nodes].copy()
    factor, travel = np.ones(nodes), np.full(nodes, np.inf)
    factor[: coupling.nodes[-1]] = speed
    np.divide(coupling.lengths, cv * factor, out=travel, where=factor > 0)
    travel[coupling.roots] = his.branches if his is not None else np.inf
    in_trees[-1] = his.fires if his is not None else np.inf
    anterograde, retrograde = np.zeros((2, len(sites.node)))  # delays of stimuli are 0
    anterograde[: coupling.junctions[-1]] = anterograde_delay
    retrograde[: coupling.junctions[-1]] = retrograde_delay
    forest = coupling.forest._replace(time=travel)
    solve_trees(in_trees, forest)
    front.nodes["time"][vertices:] = in_trees
    sources = sites.node[np.isfinite(in_trees[sites.node - vertices])]
    sites = sites._replace(anterograde=anterograde, retrograde=retrograde)
    sweep(front, sources, mesh, forest, sites)
    return _activation(coupling, front, stimulus_times)


def initial_front(mesh: EikonalMesh, tree_nodes: int, sites: int) -> Front:
    """Initial front, before anything has fired."""
    nodes = np.empty(len(mesh.vertices) + tree_nodes, STATE)
    nodes["time"], nodes["origin"], nodes["bucket"] = np.inf, -1, Bucket.NOT_QUEUED
    # nearly all times that wait lie within 200 ms: the queue's ring has buckets for them
    queue = Queue(head=np.full(4096, -1, np.int32), now=np.array([LAST], np.int64))
    batch = 8  # vertices at a time, at most
    neighbours = batch * int(np.diff(mesh.link_start).max(initial=0))
    elements = batch * int(np.diff(mesh.star_start).max(initial=0)) + 1  # and a spare one
    faces = (CORNERS - 1) * elements
    around = Surroundings(
        batch=np.empty(batch, dtype=np.int64),
        now=np.empty(batch),
        time=np.empty(neighbours),
        near=np.empty(neighbours, NEAR),
        chosen=np.empty(elements, CHOSEN),
        face=np.empty(faces, np.uint32),
        faces=np.zeros((-(-faces // LANES), FaceRow.COUNT * LANES)),
    )
    return Front(nodes, np.full(sites, -1), queue, around)


def _activation(coupling: Coupling, front: Front, stimulus_times: Floats) -> Activation:
    """Result of the sweep, in the heart's vertex numbers and tree by tree."""
    order, vertices = coupling.myocardium.order, len(coupling.myocardium.order)
    times = np.ascontiguousarray(front.nodes["time"])
    in_trees, origin, entered_by = times[vertices:], front.nodes["origin"], front.entered_by
    if len(entered_by):
        # a site that a front has entered passes it on under its own number, not under that of the
        # site at which it first came into the myocardium
        first = np.arange(len(entered_by))
        for _ in first:  # at most as often as a front can be passed on
            if not (entered_by[first] >= 0).any():
                break
            first = np.where(entered_by[first] >= 0, entered_by[first], first)
        origin = np.where(origin >= 0, first[origin], -1)
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


def _pieces(values: NDArray[Any], starts: Integers) -> tuple[NDArray[Any], ...]:
    return tuple(values[a:b] for a, b in pairwise(starts))
