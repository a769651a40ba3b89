"""How the recorder was set: rate, duration, filters that change the QRS, digits and their range."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.recording.filter_estimate import estimated_lowpass
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.quality.check_result import Check, CheckResult, Severity
from fascicle.recording.quality.lead_signals import UV_PER_MV, measured
from fascicle.recording.recording import Recording

RATE = Check("sampling rate", "Hz", 500.0)  # AHA/ACC/HRS, see `check_filters`
DURATION = Check("duration", "s", 5.0)  # half of the 10 s of a standard recording
LOWPASS = Check("recorder's low-pass", "Hz", 150.0)  # for adults: AHA/ACC/HRS
HIGHPASS = Check("recorder's high-pass", "Hz", 0.5)  # above it the QRS itself changes, not only ST
MAINS_FILTER = Check("recorder's mains filter", "Hz", np.nan)
AS_STATED = 1.1  # ratio of cut-offs that may be one
STEEPER = 2.0  # ratio of orders from which on a filter rings otherwise
STRONG_LOWPASS = 40.0  # Hz; at and below it small deflections of the QRS vanish

STEP = Check("amplitude step", "uV", 20.0)  # recorders store 5 uV or finer
ENOUGH = 100_000  # samples that show the step
ROUNDING = 1e-7  # mV; values nearer to each other than this are one value

CLIPPED = Check("samples at the rails", "", 1e-4)  # share; one run of 3 in 30 000
SHORTEST_RUN = 3  # equal samples at the extreme value
# A rounded peak comes to its top by steps of about one digit; a cut one arrives at full slope.
STEEPEST_ROUND = 4.0  # digits between the run and the sample beside it
FEWEST_RUNS, LONG_RUN = 3, 0.02  # runs, or s of one run; fewer and shorter happen by chance


def check_extent_in_time(recording: Recording, n_beats: int) -> list[CheckResult]:
    """Compare the sampling rate (Hz) and the duration (s) with what is usual: two findings.

    The duration is not judged (NaN) where there is a single beat, whose noise is stated.
    """
    rate, duration = recording.sampling_rate, recording.duration
    slow, short = "", ""
    if rate < RATE.limit:
        slow = f"{rate:g} Hz blur the QRS; export the recording at {RATE.limit:g} Hz or more"
    if n_beats == 1:
        duration = np.nan
    elif duration < DURATION.limit:
        short = f"{duration:.1f} s hold few beats, so their spread is uncertain; give 10 s"
    return [RATE.found(rate, slow), DURATION.found(duration, short)]


def check_filters(
    recording: Recording, peaks: Integers, passed: Sequence[Filter]
) -> list[CheckResult]:
    """Say what the recorder's filters do to the QRS.

    The figures are the low-pass, high-pass and notch (Hz); NaN where none is known, which is fine.
    Of the filters that were `passed` the recorder's low-pass counts, which is not always in the
    file; one that the user states is set against the spectrum of the beats about the `peaks`.

    References
    ----------
    P. Kligfield et al., Recommendations for the standardization and interpretation of the
    electrocardiogram, part I, Circulation 115:1306 (2007).
    """
    filters = recording.filters
    low, high, notch = "", "", ""
    lowpass = _recorder_lowpass(passed)
    if lowpass is not None and lowpass.frequency < LOWPASS.limit:
        much = "strongly " if lowpass.frequency <= STRONG_LOWPASS else ""
        known = ", estimated from the spectrum," if lowpass.origin is FilterOrigin.ESTIMATED else ""
        low = (
            f"the recorder's low-pass at {lowpass.frequency:.3g} Hz{known} {much}smooths the QRS "
            f"({LOWPASS.limit:g} Hz are recommended); export the recording unfiltered"
        )
    if lowpass is not None and lowpass.origin is FilterOrigin.STATED:
        low = "; ".join(filter(None, (low, _contradicted(lowpass, recording, peaks))))
    if filters.highpass is not None and filters.highpass > HIGHPASS.limit:
        high = (
            f"the recorder's high-pass at {filters.highpass:g} Hz bends the QRS and ST (0.05 Hz "
            "are recommended); export the recording unfiltered"
        )
    if filters.notch is not None:
        notch = f"note: the recorder's mains filter at {filters.notch:g} Hz was on"
    return [
        LOWPASS.found(_or_nan(None if lowpass is None else lowpass.frequency), low),
        HIGHPASS.found(_or_nan(filters.highpass), high),
        MAINS_FILTER.found(_or_nan(filters.notch), notch, Severity.FINE),
    ]


def _contradicted(stated: Filter, recording: Recording, peaks: Integers) -> str:
    """Say that the spectrum shows another low-pass than the user states; empty if it does not."""
    seen = estimated_lowpass(recording.signal, recording.sampling_rate, peaks)
    if seen is None:
        return ""
    apart = abs(math.log(seen.frequency / stated.frequency)) > math.log(AS_STATED)
    if not apart and seen.shape < STEEPER * stated.shape:
        return ""
    return (
        f"the spectrum shows a low-pass at {seen.frequency:.3g} Hz of order {seen.shape:.2g}, not "
        f"one at {stated.frequency:.3g} Hz of order {stated.shape:.2g}, as --recorder-lowpass is "
        "taken: it rings, and the QRS is marked too wide unless that option is left out"
    )


def _recorder_lowpass(filters: Sequence[Filter]) -> Filter | None:
    """The low-pass that is not this program's."""
    for one in filters:
        if one.kind is FilterKind.LOW_PASS and one.origin is not FilterOrigin.APPLIED:
            return one
    return None


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def check_resolution(recording: Recording) -> list[CheckResult]:
    """Find leads that were stored too coarsely.

    The figure is the largest step between two neighbouring values of a lead (uV).
    """
    steps = {lead: _step_of(values) for lead, values in measured(recording).items()}
    message = (
        "steps of up to {largest:.0f} uV between the values of {leads}; export the recording with "
        "all its digits"
    )
    return [STEP.worst_lead(steps, message, UV_PER_MV)]


