"""Leads recorded at the same time, and their beats: where each is, and of which shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from string import ascii_uppercase

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS, independent_rows
from fascicle.recording.classes import HALF_WIDTH, cluster_morphology, cut, detrended, noise_energy
from fascicle.recording.detection import magnitude, r_peaks
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import SAMPLING_STEP, TARGET_RATE, filtered, resample
from fascicle.recording.spikes import find_spikes, remove_spikes
from fascicle.recording.target_options import TargetOptions
from fascicle.recording.window import qrs_window

SAME_TIME = 0.9  # share of a stretch that another covers, if it is of the same group or longer
ONE_BEAT = 120.0  # ms; R peaks so near to each other are of one beat
SHORTEST_RHYTHM = 1.5  # s; less is one beat, as recorders print it
CUT = 40.0  # ms; of a QRS that is nearer to an end of the recording, half is missing
EARLY = 0.85  # of the usual interval; a beat that comes sooner is premature
SMALLEST_R = 0.1  # of a lead's largest deflection
MEDIAN_REACH = 2 * HALF_WIDTH  # samples each side of R of the median beat that shows a class's QRS
WIDE, WIDER = 120.0, 20.0  # ms; a QRS that long, and that much longer than the commonest
SPIKE_REACH = 200.0  # ms before R in which a spike is taken to have fired the beat


@dataclass(frozen=True)
class LeadGroup:
    """The leads that were recorded over one stretch of time, and the beats in it.

    Most recordings are one group; on paper, leads are recorded one group after another.

    Attributes
    ----------
    start : int
        First sample of the stretch in the whole recording.
    recording : Recording
        That stretch without pacing spikes; leads recorded at other times are NaN.
    recorded : (12, n) array
        Its potential (mV) every `SAMPLING_STEP`, as recorded.
    signal : (12, n) array
        The same without pacing spikes, filtered if so chosen.
    spikes : (k, 2) array
        First sample of each pacing spike and the one after its last.
    noise : float
        Energy of the noise between beats, see `fascicle.recording.classes.noise_energy`.
    peaks : (n_beats,) array
        R peak of each beat, a sample; beats of one class are aligned on all leads. May be empty.
    labels : tuple of str
        Class of each beat: A is the one with the most beats, of equals the narrower.
    """

    start: int
    recording: Recording
    recorded: Floats
    signal: Floats
    spikes: Integers
    noise: float
    peaks: Integers
    labels: tuple[str, ...]

    @property
    def leads(self) -> str:
        """Names of its leads, for messages."""
        names = [lead for lead, there in zip(LEADS, self.recording.recorded, strict=True) if there]
        return "all leads" if len(names) == len(LEADS) else ", ".join(names)

    @property
    def times(self) -> Floats:
        """Times of the R peaks (s from the start of the recording), shape (n_beats,)."""
        return self._time_of(self.peaks)

    @property
    def spike_times(self) -> Floats:
        """Times of the pacing spikes (s from the start of the recording), shape (k,)."""
        return self._time_of(self.spikes[:, 0])

    @property
    def intervals(self) -> Floats:
        """Time since the beat before (ms), NaN for the first, shape (n_beats,)."""
        return np.concatenate([[np.nan], SAMPLING_STEP * np.diff(self.peaks)])

    @property
    def height(self) -> float:
        """Largest deflection, peak to peak, of the median beat of class A in any lead (mV)."""
        beats = cut(self.signal, self.peaks[self.of_class("A")], HALF_WIDTH, HALF_WIDTH)
        return float(np.nanmax(np.ptp(np.median(beats, axis=0), axis=1)))

    @property
    def signal_to_noise(self) -> float:
        """Energy of the median beat of class A over that of the noise between beats."""
        independent = self.signal[_independent(self.signal)]
        beats = cut(independent, self.peaks[self.of_class("A")], HALF_WIDTH, HALF_WIDTH)
        median = np.median(detrended(beats), axis=0)
        return float((median**2).sum() / max(self.noise, np.finfo(float).tiny))

    def of_class(self, label: str) -> Integers:
        """Which beats have a label, increasing."""
        return np.flatnonzero([one == label for one in self.labels])

    def describe(self, label: str) -> str:
        """What is notable about a class: paced, early, wide; empty if nothing is."""
        members, words = self.of_class(label), []
        if np.mean([self.spike_before(k) is not None for k in members]) > 0.5:
            words.append("paced")
        if label != "A":
            usual = np.nanmedian(self.intervals)
            own = self.intervals[members]
            if np.isfinite(own).any() and np.nanmedian(own) < EARLY * usual:
                words.append("early")
            own_width, usual_width = (
                _rough_width(self.signal, self.peaks[self.of_class(one)]) for one in (label, "A")
            )
            if own_width > max(WIDE, usual_width + WIDER):
                words.append("wide")
        return ", ".join(words)

    def spike_before(self, beat: int) -> int | None:
        """Sample after the end of the last pacing spike that may have fired a beat."""
        peak = self.peaks[beat]
        reach = SPIKE_REACH / SAMPLING_STEP
        near = self.spikes[(self.spikes[:, 1] <= peak) & (self.spikes[:, 0] > peak - reach)]
        return int(near[-1, 1]) if len(near) else None

    def _time_of(self, samples: Integers) -> Floats:
        return np.asarray(self.start / self.recording.sampling_rate + samples / TARGET_RATE)


def lead_groups(recording: Recording, choices: TargetOptions) -> list[LeadGroup]:
    """Split a recording into leads recorded at the same time, and find and sort their beats.

    The groups are in the order of time, filtered as `choices` say; any may have no beat. A lead
    that runs through several stretches, such as a rhythm strip, is in each group.
    """
    return [_group(recording, first, stop, choices) for first, stop in _stretches(recording)]


def _stretches(recording: Recording) -> list[tuple[int, int]]:
    """First sample and the one after the last of each stretch with the same leads, in order."""
    spans = {(first, stop) for first, stop in recording.spans[recording.recorded].tolist()}
    found: list[tuple[int, int]] = []
    for span in sorted(sorted(spans), key=lambda one: one[1] - one[0]):  # containing ones last
        same = [k for k, one in enumerate(found) if _shared(one, span) >= SAME_TIME]
        if not same:
            found.append(span)
        elif span[1] - span[0] < (found[same[0]][1] - found[same[0]][0]) / SAME_TIME:
            one = found[same[0]]  # leads of one group, whose ends were digitised unevenly
            found[same[0]] = (max(one[0], span[0]), min(one[1], span[1]))
    return sorted(found)


def _shared(one: tuple[int, int], other: tuple[int, int]) -> float:
    """Share of the first stretch that the second covers."""
    return (min(one[1], other[1]) - max(one[0], other[0])) / (one[1] - one[0])


def _group(recording: Recording, first: int, stop: int, choices: TargetOptions) -> LeadGroup:
    """Cut out the leads that are there over all of a stretch, and find their beats."""
    rate = recording.sampling_rate
    native = recording.signal[:, first:stop].copy()
    native[~np.isfinite(native).all(axis=1)] = np.nan
    signal = recorded = resample(native, rate)
    spikes = find_spikes(native, rate)
    if len(spikes):
        native = remove_spikes(native, spikes)
        signal = resample(native, rate)
    signal = filtered(signal, choices.lowpass, choices.notch)
    independent = signal[_independent(signal)]
    noise = noise_energy(independent)
    labels: tuple[str, ...] = ()
    peaks = _find_peaks(signal)
    if len(peaks):
        classes, peaks = cluster_morphology(independent, peaks, noise)
        peaks, labels = _name_classes(signal, classes, peaks)
    return LeadGroup(
        start=first,
        recording=replace(recording, signal=native),
        recorded=recorded,
        signal=signal,
        spikes=np.round(spikes * (TARGET_RATE / rate)).astype(np.int64),
        noise=noise,
        peaks=peaks,
        labels=labels,
    )


def _independent(signal: Floats) -> Integers:
    """Rows of the leads that are there and no combination of one another."""
    return independent_rows(np.asarray(np.isfinite(signal).all(axis=1), dtype=np.bool_))


def _find_peaks(signal: Floats) -> Integers:
    """R peaks of a signal (12, n) every `SAMPLING_STEP`; one where there is room for one only."""
    if signal.shape[1] < SHORTEST_RHYTHM * TARGET_RATE:
        return np.array([int(np.argmax(magnitude(detrended(signal))))])
    peaks, margin = r_peaks(signal, TARGET_RATE), CUT / SAMPLING_STEP
    return np.asarray(peaks[(peaks >= margin) & (peaks < signal.shape[1] - margin)])


def _name_classes(
    signal: Floats, classes: Integers, peaks: Integers
) -> tuple[Integers, tuple[str, ...]]:
    """R peaks in the order of time, and the label of each beat's class.

    A is the class with the most beats, and of equally many the one with the narrower QRS. A wave
    that was found beside its QRS moves to the R peak of that, and is no beat of its own.
    """
    moved = peaks.copy()
    for number in np.unique(classes):
        moved[classes == number] += _to_r_peak(signal, peaks[classes == number])
    moved = np.clip(moved, 0, signal.shape[1] - 1)
    kept = _beats_of_their_own(moved, np.abs(moved - peaks))
    peaks, classes = moved[kept], classes[kept]
    numbers = np.unique(classes).tolist()
    rank = {k: (-(classes == k).sum(), _rough_width(signal, peaks[classes == k])) for k in numbers}
    names = {k: _name(place) for place, k in enumerate(sorted(numbers, key=rank.__getitem__))}
    return peaks, tuple(names[k] for k in classes)


def _beats_of_their_own(peaks: Integers, moved: Integers) -> Integers:
    """Which peaks are kept, in the order of time: of those of one beat, that which moved least."""
    kept: list[int] = []
    for k in np.argsort(peaks, kind="stable"):
        if kept and (peaks[k] - peaks[kept[-1]]) * SAMPLING_STEP < ONE_BEAT:
            kept[-1] = k if moved[k] < moved[kept[-1]] else kept[-1]
        else:
            kept.append(k)
    return np.array(kept, dtype=np.int64)


def _name(place: int) -> str:
    """A to Z, then A2 to Z2 and so on."""
    again, letter = divmod(place, len(ascii_uppercase))
    return ascii_uppercase[letter] + (str(again + 1) if again else "")


def _to_r_peak(signal: Floats, peaks: Integers) -> int:
    """Samples from the common mark of aligned beats to the R peak of their median.

    It is the median over the leads of each one's R wave, its largest upward deflection, or of its
    largest deflection where it has no R wave.
    """
    median, onset, offset = _median_beat(signal, peaks)
    qrs = median[np.isfinite(median).all(axis=1), onset : offset + 1]
    qrs = qrs - np.linspace(qrs[:, 0], qrs[:, -1], qrs.shape[1], axis=1)
    has_r = qrs.max(axis=1) >= SMALLEST_R * np.abs(qrs).max(axis=1)
    tops = np.where(has_r, qrs.argmax(axis=1), qrs.argmin(axis=1))
    return int(np.median(tops)) + onset - MEDIAN_REACH


def _rough_width(signal: Floats, peaks: Integers) -> float:
    """QRS duration (ms) of the median of aligned beats."""
    _, onset, offset = _median_beat(signal, peaks)
    return (offset - onset) * SAMPLING_STEP


def _median_beat(signal: Floats, peaks: Integers) -> tuple[Floats, int, int]:
    """Median of aligned beats, `MEDIAN_REACH` samples each side of R, and the ends of its QRS."""
    median = np.median(cut(signal, peaks, MEDIAN_REACH, MEDIAN_REACH), axis=0)
    return median, *qrs_window(median, SAMPLING_STEP)
