"""Targets to and from netCDF, and residuals whose covariance is known."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin, applied_filters
from fascicle.recording.target import Target, repeated, residual_covariance
from fascicle.recording.target_files import read_target, write_target


@pytest.fixture(scope="module")
def target():
    rng = np.random.default_rng(4)
    notes, warnings = {"source": "rec.hea", "none": ""}, ("I + III differs; μV ≠ mV", "noise")
    beats, time = rng.normal(size=(3, 12, 201)), np.arange(-80.0, 121.0)
    ends = {"onset_sd": 3.5, "offset_sd": 4.25}
    return Target(beats, time, -41.5, 62.0, 71.25, notes, **ends, warnings=warnings)


def load(path):
    return xr.load_dataset(path, engine="h5netcdf")


def test_round_trip_is_exact_and_the_file_explains_itself(target, tmp_path):
    write_target(target, tmp_path / "new" / "target.nc")
    again = read_target(str(tmp_path / "new" / "target.nc"))
    for name in ("beats", "time"):
        assert np.array_equal(getattr(again, name), getattr(target, name))
    for name in (
        "qrs_onset", "qrs_offset", "heart_rate", "onset_sd", "offset_sd", "noise", "provenance",
        "earliest_onset", "warnings",
    ):  # fmt: skip
        assert getattr(again, name) == getattr(target, name)
    dataset = load(tmp_path / "new" / "target.nc")
    assert dataset["beats"].dims == ("beat", "lead", "time")
    assert tuple(dataset["lead"].values) == LEADS
    units = {name: variable.attrs.get("units") for name, variable in dataset.variables.items()}
    assert units == {
        "beats": "mV", "mean": "mV", "standard_deviation": "mV",
        "residual_covariance_leads": "1", "residual_covariance_time": "1",
        "time": "ms", "qrs_time": "ms", "qrs_time_2": "ms", "beat": "1", "in_qrs": "1",
        "lead": None, "lead_2": None,
    }  # fmt: skip
    assert all("long_name" in variable.attrs for variable in dataset.variables.values())
    assert dataset["mean"].sel(lead="V2", time=7.0).item() == target.mean[7, 87]
    inside = dataset["in_qrs"] == 1
    assert dataset["beats"].isel(time=inside).values == pytest.approx(target.qrs_beats)
    attributes = dataset.attrs
    assert attributes["qrs_duration_ms"] == 103.5
    assert "earliest_onset_ms" not in attributes
    assert attributes["provenance_source"] == "rec.hea"
    covariance = residual_covariance(target)
    assert np.array_equal(dataset["standard_deviation"].isel(time=inside).values, covariance.sd)
    for over in ("leads", "time"):
        found = dataset[f"residual_covariance_{over}"]
        assert np.array_equal(found.values, getattr(covariance, over))
        assert 0 < found.attrs["shrinkage"] <= 1
        assert "standard_deviation[l, t]" in found.attrs["comment"]


def test_single_paced_beat_and_unused_leads_come_back(target, tmp_path):
    beats = target.beats[:1].copy()
    beats[:, 7] = np.nan
    one = replace(target, beats=beats, noise=0.03, heart_rate=None, earliest_onset=-33.0)
    write_target(one, tmp_path / "one.nc")
    again = read_target(tmp_path / "one.nc")
    assert np.array_equal(again.beats, beats, equal_nan=True)
    assert (again.noise, again.heart_rate, again.earliest_onset) == (0.03, None, -33.0)
    assert np.flatnonzero(~again.used) == [7]
    dataset = load(tmp_path / "one.nc")
    assert "heart_rate_bpm" not in dataset.attrs
    assert (dataset["standard_deviation"].sel(lead="I") == 0.03).all()
    assert dataset["standard_deviation"].sel(lead="V2").isnull().all()


def test_additional_leads_come_back_and_go_with_a_heart(target, tmp_path):
    """Rows after the twelve; a heart's leads in its order, those of one side only left out."""
    rng, leads = np.random.default_rng(5), (*LEADS, "V7", "X")
    more = rng.normal(size=(3, 2, 201))
    target = replace(target, beats=np.concatenate([target.beats, more], axis=1), leads=leads)
    write_target(target, path := tmp_path / "target.nc")
    again = read_target(path)
    assert again.leads == leads
    np.testing.assert_array_equal(again.beats, target.beats)
    assert load(path)["lead"].to_numpy().tolist() == [*leads]
    of_heart = again.in_leads((*LEADS, "X", "V9"))
    assert of_heart.leads == (*LEADS, "X", "V9")
    assert of_heart.used.tolist() == [True] * 13 + [False]
    np.testing.assert_array_equal(of_heart.mean[12], target.mean[13])
    assert again.in_leads(LEADS).leads == LEADS


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
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: .*{re.escape(word)}.*$"):
        read_target(path)


