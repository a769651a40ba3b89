"""Einthoven's and Goldberger's laws in the limb leads; if they are broken, why: lead reversal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter1d

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import CHEST_LEADS, LEADS, LIMB_LEADS, lead_matrix, limb_leads_from
from fascicle.recording.filters import coarse
from fascicle.recording.lead_groups import cut, stretches
from fascicle.recording.quality import Check, CheckResult, Severity, leave_out
from fascicle.recording.recording import Recording

REMAINING = 0.5  # share of a misfit that an explanation may leave, also of what the next one leaves


def check_identities(recording: Recording) -> list[CheckResult]:
    """Compare the limb leads that were recorded with one another.

    The figure of an identity is the 99th percentile of the sum that should be zero, after removal
    of each lead's baseline and of all above about 37 Hz; it is fine up to 0.05 mV or 5 % of the
    limb leads' height. The first broken identity carries the explanation. Leads that were
    recorded one group after another are compared where they overlap.
    W. Einthoven, G. Fahr, A. de Waart, Pflügers Arch. 150:275 (1913); E. Goldberger, Am. Heart J.
    23:483 (1942).
    """
    measured = [row for row, lead in enumerate(LIMB_LEADS) if lead in recording.measured_leads]
    results: list[CheckResult] = []
    for first, stop in stretches(recording):
        rows = [row for row in measured if np.isfinite(recording.signal[row, first:stop]).all()]
        if len(rows) >= 3 and stop - first >= recording.sampling_rate:  # 1 s
            results += _check_group(recording, rows, slice(first, stop))
    if not results:
        message = "not checked: no three limb leads were recorded at the same time"
        results = [Check("limb leads", "mV", 0.05).result(np.nan, message, Severity.FINE)]
    return results


def _check_group(recording: Recording, rows: list[int], time: slice) -> list[CheckResult]:
    """Check the identities of limb leads, and whether wrong gains per lead break them.

    Gains are wrong where the digits obey the identities, also where leads are small.
    """
    leads = _detrended(recording.signal[rows, time], recording.sampling_rate)
    leads = leads[:, :: max(leads.shape[1] // 30_000, 1)]  # relations hold at each sample
    labels, zeros = _identities(rows)
    misfits, limit = _misfits(leads, zeros), _limit_of(leads)
    values = zip(labels, misfits.tolist(), strict=True)
    results = [Check(label, "mV", limit).result(value) for label, value in values]
    gains, gain_results, wrong_gains = recording.digits_per_millivolt, [], ""
    if gains is not None and (gains[rows] > 0).all():
        check = Check("gains of limb leads, ratio", "", 1.01)  # up to which gains count as equal
        ratio = float(gains[rows].max() / gains[rows].min())
        digits = gains[rows][:, None] * leads
        misfit, misfit_of_digits = misfits.max(), _misfits(digits, zeros).max()
        height, message = max(_height(digits), 1.0), ""
        if (
            ratio > check.limit
            and misfit_of_digits <= max(3.0, 0.01 * height)  # no more than rounding causes
            and misfit * height > 3.0 * misfit_of_digits * _height(leads)
        ):
            wrong_gains = (
                "its gains per lead are wrong, the raw digits satisfy the identities; read it with "
                "--shared-gain"
            )
            message = f"the gains differ {ratio:.2f}-fold: {wrong_gains}"
        gain_results = [check.result(ratio, message, Severity.FATAL)]
    broken = np.flatnonzero(misfits > limit)
    if not broken.size:
        return [*gain_results, *results]
    severity, reason = Severity.FATAL, wrong_gains
    if not wrong_gains:
        severity, reason = _explain(recording, rows, leads, zeros)
    for k in broken:
        results[k] = replace(results[k], severity=severity)
    first = int(broken[0])  # one fault breaks several identities, and is explained once
    fault = f"{labels[first].split(' ', 1)[1]} is off by {misfits[first]:.2f} mV"
    results[first] = replace(results[first], message=f"{fault}: {reason}")
    return results


def _detrended(leads: Floats, rate: float) -> Floats:
    """Leads (m, n), mV, without baseline and with less noise, about 0.6 to 37 Hz.

    Moving averages are linear: relations between leads still hold.
    """
    leads, rate = coarse(leads, rate)
    width = max(round(0.5 * rate), 1)  # s
    baseline = uniform_filter1d(leads, width, axis=-1, mode="nearest")
    baseline = uniform_filter1d(baseline, width, axis=-1, mode="nearest")
    width = max(round(0.012 * rate), 1)
    return np.asarray(uniform_filter1d(leads - baseline, width, axis=-1, mode="nearest"))


def _identities(rows: list[int]) -> tuple[list[str], Floats]:
    """Labels and coefficients of the independent identities of some limb leads."""
    classic = {  # sums of limb leads that are zero: coefficients in the order of LIMB_LEADS
        "Einthoven I + III - II": (1.0, -1.0, 1.0, 0.0, 0.0, 0.0),
        "Goldberger aVR + (I + II)/2": (0.5, 0.5, 0.0, 1.0, 0.0, 0.0),
        "Goldberger aVL - (I - III)/2": (-0.5, 0.0, 0.5, 0.0, 1.0, 0.0),
        "Goldberger aVF - (II + III)/2": (0.0, -0.5, -0.5, 0.0, 0.0, 1.0),
    }
    zeros = np.array(list(classic.values()))
    complete = ~np.delete(zeros, rows, axis=1).any(axis=1)
    if complete.sum() == len(rows) - 2:
        usable = np.flatnonzero(complete)
        return [[*classic][k] for k in usable], zeros[usable][:, rows]
    names = [LIMB_LEADS[row] for row in rows]
    from_two = limb_leads_from(names)
    assert from_two is not None  # there are at least three
    labels = [f"identity {name} from {names[0]} and {names[1]}" for name in names[2:]]
    return labels, (np.eye(len(LIMB_LEADS)) - from_two)[rows[2:]][:, rows]


def _explain(
    recording: Recording, rows: list[int], leads: Floats, zeros: Floats
) -> tuple[Severity, str]:
    """Find the simplest change of the leads (m, n) that makes their relations (m - 2, m) hold.

    The changes are, in order: one lead inverted, or two exchanged; one lead with another gain, or
    wrong altogether. Reversed electrodes leave every relation intact. FATAL with an explanation, or
    where the relations are off by a third of the leads' height, WARNING else.
    """
    names, before = [LIMB_LEADS[row] for row in rows], float(_misfits(leads, zeros).max())

    def holds(changed: Floats) -> bool:
        return float(_misfits(changed, zeros).max()) <= min(_limit_of(changed), REMAINING * before)

    identity = np.eye(len(rows))
    changes = {}
    for k, name in enumerate(names):
        mistake = f"lead {name} is upside down, give --invert {name}"
        changes[mistake] = identity * np.where(identity[k], -1.0, 1.0)
    for i, j in combinations(range(len(rows)), 2):
        mistake = (
            f"leads {names[i]} and {names[j]} are exchanged, give --swap {names[i]}-{names[j]}"
        )
        changes[mistake] = identity[[{i: j, j: i}.get(k, k) for k in range(len(rows))]]
    mistakes = [mistake for mistake, change in changes.items() if holds(change @ leads)]
    if mistakes:
        return Severity.FATAL, ", or ".join(mistakes)
    remaining = np.array([_without(k, leads, zeros) for k in range(len(rows))])
    best, next_best = np.argsort(remaining)[:2]
    limit = _limit_of(np.delete(leads, best, axis=0))
    if remaining[best] <= min(limit, REMAINING * before, REMAINING * remaining[next_best]):
        gain = _gain(int(best), leads, zeros)
        fault = "does not follow from the other limb leads"
        if holds(np.where(identity[best][:, None], gain, 1.0) * leads):
            fault = f"is {1 / gain:.2f} times what the other limb leads say"
        advice = "leave it out, it is then computed from the others:"
        advice = f"{advice} {leave_out(recording, [names[best]])}"
        return Severity.FATAL, f"lead {names[best]} {fault}; {advice}"
    # more than noise, delays and different filters do; leads may have gains of their own
    severity = Severity.FATAL if before > _height(leads) / 3 else Severity.WARNING
    return severity, (
        "no single lead, gain or exchange explains it; export the limb leads again, in mV with one "
        f"gain, or go on with two of them: --leads {','.join([*names[:2], *CHEST_LEADS])}"
    )


def _misfits(leads: Floats, zeros: Floats) -> Floats:
    """Deviation (mV) of each relation ``zeros @ leads`` from constant, 99th percentile, (k,)."""
    residual = zeros @ leads
    residual = np.abs(residual - np.median(residual, axis=1, keepdims=True))
    return np.asarray(np.percentile(residual, 99.0, axis=1))


def _height(leads: Floats) -> float:
    """99th percentile of the largest absolute value among leads (m, n), each less its median."""
    centred = np.abs(leads - np.median(leads, axis=1, keepdims=True))
    return float(np.percentile(centred.max(axis=0), 99.0))


def _limit_of(leads: Floats) -> float:
    """Misfit (mV) up to which a relation between leads (m, n) holds."""
    return max(0.05, 0.05 * _height(leads))


def _without(k: int, leads: Floats, zeros: Floats) -> float:
    """Worst misfit (mV) when lead k is left out or, where too few remain, has the best gain."""
    if len(leads) > 3:
        pivot = int(np.argmax(np.abs(zeros[:, k])))  # of the relations in which the lead occurs
        free = zeros - np.outer(zeros[:, k] / zeros[pivot, k], zeros[pivot])
        return float(_misfits(leads, np.delete(free, pivot, axis=0)).max())
    changed = leads.copy()
    changed[k] *= _gain(k, leads, zeros)
    return float(_misfits(changed, zeros).max())


def _gain(k: int, leads: Floats, zeros: Floats) -> float:
    """Factor for lead k that makes the relations hold best, by least squares."""
    part = zeros[:, k, None] * leads[k]
    other_terms = zeros @ leads - part
    return float(-(part * other_terms).sum() / max((part * part).sum(), np.finfo(float).tiny))


def check_reversal(recording: Recording, peaks: Integers, paced: bool = False) -> CheckResult:
    """Check whether the electrode of the right arm is exchanged with another limb's.

    Leads I and II look to the left and down, as V6 (or V5) does. Reversed arms turn lead I upside
    down, and reversed right arm and left leg lead II. The figure is the lower mean of the
    correlations of I or II with V6 in P wave and QRS, so that a QRS axis to the right alone does
    not count; a rhythm that is `paced` or has no P wave is not judged. Reversed left arm and left
    leg look like a turned axis. The `peaks` (n_beats,) are samples of the R peaks.

    V. N. Batchvarov, M. Malik, A. J. Camm, Europace 9:1081 (2007); K. K. Ho, S. K. Ho, J.
    Electrocardiol. 34:161 (2001), on the P wave.
    """
    check = Check("lead reversal, I and II against V6", "", -0.4)
    rate = recording.sampling_rate
    median = _median_beat(recording, peaks)
    rows = [LEADS.index(lead) for lead in ("V6", "V5")]
    lateral = [row for row in rows if np.isfinite(median[row]).all()]
    if not lateral or not np.isfinite(median[:2]).all():
        message = "not checked: needs leads I, II and V6 or V5, and two beats"
        return check.result(np.nan, message, Severity.FINE)
    heights = np.ptp([*median[:2], median[1] - median[0]], axis=1)  # mV, of I, II and III
    flattest = int(np.argmin(heights))
    # with the right leg in place of an arm, the other two legs' lead shows nothing
    if flattest and heights[flattest] < min(0.1, 0.1 * heights.max()):
        arm = ("RA", "LA")[flattest - 1]
        message = (
            f"lead {LEADS[flattest]} is flat ({heights[flattest]:.2f} mV): {arm} and RL are "
            "probably exchanged, which cannot be undone; record again"
        )
        return check.result(-1.0, message)
    reference = median[lateral[0]]
    waves = (-0.26, -0.10), (-0.06, 0.08)  # s from R: P wave and QRS
    p_wave = np.ptp(_wave(median[:2], waves[0], rate), axis=1).max()
    if paced or p_wave < 0.05:  # mV; half a mm on paper
        why = "the rhythm is paced" if paced else "leads I and II show no P wave"
        return check.result(np.nan, f"not checked: {why}", Severity.FINE)
    correlations = _likeness(median[:2], reference, waves, rate)
    if min(correlations) >= check.limit:
        return check.result(min(correlations))
    limb = lead_matrix()[:2, :3]
    from_potentials = np.linalg.pinv(limb)
    after = {
        pair: sum(_likeness(limb[:, order] @ from_potentials @ median[:2], reference, waves, rate))
        for pair, order in {"RA-LA": [1, 0, 2], "RA-LL": [2, 1, 0]}.items()
    }
    pair = max(after, key=after.__getitem__)
    message = (
        f"lead {'I' if correlations[0] < correlations[1] else 'II'} runs against "
        f"{LEADS[lateral[0]]} in P wave and QRS: electrodes {pair.replace('-', ' and ')} are "
        "probably reversed (or the heart lies on the right, or the rhythm is not from the sinus "
        f"node); to undo it: --swap {pair}"
    )
    return check.result(min(correlations), message)


def _median_beat(recording: Recording, peaks: Integers) -> Floats:
    """Median (12, n), mV, over two or more beats of each lead, 0.26 s before R to 0.10 s after.

    Leads recorded at other times have beats of their own; NaN where these are fewer than two.
    """
    before, after = (round(s * recording.sampling_rate) for s in (0.26, 0.10))
    median = np.full((len(LEADS), before + after + 1), np.nan)
    for row, (start, stop) in enumerate(recording.spans):
        covered = peaks[(peaks - before >= start) & (peaks + after < stop)]
        covered = covered[:: max(len(covered) // 100, 1)]
        if len(covered) >= 2:
            median[row] = np.median(cut(recording.signal[[row]], covered, before, after), axis=0)
    return median


def _likeness(
    leads: Floats, reference: Floats, waves: Sequence[tuple[float, float]], rate: float
) -> Floats:
    """Mean of the correlations of leads with another, in two `waves` of median beats (n,)."""
    with np.errstate(invalid="ignore"):  # of flat leads
        shapes = (_wave(np.vstack([leads, reference]), wave, rate) for wave in waves)
        correlations = [np.atleast_2d(np.corrcoef(shape))[-1, :-1] for shape in shapes]
    return np.asarray(np.nan_to_num(correlations).mean(axis=0))


def _wave(leads: Floats, wave: tuple[float, float], rate: float) -> Floats:
    """A wave (s from R) of median beats (k, n), less the line between its first and last 10 ms."""
    edge = max(round(0.01 * rate), 1)
    start, stop = (round((0.26 + end) * rate) for end in wave)
    x = leads[:, start : stop + 1]
    ends = x[:, :edge].mean(axis=1), x[:, -edge:].mean(axis=1)
    return np.asarray(x - np.linspace(*ends, x.shape[1], axis=1))