def _step_of(values: Floats) -> float:
    """Smallest difference between distinct (n,) values (mV); 0 where all are the same."""
    gaps = np.diff(np.unique(values[:: max(len(values) // ENOUGH, 1)]))
    gaps = gaps[gaps > ROUNDING]
    return float(gaps.min()) if gaps.size else 0.0


def check_clipping(recording: Recording) -> list[CheckResult]:
    """Find leads that stay at their highest or lowest value where they were still rising.

    The figure is the largest share of a lead's samples that lie at such a rail.
    """
    long = LONG_RUN * recording.sampling_rate
    shares = {lead: _share_at_rails(values, long) for lead, values in measured(recording).items()}
    message = (
        "peaks of {leads} are cut off ({largest:.2%} of the samples at the rails): the amplifier's "
        "or the file's range was too small; leave out what is cut in the QRS"
    )
    return [CLIPPED.worst_lead(shares, message)]


def _share_at_rails(values: Floats, long: float) -> float:
    """Share of the samples in runs at the lowest or highest value with a steep end."""
    if np.ptp(values) == 0:
        return 0.0
    step = STEEPEST_ROUND * _step_of(values)
    count = 0
    for rail in (values.min(), values.max()):
        lengths = [
            stop - start
            for start, stop in _runs(values == rail)
            if _steepness(values, start, stop) >= step
        ]
        if len(lengths) >= FEWEST_RUNS or max(lengths, default=0) >= long:
            count += sum(lengths)
    return count / len(values)


def _runs(at_rail: Booleans) -> list[tuple[int, int]]:
    """Start and stop of each run of at least `SHORTEST_RUN` samples."""
    edges = np.diff(np.concatenate([[0], at_rail.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    long = stops - starts >= SHORTEST_RUN
    return list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))


def _steepness(values: Floats, start: int, stop: int) -> float:
    """Larger of the differences between a run and the samples beside it (mV)."""
    before = abs(values[start] - values[start - 1]) if start > 0 else 0.0
    after = abs(values[stop] - values[stop - 1]) if stop < len(values) else 0.0
    return float(max(before, after))
