"""Whether the limb leads obey Einthoven's and Goldberger's laws."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS, limb_leads_from
from fascicle.recording.quality.explanation import (
    LARGEST_MISFIT,
    SAME_GAIN,
    SHARED_GAIN,
    digits_fit,
    explain,
    height,
    limit_of,
    misfits,
)
from fascicle.recording.quality.finding import Check, Finding, Severity
from fascicle.recording.quality.lead_signals import coarse, steady
from fascicle.recording.recording import Recording

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


@dataclass(frozen=True)
class _Together:
    """Limb leads that were recorded at the same time."""

    rows: tuple[int, ...]
    start: int
    stop: int


def check_identities(recording: Recording) -> list[Finding]:
    r"""Compare the limb leads that were recorded with what the others among them say.

    The figure of an identity is the 99th percentile of \|what should be zero\| less its median,
    after the baseline and what is faster than about 37 Hz have been taken off each lead, so that
    neither drift nor noise of single leads counts. It is fine up to `LARGEST_MISFIT` mV, or up to
    `explanation.LARGEST_SHARE` of the limb leads' height where that is more.

    Parameters
    ----------
    recording : Recording
        Twelve leads. Those in ``derived`` satisfy the identities by construction and do not count.
        Leads that were recorded one group after another are compared where they overlap.

    Returns
    -------
    list of Finding
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
    return [finding for group in together for finding in _check_group(recording, group)]


def _together(recording: Recording) -> list[_Together]:
    """Find the sets of at least three limb leads with a stretch of time in common."""
    spans = recording.spans
    rows = [row for row, lead in enumerate(LIMB_LEADS) if lead in recording.measured_leads]
    found: dict[tuple[int, ...], _Together] = {}
    for start, stop in {(int(spans[row, 0]), int(spans[row, 1])) for row in rows}:
        covering = tuple(
            row
            for row in rows
            if min(spans[row, 1], stop) - max(spans[row, 0], start) >= SAME_TIME * (stop - start)
        )
        begin = max([start, *(int(spans[row, 0]) for row in covering)])
        end = min([stop, *(int(spans[row, 1]) for row in covering)])
        if len(covering) >= 3 and end - begin >= SHORTEST_OVERLAP * recording.sampling_rate:
            found[covering] = _Together(covering, begin, end)
    return sorted(found.values(), key=lambda group: group.rows)


def _check_group(recording: Recording, group: _Together) -> list[Finding]:
    """Check one set of leads that were recorded together."""
    rows = list(group.rows)
    part, rate = coarse(recording.signal[rows, group.start : group.stop], recording.sampling_rate)
    leads = steady(part, rate)
    labels, zeros = _identities(rows)
    found, limit = misfits(leads, zeros), limit_of(leads)
    broken = np.flatnonzero(found > limit)
    findings = [
        Check(label, "mV", limit).found(float(value))
        for label, value in zip(labels, found, strict=True)
    ]
    if not broken.size:
        return [*_check_gains(recording, rows, leads, zeros), *findings]
    severity, reason = explain(recording, rows, leads, zeros)
    for k in broken:
        findings[k] = replace(findings[k], severity=severity)
    first = int(broken[0])  # one fault breaks several identities, and is explained once
    what = f"{labels[first].split(' ', 1)[1]} is off by {found[first]:.2f} mV"
    findings[first] = replace(findings[first], message=f"{what}: {reason}")
    return findings


def _check_gains(
    recording: Recording, rows: list[int], leads: Floats, zeros: Floats
) -> list[Finding]:
    """Find gains per lead that break identities by little, where digits do not break them at all.

    Small limb leads hide gains that are several times too high or low in the chest leads.
    """
    gains = recording.digits_per_millivolt
    if gains is None or not (gains[rows] > 0).all():
        return []
    ratio = float(gains[rows].max() / gains[rows].min())
    digits = gains[rows][:, None] * leads
    share = float(misfits(leads, zeros).max()) / max(height(leads), np.finfo(float).tiny)
    share_of_digits = float(misfits(digits, zeros).max()) / max(height(digits), 1.0)
    wrong = digits_fit(leads, zeros, gains[rows]) and share > CLEARLY_WORSE * share_of_digits
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
