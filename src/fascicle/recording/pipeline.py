"""From a recording to its target, with everything that was found on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.analysis import Analysis, Beat, BeatClass
from fascicle.recording.beats import CutBeats, cut_beats, reasons_against
from fascicle.recording.choices import Choices
from fascicle.recording.lead_groups import Turn, combine, turns
from fascicle.recording.quality.check import check_leads, check_recording
from fascicle.recording.quality.finding import Finding, Severity
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import TARGET_RATE, resample
from fascicle.recording.sorted_beats import SortedBeats, prepared, sort_beats, without_spikes
from fascicle.recording.target import Target
from fascicle.recording.unsorted_target import FEW_ALIKE, whole_target
from fascicle.recording.window import NoQrsError

LARGEST_QRS, SMALLEST_QRS = 20.0, 0.05  # mV peak to peak; outside, the unit is wrong

LEAST_SIGNAL = 0.5  # energy of a typical beat over that of the noise between beats


def make_target(
    recording: Recording,
    onset: float | None = None,
    offset: float | None = None,
    *,
    beat_class: str | None = None,
    beats: tuple[int, ...] | None = None,
    exclude: tuple[int, ...] = (),
    noise: float | None = None,
) -> Target:
    """Aligned, levelled beats of a recording and their QRS window.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    onset, offset : float, optional
        QRS window (ms from the R peak, onset negative); they replace what is found.
    beat_class : str, optional
        Label of the class whose beats make the target; by default that with the most beats.
    beats, exclude : tuple of int
        Numbers of the beats to use, whatever their class, and to leave out.
    noise : float, optional
        Standard deviation (mV) of a single beat.

    Returns
    -------
    Target
        ``provenance["warnings"]`` is there when something is suspicious; `analyse` tells more.

    Raises
    ------
    InputError
        When the recording does not bear a target, or a choice is impossible.
    """
    choices = Choices(onset, offset, beat_class, beats, exclude, noise)
    return analyse(recording, choices).target


def analyse(recording: Recording, choices: Choices | None = None) -> Analysis:
    """Find, sort, choose and level the beats of a recording, and find their QRS window.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    choices : Choices, optional
        Decisions of the user; by default everything is decided here.

    Raises
    ------
    InputError
        When a check refuses the recording, it has too few beats, or a choice is impossible.
    """
    choices = choices if choices is not None else Choices()
    basic = check_leads(recording)
    _refuse(basic, recording)
    parts = turns(recording)
    try:
        clean, groups = _sorted(parts, choices)
        _check_found(recording.source, parts, groups)
        beats = _number(parts, groups, recording.sampling_rate)
        checked = clean[0] if len(clean) == 1 else recording
        findings = basic + check_recording(checked, _native(beats, recording.sampling_rate))
        _refuse(findings, recording)
        _check_numbers(recording.source, len(beats), choices)
        label = _label(beats, choices)
        _check_classes(recording.source, groups, choices, label)
        reasons = _reasons(groups, choices, label)
        judged = _judged(beats, [reason for why in reasons for reason in why])
        _check_named(recording.source, judged, choices)
        cuts = [
            _cut(recording, part, group, why, choices, label)
            for part, group, why in zip(parts, groups, reasons, strict=True)
        ]
        target = whole_target(recording, combine(cuts), judged, choices, label, findings)
    except NoQrsError as error:
        raise InputError(
            f"{recording.source}: {error}; leave bad leads out by --leads, or give a cleaner "
            "recording"
        ) from error
    return Analysis(
        recording=recording,
        signal=_strip(recording, parts),
        beats=judged,
        classes=_classes(groups),
        spikes=_spikes(parts, groups, recording.sampling_rate),
        findings=findings,
        target=target,
        chosen=label,
    )


def _sorted(parts: Sequence[Turn], choices: Choices) -> tuple[list[Recording], list[SortedBeats]]:
    """Each part without its pacing spikes, and its beats."""
    clean, groups = [], []
    for part in parts:
        recording, spikes = without_spikes(part.recording)
        per_sample = TARGET_RATE / recording.sampling_rate
        spikes = np.round(spikes * per_sample).astype(np.int64)
        clean.append(recording)
        groups.append(sort_beats(prepared(recording, choices), spikes))
    return clean, groups


def _reasons(groups: Sequence[SortedBeats], choices: Choices, label: str) -> list[list[str]]:
    """Why each beat of each group is not used; groups recorded in turns use equally many."""
    firsts = [1, *(1 + n for n in accumulate(len(group.peaks) for group in groups))]
    reasons = [
        reasons_against(group, choices, label, first)
        for group, first in zip(groups, firsts, strict=False)
    ]
    fewest = min(why.count("") for why in reasons)
    for why in reasons:
        used = [k for k, reason in enumerate(why) if not reason]
        for k in used[fewest:] if fewest else ():
            why[k] = "the other groups of leads have no more beats"
    return reasons


def _number(
    parts: Sequence[Turn], groups: Sequence[SortedBeats], sampling_rate: float
) -> list[Beat]:
    """List every beat with its number, time and class; none is used yet."""
    beats: list[Beat] = []
    for part, group in zip(parts, groups, strict=True):
        for peak, label, interval in zip(group.peaks, group.labels, group.intervals, strict=True):
            time = part.start / sampling_rate + float(peak) / TARGET_RATE
            beats.append(Beat(len(beats) + 1, time, label, float(interval), used=False))
    return beats


def _native(beats: Sequence[Beat], sampling_rate: float) -> NDArray[np.int64]:
    """R peaks as samples of the recording."""
    return np.array([round(beat.time * sampling_rate) for beat in beats], dtype=np.int64)


def _judged(beats: Sequence[Beat], reasons: Sequence[str]) -> tuple[Beat, ...]:
    """Beats with whether they are used, and why not."""
    return tuple(
        replace(beat, used=not reason, reason=reason)
        for beat, reason in zip(beats, reasons, strict=True)
    )


def _refuse(findings: Sequence[Finding], recording: Recording) -> None:
    """Raise the first finding that forbids a target."""
    for finding in findings:
        if finding.severity is Severity.FATAL:
            raise InputError(f"{recording.source}: {finding.message}{_reminder(recording)}")


def _reminder(recording: Recording) -> str:
    """What the user has changed in the recording, which may be the fault."""
    done = [
        f"{name} {recording.provenance[name]}"
        for name in ("inverted", "swapped")
        if name in recording.provenance
    ]
    return f" (after your options: {', '.join(done)}; they may be the fault)" if done else ""


def _check_found(source: str, parts: Sequence[Turn], groups: Sequence[SortedBeats]) -> None:
    """Refuse recordings without beats, or with beats of another size than a heart's."""
    for part, group in zip(parts, groups, strict=True):
        if not len(group.peaks):
            raise InputError(
                f"{source}: no beats found in {part.recording.duration:.1f} s of "
                f"{_names(part.recording)}; give a longer or cleaner recording (10 s is usual)"
            )
    height = max(group.height for group in groups)
    if not SMALLEST_QRS <= height <= LARGEST_QRS:
        raise InputError(
            f"{source}: the largest lead spans {height:.3g} mV in one beat, expected "
            f"{SMALLEST_QRS:g} to {LARGEST_QRS:g} mV; correct the unit or the gain of the file"
        )
    clearest = min(group.signal_to_noise for group in groups)
    if clearest < LEAST_SIGNAL:
        raise InputError(
            f"{source}: no heart beats stand out of the noise (ratio of energies {clearest:.2f}); "
            "give a cleaner recording"
        )


