"""The recorder's filters: as the file or the user states, or from the spectrum of the beats.

A QRS's own spectrum falls slowly, over octaves; that of a recording behind a steep low-pass breaks
off at its cut-off and falls to the noise of the digits. Two models of the spectrum (dB) about a
frequency tell them apart: a straight line, noise and a Butterworth low-pass above the floor, or a
parabola above it. Gentle filters look like the spectrum of a smooth QRS and are not found.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.signal.windows import blackmanharris

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.recording.filters import (
    DECIBELS,
    MAINS,
    NOTCH_QUALITY,
    Filter,
    FilterKind,
    FilterOrigin,
    applied_filters,
    attenuation,
)
from fascicle.recording.recording import Recording
from fascicle.recording.target_options import TargetOptions

# Electrocardiographs state where they are 3 dB down (ANSI/AAMI EC11, IEC 60601-2-25), not how
# steeply they fall from there; an analogue stage of second order is usual.
RECORDER_ORDER = 2.0
RESOLUTION, BANDWIDTH = 0.5, 2.0  # Hz; of the spectrum, by padding, and of one value of the fit
CUTOFFS = (0.7, 1.4)  # range of a fitted cut-off, as shares of the centre of its search
KNEE = 0.7  # share of that centre at which the line is pinned


def passed_filters(
    recording: Recording, r_peaks: Integers, options: TargetOptions
) -> tuple[Filter, ...]:
    """The recorder's filters and those of this program, in the order in which they were passed."""
    named, stated = recording.filters.lowpass, options.recorder_lowpass
    if named is not None and stated not in (None, named):
        raise InputError(
            f"{recording.source}: the recorder's low-pass is {named:g} Hz in the file, not "
            f"{stated:g} Hz; leave --recorder-lowpass out, or correct the file"
        )
    if (cutoff := named if named is not None else stated) is not None:
        origin = FilterOrigin.STATED if named is None else FilterOrigin.FILE
        filters = [Filter(FilterKind.LOW_PASS, cutoff, origin, RECORDER_ORDER)]
    else:
        estimate = estimated_lowpass(recording.signal, recording.sampling_rate, r_peaks)
        filters = [] if estimate is None else [estimate]
    if (notch := recording.filters.notch) is not None:
        filters.append(Filter(FilterKind.NOTCH, notch, FilterOrigin.FILE, NOTCH_QUALITY))
    return (*filters, *applied_filters(options.lowpass, options.notch))


def estimated_lowpass(signal: Floats, sampling_rate: float, r_peaks: Integers) -> Filter | None:
    """Find the low-pass that a recording has passed, None unless it shows one beyond doubt.

    Of a signal (n_leads, n), mV, at a rate (Hz), with beats at the samples `r_peaks` (n_beats,). It
    is the Butterworth low-pass that describes the fall best; its order need not be whole.
    """
    if (spectrum := _beat_spectrum(signal, sampling_rate, r_peaks)) is None:
        return None
    frequency, level = _levels(*spectrum, sampling_rate)
    believed = []
    for centre in (20.0, 30.0, 40.0, 55.0, 75.0, 100.0, 130.0):  # Hz
        near = (frequency > 0.4 * centre) & (frequency < 2.5 * centre)
        if near.sum() < 15 or frequency[-1] < CUTOFFS[1] * centre:
            continue
        # Where levels fall by less, from one frequency to 1.4 times that, there is no low-pass of
        # the order and depth that count.
        here, its = frequency[near], level[near]
        fall = its - np.interp(1.4 * here, here, its)
        if fall[1.4 * here <= here[-1]].max(initial=0.0) > 15.0:  # dB
            believed.append(_fit(frequency[near], level[near], centre))
    # A true low-pass is found about more than one centre.
    fits = combinations(filter(None, believed), 2)
    agreeing = [min(a, b) for a, b in fits if abs(a[1] / b[1] - 1) < 0.05]
    if not agreeing:
        return None
    _, cutoff, order = min(agreeing)
    return Filter(FilterKind.LOW_PASS, cutoff, FilterOrigin.ESTIMATED, order)


