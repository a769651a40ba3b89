"""Whether the recording is fine enough in time, and long enough."""

from __future__ import annotations

from fascicle.recording.quality.finding import Finding, warning_if
from fascicle.recording.recording import Recording

RECOMMENDED_RATE = 500.0  # Hz; AHA/ACC/HRS, Circulation 115:1306 (2007)
SHORT = 5.0  # s; half of the 10 s of a standard recording


def check_extent_in_time(recording: Recording) -> list[Finding]:
    """Compare the sampling rate (Hz) and the duration (s) with what is usual.

    Returns
    -------
    list of Finding
        Two; warnings below `RECOMMENDED_RATE` and below `SHORT`.

    References
    ----------
    P. Kligfield et al., Recommendations for the standardization and interpretation of the
    electrocardiogram, part I, Circulation 115:1306 (2007).
    """
    rate, duration = recording.sampling_rate, recording.duration
    slow = ""
    if rate < RECOMMENDED_RATE:
        slow = f"{rate:g} Hz blur the QRS; export the recording at {RECOMMENDED_RATE:g} Hz or more"
    short = ""
    if duration < SHORT:
        short = f"{duration:.1f} s hold few beats, so their spread is uncertain; give 10 s"
    return [
        warning_if(slow, "sampling rate", rate, "Hz", RECOMMENDED_RATE),
        warning_if(short, "duration", duration, "s", SHORT),
    ]
