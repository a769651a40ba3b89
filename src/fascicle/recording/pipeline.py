"""From a recording to its target, with everything that was found on the way.

Recording -> `LeadGroup` (leads recorded together, their beats) -> `AlignedBeats` (those chosen, cut
out) -> `Target`.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import NoneType

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.ranges import check_kind
from fascicle.recording.aligned_beats import AlignedBeats, combine, cut_beats
from fascicle.recording.analysis import Analysis, Beat, BeatClass
from fascicle.recording.beat_selection import by_name, select_beats
from fascicle.recording.lead_groups import LeadGroup, lead_groups
from fascicle.recording.passed_filters import passed_filters
from fascicle.recording.quality.check import check_leads, check_recording
from fascicle.recording.quality.check_result import CheckResult, Severity
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import TARGET_RATE
from fascicle.recording.spatial_velocity import NoQrsError
from fascicle.recording.target import Target
from fascicle.recording.target_from_beats import target_from_beats
from fascicle.recording.target_options import TargetOptions

LARGEST_QRS, SMALLEST_QRS = 20.0, 0.05  # mV peak to peak; outside, the unit is wrong
LEAST_SIGNAL = 0.5  # energy of the median beat over that of the noise between beats


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
    """Aligned, detrended beats of a recording and their QRS window.

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
        ``provenance["warnings"]`` is there when something is suspicious; `analyse` says more.

    Raises
    ------
    InputError
        When no target can be made of the recording, or a choice is impossible.
    """
    choices = TargetOptions(onset, offset, beat_class, beats, exclude, noise)
    return analyse(recording, choices).target


def analyse(recording: Recording, choices: TargetOptions | None = None) -> Analysis:
    """Find, sort, choose and detrend the beats of a recording, and find their QRS window.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    choices : TargetOptions, optional
        Decisions of the user; by default everything is decided here.

    Raises
    ------
    InputError
        When a check refuses the recording, it has too few beats, or a choice is impossible.
    """
    check_kind(recording, Recording, "recording", "what fascicle.read_recording returned")
    check_kind(choices, (TargetOptions, NoneType), "choices", "fascicle.TargetOptions")
    choices = choices if choices is not None else TargetOptions()
    source = recording.source
    findings = check_leads(recording)
    _refuse(findings, recording)
    try:
        groups = lead_groups(recording, choices)
        _check_beats_found(source, groups)
        checked = groups[0].recording if len(groups) == 1 else recording
        times = np.concatenate([group.times for group in groups])
        r_peaks = np.round(times * recording.sampling_rate).astype(np.int64)
        filters = passed_filters(recording, r_peaks, choices)
        findings += check_recording(checked, r_peaks, filters)
        _refuse(findings, recording)
        by_group, label = select_beats(groups, choices, source)
        aligned = combine(
            [
                _cut(source, group, own, choices, label)
                for group, own in zip(groups, by_group, strict=True)
            ]
        )
        beats = tuple(beat for own in by_group for beat in own)
        target = target_from_beats(recording, aligned, beats, choices, label, findings, filters)
    except NoQrsError as error:
        raise InputError(
            f"{source}: {error}; leave bad leads out by --leads, or give a cleaner recording"
        ) from error
    return Analysis(
        recording=recording,
        signal=_recorded_signal(recording, groups),
        beats=beats,
        classes=_classes(groups),
        spikes=np.concatenate([group.spike_times for group in groups]),
        findings=findings,
        target=target,
        chosen=label,
    )


def _refuse(findings: Sequence[CheckResult], recording: Recording) -> None:
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


def _check_beats_found(source: str, groups: Sequence[LeadGroup]) -> None:
    """Refuse recordings without beats, or with beats of another size than a heart's."""
    for group in groups:
        if not len(group.peaks):
            raise InputError(
                f"{source}: no beats found in {group.recording.duration:.1f} s of "
                f"{group.leads}; give a longer or cleaner recording (10 s is usual)"
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


def _cut(
    source: str, group: LeadGroup, beats: Sequence[Beat], choices: TargetOptions, label: str
) -> AlignedBeats:
    """Cut out the beats of one group that are used."""
    members = np.flatnonzero([beat.used for beat in beats])
    if not len(members):
        of_class = [beat for beat in beats if beat.label == label]
        cut_off = sum(beat.unused is not None and beat.unused.cut_off for beat in of_class)
        raise InputError(
            f"{source}: no beat is left of {len(beats)} in {group.leads} ({len(of_class)} of class "
            f"{label}, {cut_off} of them cut off by the ends of the recording); choose others or "
            "give a longer recording"
        )
    return cut_beats(group, members, choices.onset)


def _recorded_signal(recording: Recording, groups: Sequence[LeadGroup]) -> Floats:
    """Recorded potential (12, n), mV, at the target's rate, each group of leads in its place."""
    ratio = TARGET_RATE / recording.sampling_rate
    signal = np.full((len(LEADS), round(recording.signal.shape[1] * ratio)), np.nan)
    for group in groups:
        start = round(group.start * ratio)
        place = signal[:, start : start + group.recorded.shape[1]]
        place[:] = np.where(np.isnan(place), group.recorded[:, : place.shape[1]], place)
    return signal


def _classes(groups: Sequence[LeadGroup]) -> tuple[BeatClass, ...]:
    """Classes of all groups, the most frequent first."""
    labels = sorted({label for group in groups for label in group.labels}, key=by_name)
    classes = []
    for label in labels:
        having = [group for group in groups if label in group.labels]
        count = sum(len(group.of_class(label)) for group in having)
        classes.append(BeatClass(label, count, having[0].describe(label)))
    return tuple(classes)
