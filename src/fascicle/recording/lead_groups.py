"""Leads recorded at the same time, and their beats: R peaks and classes of morphology."""

from __future__ import annotations

import math
from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS, independent_rows
from fascicle.recording.choices import TargetOptions
from fascicle.recording.detection import magnitude, r_peaks
from fascicle.recording.filters import SAMPLING_STEP, TARGET_RATE, applied_filters, resample
from fascicle.recording.recording import Recording
from fascicle.recording.window import qrs_window

HALF_WIDTH = 100  # samples each side of R that are compared
LARGEST_SHIFT = 60  # samples; an R' may be as tall as the R, and that far away
ALIKE = 0.2  # share of a beat's energy by which beats of one class differ: correlation 0.9 or more


@dataclass(frozen=True)
class LeadGroup:
    """Leads that were recorded at the same time, and the beats in that time.

    Most recordings are one group; on paper, leads are recorded one group after another. The signal
    is without pacing spikes and filtered if so chosen; leads recorded at other times are NaN. Beats
    of one class are aligned on all leads; A is the class with most beats, of equals the narrower.
    """

    start: float  # s; time of the first sample in the recording
    signal: Floats  # (12, n), mV, every `SAMPLING_STEP`
    spikes: Integers  # (k, 2); first sample of each pacing spike and the one after its last
    noise: float  # energy between beats, see `noise_energy`
    peaks: Integers  # (n_beats,); sample of each beat's R peak
    labels: tuple[str, ...]  # class of each beat
    additional: Floats  # (k, n), mV, likewise, of additional leads, which decide nothing

    @property
    def leads(self) -> str:
        """Names of the leads, for messages."""
        names = [LEADS[row] for row in np.flatnonzero(np.isfinite(self.signal).any(axis=1))]
        return "all leads" if len(names) == len(LEADS) else ", ".join(names)

    @property
    def times(self) -> Floats:
        """Times of the R peaks (s from the start of the recording), shape (n_beats,)."""
        return np.asarray(self.start + self.peaks / TARGET_RATE)

    @property
    def intervals(self) -> Floats:
        """Time since the beat before (ms), NaN for the first, shape (n_beats,)."""
        return np.concatenate([[np.nan], SAMPLING_STEP * np.diff(self.peaks)])

    @property
    def height(self) -> float:
        """Largest deflection, peak to peak, of the median beat of class A in any lead (mV)."""
        return _height(self.signal, self.peaks[self.of_class("A")])

    @property
    def signal_to_noise(self) -> float:
        """Energy of the median beat of class A over that of the noise between beats."""
        independent = self.signal[_independent(self.signal)]
        beats = cut(independent, self.peaks[self.of_class("A")], HALF_WIDTH, HALF_WIDTH)
        median = np.median(detrended(beats), axis=0)
        return float((median**2).sum()) / self.noise if self.noise else math.inf

    def of_class(self, label: str) -> Integers:
        """Indices of the beats with a label, increasing."""
        return np.flatnonzero([beat_label == label for beat_label in self.labels])

    def describe(self, label: str) -> str:
        """Notable features of a class: paced, early, wide; empty if it has none."""
        members, words = self.of_class(label), []
        if end_of_spikes(self.signal, self.spikes, self.peaks[members], 2 * HALF_WIDTH):
            words.append("paced")
        if label != "A":
            rr = self.intervals[members]
            # premature: sooner than 85 % of the usual interval
            if np.isfinite(rr).any() and np.nanmedian(rr) < 0.85 * np.nanmedian(self.intervals):
                words.append("early")
            both = (self.peaks[self.of_class(name)] for name in (label, "A"))
            width, usual_width = (_qrs_width(self.signal, of, self.spikes) for of in both)
            if width > max(120.0, usual_width + 20.0):  # ms
                words.append("wide")
        return ", ".join(words)


