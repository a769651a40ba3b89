"""Recordings from tables, good and bad."""

import io

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from refusals import read_as, refused, waves

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import MissingMetadataError

RATE, N = 500, 2000
IN_MV = [f"{lead}_mV" for lead in LEADS]


@pytest.fixture(scope="module")
def signal():
    return waves(N)


def table(signal, names=LEADS, time="time_ms", rate=RATE):
    step = 1000 / rate if time == "time_ms" else 1 / rate
    columns = {time: step * np.arange(signal.shape[1])}
    return pd.DataFrame(columns | dict(zip(names, signal, strict=True)))


def save(frame, path, **options):
    frame.to_csv(path, index=False, **options)
    return path


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


class TestUnits:
    def test_our_own_format_is_in_mv(self, tmp_path, signal):
        recording = read_as(save(table(signal), tmp_path / "ecg.csv"), signal)
        assert recording.sampling_rate == 500
        assert len(recording.provenance["source_sha256"]) == 64

    def test_by_the_user_or_a_comment(self, tmp_path, signal):
        path = save(table(1e3 * signal, time="time_s"), tmp_path / "a.csv")
        refused(path, "unknown unit of lead I", "unit=")
        assert_allclose(read_recording(path, unit="uV").signal, signal, rtol=0, atol=1e-9)
        path = write(tmp_path / "b.csv", f"# units: uV\n{path.read_text()}")
        assert_allclose(read_recording(path).signal, signal, rtol=0, atol=1e-9)
        refused(path, "is in 'uV', unit= says 'mV'", unit="mV")
        path = save(table(signal, IN_MV), tmp_path / "c.csv")
        path = write(tmp_path / "c.csv", f"# unit = uV\n{path.read_text()}")
        refused(path, "column 'I_mV' is in 'mV', a comment says 'uV'")

    def test_row_of_units_is_refused(self, tmp_path, signal):
        lines = table(1e3 * signal, time="time").to_csv(index=False).splitlines()
        units = ",".join(["(sec)", *["(µV)"] * 12])
        path = write(tmp_path / "a.csv", "\n".join([lines[0], units, *lines[1:]]))
        refused(path, "column 'I' holds '(µV)' in row 1", "must be a number")

    @pytest.mark.parametrize(
        ("unit", "time"), [("hh:mm:ss.mmm", "'1:02:{:06.3f}'"), ("seconds", "{}")]
    )
    def test_as_rdsamp_writes_csv(self, tmp_path, signal, unit, time):
        header = ",".join(["'Elapsed time'", *[f"'{lead.lower()}'" for lead in LEADS]])
        units = ",".join([f"'{unit}'", *["'mV'"] * 12])
        rows = [",".join(map(repr, sample)) for sample in signal.T.tolist()]
        rows = [f"{time.format(k / RATE)},{row}" for k, row in enumerate(rows)]
        recording = read_as(write(tmp_path / "a.csv", "\n".join([header, units, *rows])), signal)
        assert recording.sampling_rate == RATE
        path = write(tmp_path / "b.csv", "\n".join([header, *rows]))
        in_uv = read_recording(path, unit="uV", sampling_rate=RATE)
        assert_allclose(in_uv.signal, signal / 1e3, rtol=0, atol=1e-12)


