"""Analysis of a recording: from the signal to its target, with all findings on the way."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import NoneType

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.ranges import check_kind, digits, short_repr
from fascicle.recording import quality, window
from fascicle.recording.beats import (
    AlignedBeats,
    DetectedBeat,
    by_name,
    combine,
    cut_beats,
    select_beats,
)
from fascicle.recording.choices import TargetOptions, check_window
from fascicle.recording.detection import magnitude
from fascicle.recording.filter_estimate import passed_filters
from fascicle.recording.filters import TARGET_RATE, Filter, resample
from fascicle.recording.lead_groups import LeadGroup, complete_in, lead_groups, stretches
from fascicle.recording.limb_leads import check_identities, check_reversal
from fascicle.recording.recording import MissingMetadataError, Recording
from fascicle.recording.spikes import find_spikes, remove_spikes
from fascicle.recording.target import Target


@dataclass(frozen=True)
class BeatClass:
    """Beats of one shape: label (A, B, ...), number, and notable features, such as ``early``."""

    label: str
    count: int
    description: str


@dataclass(frozen=True)
class Analysis:
    """Analysis of a recording: its checks, beats and classes, and the target built from it.

    Attributes
    ----------
    recording : Recording
        Recording with the user's corrections.
    signal : (12, n) array
        Potential (mV) as recorded, every `fascicle.recording.filters.SAMPLING_STEP`; NaN where a
        lead was not recorded.
    beats : tuple of Beat
        Every beat that was found.
    classes : tuple of BeatClass
        Classes of the beats, the most frequent first.
    spikes : (k,) array
        Times of pacing spikes (s).
    findings : tuple of CheckResult
        Every check with its figure.
    target : Target
        Target of the inference.
    chosen : str
        Label of the class of the target's beats.
    """

    recording: Recording
    signal: Floats
    beats: tuple[DetectedBeat, ...]
    classes: tuple[BeatClass, ...]
    spikes: Floats
    findings: tuple[quality.CheckResult, ...]
    target: Target
    chosen: str

    __repr__ = short_repr

    @property
    def read_with(self) -> tuple[str, ...]:
        """Statements of the user about the file, in words, that the reading relied on."""
        texts = {
            "shared_gain": "one gain for all leads, {}, in place of the file's "
            "(amplitudes rest on it)",
            "choice_unit": "unit {}",
            "choice_sampling_rate_hz": "sampling rate {} Hz",
            "inverted": "upside down: {}",
            "swapped": "exchanged: {}",
        }
        notes = self.recording.provenance
        return tuple(text.format(notes[key]) for key, text in texts.items() if key in notes)


def make_target(
    recording: Recording,
    onset: float | None = None,
    offset: float | None = None,
    *,
    beat_class: str | None = None,
    beats: tuple[int, ...] | None = None,
    exclude: tuple[int, ...] = (),
    noise: float | None = None,
    lowpass: float | None = None,
    notch: float | None = None,
    recorder_lowpass: float | None = None,
) -> Target:
    """Aligned, detrended beats of a recording and their QRS window.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    onset, offset, beat_class, beats, exclude, noise, lowpass, notch, recorder_lowpass : optional
        Decisions, as of `TargetOptions`.

    Returns
    -------
    Target
        Its `warnings` say what is suspicious; `analyse` returns more.

    Raises
    ------
    InputError
        When no target can be made of the recording, or a choice is impossible.
    """
    options = TargetOptions(
        onset, offset, beat_class, beats, exclude, noise, lowpass, notch, recorder_lowpass
    )
    return analyse(recording, options).target


def analyse(recording: Recording, choices: TargetOptions | None = None) -> Analysis:
    """Find, sort, choose and detrend the beats of a recording, and find their QRS window.

    Decisions that `choices` leaves open are made automatically.

    Raises
    ------
    InputError
        When a check refuses the recording, it has too few beats, or a choice is impossible.
    """
    check_kind(recording, Recording, "recording", "what fascicle.read_recording returned")
    check_kind(choices, (TargetOptions, NoneType), "choices", "fascicle.TargetOptions")
    options = choices if choices is not None else TargetOptions()
    source, rate = recording.source, recording.sampling_rate
    complete = {lead: x for lead, x in recording.additional.items() if np.isfinite(x).all()}
    findings = quality.check_leads(replace(recording, additional=complete))
    _refuse(findings, recording)
    spikes = find_spikes(recording.signal, rate)
    signals = np.array([*recording.signal, *recording.additional.values()])
    signals = remove_spikes(signals, spikes, rate)
    more = dict(zip(recording.additional, signals[len(LEADS) :], strict=True))
    clean = replace(recording, signal=signals[: len(LEADS)], additional=more)
    try:
        groups = lead_groups(clean, spikes, options)
        recording = _with_beats_checked(recording, groups)
        times = np.concatenate([group.times for group in groups])
        r_peaks = np.round(times * rate).astype(np.int64)
        filters = passed_filters(recording, r_peaks, options)
        checked = replace(clean, additional={lead: clean.additional[lead] for lead in complete})
        reversal = check_reversal(checked, r_peaks, paced=len(spikes) > 0)
        findings += (*check_identities(checked), reversal)
        findings += quality.check_recording(checked, r_peaks, filters)
        _refuse(findings, recording)
        by_group, label = select_beats(groups, options, source)
        pairs = zip(groups, by_group, strict=True)
        aligned = combine(
            [_cut(source, group, group_beats, options, label) for group, group_beats in pairs]
        )
        beats = tuple(beat for group_beats in by_group for beat in group_beats)
        target = _target(recording, aligned, beats, options, label, filters)
    except window.NoQrsError as error:
        raise InputError(
            f"{source}: {error}; leave bad leads out by --leads, or give a cleaner recording"
        ) from error
    findings += quality.check_mean_beat(target.qrs[: len(LEADS)], recording.simultaneous)
    analysis = Analysis(
        recording=recording,
        signal=_recorded_signal(recording),
        beats=beats,
        classes=_classes(groups),
        spikes=np.concatenate([g.start + g.spikes[:, 0] / TARGET_RATE for g in groups]),
        findings=findings,
        target=target,
        chosen=label,
    )
    if warnings := _warnings(analysis, options):
        analysis = replace(analysis, target=replace(target, warnings=tuple(warnings)))
    return analysis


def _refuse(findings: Sequence[quality.CheckResult], recording: Recording) -> None:
    """Raise the first finding that forbids a target, with the corrections that may be the fault."""
    notes = recording.provenance
    done = [f"{name} {notes[name]}" for name in ("inverted", "swapped") if name in notes]
    note = f" (after your options: {', '.join(done)}; they may be the fault)" if done else ""
    for finding in findings:
        if finding.severity is quality.Severity.FATAL:
            raise InputError(f"{recording.source}: {finding.message}{note}")


def _with_beats_checked(recording: Recording, groups: Sequence[LeadGroup]) -> Recording:
    """Refuse recordings without beats, or of a size that no heart has; remark on unusual ones."""
    for group in groups:
        if not len(group.peaks):
            seconds = group.signal.shape[1] / TARGET_RATE
            raise InputError(
                f"{recording.source}: no beats found in {seconds:.1f} s of {group.leads}; give a "
                "longer or cleaner recording (10 s is usual)"
            )
    remark = _check_amplitude(recording, max(group.height for group in groups))
    clearest = min(group.signal_to_noise for group in groups)
    if clearest < 0.5:
        raise InputError(
            f"{recording.source}: no heart beats stand out of the noise (ratio of energies "
            f"{clearest:.2f}); give a cleaner recording"
        )
    return replace(recording, remarks=(*recording.remarks, *remark))


def _check_amplitude(recording: Recording, height: float) -> list[str]:
    """Check the height (mV) of beats in the largest lead: refuse it, ask, or return a warning.

    Below 0.5 mV in the limb leads and 1.0 mV in the chest leads the voltage is low (E. W. Hancock
    et al., AHA/ACCF/HRS recommendations, part V, J. Am. Coll. Cardiol. 53:992, 2009); the 98th
    percentiles of R and S are up to 3 mV in a lead (P. R. Rijnbeek et al., J. Electrocardiol.
    47:914, 2014), and hypertrophy adds to that.
    """
    if not 0.05 <= height <= 20.0:
        raise InputError(
            f"{recording.source}: the largest lead spans {digits(height)} mV in one beat, expected "
            "0.05 to 20 mV; correct the unit or the gain of the file"
        )
    if 0.5 <= height <= 5.0 or not recording.from_file:
        return []
    # gain or unit may be wrong
    if not (0.3 <= height <= 6.0 or recording.amplitude_stated):
        gains, gain = recording.digits_per_millivolt, ""
        if gains is not None and np.isfinite(gains).any():
            gain = f" (--shared-gain --digits-per-mv, in place of {np.nanmedian(gains):g})"
        raise MissingMetadataError(
            f"{recording.source}: the QRS spans {height:.2g} mV in its largest lead, that of a "
            f"person 0.3 to 6 mV; correct the gain{gain}, or confirm the unit that the file states "
            "by --unit",
            "unit",
        )
    size = "low" if height < 0.5 else "high"
    return [
        f"{size} voltage: the QRS spans {height:.2g} mV in its largest lead, usually 0.5 to 5 mV; "
        "are unit and gain right?"
    ]


def _cut(
    source: str, group: LeadGroup, beats: Sequence[DetectedBeat], options: TargetOptions, label: str
) -> AlignedBeats:
    members = np.flatnonzero([beat.used for beat in beats])
    if not len(members):
        of_class = [beat for beat in beats if beat.label == label]
        raise InputError(
            f"{source}: no beat is left of {len(beats)} in {group.leads} ({len(of_class)} of class "
            f"{label}, {sum(beat.cut_off for beat in of_class)} of them cut off by the ends of the "
            "recording); choose others or give a longer recording"
        )
    return cut_beats(group, members, options.onset)


def _recorded_signal(recording: Recording) -> Floats:
    """Recorded potential (12, n), mV, at the target's rate, each stretch of leads in its place."""
    ratio = TARGET_RATE / recording.sampling_rate
    signal = np.full((len(LEADS), round(recording.signal.shape[1] * ratio)), np.nan)
    for first, stop in stretches(recording):
        recorded = resample(complete_in(recording.signal, first, stop), recording.sampling_rate)
        start = round(first * ratio)
        place = signal[:, start : start + recorded.shape[1]]
        place[:] = np.where(np.isnan(place), recorded[:, : place.shape[1]], place)
    return signal


