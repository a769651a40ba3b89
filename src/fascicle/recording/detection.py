"""R peaks by the Pan-Tompkins detector on all leads together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

INDEPENDENT = (0, 1, 6, 7, 8, 9, 10, 11)  # I, II, V1 to V6: the eight leads that are measured
BASELINE_WIDTH = 0.2  # s; standard deviation of the Gaussian that is taken as baseline
MAGNITUDE_WIDTH = 0.012  # s; smoothing that merges the notches of one QRS
LEARNING = 4.0  # s; mirrored start in which the detector learns the height of a QRS
LOOK_BACK, LOOK_AHEAD = 0.15, 0.05  # s; the detector marks up to its 0.12 s window after the R


def magnitude(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Root mean square over the eight independent leads, (12, n) mV to (n,) mV."""
    return np.asarray(np.sqrt(np.mean(signal[list(INDEPENDENT)] ** 2, axis=0)))


def remove_baseline(signal: NDArray[np.float64], sampling_rate: float) -> NDArray[np.float64]:
    """Signal (12, n) less its slow part; for detection only, it distorts ST and T."""
    from scipy.ndimage import gaussian_filter1d

    width = BASELINE_WIDTH * sampling_rate
    return np.asarray(signal - gaussian_filter1d(signal, width, axis=-1, mode="nearest"))


def r_peaks(signal: NDArray[np.float64], sampling_rate: float) -> NDArray[np.int64]:
    """R peaks of a recording.

    The detector of Pan and Tompkins (IEEE Trans. Biomed. Eng. 32:230, 1985) as in NeuroKit2 works
    on the root mean square of the leads; each mark then moves to the top of the smoothed root mean
    square, which is the same point of every beat to within a few ms.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV).
    sampling_rate : float
        Samples per second (Hz).

    Returns
    -------
    (n_beats,) array
        Sample of each R peak, increasing; empty when there is none.
    """
    from scipy.ndimage import gaussian_filter1d

    height = magnitude(remove_baseline(signal, sampling_rate))
    smooth = gaussian_filter1d(height, MAGNITUDE_WIDTH * sampling_rate, mode="nearest")
    back, ahead = round(LOOK_BACK * sampling_rate), round(LOOK_AHEAD * sampling_rate)
    peaks = set()
    for mark in _pan_tompkins(height, sampling_rate):
        start = max(int(mark) - back, 0)
        peaks.add(start + int(np.argmax(smooth[start : int(mark) + ahead])))
    return np.array(sorted(peaks), dtype=np.int64)


def _pan_tompkins(height: NDArray[np.float64], sampling_rate: float) -> NDArray[np.int64]:
    """Run the detector after it has learnt on the mirrored start of the recording."""
    import neurokit2

    learning = min(round(LEARNING * sampling_rate), len(height) - 1)
    padded = np.pad(height, (learning, 0), mode="reflect")
    method, rate = "pantompkins1985", round(sampling_rate)
    clean = neurokit2.ecg_clean(padded, sampling_rate=rate, method=method)
    found = neurokit2.ecg_findpeaks(clean, sampling_rate=rate, method=method)["ECG_R_Peaks"]
    marks = np.asarray(found, dtype=np.int64) - learning
    return marks[marks >= 0]
