"""Quality checks of a recording by its own numbers, each with its limit and unit."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from itertools import combinations, pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import welch

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import CHEST_LEADS, LEADS, LIMB_LEADS
from fascicle.recording.filter_estimate import estimated_lowpass
from fascicle.recording.filters import MAINS, Filter, FilterKind, FilterOrigin, coarse
from fascicle.recording.recording import Recording
from fascicle.recording.window import spatial_velocity


class Severity(Enum):
    """Consequence of a check."""

    FINE = "ok"
    WARNING = "warning"  # the target is made, and says so
    FATAL = "refused"  # no target until the user has decided


@dataclass(frozen=True)
class Check:
    """A check: name, unit of its figure (or none), and limit of what is acceptable."""

    name: str
    unit: str
    limit: float

    def result(
        self, value: float, message: str = "", severity: Severity = Severity.WARNING
    ) -> CheckResult:
        """Outcome of the check: all is fine where the message is empty."""
        return CheckResult(self, value, severity if message else Severity.FINE, message)


@dataclass(frozen=True)
class CheckResult:
    """Outcome of a check, with its figure."""

    check: Check
    value: float  # NaN where the recording does not allow the check
    severity: Severity
    message: str = ""  # one line: what was found and what to do; empty where all is fine


def listed(leads: Collection[str]) -> str:
    """Names in the usual order: ``lead V2``, ``leads I and V1``, ``leads V1 to V6``."""
    names = sorted(leads, key=lambda lead: LEADS.index(lead) if lead in LEADS else len(LEADS))
    if len(names) == 1:
        return f"lead {names[0]}"
    for group in (LIMB_LEADS, CHEST_LEADS, LEADS):
        if names == list(group):
            return f"leads {group[0]} to {group[-1]}"
    return f"leads {', '.join(names[:-1])} and {names[-1]}"


def leave_out(recording: Recording, leads: Collection[str]) -> str:
    """Option that uses every recorded lead but these."""
    recorded = (*recording.measured_leads, *recording.additional)
    kept = [lead for lead in recorded if lead not in leads]
    return f"--leads {','.join(kept)}"


FASTEST_QRS = Check("fastest part of the QRS", "mV/ms", 0.01)
CHEST = Check("chest leads, misfit ratio", "", 1.5)


@dataclass(frozen=True)
class LeadCheck(Check):
    """A check of each lead by itself; the largest figure counts."""

    figure: Callable[[Floats, float], float]  # from samples (mV) and rate (Hz), in the check's unit
    message: str  # with {leads} for those over the limit and {largest} for the largest figure
    advice: str  # what the user should do
    refused: float = math.inf  # limit beyond which a lead cannot be used, unless all are
    mains: float | None = None  # Hz; frequency of the notch that would help

    def of(self, recording: Recording, notch: Filter | None = None) -> CheckResult:
        """Outcome in a recording, of which the `notch` that the user asked for is to be applied."""
        rate, leads = recording.sampling_rate, measured(recording) | recording.additional
        advice = self.advice
        if notch is not None and notch.frequency == self.mains:
            notch = replace(notch, sampling_rate=rate)
            leads = {lead: notch.apply(values) for lead, values in leads.items()}
        elif self.mains is not None:
            advice = f"take it away by --notch {self.mains:g}, or {advice}"
        figures = {lead: self.figure(values, rate) for lead, values in leads.items()}
        largest = max(figures.values())
        named = [lead for lead in figures if figures[lead] > self.limit]
        lost, severity = [lead for lead in named if figures[lead] > self.refused], Severity.WARNING
        if lost and len(lost) < len(figures):
            named, severity = lost, Severity.FATAL
            advice = f"go on without: {leave_out(recording, lost)}"
        elif 0 < len(named) <= 2 < len(figures):
            advice += f", or go on without: {leave_out(recording, named)}"
        if not named:
            return self.result(largest)
        problem = self.message.format(leads=listed(named), largest=largest)
        return self.result(largest, f"{problem}; {advice}", severity)


def check_recording(
    recording: Recording, peaks: Integers, filters: Sequence[Filter]
) -> tuple[CheckResult, ...]:
    """Check the noise, range and resolution of each lead, and the recorder's low-pass.

    The fine outcomes are returned, too. The recording is without pacing spikes, its R peaks are at
    the samples `peaks` (n_beats,), and it has passed the `filters`.
    """
    applied = (filter_ for filter_ in filters if filter_.origin is FilterOrigin.APPLIED)
    notch = next((filter_ for filter_ in applied if filter_.kind is FilterKind.NOTCH), None)
    results = (check.of(recording, notch) for check in LEAD_CHECKS)
    return (*results, _check_lowpass(recording, peaks, filters))


def measured(recording: Recording) -> dict[str, Floats]:
    """Samples (mV) of each lead over its own time; computed leads are left out."""
    kept = recording.measured_leads
    rows = zip(LEADS, recording.signal, recording.spans, strict=True)
    return {lead: x[first:stop] for lead, x, (first, stop) in rows if lead in kept}


def check_leads(recording: Recording) -> tuple[CheckResult, ...]:
    """Check that each lead holds a signal at all times, and is not a copy of another lead."""
    # standard deviation below which a lead holds no signal
    flatness = Check("smallest lead", "uV", 1.0)
    # longer than between two beats of most
    constancy = Check("longest constant stretch", "s", 2.0)
    leads = measured(recording) | recording.additional
    spread = {lead: 1e3 * float(values.std()) for lead, values in leads.items()}
    flat = [lead for lead in leads if spread[lead] < flatness.limit]
    message = ""
    if flat:
        message = f"no signal in {listed(flat)}; go on without: {leave_out(recording, flat)}"
        if len(flat) == len(leads):
            message = "no signal in any lead; correct the unit or the gain, or record again"
    flat_result = flatness.result(min(spread.values()), message, Severity.FATAL)
    constant = {}
    for lead, values in leads.items():
        if lead not in flat:
            runs = np.diff(np.flatnonzero(np.diff(values, prepend=np.nan, append=np.nan)))
            constant[lead] = int(runs.max()) / recording.sampling_rate
    long = [lead for lead, seconds in constant.items() if seconds > constancy.limit]
    longest = max(constant.values(), default=0.0)
    message, everywhere = "", len(long) == len(constant)
    if long:
        where = "any lead" if everywhere else listed(long)
        message = (
            f"no signal in {where} for up to {longest:.1f} s: electrode off, or the file was "
            "filled up; cut the recording to the part with signal"
        )
    severity = Severity.FATAL if everywhere else Severity.WARNING
    duplicates = _check_duplicates(recording, 1e-3 * flatness.limit)
    return (flat_result, constancy.result(longest, message, severity), *duplicates)


def _check_duplicates(recording: Recording, least: float) -> list[CheckResult]:
    """Largest absolute correlation between two leads of the same size, of at least so many mV."""
    check = Check("duplicated leads, correlation", "", 0.9999)
    leads = {}  # leads with a signal, standardised, and their SD (mV)
    for lead, values in measured(recording).items():
        x, _ = coarse(values, recording.sampling_rate)
        size = float(x.std())
        if size >= least:
            leads[lead] = ((x - x.mean()) / size, size)
    # where one limb lead is flat, others are the same by Einthoven's law
    limb_flat = {lead for lead in measured(recording) if lead in LIMB_LEADS} - set(leads)
    largest, messages = 0.0, []
    for lead, other in combinations(leads, 2):
        if limb_flat and lead in LIMB_LEADS and other in LIMB_LEADS:
            continue
        (x, x_size), (y, y_size) = leads[lead], leads[other]
        if len(x) != len(y) or abs(x_size - y_size) > 0.01 * max(x_size, y_size):
            continue
        correlation = float(x @ y) / len(x)
        largest = max(largest, abs(correlation))
        if abs(correlation) > check.limit:
            sign = "the same" if correlation > 0 else "the same but for the sign"
            messages.append(
                f"leads {lead} and {other} are {sign}; get the right samples, or leave both out: "
                f"{leave_out(recording, [lead, other])}"
            )
    return [check.result(largest, message, Severity.FATAL) for message in messages or [""]]


def _check_lowpass(recording: Recording, peaks: Integers, filters: Sequence[Filter]) -> CheckResult:
    """Check the recorder's low-pass, which smooths the QRS; compare one stated to the spectrum."""
    # for adults, of P. Kligfield et al., Recommendations for the standardization and interpretation
    # of the electrocardiogram, part I, Circulation 115:1306 (2007)
    check = Check("recorder's low-pass", "Hz", 150.0)
    own, kind = FilterOrigin.APPLIED, FilterKind.LOW_PASS
    lowpass = next((f for f in filters if f.kind is kind and f.origin is not own), None)
    if lowpass is None:
        return check.result(math.nan)
    messages = []
    if lowpass.frequency < check.limit:
        much = "strongly " if lowpass.frequency <= 40.0 else ""  # Hz; small deflections vanish
        estimated = lowpass.origin is FilterOrigin.ESTIMATED
        source = ", estimated from the spectrum," if estimated else ""
        messages.append(
            f"the recorder's low-pass at {lowpass.frequency:.3g} Hz{source} {much}smooths the QRS "
            f"({check.limit:g} Hz are recommended); export the recording unfiltered"
        )
    if lowpass.origin is FilterOrigin.STATED:
        estimate = estimated_lowpass(recording.signal, recording.sampling_rate, peaks)
        if estimate is not None and (
            abs(math.log(estimate.frequency / lowpass.frequency)) > math.log(1.1)
            or estimate.shape >= 2.0 * lowpass.shape  # a steeper filter rings differently
        ):
            messages.append(
                f"the spectrum shows a low-pass at {estimate.frequency:.3g} Hz of order "
                f"{estimate.shape:.2g}, not that of --recorder-lowpass: it rings, and the QRS is "
                "marked too wide unless that option is left out"
            )
    return check.result(lowpass.frequency, "; ".join(messages))