def end_of_spikes(signal: Floats, spikes: Integers, peaks: Integers, before: int) -> int:
    """Sample at which the pacing spikes that fired most beats at `peaks` end; 0 if none did.

    Counted from `before` samples ahead of R: the median over the beats of the last spike within 200
    ms before R, or, where both ventricles are paced, of the first of those that follow each other
    within 50 ms. `spikes` (k, 2) are first samples and those after the last. A spike into a QRS
    that has begun, as in pseudofusion, fired none.
    """
    extents = []
    for peak in peaks:
        near = spikes[(spikes[:, 1] <= peak) & (spikes[:, 0] > peak - 200.0 / SAMPLING_STEP)]
        if len(near):
            alone = np.append(True, near[1:, 0] - near[:-1, 1] > 50.0 / SAMPLING_STEP)
            extents.append(near[np.flatnonzero(alone)[-1]] - peak)
    if len(extents) <= len(peaks) / 2:
        return 0
    first, end = np.median(extents, axis=0).astype(int)
    ahead = np.ptp(np.median(cut(signal, peaks + first, 30, -2), axis=0), axis=1)
    return max(int(end) + before, 0) if np.nanmax(ahead) < 0.2 * _height(signal, peaks) else 0


def lead_groups(recording: Recording, spikes: Integers, options: TargetOptions) -> list[LeadGroup]:
    """Split a recording into leads recorded at the same time, and find and sort their beats.

    In the order of time. A lead that runs through several stretches, such as a rhythm strip, is in
    each. The pacing `spikes` (k, 2), first sample and the one after the last, are taken out.
    """
    rate, groups = recording.sampling_rate, []
    all_leads = np.array([*recording.signal, *recording.additional.values()])
    for first, stop in stretches(recording):
        leads = resample(complete_in(all_leads, first, stop), rate)
        for filter_ in applied_filters(options.lowpass, options.notch):
            leads = filter_.apply(leads)
        signal, additional = leads[: len(LEADS)], leads[len(LEADS) :]
        inside = spikes[(spikes[:, 0] >= first) & (spikes[:, 0] < stop)] - first
        inside = np.round(inside * (TARGET_RATE / rate)).astype(np.int64)
        independent = signal[_independent(signal)]
        noise = noise_energy(independent)
        if signal.shape[1] < 1.5 * TARGET_RATE:  # a single (median) beat, as recorders print it
            peaks = np.array([int(np.argmax(magnitude(detrended(signal))))])
        else:
            peaks, margin = r_peaks(signal, TARGET_RATE), 40.0 / SAMPLING_STEP  # ms from the ends
            peaks = peaks[(peaks >= margin) & (peaks < signal.shape[1] - margin)]
        labels: tuple[str, ...] = ()
        if len(peaks):
            classes, peaks = cluster_morphology(independent, peaks, noise)
            peaks, labels = _name_classes(signal, classes, peaks, inside)
        groups.append(LeadGroup(first / rate, signal, inside, noise, peaks, labels, additional))
    return groups


def stretches(recording: Recording) -> list[tuple[int, int]]:
    """First sample and the one after the last of each stretch with the same leads, in order."""
    spans = {(first, stop) for first, stop in recording.spans[recording.recorded].tolist()}
    distinct: list[tuple[int, int]] = []
    for first, stop in sorted(sorted(spans), key=lambda span: span[1] - span[0]):  # longest last
        for k, (begin, end) in enumerate(distinct):
            if min(end, stop) - max(begin, first) >= 0.9 * (end - begin):
                if stop - first < (end - begin) / 0.9:
                    # leads of one group, whose ends were digitised unevenly
                    distinct[k] = (max(begin, first), min(end, stop))
                break
        else:
            distinct.append((first, stop))
    return sorted(distinct)


def complete_in(signal: Floats, first: int, stop: int) -> Floats:
    """Leads (k, n) from one sample to another; those not recorded all along are NaN."""
    part = signal[:, first:stop].copy()
    part[~np.isfinite(part).all(axis=1)] = np.nan
    return part


def _independent(signal: Floats) -> Integers:
    """Rows of the recorded leads that are linearly independent."""
    return independent_rows(np.asarray(np.isfinite(signal).all(axis=1), dtype=np.bool_))


