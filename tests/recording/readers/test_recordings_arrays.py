"""Recordings from HDF5 and MATLAB files, good, bad and damaged."""

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from refusals import read_as, refused, waves

from fascicle.core.leads import LEADS
from fascicle.recording.readers.read import read_recording

RATE, N = 500, 1000


@pytest.fixture
def signal():
    return waves(N)


def by_lead(signal, names=LEADS):
    return dict(zip(names, signal, strict=True))


def save_hdf5(path, datasets, attributes=None):
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name] = values
        for place, value in (
            {"fs": RATE, "units": "mV"} if attributes is None else attributes
        ).items():
            owner, _, name = place.rpartition(":")
            file[owner or "/"].attrs[name] = value
    return path


def save_matlab(path, variables, **options):
    scipy.io.savemat(path, variables, **options)
    return path


def save_matlab_73(path, signal, names=LEADS, kind=b"cell"):
    """Write what MATLAB 7.3 writes for a matrix, a cell array of texts, a number and a text."""

    def text(group, name, letters):
        codes = np.array([[ord(letter)] for letter in letters], dtype=np.uint16)
        group[name] = codes
        group[name].attrs["MATLAB_class"] = np.bytes_(b"char")
        return group[name].ref

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"ecg": signal.T, "fs": [[500.0]]}.items():
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_(b"double")
        text(file, "units", "mV")
        cells = file.create_group("#refs#")
        references = [text(cells, f"r{k}", name) for k, name in enumerate(names)]
        file["leads"] = np.array([references], dtype=h5py.ref_dtype)
        file["leads"].attrs["MATLAB_class"] = np.bytes_(kind)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\0\2IM"
    path.write_bytes(header + path.read_bytes()[128:])
    return path


class TestHdf5:
    def test_one_dataset_a_lead(self, tmp_path, signal):
        names = [f"patient/ecg/lead_{lead.lower()}" for lead in LEADS]
        datasets = by_lead(1000 * signal, names) | {"patient/ecg/resp": np.zeros(9)}
        attributes = {"fs": RATE, "patient/ecg:units": "uV"}
        path = save_hdf5(tmp_path / "a.h5", datasets, attributes)
        recording = read_as(path, signal)
        assert recording.sampling_rate == 500
        assert recording.ignored == ("resp",)
        assert recording.provenance["format"] == "HDF5"

    @pytest.mark.parametrize(("key", "turned"), [("sig_name", False), ("Lead Names", True)])
    def test_matrix_with_names(self, tmp_path, signal, key, turned):
        names = ["Resp", *reversed(LEADS)]
        matrix = np.insert(signal[::-1], 0, 7.0, axis=0)
        path = save_hdf5(tmp_path / "a.h5", {"ecg": matrix.T if turned else matrix, key: names})
        recording = read_as(path, signal)
        assert recording.ignored == ("Resp",)

    @pytest.mark.parametrize(
        "names", [list(LEADS), np.array(LEADS, dtype="S5"), ",".join(LEADS), " ".join(LEADS)]
    )
    def test_names_rate_and_unit_as_attributes(self, tmp_path, signal, names):
        attributes = {"ecg:leads": names, "ecg:Sampling Rate": "500 sps", "ecg:unit": "uV"}
        path = save_hdf5(tmp_path / "a.h5", {"ecg": 1000 * signal[None]}, attributes)
        recording = read_as(path, signal)
        assert recording.sampling_rate == 500

    @pytest.mark.parametrize(
        ("key", "value"),
        [("sampling_frequency", [500.0]), ("samplerate", np.full(12, 500)), ("fs_hz", "500"),
         ("frequency", "500.0Hz")],
    )  # fmt: skip
    def test_spellings_of_the_rate(self, tmp_path, signal, key, value):
        path = save_hdf5(tmp_path / "a.h5", by_lead(signal), {key: value, "units": "mV"})
        assert read_recording(path).sampling_rate == 500

    def test_unit_of_each_lead(self, tmp_path, signal):
        scaled = signal * np.where(np.arange(12) < 6, 1.0, 1000.0)[:, None]
        units = ["mV"] * 6 + ["uV"] * 6
        path = save_hdf5(
            tmp_path / "a.h5", {"ecg": scaled}, {"fs": RATE, "leads": list(LEADS), "units": units}
        )
        assert read_recording(path).signal == pytest.approx(signal, abs=1e-12)
        path = save_hdf5(
            tmp_path / "b.h5", {"ecg": signal}, {"fs": 500, "leads": LEADS, "units": units[:5]}
        )
        refused(path, "one for each of the 12 signals")

    def test_netcdf(self, tmp_path, signal):
        xarray = pytest.importorskip("xarray")
        ecg = xarray.DataArray(
            signal.T, dims=("time", "lead"), attrs={"units": "mV"},
            coords={"lead": list(LEADS), "time": ("time", np.arange(N) / RATE, {"units": "s"})},
        )  # fmt: skip
        dataset = xarray.Dataset({"ecg": ecg}, attrs={"sampling_rate": 500.0})
        dataset.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        assert read_recording(tmp_path / "a.nc").signal == pytest.approx(signal, abs=0)


