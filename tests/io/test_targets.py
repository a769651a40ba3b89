"""Targets to and from netCDF."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from fascicle.errors import InputError
from fascicle.io.targets import read_target, write_target
from fascicle.leads import LEADS
from fascicle.recording.target import Target


@pytest.fixture
def target():
    rng = np.random.default_rng(4)
    notes = {
        "source": "rec.hea",
        "beats_used": "3",
        "warnings": "I + III differs; μV ≠ mV",
        "none": "",
    }
    return Target(rng.normal(size=(3, 12, 201)), np.arange(-80.0, 121.0), -41.5, 62.0, 71.25, notes)


def test_round_trip_is_exact(target, tmp_path):
    write_target(target, tmp_path / "new" / "target.nc")
    again = read_target(str(tmp_path / "new" / "target.nc"))
    assert np.array_equal(again.beats, target.beats)
    assert np.array_equal(again.time, target.time)
    assert (again.qrs_onset, again.qrs_offset, again.heart_rate) == (-41.5, 62.0, 71.25)
    assert again.provenance == target.provenance
    assert again.beats.dtype == np.float64


def test_file_explains_itself(target, tmp_path):
    write_target(target, tmp_path / "target.nc")
    dataset = xr.load_dataset(tmp_path / "target.nc", engine="h5netcdf")
    assert dataset["beats"].dims == ("beat", "lead", "time")
    units = {name: variable.attrs.get("units") for name, variable in dataset.variables.items()}
    assert units == {
        "beats": "mV", "mean": "mV", "standard_deviation": "mV",
        "time": "ms", "beat": "1", "lead": None,
    }  # fmt: skip
    assert dataset["mean"].sel(lead="V2", time=7.0).item() == target.mean[7, 87]
    assert dataset["standard_deviation"].values == pytest.approx(target.standard_deviation)
    assert dataset.attrs["qrs_duration_ms"] == 103.5
    assert dataset.attrs["heart_rate_bpm"] == 71.25
    assert dataset.attrs["provenance_source"] == "rec.hea"
    assert dataset.attrs["software"].startswith("fascicle ")


def test_failed_write_leaves_the_old_file(target, tmp_path, monkeypatch):
    path = tmp_path / "target.nc"
    write_target(target, path)
    before = path.read_bytes()

    def fail(*_args, **_options):
        raise OSError("disk full")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    with pytest.raises(OSError, match="disk full"):
        write_target(target, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["target.nc"]


def refused(path, word):
    with pytest.raises(InputError) as info:
        read_target(path)
    assert str(info.value).startswith(f"{path}: ")
    assert word in str(info.value)
    assert "\n" not in str(info.value)


def test_files_that_are_not_targets(target, tmp_path):
    refused(tmp_path, "is a folder")
    refused(tmp_path / "none.nc", "no such file")
    (tmp_path / "text.nc").write_text("not netCDF")
    refused(tmp_path / "text.nc", "not a readable netCDF file")
    (tmp_path / "empty.nc").touch()
    refused(tmp_path / "empty.nc", "not a readable netCDF file")
    write_target(target, tmp_path / "target.nc")
    content = (tmp_path / "target.nc").read_bytes()
    (tmp_path / "short.nc").write_bytes(content[: len(content) // 2])
    refused(tmp_path / "short.nc", "not a readable netCDF file")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    refused(tmp_path / "other.nc", "not a target")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda d: d.drop_vars("beats"), "without beats"),
        (lambda d: d.isel(beat=[0]), "at least 2 beats"),
        (lambda d: d.isel(lead=slice(0, 8)), "not the standard 12"),
        (lambda d: d.assign(beats=d["beats"] * np.nan), "not finite"),
        (lambda d: d.assign_attrs(format_version=99), "format version 99"),
        (lambda d: d.assign_attrs(format="fascicle heart"), "not a target"),
    ],
)
def test_damaged_targets(target, tmp_path, change, word):
    write_target(target, tmp_path / "target.nc")
    dataset = change(xr.load_dataset(tmp_path / "target.nc", engine="h5netcdf"))
    dataset.to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    refused(tmp_path / "changed.nc", word)


def test_leads_are_written_in_order(target, tmp_path):
    write_target(target, tmp_path / "target.nc")
    dataset = xr.load_dataset(tmp_path / "target.nc", engine="h5netcdf")
    assert tuple(dataset["lead"].values) == LEADS
