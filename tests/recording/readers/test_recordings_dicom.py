"""DICOM waveform objects, good and bad, and a published one."""

import numpy as np
import pydicom
import pytest
from dicom_files import RATE, N, change_leads, code, digits, group, put, write
from pydicom.data import get_testdata_file
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    EncapsulatedPDFStorage,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
)
from refusals import read_as, refused

from fascicle.core.leads import LEADS
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import read_recording

# pydicom warns while it writes what these tests want to be wrong
pytestmark = pytest.mark.filterwarnings("ignore:Invalid value for VR:UserWarning")


def test_rhythm_in_mv_of_a_published_file():
    path = get_testdata_file("waveform_ecg.dcm", download=False)
    recording = read_recording(path)
    raw = pydicom.dcmread(path).waveform_array(0)
    assert recording.signal == pytest.approx(raw.T / 1000)
    assert recording.sampling_rate == 1000
    assert recording.digits_per_millivolt == pytest.approx(np.full(12, 800))
    assert recording.provenance["multiplex_group"] == "1"
    assert recording.provenance["multiplex_group_label"] == "RHYTHM"
    filters = recording.filters
    assert (filters.highpass, filters.lowpass, filters.notch) == (0.05, 300, None)


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, DeflatedExplicitVRLittleEndian])
def test_transfer_syntaxes(tmp_path, syntax):
    recording = read_as(write(tmp_path, group(digits()), syntax=syntax), 0.025 * digits())
    assert recording.sampling_rate == RATE


def test_sensitivity_correction_baseline_and_gain(tmp_path):
    item = group(digits())
    put(
        item.ChannelDefinitionSequence[7], ChannelSensitivity="5",
        ChannelSensitivityCorrectionFactor="-0.5", ChannelBaseline="100",
    )  # fmt: skip
    recording = read_recording(write(tmp_path, item))
    assert recording.signal[7] == pytest.approx((-2.5 * digits()[7] + 100) / 1000)
    assert recording.digits_per_millivolt[6:8] == pytest.approx([40, 400])


@pytest.mark.parametrize(
    ("elements", "word"),
    [
        ({"ChannelSensitivity": None}, "unknown unit of lead aVL"),
        ({"ChannelSensitivity": "0"}, "unknown unit of lead aVL"),
        ({"ChannelSensitivity": ["1", "2"]}, "damaged"),
        ({"ChannelSensitivity": "inf"}, "ChannelSensitivity is inf"),
        ({"ChannelBaseline": "nan"}, "ChannelBaseline is nan"),
        ({"ChannelSensitivityUnitsSequence": [code("1", "UCUM", "")]}, "lead aVL ('1')"),
        ({"ChannelSampleSkew": "0.6"}, "lead aVL is 0.6 samples apart"),
        ({"ChannelSampleSkew": None, "ChannelTimeSkew": "0.01"}, "aVL is 5 samples apart"),
        ({"ChannelOffset": "-0.004"}, "aVL is -2 samples apart"),
    ],
)
def test_channels_that_are_refused(tmp_path, elements, word):
    item = group(digits())
    put(item.ChannelDefinitionSequence[4], **elements)
    refused(write(tmp_path, item), word)


def test_multiplexing_is_no_skew(tmp_path):
    item = group(digits())
    for k, described in enumerate(item.ChannelDefinitionSequence):
        put(described, ChannelSampleSkew=f"{k / 25:.2f}")
    assert read_recording(write(tmp_path, item)).signal == pytest.approx(0.025 * digits())


def test_filters_are_the_narrowest_of_the_leads(tmp_path):
    item = group(digits())
    for described, low, high in zip(
        item.ChannelDefinitionSequence, ["0.05", "0.5", "0"] * 4, ["150", "40", "300"] * 4,
        strict=True,
    ):  # fmt: skip
        put(described, FilterLowFrequency=low, FilterHighFrequency=high, NotchFilterFrequency="50")
    filters = read_recording(write(tmp_path, item)).filters
    assert (filters.highpass, filters.lowpass, filters.notch) == (0.5, 40, 50)
    assert read_recording(write(tmp_path, group(digits()))).filters.lowpass is None


