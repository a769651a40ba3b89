"""EDF recordings: calibration, labels, filters, and what is refused."""

import edfio
import numpy as np
import pytest
from refusals import read_as, refused, waves

from fascicle.core.leads import LEADS
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Filters

RANGE = 5000.0  # uV; 16 bits resolve 0.15 uV of it
DIGIT = 2 * RANGE / 65535 / 1000  # mV


@pytest.fixture
def signal():
    return waves(1000)


def signals(signal, labels=LEADS, **options):
    options = {"physical_dimension": "uV", "physical_range": (-RANGE, RANGE)} | options
    return [
        edfio.EdfSignal(1000 * lead, 500, label=label, **options)
        for label, lead in zip(labels, signal, strict=True)
    ]


def write(path, signals, annotations=None):
    edfio.Edf(signals, annotations=annotations, data_record_duration=1).write(path)
    return path


def test_values_rate_and_gain_of_leads_among_other_signals(tmp_path, signal):
    breath = edfio.EdfSignal(np.sin(np.arange(50.0)), 25, label="Resp", physical_dimension="l")
    annotations = [edfio.EdfAnnotation(0.5, None, "lead I off")]
    path = write(tmp_path / "a.edf", [breath, *signals(signal)], annotations)
    recording = read_as(path, signal, DIGIT)
    by_edfio = np.array([channel.data / 1000 for channel in edfio.read_edf(path).signals[1:]])
    assert recording.signal == pytest.approx(by_edfio, abs=1e-14)
    assert recording.sampling_rate == 500
    assert recording.digits_per_millivolt == pytest.approx(np.full(12, 1 / DIGIT))
    assert recording.provenance["format"] == "EDF/EDF+"
    assert recording.filters == Filters()
    assert recording.ignored == ("Resp",)


def test_wilson_reference_and_inverted_lead(tmp_path, signal):
    labels = [f"ECG {lead}-WCT" if lead[0] == "V" else lead for lead in LEADS]
    read_as(write(tmp_path / "a.edf", signals(signal, labels)), signal, DIGIT)
    for wrong in ("ECG -V1", "V1-V2"):
        labels = [wrong if lead == "V1" else lead for lead in LEADS]
        refused(write(tmp_path / "b.edf", signals(signal, labels)), "lead V1 missing")


@pytest.mark.parametrize(
    ("texts", "filters"),
    [
        (["HP:0.05Hz LP:150Hz N:50Hz"], Filters(0.05, 150, 50)),
        (["HP: 0,5 Hz LP: 40 Hz Notch: 60 Hz"], Filters(0.5, 40, 60)),
        (["HP:0.1 LP:75"], Filters(0.1, 75)),
        (["HP:0.3s LP:0.15kHz N:none", "HP:0Hz LP:0Hz"], Filters()),
        (["HP:0.5Hz LP:100Hz", "HP:0.05Hz LP:40Hz"], Filters(0.5, 40)),  # the narrowest passband
    ],
)
def test_filters(tmp_path, signal, texts, filters):
    made = [
        each
        for row, lead in enumerate(LEADS)
        for each in signals(signal[[row]], [lead], prefiltering=texts[row % len(texts)])
    ]
    assert read_recording(write(tmp_path / "a.edf", made)).filters == filters


def test_gaps_and_bdf_are_refused(tmp_path, signal):
    path = write(tmp_path / "a.edf", signals(signal), [edfio.EdfAnnotation(0, None, "x")])
    path.write_bytes(path.read_bytes().replace(b"EDF+C", b"EDF+D"))
    assert read_recording(path).duration == 2
    path.write_bytes(path.read_bytes().replace(b"+1\x14\x14", b"+9\x14\x14"))
    refused(path, "gaps between data records")
    bdf = [
        edfio.BdfSignal(1000 * lead, 500, label=label, physical_dimension="uV")
        for label, lead in zip(LEADS, signal, strict=True)
    ]
    edfio.Bdf(bdf).write(path)
    refused(path, "BDF", "export")
