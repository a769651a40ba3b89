"""A front in a cable of ten Tusscher–Panfilov 2006 myocytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.forward.cable.cell import COARSENING, STEP, STIMULUS, cell_type, simulate_cell
from fascicle.forward.cable.measures import max_upstroke
from fascicle.kernels import ten_tusscher

# D = 1/(ρSCm) (mm²/ms) of the 2006 paper: ρ = 162 Ω·cm, S = 0.2/µm, Cm = 2 µF/cm²
DIFFUSIVITY = 0.154
LENGTH = 20.0  # mm
SPACING = 0.05  # mm
DURATION = 500.0  # ms, longer than the longest of the three action potentials
BEATS = 20  # of single-cell pacing before the cable's beat
CYCLE_LENGTH = 1000.0  # ms
STIMULATED = 1.5  # mm at the end of the cable
STIMULATION = 2.0  # ms
BASELINE = 2.0  # mm on either side of the middle, between which the speed is measured
CHUNK = 5.0  # ms, between looks whether the front has arrived at the other end
DEPOLARISED = 0.0  # mV; a cell above it has fired


@dataclass(frozen=True)
class CableRun:
    """One beat in a cable.

    Attributes
    ----------
    time : (n,) array
        Since the stimulus (ms), from 0; in short steps until the front has left the cable.
    potential : (n,) array
        Transmembrane potential in the middle (mV).
    speed : float
        Conduction velocity around the middle (mm/ms).
    spacing, step : float
        dx (mm) and the short dt (ms).
    """

    time: Floats
    potential: Floats
    speed: float
    spacing: float
    step: float


def simulate_cable(
    cell: str,
    diffusivity: float = DIFFUSIVITY,
    length: float = LENGTH,
    duration: float = DURATION,
    spacing: float = SPACING,
    step: float = STEP,
    beats: int = BEATS,
) -> CableRun:
    """Stimulate one end of a homogeneous cable and record its middle.

    The cells are those of `simulate_cell` after `beats` beats at 1000 ms. Monodomain,
    ∂U/∂t = D ∂²U/∂x² − I, with sealed ends. Second order in time (Strang splitting), fourth in
    space (compact differences).

    Notes
    -----
    What the defaults leave (endocardial; on halving dt, dx, or both): speed +0.09, +0.01, +0.10 %;
    maximum upstroke +0.9, −0.5, +0.5 %; U, from 2 ms after the upstroke on, 0.02 mV each, and on
    the upstroke a shift of up to 0.006 ms. A cable of 30 mm changes U by 0.02 mV, 100 beats instead
    of 20 by 0.4 mV.

    Once a front travels steadily, the length scale is √D: the speed goes with √D, and the time
    course of U does not depend on D at all. At the published D the speed is 0.78 to 0.79 mm/ms; the
    published 0.70 is what an explicit scheme with dx = 0.25 mm and dt = 0.02 ms gives.

    Parameters
    ----------
    cell : str
        ``"endocardial"``, ``"midmyocardial"`` or ``"epicardial"``.
    diffusivity : float
        D (mm²/ms); conductivity over surface-to-volume ratio and capacitance.
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

    Returns
    -------
    CableRun
        The beat.

    Raises
    ------
    InputError
        If a value is out of range, or the front does not arrive at the other end in `duration`.
    """
    if not (diffusivity > 0 and length >= 4 * BASELINE and 0 < spacing <= 0.5 and step > 0):
        raise InputError(
            f"cable of {length:g} mm, dx {spacing:g} mm, dt {step:g} ms, D {diffusivity:g} mm²/ms: "
            f"give at least {4 * BASELINE:g} mm, dx up to 0.5 mm, and dt and D above 0"
        )
    rest = simulate_cell(cell, CYCLE_LENGTH, beats).state
    cable = _Cable(cell, rest, diffusivity, length, spacing)
    while not cable.passed:
        if cable.now >= duration:
            raise InputError(
                f"cable of {length:g} mm: no front at its end after {cable.now:g} ms; refine dx "
                f"({spacing:g} mm), raise D ({diffusivity:g} mm²/ms) or record longer"
            )
        cable.run(CHUNK, step)
    cable.run(CHUNK, step)  # the far end finishes its upstroke
    fired = [max_upstroke(cable.time, trace)[1] for trace in cable.potentials.T]
    speed = cable.baseline / (fired[2] - fired[0])
    cable.run(max(duration - cable.now, 0.0), COARSENING * step)
    return CableRun(cable.time, cable.potentials[:, 1], speed, spacing, step)


class _Cable:
    """The cells of a cable while it is simulated, and what its probes have seen."""

    def __init__(
        self, cell: str, rest: Floats, diffusivity: float, length: float, spacing: float
    ) -> None:
        half = round(length / spacing / 2)
        apart = round(BASELINE / spacing)
        self.cell = cell_type(cell).constants
        self.state = np.tile(rest, (2 * half + 1, 1))
        self.curvature = diffusivity / spacing**2
        self.reach = round(STIMULATED / spacing) + 1
        self.probes = np.array([half - apart, half, half + apart])
        self.baseline = 2 * apart * spacing
        self.now = 0.0
        self._times: list[Floats] = [np.zeros(1)]
        self._traces: list[Floats] = [self.state[self.probes, ten_tusscher.V][None]]

    @property
    def passed(self) -> bool:
        """Whether the front has arrived at the far end."""
        return bool(self.state[-1, ten_tusscher.V] > DEPOLARISED)

    @property
    def time(self) -> Floats:
        """Since the stimulus (ms)."""
        return np.concatenate(self._times)

    @property
    def potentials(self) -> Floats:
        """At the three probes (mV), shape (n, 3)."""
        return np.concatenate(self._traces)

    def run(self, duration: float, step: float) -> None:
        """Go on by a whole number of steps, at least as long as `duration` (ms)."""
        steps = int(np.ceil(duration / step - 1e-9))
        stimulus = STIMULUS, round(max(STIMULATION - self.now, 0.0) / step), self.reach
        lambda_ = self.curvature * step / 2
        self._traces.append(
            ten_tusscher.run_cable(
                self.state, self.cell, stimulus, lambda_, step, steps, self.probes
            )
        )
        self._times.append(np.asarray(self.now + step * np.arange(1, steps + 1), dtype=float))
        self.now += step * steps
