"""Targets of real recordings against manual and machine annotations."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import read_recording


def test_bundle_branch_blocks_are_wide_and_the_normal_is_not(data_folder):
    folder = data_folder / "ecg" / "ludb"
    width = {
        record: make_target(read_recording(folder / f"{record}_common")).qrs_duration
        for record in ("24", "23", "119")
    }
    assert width["24"] == pytest.approx(173, abs=8)
    assert width["23"] == pytest.approx(147, abs=8)
    assert width["119"] == pytest.approx(97, abs=8)


def test_detrended_beats_start_from_zero(data_folder):
    target = make_target(read_recording(data_folder / "ecg" / "ludb" / "24_common.hea"))
    before = (target.time >= target.qrs_onset - 15) & (target.time < target.qrs_onset)
    assert np.abs(target.mean[:, before]).max() < 0.02
    assert target.beats.shape == (7, 12, len(target.time))


def test_gain_per_lead_is_refused(data_folder):
    with pytest.raises(InputError, match=r"I \+ III - II is off by 0.19 mV.*--shared-gain"):
        make_target(read_recording(data_folder / "ecg" / "ludb" / "24.hea"))


def test_long_recording_keeps_its_beats(data_folder):
    target = make_target(read_recording(data_folder / "ecg" / "ptb-s0010" / "s0010_re.hea"))
    assert len(target.beats) >= 48
    assert target.heart_rate == pytest.approx(81.9, abs=0.5)
    assert target.qrs_duration == pytest.approx(140, abs=10)
