"""All checks of a recording, the most basic first."""

from __future__ import annotations

from collections.abc import Sequence

from fascicle.core.arrays import Integers
from fascicle.recording.filters import Filter
from fascicle.recording.quality import acquisition, disturbances, electrodes
from fascicle.recording.quality.check_result import CheckResult
from fascicle.recording.quality.identities import check_identities
from fascicle.recording.quality.synchrony import check_synchrony
from fascicle.recording.recording import Recording


def check_leads(recording: Recording) -> tuple[CheckResult, ...]:
    """What is wrong with leads whatever is in them: no signal, or another lead's."""
    return (*disturbances.check_flatness(recording), *disturbances.check_duplicates(recording))


def check_recording(
    recording: Recording, peaks: Integers, filters: Sequence[Filter]
) -> tuple[CheckResult, ...]:
    """Every check of a recording with a signal in each lead, also those that are fine.

    Leads may be absent, or recorded one group after another. NaN is the figure of a check that the
    recording does not allow; its message says so.

    Parameters
    ----------
    recording : Recording
        As it was read.
    peaks : (n_beats,) array
        Samples of its R peaks.
    filters : sequence of Filter
        Those that it has passed.
    """
    return (
        *check_synchrony(recording),
        *check_identities(recording),
        *electrodes.check_limb_electrodes(recording, electrodes.median_beat(recording, peaks)),
        *disturbances.check_noise(recording),
        *acquisition.check_clipping(recording),
        *disturbances.check_mains(recording),
        *disturbances.check_wander(recording),
        *acquisition.check_resolution(recording),
        *acquisition.check_extent_in_time(recording, len(peaks)),
        *acquisition.check_filters(recording, peaks, filters),
    )
