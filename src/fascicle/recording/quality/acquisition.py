"""How the recorder was set: sampling rate, duration, and filters that change the QRS."""

from __future__ import annotations

import numpy as np

from fascicle.recording.quality.finding import Check, Finding, Severity
from fascicle.recording.recording import Recording

RATE = Check("sampling rate", "Hz", 500.0)  # AHA/ACC/HRS, see `check_filters`
DURATION = Check("duration", "s", 5.0)  # half of the 10 s of a standard recording
LOWPASS = Check("recorder's low-pass", "Hz", 150.0)  # for adults: AHA/ACC/HRS
HIGHPASS = Check("recorder's high-pass", "Hz", 0.5)  # above it the QRS itself changes, not only ST
MAINS_FILTER = Check("recorder's mains filter", "Hz", np.nan)
STRONG_LOWPASS = 40.0  # Hz; at and below it small deflections of the QRS vanish


def check_extent_in_time(recording: Recording) -> list[Finding]:
    """Compare the sampling rate (Hz) and the duration (s) with what is usual: two findings."""
    rate, duration = recording.sampling_rate, recording.duration
    slow, short = "", ""
    if rate < RATE.limit:
        slow = f"{rate:g} Hz blur the QRS; export the recording at {RATE.limit:g} Hz or more"
    if duration < DURATION.limit:
        short = f"{duration:.1f} s hold few beats, so their spread is uncertain; give 10 s"
    return [RATE.found(rate, slow), DURATION.found(duration, short)]


def check_filters(recording: Recording) -> list[Finding]:
    """Say what the filters that the file names do to the QRS.

    Returns
    -------
    list of Finding
        Low-pass, high-pass and notch (Hz); NaN where the file does not say, which is fine.

    References
    ----------
    P. Kligfield et al., Recommendations for the standardization and interpretation of the
    electrocardiogram, part I, Circulation 115:1306 (2007).
    """
    filters = recording.filters
    low, high, notch = "", "", ""
    if filters.lowpass is not None and filters.lowpass < LOWPASS.limit:
        much = "strongly " if filters.lowpass <= STRONG_LOWPASS else ""
        low = (
            f"the recorder's low-pass at {filters.lowpass:g} Hz {much}smooths the QRS "
            f"({LOWPASS.limit:g} Hz are recommended); export the recording unfiltered"
        )
    if filters.highpass is not None and filters.highpass > HIGHPASS.limit:
        high = (
            f"the recorder's high-pass at {filters.highpass:g} Hz bends the QRS and ST (0.05 Hz "
            "are recommended); export the recording unfiltered"
        )
    if filters.notch is not None:
        notch = f"note: the recorder's mains filter at {filters.notch:g} Hz was on"
    return [
        LOWPASS.found(_or_nan(filters.lowpass), low),
        HIGHPASS.found(_or_nan(filters.highpass), high),
        MAINS_FILTER.found(_or_nan(filters.notch), notch, Severity.FINE),
    ]


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