def test_files_that_are_not_targets(target, tmp_path):
    refused(tmp_path, "is a folder")
    refused(tmp_path / "none.nc", "no such file")
    write_target(target, tmp_path / "target.nc")
    content = (tmp_path / "target.nc").read_bytes()
    for bad in (b"", content[:-5000]):
        (tmp_path / "bad.nc").write_bytes(bad)
        refused(tmp_path / "bad.nc", "not a readable netCDF file")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    refused(tmp_path / "other.nc", "not a target")


def test_filters_come_back_and_can_be_read_by_others(target, tmp_path):
    filters = (
        Filter(FilterKind.LOW_PASS, 36.25, FilterOrigin.ESTIMATED, 12.5),
        Filter(FilterKind.NOTCH, 60.0, FilterOrigin.FILE, 30.0),
        *applied_filters(150.0, 50.0),
    )
    write_target(replace(target, filters=filters), tmp_path / "target.nc")
    assert read_target(tmp_path / "target.nc").filters == filters
    assert json.loads(load(tmp_path / "target.nc").attrs["filters"])[0] == {
        "kind": "low-pass",
        "frequency_Hz": 36.25,
        "order": 12.5,
        "origin": "estimated from the spectrum of the recording",
        "sampling_rate_Hz": None,
    }


TIME = np.arange(-40.0, 61.0)
LENGTH = 8.0  # ms of the correlation in time


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda d: d.drop_vars("beats"), "without beats"),
        (lambda d: d.isel(beat=[0]), "1 beats without a stated noise"),
        (lambda d: d.isel(lead=slice(0, 8)), "not beat, the standard 12"),
        (lambda d: d.assign(beats=d["beats"].where(d["time"] < 100)), "not finite"),
        (lambda d: d.assign_attrs(heart_rate_bpm=np.nan), "heart_rate_bpm is"),
        (lambda d: d.assign_attrs(qrs_onset_ms="early"), "qrs_onset_ms is 'early'"),
        (lambda d: d.assign_attrs(format_version=2), "format version 2, this fascicle reads 3"),
        (lambda d: d.assign_attrs(filters="40 Hz"), "filters are '40 Hz', not a list of filters"),
        (lambda d: d.assign_attrs(filters='[{"kind": "low-pass"}]'), "not a list of filters"),
        (lambda d: d.attrs.pop("filters") and d, "damaged target without filters"),
        (lambda d: d.assign_attrs(format="fascicle heart"), "not a target"),
    ],
)
def test_damaged_targets(target, tmp_path, change, word):
    write_target(target, tmp_path / "target.nc")
    dataset = change(load(tmp_path / "target.nc"))
    dataset.to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    refused(tmp_path / "changed.nc", word)


def full(found):
    """The whole covariance (mV²), shape (12, n_qrs, 12, n_qrs)."""
    return np.einsum("lt,ms,lm,ts->ltms", found.sd, found.sd, found.leads, found.time)


