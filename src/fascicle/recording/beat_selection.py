"""Which beats of a recording make its target."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.aligned_beats import extent
from fascicle.recording.analysis import Beat, Unused
from fascicle.recording.baseline_drift import Drift, drifting_beats
from fascicle.recording.lead_groups import LeadGroup
from fascicle.recording.target_options import TargetOptions

FEW_ALIKE = 0.7  # share of the beats that should be alike


def select_beats(
    groups: Sequence[LeadGroup], choices: TargetOptions, source: str
) -> tuple[list[tuple[Beat, ...]], str]:
    """Number all beats and decide which are used.

    Parameters
    ----------
    groups : sequence of LeadGroup
        In the order of time, each with at least one beat.
    choices : TargetOptions
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
    _check_numbers(source, firsts[-1] - 1, choices)
    label = _target_class(groups, choices)
    _check_classes(source, groups, choices, label)
    reasons = [
        _reasons(group, choices, label, first) for group, first in zip(groups, firsts, strict=False)
    ]
    drifts = [
        _leave_out_drifting(group, why, choices) for group, why in zip(groups, reasons, strict=True)
    ]
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
    _check_named(source, [beat for own in beats for beat in own], choices)
    return beats, label


def by_name(label: str) -> tuple[int, str]:
    """Key that sorts Z before A2."""
    return len(label), label


def _target_class(groups: Sequence[LeadGroup], choices: TargetOptions) -> str:
    """Class of the target: the one that was chosen, or that of most of the beats that were."""
    if choices.beats is not None:
        every = [label for group in groups for label in group.labels]
        labels = [label for k, label in enumerate(every) if k + 1 in choices.beats]
        return max(sorted(set(labels), key=by_name), key=labels.count)
    return choices.beat_class if choices.beat_class is not None else "A"


def _reasons(
    group: LeadGroup, choices: TargetOptions, label: str, first_number: int
) -> list[Unused | None]:
    """Why each beat of one group is not used; None where it is."""
    before, after = extent(group)
    n_samples = group.signal.shape[1]
    reasons: list[Unused | None] = []
    for number, (peak, one) in enumerate(zip(group.peaks, group.labels, strict=True), first_number):
        if peak < before or peak + after >= n_samples:
            near_start = peak < n_samples / 2
            reasons.append(Unused.CUT_OFF_START if near_start else Unused.CUT_OFF_END)
        elif number in choices.exclude:
            reasons.append(Unused.EXCLUDED)
        elif choices.beats is not None:
            reasons.append(None if number in choices.beats else Unused.NOT_CHOSEN)
        else:
            reasons.append(None if one == label else Unused.OTHER_CLASS)
    return reasons


def _leave_out_drifting(
    group: LeadGroup, reasons: list[Unused | None], choices: TargetOptions
) -> dict[int, Drift]:
    """Leave out beats whose baseline drifts, unless the user has named those to use."""
    if choices.beats is not None:
        return {}
    members = np.flatnonzero([reason is None for reason in reasons])
    drifts = drifting_beats(group, members, choices.onset)
    for beat in drifts:
        reasons[beat] = Unused.DRIFTING
    return drifts


def _check_numbers(source: str, count: int, choices: TargetOptions) -> None:
    """Refuse beats that are not there."""
    wrong = [k for k in (*(choices.beats or ()), *choices.exclude) if not 1 <= k <= count]
    if wrong:
        raise InputError(
            f"{source}: there is no beat {wrong[0]}; {count} beats were found, numbered from 1"
        )


def _check_named(source: str, beats: Sequence[Beat], choices: TargetOptions) -> None:
    """Refuse to leave out beats that the user has named."""
    for beat in beats:
        if beat.number in (choices.beats or ()) and beat.unused is not None and beat.unused.cut_off:
            raise InputError(f"{source}: beat {beat.number} is {beat.why_unused}; name others")


def _check_classes(
    source: str, groups: Sequence[LeadGroup], choices: TargetOptions, label: str
) -> None:
    """Refuse a class that is not there, and classes that groups of leads may not share."""
    for group in groups:
        mixed = len(group.of_class(label)) < FEW_ALIKE * len(group.peaks)
        if len(groups) > 1 and mixed and choices.beats is None:
            raise InputError(
                f"{source}: leads were recorded one group after another and the beats are of "
                "several shapes, which cannot be matched; name those of one shape in every group "
                "by --beats"
            )
        labels = sorted(set(group.labels))
        if choices.beat_class is not None and choices.beat_class not in labels:
            raise InputError(
                f"{source}: there is no class {choices.beat_class}; the beats are of class "
                f"{', '.join(labels)}"
            )
