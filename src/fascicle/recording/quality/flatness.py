"""Leads that do not move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.finding import Finding, Severity
from fascicle.recording.quality.stretches import measured
from fascicle.recording.quality.wording import leave_out, listed
from fascicle.recording.recording import Recording

FLAT = 1e-3  # mV; standard deviation below which there is no signal
LONGEST_STILL = 2.0  # s; longer than the time between two beats of most hearts


def check_flatness(recording: Recording) -> list[Finding]:
    """Find leads without signal, and leads that lose it for a while.

    Returns
    -------
    list of Finding
        The smallest standard deviation of a lead (uV), and the longest time (s) over which a lead
        stays at one value.
    """
    leads = measured(recording)
    spread = {lead: float(values.std()) for lead, values in leads.items()}
    flat = [lead for lead in leads if spread[lead] < FLAT]
    message = (
        ""
        if not flat
        else f"no signal in {listed(flat)}; go on without: {leave_out(recording, flat)}"
    )
    severity = Severity.FATAL if flat else Severity.FINE
    smallest = 1e3 * min(spread.values())
    finding = Finding("smallest lead", smallest, "uV", 1e3 * FLAT, severity, message)
    return [finding, _check_still(recording, {k: v for k, v in leads.items() if k not in flat})]


def _check_still(recording: Recording, leads: dict[str, NDArray[np.float64]]) -> Finding:
    """Find the longest time over which a lead stays at one value."""
    rate = recording.sampling_rate
    still = {lead: longest_constant(values) / rate for lead, values in leads.items()}
    long = [lead for lead in leads if still[lead] > LONGEST_STILL]
    longest = max(still.values(), default=0.0)
    message = ""
    if long:
        message = (
            f"no signal in {listed(long)} for up to {longest:.1f} s: electrode off, or the file "
            f"was filled up; cut the recording, or go on without: {leave_out(recording, long)}"
        )
        if len(long) == len(leads):
            message = (
                f"no signal in any lead for up to {longest:.1f} s: the file was filled up; cut the "
                "recording to the part with signal"
            )
    severity = Severity.WARNING if long else Severity.FINE
    if len(long) == len(leads) > 0:
        severity = Severity.FATAL
    return Finding("longest constant stretch", longest, "s", LONGEST_STILL, severity, message)


def longest_constant(values: NDArray[np.float64]) -> int:
    """Number of samples of the longest run of equal ones in (n,) values."""
    changes = np.flatnonzero(np.diff(values))
    ends = np.concatenate([[-1], changes, [len(values) - 1]])
    return int(np.diff(ends).max())