def _noise(values: Floats, rate: float) -> float:
    """Standard deviation (uV) of the noise that a moving average of 12 ms (37 Hz) removes.

    It is found by the median absolute deviation, which the short QRS hardly changes.
    """
    fast = values - uniform_filter1d(values, max(round(0.012 * rate), 1), mode="nearest")
    fast = fast[:: max(len(fast) // 200_000, 1)]
    return 1e3 * 1.4826 * float(np.median(np.abs(fast - np.median(fast))))


def _interference(values: Floats, rate: float, mains: float) -> float:
    """Amplitude (uV), as of one sine, of a frequency (Hz) and two harmonics.

    Its power is that of the lines less that of the spectrum next to them, by pieces of 4 s.
    """
    n = min(len(values), round(4.0 * rate))
    frequency, density = welch(values, rate, window=np.hanning(n), noverlap=0, scaling="density")
    # scaled so that of a sine of amplitude A the sum over its line is A²
    spectrum = 2 * density * rate / n
    power = 0.0
    for line in mains * np.arange(1, 4):
        distance = np.abs(frequency - line)
        on_line = distance <= 0.75  # Hz, for mains that are not quite on their frequency
        nearby = (distance > 0.75) & (distance <= 4.0)
        if line + 4.0 < rate / 2:
            excess = spectrum[on_line].sum() - on_line.sum() * float(np.median(spectrum[nearby]))
            power += max(excess, 0.0)
    return 1e3 * float(np.sqrt(power))


def _resolution(values: Floats, rate: float) -> float:
    """Smallest difference between distinct (n,) values (uV); 0 where all are the same."""
    gaps = np.diff(np.unique(values[:: max(len(values) // 100_000, 1)]))
    gaps = gaps[gaps > 1e-7]  # mV; nearer values are one value
    return 1e3 * float(gaps.min()) if gaps.size else 0.0


def _clipped(values: Floats, rate: float) -> float:
    """Share of the samples in runs of three or more at the lowest or highest value.

    A rounded peak approaches its top by steps of about one digit, a clipped one at full slope, by
    four digits or more. Fewer than three runs shorter than 20 ms occur by chance. A plateau nearer
    to the baseline than half of the lead's largest deflection is not clipping.
    """
    if np.ptp(values) == 0:
        return 0.0
    middle = np.median(values)
    furthest = np.abs(values - middle).max()
    steps = np.abs(np.diff(values, prepend=values[0], append=values[-1]))
    # A digit is the smallest step that is common: between digits lies what replaced a spike.
    sizes, counts = np.unique(np.round(steps[steps > 1e-7], 7), return_counts=True)
    steep = 4.0 * float(sizes[counts >= 0.25 * counts.max()][0])
    count = 0
    for extreme in (values.min(), values.max()):
        if abs(extreme - middle) < 0.5 * furthest:
            continue
        edges = np.diff(np.concatenate([[0], values == extreme, [0]]))
        starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        lengths = (stops - starts)[np.maximum(steps[starts], steps[stops]) >= steep]
        lengths = lengths[lengths >= 3]
        if len(lengths) >= 3 or max(lengths, default=0) >= 0.02 * rate:
            count += int(lengths.sum())
    return count / len(values)


LEAD_CHECKS = (
    LeadCheck(
        "noise above 37 Hz", "uV", 50.0, _noise,  # a band 3 mm wide on paper
        "noise in {leads} (SD up to {largest:.0f} uV above 37 Hz)", "record again",
        refused=300.0,  # the QRS drowns
    ),
    LeadCheck(
        "clipped samples", "", 1e-4, _clipped,  # one run of 3 samples in 30 000
        "peaks of {leads} are clipped ({largest:.2%} of the samples)",
        "the amplifier's or the file's range was too small, leave out what is clipped in the QRS",
    ),
    *(
        LeadCheck(
            f"power-line interference, {mains:g} Hz", "uV", 25.0,  # a quarter of a mm on paper
            partial(_interference, mains=mains),
            f"power-line interference at {mains:g} Hz in {{leads}} (up to {{largest:.0f}} uV)",
            "record again away from the power line", mains=mains,
        )
        for mains in MAINS
    ),
    LeadCheck(
        "amplitude resolution", "uV", 20.0, _resolution,  # recorders store 5 uV or finer
        "steps of up to {largest:.0f} uV between the values of {leads}",
        "export the recording with all its digits",
    ),
)  # fmt: skip


def check_mean_beat(qrs: Floats, simultaneous: bool = True) -> tuple[CheckResult, CheckResult]:
    """Check the speed and the chest leads of a mean QRS (12, n), mV, every `SAMPLING_STEP` ms.

    Chest leads are not checked in a beat that is too slow for a QRS. `simultaneous` says that all
    leads were recorded at the same time.
    """
    fastest = float(spatial_velocity(qrs).max())
    if not fastest < FASTEST_QRS.limit:
        return FASTEST_QRS.result(fastest), check_chest_leads(qrs, simultaneous)
    message = (
        f"the fastest part of the beat moves by {fastest:.4f} mV/ms, slower than any QRS "
        f"({FASTEST_QRS.limit:g} or more): a T or P wave was probably taken for the beat; look at "
        "the picture, choose another class by --class, or give a recording with QRS complexes"
    )
    return FASTEST_QRS.result(fastest, message), CHEST.result(
        np.nan, "not checked: no QRS", Severity.FINE
    )


def check_chest_leads(qrs: Floats, simultaneous: bool = True) -> CheckResult:
    r"""Check whether two neighbouring chest leads are exchanged, or one is upside down.

    The chest leads V (6,) are :math:`V = D h + e`, of a heart vector h, by Dower's matrix D, and a
    rest e of other torsos, hearts and electrodes. With h and e normally distributed, of covariance
    1 and C, their misfit is :math:`V^T (D D^T + C)^{-1} V`, summed over the QRS. The figure is the
    misfit over the least that an exchange of neighbours or an inversion leaves. Limb leads take no
    part; reversed limb electrodes change no chest lead.

    Of a mean QRS (12, n), mV, from the PR segment as zero; absent leads are NaN. `simultaneous`
    says whether all leads were recorded at the same time.
    """
    chest = qrs[len(LEADS) - len(CHEST_LEADS) : len(LEADS)]
    if not (simultaneous and np.isfinite(chest).all()):
        message = "not checked: needs V1 to V6, recorded at the same time"
        return CHEST.result(np.nan, message, Severity.FINE)
    # V1 to V6 of a heart vector (left, down, back) in Frank's torso: G. E. Dower, H. Bastos
    # Machado, J. A. Osborne, On deriving the electrocardiogram from vectorcardiographic leads,
    # Clin. Cardiol. 3:87 (1980)
    dower = np.array(
        [
            [-0.515, 0.157, -0.917], [0.044, 0.164, -1.387], [0.882, 0.098, -1.277],
            [1.213, 0.127, -0.601], [1.125, 0.127, -0.086], [0.831, 0.076, 0.230],
        ]
    )  # fmt: skip
    # Standard deviations of the rest of a chest lead over those of the heart vector: of the part
    # that its neighbours share, and of the electrode's alone; tuned, as the limits, on
    # benchmarks/chest_leads.py
    shared, electrode_noise = 0.6, 0.3
    apart = np.subtract.outer(np.arange(6), np.arange(6))
    residual_covariance = shared**2 * np.exp(-(apart**2) / 2) + electrode_noise**2 * np.eye(6)
    weight = np.linalg.inv(dower @ dower.T + residual_covariance)

    def misfit(leads: Floats) -> float:
        return float(np.sum(leads * (weight @ leads)))

    remedies = {}
    for k, lead in enumerate(CHEST_LEADS):
        turned = np.where(np.arange(6) == k, -1.0, 1.0)[:, None] * chest
        remedies[f"lead {lead} is probably upside down", f"--invert {lead}"] = misfit(turned)
    for k, (lead, other) in enumerate(pairwise(CHEST_LEADS)):
        order = [*range(k), k + 1, k, *range(k + 2, 6)]
        problem = f"leads {lead} and {other} are probably exchanged"
        remedies[problem, f"--swap {lead}-{other}"] = misfit(chest[order])
    problem, option = min(remedies, key=remedies.__getitem__)
    ratio = misfit(chest) / remedies[problem, option]
    message = (
        f"{problem}: with that undone the chest leads fit one another {ratio:.1f} times better; "
        f"look at the picture; to undo it: {option}"
    )
    return CHEST.result(ratio, message if ratio > CHEST.limit else "")
