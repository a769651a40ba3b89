"""Every beat of a recording: where it is, and of which shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from string import ascii_uppercase

import numpy as np
from numpy.typing import NDArray

from fascicle.core.leads import measured_rows
from fascicle.recording.alignment import HALF_WIDTH, cut, levelled
from fascicle.recording.choices import Choices
from fascicle.recording.classes import noise_energy, sort_by_shape
from fascicle.recording.detection import magnitude, r_peaks
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import TARGET_RATE, lowpass, notch, resample
from fascicle.recording.spikes import find_spikes, remove_spikes
from fascicle.recording.target import SAMPLING_STEP
from fascicle.recording.window import qrs_window

SHORTEST_RHYTHM = 1.5  # s; less is one beat, as recorders print it
CUT = 40.0  # ms; of a QRS that is nearer to an end of the recording, half is missing
EARLY = 0.85  # of the usual interval; a beat that comes sooner is premature
SMALLEST_R = 0.1  # of a lead's largest deflection
TYPICAL = 2 * HALF_WIDTH  # samples each side of R of the beat in which a class's QRS is found
WIDE, WIDER = 120.0, 20.0  # ms; a QRS that long, and that much longer than the commonest
SPIKE_REACH = 200.0  # ms before R in which a spike is taken to have fired the beat


@dataclass(frozen=True)
class SortedBeats:
    """The beats of a recording.

    Attributes
    ----------
    signal : (12, n) array
        Potential (mV) every `SAMPLING_STEP`, without pacing spikes, filtered if so chosen.
    peaks : (n_beats,) array
        R peak of each beat, a sample; beats of one class are aligned on all leads.
    labels : tuple of str
        Class of each beat: A is the one with the most beats, of equals the narrower.
    spikes : (k, 2) array
        First sample of each pacing spike and the one after its last.
    """

    signal: NDArray[np.float64]
    peaks: NDArray[np.int64]
    labels: tuple[str, ...]
    spikes: NDArray[np.int64]

    @property
    def intervals(self) -> NDArray[np.float64]:
        """Time since the beat before (ms), NaN for the first, shape (n_beats,)."""
        return np.concatenate([[np.nan], SAMPLING_STEP * np.diff(self.peaks)])

    @property
    def height(self) -> float:
        """Largest deflection, peak to peak, of the typical beat of class A in any lead (mV)."""
        beats = cut(self.signal, self.peaks[self.of_class("A")], HALF_WIDTH, HALF_WIDTH)
        return float(np.nanmax(np.ptp(np.median(beats, axis=0), axis=1)))

    @property
    def signal_to_noise(self) -> float:
        """Energy of the typical beat of class A over that of the noise between beats."""
        measured = self.signal[_rows(self.signal)]
        beats = cut(measured, self.peaks[self.of_class("A")], HALF_WIDTH, HALF_WIDTH)
        typical = np.median(levelled(beats), axis=0)
        noise = max(noise_energy(measured), np.finfo(float).tiny)
        return float((typical**2).sum() / noise)

    def of_class(self, label: str) -> NDArray[np.int64]:
        """Which beats have a label, increasing."""
        return np.flatnonzero([one == label for one in self.labels])

    def describe(self, label: str) -> str:
        """What is notable about a class: paced, early, wide; empty if nothing is."""
        members, words = self.of_class(label), []
        if np.mean([self.spike_before(k) is not None for k in members]) > 0.5:
            words.append("paced")
        if label != "A":
            usual = np.nanmedian(self.intervals)
            known = self.intervals[members]
            if np.isfinite(known).any() and np.nanmedian(known) < EARLY * usual:
                words.append("early")
            if self._width(label) > max(WIDE, self._width("A") + WIDER):
                words.append("wide")
        return ", ".join(words)

    def spike_before(self, beat: int) -> int | None:
        """Sample after the end of the last pacing spike that may have fired a beat."""
        peak = self.peaks[beat]
        reach = SPIKE_REACH / SAMPLING_STEP
        near = self.spikes[(self.spikes[:, 1] <= peak) & (self.spikes[:, 0] > peak - reach)]
        return int(near[-1, 1]) if len(near) else None

    def _width(self, label: str) -> float:
        """Rough QRS duration of a class (ms)."""
        return _rough_width(self.signal, self.peaks[self.of_class(label)])


def sort_beats(signal: NDArray[np.float64], spikes: NDArray[np.int64]) -> SortedBeats:
    """Find the beats of simultaneous leads and sort them by shape.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV) every `SAMPLING_STEP` without pacing spikes; NaN for absent leads.
    spikes : (k, 2) array
        First sample of each pacing spike and the one after its last.

    Returns
    -------
    SortedBeats
        Perhaps without a beat.
    """
    peaks = _find_peaks(signal)
    if not len(peaks):
        return SortedBeats(signal, peaks, (), spikes)
    classes, peaks = sort_by_shape(signal[_rows(signal)], peaks)
    for number in range(classes.max() + 1):
        peaks[classes == number] += _to_r_peak(signal, peaks[classes == number])
    peaks = np.clip(peaks, 0, signal.shape[1] - 1)
    order = np.argsort(peaks, kind="stable")
    peaks, classes = peaks[order], classes[order]
    return SortedBeats(signal, peaks, _labels(signal, peaks, classes), spikes)


def _rows(signal: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of the leads that are there and no combination of one another."""
    return measured_rows(np.asarray(np.isfinite(signal).all(axis=1), dtype=np.bool_))


