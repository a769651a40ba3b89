"""All checks of a recording, the most basic first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.activity import Activity, activity, beats, together
from fascicle.recording.quality.clipping import check_clipping
from fascicle.recording.quality.duplicates import check_duplicates
from fascicle.recording.quality.electrodes import check_limb_electrodes
from fascicle.recording.quality.extent import check_extent_in_time
from fascicle.recording.quality.filtering import check_filters
from fascicle.recording.quality.finding import Finding
from fascicle.recording.quality.flatness import check_flatness
from fascicle.recording.quality.identities import check_identities
from fascicle.recording.quality.mains import check_mains
from fascicle.recording.quality.noise import check_noise
from fascicle.recording.quality.resolution import check_resolution
from fascicle.recording.quality.synchrony import check_synchrony
from fascicle.recording.quality.typical import typical_beat
from fascicle.recording.quality.wander import check_wander
from fascicle.recording.recording import Recording


def check_recording(recording: Recording, peaks: NDArray[np.int64] | None) -> tuple[Finding, ...]:
    """Everything that the numbers of a recording say against it.

    Parameters
    ----------
    recording : Recording
        Twelve leads; any of them may be absent, and they may be recorded in turns.
    peaks : (n_beats,) array or None
        R peaks (samples of ``recording.signal``); None when they are not known, and then found
        roughly.

    Returns
    -------
    tuple of Finding
        Every check with its figure, also those that are fine. NaN is the figure of a check that
        the recording does not allow; its message says so.
    """
    moving = activity(recording)
    if peaks is None:
        peaks = _rough_peaks(recording, moving)
    typical = typical_beat(recording, peaks)
    return (
        *check_flatness(recording),
        *check_duplicates(recording),
        *check_synchrony(recording, moving),
        *check_identities(recording),
        *check_limb_electrodes(recording, typical),
        *check_noise(recording),
        *check_clipping(recording),
        *check_mains(recording),
        *check_wander(recording),
        *check_resolution(recording),
        *check_extent_in_time(recording),
        *check_filters(recording),
    )


def _rough_peaks(recording: Recording, moving: Activity) -> NDArray[np.int64]:
    """Middles of the QRS, by the activity of all leads."""
    found, _ = beats(together(moving.speed), moving.rate)
    return np.asarray(np.round(found * recording.sampling_rate / moving.rate), dtype=np.int64)
