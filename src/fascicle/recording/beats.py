"""Beats of the target: selected, cut out, aligned at R and detrended, of one group or several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate
from typing import ClassVar, NamedTuple

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.choices import TargetOptions
from fascicle.recording.detection import magnitude
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.recording.lead_groups import LARGEST_SHIFT, LeadGroup, cut, detrended, end_of_spikes
from fascicle.recording.spikes import spike_tail
from fascicle.recording.window import qrs_window, spatial_velocity


class Unused(Enum):
    """Reason why a beat is not used in the target."""

    CUT_OFF_START = "cut off by the start of the recording"
    CUT_OFF_END = "cut off by the end of the recording"
    EXCLUDED = "excluded"
    NOT_CHOSEN = "not chosen"
    OTHER_CLASS = "of another class"
    DRIFTING = "baseline drifts"
    SURPLUS = "the other groups of leads have no more beats"


class Drift(NamedTuple):
    """Largest deviation (mV) of a beat from the median beat right after the QRS, and its lead."""

    lead: str
    potential: float


@dataclass(frozen=True)
class DetectedBeat:
    """A heart beat of a recording."""

    number: int  # number in order of time, from 1
    time: float  # time of the R peak (s from the start of the recording)
    label: str  # its class: A is the one with the most beats, then B and so on
    interval: float  # time since the beat before (ms); NaN for the first
    unused: Unused | None = None  # reason why the target does not use it
    drift: Drift | None = None  # baseline drift, if that is why it is excluded

    @property
    def used(self) -> bool:
        """True if the target uses the beat."""
        return self.unused is None

    @property
    def cut_off(self) -> bool:
        """True if a part of the beat was not recorded."""
        return self.unused in (Unused.CUT_OFF_START, Unused.CUT_OFF_END)

    @property
    def why_unused(self) -> str:
        """Reason why the beat is not used, in words; empty where it is."""
        if self.unused is Unused.OTHER_CLASS:
            return f"class {self.label}"
        if self.drift is not None:
            return f"baseline drifts by {abs(self.drift.potential):.2f} mV in {self.drift.lead}"
        return "" if self.unused is None else self.unused.value


@dataclass(frozen=True)
class AlignedBeats:
    """Potentials of beats on a common time axis."""

    # samples in which the isoelectric level of a beat is read: one period of 50 Hz
    level_samples: ClassVar[int] = 20

    beats: Floats  # (n_beats, 12 + k, n_time), mV, less the isoelectric level and its drift
    before: int  # sample of the R peak in each
    not_before: int  # sample of the end of the pacing spike that fired the beats; 0 if none did
    alignment_sd: float = 0.0  # ms; standard deviation of the alignment of several lead groups

    @property
    def mean(self) -> Floats:
        """Mean beat (mV), shape (12 + k, n_time)."""
        return np.asarray(self.beats.mean(axis=0))

    @property
    def time(self) -> Floats:
        """Time from the R peak (ms), shape (n_time,)."""
        return SAMPLING_STEP * (np.arange(self.beats.shape[2], dtype=np.float64) - self.before)


def extent(group: LeadGroup) -> tuple[int, int]:
    """Number of samples of a beat before and after R."""
    before, after = 250.0, 450.0  # ms
    if len(group.peaks) > 1:
        interval = float(np.nanmedian(group.intervals))
        before, after = min(before, 0.4 * interval), min(after, 0.6 * interval)
    before, after = round(before / SAMPLING_STEP), round(after / SAMPLING_STEP)
    if len(group.peaks) == 1:
        peak = int(group.peaks[0])
        return min(before, peak), min(after, group.signal.shape[1] - 1 - peak)
    return before, after


def cut_beats(group: LeadGroup, members: Integers, onset: float | None) -> AlignedBeats:
    """Cut out the beats `members` (n_beats,) of a group, and subtract their isoelectric lines.

    The lines are found in the twelve leads alone, or from the `onset` (ms from R) that the user
    gave. Each runs through the isoelectric level before the QRS and that of the nearest beat; where
    none is near, as for a single beat, the level alone is subtracted.
    """
    before, after = extent(group)
    peaks = group.peaks[members]
    signal = np.concatenate([group.signal, group.additional])
    median = np.median(cut(signal, peaks, before, after), axis=0)
    not_before = end_of_spikes(group.signal, group.spikes, peaks, before)
    if not_before:
        tail = spike_tail(median, not_before)
        median = median - tail
        for peak in peaks:
            signal[:, peak - before : peak + after + 1] -= tail
    median = median[: len(LEADS)]
    first = qrs_window(median, not_before)[0]
    if onset is not None:
        first = min(max(before + round(onset / SAMPLING_STEP), 0), before + after)
    # The isoelectric level is read where the beat is slowest, 60 to 5 samples before the QRS:
    # further back is the P wave; nearer, the first slope of the QRS is smoothed in.
    earliest = max(first - 60, 0)
    width = AlignedBeats.level_samples
    velocity = spatial_velocity(median)[earliest : max(first - 5, earliest + width)]
    slowest = np.argmin(np.convolve(velocity, np.full(width, 1 / width), mode="valid"))
    knots = peaks - before + int(earliest + slowest)
    level = np.stack([signal[:, max(k, 0) : k + width].mean(axis=1) for k in knots])
    slope = np.zeros_like(level)  # mV per sample
    for beat, knot in enumerate(knots):
        neighbours = [k for k in (beat + 1, beat - 1) if 0 <= k < len(knots)]
        near = min(neighbours, key=lambda k: abs(int(knots[k] - knot)), default=beat)
        distance = int(knots[near] - knot)
        if 0 < abs(distance) <= 2500:  # samples; over more, drift does not follow a straight line
            slope[beat] = (level[near] - level[beat]) / distance
    since = (peaks - knots)[:, None] - (width - 1) / 2 + np.arange(-before, after + 1)
    beats = cut(signal, peaks, before, after)
    beats = np.asarray(beats - level[:, :, None] - slope[:, :, None] * since[:, None])
    return AlignedBeats(beats, before, not_before)


def drifting_beats(group: LeadGroup, members: Integers, onset: float | None) -> dict[int, Drift]:
    """Find beats whose level right after the QRS differs from the others', by baseline drift.

    A drift, as when an electrode settles or is pushed, need not be the straight line that was
    removed. A drifting beat is off by more than 0.1 mV in a lead, and by more than eight robust
    standard deviations of the beats in that lead, or in the median lead where that is larger. Of
    two neighbours the one further off is excluded first: the other's line may run through it.
    Parameters as of `cut_beats`.
    """
    drifts: dict[int, Drift] = {}
    while len(members) >= 5:
        aligned = cut_beats(group, members, onset)
        end = qrs_window(np.median(aligned.beats, axis=0), aligned.not_before)[1]
        after = slice(end, end + aligned.level_samples)
        levels = aligned.beats[:, : len(LEADS), after].mean(axis=2)
        off = np.asarray(levels - np.median(levels, axis=0))
        # of a normal distribution this is the standard deviation
        spread = 1.4826 * np.median(np.abs(off), axis=0)
        spread = np.maximum(spread, np.nanmedian(spread))
        excess = np.abs(off) / np.maximum(8.0 * spread, 0.1)
        leads = np.argmax(np.where(np.isfinite(excess), excess, 0.0), axis=1)
        worst = np.pad(excess[np.arange(len(members)), leads], 1)
        drifting = (worst[1:-1] > 1) & (worst[1:-1] > worst[:-2]) & (worst[1:-1] >= worst[2:])
        if not drifting.any():
            break
        for k in np.flatnonzero(drifting):
            drifts[int(members[k])] = Drift(LEADS[leads[k]], float(off[k, leads[k]]))
        members = members[~drifting]
    return drifts


def combine(groups: Sequence[AlignedBeats]) -> AlignedBeats:
    """Merge the beats of lead groups, the first of each group with the first of the others.

    The beats are aligned by the leads that the groups share, or else by the root mean square of
    their mean beats. The latter, in synthetic recordings cut up into groups, was right to within 2
    ms in half of them, and off by more than 12 ms in one of ten.
    """
    first = groups[0]
    if len(groups) == 1:
        return first
    complete = [np.isfinite(group.beats[0, : len(LEADS)]).all(axis=1) for group in groups]
    shared = [complete[0] & other for other in complete]
    r_peaks = [first.before]
    for group, both in zip(groups[1:], shared[1:], strict=True):
        a, b = first.mean[: len(LEADS)], group.mean[: len(LEADS)]
        x, y = (a[both], b[both]) if both.any() else (magnitude(a)[None], magnitude(b)[None])
        r_peaks.append(group.before + _shift(x, y, first.before, group.before))
    before = min(r_peaks)
    after = min(group.beats.shape[2] - r for group, r in zip(groups, r_peaks, strict=True))
    count = min(len(group.beats) for group in groups)
    together = np.full((count, first.beats.shape[1], before + after), np.nan)
    not_before = 0
    for group, r in zip(groups, r_peaks, strict=True):
        beats = group.beats[:count, :, r - before : r + after]
        together = np.where(np.isnan(together), beats, together)
        if group.not_before:
            not_before = max(not_before, group.not_before - r + before)
    alone = not all(both.any() for both in shared)
    return AlignedBeats(together, before, not_before, 10.0 if alone else 0.0)


def _shift(x: Floats, y: Floats, x_peak: int, y_peak: int) -> int:
    """Samples by which beats (k, m) lie later about R in the second group than in the first."""
    reach = min(x_peak, y_peak)
    length = min(x.shape[1] - x_peak, y.shape[1] - y_peak) + reach
    x = detrended(x[:, x_peak - reach :][:, :length])
    y = detrended(y[:, y_peak - reach :][:, :length])
    margin = min(LARGEST_SHIFT, length // 3)
    core = x[:, margin : length - margin]
    tries = np.lib.stride_tricks.sliding_window_view(y, core.shape[1], axis=-1)
    return int(np.argmax(np.einsum("ct,cst->s", core, tries)) - margin)


def select_beats(
    groups: Sequence[LeadGroup], options: TargetOptions, source: str
) -> tuple[list[tuple[DetectedBeat, ...]], str]:
    """Number and select the beats of each group; also return the class of the target's beats."""
    firsts = [1, *(1 + n for n in accumulate(len(group.peaks) for group in groups))]
    count = firsts[-1] - 1
    wrong = [k for k in (*(options.beats or ()), *options.exclude) if not 1 <= k <= count]
    if wrong:
        raise InputError(
            f"{source}: there is no beat {wrong[0]}; {count} beats were found, numbered from 1"
        )
    label = options.beat_class if options.beat_class is not None else "A"
    if options.beats is not None:  # the class of most of them
        all_labels = [label for group in groups for label in group.labels]
        labels = [label for k, label in enumerate(all_labels) if k + 1 in options.beats]
        label = max(sorted(set(labels), key=by_name), key=labels.count)
    _check_classes(source, groups, options, label)
    reasons = [
        _reasons(group, options, label, first) for group, first in zip(groups, firsts, strict=False)
    ]
    drifts: list[dict[int, Drift]] = [{} for _ in groups]
    if options.beats is None:  # beats named by the user are all used
        for group, why, drift in zip(groups, reasons, drifts, strict=True):
            members = np.flatnonzero([reason is None for reason in why])
            drift |= drifting_beats(group, members, options.onset)
            for member in drift:
                why[member] = Unused.DRIFTING
    fewest = min(why.count(None) for why in reasons)
    for why in reasons:  # groups recorded one after another use equally many
        used = [k for k, reason in enumerate(why) if reason is None]
        for k in used[fewest:] if fewest else ():
            why[k] = Unused.SURPLUS
    beats = []
    for group, first, why, drift in zip(groups, firsts, reasons, drifts, strict=False):
        rows = zip(group.times, group.labels, group.intervals, why, strict=True)
        numbered = [
            DetectedBeat(first + k, float(time), beat_label, float(interval), reason, drift.get(k))
            for k, (time, beat_label, interval, reason) in enumerate(rows)
        ]
        for beat in numbered:
            if beat.number in (options.beats or ()) and beat.cut_off:
                raise InputError(f"{source}: beat {beat.number} is {beat.why_unused}; name others")
        beats.append(tuple(numbered))
    return beats, label


