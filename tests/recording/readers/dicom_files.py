"""Writers of DICOM waveform objects; everything that a test wants wrong is an argument."""

from __future__ import annotations

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, TwelveLeadECGWaveformStorage, generate_uid
from refusals import waves

from fascicle.core.leads import LEADS

RATE, N = 500, 1000
MDC = dict(zip(LEADS, (1, 2, 61, 62, 63, 64, *range(3, 9)), strict=True))


def digits(n=N, amplitude=40):
    """(12, n) integers within 8 bits, every lead different."""
    return np.round(amplitude * waves(n)).astype(np.int64)


def code(value, scheme, meaning=""):
    item = Dataset()
    item.CodeValue, item.CodingSchemeDesignator, item.CodeMeaning = value, scheme, meaning
    return item


def channel(lead):
    item = Dataset()
    item.ChannelSourceSequence = [code(f"2:{MDC[lead]}", "MDC", f"Lead {lead}")]
    item.ChannelSensitivity = "25"
    item.ChannelSensitivityUnitsSequence = [code("uV", "UCUM", "microvolt")]
    item.ChannelSensitivityCorrectionFactor = "1"
    item.ChannelBaseline = "0"
    item.ChannelSampleSkew = "0"
    item.WaveformBitsStored = 16
    return item


def group(samples, leads=LEADS, **elements):
    """A multiplex group of samples (channels, n)."""
    item = Dataset()
    item.WaveformOriginality = "ORIGINAL"
    item.NumberOfWaveformChannels, item.NumberOfWaveformSamples = samples.shape
    item.SamplingFrequency = str(RATE)
    item.WaveformBitsAllocated, item.WaveformSampleInterpretation = 16, "SS"
    item.ChannelDefinitionSequence = [channel(lead) for lead in leads]
    item.WaveformData = samples.T.astype("<i2").tobytes()
    item["WaveformData"].VR = "OW"
    return put(item, **elements)


def put(item, **elements):
    """Set elements of a dataset; None takes one away."""
    for keyword, value in elements.items():
        if value is None:
            delattr(item, keyword)
        else:
            setattr(item, keyword, value)
    return item


def write(folder, *groups, syntax=ExplicitVRLittleEndian, **elements):
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = syntax
    dataset.SOPClassUID = TwelveLeadECGWaveformStorage
    dataset.SOPInstanceUID = generate_uid(entropy_srcs=["a test"])
    dataset.Modality = "ECG"
    dataset.WaveformSequence = list(groups)
    put(dataset, **elements)
    dataset.save_as(folder / "a.dcm", enforce_file_format=True)
    return folder / "a.dcm"


def change_leads(group, **elements):
    for item in group.ChannelDefinitionSequence:
        put(item, **elements)
    return group
