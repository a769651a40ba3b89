"""From a recording to a target: find the beats, align them, level them, find the QRS."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.recording import alignment
from fascicle.recording.baseline import quiet_start, subtract_drift
from fascicle.recording.detection import magnitude, r_peaks, remove_baseline
from fascicle.recording.einthoven import einthoven_warning
from fascicle.recording.recording import Recording
from fascicle.recording.target import SAMPLING_STEP, Target
from fascicle.recording.window import qrs_window

BEFORE, AFTER = 250.0, 450.0  # ms around R
BEFORE_SHARE, AFTER_SHARE = 0.4, 0.6  # of the RR interval, at fast rates
FIDUCIAL_REACH = 60  # samples about the first guess in which the R peak of the typical beat lies
LARGEST_QRS, SMALLEST_QRS = 20.0, 0.05  # mV peak to peak; outside, the unit is wrong
SHORTEST_WINDOW = 20.0  # ms
MINUTE = 60000.0  # ms
NOISY = 0.2  # beat-to-beat spread over QRS height
FEW_ALIKE = 0.7  # share of the beats that should be alike


def make_target(
    recording: Recording, onset: float | None = None, offset: float | None = None
) -> Target:
    """Aligned, levelled beats of a recording and their QRS window.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    onset, offset : float, optional
        QRS window (ms from the R peak, onset negative); they replace what is found.

    Returns
    -------
    Target
        At least two beats. ``provenance["warnings"]`` is there when something is suspicious.

    Raises
    ------
    InputError
        When fewer than two regular beats are found or the window is impossible.
    """
    _check_given(onset, offset, recording.source)
    signal = alignment.resample(recording.signal, recording.sampling_rate)
    found = r_peaks(signal, alignment.TARGET_RATE)
    _need_two(len(found), recording, "beats found")
    interval = float(np.median(np.diff(found))) * SAMPLING_STEP
    before, after = _extent(interval)
    peaks = _aligned_peaks(signal, found, before, after, recording)
    raw = alignment.cut(signal, peaks, before, after)
    kept = alignment.regular(raw)
    _need_two(int(kept.sum()), recording, "beats alike")
    beats = _levelled(signal, peaks[kept], raw[kept], before, onset)
    _check_height(beats.mean(axis=0), recording.source)
    time = SAMPLING_STEP * np.arange(-before, after + 1, dtype=np.float64)
    window = _window(beats.mean(axis=0), time, onset, offset, recording.source)
    provenance = _provenance(recording, len(found), len(beats), onset, offset)
    target = Target(beats, time, *window, MINUTE / interval, provenance)
    warnings = _warnings(recording, target, len(peaks))
    return replace(target, provenance=provenance | warnings)


def _provenance(
    recording: Recording, n_found: int, n_used: int, onset: float | None, offset: float | None
) -> dict[str, str]:
    return recording.provenance | {
        "source": recording.source,
        "sampling_rate_hz": f"{recording.sampling_rate:g}",
        "recording_duration_s": f"{recording.duration:.3f}",
        "beats_found": str(n_found),
        "beats_used": str(n_used),
        "qrs_onset_from": "detected" if onset is None else "given",
        "qrs_offset_from": "detected" if offset is None else "given",
    }


def _check_given(onset: float | None, offset: float | None, source: str) -> None:
    for name, value in (("onset", onset), ("offset", offset)):
        if value is not None and not math.isfinite(value):
            raise InputError(
                f"{source}: QRS window {name} is {value} ms; give a number of ms from the R peak"
            )


def _extent(interval: float) -> tuple[int, int]:
    """Return the samples before and after R for a median RR interval (ms)."""
    before = min(BEFORE, BEFORE_SHARE * interval)
    after = min(AFTER, AFTER_SHARE * interval)
    return round(before / SAMPLING_STEP), round(after / SAMPLING_STEP)


def _need_two(count: int, recording: Recording, what: str) -> None:
    if count < 2:
        raise InputError(
            f"{recording.source}: {count} {what} in {recording.duration:.1f} s; at least 2 are "
            "needed, give a longer or cleaner recording (10 s is usual)"
        )


def _aligned_peaks(
    signal: NDArray[np.float64],
    found: NDArray[np.int64],
    before: int,
    after: int,
    recording: Recording,
) -> NDArray[np.int64]:
    """Peaks with a full window each, moved to the R peak of the typical beat."""
    margin = alignment.HALF_WIDTH + alignment.LARGEST_SHIFT
    n_samples = signal.shape[1]
    peaks = alignment.complete(found, n_samples, max(before, margin), max(after, margin))
    _need_two(len(peaks), recording, "complete beats")
    peaks = alignment.align(signal, peaks)
    level = remove_baseline(signal, alignment.TARGET_RATE)
    typical = alignment.typical_beat(alignment.cut(level, peaks, FIDUCIAL_REACH, FIDUCIAL_REACH))
    peaks = peaks + int(np.argmax(magnitude(typical))) - FIDUCIAL_REACH
    peaks = alignment.complete(peaks, n_samples, before, after)
    _need_two(len(peaks), recording, "complete beats")
    return peaks


def _levelled(
    signal: NDArray[np.float64],
    peaks: NDArray[np.int64],
    raw: NDArray[np.float64],
    before: int,
    onset: float | None,
) -> NDArray[np.float64]:
    """Beats less the line through their isoelectric points."""
    mean = np.median(raw, axis=0)
    first = qrs_window(mean, SAMPLING_STEP)[0]
    if onset is not None:
        first = min(max(before + round(onset / SAMPLING_STEP), 0), raw.shape[-1] - 1)
    knots = peaks - before + quiet_start(mean, first, SAMPLING_STEP)
    return subtract_drift(signal, knots, peaks, before, raw.shape[-1])


def _window(
    mean: NDArray[np.float64],
    time: NDArray[np.float64],
    onset: float | None,
    offset: float | None,
    source: str,
) -> tuple[float, float]:
    """QRS window (ms from R): what is given, otherwise what is found."""
    first, last = qrs_window(mean, SAMPLING_STEP)
    start = float(time[first]) if onset is None else float(onset)
    end = float(time[last]) if offset is None else float(offset)
    if end - start < SHORTEST_WINDOW:
        raise InputError(
            f"{source}: QRS window {start:g} to {end:g} ms; the offset must be at least "
            f"{SHORTEST_WINDOW:g} ms after the onset (both in ms from the R peak)"
        )
    if start < time[0] or end > time[-1]:
        raise InputError(
            f"{source}: QRS window {start:g} to {end:g} ms leaves the beat, which spans "
            f"{time[0]:g} to {time[-1]:g} ms from the R peak; give an onset and offset inside"
        )
    return start, end


def _check_height(mean: NDArray[np.float64], source: str) -> None:
    height = float(np.ptp(mean, axis=1).max())
    if not SMALLEST_QRS <= height <= LARGEST_QRS:
        raise InputError(
            f"{source}: the largest lead spans {height:.3g} mV in one beat, expected "
            f"{SMALLEST_QRS:g} to {LARGEST_QRS:g} mV; correct the unit or the gain of the file"
        )


def _warnings(recording: Recording, target: Target, n_complete: int) -> dict[str, str]:
    """Collect what the user should know, under the key ``warnings``; {} if nothing."""
    warnings = []
    einthoven = einthoven_warning(recording.signal)
    if einthoven is not None:
        warnings.append(einthoven)
    n_used = len(target.beats)
    if n_used < FEW_ALIKE * n_complete:
        warnings.append(
            f"only {n_used} of {n_complete} beats are alike and were used; look at the rhythm"
        )
    spread = float(magnitude(target.standard_deviation[:, target.qrs_samples]).mean())
    height = float(magnitude(target.qrs).max())
    if spread > NOISY * height:
        warnings.append(
            f"the QRS varies by {spread:.3f} mV from beat to beat, {spread / height:.0%} of its "
            "height; the recording is noisy"
        )
    return {"warnings": "; ".join(warnings)} if warnings else {}