def _classes(groups: Sequence[LeadGroup]) -> tuple[BeatClass, ...]:
    counts = Counter(label for group in groups for label in group.labels)
    first = {label: group for group in reversed(groups) for label in group.labels}
    labels = sorted(counts, key=by_name)
    return tuple(BeatClass(label, counts[label], first[label].describe(label)) for label in labels)


def _target(
    recording: Recording,
    aligned: AlignedBeats,
    beats: Sequence[DetectedBeat],
    options: TargetOptions,
    label: str,
    filters: tuple[Filter, ...],
) -> Target:
    source, count = recording.source, len(aligned.beats)
    if count == 1 and options.noise is None:
        message = (
            f"{source}: a single beat (class {label}) does not show how beats vary; state its "
            "noise by --noise (mV), or give a recording with more beats of one shape"
        )
        why = "beats at rest differ by about as much (mV)"
        raise MissingMetadataError(message, "noise", 0.03, why)
    if count > 1 and options.noise is not None:
        raise InputError(
            f"{source}: {count} beats show how they vary; --noise is for a single beat"
        )
    smoothing = window.smoothing_against_ringing(filters)
    onset, offset, onset_sd, offset_sd = _window(aligned, smoothing, options, source)
    intervals = [beat.interval for beat in beats if math.isfinite(beat.interval)]
    notes = {
        "source": source,
        "sampling_rate_hz": f"{recording.sampling_rate:g}",
        "recording_duration_s": f"{recording.duration:.3f}",
        "beats_found": str(len(beats)),
        "beats_used": str(count),
        "beat_numbers": ", ".join(str(beat.number) for beat in beats if beat.used),
        "beat_class": ", ".join(sorted({beat.label for beat in beats if beat.used})),
        "qrs_onset_from": "detected" if options.onset is None else "given",
        "qrs_offset_from": "detected" if options.offset is None else "given",
    }
    lists = {"derived_leads": recording.derived, "ignored_channels": recording.ignored}
    notes |= {name: ", ".join(channels) for name, channels in lists.items() if channels}
    notes = recording.provenance | notes | options.described()
    return Target(
        beats=aligned.beats,
        time=aligned.time,
        qrs_onset=onset,
        qrs_offset=offset,
        heart_rate=60000.0 / float(np.mean(intervals)) if intervals else None,
        provenance=notes | {"filters": "\n".join(map(str, filters)) or "none known"},
        onset_sd=onset_sd,
        offset_sd=offset_sd,
        noise=options.noise,
        filters=filters,
        earliest_onset=float(aligned.time[aligned.not_before]) if aligned.not_before else None,
        leads=(*LEADS, *recording.additional),
    )