@pytest.mark.parametrize(
    "source",
    [
        code("5.6.3-9-5", "SCPECG", "Lead V3"),
        code("2:5", "mdc", "chest"),
        code("2:1", "99MAKER", "V3"),  # not of the scheme whose code for lead I it is
    ],
)
def test_codes_and_meanings(tmp_path, source):
    item = group(digits())
    put(item.ChannelDefinitionSequence[8], ChannelSourceSequence=[source])
    assert read_recording(write(tmp_path, item)).signal[8] == pytest.approx(0.025 * digits()[8])


def test_other_leads_are_ignored_and_need_no_calibration(tmp_path):
    samples = np.concatenate([digits(), digits()[:1]])
    item = group(samples, [*LEADS, "aVR"])
    put(
        item.ChannelDefinitionSequence[12], ChannelSensitivity=None, ChannelLabel="aVR",
        ChannelSourceSequence=[code("2:65", "MDC", "Lead -aVR")],
    )  # fmt: skip
    recording = read_as(write(tmp_path, item), 0.025 * digits())
    assert recording.ignored == ("Lead -aVR",)


class TestGroups:
    def thirds(self, offsets, rates=(RATE,) * 4, n=N):
        """Four groups of three leads."""
        return [
            group(
                digits(n)[3 * k : 3 * k + 3], LEADS[3 * k : 3 * k + 3],
                MultiplexGroupTimeOffset=offset, SamplingFrequency=str(rate),
            )
            for k, (offset, rate) in enumerate(zip(offsets, rates, strict=True))
        ]  # fmt: skip

    def test_leads_in_turns(self, tmp_path):
        path = write(tmp_path, *self.thirds(["100", "2100", "4100", "6100"]))
        recording = read_recording(path)
        assert not recording.simultaneous
        assert recording.signal.shape == (12, 4 * N)
        starts = np.repeat([0, 1000, 2000, 3000], 3)
        assert recording.spans == pytest.approx(np.stack([starts, starts + N], axis=1))
        for row, start in enumerate(starts):
            assert recording.signal[row, start : start + N] == pytest.approx(0.025 * digits()[row])
        assert recording.provenance["multiplex_group"] == "1, 2, 3, 4"

    @pytest.mark.parametrize("place", [0, 4])
    def test_rhythm_strip(self, tmp_path, place):
        """A lead that runs through all groups is in each of them."""
        groups = self.thirds(["0", "2000", "4000", "6000"])
        strip = group(digits(4 * N)[1:2], ["II"], MultiplexGroupTimeOffset="0")
        groups.insert(place, strip)
        recording = read_recording(write(tmp_path, *groups))
        assert recording.provenance["multiplex_group"] == "1, 2, 3, 4, 5"
        assert recording.signal[1] == pytest.approx(0.025 * digits(4 * N)[1])
        assert recording.signal[11, 3 * N :] == pytest.approx(0.025 * digits()[11])
        put(strip, MultiplexGroupTimeOffset=None)  # without, it cannot be placed
        assert np.isfinite(read_recording(write(tmp_path, *groups)).signal[1]).sum() == N

    @pytest.mark.parametrize("strip", [False, True])
    def test_channels_that_are_empty_in_a_group(self, tmp_path, strip):
        """All channels in each group, constant where they were not recorded."""
        groups = []
        for k in range(4):
            samples = np.full((12, N), 7)
            samples[3 * k : 3 * k + 3] = digits()[3 * k : 3 * k + 3]
            if strip:
                samples[1] = digits(4 * N)[1, k * N : (k + 1) * N]
            groups.append(group(samples, MultiplexGroupTimeOffset=str(2000 * k)))
        recording = read_recording(write(tmp_path, *groups))
        starts = np.repeat([0, 1000, 2000, 3000], 3)
        spans = np.stack([starts, starts + N], axis=1)
        spans[1, 1] = 4 * N if strip else N
        assert recording.spans.tolist() == spans.tolist()
        for row, (start, stop) in enumerate(spans):
            whole = digits(4 * N)[row, : stop - start]
            assert recording.signal[row, start:stop] == pytest.approx(0.025 * whole)

    def test_a_lead_without_signal_in_any_group_was_not_recorded(self, tmp_path):
        groups = self.thirds(["0", "2000", "4000", "6000"])
        samples = digits()[9:].copy()
        samples[2] = 0
        groups[3] = group(samples, LEADS[9:], MultiplexGroupTimeOffset="6000")
        refused(write(tmp_path, *groups), "lead V6 missing", "constant or empty: V6")

    def test_groups_that_share_leads(self, tmp_path):
        """Two groups with the limb leads in both, as of a recorder with six channels."""
        both = [("I", "II", "V1", "V2", "V3"), ("I", "II", "V4", "V5", "V6")]
        groups = [
            group(
                digits(2 * N)[[LEADS.index(lead) for lead in leads], k * N : (k + 1) * N], leads,
                MultiplexGroupTimeOffset=str(2000 * k),
            )
            for k, leads in enumerate(both)
        ]  # fmt: skip
        recording = read_recording(write(tmp_path, *groups))
        assert recording.signal[:2] == pytest.approx(0.025 * digits(2 * N)[:2])
        assert np.isfinite(recording.signal[6:9, :N]).all()
        assert np.isfinite(recording.signal[9:, N:]).all()
        # apart in time, the longer part of a lead counts
        put(groups[1], MultiplexGroupTimeOffset="2600")
        assert (np.isfinite(read_recording(write(tmp_path, *groups)).signal[:2]).sum(1) == N).all()

    def test_averaged_beats_are_the_last_resort(self, tmp_path):
        median = group(digits(600), MultiplexGroupLabel="MEDIAN BEAT", MultiplexGroupTimeOffset="0")
        path = write(tmp_path, median, *self.thirds(["0", "2000", "4000", "6000"]))
        assert read_recording(path).provenance["multiplex_group"] == "2, 3, 4, 5"
        path = write(tmp_path, median, *self.thirds(["0", "2000", "4000", "6000"])[:3])
        assert read_recording(path).provenance["multiplex_group"] == "1"
        derived = group(digits(600), WaveformOriginality="DERIVED", SamplingFrequency="1000")
        change_leads(derived, ChannelSensitivity=None)  # is not read, and need not be calibrated
        recording = read_recording(write(tmp_path, derived, group(digits())))
        assert recording.provenance["multiplex_group"] == "2"
        assert recording.signal.shape == (12, N)

    def test_groups_that_cannot_be_joined(self, tmp_path):
        path = write(tmp_path, *self.thirds(["0", "2000", "4000", ""]))
        refused(path, "without time offsets")
        path = write(tmp_path, *self.thirds(["0"] * 4, rates=(500, 500, 250, 500)))
        refused(path, "V1, V2, V3 are sampled at 250 Hz, I, II, III at 500 Hz")
        path = write(tmp_path, *self.thirds(["0", "0", "0", "99999999999999"]))
        refused(path)
        refused(write(tmp_path, *self.thirds(["0", "0", "0", "500"])), "lead I lacks")

    def test_a_rhythm_strip_aligns_the_groups(self, data_folder):
        target = make_target(read_recording(data_folder / "cases" / "c12_4x3_rhythm.dcm"))
        assert target.qrs_onset == pytest.approx(-45, abs=4)
        assert target.qrs_offset == pytest.approx(50, abs=4)
        assert "aligned by lead II" in "\n".join(target.warnings)


