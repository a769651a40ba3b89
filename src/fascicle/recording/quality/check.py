"""All checks of a recording, the most basic first."""

from __future__ import annotations

from fascicle.core.arrays import Integers
from fascicle.recording.quality.acquisition import check_extent_in_time, check_filters
from fascicle.recording.quality.digits import check_clipping, check_resolution
from fascicle.recording.quality.disturbances import check_mains, check_noise, check_wander
from fascicle.recording.quality.electrodes import check_limb_electrodes, median_beat
from fascicle.recording.quality.empty_leads import check_duplicates, check_flatness
from fascicle.recording.quality.finding import Finding
from fascicle.recording.quality.identities import check_identities
from fascicle.recording.quality.synchrony import check_synchrony
from fascicle.recording.recording import Recording


def check_leads(recording: Recording) -> tuple[Finding, ...]:
    """What is wrong with leads whatever is in them: no signal, or another lead's."""
    return (*check_flatness(recording), *check_duplicates(recording))


def check_recording(recording: Recording, peaks: Integers) -> tuple[Finding, ...]:
    """Everything that the numbers of a recording with a signal in each lead say against it.

    Parameters
    ----------
    recording : Recording
        Twelve leads; any of them may be absent, and they may be recorded one group after another.
    peaks : (n_beats,) array
        R peaks (samples of ``recording.signal``).

    Returns
    -------
    tuple of Finding
        Every check with its figure, also those that are fine. NaN is the figure of a check that
        the recording does not allow; its message says so.
    """
    return (
        *check_synchrony(recording),
        *check_identities(recording),
        *check_limb_electrodes(recording, median_beat(recording, peaks)),
        *check_noise(recording),
        *check_clipping(recording),
        *check_mains(recording),
        *check_wander(recording),
        *check_resolution(recording),
        *check_extent_in_time(recording),
        *check_filters(recording),
    )