def _check_named(source: str, beats: Sequence[Beat], choices: Choices) -> None:
    """Refuse to leave out beats that the user has named."""
    for beat in beats:
        if beat.number in (choices.beats or ()) and "cut off" in beat.reason:
            raise InputError(f"{source}: beat {beat.number} is {beat.reason}; name others")


def _check_numbers(source: str, count: int, choices: Choices) -> None:
    """Refuse beats that are not there."""
    wrong = [k for k in (*(choices.beats or ()), *choices.exclude) if not 1 <= k <= count]
    if wrong:
        raise InputError(
            f"{source}: there is no beat {wrong[0]}; {count} beats were found, numbered from 1"
        )


def _check_classes(
    source: str, groups: Sequence[SortedBeats], choices: Choices, label: str
) -> None:
    """Refuse a class that is not there, and classes that groups of leads may not share."""
    for group in groups:
        mixed = len(group.of_class(label)) < FEW_ALIKE * len(group.peaks)
        if len(groups) > 1 and mixed and choices.beats is None:
            raise InputError(
                f"{source}: leads were recorded in turns and the beats are of several shapes, "
                "which cannot be matched; name those of one shape in every group by --beats"
            )
        known = sorted(set(group.labels))
        if choices.beat_class is not None and choices.beat_class not in known:
            raise InputError(
                f"{source}: there is no class {choices.beat_class}; the beats are of class "
                f"{', '.join(known)}"
            )


