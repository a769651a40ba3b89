"""Activation of trees and myocardium together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fascicle.eikonal.tissue import Site, Tissue
from fascicle.kernels.coupled import sweep
from fascicle.tree.purkinje import PurkinjeTree

# Radius of the ball around a fired junction whose vertices get their time along a straight line:
# so many mean edges, and on fine meshes at least so many mm, which keeps the order of convergence.
BALL_EDGES, BALL_RADIUS = 2.0, 6.0


def default_ball_radius(edge_length: float) -> float:
    """Radius (mm) of the ball around a junction for a mesh of this mean edge length (mm)."""
    return max(BALL_EDGES * edge_length, BALL_RADIUS)


@dataclass(frozen=True)
class Activation:
    """When the front arrives.

    Attributes
    ----------
    myocardium : (n,) array
        Time at each vertex of the mesh (ms).
    trees : tuple of (n_nodes,) arrays
        Time at each node of each tree (ms).
    antidromic : tuple of (n_junctions,) bool arrays
        Which junctions the myocardium fired before their tree could.
    junction_distances : tuple of (n_junctions,) arrays
        How far each junction lies from the tissue's surface (mm).
    """

    myocardium: NDArray[np.float64]
    trees: tuple[NDArray[np.float64], ...]
    antidromic: tuple[NDArray[np.bool_], ...]
    junction_distances: tuple[NDArray[np.float64], ...]


@dataclass(frozen=True)
class Links:
    """The trees as one graph: neighbours of each node and travel times to them (ms)."""

    start: NDArray[np.int64]
    node: NDArray[np.int64]
    time: NDArray[np.float64]


def solve(
    tissue: Tissue,
    trees: Sequence[PurkinjeTree],
    root_times: Sequence[float],
    cv: float,
    *,
    ball_radius: float,
    vertex_times: Mapping[int, float] | None = None,
    orthodromic_delay: float = 0.0,
    antidromic_delay: float = 0.0,
) -> Activation:
    """Solve the coupled eikonal problem, orthodromic and antidromic, in one sweep.

    Equivalent to the limit of the paper's alternation between trees and myocardium.

    Parameters
    ----------
    tissue : Tissue
        The myocardium.
    trees : sequence of PurkinjeTree
        Any number of trees.
    root_times : sequence of float
        When each root fires (ms); inf for a root that never does.
    cv : float
        Speed in the trees (mm/ms).
    ball_radius : float
        Vertices within this distance (mm) of a fired junction get their time along the straight
        line through the tissue, which removes most of the point-source error.
    vertex_times : mapping of vertex to time, optional
        Extra stimuli at mesh vertices (ms).
    orthodromic_delay, antidromic_delay : float
        Delays of the junctions (ms).
    """
    if len(root_times) != len(trees):
        raise ValueError(f"{len(root_times)} root times for {len(trees)} trees")
    offsets = _starts([len(tree.nodes) for tree in trees])
    vertices = len(tissue.vertices)
    junctions = [tree.junctions + offset for tree, offset in zip(trees, offsets[:-1], strict=True)]
    junction_nodes = np.concatenate([*junctions, np.empty(0, np.int64)]).astype(np.int64)
    points = [tree.nodes[tree.junctions] for tree in trees]
    site = tissue.locate(np.concatenate([*points, np.empty((0, 3))]))
    time = np.full(vertices + offsets[-1], np.inf)
    for tree, offset, root_time in zip(trees, offsets[:-1], root_times, strict=True):
        time[vertices + offset + tree.root] = root_time
    for vertex, stimulus in (vertex_times or {}).items():
        time[vertex] = stimulus
    junction_of = np.full(offsets[-1], -1, dtype=np.int64)
    junction_of[junction_nodes] = np.arange(len(junction_nodes))
    links = _links(trees, offsets, cv)
    sweep(
        time, np.flatnonzero(np.isfinite(time)),
        tissue.corners, tissue.squares, tissue.vertex_start, tissue.vertex_tetrahedra,
        links.start, links.node, links.time,
        junction_of, site.elements, tissue.squares_to_corners(site),
        *tissue.balls(site, ball_radius),
        *_readers(tissue, site),
        orthodromic_delay, antidromic_delay,
    )  # fmt: skip
    tree_times = _pieces(time[vertices:], offsets)
    return Activation(
        time[:vertices],
        tree_times,
        tuple(_fired_by_myocardium(tree, t, cv) for tree, t in zip(trees, tree_times, strict=True)),
        _pieces(site.distances, _starts([len(j) for j in junctions])),
    )


def _starts(sizes: Sequence[int]) -> NDArray[np.int64]:
    """Where each of several consecutive pieces starts, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(np.asarray(sizes, dtype=np.int64))])


def _pieces(
    values: NDArray[np.float64], starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], ...]:
    return tuple(values[a:b] for a, b in pairwise(starts))


def _links(trees: Sequence[PurkinjeTree], offsets: NDArray[np.int64], cv: float) -> Links:
    child, parent, travel = [], [], []
    for tree, offset in zip(trees, offsets[:-1], strict=True):
        linked = np.flatnonzero(tree.parents >= 0)
        child.append(linked + offset)
        parent.append(tree.parents[linked] + offset)
        travel.append(tree.lengths[linked] / cv)
    none = np.empty(0)
    a, b = (np.concatenate([*side, none]).astype(np.int64) for side in (child, parent))
    tail, head = np.concatenate([a, b]), np.concatenate([b, a])
    order = np.argsort(tail, kind="stable")
    counts = np.bincount(tail, minlength=int(offsets[-1]))
    time = np.tile(np.concatenate([*travel, none]), 2)[order]
    return Links(np.concatenate([[0], np.cumsum(counts)]), head[order], time)


def _readers(tissue: Tissue, site: Site) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The junctions whose element contains each vertex, as start and list."""
    corners = tissue.corners[site.elements].ravel()
    order = np.argsort(corners, kind="stable")
    counts = np.bincount(corners, minlength=len(tissue.vertices))
    return np.concatenate([[0], np.cumsum(counts)]), order // 4


def _fired_by_myocardium(
    tree: PurkinjeTree, time: NDArray[np.float64], cv: float
) -> NDArray[np.bool_]:
    """Junctions that fired earlier than the segment that leads to them could fire them."""
    parents = tree.parents[tree.junctions]
    by_tree = time[parents] + tree.lengths[tree.junctions] / cv
    return np.asarray(time[tree.junctions] < by_tree - 1e-9)
