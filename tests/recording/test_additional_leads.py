"""Leads besides the twelve: which channels they are, and that they decide nothing."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from quality_recordings import analysed, beating

from fascicle.cli.options import lead_names
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.prediction.indices import vectorcardiogram
from fascicle.recording.choices import invert, share_gain
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.names import additional_lead_name
from fascicle.recording.readers.read import read_recording


@pytest.fixture(scope="module")
def recording():
    return beating(seconds=6.0)


@pytest.fixture(scope="module")
def more(recording):
    """V7 as V6, and an X that is wilder than any lead, with a drift and the beats of another."""
    v6, times = recording.signal[11], np.arange(recording.signal.shape[1])
    wild = 3.0 * np.roll(recording.signal[7], 100) + 0.4 * np.sin(times / 400.0)
    return replace(recording, additional={"V7": 0.7 * v6, "X": wild})


@pytest.fixture
def table(recording, tmp_path):
    """A table of the twelve leads and columns of other names, and what reads it."""

    def read(columns, **options):
        names = ["time_ms", *(f"{lead}_mV" for lead in LEADS), *columns]
        time = 2.0 * np.arange(recording.signal.shape[1])
        rows = np.column_stack([time, recording.signal.T, *columns.values()])
        path = tmp_path / "recording.csv"
        np.savetxt(path, rows, "%.5f", ",", header=",".join(names), comments="")
        return read_recording(path, **options)

    return read


def test_spellings_and_lists_of_leads():
    for lead, spellings in {
        "V7": ["v7", "Lead V7", "MDC_ECG_LEAD_V7"],
        "V4R": ["V4R", "lead_V4R"],
        "X": ["x", "VX", "Frank X", "MDC_ECG_LEAD_X"],
        None: ["V6", "VR", "MLII", "V10", "V1R", "vx2", "xyz", "", "acc_x", "E1"],
    }.items():
        assert {additional_lead_name(spelling) for spelling in spellings} == {lead}
    assert lead_names("I,II,V1-V3") == ["I", "II", "V1", "V2", "V3"]
    assert lead_names("V6-V9,vx-vz") == ["V6", "V7", "V8", "V9", "X", "Y", "Z"]
    assert lead_names("aVF,E9-E11,n3") == ["aVF", "E9", "E10", "E11", "n3"]
    for text in ("V3-V1", "E4-E2", "E1-F3", "J", "I-V2-V3", ""):
        with pytest.raises(InputError, match=f"^leads '{text}'"):
            lead_names(text)


def test_channels_of_standard_names_are_kept(table, recording):
    v6 = recording.signal[11]
    found = table({"V7_mV": v6, "vx_uV": 500 * v6, "pressure_mmHg": v6, "E1_mV": v6})
    assert [*found.additional] == ["V7", "X"]
    assert found.ignored == ("pressure_mmHg", "E1_mV")
    np.testing.assert_allclose(found.additional["X"], 0.5 * v6, atol=1e-5)
    np.testing.assert_allclose(found.signal, recording.signal, atol=1e-5)


def test_other_channels_are_kept_by_name(table, recording):
    columns = {f"E{k}_mV": k * recording.signal[6] for k in range(1, 4)}
    found = table(columns, leads=[*LEADS, "E2", "E3"])
    assert [*found.additional] == ["E2", "E3"]
    np.testing.assert_allclose(found.additional["E3"], 3 * recording.signal[6], atol=1e-4)
    with pytest.raises(InputError, match="lead E4 missing"):
        table(columns, leads=[*LEADS, "E4"])


def test_what_is_no_potential_or_has_gaps_is_not_a_lead(table, recording):
    """The axes of an accelerometer are called X, Y and Z, too."""
    gaps = recording.signal[6].copy()
    gaps[100:900] = np.nan
    columns = {"X_g": gaps, "V8_mV": gaps, "V7_mV": np.zeros(len(gaps))}
    found = table(columns | {"V9_mV": recording.signal[6]})
    assert [*found.additional] == ["V9"]
    assert sorted(found.ignored) == ["V7_mV", "V8_mV", "X_g"]
    with pytest.raises(InputError, match="lead V8 is constant, was not recorded all of the time"):
        table({"V8_mV": gaps}, leads=[*LEADS, "V8"])


def test_decide_nothing(recording, more):
    """Beats, window and the twelve leads are the same to the last bit."""
    plain, target = make_target(recording), make_target(more)
    assert target.leads == (*LEADS, "V7", "X")
    np.testing.assert_array_equal(target.beats[:, :12], plain.beats)
    assert (target.qrs_onset, target.qrs_offset) == (plain.qrs_onset, plain.qrs_offset)
    assert (target.onset_sd, target.offset_sd) == (plain.onset_sd, plain.offset_sd)
    np.testing.assert_allclose(target.mean[12], 0.7 * plain.mean[11], atol=1e-6)
    assert np.isfinite(target.beats[:, 13]).all()
    chosen = {"beats": (3,), "noise": 0.02, "lowpass": 60.0}
    single, with_more = make_target(recording, **chosen), make_target(more, **chosen)
    np.testing.assert_array_equal(with_more.beats[:, :12], single.beats)
    assert with_more.onset_sd == single.onset_sd
    np.testing.assert_allclose(with_more.mean[12], 0.7 * single.mean[11], atol=1e-6)


@pytest.mark.parametrize("long", [False, True])
def test_of_groups_one_after_another(tmp_path, recording, long):
    """V7 is that of its group, in a table with empty cells or with a row for each lead and time."""
    n = recording.signal.shape[1]
    half, time = n // 2, 2.0 * np.arange(n)
    rows = dict(zip(LEADS, recording.signal.copy(), strict=True)) | {
        "V7": 0.7 * recording.signal[11],
        "V4R": recording.signal[5].copy(),
    }
    for k, values in enumerate(rows.values()):
        values[slice(half, None) if k < 6 else slice(half)] = np.nan
    rows["V4R"][half + 100 : half + 900] = np.nan
    frame = pd.DataFrame({"time_ms": time, **{f"{lead}_mV": x for lead, x in rows.items()}})
    if long:
        tall = frame.rename(columns=lambda name: name.removesuffix("_mV")).melt(
            "time_ms", var_name="lead", value_name="value_mV"
        )
        frame = tall[tall["lead"] != "V4R"].dropna()
    frame.to_csv(tmp_path / "a.csv", index=False)
    found = read_recording(tmp_path / "a.csv")
    assert [*found.additional] == ["V7"]
    target = make_target(found)
    plain = make_target(read_recording(tmp_path / "a.csv", leads=LEADS))
    np.testing.assert_array_equal(target.beats[:, :12], plain.beats)
    np.testing.assert_allclose(target.mean[12], 0.7 * target.mean[11], atol=1e-5)


def test_are_checked_and_corrected(more):
    flat = replace(more, additional=more.additional | {"V7": 0.0 * more.signal[0]})
    with pytest.raises(
        InputError, match=r"no signal in lead V7; go on without: leads=\[.*'V6', 'X'\]$"
    ):
        make_target(flat)
    turned = invert(more, "X")
    np.testing.assert_array_equal(turned.additional["X"], -more.additional["X"])
    gains = replace(more, digits_per_millivolt=np.linspace(900.0, 1100.0, 12))
    with pytest.raises(InputError, match="the leads V7, X keep their gains"):
        share_gain(gains)


def test_frank_leads_of_a_recording(data_folder):
    """Of the PTB database: those that Kors' regression makes of the twelve, Z to the back."""
    path = data_folder / "ecg" / "ptb-s0010" / "s0010_re"
    target = analysed(data_folder)["infarct"].target
    plain = make_target(read_recording(path, leads=LEADS))
    assert target.leads == (*LEADS, "X", "Y", "Z")
    assert plain.leads == LEADS
    np.testing.assert_array_equal(target.beats[:, :12], plain.beats)
    regressed = vectorcardiogram(target.qrs[:12])
    found = [np.corrcoef(*pair)[0, 1] for pair in zip(target.qrs[12:], regressed, strict=True)]
    assert min(found) > 0.85