def _name_classes(
    signal: Floats, classes: Integers, peaks: Integers, spikes: Integers
) -> tuple[Integers, tuple[str, ...]]:
    """R peaks in the order of time, and the label of each beat's class.

    A is the class with the most beats, and of equally many the one with the narrower QRS, unless
    that is low enough for a P or T wave. A wave that was found next to its QRS moves to the R peak
    of that, and does not count as a beat.
    """
    moved = peaks.copy()
    for number in np.unique(classes):
        moved[classes == number] += _to_r_peak(signal, peaks[classes == number], spikes)
    moved = np.clip(moved, 0, signal.shape[1] - 1)
    distances, kept = np.abs(moved - peaks), list[int]()
    for k in np.argsort(moved, kind="stable"):  # the least moved of those within 120 ms stays
        if kept and (moved[k] - moved[kept[-1]]) * SAMPLING_STEP < 120.0:
            kept[-1] = k if distances[k] < distances[kept[-1]] else kept[-1]
        else:
            kept.append(k)
    peaks, classes = moved[kept], classes[kept]
    of_class = {k: peaks[classes == k] for k in np.unique(classes).tolist()}
    heights = {k: _height(signal, beats) for k, beats in of_class.items()}
    rank = {
        k: (-len(beats), heights[k] < max(heights.values()) / 3, _qrs_width(signal, beats, spikes))
        for k, beats in of_class.items()
    }
    names = {}  # A to Z, then A2 to Z2 and so on
    for place, k in enumerate(sorted(rank, key=rank.__getitem__)):
        cycle, letter = divmod(place, len(ascii_uppercase))
        names[k] = ascii_uppercase[letter] + (str(cycle + 1) if cycle else "")
    return peaks, tuple(names[k] for k in classes)


def _to_r_peak(signal: Floats, peaks: Integers, spikes: Integers) -> int:
    """Samples from the common mark of aligned beats to the R peak of their median.

    The R peak is the median over the leads of the time of each lead's R wave, its largest upward
    deflection, or of its largest deflection where it has no R wave.
    """
    median, onset, offset = _median_beat(signal, peaks, spikes)
    qrs = median[np.isfinite(median).all(axis=1), onset : offset + 1]
    qrs = qrs - np.linspace(qrs[:, 0], qrs[:, -1], qrs.shape[1], axis=1)
    has_r = qrs.max(axis=1) >= 0.1 * np.abs(qrs).max(axis=1)
    tops = np.where(has_r, qrs.argmax(axis=1), qrs.argmin(axis=1))
    return int(np.median(tops)) + onset - 2 * HALF_WIDTH


def _height(signal: Floats, peaks: Integers) -> float:
    """Largest deflection, peak to peak, of the median of aligned beats in any lead (mV)."""
    beats = cut(signal, peaks, HALF_WIDTH, HALF_WIDTH)
    return float(np.nanmax(np.ptp(np.median(beats, axis=0), axis=1)))


def _qrs_width(signal: Floats, peaks: Integers, spikes: Integers) -> float:
    """QRS duration (ms) of the median of aligned beats."""
    _, onset, offset = _median_beat(signal, peaks, spikes)
    return (offset - onset) * SAMPLING_STEP


def _median_beat(signal: Floats, peaks: Integers, spikes: Integers) -> tuple[Floats, int, int]:
    """Median of aligned beats, `2 HALF_WIDTH` samples each side of R, and the ends of its QRS."""
    reach = 2 * HALF_WIDTH
    median = np.median(cut(signal, peaks, reach, reach), axis=0)
    return median, *qrs_window(median, end_of_spikes(signal, spikes, peaks, reach))


def cut(signal: Floats, peaks: Integers, before: int, after: int) -> Floats:
    """Windows (n_beats, n_leads, before + after + 1) of a signal (n_leads, n) around its peaks.

    Beyond its ends the signal keeps its first or last value.
    """
    within = np.clip(peaks[:, None] + np.arange(-before, after + 1), 0, signal.shape[1] - 1)
    return np.stack([signal[:, samples] for samples in within])


def detrended(beats: Floats) -> Floats:
    """Beats (..., n_time) less the straight line that fits each lead of each beat best."""
    t = np.linspace(-1.0, 1.0, beats.shape[-1])
    slope = beats @ t / (t @ t)
    return np.asarray(beats - beats.mean(axis=-1, keepdims=True) - slope[..., None] * t)


