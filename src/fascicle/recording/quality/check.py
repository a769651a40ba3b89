"""All checks of a recording, the most basic first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.activity import activity
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


def check_leads(recording: Recording) -> tuple[Finding, ...]:
    """What is wrong with leads whatever is in them: no signal, or another lead's.

    Parameters
    ----------
    recording : Recording
        Twelve leads.
    """
    return (*check_flatness(recording), *check_duplicates(recording))


def check_recording(recording: Recording, peaks: NDArray[np.int64]) -> tuple[Finding, ...]:
    """Everything that the numbers of a recording with a signal in each lead say against it.

    Parameters
    ----------
    recording : Recording
        Twelve leads; any of them may be absent, and they may be recorded in turns.
    peaks : (n_beats,) array
        R peaks (samples of ``recording.signal``).

    Returns
    -------
    tuple of Finding
        Every check with its figure, also those that are fine. NaN is the figure of a check that
        the recording does not allow; its message says so.
    """
    moving = activity(recording)
    typical = typical_beat(recording, peaks)
    return (
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
