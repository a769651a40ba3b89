"""Why limb leads do not obey Einthoven's and Goldberger's laws."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS
from fascicle.recording.quality.finding import Severity, leave_out
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


def explain(
    recording: Recording, rows: list[int], leads: Floats, zeros: Floats
) -> tuple[Severity, str]:
    """Find the simplest change of the leads that makes their relations hold.

    Tried in this order: the digits of the file without its gains; one lead upside down or two
    exchanged; one lead with another gain, or wrong altogether; each lead with a gain of its own.
    Exchanged electrodes are not among them: they leave every relation intact.

    Parameters
    ----------
    recording : Recording
        Where the leads come from, with the gains of its file.
    rows : list of int
        Which limb leads, in the order of `LIMB_LEADS`.
    leads : (m, n) array
        Their potential (mV), without baseline.
    zeros : (m - 2, m) array
        Relations of which at least one is broken.

    Returns
    -------
    Severity
        FATAL when there is an explanation, WARNING when there is none.
    str
        The explanation and what to do.
    """
    leads = _thinned(leads)
    gains = recording.digits_per_millivolt
    if gains is not None and digits_fit(leads, zeros, gains[rows]):
        return Severity.FATAL, SHARED_GAIN
    names = [LIMB_LEADS[row] for row in rows]
    mistakes = _mistakes(names, leads, zeros)
    if mistakes:
        return Severity.FATAL, ", or ".join(mistakes)
    single = _single_lead(names, leads, zeros)
    if single is not None:
        lead, what = single
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


def misfits(leads: Floats, zeros: Floats) -> Floats:
    """How far each relation is from zero.

    Parameters
    ----------
    leads : (m, n) array
        Potential (mV).
    zeros : (k, m) array
        Coefficients: ``zeros @ leads`` should be constant.

    Returns
    -------
    (k,) array
        99th percentile of the absolute value less its median (mV).
    """
    rest = zeros @ _thinned(leads)
    rest = np.abs(rest - np.median(rest, axis=1, keepdims=True))
    return np.asarray(np.percentile(rest, PERCENTILE, axis=1))


def height(leads: Floats) -> float:
    """99th percentile of the largest absolute value among leads (m, n), each less its median."""
    leads = _thinned(leads)
    centred = np.abs(leads - np.median(leads, axis=1, keepdims=True))
    return float(np.percentile(centred.max(axis=0), PERCENTILE))


def limit_of(leads: Floats) -> float:
    """Misfit (mV) up to which a relation between leads (m, n) holds."""
    return max(LARGEST_MISFIT, LARGEST_SHARE * height(leads))


def _thinned(leads: Floats) -> Floats:
    """Evenly spread samples of leads (m, n), which serve as relations hold at each sample."""
    return leads[:, :: max(leads.shape[1] // ENOUGH, 1)]


def _holds(before: float, leads: Floats, zeros: Floats) -> bool:
    """Whether all relations hold now, and better than before (worst misfit in mV)."""
    return float(misfits(leads, zeros).max()) <= min(limit_of(leads), REMAINING * before)


def digits_fit(leads: Floats, zeros: Floats, gains: Floats) -> bool:
    """Whether leads times their different gains satisfy the relations.

    Parameters
    ----------
    leads : (m, n) array
        Potential (mV).
    zeros : (k, m) array
        Relations, see `misfits`.
    gains : (m,) array
        Digits per mV.
    """
    if not (gains > 0).all() or gains.max() <= (1 + SAME_GAIN) * gains.min():
        return False
    digits = gains[:, None] * leads
    largest = max(LARGEST_MISFIT_OF_DIGITS, LARGEST_SHARE_OF_DIGITS * height(digits))
    return bool(misfits(digits, zeros).max() <= largest)


def _mistakes(names: list[str], leads: Floats, zeros: Floats) -> list[str]:
    """Inversions of one lead and exchanges of two that make the relations hold."""
    before = float(misfits(leads, zeros).max())
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


def _single_lead(names: list[str], leads: Floats, zeros: Floats) -> tuple[str, str] | None:
    """Find the one lead at fault and say how, or None when it is not one or not clear which."""
    before = float(misfits(leads, zeros).max())
    remaining = np.array([_without(k, leads, zeros) for k in range(len(names))])
    order = np.argsort(remaining)
    best, next_best = int(order[0]), int(order[1])
    largest = min(limit_of(np.delete(leads, best, axis=0)), REMAINING * before)
    if remaining[best] > min(largest, DISTINCT * remaining[next_best]):
        return None
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
        return float(misfits(leads, np.delete(free, pivot, axis=0)).max())
    changed = leads.copy()
    changed[k] *= _gain(k, leads, zeros)
    return float(misfits(changed, zeros).max())


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
    before = float(misfits(leads, zeros).max())
    return 1 / factors if _holds(before, factors[:, None] * leads, zeros) else None
