"""WFDB records of every layout, good and bad.

Signal files are packed here, from the text of signal(5), and not by the library that reads them.
"""

import hashlib

import numpy as np
import pytest
import wfdb
from refusals import read_as, refused, waves

from fascicle.core.leads import LEADS
from fascicle.recording.readers.read import read_recording

RATE, N, GAIN = 500, 1500, 40


def digits(n=N, gain=GAIN):
    """(12, n) integers, every lead different, limb leads consistent but for rounding."""
    return np.round(gain * waves(n)).astype(np.int64)


def pack(samples):
    """Bytes of samples (n, channels) in signal format 212."""
    one, two = (samples.ravel() & 0xFFF).reshape(-1, 2).T
    octets = [one & 0xFF, (one >> 8) | (two >> 8 << 4), two & 0xFF]
    return np.stack(octets, axis=1).astype(np.uint8).tobytes()


def write(folder, samples, gain=f"{GAIN}/mV", names=LEADS, name="rec", first=None, stored="16"):
    """Write a record of samples (channels, n)."""
    first = f"{name} {len(samples)} {RATE} {samples.shape[1]}" if first is None else first
    lines = [
        f"{name}.dat {stored} {gain} 16 0 {row[0]} {int(row.sum()) % 2**16} 0 {lead}"
        for row, lead in zip(samples, names, strict=True)
    ]
    (folder / f"{name}.dat").write_bytes(samples.T.astype("<i2").tobytes())
    path = folder / f"{name}.hea"
    path.write_text("\n".join([first, *lines]) + "\n", encoding="utf-8")
    return path


def change(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))
    return path