class TestStated:
    """What is missing or contradictory is refused, in files of both kinds."""

    def test_contradictions_in_the_file(self, tmp_path, signal):
        path = save_hdf5(tmp_path / "a.h5", by_lead(signal), {"fs": 500, "I:fs": 250, "units": "V"})
        refused(path, "unclear sampling rate", "250", "500")
        for rate in (np.array([500, 1000]), "0.5 kHz", np.inf):
            path = save_hdf5(tmp_path / "a.h5", by_lead(signal), {"fs": rate, "units": "mV"})
            refused(path, "unclear sampling rate")
        attributes = {"fs": 500, "units": "mV", "II:units": "uV"}
        refused(
            save_hdf5(tmp_path / "b.h5", by_lead(signal), attributes), "unclear unit of lead 'II'"
        )
        path = save_hdf5(
            tmp_path / "c.h5", {"ecg": signal},
            {"fs": 500, "units": "mV", "leads": LEADS, "labels": LEADS[::-1]},
        )  # fmt: skip
        refused(path, "'ecg' (12 x 1000)", "ambiguous")

    @pytest.mark.parametrize(("name", "value"), [("add_offset", 5.0), ("adc_gain", np.arange(12))])
    def test_digits_with_a_gain(self, tmp_path, signal, name, value):
        attributes = {"fs": RATE, "units": "mV", name: value}
        refused(save_hdf5(tmp_path / "a.h5", by_lead(signal), attributes), f"'{name}'", "physical")
        variables = by_lead(signal) | attributes
        refused(save_matlab(tmp_path / "a.mat", variables), f"'{name}'", "physical")

    def test_matrix_without_names(self, tmp_path, signal):
        path = save_hdf5(tmp_path / "a.h5", {"ecg": signal})
        refused(path, "'ecg' (12 x 1000)", "add a list 'leads'")
        refused(save_hdf5(tmp_path / "b.h5", {"ecg": signal, "leads": LEADS[:11]}), "no leads")

    def test_two_recordings(self, tmp_path, signal):
        path = save_hdf5(tmp_path / "a.h5", {"one": signal, "two": signal, "leads": LEADS})
        refused(path, "'one' of / and 'two' of /")
        datasets = {f"{group}/{lead}": x for group in "ab" for lead, x in by_lead(signal).items()}
        refused(save_hdf5(tmp_path / "b.h5", datasets), "leads of /a and", "leads of /b")
        path = save_hdf5(tmp_path / "c.h5", by_lead(signal) | {"ecg": signal, "leads": LEADS})
        refused(path, "'ecg' of / and arrays named after leads of /")

    def test_no_leads(self, tmp_path, signal):
        refused(save_hdf5(tmp_path / "a.h5", {"x": np.arange(9)}), "no leads", "'x' (9)")
        refused(save_hdf5(tmp_path / "b.h5", {}), "found: nothing")
        refused(save_hdf5(tmp_path / "c.h5", {"ecg": signal[None].repeat(3, 0)}), "(3 x 12 x 1000)")
        refused(save_hdf5(tmp_path / "d.h5", {"x\ny": np.arange(9)}), r"x\ny")