def _window(
    aligned: AlignedBeats, smoothing: float, options: TargetOptions, source: str
) -> tuple[float, float, float, float]:
    """QRS window (ms from R), its ends stated by the user or detected, and their SDs (ms).

    A stated end has an SD of 0; a detected one with an SD of more than 40 ms is refused.
    """
    first, last = window.qrs_window(aligned.mean, aligned.not_before, smoothing)
    time = aligned.time
    start = float(time[first]) if options.onset is None else float(options.onset)
    end = float(time[last]) if options.offset is None else float(options.offset)
    check_window(start, end, source)
    if not start < 0 < end and None in (options.onset, options.offset):
        raise InputError(
            f"{source}: QRS window {start:g} to {end:g} ms does not hold the R peak (0 ms); give "
            "--onset and --offset about it, or a cleaner recording"
        )
    if start < time[0] or end > time[-1]:
        raise InputError(
            f"{source}: QRS window {start:g} to {end:g} ms leaves the beat, which spans "
            f"{time[0]:g} to {time[-1]:g} ms from the R peak; give an onset and offset inside"
        )
    sds = window.window_uncertainty(aligned.beats, aligned.not_before, options.noise, smoothing)
    deviations = []
    for name, sd in zip(("onset", "offset"), sds, strict=True):
        by_user = getattr(options, name) is not None
        deviations.append(0.0 if by_user else math.hypot(sd, aligned.alignment_sd))
        if deviations[-1] > 40.0:
            raise InputError(
                f"{source}: QRS {name} found to within {deviations[-1]:.0f} ms only (at most 40); "
                f"give it by --{name}, or a cleaner recording"
            )
    return start, end, deviations[0], deviations[1]


