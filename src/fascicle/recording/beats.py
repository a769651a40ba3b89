"""The beats that make the target: chosen, cut out, levelled, and their QRS window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fascicle.recording import alignment
from fascicle.recording.baseline import quiet_start, subtract_drift
from fascicle.recording.choices import Choices
from fascicle.recording.sorted_beats import SortedBeats
from fascicle.recording.target import SAMPLING_STEP
from fascicle.recording.window import qrs_window

BEFORE, AFTER = 250.0, 450.0  # ms around R
BEFORE_SHARE, AFTER_SHARE = 0.4, 0.6  # of the RR interval, at fast rates


@dataclass(frozen=True)
class CutBeats:
    """Beats that were cut out of a recording.

    Attributes
    ----------
    beats : (n_beats, 12, n_time) array
        Potential (mV) every `SAMPLING_STEP`, less the isoelectric level and its drift.
    before : int
        Sample of the R peak in each.
    not_before : int
        Sample at which the QRS may begin: after the pacing spike that fired the beats; 0 if none.
    doubt : float
        Standard deviation (ms) with which groups of leads are aligned that were recorded in turns.
    """

    beats: NDArray[np.float64]
    before: int
    not_before: int
    doubt: float = 0.0

    @property
    def time(self) -> NDArray[np.float64]:
        """Time from the R peak (ms), shape (n_time,)."""
        return SAMPLING_STEP * (np.arange(self.beats.shape[2], dtype=np.float64) - self.before)


def extent(found: SortedBeats) -> tuple[int, int]:
    """Samples before and after R that a beat has."""
    before, after = BEFORE, AFTER
    if len(found.peaks) > 1:
        interval = float(np.nanmedian(found.intervals))
        before, after = min(before, BEFORE_SHARE * interval), min(after, AFTER_SHARE * interval)
    before, after = round(before / SAMPLING_STEP), round(after / SAMPLING_STEP)
    if len(found.peaks) == 1:
        peak = int(found.peaks[0])
        return min(before, peak), min(after, found.signal.shape[1] - 1 - peak)
    return before, after


def reasons_against(
    found: SortedBeats, choices: Choices, label: str, first_number: int
) -> list[str]:
    """Why each beat is not one of the target's; an empty text where it is.

    Parameters
    ----------
    found : SortedBeats
        All beats.
    choices : Choices
        Decisions of the user.
    label : str
        The class of the target.
    first_number : int
        What the user calls the first of the beats.
    """
    whole = alignment.complete(found.peaks, found.signal.shape[1], *extent(found))
    reasons = []
    for k, one in enumerate(found.labels):
        number = first_number + k
        if not whole[k]:
            end = "start" if found.peaks[k] < found.signal.shape[1] / 2 else "end"
            reasons.append(f"cut off by the {end} of the recording")
        elif number in choices.exclude:
            reasons.append("excluded")
        elif choices.beats is not None:
            reasons.append("" if number in choices.beats else "not chosen")
        else:
            reasons.append("" if one == label else f"class {one}")
    return reasons


def cut_beats(found: SortedBeats, members: NDArray[np.int64], onset: float | None) -> CutBeats:
    """Cut out beats and subtract the line through their isoelectric points.

    Parameters
    ----------
    found : SortedBeats
        All beats.
    members : (n_beats,) array
        Which ones to cut out, increasing, each with its whole window.
    onset : float, optional
        Onset of the QRS (ms from R) where the user has given it.
    """
    before, after = extent(found)
    peaks = found.peaks[members]
    raw = alignment.cut(found.signal, peaks, before, after)
    not_before = _end_of_spikes(found, members, before)
    middle = np.median(raw, axis=0)
    first = qrs_window(middle, SAMPLING_STEP, not_before)[0]
    if onset is not None:
        first = min(max(before + round(onset / SAMPLING_STEP), 0), raw.shape[-1] - 1)
    knots = peaks - before + quiet_start(middle, first, SAMPLING_STEP)
    beats = subtract_drift(found.signal, knots, peaks, before, raw.shape[-1])
    return CutBeats(beats, before, not_before)


def _end_of_spikes(found: SortedBeats, members: NDArray[np.int64], before: int) -> int:
    """Sample of the window after the spikes that fired most of the beats; 0 if none did."""
    ends = [found.spike_before(int(k)) for k in members]
    offsets = [
        end - found.peaks[k] + before
        for k, end in zip(members, ends, strict=True)
        if end is not None
    ]
    if len(offsets) <= len(members) / 2:
        return 0
    return max(int(np.median(offsets)), 0)
