"""Leads that are copies of each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fascicle.core.leads import LIMB_LEADS
from fascicle.recording.quality.finding import Finding, Severity
from fascicle.recording.quality.flatness import FLAT
from fascicle.recording.quality.stretches import coarse, measured
from fascicle.recording.quality.wording import leave_out
from fascicle.recording.recording import Recording

COPY = 0.9999  # correlation from which on two leads are one
SAME_SIZE = 0.01  # relative difference of the standard deviations of copies


def check_duplicates(recording: Recording) -> list[Finding]:
    """Find leads that are the same as another, or its exact negative.

    Returns
    -------
    list of Finding
        The largest absolute correlation between two leads of the same size.
    """
    largest, copies = 0.0, []
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
        if abs(correlation) > COPY:
            sign = "the same" if correlation > 0 else "the same but for the sign"
            rest = leave_out(recording, [one, other])
            copies.append(
                f"leads {one} and {other} are {sign}; get the right samples, or leave both out: "
                f"{rest}"
            )
    if not copies:
        return [Finding("likest leads of one size", largest, "", COPY, Severity.FINE)]
    return [
        Finding("likest leads of one size", largest, "", COPY, Severity.FATAL, m) for m in copies
    ]


def _standardised(recording: Recording) -> dict[str, tuple[NDArray[np.float64], float]]:
    """Leads that move, with mean zero and standard deviation one, and what that was (mV)."""
    leads = {}
    for lead, values in measured(recording).items():
        x, _ = coarse(values, recording.sampling_rate)
        size = float(x.std())
        if size >= FLAT:
            leads[lead] = ((x - x.mean()) / size, size)
    return leads
