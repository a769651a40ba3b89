"""The low-pass of a recorder whose file does not name it, from the spectrum of its beats.

A QRS's own spectrum falls slowly, over octaves; that of a recording behind a steep low-pass breaks
off at its cut-off and falls to the noise of the digits. Two models of the spectrum (dB) about a
frequency tell them apart: a straight line, noise and a Butterworth low-pass above the floor, or a
parabola above it. Gentle filters look like the spectrum of a smooth QRS and are not found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.recording.filters import DECIBELS, Filter, FilterKind, FilterOrigin, attenuation

BEFORE, AFTER = 0.25, 0.45  # s of each beat, about R
FLAT_BEFORE, FLAT_AFTER = 0.04, 0.06  # s about R that no taper reaches: most of the QRS
LEAST = 0.35  # s; with less of a beat the spectrum is too blurred
MOST_BEATS = 30  # more do not make the spectrum smoother
RESOLUTION = 0.5  # Hz, by padding
BAND = 2.0  # Hz; the mean power of so much is one value of the fit
FITTED_FROM, FITTED_TO = 10.0, 0.36  # Hz, below it are P and T; share of the sampling rate
SMALLEST = 1e-30  # mV² s²; keeps the logarithm finite
MAINS_LINES, LINE_WIDTH, HARMONICS = (50.0, 60.0), 3.0, 10  # Hz to each side of every harmonic

# Cut-offs (Hz) about which one is looked for, and the range of the fit about each, in shares of it
CENTRES = (20.0, 30.0, 40.0, 55.0, 75.0, 100.0, 130.0)
RANGE, CUTOFFS = (0.4, 2.5), (0.7, 1.4)
FEWEST = 15  # values in that range
KNEE = 0.7  # of the centre: where the line is pinned
ORDERS, FIRST_ORDERS = (2.0, 40.0), (5.0, 12.0)  # and where the fit starts
TOLERANCE = 2.0  # dB; values farther from the model than this count less
EVALUATIONS = 100  # of a fit, at most

# What a low-pass must be like to be believed; in between lies what smooth waves look like
LOWEST, HIGHEST = 25.0, 130.0  # Hz
LEAST_ORDER = 8.0  # 48 dB per octave
LEAST_DEPTH = 20.0  # dB that it takes away before the floor is reached
STEEPER = 2.0  # times as steep as the recording's own spectrum
BETTER = 0.8  # largest ratio of its misfit to that without a low-pass
# Where the spectrum falls by less there is none of that order and depth, and nothing is fitted.
APART, LEAST_FALL = 1.4, 15.0  # ratio of two frequencies, and dB from one to the other
AGREEMENT = 0.05  # between the cut-offs found about two centres
AT_BOUND = 0.01  # of the cut-off; nearer to the end of its range it is not found, but stopped


class _Fitted(NamedTuple):
    """A low-pass that was fitted, and what it is judged by."""

    cutoff: float  # Hz
    order: float
    depth: float  # dB
    slope: float  # of the recording's own spectrum, dB per octave, downward
    misfit: float  # over that without a low-pass
    at_bound: bool

    @property
    def believed(self) -> bool:
        """Whether nothing but a low-pass looks like this."""
        per_octave = 20 * np.log10(2) * self.order
        return bool(
            LOWEST <= self.cutoff <= HIGHEST
            and not self.at_bound
            and self.order >= LEAST_ORDER
            and self.depth >= LEAST_DEPTH
            and per_octave >= STEEPER * self.slope
            and self.misfit <= BETTER
        )


def estimated_lowpass(signal: Floats, sampling_rate: float, r_peaks: Integers) -> Filter | None:
    """Find the low-pass that a recording has passed, if it shows one beyond doubt.

    Parameters
    ----------
    signal : (n_leads, n) array
        Potential (mV) as recorded; leads may be NaN.
    sampling_rate : float
        Samples per second (Hz).
    r_peaks : (n_beats,) array
        Samples of the R peaks.

    Returns
    -------
    Filter or None
        Butterworth low-pass with the cut-off (-3 dB) and the order that describe the fall best; its
        order need not be whole. None where there is no low-pass, a gentle one, or doubt.
    """
    found = beat_spectrum(signal, sampling_rate, r_peaks)
    if found is None:
        return None
    frequency, level = _levels(*found, sampling_rate)
    believed = []
    for centre in CENTRES:
        near = (frequency > RANGE[0] * centre) & (frequency < RANGE[1] * centre)
        if near.sum() < FEWEST or frequency[-1] < CUTOFFS[1] * centre:
            continue
        if _steepest_fall(frequency[near], level[near]) > LEAST_FALL:
            fit = _fit(frequency[near], level[near], centre)
            if fit.believed:
                believed.append(fit)
    # one that is there is found about more than one centre
    agreeing = [
        min(one, other, key=lambda fit: fit.misfit)
        for one, other in combinations(believed, 2)
        if abs(one.cutoff / other.cutoff - 1) < AGREEMENT
    ]
    if not agreeing:
        return None
    best = min(agreeing, key=lambda fit: fit.misfit)
    return Filter(FilterKind.LOW_PASS, best.cutoff, FilterOrigin.ESTIMATED, best.order)


def beat_spectrum(
    signal: Floats, sampling_rate: float, r_peaks: Integers
) -> tuple[Floats, Floats] | None:
    """Mean spectrum of energy over the beats and leads of a recording.

    Parameters
    ----------
    signal : (n_leads, n) array
        Potential (mV); leads may be NaN.
    sampling_rate : float
        Samples per second (Hz).
    r_peaks : (n_beats,) array
        Samples of the R peaks.

    Returns
    -------
    frequency, energy : (k,) array, or None
        In Hz and mV² s²; None where no beat has enough around it.
    """
    size = round(sampling_rate / RESOLUTION)
    before, after = round(BEFORE * sampling_rate), round(AFTER * sampling_rate)
    energies = []
    for peak in r_peaks[:: max(len(r_peaks) // MOST_BEATS, 1)]:
        start, stop = max(peak - before, 0), min(peak + after, signal.shape[1])
        beat = signal[:, start:stop]
        beat = beat[np.isfinite(beat).all(axis=1)]
        if stop - start < LEAST * sampling_rate or not len(beat):
            continue
        along = np.linspace(0.0, 1.0, stop - start)
        beat = beat - beat[:, :1] - along * (beat[:, -1:] - beat[:, :1])
        spectrum = np.fft.rfft(beat * _taper(peak - start, stop - start, sampling_rate), size)
        energies.append((np.abs(spectrum) ** 2).mean(axis=0))
    if not energies:
        return None
    frequency = np.asarray(np.fft.rfftfreq(size, 1 / sampling_rate), dtype=np.float64)
    return frequency, np.asarray(np.mean(energies, axis=0)) / sampling_rate**2


def _taper(peak: int, size: int, sampling_rate: float) -> Floats:
    """Weights (size,), 1 about R, that fall to 0 at both ends by halves of a Blackman-Harris."""
    from scipy.signal.windows import blackmanharris

    rise = max(peak - round(FLAT_BEFORE * sampling_rate), 1)
    fall = max(size - 1 - peak - round(FLAT_AFTER * sampling_rate), 1)
    ends = np.ones(size)
    ends[:rise] = blackmanharris(2 * rise + 1)[:rise]
    ends[-fall:] *= blackmanharris(2 * fall + 1)[-fall:]
    return ends


def _levels(frequency: Floats, energy: Floats, sampling_rate: float) -> tuple[Floats, Floats]:
    """Middle (Hz) and level (dB) of bands, without those that power-line interference may be in."""
    starts = np.arange(FITTED_FROM, FITTED_TO * sampling_rate - BAND, BAND)
    middles = starts + BAND / 2
    lines = np.outer(MAINS_LINES, np.arange(1, HARMONICS + 1)).ravel()
    kept = (np.abs(middles[:, None] - lines) > LINE_WIDTH).all(axis=1)
    width = round(BAND / RESOLUTION)
    first = np.searchsorted(frequency, starts - RESOLUTION / 2)
    means = np.array([energy[k : k + width].mean() for k in first])
    return middles[kept], 10 * np.log10(means[kept] + SMALLEST)


def _steepest_fall(frequency: Floats, level: Floats) -> float:
    """Most (dB) that levels fall between two frequencies of ratio `APART`."""
    from_here = frequency[frequency * APART <= frequency[-1]]
    later = np.interp(APART * from_here, frequency, level)
    return float((level[: len(from_here)] - later).max(initial=0.0))


def _fit(frequency: Floats, level: Floats, centre: float) -> _Fitted:
    """Fit a low-pass to the levels (k,), dB, about a frequency (Hz)."""
    lowest, highest = float(level.min()), float(level.max())
    knee = float(np.interp(KNEE * centre, frequency, level))
    middle = float(np.interp(centre, frequency, level))
    floor = float(level[-5:].mean())
    lower, upper = [lowest - 60, -10.0, lowest - 20, 0.0], [highest + 40, 400.0, highest, 60.0]
    starts = [
        [knee, 5.0, floor, 1.0, np.log(centre), np.log(order), noise]
        for order in FIRST_ORDERS
        for noise in (middle - 20, middle)
    ]
    cost, best = _least_cost(
        lambda p: _with_lowpass(p, frequency, centre) - level,
        starts,
        [*lower, np.log(CUTOFFS[0] * centre), np.log(ORDERS[0]), lowest - 20],
        [*upper, np.log(CUTOFFS[1] * centre), np.log(ORDERS[1]), highest],
    )
    free, _ = _least_cost(
        lambda p: _without_lowpass(p, frequency, centre) - level,
        [[knee, 5.0, floor, 1.0, 5.0]],
        [*lower, -1000.0],
        [*upper, 1000.0],
    )
    cutoff, order = float(np.exp(best[4])), float(np.exp(best[5]))
    fine = np.geomspace(frequency[0], frequency[-1], 500)
    own, floor_there = _own_and_floor(best, fine, centre)
    above = _power_sum(own, best[6]) - floor_there
    return _Fitted(
        cutoff,
        order,
        depth=float(np.minimum(attenuation(fine / cutoff, order), above).max()),
        slope=float(best[1]) / centre * cutoff * np.log(2),
        misfit=float(np.sqrt(cost / free)),
        at_bound=min(abs(cutoff / (share * centre) - 1) for share in CUTOFFS) < AT_BOUND,
    )


def _own_and_floor(p: Floats, frequency: Floats, centre: float) -> tuple[Floats, Floats]:
    """Straight lines (dB): a QRS's own spectrum, and what lies above every filter.

    Each has a level (dB) and a fall (dB per centre); of an averaged beat even the floor falls.
    """
    relative = frequency / centre - KNEE
    return p[0] - p[1] * relative, p[2] - p[3] * relative


def _with_lowpass(p: Floats, frequency: Floats, centre: float) -> Floats:
    """Levels (dB): a line and noise, both behind the low-pass, above the floor.

    After the lines' the parameters are the logarithms of cut-off and order, and the noise (dB).
    """
    own, floor = _own_and_floor(p, frequency, centre)
    taken = attenuation(frequency / np.exp(p[4]), float(np.exp(p[5])))
    return _power_sum(_power_sum(own, p[6]) - taken, floor)


def _without_lowpass(p: Floats, frequency: Floats, centre: float) -> Floats:
    """Levels (dB): a parabola, p[4] its curvature (dB per centre squared), above the floor."""
    own, floor = _own_and_floor(p, frequency, centre)
    return _power_sum(own - p[4] * (frequency / centre - KNEE) ** 2, floor)


def _power_sum(level: Floats, other: Floats) -> Floats:
    """Level (dB) of the sum of two powers."""
    return np.asarray(DECIBELS * np.logaddexp(level / DECIBELS, other / DECIBELS))


def _least_cost(
    residuals: Callable[[Floats], Floats],
    starts: Sequence[Sequence[float]],
    lowest: Sequence[float],
    highest: Sequence[float],
) -> tuple[float, Floats]:
    """Robust cost and parameters of the best fit from several starts."""
    from scipy.optimize import least_squares

    lower, upper = np.array(lowest), np.array(highest)
    inside = 1e-6 * (upper - lower)
    fits = [
        least_squares(
            residuals, np.clip(start, lower + inside, upper - inside), bounds=(lower, upper),
            loss="soft_l1", f_scale=TOLERANCE, max_nfev=EVALUATIONS,
        )
        for start in starts
    ]  # fmt: skip
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(best.cost), np.asarray(best.x)
