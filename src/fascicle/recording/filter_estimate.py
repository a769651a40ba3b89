"""The recorder's filters: stated in the file or by the user, or estimated from the beats' spectrum.

The spectrum of a QRS falls gradually, over octaves. After a steep low-pass it drops at the cut-off,
down to the quantisation noise. Two models of the spectrum (dB) around a frequency are compared: a
straight line with noise, both behind a Butterworth low-pass, above a noise floor; and a parabola
above the floor. A low-pass of low order cannot be told from a smooth QRS and is not detected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares
from scipy.signal.windows import blackmanharris

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.recording.choices import TargetOptions
from fascicle.recording.filters import (
    DECIBELS,
    MAINS,
    Filter,
    FilterKind,
    FilterOrigin,
    applied_filters,
    attenuation,
)
from fascicle.recording.recording import Recording


def passed_filters(
    recording: Recording, r_peaks: Integers, options: TargetOptions
) -> tuple[Filter, ...]:
    """Filters that the beats have passed, in order: the recorder's, then those of this program."""
    in_file, stated = recording.filters.lowpass, options.recorder_lowpass
    if in_file is not None and stated not in (None, in_file):
        raise InputError(
            f"{recording.source}: the recorder's low-pass is {in_file:g} Hz in the file, not "
            f"{stated:g} Hz; leave --recorder-lowpass out, or correct the file"
        )
    if (cutoff := in_file if in_file is not None else stated) is not None:
        origin = FilterOrigin.STATED if in_file is None else FilterOrigin.FILE
        kind = FilterKind.LOW_PASS
        filters = [Filter(kind, cutoff, origin, kind.usual_shape)]
    else:
        estimate = estimated_lowpass(recording.signal, recording.sampling_rate, r_peaks)
        filters = [] if estimate is None else [estimate]
    if (notch := recording.filters.notch) is not None:
        kind = FilterKind.NOTCH
        filters.append(Filter(kind, notch, FilterOrigin.FILE, kind.usual_shape))
    return (*filters, *applied_filters(options.lowpass, options.notch))


def estimated_lowpass(signal: Floats, sampling_rate: float, r_peaks: Integers) -> Filter | None:
    """Estimate the low-pass that a signal (n_leads, n), mV, has passed; None if there is doubt.

    The estimate is the Butterworth low-pass that fits the spectrum best; its order need not be an
    integer. The sampling rate is in Hz; `r_peaks` (n_beats,) are samples.
    """
    if (levels := _levels(signal, sampling_rate, r_peaks)) is None:
        return None
    frequency, level = levels
    low_passes = []
    for centre in (20.0, 30.0, 40.0, 55.0, 75.0, 100.0, 130.0):  # Hz
        near = (frequency > 0.4 * centre) & (frequency < 2.5 * centre)
        if near.sum() < 15 or frequency[-1] < _Fall.cutoffs[1] * centre:
            continue
        # A low-pass of sufficient order and depth lowers the level by more than this from some
        # frequency to 1.4 times that.
        x, y = frequency[near], level[near]
        fall = y - np.interp(1.4 * x, x, y)
        if fall[1.4 * x <= x[-1]].max(initial=0.0) > 15.0:  # dB
            low_passes.append(_Fall(x, y, centre).fit())
    # An actual low-pass is found from more than one centre.
    fits = combinations(filter(None, low_passes), 2)
    agreeing = [min(a, b) for a, b in fits if abs(a[1] / b[1] - 1) < 0.05]
    if not agreeing:
        return None
    _, cutoff, order = min(agreeing)
    return Filter(FilterKind.LOW_PASS, cutoff, FilterOrigin.ESTIMATED, order)


