"""Cells of any model, alone and in a cable.

Second order in time: a half step with the rates at its start, then the whole step with the rates at
the middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable

from fascicle.kernels.jit import kernel


class CellModel(NamedTuple):
    """A model of a heart cell.

    Attributes
    ----------
    name : str
        Of the model, and of the type of cell.
    advance : function
        Called as ``advance(at, base, out, constants, stimulus, dt)``, and compiled by Numba: writes
        the state `dt` (ms) after `base` to `out`, by the rates at the state `at`. `stimulus` is a
        current (pA/pF, negative depolarises). `out` may be `base`, so each number of it is read
        before it is written. The potential (mV) of a state comes first. For the simplest model,
        ``out[k] = base[k] + dt * rate(at)``; `relaxed` is for gates.
    start, constants : tuples of float
        The state that pacing starts from, and what `advance` is given as an array.
    """

    name: str
    advance: Callable[..., None]
    start: tuple[float, ...]
    constants: tuple[float, ...]


@kernel()
def relaxed(gate, steady, tau, dt):
    """A gate after dt at constant steady state and time constant (Rush and Larsen).

    IEEE Trans Biomed Eng 25 (1978) 389-392; the midpoint form: Sundnes et al., 56 (2009) 2546-2548.
    """
    return steady + (gate - steady) * math.exp(-dt / tau)


@kernel()
def _factor(pivot, lambda_):
    """Factors of the tridiagonal matrix of `_diffuse`; ends reflect."""
    side, centre = 1.0 / 12.0 - lambda_ / 2.0, 10.0 / 12.0 + lambda_
    pivot[0] = 1.0 / centre
    for k in range(1, len(pivot)):
        above = 2.0 * side if k == 1 else side
        below = 2.0 * side if k == len(pivot) - 1 else side
        pivot[k] = 1.0 / (centre - below * above * pivot[k - 1])


@kernel()
def _diffuse(state, pivot, right, lambda_):
    """Crank-Nicolson step with the compact Laplacian, of fourth order in space.

    (1 + δ²/12 − λδ²/2) V⁺ = (1 + δ²/12 + λδ²/2) V with λ = D·step/dx² (Douglas, 1956).
    """
    n = len(pivot)
    side, centre = 1.0 / 12.0 + lambda_ / 2.0, 10.0 / 12.0 - lambda_
    for k in range(n):
        before = state[k - 1, 0] if k > 0 else state[1, 0]
        after = state[k + 1, 0] if k < n - 1 else state[n - 2, 0]
        right[k] = centre * state[k, 0] + side * (before + after)
    side = 1.0 / 12.0 - lambda_ / 2.0
    for k in range(1, n):
        below = 2.0 * side if k == n - 1 else side
        right[k] -= below * pivot[k - 1] * right[k - 1]
    state[n - 1, 0] = right[n - 1] * pivot[n - 1]
    for k in range(n - 2, -1, -1):
        above = 2.0 * side if k == 0 else side
        state[k, 0] = (right[k] - above * state[k + 1, 0]) * pivot[k]


@cache
def cable_of(advance: Callable[..., None], keep: bool = False) -> Any:
    """Compile a cable of cells that `CellModel.advance` advances.

    `keep` says whether it is kept on disk, where Numba would not see that `advance` has changed.
    The compiled ``run(state, constants, stimulus, lambda_, dt, steps, probes)`` advances the
    cells, an array with a row each, in place: half a step of diffusion, a step of every cell, half
    a step of diffusion (Strang, 1968). A single one does not diffuse. `stimulus` is a current, the
    number of steps that it lasts, and the number of cells, from the first one on, that it goes
    into; `lambda_` is D·(dt/2)/dx²; `probes` are the cells whose potentials (mV) after each
    step are returned, shape (steps, p).
    """
    if not keep:
        register_jitable(advance)

    @njit(cache=keep, nogil=True)
    def run(state, constants, stimulus, lambda_, dt, steps, probes):
        amplitude, stimulated, reach = stimulus
        middle, traces = np.empty_like(state[0]), np.empty((steps, len(probes)))
        pivot, right = np.empty(len(state)), np.empty(len(state))
        _factor(pivot, lambda_)
        for step in range(steps):
            if len(state) > 1:
                _diffuse(state, pivot, right, lambda_)
            for i in range(len(state)):
                current = amplitude if step < stimulated and i < reach else 0.0
                cell = state[i]
                advance(cell, cell, middle, constants, current, dt / 2.0)
                advance(middle, cell, cell, constants, current, dt)
            if len(state) > 1:
                _diffuse(state, pivot, right, lambda_)
            for p in range(len(probes)):
                traces[step, p] = state[probes[p], 0]
        return traces

    return run
