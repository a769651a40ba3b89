"""Which beats of a recording make its target."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.aligned_beats import drifting_beats, extent
from fascicle.recording.analysis import Beat, Drift, Unused
from fascicle.recording.lead_groups import LeadGroup
from fascicle.recording.target_options import TargetOptions

FEW_ALIKE = 0.7  # share of the beats that should be alike


def select_beats(
    groups: Sequence[LeadGroup], options: TargetOptions, source: str
) -> tuple[list[tuple[Beat, ...]], str]:
    """Number all beats and decide which are used.

    Parameters
    ----------
    groups : sequence of LeadGroup
        In the order of time, each with at least one beat.
    options : TargetOptions
        Decisions of the user.
    source : str
        What error messages begin with.

    Returns
    -------
    beats : list of tuple of Beat
        Those of each group.
    label : str
        Class of the target's beats.

    Raises
    ------
    InputError
        When a beat or class that the user names is not there or cannot be used.
    """
    firsts = [1, *(1 + n for n in accumulate(len(group.peaks) for group in groups))]
    _check_numbers(source, firsts[-1] - 1, options)
    label = _target_class(groups, options)
    _check_classes(source, groups, options, label)
    reasons = [
        _reasons(group, options, label, first) for group, first in zip(groups, firsts, strict=False)
    ]
    drifts: list[dict[int, Drift]] = []
    for group, why in zip(groups, reasons, strict=True):
        members = np.flatnonzero([reason is None for reason in why])
        named = options.beats is not None  # what the user names is used
        drifts.append({} if named else drifting_beats(group, members, options.onset))
        for member in drifts[-1]:
            why[member] = Unused.DRIFTING
    fewest = min(why.count(None) for why in reasons)
    for why in reasons:  # groups recorded one after another use equally many
        used = [k for k, reason in enumerate(why) if reason is None]
        for k in used[fewest:] if fewest else ():
            why[k] = Unused.SURPLUS
    beats = [
        tuple(
            Beat(first + k, float(time), one, float(interval), reason, drift.get(k))
            for k, (time, one, interval, reason) in enumerate(
                zip(group.times, group.labels, group.intervals, why, strict=True)
            )
        )
        for group, first, why, drift in zip(groups, firsts, reasons, drifts, strict=False)
    ]
    for beat in (beat for own in beats for beat in own):
        if beat.number in (options.beats or ()) and beat.cut_off:
            raise InputError(f"{source}: beat {beat.number} is {beat.why_unused}; name others")
    return beats, label


def by_name(label: str) -> tuple[int, str]:
    """Key that sorts Z before A2."""
    return len(label), label


def _target_class(groups: Sequence[LeadGroup], options: TargetOptions) -> str:
    """Class of the target: the one that was chosen, or that of most of the beats that were."""
    if options.beats is not None:
        every = [label for group in groups for label in group.labels]
        labels = [label for k, label in enumerate(every) if k + 1 in options.beats]
        return max(sorted(set(labels), key=by_name), key=labels.count)
    return options.beat_class if options.beat_class is not None else "A"


def _reasons(
    group: LeadGroup, options: TargetOptions, label: str, first_number: int
) -> list[Unused | None]:
    """Why each beat of one group is not used; None where it is."""
    before, after = extent(group)
    n_samples = group.signal.shape[1]
    reasons: list[Unused | None] = []
    for number, (peak, one) in enumerate(zip(group.peaks, group.labels, strict=True), first_number):
        if peak < before or peak + after >= n_samples:
            near_start = peak < n_samples / 2
            reasons.append(Unused.CUT_OFF_START if near_start else Unused.CUT_OFF_END)
        elif number in options.exclude:
            reasons.append(Unused.EXCLUDED)
        elif options.beats is not None:
            reasons.append(None if number in options.beats else Unused.NOT_CHOSEN)
        else:
            reasons.append(None if one == label else Unused.OTHER_CLASS)
    return reasons


def _check_numbers(source: str, count: int, options: TargetOptions) -> None:
    """Refuse beats that are not there."""
    wrong = [k for k in (*(options.beats or ()), *options.exclude) if not 1 <= k <= count]
    if wrong:
        raise InputError(
            f"{source}: there is no beat {wrong[0]}; {count} beats were found, numbered from 1"
        )


def _check_classes(
    source: str, groups: Sequence[LeadGroup], options: TargetOptions, label: str
) -> None:
    """Refuse a class that is not there, and classes that groups of leads may not share."""
    for group in groups:
        mixed = len(group.of_class(label)) < FEW_ALIKE * len(group.peaks)
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