class TestHdf5Refused:
    def test_links_are_not_followed(self, tmp_path, signal):
        other = save_hdf5(tmp_path / "other.h5", by_lead(signal))
        for link in (h5py.ExternalLink(str(other), "/V1"), h5py.SoftLink("/V2")):
            path = save_hdf5(tmp_path / "a.h5", by_lead(signal))
            with h5py.File(path, "a") as file:
                del file["V1"]
                file["V1"] = link
            refused(path, "lead V1 missing")

    def test_other_files_are_not_opened(self, tmp_path, signal):
        other = save_hdf5(tmp_path / "other.h5", by_lead(signal))
        path = save_hdf5(tmp_path / "a.h5", by_lead(signal))
        layout = h5py.VirtualLayout(shape=(N,), dtype=float)
        layout[:] = h5py.VirtualSource(other, "V1", shape=(N,))
        with h5py.File(path, "a") as file:
            del file["V1"]
            file.create_virtual_dataset("V1", layout)
        refused(path, "lead V1 missing")
        secret = tmp_path / "secret"
        secret.write_bytes(signal[6].tobytes())
        with h5py.File(path, "a") as file:
            del file["V1"]
            file.create_dataset("V1", (N,), float, external=[(secret, 0, 8 * N)])
        refused(path, "lead V1 missing")

    @pytest.mark.parametrize("dtype", [np.complex128, h5py.vlen_dtype(float)])
    def test_what_is_no_number(self, tmp_path, signal, dtype):
        path = save_hdf5(tmp_path / "a.h5", by_lead(signal))
        with h5py.File(path, "a") as file:
            del file["V1"]
            file.create_dataset("V1", (N,), dtype, fillvalue=None)
        refused(path, "lead V1 missing")
        refused(save_hdf5(path, by_lead(signal) | {"V1": h5py.Empty(float)}), "V1")

    def test_bomb(self, tmp_path):
        path = tmp_path / "a.h5"
        with h5py.File(path, "w") as file:
            file.attrs.update({"fs": RATE, "units": "mV", "leads": list(LEADS)})
            file.create_dataset("ecg", (12, 10**11), "i1", chunks=(1, 1))[0, 0] = 1
        refused(path, "GB of memory, the limit for a file")

    def test_groups_in_circles_and_crowds(self, tmp_path, signal):
        path = save_hdf5(tmp_path / "a.h5", {f"ecg/{lead}": signal[0] for lead in LEADS})
        with h5py.File(path, "a") as file:
            file["ecg/again"] = file["/"]
        refused(path, "leads in", "/ecg/again/ecg")
        save_hdf5(path, by_lead(signal) | {str(k): 0 for k in range(1001)})
        assert read_recording(path).signal == pytest.approx(signal, abs=0)


def test_module_in_the_working_folder_is_not_run(tmp_path, signal, monkeypatch):
    (tmp_path / "h5py.py").write_text("raise SystemExit(3)")
    path = save_hdf5(tmp_path / "a.h5", by_lead(signal))
    monkeypatch.chdir(tmp_path)
    assert read_recording(path).signal == pytest.approx(signal, abs=0)


class TestMatlab:
    @pytest.mark.parametrize("options", [{}, {"format": "4"}])
    def test_one_variable_a_lead(self, tmp_path, signal, options):
        variables = by_lead(1000 * signal) | {"fs": 500.0, "units": "uV", "x": np.ones(3)}
        recording = read_as(save_matlab(tmp_path / "a.mat", variables, **options), signal)
        assert recording.sampling_rate == 500
        assert recording.ignored == ("x",)
        assert recording.provenance["format"] == f"MATLAB {options.get('format', '5')}"

    @pytest.mark.parametrize("names", [np.array(LEADS, dtype=object), np.array(LEADS)])
    def test_matrix_with_names(self, tmp_path, signal, names):
        loop_index = np.arange(9.0)  # is no lead I
        variables = {"ecg": signal.T, "leads": names, "Fs": 500, "unit": "mV", "i": loop_index}
        read_as(save_matlab(tmp_path / "a.mat", variables), signal)

    def test_structure(self, tmp_path, signal):
        names = np.array(LEADS, dtype=object)
        fields = {"data": signal, "leads": names, "fs": 500, "units": "mV"}
        path = save_matlab(tmp_path / "a.mat", {"ecg": fields, "info": {"age": 61}})
        assert read_recording(path).signal == pytest.approx(signal, abs=0)
        fields = {"leads": by_lead(signal) | {"units": "mV"}, "fs": 500}
        path = save_matlab(tmp_path / "b.mat", {"ecg": fields})
        assert read_recording(path).signal == pytest.approx(signal, abs=0)

    def test_physionet_challenge(self, tmp_path, signal):
        path = save_matlab(tmp_path / "a.mat", {"val": np.round(1000 * signal)})
        refused(path, "'val' (12 x 1000)", ".hea")

    def test_version_7_3(self, tmp_path, signal):
        path = save_matlab_73(tmp_path / "a.mat", signal)
        recording = read_as(path, signal)
        assert recording.provenance["format"] == "MATLAB 7.3"
        path = save_matlab_73(tmp_path / "b.mat", signal, kind=b"string")
        refused(path, "'leads' (no numbers)")

    @pytest.mark.parametrize("value", ["text", scipy.sparse.eye(9).tocsc()])
    def test_what_is_no_number(self, tmp_path, signal, value):
        variables = by_lead(signal) | {"fs": 500, "units": "mV", "V1": value}
        refused(save_matlab(tmp_path / "a.mat", variables), "lead V1 missing")

    def test_twice_the_same_variable(self, tmp_path, signal):
        path = save_matlab(tmp_path / "a.mat", by_lead(signal))
        path.write_bytes(path.read_bytes() + path.read_bytes()[128:])
        refused(path, "Duplicate variable")
