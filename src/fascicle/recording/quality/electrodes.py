"""Exchanged electrodes of the limbs."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS, lead_matrix
from fascicle.recording.classes import cut
from fascicle.recording.quality.check_result import Check, CheckResult, Severity
from fascicle.recording.recording import Recording

P_WAVE = (-0.26, -0.10)  # s from R
QRS = (-0.06, 0.08)  # s from R
LIKENESS = Check("lead I, II against V6", "", -0.4)
EDGE = 0.01  # s at each end of a wave that is taken as its level
BEFORE, AFTER = 0.26, 0.10  # s around R of the median beat
MOST_BEATS = 100
FEWEST_BEATS = 2
LEFT_LEADS = (LEADS.index("V6"), LEADS.index("V5"))  # the first that is there
EXCHANGES = {"RA-LA": [1, 0, 2], "RA-LL": [2, 1, 0]}  # limb electrodes, as exchanged


def median_beat(recording: Recording, peaks: Integers) -> Floats:
    """Median (12, n), mV, over the beats of each lead, at the rate of the recording.

    It spans `BEFORE` to `AFTER` about the R peaks (n_beats,), samples; leads recorded at other
    times give their own beats, and those with fewer than `FEWEST_BEATS` whole ones NaN.
    """
    before = round(BEFORE * recording.sampling_rate)
    after = round(AFTER * recording.sampling_rate)
    median = np.full((len(LEADS), before + after + 1), np.nan)
    for row, (start, stop) in enumerate(recording.spans):
        own = peaks[(peaks - before >= start) & (peaks + after < stop)]
        own = own[:: max(len(own) // MOST_BEATS, 1)]
        if len(own) >= FEWEST_BEATS:
            median[row] = np.median(cut(recording.signal[[row]], own, before, after), axis=0)
    return median


def check_limb_electrodes(recording: Recording, median: Floats) -> list[CheckResult]:
    """Suspect the right arm's electrode of having been exchanged with another limb's, by beats.

    Leads I and II look to the left and down, as V6 does: P wave and QRS mostly have the same sense
    in all three. Exchanged arms turn lead I upside down, and exchanged right arm and left leg lead
    II; V6 stays as it is. The figure is the mean of the correlations with V6 in the P wave and in
    the QRS, so that a QRS axis to the right alone does not count (a P wave that is negative in lead
    I is the better sign). Exchanged left arm and left leg look like a turned axis. The beats are
    those of `median_beat`.

    Returns
    -------
    list of CheckResult
        One; the lower likeness of I and II with V6 (with V5 where there is no V6).

    References
    ----------
    V. N. Batchvarov, M. Malik, A. J. Camm, Europace 9:1081 (2007); K. K. Ho, S. K. Ho, J.
    Electrocardiol. 34:161 (2001), on the P wave.
    """
    left = [row for row in LEFT_LEADS if np.isfinite(median[row]).all()]
    if not left or not np.isfinite(median[:2]).all():
        message = "not checked: needs leads I, II and V6 or V5, and two beats"
        return [LIKENESS.found(np.nan, message, Severity.FINE)]
    rate = recording.sampling_rate
    reference = median[left[0]]
    now = _likeness(median[:2], reference, rate)
    if min(now) >= LIKENESS.limit:
        return [LIKENESS.found(min(now))]
    limb = lead_matrix()[:2, :3]
    after = {
        pair: sum(_likeness(limb[:, order] @ np.linalg.pinv(limb) @ median[:2], reference, rate))
        for pair, order in EXCHANGES.items()
    }
    pair = max(after, key=after.__getitem__)
    inverted = "I" if now[0] < now[1] else "II"
    message = (
        f"lead {inverted} runs against {LEADS[left[0]]} in P wave and QRS: electrodes "
        f"{pair.replace('-', ' and ')} are probably exchanged (or the heart lies on the right, or "
        f"the rhythm is not from the sinus node); to undo it: --swap {pair}"
    )
    return [LIKENESS.found(min(now), message)]


def _likeness(leads: Floats, reference: Floats, rate: float) -> tuple[float, float]:
    """Mean of the correlations in P wave and QRS of leads I and II with another lead."""
    one, two = (
        (_correlation(lead, reference, P_WAVE, rate) + _correlation(lead, reference, QRS, rate)) / 2
        for lead in leads
    )
    return one, two


def _correlation(x: Floats, y: Floats, wave: tuple[float, float], rate: float) -> float:
    """Correlation of two leads (n,) over a wave, each less the line between its ends."""
    start, stop = (round((BEFORE + end) * rate) for end in wave)
    a, b = (_detrended(lead[start : stop + 1], max(round(EDGE * rate), 1)) for lead in (x, y))
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / scale if scale > 0 else 0.0


def _detrended(x: Floats, edge: int) -> Floats:
    line = np.linspace(x[:edge].mean(), x[-edge:].mean(), len(x))
    return np.asarray(x - line - (x - line).mean())
