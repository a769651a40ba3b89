"""The ten Tusscher–Panfilov 2006 myocyte: its three types, and a cell paced alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.kernels import ten_tusscher

STIMULUS = -52.0  # pA/pF, as in the model's CellML versions
STIMULUS_DURATION = 1.0  # ms
STEP = 0.01  # ms, during an upstroke
COARSENING = 10  # steps are longer by this after the upstrokes
UPSTROKE_TIME = 10.0  # ms of short steps after a stimulus to a single cell


@dataclass(frozen=True)
class CellType:
    """What distinguishes a layer of the wall.

    Attributes
    ----------
    g_ks, g_to : float
        Conductances of the slow delayed rectifier and the transient outward current (nS/pF).
    endocardial : bool
        Whether the transient outward current inactivates slowly, as in endocardial cells.
    start : tuple of 19 floats
        State that the pacing starts from: the published initial values of the type, in the rows of
        `fascicle.kernels.ten_tusscher`.
    """

    g_ks: float
    g_to: float
    endocardial: bool
    start: tuple[float, ...]

    @property
    def constants(self) -> Floats:
        """The first three as the kernels take them, shape (3,)."""
        return np.array([self.g_ks, self.g_to, float(self.endocardial)])


# Conductances of the 2006 paper; initial values of its CellML versions
CELLS: Mapping[str, CellType] = MappingProxyType(
    {
        "endocardial": CellType(
            0.392, 0.073, True,
            (-86.709, 0.00155, 0.7573, 0.7225, 3.164e-5, 0.8009, 0.9778, 0.9953, 2.235e-8, 0.3212,
             0.00448, 0.476, 0.0087, 0.9068, 0.00013, 3.715, 0.00036, 10.355, 138.4),
        ),
        "midmyocardial": CellType(
            0.098, 0.294, False,
            (-85.423, 0.00165, 0.749, 0.6788, 3.288e-5, 0.7026, 0.9526, 0.9942, 2.347e-8, 0.999998,
             0.0165, 0.473, 0.0174, 0.8978, 0.000153, 4.272, 0.00042, 10.132, 138.52),
        ),
        "epicardial": CellType(
            0.392, 0.294, False,
            (-85.23, 0.00172, 0.7444, 0.7045, 3.373e-5, 0.7888, 0.9755, 0.9953, 2.42e-8, 0.999998,
             0.00621, 0.4712, 0.0095, 0.9073, 0.000126, 3.64, 0.00036, 8.604, 136.89),
        ),
    }
)  # fmt: skip


@dataclass(frozen=True)
class CellRun:
    """The last beat of a paced cell.

    Attributes
    ----------
    time : (n,) array
        Since the last stimulus (ms), from 0.
    potential : (n,) array
        Transmembrane potential (mV).
    state : (19,) array
        The cell at the end of the beat; pacing can go on from it.
    """

    time: Floats
    potential: Floats
    state: Floats


def cell_type(name: str) -> CellType:
    """The type of this name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in CELLS:
        raise InputError(f"cell '{name}': no such type; choose one of {', '.join(CELLS)}")
    return CELLS[name]


def simulate_cell(
    cell: str,
    cycle_length: float = 1000.0,
    beats: int = 1,
    state: Floats | None = None,
    step: float = STEP,
) -> CellRun:
    """Pace one cell and record its last beat.

    Parameters
    ----------
    cell : str
        ``"endocardial"``, ``"midmyocardial"`` or ``"epicardial"``.
    cycle_length : float
        From one stimulus to the next (ms), over 10; also the length of the record.
    beats : int
        How many, at least 1.
    state : (19,) array, optional
        State to start from, such as that of an earlier run; by default the published one.
    step : float
        Time step in the first 10 ms of a beat (ms); ten times that later. The method is of second
        order.

    Returns
    -------
    CellRun
        The last beat.

    Raises
    ------
    InputError
        If a value is out of range, or no such cell type is known.
    """
    kind = cell_type(cell)
    if not (cycle_length > UPSTROKE_TIME and beats >= 1 and 0 < step <= STIMULUS_DURATION):
        raise InputError(
            f"pacing {beats} beats every {cycle_length:g} ms in steps of {step:g} ms: give at "
            f"least 1 beat, over {UPSTROKE_TIME:g} ms apart, and a step of up to "
            f"{STIMULUS_DURATION:g} ms"
        )
    current = np.array([kind.start if state is None else state], dtype=float)
    long = COARSENING * step
    stimulated, many = round(STIMULUS_DURATION / step), round(UPSTROKE_TIME / step)
    more = round((cycle_length - UPSTROKE_TIME) / long)
    for _ in range(beats):
        before = current[0, ten_tusscher.V]
        fast = ten_tusscher.run_cell(current, kind.constants, STIMULUS, stimulated, step, many)
        slow = ten_tusscher.run_cell(current, kind.constants, 0.0, 0, long, more)
    first = step * np.arange(many + 1)
    times = np.concatenate([first, first[-1] + long * np.arange(1, more + 1)])
    return CellRun(times, np.concatenate([[before], fast, slow]), current[0])