def _warnings(analysis: Analysis, options: TargetOptions) -> list[str]:
    recording, target, beats = analysis.recording, analysis.target, analysis.beats
    warned = [f for f in analysis.findings if f.severity is quality.Severity.WARNING]
    warnings = [finding.message for finding in warned if finding.message]
    if not recording.simultaneous:
        middles = [(first + stop) // 2 for first, stop in stretches(recording)]
        strips = np.array(LEADS)[np.isfinite(recording.signal[:, middles]).all(axis=1)]
        how = quality.listed(strips) if strips.size else "the whole QRS, to within some 10 ms"
        warnings.append(
            "leads were recorded one group after another: beats of different groups are put "
            f"together, aligned by {how}"
        )
    warnings += recording.remarks
    rate, qrs = target.heart_rate, target.qrs_duration
    # Of the adults of PTB-XL none has a QRS below 75 ms.
    too_fast = rate is not None and (rate > 300.0 or (rate > 90.0 and qrs < 65.0))
    if rate is not None and (too_fast or rate < 20.0):
        warnings.append(
            f"{rate:.0f} beats per minute with a QRS of {qrs:.0f} ms: the sampling rate "
            f"({recording.sampling_rate:g} Hz) may be too {'high' if too_fast else 'low'}; compare "
            "it with the recorder's"
        )
    if len(target.beats) == 2:
        warnings.append("two beats show little of how beats vary; give a longer recording")
    alike = sum(beat.label == analysis.chosen for beat in beats)
    if options.beats is None and _alternate(beats):
        warnings.append(
            "beats of two classes alternate: every second one is ectopic, or twice as many were "
            "found as there are, with T waves among them; look at the picture (--class chooses)"
        )
    elif options.beats is None and alike < options.few_alike * len(beats):
        warnings.append(
            f"only {alike} of {len(beats)} beats are of class {analysis.chosen}; look at the rhythm"
        )
    spread = float(np.nanmean(magnitude(target.standard_deviation[:, target.qrs_samples])))
    height = float(magnitude(target.qrs).max())
    if spread > 0.2 * height:
        warnings.append(
            f"the QRS varies by {spread:.3f} mV from beat to beat, {spread / height:.0%} of its "
            "height; the recording is noisy"
        )
    return warnings


def _alternate(beats: Sequence[DetectedBeat]) -> bool:
    """True if nearly every second of four or more beats is of one class, the others of another."""
    two = {label for label, _ in Counter(beat.label for beat in beats).most_common(2)}
    changes = [{beat.label, following.label} == two for beat, following in pairwise(beats)]
    return len(two) == 2 and len(beats) >= 4 and sum(changes) >= 0.8 * len(changes)