@pytest.mark.parametrize(
    "elements",
    [
        {"SamplingFrequency": "nan"}, {"NumberOfWaveformSamples": None},
        {"ChannelDefinitionSequence": None}, {"WaveformData": None}, {"WaveformBitsAllocated": 12},
        {"WaveformBitsAllocated": 8, "WaveformSampleInterpretation": "MB"},
    ],
)  # fmt: skip
def test_groups_that_are_refused(tmp_path, elements):
    item = group(digits())
    put(item, **elements)
    refused(write(tmp_path, item))


class TestOtherFiles:
    def test_no_waveform(self, tmp_path):
        path = write(tmp_path, WaveformSequence=None, SOPClassUID=EncapsulatedPDFStorage)
        refused(path, "without a waveform", "without encryption")
        refused(write(tmp_path), "without a waveform")

    def test_compressed_and_other_syntaxes(self, tmp_path):
        path = write(tmp_path, group(digits()), syntax=ExplicitVRBigEndian)
        refused(path, "Explicit VR Big Endian", "Explicit VR Little Endian")
        item = group(digits())
        item["WaveformData"].VR = "OB"
        item["WaveformData"].is_undefined_length = True
        item.WaveformData = pydicom.encaps.encapsulate([item.WaveformData])
        refused(write(tmp_path, item), "is compressed")
