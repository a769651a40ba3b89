"""Whether all leads show the beats of one heart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import find_peaks
from scipy.spatial.distance import squareform

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS
from fascicle.recording.quality.check_result import Check, CheckResult, Severity, leave_out, listed
from fascicle.recording.quality.lead_signals import coarse, measured, steady
from fascicle.recording.recording import Recording

AGREEMENT = Check("agreement of the leads' beats", "", 0.75)  # 0.5 is chance, 0.9 one heart
JITTER = Check("limb against chest, jitter", "ms", 12.0)  # in one heart it is a few ms
LEAST_CONTRAST = 4.0  # activity of a beat over the usual; leads with less are not judged
FEWEST_BEATS = 3
FEWEST_FOR_STEP = 6  # beats, of which three could not be equally far apart by chance
TOLERANCE = 0.08  # s between the beats of two leads of one heart
CLEARLY_APART = 0.65  # a single lead between this and the limit may only be disturbed
LEAST_SAMENESS = 0.7  # correlation of the beats of one lead; chance gives 0.5
HALF_BEAT, LARGEST_SHIFT = 0.1, 0.024  # s compared each side of a beat, and by which it may move
FEW_BEATS = 15  # that are compared
LONGEST_LAG = 0.12  # s
LEAST_CORRELATION = 0.5  # of two groups' activity about a beat, for their lag to count
MOST_LEFT_OUT = 2  # leads that one can do without
MOST_BEATS = 60  # that give the jitter
QUARTILES = 1.349  # standard deviations that hold half of a normal distribution
MINUTE = 60.0  # s

QRS_WIDTH = 0.06  # s; moving average of the slope
REFRACTORY = 0.3  # s between two beats
STRONG = 0.5  # of the highest activity: a beat
HIGHEST = 99.0  # percentile taken as the highest activity
LARGEST_WEIGHT = 30.0  # times its median that the activity of one lead counts in a group


@dataclass(frozen=True)
class _Activity:
    """How much each lead moves; NaN where a lead is absent, computed, flat or not recorded.

    The `wave` (12, n) is the potential (mV) without baseline; the `speed` (12, n) its mean absolute
    slope over the time that a QRS takes, over its median, so that 1 is usual between beats; the
    `rate` is in samples per second (Hz).
    """

    wave: Floats
    speed: Floats
    rate: float


def check_synchrony(recording: Recording) -> list[CheckResult]:
    """Find leads that beat at other times than the others.

    Two leads agree when one moves more than usual at the beats of the other: the agreement is the
    mean rank (0 to 1, like the area under a ROC curve) of its activity there, the larger of both
    directions. Leads of one heart agree even where a beat is a QRS in one and a pacing spike or a
    T wave in the other. Leads without clear beats of one shape (low, noisy, disturbed) are not
    judged. Leads that agree on average are one group; a lead or two that beat at a steady distance
    from the rest show the T wave more than the QRS, and are fine. As two hearts may beat in step
    for a while, the time between the beats of the limb and the chest leads must also be steady.

    Returns
    -------
    list of CheckResult
        The agreement of each group with the largest one, or of all leads where there is one group
        only; and the jitter (ms) between limb and chest leads.
    """
    moving = _activity(recording)
    clear = _clear_beats(moving)
    agreement = _agreement(moving, clear)
    groups, lowest = _groups(list(clear), agreement)
    findings = [
        _apart(recording, group, groups[0], agreement, moving)
        for group in groups[1:]
        if len(group) > MOST_LEFT_OUT or not _in_step(moving, group, groups[0])
    ]
    if not findings:
        findings = [AGREEMENT.found(lowest)]
    jitter = _jitter(moving)
    message = ""
    if jitter > JITTER.limit and len(groups) < 2:
        rates = " and ".join(f"{_rate(moving, rows):.0f}" for rows in (range(6), range(6, 12)))
        message = (
            f"limb and chest leads do not beat in step ({rates} per minute): two recordings in one "
            "file? Give leads of one recording"
        )
    return [*findings, JITTER.found(jitter, message, Severity.FATAL)]


def _activity(recording: Recording) -> _Activity:
    """How much each lead of a recording moves."""
    empty, rate = coarse(np.zeros(recording.signal.shape[1]), recording.sampling_rate)
    shape = (len(LEADS), len(empty))
    found = _Activity(np.full(shape, np.nan), np.full(shape, np.nan), rate)
    factor, spans = recording.sampling_rate / rate, recording.spans
    for lead, values in measured(recording).items():
        row = LEADS.index(lead)
        x, _ = coarse(values, recording.sampling_rate)
        wave = steady(x, rate)
        slope = np.abs(np.gradient(wave))
        speed = uniform_filter1d(slope, round(QRS_WIDTH * rate), mode="nearest")
        usual = float(np.median(speed))
        if usual > 0:
            start = round(int(spans[row, 0]) / factor)
            stop = min(start + len(speed), len(empty))
            found.speed[row, start:stop] = speed[: stop - start] / usual
            found.wave[row, start:stop] = wave[: stop - start]
    return found


def _clear_beats(moving: _Activity) -> dict[int, Integers]:
    """Leads with clear beats of one shape, and these."""
    found = {row: _beats_of(moving.speed[row], moving.rate) for row in range(len(LEADS))}
    return {
        row: times
        for row, (times, contrast) in found.items()
        if contrast >= LEAST_CONTRAST
        and len(times) >= FEWEST_BEATS
        and _sameness(moving.wave[row], times, moving.rate) >= LEAST_SAMENESS
    }


def _sameness(wave: Floats, times: Integers, rate: float) -> float:
    """Median correlation of one lead's (n,) beats with the one that is most like the others."""
    half, shift = round(HALF_BEAT * rate), round(LARGEST_SHIFT * rate)
    margin = half + shift
    times = times[(times >= margin) & (times + margin < len(wave))]
    times = times[:: max(len(times) // FEW_BEATS, 1)]
    if len(times) < 2:
        return 0.0
    wide = np.nan_to_num(np.stack([wave[time - margin : time + margin + 1] for time in times]))
    tries = _normalised(np.lib.stride_tricks.sliding_window_view(wide, 2 * half + 1, axis=1))
    alike = np.einsum("bsn,cn->cbs", tries, tries[:, shift]).max(axis=2)
    np.fill_diagonal(alike, np.nan)
    return float(np.nanmedian(alike, axis=1).max())


def _agreement(moving: _Activity, clear: dict[int, Integers]) -> Floats:
    """Agreement of each pair of leads (12, 12); NaN where they cannot be compared."""
    ranks = np.full((len(LEADS), len(LEADS)), np.nan)
    speed, width = moving.speed, 2 * round(TOLERANCE * moving.rate) + 1
    for row in clear:
        there = np.isfinite(speed[row])
        near = maximum_filter1d(np.where(there, speed[row], -1.0), width)
        ordered = np.sort(near[there])
        for other, times in clear.items():
            common = times[there[times]]
            if len(common) >= FEWEST_BEATS:
                ranks[row, other] = np.searchsorted(ordered, near[common]).mean() / len(ordered)
    return np.asarray(np.fmax(ranks, ranks.T))


def _groups(rows: list[int], agreement: Floats) -> tuple[list[list[int]], float]:
    """Leads that agree with each other on average, the most first; the lowest such average."""
    if len(rows) < 2:
        return [rows], np.nan
    # leads without time in common do not disagree
    distance = 1 - np.where(np.isfinite(agreement), agreement, 1.0)[np.ix_(rows, rows)]
    np.fill_diagonal(distance, 0.0)
    tree = linkage(squareform(np.maximum(distance, 0.0), checks=False), method="average")
    label = fcluster(tree, 1 - AGREEMENT.limit, criterion="distance")
    groups = [[row for row, own in zip(rows, label, strict=True) if own == k] for k in set(label)]
    return sorted(groups, key=lambda group: (-len(group), group)), 1 - float(tree[-1, 2])


def _apart(
    recording: Recording, group: list[int], largest: list[int], agreement: Floats, moving: _Activity
) -> CheckResult:
    """Finding on a group of leads that beats at other times than the largest one."""
    between = agreement[np.ix_(group, largest)]
    found = float(between[np.isfinite(between)].mean())
    names, others = ([LEADS[row] for row in rows] for rows in (group, largest))
    message = (
        f"the beats of {listed(names)} are not those of {listed(others)} "
        f"({_rate(moving, group):.0f} against {_rate(moving, largest):.0f} per minute): "
    )
    severity = Severity.FATAL
    if len(names) > MOST_LEFT_OUT:
        message += "two recordings in one file? Give leads of one recording"
        if _in_step(moving, group, largest):
            severity = Severity.WARNING
    else:
        message += (
            "of another recording, or a loose electrode? Go on without: "
            f"{leave_out(recording, names)}"
        )
        severity = Severity.FATAL if found < CLEARLY_APART else Severity.WARNING
    return AGREEMENT.found(found, message, severity)


def _in_step(moving: _Activity, group: list[int], largest: list[int]) -> bool:
    """Whether two groups beat at a steady distance, as T waves do from QRS."""
    own, theirs = (_beats(moving, rows)[0] for rows in (group, largest))
    if min(len(own), len(theirs)) < FEWEST_FOR_STEP:
        return False
    distance = own[:, None] - theirs
    nearest = distance[np.arange(len(own)), np.argmin(np.abs(distance), axis=1)]
    return _spread(1e3 * nearest / moving.rate) <= JITTER.limit


def _spread(lags: Floats) -> float:
    """Standard deviation of the closest half of (n,) lags: every other beat may be ectopic."""
    ordered, half = np.sort(lags), (len(lags) + 1) // 2
    return float((ordered[half - 1 :] - ordered[: len(lags) - half + 1]).min()) / QUARTILES


def _beats(moving: _Activity, rows: Iterable[int]) -> tuple[Integers, float]:
    return _beats_of(_mean_activity(moving.speed[list(rows)]), moving.rate)


def _rate(moving: _Activity, rows: Iterable[int]) -> float:
    """Beats per minute of some leads together."""
    times, _ = _beats(moving, rows)
    return MINUTE * moving.rate / float(np.median(np.diff(times))) if len(times) > 1 else np.nan


def _jitter(moving: _Activity) -> float:
    """Spread (ms) of the time from limb to chest beats; NaN where unclear."""
    limb, chest = _mean_activity(moving.speed[:6]), _mean_activity(moving.speed[6:])
    there = np.isfinite(limb) & np.isfinite(chest)
    lags = _lags(limb[there], chest[there], moving.rate)
    return np.nan if lags is None else _spread(lags)


def _lags(limb: Floats, chest: Floats, rate: float) -> Floats | None:
    """Time (ms) from each beat of one activity (n,) to the other's, by their correlation."""
    times, contrast = _beats_of(limb, rate)
    _, contrast_of_chest = _beats_of(chest, rate)
    reach = round(LONGEST_LAG * rate)
    times = times[(times >= 2 * reach) & (times + 2 * reach < len(limb))]
    times = times[:: max(len(times) // MOST_BEATS, 1)]
    if len(times) < FEWEST_BEATS + 1 or min(contrast, contrast_of_chest) < LEAST_CONTRAST:
        return None
    lags = []
    for time in times:
        own = _normalised(limb[time - reach : time + reach])
        near = chest[time - 2 * reach : time + 2 * reach]
        tries = np.lib.stride_tricks.sliding_window_view(near, 2 * reach)
        correlation = _normalised(tries) @ own
        best = int(np.argmax(correlation))
        if correlation[best] > LEAST_CORRELATION:
            lags.append(1e3 * (best - reach) / rate)
    return np.array(lags) if len(lags) > len(times) / 2 else None


def _mean_activity(speed: Floats) -> Floats:
    """Mean over leads of their activity (m, n), NaN where none is recorded."""
    there = np.isfinite(speed)
    total = np.where(there, np.minimum(speed, LARGEST_WEIGHT), 0.0).sum(axis=0)
    return np.where(there.any(axis=0), total / np.maximum(there.sum(axis=0), 1), np.nan)


def _beats_of(speed: Floats, rate: float) -> tuple[Integers, float]:
    """Samples at which one activity (n,) is strong, and how far above the usual it is there."""
    there = speed[np.isfinite(speed)]
    if not there.size:
        return np.zeros(0, dtype=np.int64), 0.0
    filled = np.where(np.isfinite(speed), speed, 0.0)
    strong = STRONG * float(np.percentile(there, HIGHEST))
    found, _ = find_peaks(filled, height=strong, distance=max(round(REFRACTORY * rate), 1))
    if not len(found):
        return np.zeros(0, dtype=np.int64), 0.0
    return np.asarray(found, dtype=np.int64), float(np.median(speed[found]) / np.median(there))


def _normalised(x: Floats) -> Floats:
    """Rows of mean zero and length one."""
    centred = x - x.mean(axis=-1, keepdims=True)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    return np.asarray(centred / np.maximum(length, np.finfo(float).tiny))
