"""Samples that were lost: what marks them, which are interpolated, and which are refused."""

import ast
import re

import clinical_files as files
import dicom_files
import h5py
import numpy as np
import pandas as pd
import pytest
from refusals import read_as, refused

from fascicle.core.leads import INDEPENDENT_LEADS, LEADS
from fascicle.recording.readers.read import Channel, read_recording, without_fill

ROWS = [LEADS.index(lead) for lead in INDEPENDENT_LEADS]
V2 = INDEPENDENT_LEADS.index("V2")


@pytest.fixture(scope="module")
def digits():
    """(8, 2000) integers in which a twentieth of the samples are 0, or more."""
    digits = files.heart_beats(seed=2)
    assert ((digits == 0).mean(axis=1) > 0.05).all()
    return digits


def save_dicom(folder, digits, fill):
    item = dicom_files.group(digits, INDEPENDENT_LEADS)
    dicom_files.change_leads(item, ChannelSensitivity="5")
    item.WaveformPaddingValue = np.int16(fill).tobytes()
    item["WaveformPaddingValue"].VR = "OW"
    return dicom_files.write(folder, item)


def save_hdf5(folder, digits, fill):
    with h5py.File(folder / "a.h5", "w") as file:
        file.attrs.update({"fs": 500, "leads": list(INDEPENDENT_LEADS), "units": "uV"})
        file["ecg"] = 5 * digits
        file["ecg"].attrs["_FillValue"] = 5 * fill
    return folder / "a.h5"


def save_table(folder, digits, fill):
    frame = pd.DataFrame(dict(zip(INDEPENDENT_LEADS, 5 * digits, strict=True)))
    text = frame.to_csv(index=False)
    (folder / "a.csv").write_text(f"# fs: 500\n# unit: uV\n# missing_value: {5 * fill}\n{text}")
    return folder / "a.csv"


def save_long_table(folder, digits, fill):
    frame = pd.DataFrame(
        {
            "lead": np.repeat(INDEPENDENT_LEADS, digits.shape[1]),
            "time_s": np.tile(np.arange(digits.shape[1]) / 500, len(digits)),
            "value_uV": 5 * digits.ravel(),
        }
    )
    (folder / "b.csv").write_text(f"# missing_value: {5 * fill}\n{frame.to_csv(index=False)}")
    return folder / "b.csv"


@pytest.mark.parametrize("save", [save_dicom, save_hdf5, save_table, save_long_table])
class TestFillValues:
    def test_that_the_signal_takes(self, tmp_path, digits, save):
        """A fill of 0 is signal where the signal passes 0, and a gap where it is away from it."""
        recording = read_as(save(tmp_path, digits, 0), 5e-3 * digits)
        assert not recording.remarks
        lost = digits + 100 * (np.arange(8) == V2)[:, None]
        lost[V2, 1000:1100] = 0
        refused(save(tmp_path, lost, 0), "lead V2 lacks 100 samples (first: sample 1000")
        lost = digits.copy()
        lost[V2, 700:1300] = 0  # longer than a signal stays at one value
        refused(save(tmp_path, lost, 0), "lead V2 lacks 60", "samples")

    def test_that_the_signal_does_not_take(self, tmp_path, digits, save):
        lost = digits.copy()
        lost[V2, 1000:1100] = -9999 // 5
        refused(save(tmp_path, lost, -9999 // 5), "lead V2 lacks 100 samples (first: sample 1000")


def test_isolated_fills_in_steep_waves_are_signal():
    still = np.tile([0.0, 1.0, 0.0, -1.0], 50)
    qrs = [20, 60, 90, 100, 90, 50, 0, -50, -20, 0, 4, 2]
    wave = np.concatenate([still, qrs, still])
    assert np.isfinite(without_fill(Channel("I", wave, missing=(0.0,)), 500.0)).all()
    wave[203] = 0.0  # at the top of the QRS
    kept = without_fill(Channel("I", wave, missing=(0.0,)), 500.0)
    assert np.flatnonzero(np.isnan(kept)).tolist() == [203]


class TestGaps:
    def test_short_ones_are_interpolated_and_told(self, tmp_path, digits):
        """An error of a few digits, where the QRS is 100 to 400 digits high and 40 ms wide."""
        lost = digits.copy()
        lost[V2, 740:745] = lost[0, 30:31] = -(2**15)  # 10 and 2 ms
        recording = read_recording(save_dicom(tmp_path, lost, -(2**15)))
        lead_i, lead_ii, lead_iii = recording.signal[:3]
        assert lead_i + lead_iii == pytest.approx(lead_ii, abs=1e-12)  # computed afterwards
        error = recording.signal[ROWS] / 5e-3 - digits
        assert np.abs(error).max() < 20
        assert np.count_nonzero(np.abs(error) > 1e-9) == pytest.approx(6, abs=1)
        assert "\n".join(recording.remarks) == (
            "missing samples were interpolated: 1 sample of lead I (at 0.060 s), 5 samples of lead "
            "V2 (at 1.480 s)"
        )

    @pytest.mark.parametrize(("samples", "every"), [(6, 1100), (1, 50)])
    def test_long_and_many_ones_are_refused_with_remedies_that_work(
        self, tmp_path, digits, samples, every
    ):
        lost = digits.copy()
        for k in range(samples):
            lost[V2, 300 + k :: every] = -(2**15)
        message = refused(save_dicom(tmp_path, lost, -(2**15)), "lead V2 lacks")
        leads = ast.literal_eval(re.search(r"leads=(\[.*\])", message)[1])
        recording = read_recording(tmp_path / "a.dcm", leads=leads)
        assert not recording.recorded[LEADS.index("V2")]
        part = re.search(r"cut the recording to (\S+) to (\S+) s", message)
        assert (part is None) == (every == 50)
        if part is not None:
            first, stop = (round(500 * float(end)) for end in part.groups())
            path = save_dicom(tmp_path, lost[:, first:stop], -(2**15))
            assert read_recording(path).duration == pytest.approx((stop - first) / 500)

    def test_of_all_leads(self, tmp_path, digits):
        lost = digits.copy()
        lost[:, 300:320] = -(2**15)
        path = save_dicom(tmp_path, lost, -(2**15))
        assert "leads=" not in refused(path, "to 0.640 to 4.000 s, which has no gaps")
        lost[:, 1200:1220] = -(2**15)
        refused(save_dicom(tmp_path, lost, -(2**15)), "give another recording")

    def test_ragged_ends_are_cut(self, tmp_path, digits):
        lost = digits.copy()
        lost[V2, :100] = lost[0, 1950:] = -(2**15)
        recording = read_as(save_dicom(tmp_path, lost, -(2**15)), 5e-3 * digits[:, 100:1950])
        assert "cut to 0.200 to 3.900 s" in "\n".join(recording.remarks)
