"""EDF recordings, good, bad and damaged."""

import edfio
import numpy as np
import pytest
from refusals import read_as, refused, waves

from fascicle.core.leads import LEADS
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Filters

RATE, N = 500, 1000
RANGE = 5000.0  # uV; 16 bits resolve 0.15 uV of it
DIGIT = 2 * RANGE / 65535 / 1000  # mV
BLOCK = 256
# Byte offsets of the fields of a signal, times the number of signals
LABEL, UNIT, PHYSICAL_MIN, PHYSICAL_MAX, DIGITAL_MIN, DIGITAL_MAX = 0, 96, 104, 112, 120, 128


@pytest.fixture
def signal():
    return waves(N)


def signals(signal, labels=LEADS, scale=1000.0, rate=RATE, **options):
    options = {"physical_dimension": "uV", "physical_range": (-RANGE, RANGE)} | options
    return [
        edfio.EdfSignal(scale * lead, rate, label=label, **options)
        for label, lead in zip(labels, signal, strict=True)
    ]


def write(path, signals, annotations=None):
    edfio.Edf(signals, annotations=annotations, data_record_duration=1).write(path)
    return path


def patch(path, offset, text, length=8):
    data = bytearray(path.read_bytes())
    data[offset : offset + length] = text.encode("latin-1").ljust(length)
    path.write_bytes(data)
    return path


def field(offset, number, count, length=8):
    """Offset of a field of one signal in the header."""
    return BLOCK + offset * count + length * number


class TestRead:
    def test_values_rate_and_gain(self, tmp_path, signal):
        path = write(tmp_path / "a.edf", signals(signal))
        recording = read_recording(path)
        by_edfio = np.array([channel.data / 1000 for channel in edfio.read_edf(path).signals])
        assert recording.signal == pytest.approx(by_edfio, abs=1e-14)
        assert recording.signal == pytest.approx(signal, abs=DIGIT)
        assert recording.sampling_rate == 500
        assert recording.digits_per_millivolt == pytest.approx(np.full(12, 1 / DIGIT))
        assert recording.provenance["format"] == "EDF/EDF+"
        assert recording.filters == Filters()

    def test_wilson_reference_and_inverted_lead(self, tmp_path, signal):
        labels = [f"ECG {lead}-WCT" if lead[0] == "V" else lead for lead in LEADS]
        read_as(write(tmp_path / "a.edf", signals(signal, labels)), signal, DIGIT)
        labels = ["ECG -V1" if lead == "V1" else f"ECG {lead}" for lead in LEADS]
        refused(write(tmp_path / "b.edf", signals(signal, labels)), "lead V1 missing")
        labels = ["V1-V2" if lead == "V1" else lead for lead in LEADS]
        refused(write(tmp_path / "c.edf", signals(signal, labels)), "lead V1 missing")

    def test_other_signals_and_annotations_are_left_out(self, tmp_path, signal):
        breath = edfio.EdfSignal(np.sin(np.arange(50.0)), 25, label="Resp", physical_dimension="l")
        path = write(
            tmp_path / "a.edf",
            [breath, *signals(signal)],
            [edfio.EdfAnnotation(0.5, None, "lead I off")],
        )
        recording = read_as(path, signal, DIGIT)
        assert recording.ignored == ("Resp",)

    @pytest.mark.parametrize(
        ("text", "filters"),
        [
            ("HP:0.05Hz LP:150Hz N:50Hz", Filters(0.05, 150, 50)),
            ("HP: 0,5 Hz LP: 40 Hz Notch: 60 Hz", Filters(0.5, 40, 60)),
            ("HP:0.1 LP:75", Filters(0.1, 75)),
            ("HP:0Hz LP:0Hz", Filters()),
            ("HP:0.3s LP:0.15kHz N:none", Filters()),
            ("", Filters()),
        ],
    )
    def test_filters(self, tmp_path, signal, text, filters):
        path = write(tmp_path / "a.edf", signals(signal, prefiltering=text))
        assert read_recording(path).filters == filters

    def test_narrowest_passband_where_leads_differ(self, tmp_path, signal):
        first = signals(signal[:6], LEADS[:6], prefiltering="HP:0.5Hz LP:100Hz")
        rest = signals(signal[6:], LEADS[6:], prefiltering="HP:0.05Hz LP:40Hz")
        path = write(tmp_path / "a.edf", [*first, *rest])
        assert read_recording(path).filters == Filters(0.5, 40)

    def test_physical_range_may_run_downward(self, tmp_path, signal):
        path = write(tmp_path / "a.edf", signals(signal))
        patch(path, field(PHYSICAL_MIN, 0, 12), "5000")
        patch(path, field(PHYSICAL_MAX, 0, 12), "-5000")
        recording = read_recording(path)
        assert recording.signal[0] == pytest.approx(-signal[0], abs=DIGIT)
        assert recording.signal[1] == pytest.approx(signal[1], abs=DIGIT)


class TestRefused:
    def test_interrupted(self, tmp_path, signal):
        path = write(tmp_path / "a.edf", signals(signal), [edfio.EdfAnnotation(0, None, "x")])
        patch(path, 192, "EDF+D", 5)
        assert read_recording(path).duration == 2
        path.write_bytes(path.read_bytes().replace(b"+1\x14\x14", b"+9\x14\x14"))
        refused(path, "gaps between data records")

    def test_bdf(self, tmp_path, signal):
        bdf = [
            edfio.BdfSignal(1000 * lead, RATE, label=label, physical_dimension="uV")
            for label, lead in zip(LEADS, signal, strict=True)
        ]
        edfio.Bdf(bdf).write(tmp_path / "a.edf")
        refused(tmp_path / "a.edf", "BDF", "export")

    @pytest.mark.parametrize(
        ("offset", "value", "word"),
        [
            (DIGITAL_MIN, "32767", "unknown amplitude of lead aVR"),
            (PHYSICAL_MIN, "5000", "unknown amplitude of lead aVR"),
            (PHYSICAL_MIN, "nan", "unknown amplitude of lead aVR"),
            (PHYSICAL_MAX, "1e999", "aVR"),
            (PHYSICAL_MAX, "x", "damaged"),
            (DIGITAL_MIN, "", "damaged"),
        ],
    )
    def test_no_calibration(self, tmp_path, signal, offset, value, word):
        path = patch(write(tmp_path / "a.edf", signals(signal)), field(offset, 3, 12), value)
        refused(path, word)
        refused(path, word, unit="uV")

    @pytest.mark.parametrize(
        ("offset", "text", "length"),
        [
            (236, "0", 8), (236, "two", 8), (252, "0", 4),
            (252, "-12", 4), (252, "9999", 4), (244, "0", 8), (244, "-1", 8), (244, "nan", 8),
            (244, "1e-300", 8), (244, "86400", 8),
        ],
    )  # fmt: skip
    def test_damaged_header(self, tmp_path, signal, offset, text, length):
        refused(patch(write(tmp_path / "a.edf", signals(signal)), offset, text, length))