def by_name(label: str) -> tuple[int, str]:
    """Key that sorts Z before A2."""
    return len(label), label


def _reasons(
    group: LeadGroup, options: TargetOptions, label: str, first_number: int
) -> list[Unused | None]:
    """Reason why each beat of one group is not used; None where it is used."""
    before, after = extent(group)
    n_samples = group.signal.shape[1]
    reasons: list[Unused | None] = []
    for number, (peak, beat_label) in enumerate(
        zip(group.peaks, group.labels, strict=True), first_number
    ):
        if peak < before or peak + after >= n_samples:
            reasons.append(Unused.CUT_OFF_START if peak < n_samples / 2 else Unused.CUT_OFF_END)
        elif number in options.exclude:
            reasons.append(Unused.EXCLUDED)
        elif options.beats is not None:
            reasons.append(None if number in options.beats else Unused.NOT_CHOSEN)
        else:
            reasons.append(None if beat_label == label else Unused.OTHER_CLASS)
    return reasons


def _check_classes(
    source: str, groups: Sequence[LeadGroup], options: TargetOptions, label: str
) -> None:
    """Refuse a class without beats, and beats of several shapes in several lead groups."""
    for group in groups:
        mixed = len(group.of_class(label)) < options.few_alike * len(group.peaks)
        if len(groups) > 1 and mixed and options.beats is None:
            raise InputError(
                f"{source}: leads were recorded one group after another and the beats are of "
                "several shapes, which cannot be matched; name those of one shape in every group "
                "by --beats"
            )
        labels = sorted(set(group.labels))
        if options.beat_class is not None and options.beat_class not in labels:
            raise InputError(
                f"{source}: there is no class {options.beat_class}; the beats are of class "
                f"{', '.join(labels)}"
            )
