"""Filters of the recorder that change the QRS."""

from __future__ import annotations

import numpy as np

from fascicle.recording.quality.finding import Finding, Severity, warning_if
from fascicle.recording.recording import Recording

LOWEST_LOWPASS = 150.0  # Hz; adults: AHA/ACC/HRS, Circulation 115:1306 (2007)
STRONG_LOWPASS = 40.0  # Hz; at and below it small deflections of the QRS vanish
HIGHEST_HIGHPASS = 0.5  # Hz; above it the QRS itself changes, not only ST


def check_filters(recording: Recording) -> list[Finding]:
    """Tell what the filters that the file names do to the QRS.

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
    low, high = "", ""
    if filters.lowpass is not None and filters.lowpass < LOWEST_LOWPASS:
        much = "strongly " if filters.lowpass <= STRONG_LOWPASS else ""
        low = (
            f"the recorder's low-pass at {filters.lowpass:g} Hz {much}smooths the QRS "
            f"({LOWEST_LOWPASS:g} Hz are recommended); export the recording unfiltered"
        )
    if filters.highpass is not None and filters.highpass > HIGHEST_HIGHPASS:
        high = (
            f"the recorder's high-pass at {filters.highpass:g} Hz bends the QRS and ST (0.05 Hz "
            "are recommended); export the recording unfiltered"
        )
    notch = ""
    if filters.notch is not None:
        notch = f"note: the recorder's mains filter at {filters.notch:g} Hz was on"
    return [
        warning_if(low, "recorder's low-pass", _or_nan(filters.lowpass), "Hz", LOWEST_LOWPASS),
        warning_if(high, "recorder's high-pass", _or_nan(filters.highpass), "Hz", HIGHEST_HIGHPASS),
        Finding(
            "recorder's mains filter", _or_nan(filters.notch), "Hz", np.nan, Severity.FINE, notch
        ),
    ]


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