class TestNumbers:
    def test_decimal_commas_that_are_not_clear(self, tmp_path, signal):
        text = table(signal, IN_MV, "time_s").to_csv(index=False, sep=";", decimal=",")
        refused(write(tmp_path / "a.csv", text.replace(";", ",")), "decimal commas by semicolons")
        frame = table(signal, IN_MV).astype(str)
        frame["V6_mV"] = frame["V6_mV"].str.replace(".", ",")
        refused(save(frame, tmp_path / "b.csv", sep=";"), "column 'V6_mV' holds", "decimal mark")

    @pytest.mark.parametrize(
        ("encoding", "first", "line_end", "end"),
        [("utf-16", "", "\r", ""), ("mac-roman", "", "\r\n", "\r\n"),
         ("utf-8-sig", "sep=,\n", ",\n", ""), ("utf-8", "", "\n", "\n\x1a")],
    )  # fmt: skip
    def test_encodings_and_line_ends(self, tmp_path, signal, encoding, first, line_end, end):
        names = [f"{lead} (µV)" for lead in LEADS]
        frame = table(1e3 * signal[:, :800], names)
        text = first + line_end.join(frame.to_csv(index=False).splitlines()) + end
        read_as(write(tmp_path / "a.csv", text, encoding), signal[:, :800])

    def test_text_and_holes(self, tmp_path, signal):
        frame = table(signal).astype(object)
        frame.loc[5, "V3"] = "0.25x"
        refused(save(frame, tmp_path / "a.csv"), "column 'V3'", "row 6", "0.25x")
        for cell in ("inf", "1e4000000000000001", "True", "0,25"):
            frame.loc[5, "V3"] = cell
            refused(save(frame, tmp_path / "b.csv"), "column 'V3'", "row 6")
        frame = table(signal)
        frame.loc[5:10, "V3"] = np.nan
        refused(save(frame, tmp_path / "c.csv"), "lead V3 lacks 6 samples (first: sample 5")
        frame = table(signal)
        frame["V3"] = True
        refused(save(frame, tmp_path / "d.csv"), "column 'V3'", "True")

    def test_comments_notes_and_empty_ends(self, tmp_path, signal):
        frame = table(signal).assign(remark='sinus, "normal"', beat=np.nan)
        lines = frame.to_csv(index=False).splitlines()
        lines = ["# exported", "", *lines[:9], "# here", *lines[9:], ",,,,,,,,,,,,,,", "", "# end"]
        recording = read_as(write(tmp_path / "a.csv", "\n".join(lines)), signal, unit="mV")
        assert recording.ignored == ("remark", "beat")

    def test_cells_beyond_the_header_and_open_quotes(self, tmp_path, signal):
        lines = table(signal, IN_MV).to_csv(index=False).splitlines()
        longer = "\n".join([lines[0], *(f"{line},1" for line in lines[1:])])
        refused(write(tmp_path / "a.csv", longer), "not a readable table", "every row")
        lines = table(signal, IN_MV).assign(note="x").to_csv(index=False).splitlines()
        lines[5], lines[9] = lines[5][:-1] + '"', lines[9] + '"'
        refused(write(tmp_path / "b.csv", "\n".join(lines)), "quotation mark")


