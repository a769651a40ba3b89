"""What happens once on a machine, with progress: kernels, and the action potential."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Timer

import numpy as np

from fascicle.core.progress import Progress
from fascicle.forward.cable.stored import default_template
from fascicle.forward.eikonal.activation import attach, solve
from fascicle.forward.preparation import build
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules, grow_tree
from fascicle.purkinje.tree import InvalidTree

PATIENCE = 1.0  # s without a word; kernels that were ran before take less
STEPS = 4


class Compilation:
    """Computes the action potential, and runs every kernel on the smallest heart there is.

    Parameters
    ----------
    progress : callable
        Told how far this is, once it is clear that something is being done.
    """

    def __init__(self, progress: Progress) -> None:
        self.progress = progress
        self.done, self.slow = 0, False

    def run(self) -> None:
        """Do what is not done yet."""
        timer = Timer(PATIENCE, self._tell)
        timer.start()
        try:
            for done in _steps():
                self.done = done
                if self.slow:
                    self._tell()
        finally:
            timer.cancel()

    def _tell(self) -> None:
        self.slow = True
        self.progress("compilation", self.done, STEPS, "once on this machine")


def _steps() -> Iterator[int]:
    template = default_template()
    yield 1
    heart = _smallest_heart()
    prepared = build(heart, Conduction(), template)
    tree = grow_tree(
        "lv", prepared.charts["lv"], prepared.seeds["lv"], 2.0, [1.0], [0.0],
        GrowthRules(branch_length=1.0, segments=2, generations=1),
    )  # fmt: skip
    if isinstance(tree, InvalidTree):
        raise RuntimeError(f"the smallest heart has no room for its tree: {tree.reason}")
    yield 2
    activation = solve(prepared.tissue, attach(prepared.tissue, [tree]), [0.0], 1.0)
    yield 3
    prepared.electrocardiograph.leads(activation.myocardium)
    yield 4


def _smallest_heart() -> Heart:
    """An octahedron of four tetrahedra; its upper half is both endocardia."""
    ring = [[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [-10.0, 0.0, 0.0], [0.0, -10.0, 0.0]]
    vertices = np.array([*ring, [0.0, 0.0, 10.0], [0.0, 0.0, -10.0]])
    around = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    tetrahedra = np.column_stack([around, np.full(4, 4), np.full(4, 5)])[:, [0, 1, 3, 2]]
    face = Endocardium("lv", vertices[:5], np.column_stack([around, np.full(4, 4)]), 4, 0)
    fibres = np.tile([1.0, 0.0, 0.0], (4, 1))
    electrodes = 50.0 * np.random.default_rng(0).normal(size=(9, 3))
    other = Endocardium("rv", face.vertices, face.triangles, 4, 0)
    return Heart(vertices, tetrahedra, fibres, face, other, electrodes)
