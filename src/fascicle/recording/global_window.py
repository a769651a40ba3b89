"""The global QRS: from its onset in the outermost leads to its offset there.

Thresholds of clinical trials and guidelines (120, 130, 150 ms) rest on this duration, which a
cardiologist or an electrocardiograph measures lead by lead: earliest onset in any lead to latest
offset in any lead. It is longer than the window of `fascicle.recording.window`, which all leads
together decide, and takes no part in losses and likelihoods. `benchmarks/global_qrs.py` measures
both against manual marks.
"""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.recording.detection import complete_leads
from fascicle.recording.spatial_velocity import (
    OFFSET,
    ONSET,
    SMOOTHING,
    SpatialVelocity,
    core_of,
    isoelectric_from,
    quiet_spatial_velocity,
    spatial_velocity,
    without_hum,
)
from fascicle.recording.window import SPREAD_PER_SMOOTHING

# Share of the highest speed of all leads together from which one lead moves: at 25 to 30 dB above
# the noise of a mean beat, so that recordings and simulated ECGs without noise have the same level.
MOVING = 0.035
FIRST, LAST = ONSET._replace(level=MOVING), OFFSET._replace(level=MOVING)
# A mark counts that so many other leads confirm, within so many ms: those of J. P. Martínez et al.,
# IEEE Trans Biomed Eng 51:570 (2004), and of their program.
CONFIRMING = 3
ONSET_WITHIN, OFFSET_WITHIN = 12.0, 10.0


def global_qrs_window(
    signal: Floats, step: float, not_before: int = 0, smoothing: float = SMOOTHING
) -> tuple[int, int]:
    """First and last sample of the QRS in the outermost leads.

    Each lead's QRS lasts, outward from the core of all leads, until that lead has been still for
    10 ms, against the straight line of its PR or ST segment. Still is what is slower than `MOVING`
    times the highest speed of all leads together, or than a little more than the lead's noise where
    that is more. The onset is the earliest mark that `CONFIRMING` other leads confirm within
    `ONSET_WITHIN` ms, the offset the latest, within `OFFSET_WITHIN` ms: one noisy lead does not
    decide. Leads that never move so fast have no marks.

    Parameters
    ----------
    signal : (12, n) array
        One beat, recorded (mean) or simulated, potential (mV); leads that are not there are NaN.
    step : float
        Sampling step (ms).
    not_before, smoothing
        As in `fascicle.recording.window.qrs_window`.

    Returns
    -------
    onset, offset : int
        Samples; the global QRS duration is ``(offset - onset) * step`` ms.

    Raises
    ------
    ValueError
        When no lead is there, none moves, or one of many alone.

    Notes
    -----
    Global duration as the CSE working party recommends it (Willems et al., Eur Heart J 6:815,
    1985); the outermost mark that others confirm as in P. Laguna et al., Comput Biomed Res 27:45
    (1994). Marks of single leads are ours.
    """
    beat = signal[:, not_before:]
    independent = beat[complete_leads(signal)]
    first, last = core_of(independent, step)
    together = quiet_spatial_velocity(without_hum(independent, first, last, step), step, smoothing)
    there = np.isfinite(beat).all(axis=1)
    every = spatial_velocity(without_hum(beat[there], first, last, step), together.smoothing, step)
    levels = together.level(FIRST, step), together.level(LAST, step)
    marks = [
        _ends(one, (first, last), levels, step)
        for one in map(every.lead, range(len(every.slope)))
        if one.level(FIRST, step) > MOVING * levels[0]
    ]
    onsets, offsets = np.array(marks).T
    onset = _outermost(onsets, ONSET_WITHIN / step)
    offset = -_outermost(-offsets, OFFSET_WITHIN / step)
    smeared = round(SPREAD_PER_SMOOTHING * (together.smoothing - SMOOTHING) / step)
    onset, offset = min(onset + smeared, first), max(offset - smeared, last)
    return not_before + onset, not_before + offset


def _ends(
    lead: SpatialVelocity, core: tuple[int, int], levels: tuple[float, float], step: float
) -> tuple[int, int]:
    """First and last sample of the QRS in one lead, both outside the core or at its ends."""
    end = lead.slope.shape[1] - 1
    onset = end - isoelectric_from(lead.backward(), end - core[0], FIRST, levels[0], step)
    return onset, isoelectric_from(lead, core[1], LAST, levels[1], step)


def _outermost(marks: Floats, within: float) -> int:
    """The smallest mark that `CONFIRMING` others confirm, or the median where none is confirmed."""
    marks = np.sort(marks)
    others = min(CONFIRMING, len(marks) - 1)
    confirmed = np.flatnonzero(marks[others:] - marks[: len(marks) - others] <= within)
    return int(marks[confirmed[0]] if confirmed.size else np.median(marks))