class TestTimes:
    def test_without_a_unit_the_rate_must_be_given(self, tmp_path, signal):
        path = save(table(signal, IN_MV, "time"), tmp_path / "a.csv")
        refused(path, "unknown unit of the time column 'time'", "sampling_rate=")
        assert read_recording(path, sampling_rate=500).sampling_rate == 500

    def test_without_times_the_rate_must_be_given(self, tmp_path, signal):
        frame = table(signal, IN_MV)[IN_MV]
        refused(save(frame, tmp_path / "a.csv"), "no time column", "sampling_rate=")
        recording = read_recording(tmp_path / "a.csv", sampling_rate=400)
        assert recording.sampling_rate == 400
        assert_allclose(recording.signal, signal, rtol=0, atol=1e-12)
        path = write(tmp_path / "b.csv", f"# fs=1000 Hz\n{(tmp_path / 'a.csv').read_text()}")
        assert read_recording(path).sampling_rate == 1000
        refused(path, "400 Hz by sampling_rate=, 1000 Hz by a comment", sampling_rate=400)

    def test_that_disagree_with_the_rate_given_or_show_gaps(self, tmp_path, signal):
        path = save(table(signal), tmp_path / "a.csv")
        refused(path, "512 Hz by sampling_rate=, 500 Hz in the column", sampling_rate=512)
        assert read_recording(path, sampling_rate=500.2).sampling_rate == 500.2
        frame = table(signal, IN_MV)[IN_MV]
        frame.insert(0, "sample #", np.arange(N))
        path = save(frame, tmp_path / "a.csv")
        assert read_recording(path, sampling_rate=500).sampling_rate == 500
        path = save(frame.drop(index=range(90, 95)), tmp_path / "b.csv")
        refused(path, "not evenly spaced", sampling_rate=500)

    @pytest.mark.parametrize(
        ("rate", "digits", "name"),
        [(256, 0, "time_ms"), (1000, 3, "time_s"), (1000 / 3, 0, "time_ms")],
    )
    def test_rounded(self, tmp_path, rate, digits, name):
        frame = table(waves(N, rate), IN_MV, name, rate)
        frame[name] = frame[name].round(digits)
        recording = read_recording(save(frame, tmp_path / "a.csv"))
        assert recording.sampling_rate == pytest.approx(rate, rel=1e-4)
        refused(save(frame.drop(index=1900), tmp_path / "b.csv"), "not evenly")

    def test_uneven(self, tmp_path, signal):
        path = save(table(signal).drop(index=range(90, 95)), tmp_path / "a.csv")
        refused(path, "not evenly spaced (12 ms after 0.178 s, 2.0")
        refused(save(table(signal)[::-1], tmp_path / "b.csv"), "do not increase")
        refused(save(table(signal).drop(index=1500), tmp_path / "c.csv"), "4 ms after 2.998 s")
        frame = table(signal)
        frame.loc[7, "time_ms"] = np.nan
        refused(save(frame, tmp_path / "d.csv"), "times in the column 'time_ms' are missing")


def paper(signal, rhythm="II_rhythm_mV"):
    """Three rows of leads that take turns, over four columns; II runs along below."""
    quarter = signal.shape[1] // 4
    frame = table(signal, IN_MV)
    for k, name in enumerate(IN_MV):
        outside = np.arange(signal.shape[1]) // quarter != k // 3
        frame.loc[outside, name] = np.nan
    return frame if rhythm is None else frame.assign(**{rhythm: signal[1]})


def long_format(frame, rate=RATE):
    leads = frame.columns[1:]
    parts = [
        pd.DataFrame({"Lead": name.removesuffix("_mV"), "time_s": np.arange(len(frame)) / rate,
                      "Voltage (mV)": frame[name]}).dropna()
        for name in leads
    ]  # fmt: skip
    return pd.concat(parts)


