"""The typical beat of each lead, as recorded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.core.leads import LEADS
from fascicle.recording.recording import Recording

BEFORE, AFTER = 0.26, 0.10  # s around R
MOST_BEATS = 100
FEWEST_BEATS = 2


def typical_beat(recording: Recording, peaks: NDArray[np.int64]) -> NDArray[np.float64]:
    """Median over the beats of each lead.

    Leads recorded in turns give their own beats: all are taken from the same time around R.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    peaks : (n_beats,) array
        R peaks (samples).

    Returns
    -------
    (12, n) array
        Potential (mV) from `BEFORE` before R to `AFTER` after it, at the rate of the recording;
        NaN for leads with fewer than `FEWEST_BEATS` whole beats.
    """
    before = round(BEFORE * recording.sampling_rate)
    after = round(AFTER * recording.sampling_rate)
    typical = np.full((len(LEADS), before + after + 1), np.nan)
    for row, (start, stop) in enumerate(recording.spans):
        own = peaks[(peaks - before >= start) & (peaks + after < stop)]
        own = own[:: max(len(own) // MOST_BEATS, 1)]
        if len(own) >= FEWEST_BEATS:
            cut = [recording.signal[row, peak - before : peak + after + 1] for peak in own]
            typical[row] = np.median(cut, axis=0)
    return typical
