"""The arrays and numbers that growth works on, bundled by what they describe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# What the search for the nearest node reads of a node lies together: one cache line, not five.
NODE = np.dtype(
    [
        ("u", np.float64),
        ("v", np.float64),
        ("branch", np.int32),  # number of the branch it belongs to
        ("following", np.int32),  # next node in the same cell of the hash, or -1
        ("parent", np.int32),  # node before it, -1 at the root
        ("triangle", np.int32),
        ("length", np.float64),  # of the segment to its parent (mm)
    ]
)


class Surface(NamedTuple):
    """The arrays of a chart.

    Attributes
    ----------
    points : (n, 2) array
        Position of each vertex in the disk.
    triangles, neighbours : (m, 3) arrays
        Vertices of each triangle, and the triangle across the edge opposite each; -1 for none.
    metric : (m, 3) array
        G₁₁, G₁₂, G₂₂ of each triangle (mm²).
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    metric: NDArray[np.float64]


class Start(NamedTuple):
    """Where the bundle starts, and its unit direction in the disk."""

    u: float
    v: float
    triangle: int
    heading_u: float
    heading_v: float


class Rules(NamedTuple):
    """What is held fixed: see `fascicle.purkinje.growth.GrowthRules`.

    Attributes
    ----------
    step : float
        Length of a segment (mm).
    segments, generations : int
        Segments of a branch, and how often the ends branch.
    repulsion, branch_angle, clearance : float
        Weight w, angle (rad), and the distance to foreign nodes in segments.
    """

    step: float
    segments: int
    generations: int
    repulsion: float
    branch_angle: float
    clearance: float


class Tree(NamedTuple):
    """A tree that grows.

    Attributes
    ----------
    nodes : array of NODE
        The nodes, and room for more.
    size : int
        How many nodes there are.
    head : (GRID, GRID) array
        The hash: a node in each cell, from which `following` leads to the others; or -1.
    """

    nodes: NDArray[np.void]
    size: int
    head: NDArray[np.int32]
