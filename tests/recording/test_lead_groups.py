"""Recordings whose leads were recorded one group after another, made of complete ones."""

from dataclasses import replace

import numpy as np
import pytest
from quality_recordings import on_paper, synthetic

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.choices import TargetOptions
from fascicle.recording.lead_groups import lead_groups
from fascicle.recording.pipeline import analyse, make_target

GROUPS = (("I", "II", "III"), ("aVR", "aVL", "aVF"), ("V1", "V2", "V3"), ("V4", "V5", "V6"))


def whole(seed, heart_rate=80.0, noise_db=30.0, **more):
    more = {"heart_rate": heart_rate, "noise_db": noise_db, "respiration": 0.02} | more
    return synthetic(seed, **more)[0]


def parts_of(recording):
    """Start (s), leads and length (s) of each group."""
    groups = lead_groups(recording, np.empty((0, 2), dtype=np.int64), TargetOptions())
    return [(part.start, part.leads, part.signal.shape[1] / 1000) for part in groups]


def test_stretches_are_found_in_spite_of_ragged_edges():
    for strip in (None, "II"):
        leads = [
            ", ".join(lead for lead in LEADS if lead in group or lead == strip) for group in GROUPS
        ]
        expected = [(2.5 * k, names, 2.5) for k, names in enumerate(leads)]
        assert parts_of(on_paper(whole(0), strip)) == expected
    paper = on_paper(whole(3))
    signal = paper.signal.copy()
    rng = np.random.default_rng(0)
    for row in range(12):
        first, stop = paper.spans[row]
        signal[row, first : first + rng.integers(0, 9)] = np.nan
        signal[row, stop - rng.integers(1, 9) : stop] = np.nan
    found = parts_of(replace(paper, signal=signal))
    assert [names for _, names, _ in found] == [", ".join(group) for group in GROUPS]


@pytest.mark.parametrize(("strip", "tolerance"), [(None, 15), ("II", 4)])
def test_the_mean_is_that_of_all_leads_at_once(strip, tolerance):
    for seed in range(2):
        recording = whole(seed)
        target = make_target(recording)
        paper = make_target(on_paper(recording, strip))
        assert paper.used.all()
        assert len(paper.beats) >= 2
        for lead in range(12):
            template = target.mean[lead, target.qrs_samples]
            start = int(np.flatnonzero(paper.time == target.time[target.qrs_samples.start])[0])
            tries = range(max(start - 40, 0), start + 41)
            misfit = [
                np.sum((paper.mean[lead, s : s + len(template)] - template) ** 2) for s in tries
            ]
            best = list(tries)[int(np.argmin(misfit))] - start
            assert abs(best) <= tolerance + 3, (seed, LEADS[lead])
            assert min(misfit) < 0.1 * np.sum(template**2) + 0.02
        assert paper.qrs_duration == pytest.approx(target.qrs_duration, abs=25)
        assert "one group after another" in "\n".join(paper.warnings)


def test_beats_are_numbered_through_and_surplus_ones_not_used():
    analysis = analyse(on_paper(whole(1)))
    assert [beat.number for beat in analysis.beats] == list(range(1, len(analysis.beats) + 1))
    times = [beat.time for beat in analysis.beats]
    assert times == sorted(times)
    assert times[-1] > 7.5
    assert analysis.signal.shape == (12, 10000)
    assert np.isfinite(analysis.signal[LEADS.index("V4")]).sum() == 2500
    assert sum(beat.used for beat in analysis.beats) == 4 * len(analysis.target.beats)
    assert analysis.target.onset_sd > 10  # the standard deviation of the alignment is in it


def test_pacing_spikes_at_the_end_of_a_group_leave_it_whole():
    """A line across a spike cannot end where a lead is not recorded."""
    paper = on_paper(whole(4, rhythm="paced", spike_size=10.0, noise_db=None))
    analysis = analyse(paper)
    assert len(analysis.spikes) > 5
    assert (np.isfinite(analysis.signal).sum(axis=1) == 2500).all()


def test_beats_of_several_shapes_are_not_matched_by_chance():
    recording = whole(5, rhythm="bigeminy", heart_rate=70.0, seconds=16.0)
    with pytest.raises(
        InputError, match="one group after another and the beats are of several shapes"
    ):
        make_target(on_paper(recording))
