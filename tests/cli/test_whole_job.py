"""Recording to prediction on the packaged heart, with a budget of seconds."""

import json
import shutil
import sqlite3
import sys
from dataclasses import replace
from functools import partial

import arviz as az
import numpy as np
import pytest
import pyvista as pv
import xarray as xr

import fascicle
from fascicle import cli
from fascicle.cli.demo import demo_recording
from fascicle.forward.loss import align
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.fit import load_study

BUDGET = {"evaluations": 200, "bank": 100, "effective": 20, "workers": 2}


@pytest.fixture(scope="module")
def target():
    return fascicle.make_target(fascicle.read_recording(demo_recording()))


@pytest.fixture(scope="module")
def study(target, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole job") / "study"  # a space in the path, too
    return fascicle.fit("default", target, folder, **BUDGET)


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["fascicle", *map(str, arguments)])
    try:
        cli.main()
    except SystemExit as stop:
        return stop.code or 0
    return 0


def test_study_folder_holds_what_is_promised(study):
    folder = study.folder
    posterior = az.from_netcdf(folder / "posterior.nc")
    assert set(posterior.posterior.data_vars) == {*fascicle.NETWORK_SPACE.names, "alpha"}
    assert posterior.posterior["cv"].attrs["units"] == "mm/ms"
    assert posterior.posterior["cv"].shape == (2, len(study.population) / 2)
    assert set(posterior.prior.data_vars) == set(posterior.posterior.data_vars)
    assert np.isfinite(posterior.log_likelihood["ecg"]).all()
    assert posterior.attrs["verdict"].startswith("NOT CONVERGED")
    assert posterior.posterior_predictive["ecg"].dims == ("chain", "draw", "lead", "time")
    for name in ("best", "00", "01", "02"):
        for side in ("lv", "rv"):
            tree = pv.read(folder / "networks" / name / f"{side}_tree.vtu")
            assert np.isfinite(tree.point_data["activation"]).all()
    activation = pv.read(folder / "activation.vtu")
    assert {"activation", "activation_mean", "activation_sd"} <= set(activation.point_data)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["verdict"] == study.verdict
    assert set(summary["what_the_ecg_says"]) == set(posterior.posterior.data_vars)
    assert 0 < summary["discrepancy_over_signal"] < 3
    assert {"V1", "QRS duration", "axis"} <= set(summary["probabilities_under_the_model"])


def test_best_network_is_what_the_summary_says(study, target):
    again = study.problem.evaluate(study.problem.space.to_unit(study.population.best))
    assert again.loss == pytest.approx(study.population.best_loss, rel=1e-9)
    assert again.loss < float((target.qrs**2).sum(axis=0).mean())  # better than a flat line


def test_same_seed_same_result_and_resuming_evaluates_nothing(study, target, tmp_path):
    again = fascicle.fit("default", target, tmp_path / "again", **BUDGET)
    for name, values in study.population.values.items():
        np.testing.assert_array_equal(again.population.values[name], values)
    with sqlite3.connect(tmp_path / "again" / "evaluations.sqlite") as ledger:
        before = ledger.execute("SELECT count(*) FROM evaluations").fetchone()
        fascicle.fit("default", target, tmp_path / "again", **BUDGET)
        assert ledger.execute("SELECT count(*) FROM evaluations").fetchone() == before


def test_a_moved_study_goes_on_with_what_it_holds(study, tmp_path):
    moved = shutil.copytree(study.folder, tmp_path / "moved")
    (moved / "posterior.nc").unlink()
    again = fascicle.fit(moved / "heart", moved / "target.nc", moved, **BUDGET)
    assert len(again.study.records()) == len(study.study.records())
    for name, values in study.population.values.items():
        np.testing.assert_array_equal(again.population.values[name], values)


def test_a_study_of_another_target_is_refused(study, target):
    other = fascicle.make_target(fascicle.read_recording(demo_recording()), onset=-40.0)
    with pytest.raises(fascicle.InputError, match=r"holds a study with another target"):
        fascicle.fit("default", other, study.folder, **BUDGET)


def test_another_heart_says_what_differs(study, target, default_heart):
    other = replace(default_heart, values={"alpha": 0.07})
    with pytest.raises(
        fascicle.InputError, match=r"another heart .*conduction alpha \(0.05 there,"
    ):
        fascicle.fit(other, target, study.folder, **BUDGET)