def _beat_spectrum(signal: Floats, rate: float, r_peaks: Integers) -> tuple[Floats, Floats] | None:
    """Frequencies (Hz) and mean energy (mV² s²) over beats and leads; None without a whole beat."""
    size = round(rate / RESOLUTION)
    before, after = round(0.25 * rate), round(0.45 * rate)  # s about R
    energies = []
    for peak in r_peaks[:: max(len(r_peaks) // 30, 1)]:  # more do not make it smoother
        start, stop = max(peak - before, 0), min(peak + after, signal.shape[1])
        beat = signal[:, start:stop]
        beat = beat[np.isfinite(beat).all(axis=1)]
        if stop - start < 0.35 * rate or not len(beat):  # shorter ones blur the spectrum
            continue
        along = np.linspace(0.0, 1.0, stop - start)
        beat = beat - beat[:, :1] - along * (beat[:, -1:] - beat[:, :1])
        spectrum = np.fft.rfft(beat * _taper(peak - start, stop - start, rate), size)
        energies.append((np.abs(spectrum) ** 2).mean(axis=0))
    if not energies:
        return None
    frequency = np.asarray(np.fft.rfftfreq(size, 1 / rate), dtype=np.float64)
    return frequency, np.asarray(np.mean(energies, axis=0)) / rate**2


def _taper(peak: int, size: int, rate: float) -> Floats:
    """Weights (size,), 1 about R, that fall to 0 at both ends by halves of a Blackman-Harris."""
    rise = max(peak - round(0.04 * rate), 1)  # s about R without a taper: the QRS
    fall = max(size - 1 - peak - round(0.06 * rate), 1)
    ends = np.ones(size)
    ends[:rise] = blackmanharris(2 * rise + 1)[:rise]
    ends[-fall:] *= blackmanharris(2 * fall + 1)[-fall:]
    return ends


def _levels(frequency: Floats, energy: Floats, sampling_rate: float) -> tuple[Floats, Floats]:
    """Middle (Hz) and level (dB) of bands, without those of power-line interference."""
    # below 10 Hz are P and T waves
    starts = np.arange(10.0, 0.36 * sampling_rate - BANDWIDTH, BANDWIDTH)
    middles = starts + BANDWIDTH / 2
    lines = np.outer(MAINS, np.arange(1, 11)).ravel()  # with harmonics
    kept = (np.abs(middles[:, None] - lines) > 3.0).all(axis=1)
    width = round(BANDWIDTH / RESOLUTION)
    first = np.searchsorted(frequency, starts - RESOLUTION / 2)
    means = np.array([energy[k : k + width].mean() for k in first])
    return middles[kept], 10 * np.log10(means[kept] + 1e-30)


def _fit(frequency: Floats, level: Floats, centre: float) -> tuple[float, float, float] | None:
    """Fit a low-pass to levels (k,), dB: misfit over that without one, cut-off (Hz) and order.

    None where a smooth wave looks like it, too.
    """
    lowest, highest = float(level.min()), float(level.max())
    knee = float(np.interp(KNEE * centre, frequency, level))
    middle = float(np.interp(centre, frequency, level))
    floor = float(level[-5:].mean())
    lower, upper = [lowest - 60, -10.0, lowest - 20, 0.0], [highest + 40, 400.0, highest, 60.0]
    starts = [
        [knee, 5.0, floor, 1.0, np.log(centre), np.log(order), noise]
        for order in (5.0, 12.0)
        for noise in (middle - 20, middle)
    ]
    cost, best = _least_cost(
        lambda p: _with_lowpass(p, frequency, centre) - level,
        starts,
        [*lower, np.log(CUTOFFS[0] * centre), np.log(2.0), lowest - 20],  # orders 2 to 40
        [*upper, np.log(CUTOFFS[1] * centre), np.log(40.0), highest],
    )
    free, _ = _least_cost(
        lambda p: _without_lowpass(p, frequency, centre) - level,
        [[knee, 5.0, floor, 1.0, 5.0]],
        [*lower, -1000.0],
        [*upper, 1000.0],
    )
    cutoff, order = float(np.exp(best[4])), float(np.exp(best[5]))
    fine = np.geomspace(frequency[0], frequency[-1], 500)
    qrs_level, floor_there = _own_and_floor(best, fine, centre)
    above = _power_sum(qrs_level, best[6]) - floor_there
    depth = float(np.minimum(attenuation(fine / cutoff, order), above).max())
    qrs_slope = float(best[1]) / centre * cutoff * np.log(2)  # dB per octave, downward
    misfit = float(np.sqrt(cost / free))
    believed = (
        25.0 <= cutoff <= 130.0  # Hz
        and min(abs(cutoff / (share * centre) - 1) for share in CUTOFFS) >= 0.01  # not at a bound
        and order >= 8.0  # 48 dB per octave
        and depth >= 20.0  # dB that it removes above the floor
        and 20 * np.log10(2) * order >= 2.0 * qrs_slope
        and misfit <= 0.8
    )
    return (misfit, cutoff, order) if believed else None


def _own_and_floor(p: Floats, frequency: Floats, centre: float) -> tuple[Floats, Floats]:
    """Straight lines (dB): the QRS's own spectrum, and the floor, which no filter lowers."""
    relative = frequency / centre - KNEE
    return p[0] - p[1] * relative, p[2] - p[3] * relative


def _with_lowpass(p: Floats, frequency: Floats, centre: float) -> Floats:
    """Levels (dB): a line and noise, p[6], both behind the low-pass, above the floor."""
    qrs_level, floor = _own_and_floor(p, frequency, centre)
    damping = attenuation(frequency / np.exp(p[4]), float(np.exp(p[5])))
    return _power_sum(_power_sum(qrs_level, p[6]) - damping, floor)


def _without_lowpass(p: Floats, frequency: Floats, centre: float) -> Floats:
    """Levels (dB): a parabola, p[4] its curvature (dB per centre squared), above the floor."""
    qrs_level, floor = _own_and_floor(p, frequency, centre)
    return _power_sum(qrs_level - p[4] * (frequency / centre - KNEE) ** 2, floor)


def _power_sum(level: Floats, other: Floats) -> Floats:
    """Level (dB) of the sum of two powers."""
    return np.asarray(DECIBELS * np.logaddexp(level / DECIBELS, other / DECIBELS))


def _least_cost(
    residuals: Callable[[Floats], Floats], starts: list[list[float]], *limits: list[float]
) -> tuple[float, Floats]:
    """Robust cost and parameters of the best fit from several starts."""
    lower, upper = np.array(limits)
    inside = 1e-6 * (upper - lower)
    fits = [
        least_squares(
            residuals, np.clip(start, lower + inside, upper - inside), bounds=(lower, upper),
            loss="soft_l1", f_scale=2.0, max_nfev=100,  # dB; values farther away count less
        )
        for start in starts
    ]  # fmt: skip
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(best.cost), np.asarray(best.x)
