"""How fine the digits are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.finding import Finding, warning_if
from fascicle.recording.quality.stretches import measured
from fascicle.recording.quality.wording import listed
from fascicle.recording.recording import Recording

LARGEST_STEP = 0.02  # mV; recorders store 5 uV or finer
ENOUGH = 100_000  # samples that show the step
ROUNDING = 1e-7  # mV; values nearer to each other than this are one value


def check_resolution(recording: Recording) -> list[Finding]:
    """Find leads that were stored too coarsely.

    Returns
    -------
    list of Finding
        The largest step between two neighbouring values of a lead (uV).
    """
    steps = {lead: step_of(values) for lead, values in measured(recording).items()}
    rough = [lead for lead, step in steps.items() if step > LARGEST_STEP]
    largest = 1e3 * max(steps.values())
    message = ""
    if rough:
        message = (
            f"steps of up to {largest:.0f} uV between the values of {listed(rough)}; export "
            "the recording with all its digits"
        )
    return [warning_if(message, "amplitude step", largest, "uV", 1e3 * LARGEST_STEP)]


def step_of(values: NDArray[np.float64]) -> float:
    """Smallest difference between distinct (n,) values (mV); 0 where all are the same."""
    gaps = np.diff(np.unique(values[:: max(len(values) // ENOUGH, 1)]))
    gaps = gaps[gaps > ROUNDING]
    return float(gaps.min()) if gaps.size else 0.0
