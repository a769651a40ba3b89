"""Leads without a signal of their own: flat ones, and copies of others."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS
from fascicle.recording.quality.finding import Check, Finding, Severity, leave_out, listed
from fascicle.recording.quality.lead_signals import UV_PER_MV, coarse, measured
from fascicle.recording.recording import Recording

FLAT = 1e-3  # mV; standard deviation below which there is no signal
SMALLEST = Check("smallest lead", "uV", UV_PER_MV * FLAT)
CONSTANT = Check("longest constant stretch", "s", 2.0)  # longer than between two beats of most
COPIES = Check("largest correlation between leads", "", 0.9999)
SAME_SIZE = 0.01  # relative difference of the standard deviations of copies


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
    message = ""
    if flat:
        message = f"no signal in {listed(flat)}; go on without: {leave_out(recording, flat)}"
        if len(flat) == len(leads):
            message = "no signal in any lead; correct the unit or the gain, or record again"
    smallest = UV_PER_MV * min(spread.values())
    finding = SMALLEST.found(smallest, message, Severity.FATAL)
    moving = {lead: values for lead, values in leads.items() if lead not in flat}
    return [finding, _check_constant(recording, moving)]


def _check_constant(recording: Recording, leads: dict[str, Floats]) -> Finding:
    """Find the longest time over which a lead stays at one value."""
    rate = recording.sampling_rate
    constant = {lead: _longest_constant(values) / rate for lead, values in leads.items()}
    long = [lead for lead in leads if constant[lead] > CONSTANT.limit]
    longest = max(constant.values(), default=0.0)
    if not long:
        return CONSTANT.found(longest)
    if len(long) == len(leads):
        message = (
            f"no signal in any lead for up to {longest:.1f} s: the file was filled up; cut the "
            "recording to the part with signal"
        )
        return CONSTANT.found(longest, message, Severity.FATAL)
    message = (
        f"no signal in {listed(long)} for up to {longest:.1f} s: electrode off, or the file "
        f"was filled up; cut the recording, or go on without: {leave_out(recording, long)}"
    )
    return CONSTANT.found(longest, message)


def _longest_constant(values: Floats) -> int:
    """Number of samples of the longest run of equal ones in (n,) values."""
    changes = np.flatnonzero(np.diff(values))
    ends = np.concatenate([[-1], changes, [len(values) - 1]])
    return int(np.diff(ends).max())


def check_duplicates(recording: Recording) -> list[Finding]:
    """Find leads that are the same as another, or its exact negative.

    Returns
    -------
    list of Finding
        The largest absolute correlation between two leads of the same size.
    """
    largest, messages = 0.0, []
    leads = _standardised(recording)
    # where one limb lead is flat, others are the same by Einthoven's law
    limb_flat = {lead for lead in measured(recording) if lead in LIMB_LEADS} - set(leads)
    for one, other in combinations(leads, 2):
        if limb_flat and one in LIMB_LEADS and other in LIMB_LEADS:
            continue
        (x, x_size), (y, y_size) = leads[one], leads[other]
        if len(x) != len(y) or abs(x_size - y_size) > SAME_SIZE * max(x_size, y_size):
            continue
        correlation = float(x @ y) / len(x)
        largest = max(largest, abs(correlation))
        if abs(correlation) > COPIES.limit:
            sign = "the same" if correlation > 0 else "the same but for the sign"
            messages.append(
                f"leads {one} and {other} are {sign}; get the right samples, or leave both out: "
                f"{leave_out(recording, [one, other])}"
            )
    return [COPIES.found(largest, message, Severity.FATAL) for message in messages or [""]]


def _standardised(recording: Recording) -> dict[str, tuple[Floats, float]]:
    """Leads that move, with mean zero and standard deviation one, and what that was (mV)."""
    leads = {}
    for lead, values in measured(recording).items():
        x, _ = coarse(values, recording.sampling_rate)
        size = float(x.std())
        if size >= FLAT:
            leads[lead] = ((x - x.mean()) / size, size)
    return leads
