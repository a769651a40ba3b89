"""Which filters a target has passed: the recorder's, and those that the user asks for."""

from __future__ import annotations

from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError
from fascicle.recording.filter_estimate import estimated_lowpass
from fascicle.recording.filters import (
    NOTCH_QUALITY,
    RECORDER_ORDER,
    Filter,
    FilterKind,
    FilterOrigin,
    applied_filters,
)
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import TARGET_RATE
from fascicle.recording.target_options import TargetOptions


def passed_filters(
    recording: Recording, r_peaks: Integers, choices: TargetOptions
) -> tuple[Filter, ...]:
    """The recorder's filters and those of this program, in the order in which they were passed.

    Parameters
    ----------
    recording : Recording
        As recorded, without the filters that the user asks for.
    r_peaks : (n_beats,) array
        Samples of its R peaks.
    choices : TargetOptions
        Decisions of the user.

    Raises
    ------
    InputError
        When the user states another low-pass than the file.
    """
    lowpass = _recorder_lowpass(recording, r_peaks, choices)
    notch = recording.filters.notch
    filters = [] if lowpass is None else [lowpass]
    if notch is not None:
        filters.append(Filter(FilterKind.NOTCH, notch, FilterOrigin.FILE, NOTCH_QUALITY))
    return (*filters, *applied_filters(choices.lowpass, choices.notch, TARGET_RATE))


def _recorder_lowpass(
    recording: Recording, r_peaks: Integers, choices: TargetOptions
) -> Filter | None:
    """What the file says, else the user, else the spectrum."""
    named, stated = recording.filters.lowpass, choices.recorder_lowpass
    if named is not None:
        if stated not in (None, named):
            raise InputError(
                f"{recording.source}: the recorder's low-pass is {named:g} Hz in the file, not "
                f"{stated:g} Hz; leave --recorder-lowpass out, or correct the file"
            )
        return Filter(FilterKind.LOW_PASS, named, FilterOrigin.FILE, RECORDER_ORDER)
    if stated is not None:
        return Filter(FilterKind.LOW_PASS, stated, FilterOrigin.STATED, RECORDER_ORDER)
    return estimated_lowpass(recording.signal, recording.sampling_rate, r_peaks)
