"""Paced cells and cables of any `CellModel`, and measures of their recorded potentials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.kernels.cable import CellModel, cable_of
from fascicle.kernels.ten_tusscher import advance

STIMULUS = -52.0  # pA/pF, as in the CellML versions of ten Tusscher and Panfilov's model
COARSENING = 10  # steps are longer by this factor after the upstrokes


@dataclass(frozen=True)
class CellRun:
    """The last beat of a paced cell: time (ms, from the stimulus), potential (mV), final state."""

    time: Floats
    potential: Floats
    state: Floats


@dataclass(frozen=True)
class CableRun:
    """Record of a beat in the middle of a cable.

    Attributes
    ----------
    time : (n,) array
        Since the stimulus (ms), from 0; in short steps until the front has left the cable.
    potential : (n,) array
        Transmembrane potential in the middle (mV).
    speed : float
        Conduction velocity around the middle (mm/ms).
    """

    time: Floats
    potential: Floats
    speed: float


def _compiled(cell: CellModel) -> Any:
    """Compiled cable of cells of a model; Numba caches that of the built-in model on disk."""
    return cable_of(cell.advance, keep=cell.advance is advance)


def simulate_cell(
    cell: CellModel,
    cycle_length: float = 1000.0,
    beats: int = 1,
    state: Floats | None = None,
    step: float = 0.01,
) -> CellRun:
    """Pace one cell and record its last beat.

    Parameters
    ----------
    cell : CellModel
        The cell.
    cycle_length : float
        From one stimulus, of 1 ms, to the next (ms), over 10; also the length of the record.
    beats : int
        How many, at least 1.
    state : array, optional
        State to start from, such as that of an earlier run; by default `CellModel.start`.
    step : float
        Time step in the first 10 ms of a beat (ms); ten times that later. The method is of second
        order.
    """
    upstroke = 10.0  # ms of short steps
    if not (cycle_length > upstroke and beats >= 1 and 0 < step <= 1.0):
        raise InputError(
            f"pacing {beats} beats every {cycle_length:g} ms in steps of {step:g} ms: give at "
            f"least 1 beat, over {upstroke:g} ms apart, and a step of up to 1 ms"
        )
    run, constants, probe = _compiled(cell), np.array(cell.constants), np.zeros(1, np.int64)
    current = np.array([cell.start if state is None else state], dtype=float)
    long = COARSENING * step
    many, more = round(upstroke / step), round((cycle_length - upstroke) / long)
    for _ in range(beats):
        before = current[0, 0]
        stimulus = STIMULUS, round(1.0 / step), 1
        fast = run(current, constants, stimulus, 0.0, step, many, probe)[:, 0]
        slow = run(current, constants, (0.0, 0, 1), 0.0, long, more, probe)[:, 0]
    first = step * np.arange(many + 1)
    times = np.concatenate([first, first[-1] + long * np.arange(1, more + 1)])
    return CellRun(times, np.concatenate([[before], fast, slow]), current[0])


def simulate_cable(
    cell: CellModel,
    diffusivity: float = 0.154,
    length: float = 20.0,
    duration: float = 500.0,
    spacing: float = 0.05,
    step: float = 0.01,
    beats: int = 20,
) -> CableRun:
    """Stimulate one end of a homogeneous cable and record its middle.

    The cells are those of `simulate_cell` after `beats` beats at 1000 ms. Monodomain,
    ∂U/∂t = D ∂²U/∂x² − I, with sealed ends. Second order in time (Strang splitting), fourth in
    space (compact differences).

    Parameters
    ----------
    cell : CellModel
        The cells.
    diffusivity : float
        D = 1/(ρSCm) (mm²/ms): conductivity over surface-to-volume ratio and capacitance. The
        default is that of the 2006 paper: ρ = 162 Ω·cm, S = 0.2/µm, Cm = 2 µF/cm².
    length : float
        Length of the cable (mm), at least 8.
    duration : float
        How long to record (ms); at least until the front has left the cable.
    spacing : float
        dx (mm), at most 0.5; the length is rounded to a whole, even number of it.
    step : float
        dt (ms) until the front has left; ten times that later.
    beats : int
        Beats of a single cell before.

    Raises
    ------
    InputError
        If a value is out of range, or the front does not arrive at the other end in `duration`.

    Notes
    -----
    Errors of the defaults (endocardial; on halving dt, dx, or both): speed +0.09, +0.01, +0.10 %;
    maximum upstroke +0.9, −0.5, +0.5 %; U, from 2 ms after the upstroke on, 0.02 mV each, and on
    the upstroke a shift of up to 0.006 ms. A cable of 30 mm changes U by 0.02 mV, 100 beats instead
    of 20 by 0.4 mV.

    Once a front travels steadily, the length scale is √D: the speed goes with √D, and the time
    course of U does not depend on D at all. At the published D the speed is 0.78 to 0.79 mm/ms; the
    published 0.70 is what an explicit scheme with dx = 0.25 mm and dt = 0.02 ms gives.
    """
    baseline, chunk = 2.0, 5.0  # mm on both sides of the middle; ms between checks for the front
    if not (diffusivity > 0 and length >= 4 * baseline and 0 < spacing <= 0.5 and step > 0):
        raise InputError(
            f"cable of {length:g} mm, dx {spacing:g} mm, dt {step:g} ms, D {diffusivity:g} mm²/ms: "
            f"give at least {4 * baseline:g} mm, dx up to 0.5 mm, and dt and D above 0"
        )
    run, constants = _compiled(cell), np.array(cell.constants)
    half, apart = round(length / spacing / 2), round(baseline / spacing)
    probes = np.array([half - apart, half, half + apart])
    state = np.tile(simulate_cell(cell, beats=beats).state, (2 * half + 1, 1))
    times, traces, elapsed = [np.zeros(1)], [state[probes, 0][None]], 0.0

    def go_on(by: float, dt: float) -> None:
        """Advance the simulation by `by` (ms), rounded up to complete steps."""
        nonlocal elapsed
        steps = int(np.ceil(by / dt - 1e-9))
        # the stimulus lasts 2 ms and covers the first 1.5 mm
        stimulus = STIMULUS, round(max(2.0 - elapsed, 0.0) / dt), round(1.5 / spacing) + 1
        lambda_ = diffusivity / spacing**2 * dt / 2
        traces.append(run(state, constants, stimulus, lambda_, dt, steps, probes))
        times.append(np.asarray(elapsed + dt * np.arange(1, steps + 1), dtype=float))
        elapsed += dt * steps

    while not state[-1, 0] > 0.0:  # mV: the far end has fired
        if elapsed >= duration:
            raise InputError(
                f"cable of {length:g} mm: no front at its end after {elapsed:g} ms; refine dx "
                f"({spacing:g} mm), raise D ({diffusivity:g} mm²/ms) or record longer"
            )
        go_on(chunk, step)
    go_on(chunk, step)  # the far end finishes its upstroke
    so_far, potentials = np.concatenate(times), np.concatenate(traces)
    fired = [max_upstroke(so_far, trace)[1] for trace in potentials.T]
    speed = 2 * apart * spacing / (fired[2] - fired[0])
    go_on(max(duration - elapsed, 0.0), COARSENING * step)
    return CableRun(np.concatenate(times), np.concatenate(traces)[:, 1], speed)


def max_upstroke(time: Floats, potential: Floats) -> tuple[float, float]:
    """Maximum of dU/dt (mV/ms, that is V/s) and its time (ms), between samples by a cubic spline.

    Of a record of time (ms) and potential (mV), (n,) arrays.
    """
    steepest = int(np.argmax(np.diff(potential) / np.diff(time)))
    near = slice(max(steepest - 12, 0), steepest + 14)
    spline = CubicSpline(time[near], potential[near])
    candidates = np.concatenate(
        [time[near], spline.derivative(2).roots(discontinuity=False, extrapolate=False)]
    )
    slopes = spline(candidates, 1)
    best = int(np.argmax(slopes))
    return float(slopes[best]), float(candidates[best])


def duration(time: Floats, potential: Floats, repolarised: float = 0.9) -> float:
    """Action potential duration (ms), by default APD90.

    From the maximum upstroke until the potential falls through
    peak − `repolarised`·(peak − rest), rest being what the record (ms, mV) starts with. InputError
    if the record ends before that.
    """
    peak = potential.max()
    level = peak - repolarised * (peak - potential[0])
    last = int(np.flatnonzero(potential >= level)[-1])
    if last + 1 == len(potential):
        raise InputError(
            f"record of {time[-1]:g} ms: ends at {potential[-1]:.1f} mV, before it has fallen to "
            f"{level:.1f}; record longer"
        )
    share = (potential[last] - level) / (potential[last] - potential[last + 1])
    end = time[last] + share * (time[last + 1] - time[last])
    return float(end - max_upstroke(time, potential)[1])
