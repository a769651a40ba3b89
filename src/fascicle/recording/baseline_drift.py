"""Beats whose baseline drifts through the QRS, as when an electrode settles or is pushed.

`fascicle.recording.aligned_beats.cut_beats` takes a straight line from each beat. What is left of a
drift that is no straight line shows right after the QRS, where beats of one shape have one ST
segment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.leads import LEADS
from fascicle.recording.aligned_beats import KNOT, cut_beats
from fascicle.recording.lead_groups import LeadGroup
from fascicle.recording.resampling import SAMPLING_STEP
from fascicle.recording.window import qrs_window

SMALLEST = 0.1  # mV, one millimetre on paper; less is no matter
OUTLYING = 8.0  # robust standard deviations of the beats; some ten tell those roughly
TO_STANDARD_DEVIATION = 1.4826  # times the median absolute deviation, for a normal distribution
FEWEST = 5  # beats; of fewer none can be told from the others


@dataclass(frozen=True)
class Drift:
    """How far a beat is off the median beat in the `KNOT` samples after the QRS.

    Attributes
    ----------
    lead : str
        In which it is off most, for how the beats vary there.
    potential : float
        How far (mV).
    """

    lead: str
    potential: float

    def __str__(self) -> str:
        return f"baseline drifts by {abs(self.potential):.2f} mV in {self.lead}"


def drifting_beats(
    group: LeadGroup, members: Integers, onset: float | None = None
) -> dict[int, Drift]:
    """Find beats of one shape whose baseline drifts: right after the QRS they are off the others.

    By more than `SMALLEST` in a lead, and by more than `OUTLYING` robust standard deviations of the
    beats in that lead, or in the median lead where that is larger. Of two neighbours the one that
    is further off goes first, since the other's line may run through it.

    Parameters
    ----------
    group : LeadGroup
        All beats.
    members : (n_beats,) array
        Which ones would be used, increasing.
    onset : float, optional
        Onset of the QRS (ms from R) where the user has given it.
    """
    found: dict[int, Drift] = {}
    while len(members) >= FEWEST:
        off = _after_qrs(group, members, onset)
        spread = TO_STANDARD_DEVIATION * np.median(np.abs(off), axis=0)
        spread = np.maximum(spread, np.nanmedian(spread))
        excess = np.abs(off) / np.maximum(OUTLYING * spread, SMALLEST)
        leads = np.argmax(np.where(np.isfinite(excess), excess, 0.0), axis=1)
        worst = _worst_of_neighbours(excess[np.arange(len(members)), leads])
        if not worst.any():
            break
        for k in np.flatnonzero(worst):
            found[int(members[k])] = Drift(LEADS[leads[k]], float(off[k, leads[k]]))
        members = members[~worst]
    return found


def _after_qrs(group: LeadGroup, members: Integers, onset: float | None) -> Floats:
    """Potential of each beat right after the QRS less that of the median beat, (n_beats, 12) mV."""
    aligned = cut_beats(group, members, onset)
    median = np.median(aligned.beats, axis=0)
    end = qrs_window(median, SAMPLING_STEP, aligned.not_before)[1]
    levels = aligned.beats[:, :, end : end + KNOT].mean(axis=2)
    return np.asarray(levels - np.median(levels, axis=0))


def _worst_of_neighbours(excess: Floats) -> Booleans:
    """Which are above 1, and above what is beside them."""
    padded = np.pad(excess, 1)
    return (excess > 1) & (excess > padded[:-2]) & (excess >= padded[2:])