def known(rng, beats):
    """Target with residuals of a known separable covariance, and its correlations and SDs."""
    mixing = rng.normal(size=(12, 12))
    of_leads = mixing @ mixing.T
    root = np.sqrt(np.diag(of_leads))
    of_leads /= np.outer(root, root)
    lag = np.subtract.outer(TIME, TIME)
    of_time = np.exp(-((lag / LENGTH) ** 2))
    sd = rng.uniform(0.02, 0.1, 12)[:, None] * (1 + 0.5 * np.sin(TIME / 20))
    white = rng.normal(size=(beats, 12, len(TIME)))
    low_lead = np.linalg.cholesky(of_leads + 1e-9 * np.eye(12))
    low_time = np.linalg.cholesky(of_time + 1e-9 * np.eye(len(TIME)))
    residual = sd * (low_lead @ white @ low_time.T)
    mean = np.exp(-((TIME / 20) ** 2)) * rng.normal(size=(12, 1))
    return Target(mean + residual, TIME, -30.0, 50.0, 60.0), of_leads, of_time, sd


def test_many_beats_give_the_known_covariance():
    target, of_leads, of_time, sd = known(np.random.default_rng(0), 400)
    found = residual_covariance(target)
    window = target.qrs_samples
    assert np.abs(found.leads - of_leads).max() < 0.06
    assert np.abs(found.time - of_time[window, window]).max() < 0.08
    assert found.sd == pytest.approx(sd[:, window], rel=0.2)
    assert found.shrinkage_leads < 0.02
    assert found.shrinkage_time < 0.05


def test_two_beats_and_beats_without_spread_show_nothing_of_correlations():
    target, *_ = known(np.random.default_rng(3), 2)
    found = residual_covariance(target)
    assert (found.shrinkage_leads, found.shrinkage_time) == (1, 1)
    same = residual_covariance(replace(target, beats=np.tile(target.mean, (4, 1, 1))))
    for covariance in (found, same):
        assert np.array_equal(covariance.time, np.eye(81))
        assert np.array_equal(covariance.leads, np.eye(12))
    assert np.abs(full(same)).max() < 1e-12


@pytest.mark.parametrize("beats", [3, 8])
def test_few_beats_are_shrunk_and_stay_positive(beats):
    rng = np.random.default_rng(beats)
    target, *_ = known(rng, beats)
    found = residual_covariance(target)
    for factor in (found.leads, found.time):
        assert np.linalg.eigvalsh(factor).min() > 0
        assert np.diag(factor) == pytest.approx(1)
    assert found.shrinkage_time > residual_covariance(known(rng, 100)[0]).shrinkage_time


def test_shrinking_brings_the_estimate_closer():
    """Averaged over draws of eight beats, the shrunk correlation in time errs less than the raw."""
    shrunk, raw = [], []
    for seed in range(8):
        target, _, of_time, _ = known(np.random.default_rng(seed), 8)
        window = target.qrs_samples
        found, true = residual_covariance(target), of_time[window, window]
        shrunk.append(((found.time - true) ** 2).sum())
        weight = found.shrinkage_time
        unshrunk = (found.time - weight * np.eye(len(true))) / (1 - weight)
        raw.append(((unshrunk - true) ** 2).sum())
    assert np.mean(shrunk) < np.mean(raw)


def test_unused_leads_have_none_and_stated_noise_is_white():
    target, *_ = known(np.random.default_rng(2), 10)
    beats = target.beats.copy()
    beats[:, 8] = np.nan
    found = residual_covariance(replace(target, beats=beats))
    absent = np.isnan(found.leads)
    assert absent[8].all()
    assert absent[:, 8].all()
    assert absent.sum() == 23
    assert np.isfinite(found.time).all()
    found = residual_covariance(replace(target, beats=target.beats[:1], noise=0.04))
    assert np.array_equal(found.leads, np.eye(12))
    assert np.array_equal(found.time, np.eye(81))
    assert (found.sd == 0.04).all()


def test_repetitions_of_a_single_beat():
    target, *_ = known(np.random.default_rng(2), 10)
    one = replace(target, beats=target.beats[:1], noise=0.04)
    again = repeated(one, np.random.default_rng(0))
    assert len(again.beats) == 10
    assert again.noise is None
    assert again.mean == pytest.approx(one.beats[0])
    assert again.standard_deviation.mean() == pytest.approx(0.04, rel=0.05)