def test_other_rules_of_growth_are_refused(study, target, monkeypatch):
    longer = partial(GrowthRules, branch_length=10.0)
    monkeypatch.setattr("fascicle.study.space.GrowthRules", longer)
    wanted = r"holds a study with another growth branch_length \(8 there, 10 now\)"
    with pytest.raises(fascicle.InputError, match=wanted):
        fascicle.fit("default", target, study.folder, **BUDGET)
    with pytest.raises(fascicle.InputError, match=wanted):
        load_study(study.folder)


def test_another_forward_model_is_refused(study, target, monkeypatch):
    def louder(*arguments, **options):
        alignment = align(*arguments, **options)
        return replace(alignment, loss=1.001 * alignment.loss)

    monkeypatch.setattr("fascicle.study.problem.align", louder)
    names = ("study.json", "evaluations.sqlite", "posterior.nc")
    before = [(study.folder / name).read_bytes() for name in names]
    with pytest.raises(fascicle.InputError, match="another forward model"):
        fascicle.fit("default", target, study.folder, **(BUDGET | {"effective": 22}))
    with pytest.raises(fascicle.InputError, match="another forward model"):
        load_study(study.folder)
    assert [(study.folder / name).read_bytes() for name in names] == before


def test_predict(study, tmp_path, monkeypatch, capsys):
    assert (
        run(monkeypatch, "predict", study.folder, "--root-time", "0", "--out", tmp_path / "p") == 0
    )
    assert "QRS duration" in capsys.readouterr().out
    rows = (tmp_path / "p" / "table.csv").read_text().splitlines()
    assert len(rows) == 1 + len(study.population)
    table = np.array([row.split(",")[1:] for row in rows[1:]], dtype=float)
    assert (table > 30).all()
    assert (table < 250).all()
    summary = json.loads((tmp_path / "p" / "summary.json").read_text())
    tat = table[:, 3]
    assert summary["total_activation_time_after_ms"]["maximum"] == pytest.approx(
        tat.max(), abs=0.01
    )
    for name, value in (("minimum", tat.min()), ("maximum", tat.max())):
        times = pv.read(tmp_path / "p" / f"activation_{name}.vtu").point_data["activation"]
        assert np.ptp(times) == pytest.approx(value, abs=0.01)
    with xr.open_dataset(tmp_path / "p" / "ecgs.nc", engine="h5netcdf") as ecgs:
        assert ecgs["after"].sizes["network"] == len(study.population)


def test_pacing_together_undoes_a_delay(study):
    """Both roots at once: the same trees as before, with nothing but their roots' times changed."""
    network = study.networks()[0]
    model, trees, cv = study.problem.model, network.simulation.trees, network.parameters["cv"]
    late = model.activate(trees, -60.0, cv)
    together = model.activate(trees, 0.0, cv)
    assert together.total_activation_time < late.total_activation_time


def test_report(study, monkeypatch, capsys):
    assert run(monkeypatch, "report", study.folder) == 0
    figures = capsys.readouterr().out.split("\n")[:-1]
    assert [figure.rsplit("/", 1)[1] for figure in figures] == [
        "ecg.png", "pairs.png", "activation.png", "convergence.png",
    ]  # fmt: skip
    for figure in figures:
        with open(figure, "rb") as file:
            assert file.read(4) == b"\x89PNG"


def test_unfinished_study_is_refused(study, tmp_path, monkeypatch, capsys):
    for name in ("study.json", "evaluations.sqlite"):
        (tmp_path / name).write_bytes((study.folder / name).read_bytes())
    for verb in (["report", tmp_path], ["predict", tmp_path, "--out", tmp_path / "p"]):
        assert run(monkeypatch, *verb) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "finish the study" in error
    assert not (tmp_path / "p").exists()


def test_another_heart_in_the_folder_is_refused(study, tmp_path):
    shutil.copytree(study.folder, tmp_path / "s")
    electrodes = tmp_path / "s" / "heart" / "electrodes.csv"
    electrodes.write_text(electrodes.read_text().replace("V6,", "V6,1"))
    with pytest.raises(fascicle.InputError, match="heart: not the one that was fitted"):
        load_study(tmp_path / "s")


@pytest.mark.parametrize("setting", [{"initial": 1}, {"tolerance": 0.0}, {"stepz": 5}])
def test_impossible_settings_are_refused_in_one_line(target, tmp_path, setting):
    name, value = next(iter(setting.items()))
    with pytest.raises(fascicle.InputError, match=f"'{name}' is {value}: ") as caught:
        fascicle.fit("default", target, tmp_path / "s", **setting)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "s").exists()


def test_load_study_gives_the_same_networks(study):
    loaded = load_study(study.folder)
    first, again = study.networks()[0], loaded.networks()[0]
    np.testing.assert_allclose(again.predicted, first.predicted, atol=1e-9)