class TestPaper:
    N = 10 * RATE

    def expected(self, signal):
        rows = np.full_like(signal, np.nan)
        quarter = self.N // 4
        for k in range(12):
            span = slice(quarter * (k // 3), quarter * (k // 3 + 1))
            rows[k, span] = signal[k, span]
        return rows

    @pytest.mark.parametrize("name", ["II (rhythm) [mV]", "rhythm strip II_mV"])
    def test_the_longer_strip_is_the_lead(self, tmp_path, name):
        signal = waves(self.N)
        recording = read_recording(save(paper(signal, name), tmp_path / "a.csv"))
        expected = self.expected(signal)
        expected[1] = signal[1]
        assert_allclose(recording.signal, expected, rtol=0, atol=1e-12)
        note = recording.provenance["strip_of_II"]
        assert "10.00 s" in note
        assert "'II_mV' (2.50 s) is left out" in note

    def test_a_rhythm_strip_of_the_same_length_is_left_out(self, tmp_path, signal):
        frame = table(signal, IN_MV).assign(II_rhythm_mV=5.0)
        recording = read_as(save(frame, tmp_path / "a.csv"), signal)
        assert recording.ignored == ("II_rhythm_mV (left out)",)

    def test_long_format(self, tmp_path):
        signal = waves(self.N)
        frame = long_format(paper(signal))
        shuffled = frame.sort_values("time_s", kind="stable")[["Voltage (mV)", "time_s", "Lead"]]
        expected = self.expected(signal)
        expected[1] = signal[1]
        for each in (frame, shuffled):
            recording = read_recording(save(each, tmp_path / "a.csv"))
            assert recording.sampling_rate == 500
            assert_allclose(recording.signal, expected, rtol=0, atol=1e-12)

    def test_long_format_with_a_grid_of_its_own_for_each_lead(self, tmp_path):
        frame = long_format(paper(waves(self.N), None))
        rng = np.random.default_rng(1)
        shift = {lead: rng.uniform(-0.24, 0.24) / RATE for lead in LEADS}
        frame["time_s"] += frame["Lead"].map(shift)
        recording = read_recording(save(frame, tmp_path / "a.csv"))
        finite = np.isfinite(recording.signal)
        first = np.argmax(finite, axis=1)
        assert np.abs(first - 1250 * (np.arange(12) // 3)).max() <= 1
        assert finite.sum(axis=1).tolist() == [1250] * 12

    def test_long_format_at_different_rates(self, tmp_path):
        frame = long_format(paper(waves(self.N), None))
        frame.loc[frame["Lead"] == "V2", "time_s"] *= 1.0015
        refused(save(frame, tmp_path / "a.csv"), "lead 'V2' is not sampled at the 500 Hz")
        frame.loc[frame["Lead"] == "V2", "time_s"] *= 1.1
        refused(save(frame, tmp_path / "b.csv"), "Hz of lead 'V2'")

    def test_long_format_that_cannot_be_used(self, tmp_path):
        frame = long_format(paper(waves(self.N), None))
        path = save(frame.rename(columns={"Voltage (mV)": "value"}), tmp_path / "a.csv")
        refused(path, "unknown unit of lead I")
        assert read_recording(path, unit="uV").recorded.all()
        far = frame.copy()
        far.loc[far["Lead"] == "V6", "time_s"] += 1e9
        refused(save(far, tmp_path / "b.csv"), "memory")
        refused(save(frame.drop(index=400), tmp_path / "c.csv"), "not evenly spaced")
        refused(save(frame.assign(Lead="spam"), tmp_path / "d.csv"), "no lead in the column 'Lead'")


@pytest.mark.parametrize(
    "content",
    [
        b"time_ms,I\n", b'"a,b\n1', b",,,\n,,,\n,,,\n", b"time_ms,I_mV,II_mV\n,,\n,,\n",
        b"I_mV,II_mV\n1,2\n", b"\x00" * 5000, b"# only\n# remarks\n", b"\xfe\xff\xd8",
        b"," * 200_000, b"sep=;\n", b"time_ms,I_mV\n1e308,1\n-1e308,1\n",
    ],
)  # fmt: skip
def test_no_tables(tmp_path, content):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    refused(path)
    refused(path, sampling_rate=500.0, unit="mV")


def test_the_text_of_the_labsystem(tmp_path, signal):
    """Digits of 16 bits; a channel of a catheter is left out."""
    labels = [*LEADS, "HIS 1,2"]
    about = "Channel #: {}\r\nLabel: {}\r\nRange: 5mv \r\nLow: 0.05Hz\r\nHigh: 100Hz\r\n"
    about += "Sample rate: .5kHz\r\nColor: 0000FF\r\nScale: -7\r\n"
    header = "[Header]\r\nFile Type: 1\r\nVersion: 1\r\nChannels exported: 13\r\nData Format 1\r\n"
    header += "".join(about.format(k + 1, label) for k, label in enumerate(labels))
    digits = np.round(np.vstack([signal, signal[:1]]) / 5 * 32768).astype(int)
    rows = "\r\n".join(",".join(map(str, row)) for row in digits.T)
    path = write(tmp_path / "a.txt", header + "[Data]\r\n" + rows)
    recording = read_as(path, signal, tolerance=1e-4)
    assert (recording.sampling_rate, recording.filters.lowpass) == (500.0, 100.0)
    assert recording.ignored == ("HIS 1,2",)
    text = path.read_text()
    refused(write(path, text[:-30]), "damaged", "export it again")
    refused(write(path, text.replace(".5kHz", "1kHz", 1)), "500.0, 1000.0")


def test_the_text_of_cardiolab_becomes_a_table(tmp_path, signal):
    rows = [" ".join([str(k), *map(str, row)]) for k, row in enumerate(signal.T)]
    refused(write(tmp_path / "a.txt", "\n".join(rows)), "GE CardioLab put commas for blanks")
    names = ",".join(["sample", *IN_MV])
    path = write(tmp_path / "a.txt", "\n".join([names, *rows]).replace(" ", ","))
    read_as(path, signal, sampling_rate=500)


SPELT = {lead: [lead, lead.upper(), lead.lower(), f"Lead {lead}", f"MDC_ECG_LEAD_{lead}"]
         for lead in LEADS}  # fmt: skip


@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_however_it_is_written_the_signal_is_the_same(tmp_path, data):
    signal = waves(1000)
    draw = data.draw
    separator = draw(st.sampled_from([",", ";", "\t"]))
    decimal = "." if separator == "," else draw(st.sampled_from(".,"))
    columns = {}
    clock, scale = draw(st.sampled_from(
        [("time_s", 1), ("t [ms]", 1e3), ("Time (us)", 1e6), ("t_ms", 1e3), ("seconds", 1),
         ("msec", 1e3), ("Time in s", 1), ("timestamp_us", 1e6), ("Elapsed time [s]", 1)]
    ))  # fmt: skip
    columns[clock] = (np.arange(1000) / RATE + draw(st.sampled_from([0.0, 0.5]))) * scale
    for lead in draw(st.permutations(LEADS)):
        row = signal[LEADS.index(lead)]
        form, factor = draw(st.sampled_from(
            [("{}_mV", 1), ("{} [uV]", 1e3), ("{} (µV)", 1e3), ("{}/nV", 1e6), ("{} in V", 1e-3),
             ("{}_V", 1e-3), ("{} / µV", 1e3), ("{} (Wilson) [nV]", 1e6)]
        ))  # fmt: skip
        columns[form.format(draw(st.sampled_from(SPELT[lead])))] = factor * row
    if draw(st.booleans()):
        columns["comment"] = "sinus, normal"
    buffer = io.StringIO()
    pd.DataFrame(columns).to_csv(
        buffer, index=False, sep=separator, decimal=decimal, quoting=draw(st.sampled_from([0, 2]))
    )
    path = tmp_path / draw(st.sampled_from(["a.csv", "a.tsv", "a.txt"]))
    write(
        path, buffer.getvalue(), draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]))
    )
    recording = read_as(path, signal)
    assert recording.sampling_rate == pytest.approx(RATE, abs=1e-5)


def test_a_counter_of_samples_says_nothing_of_the_rate(data_folder):
    """Its 5000 samples are ten seconds at 500 Hz; read as ms, times would be half as long."""
    path = data_folder / "cases" / "pandas_index_column.csv"
    with pytest.raises(MissingMetadataError, match="counts samples") as refused:
        read_recording(path)
    assert refused.value.guess == 500.0
    assert make_target(read_recording(path, sampling_rate=500)).warnings == ()
    twice = make_target(read_recording(path, sampling_rate=1000)).warnings
    assert (
        "150 beats per minute with a QRS of 51 ms: the sampling rate (1000 Hz) may be" in twice[-1]
    )


def test_one_lead_of_a_watch_is_named_and_the_person_is_not(data_folder):
    with pytest.raises(InputError, match=r"one lead alone \(Lead I\)") as refused:
        read_recording(data_folder / "cases" / "watch_one_lead.csv")
    assert "Sample" not in str(refused.value)


def test_a_calibration_pulse_may_be_rounded(data_folder):
    """Its first samples differ between leads by two digits of 5 uV."""
    recording = read_recording(data_folder / "cases" / "calibration_pulse_rounded.csv")
    assert recording.remarks[-1] == "calibration pulse left out: 5.600 to 6.000 s"
