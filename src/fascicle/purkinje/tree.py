"""Purkinje trees, whose nodes are joined by straight segments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core import above, html_card
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.files import as_path
from fascicle.core.ranges import short_repr
from fascicle.kernels.growth import path_lengths
from fascicle.mesh.vtk import pyvista_grid

# A tree with fewer junctions than this has hardly branched. In 500 networks drawn from the ranges
# of `NETWORK_SPACE`, the packaged heart's trees have a median of 280 (left) and 345 (right)
# junctions, 1 % of the right ones fewer than 50; crtdemo's right ones 210, 0.4 % fewer than 50. In
# its small left ventricle few junctions are usual (median 66, a third below 50).
FEW_JUNCTIONS = 50


@dataclass(frozen=True, eq=False)  # equal is the same, as fits something made of arrays
class PurkinjeTree:
    """A tree of straight segments from one root.

    Attributes
    ----------
    side : str
        ``"lv"`` or ``"rv"``.
    nodes, parents : (n, 3) and (n,) arrays
        Positions (mm), and the parent of each node; -1 at the root.
    lengths : (n,) array
        Length of the segment to the parent (mm), measured along the endocardium; 0 at the root.
    labels : (n,) array, optional
        Part that the segment ending in each node belongs to: 0 the bundle, k fascicle k, above
        that the branches. Without labels, parts follow from the forks of the tree.
    triangles : (n,) array, optional
        The triangle of its side's endocardium that each node was grown in.
    """

    side: str
    nodes: Floats
    parents: Integers
    lengths: Floats
    labels: Integers | None = None
    triangles: Integers | None = None

    __repr__ = short_repr
    _repr_html_ = html_card

    def plot(self, ax: Any = None) -> list[Any]:
        """Draw it by `fascicle.plot.tree`; returns Matplotlib axes."""
        return list(above("plot").tree(self, ax))

    def to_pyvista(self, activation: Floats | None = None) -> Any:
        """`pyvista.UnstructuredGrid` of lines (mm), with times of the nodes (n,) (ms) if given."""
        return pyvista_grid(*above("purkinje.tree_files").tree_lines(self, activation))

    def save(self, path: Path | str) -> None:
        """Write it as VTU, without labels; `fascicle.read_tree` reads it."""
        above("purkinje.tree_files").write_tree(as_path(path, "path"), self)

    @property
    def root(self) -> int:
        """The node where the bundle starts."""
        return int(np.flatnonzero(self.parents < 0)[0])

    @cached_property
    def junctions(self) -> Integers:
        """Purkinje-myocardium junctions: the leaves, each once, ascending."""
        leaf = np.ones(len(self.nodes), dtype=bool)
        leaf[self.parents[self.parents >= 0]] = False
        leaf[self.root] = False
        return np.flatnonzero(leaf)

    @cached_property
    def to_first_junction(self) -> float:
        """Length (mm) of the shortest path from the root to a junction; inf without junctions."""
        along = path_lengths(self.parents, self.lengths)
        return float(along[self.junctions].min(initial=np.inf))

    @cached_property
    def parts(self) -> dict[str, Booleans]:
        """Masks of the segments of the bundle and of each fascicle, by the node they end in.

        Without labels, the bundle reaches from the root to the first fork. Every segment that
        starts there begins a fascicle, which reaches to the next fork. A root that is a fork or
        lies within a branch has no bundle.
        """
        labels = self.labels if self.labels is not None else self._labels_from_forks()
        fascicles = (self.parents >= 0) & (labels > 0) & (labels[self.parents] == 0)
        bundle = labels == 0
        parts = {"bundle": bundle} if (self.parents[bundle] >= 0).any() else {}
        for k in range(1, int(fascicles.sum()) + 1):
            parts[f"fascicle {k}"] = labels == k
        return parts

    def _labels_from_forks(self) -> Integers:
        labels = np.full(len(self.parents), len(self.parents), dtype=np.int64)

        def label_until_fork(node: int, label: int) -> Integers:
            labels[node] = label
            while len(children := np.flatnonzero(self.parents == node)) == 1:
                node = children[0]
                labels[node] = label
            return children

        for k, start in enumerate(label_until_fork(self.root, 0), 1):
            label_until_fork(start, k)
        return labels
