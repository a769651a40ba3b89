"""The conventional ECG criteria of bundle branch and fascicular block, read off a mean beat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS, LIMB_LEADS
from fascicle.recording.waves import CAPITAL, Qrs

AHA = "AHA/ACCF/HRS 2009"  # Surawicz et al., J Am Coll Cardiol 53:976
STRAUSS = "Strauss et al. 2011"  # Strauss, Selvester and Wagner, Am J Cardiol 107:927


@dataclass(frozen=True)
class Criterion:
    """Decision of a conventional criterion on a beat.

    Attributes
    ----------
    name : str
        The conduction disturbance.
    met : bool or None
        None where a lead that decides it is not used.
    why : str
        Measurements, each with its limit in brackets: all of them where the criterion is met,
        otherwise those that are against it or missing.
    source : str
        Publication that defines it.
    """

    name: str
    met: bool | None
    why: str
    source: str


def conventional_criteria(
    leads: Floats, onset: int, offset: int, names: Sequence[str] = LEADS
) -> tuple[Criterion, ...]:
    """Decide the conventional criteria of conduction disturbances in adults.

    Times are from the global QRS onset. Criteria that need more than the QRS of a beat are left
    out: ST segment and T wave, age, sex (the limits of Strauss et al. for both are decided),
    congenital heart disease, and incomplete left bundle branch block, which needs a pattern of
    hypertrophy.

    Parameters
    ----------
    leads : (n_leads, n) array
        Mean beat (mV), every 1 ms, its isoelectric level at 0; NaN where a lead is not used.
    onset, offset : int
        Samples at which the global QRS begins and ends.
    names : sequence of str
        Names of the leads.
    """
    beat = _Beat(leads, onset, offset, names)
    qrs, right, left, strauss = beat.qrs, beat.right(), beat.left(), beat.left_of_strauss()
    shapes = [_at_least(len(parts), [part.met for part in parts]) for parts in (right, left)]
    neither = {None: None, True: False, False: True}[_at_least(1, shapes)]
    how = {None: "perhaps ", True: "not ", False: ""}[neither]
    description = f"shape {how}of a bundle branch block (neither bundle's)"
    short, long = qrs("below 120", beat.ms < 120), qrs("at least 120", beat.ms >= 120)
    between = qrs("at least 110, below 120", 110 <= beat.ms < 120)
    men, women = (qrs(f"at least {limit}", beat.ms >= limit) for limit in (140, 130))
    nonspecific = [qrs("over 110", beat.ms > 110), _Part(neither, description)]
    return (
        _criterion("complete right bundle branch block", [long, *right]),
        _criterion("incomplete right bundle branch block", [between, *right]),
        _criterion("complete left bundle branch block", [long, *left]),
        _criterion("left anterior fascicular block", [short, *beat.anterior()]),
        _criterion("left posterior fascicular block", [short, *beat.posterior()]),
        _criterion("nonspecific intraventricular conduction disturbance", nonspecific),
        _criterion("left bundle branch block (140 ms, men)", [men, *strauss], STRAUSS),
        _criterion("left bundle branch block (130 ms, women)", [women, *strauss], STRAUSS),
    )


def frontal_axis(ecg: Floats) -> float:
    """Angle (degrees) of a QRS (12, n) in the frontal plane, from the areas in leads I and aVF."""
    area = ecg.sum(axis=1)
    # aVF is shorter than I by the factor √3/2 of augmented leads
    return float(np.degrees(np.arctan2(2 / np.sqrt(3) * area[5], area[0])))


class _Part(NamedTuple):
    """A requirement of a criterion: whether it is met, and the measurement with its limit."""

    met: bool | None
    why: str


def _at_least(number: int, met: Sequence[bool | None]) -> bool | None:
    """Whether at least `number` are met; None where that depends on the unknown ones."""
    certain, possible = met.count(True), len(met) - met.count(False)
    return True if certain >= number else None if possible >= number else False


def _criterion(name: str, parts: Sequence[_Part], source: str = AHA) -> Criterion:
    met = _at_least(len(parts), [part.met for part in parts])
    return Criterion(
        name, met, "; ".join(why for part_met, why in parts if part_met is met), source
    )


class _Beat:
    """The QRS of a beat, and the parts of the criteria."""

    def __init__(self, leads: Floats, onset: int, offset: int, names: Sequence[str]) -> None:
        self.ms = offset - onset
        rows = zip(names, leads[:, max(onset, 0) : offset + 1], strict=True)
        self.leads = {name: Qrs(qrs) for name, qrs in rows if np.isfinite(qrs).all()}
        limb = [self.leads[name].potential for name in LIMB_LEADS if name in self.leads]
        self.axis = frontal_axis(np.array(limb)) if len(limb) == len(LIMB_LEADS) else None

    def qrs(self, limit: str, met: bool) -> _Part:
        """Requirement on the global QRS duration."""
        return _Part(met, f"QRS {self.ms} ms ({limit})")

    def each(
        self,
        names: str,
        limit: str,
        met: Callable[[Qrs], bool],
        say: Callable[[Qrs], str] = lambda lead: lead.pattern,
        number: int | None = None,
    ) -> _Part:
        """Requirement that the leads meet, all of them or at least a `number`."""
        leads_by_text: dict[str, list[str]] = {}
        results: list[bool | None] = []
        for name in names.split():
            lead = self.leads.get(name)
            results.append(None if lead is None else met(lead))
            leads_by_text.setdefault("not used:" if lead is None else f"{say(lead)} in", []).append(
                name
            )
        measured = " and ".join(
            f"{text} {', '.join(leads)}" for text, leads in leads_by_text.items()
        )
        enough = _at_least(len(results) if number is None else number, results)
        return _Part(enough, f"{measured} ({limit})")

    def r_peak(self, names: str, limit: str, met: Callable[[float], bool]) -> _Part:
        """Requirement on the R-peak time (ms)."""

        def say(lead: Qrs) -> str:
            return "no R peak" if np.isnan(lead.r_peak) else f"R peak {lead.r_peak:.0f} ms"

        return self.each(names, limit, lambda lead: met(lead.r_peak), say)

    def axis_within(self, low: float, high: float) -> _Part:
        """Requirement on the frontal axis (degrees)."""
        if self.axis is None:
            return _Part(None, "axis unknown: a limb lead is not used")
        return _Part(low <= self.axis <= high, f"axis {self.axis:.0f}° ({low} to {high}°)")

    def right(self) -> list[_Part]:
        """Shape of right bundle branch block."""
        r_prime = self.each("V1 V2", "rsr', rsR' or rSR' in one", _has_r_prime, number=1)
        alone = self.each("V1 V2", "R alone in one", lambda lead: lead.signs == "+", number=1)
        s_wave = self.each("I V6", "S longer than R or 40 ms", _has_long_s)
        if r_prime.met is not False or not alone.met:
            return [r_prime, s_wave]
        late = self.r_peak("V1", "over 50", lambda t: t > 50)
        return [alone, late, self.r_peak("V5 V6", "up to 60", lambda t: t <= 60), s_wave]

    def left(self) -> list[_Part]:
        """Shape of left bundle branch block."""
        small_r = [
            name for name in ("V1", "V2", "V3") if name in self.leads and self.leads[name].is_rs
        ]
        early = [self.r_peak(" ".join(small_r), "up to 50", lambda t: t <= 50)] if small_r else []
        return [
            self.each(
                "I aVL V5 V6",
                "each",
                lambda lead: bool(lead.notches(1)),
                lambda lead: f"{'' if lead.notches(1) else 'no '}notch or slur of R",
            ),
            self.each("I V5 V6", "no q", lambda lead: lead.signs.startswith("+")),
            self.r_peak("V5 V6", "over 60", lambda t: t > 60),
            *early,
        ]

    def left_of_strauss(self) -> list[_Part]:
        """Shape of left bundle branch block of Strauss et al."""

        def notched(lead: Qrs) -> bool:
            # the paper says mid-QRS, without times
            times = lead.notches(1) + lead.notches(-1)
            return any(40 <= time <= self.ms * 2 / 3 for time in times)

        return [
            self.each("V1 V2", "QS or rS", lambda lead: lead.signs == "-" or lead.is_rs),
            self.each(
                "V1 V2 V5 V6 I aVL",
                "two of them",
                notched,
                lambda lead: f"{'' if notched(lead) else 'no '}mid-QRS notch or slur",
                number=2,
            ),
        ]

    def anterior(self) -> list[_Part]:
        """Shape of left anterior fascicular block."""
        late = self.r_peak("aVL", "at least 45", lambda t: t >= 45)
        return [self.axis_within(-90, -45), self.each("aVL", "qR", lambda lead: lead.is_qr), late]

    def posterior(self) -> list[_Part]:
        """Shape of left posterior fascicular block."""
        r_s, q_r = (
            self.each("I aVL", "rS", lambda lead: lead.is_rs),
            self.each("III aVF", "qR", lambda lead: lead.is_qr),
        )
        return [self.axis_within(90, 180), r_s, q_r]


def _has_r_prime(lead: Qrs) -> bool:
    """Whether a QRS is rsR', rSR', or rsr' with waves that all have small letters; not rSr'."""
    if lead.signs != "+-+":
        return False
    r, s, r_prime = (abs(wave.height) for wave in lead.waves)
    return r_prime >= r or max(r, s) < CAPITAL


def _has_long_s(lead: Qrs) -> bool:
    r_to_s = lead.signs.find("+-")
    if r_to_s < 0:
        return False
    r, s = (wave.end - wave.start for wave in lead.waves[r_to_s : r_to_s + 2])
    return s > min(r, 40)
