"""Whether the limb leads obey Einthoven's and Goldberger's laws, and if not, why."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from operator import itemgetter

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS, limb_leads_from
from fascicle.recording.quality.check_result import Check, CheckResult, Severity, leave_out
from fascicle.recording.quality.lead_signals import coarse, steady
from fascicle.recording.recording import Recording

LARGEST_MISFIT = 0.05  # mV
LARGEST_SHARE = 0.05  # of the limb leads' height
PERCENTILE = 99.0
ENOUGH = 30_000  # samples that give the percentile
LARGEST_MISFIT_OF_DIGITS = 3.0  # digits; each lead was rounded
LARGEST_SHARE_OF_DIGITS = 0.01  # of the limb leads' height
SAME_GAIN = 0.01  # relative difference up to which gains are one
REMAINING = 0.5  # of the misfit; an explanation leaves less
DISTINCT = 0.5  # an explanation leaves less than this share of what the next one leaves
SHARED_GAIN = (
    "its gains per lead are wrong, the raw digits satisfy the identities; "
    "read it with --shared-gain"
)
LARGEST_RATIO = 1.2  # between gains of leads that may still be in mV
LIMB_LEADS_CHECK = Check("limb leads", "mV", LARGEST_MISFIT)
GAINS = Check("gains of limb leads, ratio", "", 1 + SAME_GAIN)
SHORTEST_OVERLAP = 1.0  # s; one beat at least
CLEARLY_WORSE = 3.0  # how many times the misfit in mV must exceed that in digits to blame the gains
SAME_TIME = 0.9  # share of a lead's time that another must cover to be compared with it

# Einthoven, 1913; Goldberger, 1942: what is zero, lead by lead in the order of LIMB_LEADS.
_CLASSIC = {
    "Einthoven I + III - II": (1.0, -1.0, 1.0, 0.0, 0.0, 0.0),
    "Goldberger aVR + (I + II)/2": (0.5, 0.5, 0.0, 1.0, 0.0, 0.0),
    "Goldberger aVL - (I - III)/2": (-0.5, 0.0, 0.5, 0.0, 1.0, 0.0),
    "Goldberger aVF - (II + III)/2": (0.0, -0.5, -0.5, 0.0, 0.0, 1.0),
}


def check_identities(recording: Recording) -> list[CheckResult]:
    r"""Compare the limb leads that were recorded with what the others among them say.

    The figure of an identity is the 99th percentile of \|what should be zero\| less its median,
    after the baseline and what is faster than about 37 Hz have been taken off each lead, so that
    neither drift nor noise of single leads counts. It is fine up to `LARGEST_MISFIT` mV, or up to
    `LARGEST_SHARE` of the limb leads' height where that is more. Computed leads satisfy the
    identities by construction and do not count; leads that were recorded one group after another
    are compared where they overlap.

    Returns
    -------
    list of CheckResult
        One for each independent identity; the first broken one carries the explanation. A single
        one, NaN, where no three limb leads were recorded at the same time.

    References
    ----------
    W. Einthoven, G. Fahr, A. de Waart, Pflügers Arch. 150:275 (1913); E. Goldberger, Am. Heart J.
    23:483 (1942).
    """
    together = _together(recording)
    if not together:
        message = "not checked: no three limb leads were recorded at the same time"
        return [LIMB_LEADS_CHECK.found(np.nan, message, Severity.FINE)]
    return [finding for rows, time in together for finding in _check_group(recording, rows, time)]


def _together(recording: Recording) -> list[tuple[list[int], slice]]:
    """Sets of at least three limb leads, and the samples that they have in common."""
    spans = recording.spans.tolist()
    rows = [row for row, lead in enumerate(LIMB_LEADS) if lead in recording.measured_leads]
    found = {}
    for start, stop in {tuple(spans[row]) for row in rows}:
        covering = tuple(
            row
            for row in rows
            if min(spans[row][1], stop) - max(spans[row][0], start) >= SAME_TIME * (stop - start)
        )
        begin = max([start, *(spans[row][0] for row in covering)])
        end = min([stop, *(spans[row][1] for row in covering)])
        if len(covering) >= 3 and end - begin >= SHORTEST_OVERLAP * recording.sampling_rate:
            found[covering] = slice(begin, end)
    return [(list(covering), time) for covering, time in sorted(found.items(), key=itemgetter(0))]


def _check_group(recording: Recording, rows: list[int], time: slice) -> list[CheckResult]:
    """Check one set of leads over the samples that they have in common."""
    part, rate = coarse(recording.signal[rows, time], recording.sampling_rate)
    leads = steady(part, rate)
    labels, zeros = _identities(rows)
    found, limit = _misfits(leads, zeros), _limit_of(leads)
    broken = np.flatnonzero(found > limit)
    findings = [
        Check(label, "mV", limit).found(float(value))
        for label, value in zip(labels, found, strict=True)
    ]
    if not broken.size:
        return [*_check_gains(recording, rows, leads, zeros), *findings]
    severity, reason = _explain(recording, rows, leads, zeros)
    for k in broken:
        findings[k] = replace(findings[k], severity=severity)
    first = int(broken[0])  # one fault breaks several identities, and is explained once
    what = f"{labels[first].split(' ', 1)[1]} is off by {found[first]:.2f} mV"
    findings[first] = replace(findings[first], message=f"{what}: {reason}")
    return findings


def _check_gains(
    recording: Recording, rows: list[int], leads: Floats, zeros: Floats
) -> list[CheckResult]:
    """Find gains per lead that break identities by little, where digits do not break them at all.

    Small limb leads hide gains that are several times too high or low in the chest leads.
    """
    gains = recording.digits_per_millivolt
    if gains is None or not (gains[rows] > 0).all():
        return []
    ratio = float(gains[rows].max() / gains[rows].min())
    digits = gains[rows][:, None] * leads
    share = _worst(leads, zeros) / max(_height(leads), np.finfo(float).tiny)
    share_of_digits = _worst(digits, zeros) / max(_height(digits), 1.0)
    wrong = _digits_fit(leads, zeros, gains[rows]) and share > CLEARLY_WORSE * share_of_digits
    message = f"the gains differ {ratio:.2f}-fold: {SHARED_GAIN}" if wrong else ""
    return [GAINS.found(ratio, message, Severity.FATAL)]


def _identities(rows: list[int]) -> tuple[list[str], Floats]:
    """Labels and coefficients of the independent identities of some limb leads."""
    absent = [row for row in range(len(LIMB_LEADS)) if row not in rows]
    classic = {
        label: np.array(zero)
        for label, zero in _CLASSIC.items()
        if not np.array(zero)[absent].any()
    }
    if len(classic) == len(rows) - 2:
        return list(classic), np.array(list(classic.values()))[:, rows]
    names = [LIMB_LEADS[row] for row in rows]
    from_two = limb_leads_from(names)
    assert from_two is not None  # there are at least three
    labels = [f"identity {name} from {names[0]} and {names[1]}" for name in names[2:]]
    return labels, (np.eye(len(LIMB_LEADS)) - from_two)[rows[2:]][:, rows]


def _explain(
    recording: Recording, rows: list[int], leads: Floats, zeros: Floats
) -> tuple[Severity, str]:
    """Find the simplest change of the leads that makes their relations hold.

    Tried in this order: the digits of the file without its gains; one lead upside down or two
    exchanged; one lead with another gain, or wrong altogether; each lead with a gain of its own.
    Exchanged electrodes are not among them: they leave every relation intact.

    Of leads (m, n) without baseline (mV), `rows` of the limb leads, whose relations `zeros`
    (m - 2, m) are not all zero. FATAL when there is an explanation, WARNING when there is none.
    """
    leads = _thinned(leads)
    gains = recording.digits_per_millivolt
    if gains is not None and _digits_fit(leads, zeros, gains[rows]):
        return Severity.FATAL, SHARED_GAIN
    names = [LIMB_LEADS[row] for row in rows]
    mistakes = _mistakes(names, leads, zeros)
    if mistakes:
        return Severity.FATAL, ", or ".join(mistakes)
    lead, what = _single_lead(names, leads, zeros)
    if lead:
        return Severity.FATAL, (
            f"lead {lead} {what}; leave it out, it is then computed from the others: "
            f"{leave_out(recording, [lead])}"
        )
    ratios = _gains(leads, zeros)
    if ratios is not None and ratios.max() > LARGEST_RATIO * ratios.min():
        found = ", ".join(f"{n} {g:.2f}" for n, g in zip(names, ratios / ratios[0], strict=True))
        return Severity.FATAL, (
            f"each lead has a gain of its own ({found}); export the recording in mV, with one gain "
            "for all leads"
        )
    return Severity.WARNING, (
        "no single lead, gain or exchange explains it; check how the limb leads were exported"
    )


def _misfits(leads: Floats, zeros: Floats) -> Floats:
    """How far (mV) each relation ``zeros @ leads`` of leads (m, n) is from constant, shape (k,).

    The 99th percentile of the absolute value less its median.
    """
    rest = zeros @ _thinned(leads)
    rest = np.abs(rest - np.median(rest, axis=1, keepdims=True))
    return np.asarray(np.percentile(rest, PERCENTILE, axis=1))


def _height(leads: Floats) -> float:
    """99th percentile of the largest absolute value among leads (m, n), each less its median."""
    leads = _thinned(leads)
    centred = np.abs(leads - np.median(leads, axis=1, keepdims=True))
    return float(np.percentile(centred.max(axis=0), PERCENTILE))


def _limit_of(leads: Floats) -> float:
    """Misfit (mV) up to which a relation between leads (m, n) holds."""
    return max(LARGEST_MISFIT, LARGEST_SHARE * _height(leads))


def _thinned(leads: Floats) -> Floats:
    """Evenly spread samples of leads (m, n), which serve as relations hold at each sample."""
    return leads[:, :: max(leads.shape[1] // ENOUGH, 1)]


def _worst(leads: Floats, zeros: Floats) -> float:
    """Largest misfit (mV)."""
    return float(_misfits(leads, zeros).max())


def _holds(before: float, leads: Floats, zeros: Floats) -> bool:
    """Whether all relations hold now, and better than before (worst misfit in mV)."""
    return _worst(leads, zeros) <= min(_limit_of(leads), REMAINING * before)


def _digits_fit(leads: Floats, zeros: Floats, gains: Floats) -> bool:
    """Whether leads (m, n), mV, times their different gains (m,) satisfy the relations (k, m)."""
    if not (gains > 0).all() or gains.max() <= (1 + SAME_GAIN) * gains.min():
        return False
    digits = gains[:, None] * leads
    largest = max(LARGEST_MISFIT_OF_DIGITS, LARGEST_SHARE_OF_DIGITS * _height(digits))
    return _worst(digits, zeros) <= largest


def _mistakes(names: list[str], leads: Floats, zeros: Floats) -> list[str]:
    """Inversions of one lead and exchanges of two that make the relations hold."""
    before = _worst(leads, zeros)
    found = []
    for k, name in enumerate(names):
        changed = leads.copy()
        changed[k] *= -1
        if _holds(before, changed, zeros):
            found.append(f"lead {name} is upside down, give --invert {name}")
    for i, j in combinations(range(len(names)), 2):
        changed = leads.copy()
        changed[[i, j]] = leads[[j, i]]
        if _holds(before, changed, zeros):
            pair = f"{names[i]} and {names[j]}"
            found.append(f"leads {pair} are exchanged, give --swap {names[i]}-{names[j]}")
    return found


def _single_lead(names: list[str], leads: Floats, zeros: Floats) -> tuple[str, str]:
    """Name of the lead at fault, empty when it is not one or not clear which, and its fault."""
    before = _worst(leads, zeros)
    remaining = np.array([_without(k, leads, zeros) for k in range(len(names))])
    order = np.argsort(remaining)
    best, next_best = int(order[0]), int(order[1])
    largest = min(_limit_of(np.delete(leads, best, axis=0)), REMAINING * before)
    if remaining[best] > min(largest, DISTINCT * remaining[next_best]):
        return "", ""
    gain = _gain(best, leads, zeros)
    changed = leads.copy()
    changed[best] *= gain
    if _holds(before, changed, zeros):
        return names[best], f"is {1 / gain:.2f} times what the other limb leads say"
    return names[best], "does not follow from the other limb leads"


def _without(k: int, leads: Floats, zeros: Floats) -> float:
    """Worst misfit (mV) when lead k is left out or, where too few remain, has the best gain."""
    if len(leads) > 3:
        # relations in which the lead no longer occurs
        pivot = int(np.argmax(np.abs(zeros[:, k])))
        free = zeros - np.outer(zeros[:, k] / zeros[pivot, k], zeros[pivot])
        return float(_misfits(leads, np.delete(free, pivot, axis=0)).max())
    changed = leads.copy()
    changed[k] *= _gain(k, leads, zeros)
    return _worst(changed, zeros)


def _gain(k: int, leads: Floats, zeros: Floats) -> float:
    """Factor for lead k that makes the relations hold best, by least squares."""
    own = zeros[:, k, None] * leads[k]
    others = zeros @ leads - own
    return float(-(own * others).sum() / max((own * own).sum(), np.finfo(float).tiny))


def _gains(leads: Floats, zeros: Floats) -> Floats | None:
    """How many times too high each lead is, if factors for all of them make the relations hold."""
    size = np.sqrt((leads**2).mean(axis=1))
    if not size.all():
        return None
    unit = leads / size[:, None]
    # the squared misfits as a quadratic form of the factors
    form = (zeros.T @ zeros) * (unit @ unit.T)
    values, vectors = np.linalg.eigh(form)
    factors = vectors[:, 0] / size
    factors = factors if factors.sum() > 0 else -factors
    if factors.min() <= 0 or values[1] * DISTINCT <= values[0]:
        return None
    factors = factors / np.exp(np.log(factors).mean())
    before = _worst(leads, zeros)
    return 1 / factors if _holds(before, factors[:, None] * leads, zeros) else None