def test_values_are_those_of_wfdb(tmp_path):
    path = write(tmp_path, digits())
    recording = read_as(path, digits() / GAIN)
    assert recording.sampling_rate == RATE
    assert recording.digits_per_millivolt == pytest.approx(np.full(12, GAIN))
    assert recording.provenance["checksums"] == "agree"
    expected = wfdb.rdrecord(str(path.with_suffix(""))).p_signal.T
    assert np.array_equal(recording.signal, expected)
    data = path.with_suffix(".dat").read_bytes()
    path.with_suffix(".dat").write_bytes(data[: len(data) // 2 - 1])
    refused(path, "rec.dat holds 749 frames, header declares 1500")
    refused(write(tmp_path, digits(), stored="516"), "FLAC", "without compression")


def test_several_signal_files_of_several_formats(tmp_path):
    path = write(tmp_path, digits())
    lines = path.read_text().splitlines()
    (tmp_path / "limb.dat").write_bytes(pack(digits()[:6].T))
    (tmp_path / "chest.dat").write_bytes(digits()[6:].T.astype("<i2").tobytes())
    for k in range(12):
        new = "limb.dat 212" if k < 6 else "chest.dat 16"
        lines[k + 1] = lines[k + 1].replace("rec.dat 16", new)
    path.write_text("\n".join([lines[0], *lines[7:], *lines[1:7]]))
    recording = read_as(path, digits() / GAIN)
    both = (tmp_path / "chest.dat").read_bytes() + (tmp_path / "limb.dat").read_bytes()
    assert recording.provenance["signal_files"] == "chest.dat, limb.dat"
    assert recording.provenance["signal_sha256"] == hashlib.sha256(both).hexdigest()


def test_slower_channels_are_ignored_but_slower_leads_refused(tmp_path):
    frames = digits().reshape(12, -1, 2).transpose(1, 0, 2).reshape(N // 2, 24)
    stored = np.concatenate([frames, np.arange(N // 2)[:, None] % 7], axis=1)
    path = write(tmp_path, digits(), stored="16x2", first=f"rec 13 {RATE / 2:g} {N // 2}")
    path.with_suffix(".dat").write_bytes(stored.astype("<i2").tobytes())
    path.write_text(path.read_text() + f"rec.dat 16 {GAIN}/mmHg 16 0 0 0 0 Resp\n")
    recording = read_recording(path)
    assert recording.ignored == ("Resp",)
    assert recording.sampling_rate == RATE
    refused(path, "sampling rate is 500 Hz", sampling_rate=250)
    assert recording.signal == pytest.approx(digits() / GAIN, abs=1e-12)
    text = path.read_text().replace("Resp", "V6").replace("0 V6", "0 other", 1)
    path.write_text(text)
    refused(path, "lead V6 has 750 samples, lead I 1500")


def test_skew_is_undone(tmp_path):
    delayed = digits()
    for row, delay in [(2, 3), (7, 5)]:
        delayed[row] = np.roll(delayed[row], delay)
    path = write(tmp_path, delayed)
    lines = path.read_text().splitlines()
    lines[3] = lines[3].replace(" 16 ", " 16:3 ", 1)
    lines[8] = lines[8].replace(" 16 ", " 16:5 ", 1)
    path.write_text("\n".join(lines))
    assert read_recording(path).signal == pytest.approx(digits()[:, :-5] / GAIN, abs=1e-12)


@pytest.mark.parametrize(
    ("gain", "millivolts", "per_millivolt"),
    [("40(7)/mV", 1 / 40, 40), ("-40/mV", -1 / 40, 40), ("40/V", 25, 0.04)],
)
def test_gain_baseline_and_unit(tmp_path, gain, millivolts, per_millivolt):
    recording = read_recording(write(tmp_path, digits(), gain=gain))
    baseline = 7 if "(7)" in gain else 0
    assert recording.signal == pytest.approx(millivolts * (digits() - baseline), rel=1e-12)
    assert recording.digits_per_millivolt == pytest.approx(np.full(12, per_millivolt))


def test_microvolts_of_old_encodings(tmp_path):
    path = write(tmp_path, digits(), gain="0.04/µV")
    path.write_text(path.read_text(encoding="utf-8"), encoding="latin-1")
    assert read_recording(path).signal == pytest.approx(digits() / GAIN, rel=1e-12)
    refused(path, "lead I is in 'µV', unit= says 'mV'", unit="mV")


def test_samples_marked_invalid_are_gaps(tmp_path):
    samples = digits()
    samples[8, 700:706] = -(2**15)
    refused(write(tmp_path, samples), "lead V3 lacks 6 samples", "sample 700")


def test_wrong_checksums_are_told(tmp_path):
    path = write(tmp_path, digits())
    data = bytearray(path.with_suffix(".dat").read_bytes())
    data[2 * 3] ^= 1  # of the first sample of aVR
    path.with_suffix(".dat").write_bytes(data)
    (remark,) = read_recording(path).remarks
    assert remark == "checksums of the file differ for aVR: it may be damaged"
    lines = [line.split() for line in path.read_text().splitlines()]
    for line in lines[1:]:
        line[6] = "0"
    path.write_text("\n".join(" ".join(line) for line in lines))
    assert "checksums" not in read_recording(path).provenance


@pytest.mark.parametrize(
    ("new", "words"),
    [("~ 16", ""), ("rek.dat 16", "rek.dat"), ("r" * 400 + " 16", ""), ("rec.dat 16x0", "16x0")],
)
def test_signal_lines(tmp_path, new, words):
    refused(change(write(tmp_path, digits()), "rec.dat 16", new), words)


class TestSegments:
    @pytest.fixture
    def parts(self, tmp_path):
        """Two halves in one folder, the second with other gains and its signals reversed."""
        write(tmp_path, digits()[:, :700], name="s1")
        write(tmp_path, 2 * digits()[::-1, 700:], gain=f"{2 * GAIN}/mV", name="s2",
              names=LEADS[::-1])  # fmt: skip
        return tmp_path

    def master(self, folder, *segments, total=None):
        total = sum(length for _, length in segments) if total is None else total
        lines = [f"rec/{len(segments)} 12 {RATE} {total}", *(f"{n} {k}" for n, k in segments)]
        (folder / "rec.hea").write_text("\n".join(lines) + "\n")
        return folder / "rec.hea"

    def test_fixed_layout(self, tmp_path):
        write(tmp_path, digits()[:, :700], name="s1")
        write(tmp_path, digits()[:, 700:], name="s2")
        recording = read_as(self.master(tmp_path, ("s1", 700), ("s2", 800)), digits() / GAIN)
        assert recording.provenance["signal_files"] == "s1.dat, s1.hea, s2.dat, s2.hea"
        assert recording.provenance["checksums"] == "agree"

    def test_variable_layout(self, parts):
        layout = [f"~ 0 {GAIN}/mV 16 0 0 0 0 {lead}" for lead in LEADS]
        (parts / "rec_layout.hea").write_text("\n".join([f"rec_layout 12 {RATE} 0", *layout]))
        path = self.master(parts, ("rec_layout", 0), ("s1", 700), ("s2", 800))
        read_as(path, digits() / GAIN)

    @pytest.mark.parametrize(
        "segments",
        [
            [("s1", 700), ("s3", 800)], [("s1", 700), ("rec", 700)], [("s1", 700), ("../s2", 800)],
            [("~", 700), ("~", 800)], [("s1", 700), ("s2", 10**11)],
        ],
    )  # fmt: skip
    def test_refusals(self, parts, segments):
        refused(self.master(parts, *segments))

    def test_contradictions_and_marks_in_a_segment(self, parts):
        path, said = self.master(parts, ("s1", 700), ("s2", 800)), "s2.hea has another rate"
        samples = 2 * digits()[::-1, 700:]
        for old, new in ((f"{2 * GAIN}/mV", f"{2 * GAIN}/uV"), (f" {RATE} ", " 1000 ")):
            change(parts / "s2.hea", old, new)
            refused(path, said)
            write(parts, samples, gain=f"{2 * GAIN}/mV", name="s2", names=LEADS[::-1])
        samples[3, 5] = -(2**15)
        write(parts, samples, gain=f"{2 * GAIN}/mV", name="s2", names=LEADS[::-1])
        refused(path, "s2.hea", "marked invalid")


@pytest.mark.parametrize("folder", ["[x]*?", "http:"])
def test_odd_paths(tmp_path, monkeypatch, folder):
    (tmp_path / folder).mkdir()
    path = write(tmp_path / folder, digits())
    other = path.rename(path.with_name("my rec.v2.hea"))
    for name in (other, other.with_suffix("")):
        assert read_recording(name).signal == pytest.approx(digits() / GAIN, abs=1e-12)
    monkeypatch.chdir(tmp_path)
    assert read_recording(f"{folder}/my rec.v2").source == f"{folder}/my rec.v2.hea"
    (tmp_path / "link.hea").symlink_to(other)
    refused(tmp_path / "link.hea", "no file in its folder")
    (tmp_path / "rec.dat").symlink_to(path.with_suffix(".dat"))
    assert read_recording(tmp_path / "link").signal.shape == (12, N)


@pytest.mark.parametrize("name", ["24", "24_common"])
def test_ludb(data_folder, name):
    """Sample by sample and bit by bit what wfdb reads."""
    path = data_folder / "ecg" / "ludb" / f"{name}.hea"
    recording, expected = read_recording(path), wfdb.rdrecord(str(path.with_suffix("")))
    assert np.array_equal(recording.signal, expected.p_signal.T)
    assert recording.digits_per_millivolt == pytest.approx(expected.adc_gain, abs=0)
    assert recording.provenance["checksums"] == "agree"


def test_ptb(data_folder):
    recording = read_recording(data_folder / "ecg" / "ptb-s0010" / "s0010_re")
    assert recording.signal.shape == (12, 38400)
    first = [-489, -458, 31, 474, -260, -214, -88, -241, -112, 212, 393, 390]
    assert recording.signal[:, 0] == pytest.approx(np.array(first) / 2000)
    assert recording.ignored == ()
    frank = [values[0] * 2000 for values in recording.additional.values()]
    assert [*recording.additional] == ["X", "Y", "Z"]
    assert frank == pytest.approx([-3, 120, -18])


def test_a_signal_file_is_found_without_its_extension(data_folder):
    """As tools of the PhysioNet challenges write headers."""
    recording = read_recording(data_folder / "cases" / "no_extension.hea")
    assert recording.signal.shape == (12, 3000)
    assert any("no_extension.mat" in remark for remark in recording.remarks)