def _levels(signal: Floats, rate: float, r_peaks: Integers) -> tuple[Floats, Floats] | None:
    """Centres (Hz) of bands and levels (dB) of the mean energy of beats and leads in them.

    None without a complete beat. Bands of power-line interference are left out.
    """
    resolution, bandwidth = 0.5, 2.0  # Hz; of the zero-padded spectrum, and of a band
    size = round(rate / resolution)
    before, after = round(0.25 * rate), round(0.45 * rate)  # s about R
    energies = []
    for peak in r_peaks[:: max(len(r_peaks) // 30, 1)]:  # 30 to 60 beats suffice
        start, stop = max(peak - before, 0), min(peak + after, signal.shape[1])
        beat = signal[:, start:stop]
        beat = beat[np.isfinite(beat).all(axis=1)]
        if stop - start < 0.35 * rate or not len(beat):  # shorter ones blur the spectrum
            continue
        along = np.linspace(0.0, 1.0, stop - start)
        beat = beat - beat[:, :1] - along * (beat[:, -1:] - beat[:, :1])
        # The taper falls to 0 at both ends by halves of a Blackman-Harris window, which begin 0.04
        # s before and 0.06 s after R, about the ends of the QRS.
        rise = max(peak - start - round(0.04 * rate), 1)
        fall = max(stop - 1 - peak - round(0.06 * rate), 1)
        taper = np.ones(stop - start)
        taper[:rise] = blackmanharris(2 * rise + 1)[:rise]
        taper[-fall:] *= blackmanharris(2 * fall + 1)[-fall:]
        energies.append((np.abs(np.fft.rfft(beat * taper, size)) ** 2).mean(axis=0))
    if not energies:
        return None
    frequency = np.asarray(np.fft.rfftfreq(size, 1 / rate), dtype=np.float64)
    energy = np.asarray(np.mean(energies, axis=0)) / rate**2  # mV² s²
    # P and T waves are below 10 Hz
    starts = np.arange(10.0, 0.36 * rate - bandwidth, bandwidth)
    middles = starts + bandwidth / 2
    lines = np.outer(MAINS, np.arange(1, 11)).ravel()  # with harmonics
    kept = (np.abs(middles[:, None] - lines) > 3.0).all(axis=1)
    width = round(bandwidth / resolution)
    first = np.searchsorted(frequency, starts - resolution / 2)
    means = np.array([energy[k : k + width].mean() for k in first])
    return middles[kept], 10 * np.log10(means[kept] + 1e-30)


@dataclass(frozen=True)
class _Fall:
    """Search for a low-pass about a `centre` (Hz), in levels (k,), dB, at frequencies (k,), Hz."""

    frequency: Floats
    level: Floats
    centre: float

    cutoffs: ClassVar[tuple[float, float]] = (0.7, 1.4)  # range of the fitted cut-off, over centre
    knee: ClassVar[float] = 0.7  # frequency at which the line's level is p[0], over the centre

    def fit(self) -> tuple[float, float, float] | None:
        """Fit both models; misfit with over that without a low-pass, cut-off (Hz) and order.

        None if a smooth QRS without a low-pass might have this spectrum.
        """
        frequency, level, centre = self.frequency, self.level, self.centre
        lowest, highest = float(level.min()), float(level.max())
        knee = float(np.interp(self.knee * centre, frequency, level))
        middle = float(np.interp(centre, frequency, level))
        floor = float(level[-5:].mean())
        lower, upper = [lowest - 60, -10.0, lowest - 20, 0.0], [highest + 40, 400.0, highest, 60.0]
        starts = [
            [knee, 5.0, floor, 1.0, np.log(centre), np.log(order), noise]
            for order in (5.0, 12.0)
            for noise in (middle - 20, middle)
        ]
        cost, best = _least_cost(
            self.misfit_with_lowpass,
            starts,
            [*lower, np.log(self.cutoffs[0] * centre), np.log(2.0), lowest - 20],  # orders 2 to 40
            [*upper, np.log(self.cutoffs[1] * centre), np.log(40.0), highest],
        )
        cost_without, _ = _least_cost(
            self.misfit_without, [[knee, 5.0, floor, 1.0, 5.0]], [*lower, -1000.0], [*upper, 1000.0]
        )
        cutoff, order = float(np.exp(best[4])), float(np.exp(best[5]))
        grid = np.geomspace(frequency[0], frequency[-1], 500)
        qrs_level, floor_level = self.qrs_and_floor(best, grid)
        qrs_above_floor = _power_sum(qrs_level, best[6]) - floor_level
        depth = float(np.minimum(attenuation(grid / cutoff, order), qrs_above_floor).max())
        qrs_slope = float(best[1]) / centre * cutoff * np.log(2)  # dB per octave, downward
        misfit = float(np.sqrt(cost / cost_without))
        at_bound = min(abs(cutoff / (share * centre) - 1) for share in self.cutoffs) < 0.01
        accepted = (
            25.0 <= cutoff <= 130.0  # Hz
            and not at_bound
            and order >= 8.0  # 48 dB per octave
            and depth >= 20.0  # dB of attenuation above the floor
            and 20 * np.log10(2) * order >= 2.0 * qrs_slope
            and misfit <= 0.8
        )
        return (misfit, cutoff, order) if accepted else None

    def qrs_and_floor(self, p: Floats, frequency: Floats) -> tuple[Floats, Floats]:
        """QRS spectrum p[0] − p[1]x and noise floor p[2] − p[3]x (dB); x = frequency/centre − knee.

        Filters do not lower the floor.
        """
        relative = frequency / self.centre - self.knee
        return p[0] - p[1] * relative, p[2] - p[3] * relative

    def misfit_with_lowpass(self, p: Floats) -> Floats:
        """Misfit (dB) of line and noise p[6] behind a low-pass (exp p[4] Hz, order exp p[5])."""
        qrs_level, floor = self.qrs_and_floor(p, self.frequency)
        damping = attenuation(self.frequency / np.exp(p[4]), float(np.exp(p[5])))
        return _power_sum(_power_sum(qrs_level, p[6]) - damping, floor) - self.level

    def misfit_without(self, p: Floats) -> Floats:
        """Misfit (dB) of a parabola above the floor; p[4] is its curvature (dB per centre²)."""
        qrs_level, floor = self.qrs_and_floor(p, self.frequency)
        parabola = qrs_level - p[4] * (self.frequency / self.centre - self.knee) ** 2
        return _power_sum(parabola, floor) - self.level


def _power_sum(level: Floats, other: Floats) -> Floats:
    """Level (dB) of the sum of two powers given as levels (dB)."""
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
