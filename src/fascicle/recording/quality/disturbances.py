"""Leads without a signal of their own; noise, hum of the mains and wander of the baseline."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS
from fascicle.recording.quality.check_result import Check, CheckResult, Severity, leave_out, listed
from fascicle.recording.quality.lead_signals import UV_PER_MV, coarse, measured, smoothed
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import MAINS

FLAT = 1e-3  # mV; standard deviation below which there is no signal
SMALLEST = Check("smallest lead", "uV", UV_PER_MV * FLAT)
CONSTANT = Check("longest constant stretch", "s", 2.0)  # longer than between two beats of most
COPIES = Check("leads of one size, correlation", "", 0.9999)
SAME_SIZE = 0.01  # relative difference of the standard deviations of copies

NOISE = Check("noise above 37 Hz", "uV", 50.0)  # a band 3 mm wide on paper
LOST = 0.3  # mV; standard deviation at which the QRS drowns
TO_STANDARD_DEVIATION = 1.4826  # times the median absolute deviation, for a normal distribution
ENOUGH = 200_000  # samples that give the median

HUM = Check("power-line interference", "uV", 25.0)  # amplitude, a quarter of a millimetre on paper
HARMONICS = (1, 2, 3)
SEGMENT = 4.0  # s
LINE_WIDTH = 0.75  # Hz each side, which allows for mains that are not quite on their frequency
NEIGHBOURS = 4.0  # Hz each side of the line, whose power is that of the ECG there

WANDER = Check("baseline wander", "mV", 1.0)  # 10 mm on paper; every beat is detrended anyway
HIGHEST_WANDER = 0.5  # Hz; below it there is no ECG (AHA/ACC/HRS, Circulation 115:1306, 2007)
RANGE = (1.0, 99.0)  # percentiles taken as lowest and highest


def check_flatness(recording: Recording) -> list[CheckResult]:
    """Find leads without signal, and leads that lose it for a while.

    The figures are the smallest standard deviation of a lead (uV), and the longest time (s) over
    which a lead stays at one value.
    """
    leads = measured(recording)
    spread = {lead: float(values.std()) for lead, values in leads.items()}
    flat = [lead for lead in leads if spread[lead] < FLAT]
    message = ""
    if flat:
        message = f"no signal in {listed(flat)}; go on without: {leave_out(recording, flat)}"
        if len(flat) == len(leads):
            message = "no signal in any lead; correct the unit or the gain, or record again"
    smallest = UV_PER_MV * min(spread.values())
    finding = SMALLEST.found(smallest, message, Severity.FATAL)
    moving = {lead: values for lead, values in leads.items() if lead not in flat}
    return [finding, _check_constant(recording, moving)]


def _check_constant(recording: Recording, leads: dict[str, Floats]) -> CheckResult:
    """Find the longest time over which a lead stays at one value."""
    rate = recording.sampling_rate
    constant = {lead: _longest_constant(values) / rate for lead, values in leads.items()}
    long = [lead for lead in leads if constant[lead] > CONSTANT.limit]
    longest = max(constant.values(), default=0.0)
    if not long:
        return CONSTANT.found(longest)
    if len(long) == len(leads):
        message = (
            f"no signal in any lead for up to {longest:.1f} s: the file was filled up; cut the "
            "recording to the part with signal"
        )
        return CONSTANT.found(longest, message, Severity.FATAL)
    message = (
        f"no signal in {listed(long)} for up to {longest:.1f} s: electrode off, or the file "
        f"was filled up; cut the recording, or go on without: {leave_out(recording, long)}"
    )
    return CONSTANT.found(longest, message)


def _longest_constant(values: Floats) -> int:
    """Number of samples of the longest run of equal ones in (n,) values."""
    changes = np.flatnonzero(np.diff(values))
    ends = np.concatenate([[-1], changes, [len(values) - 1]])
    return int(np.diff(ends).max())


def check_duplicates(recording: Recording) -> list[CheckResult]:
    """Find leads that are the same as another, or its exact negative.

    The figure is the largest absolute correlation between two leads of the same size.
    """
    largest, messages = 0.0, []
    leads = _standardised(recording)
    # where one limb lead is flat, others are the same by Einthoven's law
    limb_flat = {lead for lead in measured(recording) if lead in LIMB_LEADS} - set(leads)
    for one, other in combinations(leads, 2):
        if limb_flat and one in LIMB_LEADS and other in LIMB_LEADS:
            continue
        (x, x_size), (y, y_size) = leads[one], leads[other]
        if len(x) != len(y) or abs(x_size - y_size) > SAME_SIZE * max(x_size, y_size):
            continue
        correlation = float(x @ y) / len(x)
        largest = max(largest, abs(correlation))
        if abs(correlation) > COPIES.limit:
            sign = "the same" if correlation > 0 else "the same but for the sign"
            messages.append(
                f"leads {one} and {other} are {sign}; get the right samples, or leave both out: "
                f"{leave_out(recording, [one, other])}"
            )
    return [COPIES.found(largest, message, Severity.FATAL) for message in messages or [""]]


def _standardised(recording: Recording) -> dict[str, tuple[Floats, float]]:
    """Leads that move, with mean zero and standard deviation one, and what that was (mV)."""
    leads = {}
    for lead, values in measured(recording).items():
        x, _ = coarse(values, recording.sampling_rate)
        size = float(x.std())
        if size >= FLAT:
            leads[lead] = ((x - x.mean()) / size, size)
    return leads


def check_noise(recording: Recording) -> list[CheckResult]:
    """Find noisy leads, and leads that are nothing but noise.

    The figure is the largest standard deviation (uV) of a lead above 37 Hz, by the median absolute
    deviation: the QRS takes too little of the time to count.
    """
    rate = recording.sampling_rate
    noise = {lead: _fast(values, rate) for lead, values in measured(recording).items()}
    lost = [lead for lead, figure in noise.items() if figure > LOST]
    if lost and len(lost) < len(noise):
        largest = UV_PER_MV * max(noise.values())
        message = (
            f"noise drowns {listed(lost)} (SD up to {largest:.0f} uV): electrode off? Go on "
            f"without: {leave_out(recording, lost)}"
        )
        return [NOISE.found(largest, message, Severity.FATAL)]
    message = "noise in {leads} (SD up to {largest:.0f} uV above 37 Hz); record again"
    return [NOISE.worst_lead(noise, message, UV_PER_MV)]


def _fast(values: Floats, rate: float) -> float:
    """Robust standard deviation (mV) of what a moving average takes off."""
    fast = values - smoothed(values, rate)
    fast = fast[:: max(len(fast) // ENOUGH, 1)]
    return TO_STANDARD_DEVIATION * float(np.median(np.abs(fast - np.median(fast))))


def check_mains(recording: Recording) -> list[CheckResult]:
    """Find hum at 50 or 60 Hz and its harmonics.

    The figure is the largest amplitude (uV) in a lead: the power of the lines less that of the
    spectrum beside them (mean over `SEGMENT` s pieces), as amplitude of one sine.
    """
    leads, rate = measured(recording), recording.sampling_rate
    hum = {
        mains: {lead: _amplitude(values, rate, mains) for lead, values in leads.items()}
        for mains in MAINS
    }
    worst = max(hum, key=lambda mains: max(hum[mains].values()))
    message = (
        f"hum at {worst:g} Hz in {{leads}} (up to {{largest:.0f}} uV); switch the recorder's mains "
        "filter on, or record again away from the mains"
    )
    return [HUM.worst_lead(hum[worst], message, UV_PER_MV)]


def _amplitude(values: Floats, rate: float, mains: float) -> float:
    """Amplitude (mV) of the hum of one lead."""
    n = min(len(values), round(SEGMENT * rate))
    pieces = values[: len(values) // n * n].reshape(-1, n)
    window = np.hanning(n)
    spectrum = np.zeros(n // 2 + 1)
    for piece in pieces:  # one at a time, to keep memory small
        spectrum += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2
    # of a sine of amplitude A, the power summed over its line is A^2 n sum(window^2) / 4
    spectrum *= 4 / (n * float((window**2).sum()) * len(pieces))
    frequency = np.fft.rfftfreq(n, 1 / rate)
    power = 0.0
    for harmonic in HARMONICS:
        distance = np.abs(frequency - harmonic * mains)
        line = distance <= LINE_WIDTH
        beside = (distance > LINE_WIDTH) & (distance <= NEIGHBOURS)
        if harmonic * mains + NEIGHBOURS < rate / 2:
            excess = spectrum[line].sum() - line.sum() * float(np.median(spectrum[beside]))
            power += max(excess, 0.0)
    return float(np.sqrt(power))


def check_wander(recording: Recording) -> list[CheckResult]:
    """Find leads whose baseline wanders.

    The figure is the largest peak-to-peak amplitude (mV) of a lead below 0.5 Hz.
    """
    rate = recording.sampling_rate
    wander = {lead: _slow_range(values, rate) for lead, values in measured(recording).items()}
    message = (
        "the baseline of {leads} wanders (up to {largest:.2f} mV peak to peak); look at the beats, "
        "or record again at rest"
    )
    return [WANDER.worst_lead(wander, message)]


def _slow_range(values: Floats, rate: float) -> float:
    """Peak-to-peak amplitude (mV) of one lead below `HIGHEST_WANDER`."""
    x, coarse_rate = coarse(values, rate)
    low = butter(2, HIGHEST_WANDER, fs=coarse_rate, output="sos")
    pad = min(len(x) - 1, round(2 * coarse_rate / HIGHEST_WANDER))
    slow = sosfiltfilt(low, x - np.median(x), padtype="even", padlen=pad)
    below, above = np.percentile(slow, RANGE)
    return float(above - below)
