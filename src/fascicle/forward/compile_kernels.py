"""Work done once on a machine, with progress: compiled kernels, and the action potential."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Timer

import numpy as np

from fascicle.core.parameters import Infeasible
from fascicle.core.progress import Progress
from fascicle.forward.cable.template import default_template
from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.myocardium import attach
from fascicle.forward.preparation import build
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.kernels.gaussian import integrated
from fascicle.purkinje.growth import GrowthRules, grow_from_parameters

_compiled = False  # whether this process has compiled the kernels


def compile_kernels(progress: Progress, silence: float = 1.0) -> None:
    """Compute the action potential, and run every kernel on a tiny heart.

    Once in a process; kernels that were compiled on this machine before are read from disk.
    `progress` is called with the steps done, once they take longer than `silence` (s).
    """
    global _compiled
    if _compiled:
        return
    finished, is_slow = 0, False

    def report() -> None:
        nonlocal is_slow
        is_slow = True
        progress("compilation", finished, 4, "once on this machine")

    timer = Timer(silence, report)
    timer.start()
    try:
        for done in _steps():
            finished = done
            if is_slow:
                report()
    finally:
        timer.cancel()
    _compiled = True


def _steps() -> Iterator[int]:
    template = default_template()
    yield 1
    heart = _smallest_heart()
    prepared = build(heart, Conduction(), template)
    lengths = {"lv_initial_length": 2.0, "lv_fascicle_length_1": 1.0, "lv_fascicle_angle_1": 0.0}
    rules = GrowthRules(branch_length=1.0, segments=2, generations=1)
    tree = grow_from_parameters("lv", prepared.charts["lv"], prepared.seeds["lv"], lengths, rules)
    if isinstance(tree, Infeasible):
        raise RuntimeError(f"the smallest heart has no room for its tree: {tree.reason}")
    yield 2
    activation = solve(attach(prepared.myocardium, [tree]), [0.0], 1.0)
    yield 3
    prepared.electrocardiograph.leads(activation.myocardium)
    for kind in (np.float32, np.float64):  # types of emulated and of simulated ECGs
        models = np.zeros((1, 1, 1), kind)
        integrated(models, kind(0), models[0, 0], models[0], np.zeros(1), np.zeros((1, 1)))
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