def cluster_morphology(signal: Floats, peaks: Integers, noise: float) -> tuple[Integers, Integers]:
    """Sort beats of a signal (n_leads, n) into classes of one shape; align each with its class.

    The first class is of the beat that most others resemble: it has every beat that differs from
    the median of the class by less than a fifth of its energy, beyond that of `noise`. The others
    are sorted in the same way, until no two are alike. Returns the number of each beat's class
    (n_beats,), from 0, and its R peak, moved to where it correlates best with the class.
    """
    wide = cut(signal, peaks, HALF_WIDTH + LARGEST_SHIFT, HALF_WIDTH + LARGEST_SHIFT)
    classes = np.full(len(peaks), -1, dtype=np.int64)
    shifts = np.zeros(len(peaks), dtype=np.int64)
    while (remaining := np.flatnonzero(classes < 0)).size:
        members, shift = _largest_class(wide[remaining], noise)
        classes[remaining[members]] = classes.max() + 1
        shifts[remaining[members]] = shift[members]
        if len(members) == 1:  # no two are alike
            singles = np.setdiff1d(remaining, remaining[members])
            classes[singles] = classes.max() + 1 + np.arange(len(singles))
            break
    return classes, np.asarray(peaks + shifts)


def noise_energy(signal: Floats) -> float:
    """Energy (mV² samples) of the noise, 10th percentile over windows as long as those compared."""
    length = 2 * HALF_WIDTH + 1
    starts = np.arange(0, signal.shape[1] - length + 1, HALF_WIDTH // 2)
    if not len(starts):
        return 0.0
    starts = starts[:: max(len(starts) // 2000, 1)]  # enough of a long recording for a quantile
    stretches = detrended(np.stack([signal[:, s : s + length] for s in starts]))
    return float(np.quantile((stretches**2).sum(axis=(1, 2)), 0.1))


def _largest_class(wide: Floats, noise: float) -> tuple[Integers, Integers]:
    """Members of the largest class among the beats, and the shift of every beat."""
    template, members = _central(wide, noise), np.zeros(1, dtype=np.int64)
    for _ in range(3):
        shift = _best_shifts(wide, template)
        moved = _shifted(wide, shift)
        difference = _difference(moved, template, noise * (1 + 1 / len(members)), noise)
        members = np.flatnonzero(difference < ALIKE)
        if not members.size:  # the template is a beat, so this is a beat of noise alone
            members = np.array([int(np.argmin(difference))])
        template = np.median(moved[members], axis=0)
    return members, shift


def _central(wide: Floats, noise: float) -> Floats:
    """Find the beat, of 40 at most, that resembles most others."""
    wide = wide[np.unique(np.linspace(0, len(wide) - 1, 40).round().astype(int))]
    candidates, alike = _shifted(wide, np.zeros(len(wide), dtype=np.int64)), []
    for candidate in candidates:
        moved = _shifted(wide, _best_shifts(wide, candidate))
        difference = _difference(moved, candidate, 2 * noise, noise)
        # as many as possible, and of equally many the most alike
        alike.append((difference < ALIKE).sum() - np.clip(difference, 0, ALIKE).mean())
    return np.asarray(candidates[np.argmax(alike)])


def _difference(beats: Floats, template: Floats, expected: float, noise: float) -> Floats:
    """Energy of beats less a template over that of the larger, both without noise."""
    energy = np.maximum((beats**2).sum(axis=(1, 2)), (template**2).sum()) - noise
    excess = ((beats - template) ** 2).sum(axis=(1, 2)) - expected
    least = 1e-3 * (template**2).sum() + np.finfo(float).tiny
    return np.asarray(excess / np.maximum(energy, least))


def _best_shifts(wide: Floats, template: Floats) -> Integers:
    """Samples, up to `LARGEST_SHIFT`, by which each beat correlates best with the template."""
    shifts = []
    for start in range(0, len(wide), 64):  # beats at a time, which bounds the memory
        some = wide[start : start + 64]
        tries = np.lib.stride_tricks.sliding_window_view(some, 2 * HALF_WIDTH + 1, axis=-1)
        # The template has neither level nor slope, so those of the beats do not matter
        shifts.append(np.argmax(np.einsum("bcst,ct->bs", tries, template), axis=1) - LARGEST_SHIFT)
    return np.concatenate(shifts)


def _shifted(wide: Floats, shifts: Integers) -> Floats:
    """Detrended beats (n_beats, n_leads, 2·HALF_WIDTH + 1) at the given shifts of `wide` ones."""
    first = LARGEST_SHIFT + shifts
    beats = [w[:, f : f + 2 * HALF_WIDTH + 1] for w, f in zip(wide, first, strict=True)]
    return detrended(np.stack(beats))
