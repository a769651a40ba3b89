"""T waves that are as high as a QRS, and would be taken for beats of their own."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats, Integers

WITHIN = 0.36  # s after a beat; of Pan and Tompkins, as is the look at the steepness
STEEPNESS = 0.7  # of that of the beat before; that of a QRS is more, but of slow ectopic beats
SLOWNESS = 0.046  # s; height over steepness, of a QRS less: up to 0.048 of few ectopic beats
SLOPE_SMOOTHING, SLOPE_REACH = 0.005, 0.08  # s; standard deviation; each side
WAVE_SMOOTHING, WAVE_REACH = 0.02, 0.1  # s; the same for heights
FOLLOWING = 0.25  # of its height; a P wave is less, and the T wave of most beats more
FROM, UNTIL = 0.14, 0.4  # s after a beat, in which its T wave is looked for
BEFORE_NEXT = 0.1  # s; the look ends that long before the next beat
SHORTEST = 0.06  # s; of less nothing can be said


def t_waves(beats: Integers, leads: Floats, rate: float) -> Integers:
    """Those of the beats found that are the T wave of the beat before.

    Such a one comes soon after a beat, is less steep, slow for its height, and no wave follows it.
    The first two are of Pan and Tompkins (IEEE Trans. Biomed. Eng. 32:230, 1985); the others keep
    early ectopic beats, which have a QRS and a T wave of their own.

    Parameters
    ----------
    beats : (n_beats,) array
        Samples of what was found, increasing.
    leads : (k, n) array
        Potential (mV).
    rate : float
        Samples per second (Hz).
    """
    slope = gaussian_filter1d(leads, SLOPE_SMOOTHING * rate, axis=-1, order=1)
    slope = np.sqrt(np.mean(slope**2, axis=0))
    reach = round(SLOPE_REACH * rate)
    steepness = [float(slope[max(beat - reach, 0) : beat + reach + 1].max()) for beat in beats]
    wave = gaussian_filter1d(leads, WAVE_SMOOTHING * rate, axis=-1)
    nexts = [*(beats[1:] - BEFORE_NEXT * rate), leads.shape[1]]
    found = []
    before = 0
    for k in range(1, len(beats)):
        height = _height(wave, beats[k] - WAVE_REACH * rate, beats[k] + WAVE_REACH * rate)
        soon = beats[k] - beats[before] < WITHIN * rate
        gentle = steepness[k] < STEEPNESS * steepness[before]
        slow = height > SLOWNESS * rate * steepness[k]
        after = beats[k] + FROM * rate, min(beats[k] + UNTIL * rate, nexts[k])
        told = after[1] - after[0] >= SHORTEST * rate
        if soon and gentle and slow and told and _height(wave, *after) < FOLLOWING * height:
            found.append(beats[k])
        else:
            before = k
    return np.array(found, dtype=np.int64)


def _height(wave: Floats, start: float, stop: float) -> float:
    """Root mean square over the leads of what each spans between two samples (mV)."""
    spans = np.ptp(wave[:, max(round(start), 0) : round(stop) + 1], axis=1)
    return float(np.sqrt(np.mean(spans**2)))
