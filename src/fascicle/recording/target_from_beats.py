"""The target of aligned beats: their QRS window, what is suspicious, where they came from."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.aligned_beats import AlignedBeats
from fascicle.recording.analysis import Beat
from fascicle.recording.beat_selection import FEW_ALIKE
from fascicle.recording.detection import magnitude
from fascicle.recording.filters import Filter
from fascicle.recording.missing_metadata import missing_noise
from fascicle.recording.quality.check_result import CheckResult, Severity
from fascicle.recording.recording import CHECKSUMS_AGREE, Recording
from fascicle.recording.resampling import SAMPLING_STEP
from fascicle.recording.target import Target
from fascicle.recording.target_options import TargetOptions, check_window
from fascicle.recording.window import qrs_window, smoothing_against_ringing, window_uncertainty

LOWEST_RATE, HIGHEST_RATE = 20.0, 300.0  # beats per minute of a living heart
LARGEST_END_SD = 40.0  # ms
ALTERNATING = 0.8  # of all pairs of neighbours, if beats of two classes take turns
FEWEST_ALTERNATING = 4  # beats
NOISY = 0.2  # beat-to-beat spread over QRS height


def target_from_beats(
    recording: Recording,
    aligned: AlignedBeats,
    beats: Sequence[Beat],
    choices: TargetOptions,
    label: str,
    findings: Sequence[CheckResult],
    filters: tuple[Filter, ...],
) -> Target:
    """Make a target.

    Parameters
    ----------
    recording : Recording
        Where they are from.
    aligned : AlignedBeats
        The beats that are used.
    beats : sequence of Beat
        All beats of the recording.
    choices : TargetOptions
        Decisions of the user.
    label : str
        Class of the beats.
    findings : sequence of CheckResult
        What the checks of the recording said.
    filters : tuple of Filter
        What the beats have passed.

    Raises
    ------
    InputError
        When a single beat has no stated noise, or the window is impossible or cannot be found.
    """
    _check_noise(len(aligned.beats), label, choices, recording.source)
    smoothing = smoothing_against_ringing(filters)
    onset, offset = _window(aligned, smoothing, choices, recording.source)
    ends = window_uncertainty(
        aligned.beats, SAMPLING_STEP, aligned.not_before, choices.noise, smoothing
    )
    onset_sd, offset_sd = (math.hypot(sd, aligned.alignment_sd) for sd in ends)
    _check_ends(onset_sd, offset_sd, choices, recording.source)
    target = Target(
        beats=aligned.beats,
        time=aligned.time,
        qrs_onset=onset,
        qrs_offset=offset,
        heart_rate=_heart_rate(beats),
        provenance=_provenance(recording, beats, len(aligned.beats), choices)
        | {"filters": "\n".join(map(str, filters)) or "none known"},
        onset_sd=onset_sd if choices.onset is None else 0.0,
        offset_sd=offset_sd if choices.offset is None else 0.0,
        noise=choices.noise,
        filters=filters,
        earliest_onset=float(aligned.time[aligned.not_before]) if aligned.not_before else None,
    )
    warnings = _warnings(recording, target, beats, label, choices, findings)
    if not warnings:
        return target
    return replace(target, provenance=target.provenance | {"warnings": "\n".join(warnings)})


def _heart_rate(beats: Sequence[Beat]) -> float | None:
    """Beats per minute, of all classes; None where there is one beat only."""
    intervals = [beat.interval for beat in beats if math.isfinite(beat.interval)]
    return 60000.0 / float(np.mean(intervals)) if intervals else None


def _check_noise(count: int, label: str, choices: TargetOptions, source: str) -> None:
    """Ask for the noise of a single beat, and only of one."""
    if count == 1 and choices.noise is None:
        raise missing_noise(
            f"{source}: a single beat (class {label}) does not show how beats vary; state its "
            "noise by --noise (mV), or give a recording with more beats of one shape"
        )
    if count > 1 and choices.noise is not None:
        raise InputError(
            f"{source}: {count} beats show how they vary; --noise is for a single beat"
        )


def _check_ends(onset_sd: float, offset_sd: float, choices: TargetOptions, source: str) -> None:
    """Refuse ends that may be anywhere, unless the user has given them."""
    for name, sd, given in (
        ("onset", onset_sd, choices.onset), ("offset", offset_sd, choices.offset)
    ):  # fmt: skip
        if sd > LARGEST_END_SD and given is None:
            raise InputError(
                f"{source}: QRS {name} found to within {sd:.0f} ms only (at most "
                f"{LARGEST_END_SD:.0f}); give it by --{name}, or a cleaner recording"
            )


def _window(
    aligned: AlignedBeats, smoothing: float, choices: TargetOptions, source: str
) -> tuple[float, float]:
    """QRS window (ms from R): what is given, otherwise what is found."""
    first, last = qrs_window(aligned.mean, SAMPLING_STEP, aligned.not_before, smoothing)
    time = aligned.time
    start = float(time[first]) if choices.onset is None else float(choices.onset)
    end = float(time[last]) if choices.offset is None else float(choices.offset)
    check_window(start, end, source)
    if not start < 0 < end and None in (choices.onset, choices.offset):
        raise InputError(
            f"{source}: QRS window {start:g} to {end:g} ms does not hold the R peak (0 ms); give "
            "--onset and --offset about it, or a cleaner recording"
        )
    if start < time[0] or end > time[-1]:
        raise InputError(
            f"{source}: QRS window {start:g} to {end:g} ms leaves the beat, which spans "
            f"{time[0]:g} to {time[-1]:g} ms from the R peak; give an onset and offset inside"
        )
    return start, end


def _provenance(
    recording: Recording, beats: Sequence[Beat], n_used: int, choices: TargetOptions
) -> dict[str, str]:
    """Text about everything that decided the target."""
    notes = {
        "source": recording.source,
        "sampling_rate_hz": f"{recording.sampling_rate:g}",
        "recording_duration_s": f"{recording.duration:.3f}",
        "beats_found": str(len(beats)),
        "beats_used": str(n_used),
        "beat_numbers": ", ".join(str(beat.number) for beat in beats if beat.used),
        "beat_class": ", ".join(sorted({beat.label for beat in beats if beat.used})),
        "qrs_onset_from": "detected" if choices.onset is None else "given",
        "qrs_offset_from": "detected" if choices.offset is None else "given",
    }
    if recording.derived:
        notes["derived_leads"] = ", ".join(recording.derived)
    if recording.ignored:
        notes["ignored_channels"] = ", ".join(recording.ignored)
    return recording.provenance | notes | choices.described()


def _warnings(
    recording: Recording,
    target: Target,
    beats: Sequence[Beat],
    label: str,
    choices: TargetOptions,
    findings: Sequence[CheckResult],
) -> list[str]:
    """Collect what the user should know."""
    warnings = [one.message for one in findings if one.severity is Severity.WARNING and one.message]
    if not recording.simultaneous:
        warnings.append(
            "leads were recorded one group after another: beats of different groups are put "
            "together, and aligned to within some 10 ms unless they share a lead"
        )
    notes = recording.provenance
    if notes.get("checksums", CHECKSUMS_AGREE) != CHECKSUMS_AGREE:
        warnings.append(f"checksums of the file {notes['checksums']}: it may be damaged")
    if "remarks" in notes:
        warnings.append(notes["remarks"])
    rate = target.heart_rate
    if rate is not None and not LOWEST_RATE <= rate <= HIGHEST_RATE:
        warnings.append(f"{rate:.0f} beats per minute; is the sampling rate right?")
    if len(target.beats) == 2:
        warnings.append("two beats show little of how beats vary; give a longer recording")
    alike = sum(beat.label == label for beat in beats)
    if choices.beats is None and _alternate(beats):
        warnings.append(
            "beats of two classes alternate: every second one is ectopic, or twice as many were "
            "found as there are, with T waves among them; look at the picture (--class chooses)"
        )
    elif choices.beats is None and alike < FEW_ALIKE * len(beats):
        warnings.append(
            f"only {alike} of {len(beats)} beats are of class {label}; look at the rhythm"
        )
    spread = float(np.nanmean(magnitude(target.standard_deviation[:, target.qrs_samples])))
    height = float(magnitude(target.qrs).max())
    if spread > NOISY * height:
        warnings.append(
            f"the QRS varies by {spread:.3f} mV from beat to beat, {spread / height:.0%} of its "
            "height; the recording is noisy"
        )
    return warnings


def _alternate(beats: Sequence[Beat]) -> bool:
    """Whether nearly every second beat is of one class, and the others of another."""
    two = {label for label, _ in Counter(beat.label for beat in beats).most_common(2)}
    changes = [{one.label, following.label} == two for one, following in pairwise(beats)]
    enough = len(two) == 2 and len(beats) >= FEWEST_ALTERNATING
    return enough and sum(changes) >= ALTERNATING * len(changes)
