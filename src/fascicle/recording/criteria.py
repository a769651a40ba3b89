"""The conventional ECG criteria of bundle branch and fascicular block, read off a mean beat.

They are about the waves of the QRS of each lead, its R peak and its notches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS, LIMB_LEADS


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

    Times are from the QRS onset. Criteria that need more than the QRS of a beat are left out: ST
    segment and T wave, age, sex (the limits of Strauss et al. for both are decided), congenital
    heart disease, and incomplete left bundle branch block, which needs a pattern of hypertrophy.

    Parameters
    ----------
    leads : (n_leads, n) array
        Mean beat (mV), every 1 ms, its isoelectric level at 0; NaN where a lead is not used.
    onset, offset : int
        First and last sample of the QRS.
    names : sequence of str
        Names of the leads.
    """
    beat = _Beat(leads, onset, offset, names)
    qrs, right, left, mid_notched = beat.qrs, beat.right(), beat.left(), beat.left_of_strauss()
    strauss = "Strauss et al. 2011"  # Strauss, Selvester and Wagner, Am J Cardiol 107:927
    shapes = [_at_least(len(parts), [part.met for part in parts]) for parts in (right, left)]
    neither = {None: None, True: False, False: True}[_at_least(1, shapes)]
    how = {None: "perhaps ", True: "not ", False: ""}[neither]
    description = f"shape {how}of a bundle branch block (neither bundle's)"
    short, long = qrs("below 120", beat.ms < 120), qrs("at least 120", beat.ms >= 120)
    between = qrs("at least 110, below 120", 110 <= beat.ms < 120)
    men, women = (qrs(f"at least {limit}", beat.ms >= limit) for limit in (140, 130))
    nonspecific = [qrs("over 110", beat.ms > 110), _Part(neither, description)]
    anterior = [
        beat.axis_within(-90, -45),
        beat.each("aVL", "qR", lambda lead: lead.is_qr),
        beat.r_peak("aVL", "at least 45", lambda t: t >= 45),
    ]
    posterior = [
        beat.axis_within(90, 180),
        beat.each("I aVL", "rS", lambda lead: lead.is_rs),
        beat.each("III aVF", "qR", lambda lead: lead.is_qr),
    ]
    return (
        _criterion("complete right bundle branch block", [long, *right]),
        _criterion("incomplete right bundle branch block", [between, *right]),
        _criterion("complete left bundle branch block", [long, *left]),
        _criterion("left anterior fascicular block", [short, *anterior]),
        _criterion("left posterior fascicular block", [short, *posterior]),
        _criterion("nonspecific intraventricular conduction disturbance", nonspecific),
        _criterion("left bundle branch block (140 ms, men)", [men, *mid_notched], strauss),
        _criterion("left bundle branch block (130 ms, women)", [women, *mid_notched], strauss),
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
    """True if at least `number` are met; None where that depends on the unknown ones."""
    certain, possible = met.count(True), len(met) - met.count(False)
    return True if certain >= number else None if possible >= number else False


def _criterion(
    name: str,
    parts: Sequence[_Part],
    source: str = "AHA/ACCF/HRS 2009",  # Surawicz et al., J Am Coll Cardiol 53:976
) -> Criterion:
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
        """Requirement on the QRS duration."""
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
        r_prime = self.each(
            "V1 V2", "rsr', rsR' or rSR' in one", lambda lead: lead.has_r_prime, number=1
        )
        alone = self.each("V1 V2", "R alone in one", lambda lead: lead.signs == "+", number=1)
        s_wave = self.each("I V6", "S longer than R or 40 ms", lambda lead: lead.has_long_s)
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


class Wave(NamedTuple):
    """A wave: first and last sample (ms from the onset), and its height (mV)."""

    start: int
    end: int
    height: float


class Qrs:
    """QRS (n,), mV, of a lead, every 1 ms from its onset."""

    # Smallest wave of IEC 60601-2-51:2003, annex GG.5, and smallest notch: its least height (mV),
    # the time (ms) that it must have this height, and its duration from end to end (ms)
    least_height: ClassVar[float] = 0.03
    least_time: ClassVar[int] = 6
    least_duration: ClassVar[int] = 12
    capital: ClassVar[float] = 0.5  # mV from which a wave has a capital letter: 5 mm on paper

    def __init__(self, qrs: Floats) -> None:
        self.potential = qrs

    @cached_property
    def waves(self) -> list[Wave]:
        """Waves Q, R, S and so on; one that returns to the level without crossing it is notched."""
        side = np.where(np.abs(self.potential) >= self.least_height, np.sign(self.potential), 0.0)
        waves: list[Wave] = []
        for sign, run in groupby(range(len(side)), key=side.__getitem__):
            samples = list(run)
            height = float(sign * (sign * self.potential[samples]).max())
            # an ST segment that is off the level only leads away from it, and is no wave
            returns = sign * (height - self.potential[-1]) >= self.least_height
            if not sign or len(samples) < self.least_time or not returns:
                continue
            start = samples[0]
            if waves and waves[-1].height * sign > 0:
                before = waves.pop()
                start, height = before.start, max(before.height, height, key=abs)
            waves.append(Wave(start, samples[-1], height))
        return waves

    @property
    def signs(self) -> str:
        """Whether each wave is above or below the level: ``+-`` for rS, RS and Rs."""
        return "".join("+" if wave.height > 0 else "-" for wave in self.waves)

    @property
    def pattern(self) -> str:
        """Waves in letters, such as rSR'."""
        letters: list[str] = []
        for wave in self.waves:
            previous_letters = "".join(letters).lower()
            letter = "r" if wave.height > 0 else "s" if "r" in previous_letters else "q"
            capital = abs(wave.height) >= self.capital
            letters.append(
                (letter.upper() if capital else letter) + "'" * previous_letters.count(letter)
            )
        return "QS" if self.signs == "-" else "".join(letters) or "no wave"

    @property
    def r_peak(self) -> float:
        """Time (ms) of the R peak; NaN without one.

        The peak is that of the last wave above the level, R or R'; of a notched wave, its last peak
        that is at least half as high as the wave.
        """
        above = [wave for wave in self.waves if wave.height > 0]
        if not above:
            return np.nan
        from scipy.signal import find_peaks  # loads scipy.stats

        peaks, _ = find_peaks(self.potential, above[-1].height / 2, prominence=self.least_height)
        peaks = peaks[(peaks >= above[-1].start) & (peaks <= above[-1].end)]
        return float(peaks[-1]) if len(peaks) else np.nan

    def notches(self, sign: int) -> list[int]:
        """Times (ms) of notches and slurs in the waves above (1) or below (-1) the level.

        But for its feet a smooth wave is concave. A notch or slur is where it departs from the
        tangent that bridges it, as far and as long as the smallest wave.
        """
        times = []
        for wave in (wave for wave in self.waves if wave.height * sign > 0):
            curve = sign * self.potential[wave.start : wave.end + 1]
            curve = np.pad(curve, 1, constant_values=-abs(wave.height))
            time = np.arange(len(curve))
            hull = np.sort(ConvexHull(np.column_stack([time, curve])).vertices)
            hull = hull[2:-2]  # without the ends of the wave, and so without its feet
            for first, last in pairwise(hull):
                bridge = np.interp(time, [first, last], curve[[first, last]])
                inside = (bridge - curve)[first : last + 1]
                if (
                    last - first >= self.least_duration
                    and (inside >= self.least_height).sum() >= self.least_time
                ):
                    times.append(wave.start - 1 + int(first + np.argmax(inside)))
        return times

    @property
    def is_qr(self) -> bool:
        """True if a q is followed by a larger R, and no other wave."""
        return self.signs == "-+" and self.waves[1].height > -self.waves[0].height

    @property
    def is_rs(self) -> bool:
        """True if an r is followed by a larger S, and no other wave."""
        return self.signs == "+-" and self.waves[0].height < -self.waves[1].height

    @property
    def has_r_prime(self) -> bool:
        """True if it is rsR', rSR', or rsr' with waves that all have small letters; not rSr'."""
        if self.signs != "+-+":
            return False
        r, s, r_prime = (abs(wave.height) for wave in self.waves)
        return r_prime >= r or max(r, s) < self.capital

    @property
    def has_long_s(self) -> bool:
        """True if an S follows an R and is longer than that, or than 40 ms."""
        r_to_s = self.signs.find("+-")
        if r_to_s < 0:
            return False
        r, s = (wave.end - wave.start for wave in self.waves[r_to_s : r_to_s + 2])
        return s > min(r, 40)