def _label(beats: Sequence[Beat], choices: Choices) -> str:
    """Class of the target: the one that was chosen, or that of most of the beats that were."""
    if choices.beats is not None:
        labels = [beat.label for beat in beats if beat.number in choices.beats]
        return max(sorted(set(labels), key=_by_name), key=labels.count)
    return choices.beat_class if choices.beat_class is not None else "A"


def _cut(
    recording: Recording,
    part: Turn,
    group: SortedBeats,
    reasons: Sequence[str],
    choices: Choices,
    label: str,
) -> CutBeats:
    """Cut the beats without a reason against them."""
    members = np.flatnonzero([not reason for reason in reasons])
    of_class = group.of_class(label)
    if not len(members):
        cut_off = sum("cut off" in reasons[k] for k in of_class)
        raise InputError(
            f"{recording.source}: no beat is left of {len(group.peaks)} in "
            f"{_names(part.recording)} ({len(of_class)} of class {label}, {cut_off} of them cut "
            "off by the ends of the recording); choose others or give a longer recording"
        )
    return cut_beats(group, members, choices.onset)


def _names(recording: Recording) -> str:
    """Name the leads that are there, shortly."""
    names = [lead for lead, there in zip(LEADS, recording.recorded, strict=True) if there]
    return "all leads" if len(names) == len(LEADS) else ", ".join(names)


def _strip(recording: Recording, parts: Sequence[Turn]) -> NDArray[np.float64]:
    """Recorded signal (12, n) at the target's rate, each group of leads in its place."""
    ratio = TARGET_RATE / recording.sampling_rate
    strip = np.full((len(LEADS), round(recording.signal.shape[1] * ratio)), np.nan)
    for part in parts:
        piece = resample(part.recording.signal, recording.sampling_rate)
        start = round(part.start * ratio)
        piece = piece[:, : strip.shape[1] - start]
        place = strip[:, start : start + piece.shape[1]]
        place[:] = np.where(np.isnan(place), piece, place)
    return strip


def _spikes(
    parts: Sequence[Turn], groups: Sequence[SortedBeats], sampling_rate: float
) -> NDArray[np.float64]:
    """Times of the pacing spikes (s)."""
    return np.concatenate(
        [
            part.start / sampling_rate + group.spikes[:, 0] / TARGET_RATE
            for part, group in zip(parts, groups, strict=True)
        ]
    )


def _classes(groups: Sequence[SortedBeats]) -> tuple[BeatClass, ...]:
    """Classes of all groups, the most frequent first."""
    labels = sorted({label for group in groups for label in group.labels}, key=_by_name)
    classes = []
    for label in labels:
        having = [group for group in groups if label in group.labels]
        count = sum(len(group.of_class(label)) for group in having)
        classes.append(BeatClass(label, count, having[0].describe(label)))
    return tuple(classes)


def _by_name(label: str) -> tuple[int, str]:
    """Sort Z before A2."""
    return len(label), label
