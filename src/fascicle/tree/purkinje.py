"""Purkinje trees, and the typed outcome for parameters that give none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PurkinjeTree:
    """A tree of straight segments from one root.

    Attributes
    ----------
    side : str
        ``"lv"`` or ``"rv"``.
    nodes : (n, 3) array
        Positions (mm); the root is the node without a parent.
    parents : (n,) array
        The node each one hangs on; -1 at the root.
    lengths : (n,) array
        Length of the segment to the parent (mm), measured along the endocardium; 0 at the root.
    """

    side: str
    nodes: NDArray[np.float64]
    parents: NDArray[np.int64]
    lengths: NDArray[np.float64]

    @property
    def root(self) -> int:
        """The node where the bundle starts."""
        return int(np.flatnonzero(self.parents < 0)[0])

    @cached_property
    def junctions(self) -> NDArray[np.int64]:
        """Purkinje-myocardium junctions: the leaves, each once, ascending."""
        leaf = np.ones(len(self.nodes), dtype=bool)
        leaf[self.parents[self.parents >= 0]] = False
        leaf[self.root] = False
        return np.flatnonzero(leaf)


@dataclass(frozen=True)
class InvalidTree:
    """The parameters ask for a bundle or fascicle that does not fit on the endocardium.

    Attributes
    ----------
    side : str
        ``"lv"`` or ``"rv"``.
    reason : str
        Which stretch left the endocardium, after how many mm, and where.
    """

    side: str
    reason: str
