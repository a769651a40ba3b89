"""All checks of a recording, the most basic first."""

from __future__ import annotations

from fascicle.core.arrays import Integers
from fascicle.recording.quality.acquisition import (
    check_clipping,
    check_extent_in_time,
    check_filters,
    check_resolution,
)
from fascicle.recording.quality.disturbances import (
    check_duplicates,
    check_flatness,
    check_mains,
    check_noise,
    check_wander,
)
from fascicle.recording.quality.electrodes import check_limb_electrodes, median_beat
from fascicle.recording.quality.finding import Finding
from fascicle.recording.quality.identities import check_identities
from fascicle.recording.quality.synchrony import check_synchrony
from fascicle.recording.recording import Recording


def check_leads(recording: Recording) -> tuple[Finding, ...]:
    """What is wrong with leads whatever is in them: no signal, or another lead's."""
    return (*check_flatness(recording), *check_duplicates(recording))


def check_recording(recording: Recording, peaks: Integers) -> tuple[Finding, ...]:
    """Every check of a recording with a signal in each lead, also those that are fine.

    Leads may be absent, or recorded one group after another; the R peaks (n_beats,) are samples of
    ``recording.signal``. NaN is the figure of a check that the recording does not allow; its
    message says so.
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