def without_spikes(recording: Recording) -> tuple[Recording, NDArray[np.int64]]:
    """Recording without its pacing spikes; their first and last samples + 1, (k, 2)."""
    found = find_spikes(recording.signal, recording.sampling_rate)
    if not len(found):
        return recording, found
    return replace(recording, signal=remove_spikes(recording.signal, found)), found


def prepared(recording: Recording, choices: Choices) -> NDArray[np.float64]:
    """Signal (12, n) of a recording every `SAMPLING_STEP`, filtered if so chosen."""
    signal = resample(recording.signal, recording.sampling_rate)
    there = recording.recorded
    if choices.lowpass is not None:
        signal[there] = lowpass(signal[there], choices.lowpass)
    if choices.notch is not None:
        signal[there] = notch(signal[there], choices.notch)
    return signal


def _find_peaks(signal: NDArray[np.float64]) -> NDArray[np.int64]:
    """R peaks of a signal (12, n) every `SAMPLING_STEP`; one where there is room for one only."""
    if signal.shape[1] < SHORTEST_RHYTHM * TARGET_RATE:
        return np.array([int(np.argmax(magnitude(levelled(signal))))])
    peaks, margin = r_peaks(signal, TARGET_RATE), CUT / SAMPLING_STEP
    return np.asarray(peaks[(peaks >= margin) & (peaks < signal.shape[1] - margin)])


def _to_r_peak(signal: NDArray[np.float64], peaks: NDArray[np.int64]) -> int:
    """Samples from the common mark of aligned beats to the R peak of their median.

    It is the median over the leads of each one's R wave, its largest upward deflection, or of its
    largest deflection where it has no R wave.
    """
    typical, onset, offset = _typical_window(signal, peaks)
    qrs = typical[np.isfinite(typical).all(axis=1), onset : offset + 1]
    qrs = qrs - np.linspace(qrs[:, 0], qrs[:, -1], qrs.shape[1], axis=1)
    has_r = qrs.max(axis=1) >= SMALLEST_R * np.abs(qrs).max(axis=1)
    tops = np.where(has_r, qrs.argmax(axis=1), qrs.argmin(axis=1))
    return int(np.median(tops)) + onset - TYPICAL


def _labels(
    signal: NDArray[np.float64], peaks: NDArray[np.int64], classes: NDArray[np.int64]
) -> tuple[str, ...]:
    """Name the classes: A has the most beats, and of equally many the narrower QRS."""
    numbers = range(classes.max() + 1)
    rank = {k: (-(classes == k).sum(), _rough_width(signal, peaks[classes == k])) for k in numbers}
    names = {k: _name(place) for place, k in enumerate(sorted(numbers, key=rank.__getitem__))}
    return tuple(names[k] for k in classes)


def _name(place: int) -> str:
    """A to Z, then A2 to Z2 and so on."""
    again, letter = divmod(place, len(ascii_uppercase))
    return ascii_uppercase[letter] + (str(again + 1) if again else "")


def _rough_width(signal: NDArray[np.float64], peaks: NDArray[np.int64]) -> float:
    """QRS duration (ms) of the median of aligned beats."""
    _, onset, offset = _typical_window(signal, peaks)
    return (offset - onset) * SAMPLING_STEP


def _typical_window(
    signal: NDArray[np.float64], peaks: NDArray[np.int64]
) -> tuple[NDArray[np.float64], int, int]:
    """Median of aligned beats, `TYPICAL` samples each side of R, and the ends of its QRS."""
    typical = np.median(cut(signal, peaks, TYPICAL, TYPICAL), axis=0)
    return typical, *qrs_window(typical, SAMPLING_STEP)
