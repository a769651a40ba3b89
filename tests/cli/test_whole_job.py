"""Recording to prediction on a small heart, with a budget of seconds."""

import html
import json
import os
import re
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import arviz as az
import numpy as np
import pandas as pd
import pytest
import pyvista as pv
import xarray as xr
from matplotlib import pyplot

import fascicle
from benchmarks.fits import demo_recording
from fascicle.core.leads import LEADS
from fascicle.core.parameters import HUMAN_SPACE
from fascicle.forward.loss import align
from fascicle.heart.folder import load_heart
from fascicle.heart.sites import SEGMENTS
from fascicle.networks.agreement import agreement
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.fitted import load_study

BUDGET = {"prior_simulations": 100, "effective": 20, "workers": 2}
# which asks for no activation as in mapped hearts, whose shape these ventricles have not
FIXED = {"conduction": "left bundle branch block", "rv_fascicle_length_1": 17.0}
FIXED |= {"lv_fascicle_length_1": 35.0, "lv_fascicle_length_2": 12.0, "lv_fascicle_length_3": 35.0}
FIXED |= {"lv_fascicle_direction_2": 0.0, "lv_fascicle_direction_3": -1.1, "fibre_speed": 0.6}
BUDGET |= {"parameters": FIXED}


@pytest.fixture(scope="module")
def target():
    """A beat that no network explains, so that what is said of it carries a caution."""
    return fascicle.make_target(fascicle.read_recording(demo_recording(), invert=["V3", "V4"]))


@pytest.fixture(scope="module")
def study(ventricles, target, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole job") / "study"  # a space in the path, too
    return fascicle.fit(ventricles, target, folder, **BUDGET)


@pytest.fixture(scope="module")
def loaded(study):
    """The same study, read from its folder, which takes seconds."""
    return load_study(study.folder)


def test_study_folder_holds_what_is_promised(study, loaded):
    folder = study.folder
    posterior = az.from_netcdf(folder / "posterior.nc")
    assert set(posterior.posterior.data_vars) == {*HUMAN_SPACE.names} - FIXED.keys()
    assert posterior.posterior["cv"].attrs["units"] == "mm/ms"
    assert posterior.posterior["cv"].shape == (2, len(study.population) / 2)
    assert set(posterior.prior.data_vars) == set(posterior.posterior.data_vars)
    assert np.isfinite(posterior.log_likelihood["ecg"]).all()
    assert posterior.attrs["verdict"] == study.verdict
    assert posterior.posterior_predictive["ecg"].dims == ("chain", "draw", "lead", "time")
    (panel,) = np.ravel(az.plot_ppc(posterior, num_pp_samples=5))  # of what was recorded, one
    pyplot.close("all")
    assert {"Observed", "Posterior predictive"} <= {line.get_label() for line in panel.lines}
    for name in ("best", "00", "01", "02"):
        for side in ("lv", "rv"):
            tree = pv.read(folder / "networks" / name / f"{side}_tree.vtu")
            assert np.isfinite(tree.point_data["activation"]).all()
    activation = pv.read(folder / "activation.vtu")
    assert {"activation", "activation_mean", "activation_sd"} <= set(activation.point_data)
    best = (folder / "networks" / "best" / "parameters.toml").read_text()
    assert "fibre_speed = 0.6" in best
    assert "alpha" not in best
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["verdict"] == study.verdict
    assert loaded.verdict == study.verdict
    target = study.recordings[0].target
    durations = summary["qrs_duration_ms"]
    assert durations["recorded"] == pytest.approx(target.qrs_duration, abs=0.06)
    assert 30 < durations["networks"]["median"] < 250
    found = agreement(target, study.networks()).content()
    assert {name: summary[name] for name in found} == found
    times = summary["statements"]["sequence"]  # of its networks, beside mapped hearts
    assert times == study.statements.sequence != []
    assert times[0].startswith("first activated: ")
    mapped = [study.simulator.model.surfaces.sequence(n.beat.activation).is_mapped
              for n in study.networks()]  # fmt: skip
    assert np.mean(mapped) == study.checks.sequence.mapped
    assert summary["statements"] == json.loads(json.dumps(study.statements.content()))
    apart = replace(study, population=replace(study.population, converged=False))
    assert apart.statements.content()["parameters"] == []  # nothing, of what has not converged
    agreeing = replace(study, population=replace(study.population, converged=True))
    said = agreeing.statements.parameters
    assert {each.name for each in said} == set(posterior.posterior.data_vars)
    assert -8 < summary["explained_by_the_best"] < 1
    assert {"QRS duration", "frontal axis", "V1", "all leads together"} <= set(
        summary["probabilities_under_the_model"]
    )


def test_best_network_is_what_the_summary_says(study, target):
    again = study.recordings[0].align(study.best_network.beat.leads)
    assert again.loss == pytest.approx(study.population.best_loss, rel=1e-9)
    assert again.loss < float((target.qrs**2).sum(axis=0).mean())  # better than a flat line


@pytest.mark.slow
def test_same_seed_same_result_and_resuming_evaluates_nothing(study, ventricles, target, tmp_path):
    again = fascicle.fit(ventricles, target, tmp_path / "again", **BUDGET)
    for name, values in study.population.values.items():
        np.testing.assert_array_equal(again.population.values[name], values)
    with sqlite3.connect(tmp_path / "again" / "evaluations.sqlite") as ledger:
        before = ledger.execute("SELECT count(*) FROM evaluations").fetchone()
        fascicle.fit(ventricles, target, tmp_path / "again", **BUDGET)
        assert ledger.execute("SELECT count(*) FROM evaluations").fetchone() == before


@pytest.mark.slow
def test_a_moved_study_goes_on_with_what_it_holds(study, tmp_path):
    moved = shutil.copytree(study.folder, tmp_path / "moved")
    (moved / "posterior.nc").unlink()
    again = fascicle.fit(moved / "heart", moved / "target.nc", moved, **BUDGET)
    assert len(again.study.records()) == len(study.study.records())
    for name, values in study.population.values.items():
        np.testing.assert_array_equal(again.population.values[name], values)


DAMAGE = {
    "target.nc": lambda path: path.write_bytes(path.read_bytes()[:-2000]),
    "heart/mesh.vtu": lambda path: path.write_bytes(path.read_bytes()[:5000]),
    "heart/heart.toml": lambda path: path.write_text("name = 3"),
    "heart/electrodes.csv": lambda path: path.unlink(),
    "scenario.toml": lambda path: path.write_text("[[inactive_root]]\ntree = 'rv'"),
}


def test_damaged_copies_are_restored(study, ventricles, run, tmp_path):
    """What a study keeps of its heart and recording, when the command fits it again."""
    every = shutil.copytree(study.folder, tmp_path / "every")
    for number, (name, spoil) in enumerate(DAMAGE.items()):
        copied = shutil.copytree(study.folder, tmp_path / str(number))
        spoil(copied / name)
        with pytest.raises(fascicle.InputError):
            load_study(copied)
        spoil(every / name)
    fixed = [word for name, value in FIXED.items() for word in ("--fix", f"{name}={value}")]
    budget = ["--prior-simulations", 100, "--effective", 20, "--workers", 2, *fixed]
    ended = run("fit", ventricles, study.folder / "target.nc", "--out", every, *budget)
    assert ended.status == 0, ended.err
    assert study.verdict in ended.out
    again = load_study(every)
    for parameter, values in study.population.values.items():
        np.testing.assert_array_equal(again.population.values[parameter], values)


def test_another_target_heart_or_growth_says_what_differs(study, ventricles, target):
    later = fascicle.make_target(fascicle.read_recording(demo_recording()), onset=-40.0)
    with pytest.raises(fascicle.InputError, match=r"holds another study \(of another target\)"):
        fascicle.fit(ventricles, later, study.folder, **BUDGET)
    faster = replace(load_heart(ventricles), values={"alpha": 0.07})
    wanted = r"\(of another heart; .*conduction alpha: there 0.05, now 0.07\)"
    with pytest.raises(fascicle.InputError, match=wanted):
        fascicle.fit(faster, target, study.folder, **BUDGET)
    longer = GrowthRules(branch_length=10.0)
    wanted = r"holds another study \(growth branch_length: there 8, now 10\)"
    with pytest.raises(fascicle.InputError, match=wanted):
        fascicle.fit(ventricles, target, study.folder, rules=longer, **BUDGET)
    with pytest.raises(fascicle.InputError, match=wanted):
        load_study(study.folder, rules=longer)


def test_another_forward_model_is_refused(study, ventricles, target, monkeypatch):
    def louder(*arguments, **options):
        alignment = align(*arguments, **options)
        return replace(alignment, loss=1.001 * alignment.loss)

    monkeypatch.setattr("fascicle.networks.target_comparison.align", louder)
    names = ("study.json", "evaluations.sqlite", "posterior.nc")
    before = [(study.folder / name).read_bytes() for name in names]
    with pytest.raises(fascicle.InputError, match="another forward model"):
        fascicle.fit(ventricles, target, study.folder, **(BUDGET | {"effective": 22}))
    assert load_study(study.folder).verdict == study.verdict  # this version's own is not evaluated
    monkeypatch.setattr("fascicle.study.fitted.VERSION", "another")
    with pytest.raises(fascicle.InputError, match="another forward model"):
        load_study(study.folder)
    assert [(study.folder / name).read_bytes() for name in names] == before


def test_predict(blank_pictures, study, tmp_path, run):
    own = tmp_path / "slow-left.toml"
    own.write_text("description = 'a slow branch'\n[his]\nleft = 0.5\n")
    asked = ["--scenario", "his-pacing", "--scenario", own, "--scenario", "biventricular-pacing"]
    ended = run("predict", study.folder, *asked, "--out", tmp_path / "p")
    assert ended.status == 0
    names = ["intrinsic", "his-pacing", "slow-left", "biventricular-pacing"]
    _, caution, head, *rows = ended.out.splitlines()
    assert caution.split(maxsplit=1) == ["caution", study.statements.caution.text]
    assert [row.split()[0] for row in rows[:4]] == names
    assert re.split("  +", head)[1] == "QRS duration (ms)"
    table = pd.read_csv(tmp_path / "p" / "indices.csv")
    assert table["scenario"].unique().tolist() == names
    assert len(table) == len(names) * len(study.population)
    assert table["qrs_duration_ms"].between(30, 250).all()
    summary = json.loads((tmp_path / "p" / "summary.json").read_text())
    assert summary["caution"] == study.statements.caution.text
    assert summary["slow-left"]["description"] == "a slow branch"
    assert summary["intrinsic"]["qrs_duration_ms"]["change"]["95 %"] == 0
    assert sum(summary["his-pacing"]["latest_segment"].values()) == pytest.approx(1, abs=0.01)
    paced = table[table["scenario"] == "biventricular-pacing"]["total_activation_time_ms"]
    arrays = pv.read(tmp_path / "p" / "biventricular-pacing" / "activation.vtu").point_data
    for name, share in (("5th_percentile", 0.05), ("95th_percentile", 0.95)):
        total = np.quantile(paced, share, method="nearest")
        assert np.ptp(arrays[f"activation_{name}"]) == pytest.approx(total, abs=0.01)
    assert ((arrays["probability_latest_fifth"] >= 0) & (arrays["activation_sd"] >= 0)).all()
    path = tmp_path / "p" / "his-pacing" / "ecgs.nc"
    with xr.open_dataset(path, engine="h5netcdf") as ecgs:
        assert ecgs["ecg"].sizes["network"] == len(study.population)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["hiss-pacing"], "no scenario 'hiss-pacing'; did you mean 'his-pacing'?"),
        (["missing.toml"], "missing.toml"),
        (["his-pacing", "his-pacing"], "two scenarios are called 'his-pacing'"),
    ],
)
def test_predict_refuses(study, tmp_path, refused, asked, words):
    options = [text for name in asked for text in ("--scenario", name)]
    refused(["predict", study.folder, *options, "--out", tmp_path / "p"], words)
    assert not (tmp_path / "p").exists()


def test_compare(study, run):
    asked = ["compare", study.folder, "his-pacing", "left-bundle-branch-block"]
    lines = run(*asked, "--threshold", "2").out.splitlines()
    assert lines[1].split(maxsplit=1) == ["caution", study.statements.caution.text]
    heading = f"his-pacing against left-bundle-branch-block, {len(study.population)} networks"
    assert lines[2] == heading
    end = next(k for k, line in enumerate(lines) if "P(reduction > 2 ms) = " in line)
    cells = [re.split("  +", line) for line in lines[4:end]]
    shown = {name: float(probability) for name, probability, _ in cells}
    assert "QRS duration" in shown
    assert shown["LV activation time"] > 0.9
    assert all(0 <= probability <= 1 for probability in shown.values())
    assert lines[end].startswith("total activation time: P(reduction > 2 ms) = ")


def test_export(study, tmp_path, run, refused):
    """The network nearest to the median by default, some of them, or the best where none is."""
    out = tmp_path / "export"
    ended = run("study", "export", study.folder, "--out", out)
    assert ended.well, ended
    assert ended.out.splitlines()[0].split(maxsplit=1) == ["caution", study.statements.caution.text]
    summary = json.loads((out / "summary.json").read_text())
    ((name, parameters),) = summary["networks"].items()
    assert summary["chosen"] == "nearest to the median activation map"
    assert parameters == study.population.parameters(int(name)) | study.settings.fixed
    assert (out / "heart.pts").exists()
    assert (out / name / "eikonal.par").exists()
    times = study.networks(chosen=[int(name)])[0].beat.activation
    np.testing.assert_allclose(np.loadtxt(out / name / "activation.dat"), times, atol=1e-5)
    written = json.loads(
        run("study", "export", study.folder, "--format", "csv", "--networks", 3, "--out",
            tmp_path / "tables", "--json").out
    )  # fmt: skip
    every = len(study.population)
    assert list(written["networks"]) == [f"{k:03d}" for k in (0, round((every - 1) / 2), every - 1)]
    for folder in written["networks"]:
        table = pd.read_csv(tmp_path / "tables" / folder / "activation.csv")
        assert table["time_ms"].notna().all()
    population = study.population
    none = {"values": {n: v[:0] for n, v in population.values.items()}, "losses": np.empty(0)}
    left = replace(study, population=replace(population, **none), gains=None)
    assert list(left.export(tmp_path / "best", "vtu")["networks"]) == ["best"]
    assert pv.read(tmp_path / "best" / "best" / "lv_tree.vtu").n_cells > 50


def test_export_refuses(study, tmp_path, refused, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    asked = ["study", "export", study.folder, "--format", "csv", "--networks", 1, "--out"]
    refused([*asked, tmp_path / "mine"], "holds 'notes.txt', which would be lost")
    refused([*asked, tmp_path / "file"], "is a file; give the path of a folder (--out)")
    with pytest.raises(fascicle.InputError, match="kind is 'stl'; give one of opencarp, vtu, csv"):
        study.export(tmp_path / "stl", "stl")
    with pytest.raises(fascicle.InputError, match="networks is 0; give a whole number, 1 or more"):
        study.export(tmp_path / "none", networks=0)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("fascicle.study.export.sites_table", full)
    refused([*asked, tmp_path / "full"], tmp_path / "full", "No space left on device")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_sweep(blank_pictures, study, tmp_path, run, refused):
    asked = ["sweep", study.folder, "biventricular-pacing", "--networks", "3"]
    lines = run(*asked, "--delay=-20:20:20", "--out", tmp_path / "s").out.splitlines()
    assert [line.split()[0] for line in lines[3:6]] == ["-20", "0", "20"]
    assert sum(int(line.split()[-1][:-1]) for line in lines[3:6]) == pytest.approx(100, abs=2)
    table = pd.read_csv(tmp_path / "s" / "indices.csv")
    assert table.groupby("scenario").size().to_dict() == {"-20 ms": 3, "0 ms": 3, "20 ms": 3}
    medians = json.loads((tmp_path / "s" / "summary.json").read_text())["medians"]
    early = table[table["scenario"] == "-20 ms"]["total_activation_time_ms"]
    assert medians["-20 ms"] == pytest.approx(early.median(), abs=0.01)
    assert (tmp_path / "s" / "sweep.png").exists()
    lines = run(*asked, "--segments", "epicardium", "--out", tmp_path / "e").out.splitlines()
    assert [re.split("  +", line)[0] for line in lines[3:20]] == list(SEGMENTS)
    assert (tmp_path / "e" / "sweep.png").exists()
    lines = run(*asked, "--radius", "0:8:4", "--out", tmp_path / "r").out.splitlines()
    assert [line.split()[0] for line in lines[3:6]] == [*"048"]
    for wrong in (["--delay", "0:1"], [], ["--segments", "middle"]):
        refused([*asked, *wrong, "--out", tmp_path / "w"])
    assert not (tmp_path / "w").exists()


def test_report(study, run):
    asked = ["report", study.folder, "--scenario", "his-pacing", "--format", "png", "--pdf"]
    pyplot.close("all")
    verdict, pdf, *figures, page = run(*asked).out.splitlines()
    assert Path(pdf) == study.folder / "report.pdf"
    assert len(re.findall(rb"/Type /Page\b", Path(pdf).read_bytes())) == 1
    assert study.verdict in verdict
    assert [figure.rsplit("/", 1)[1] for figure in figures] == [
        "ecg.png", "activation.png", "activation-spread.png", "indices.png", "priors.png",
        "pairs.png", "recording.png", "emulator.png", "convergence.png", "heart.png",
    ]  # fmt: skip
    for figure in figures:
        with open(figure, "rb") as file:
            assert file.read(4) == b"\x89PNG"
    assert page == (study.folder / "report.html").resolve().as_uri()
    assert pyplot.get_fignums() == [], "figures of a report are no business of pyplot"
    text = (study.folder / "report.html").read_text()
    assert (
        html.unescape(text).count(study.statements.caution.text) >= 5
    )  # headings; figures show it
    assert study.verdict in html.unescape(text)
    assert len(text) < 5_000_000
    assert not re.search(r"(src|href)=.https?:", text), "nothing is loaded from elsewhere"
    content = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.S)
    scenarios = json.loads(content[1])["scenarios"]
    assert [scenario["name"] for scenario in scenarios] == ["intrinsic", "his-pacing"]
    assert all(warning in html.unescape(text) for warning in study.warnings)
    rows = dict(re.findall(r'<th[^>]*>([^<]*)</th>\s*<td class="number">(.*?)</tr>', text, re.S))
    said = json.loads((study.folder / "summary.json").read_text())
    cells = re.findall(r"[-\d.]+%", rows["variance explained"])
    assert cells == [f"{said['explained_power'][lead]:.0%}" for lead in (*LEADS, "all")]
    cells = re.findall(r"[-\d.]+\d", rows["correlation"])
    assert cells == [f"{said['correlation'][lead]:.2f}" for lead in (*LEADS, "all")]
    (window,) = (row for name, row in rows.items() if name.startswith("QRS duration"))
    known = said["qrs_duration_ms"]
    assert window.startswith(f"{known['recorded']:.0f} ms<")
    assert f"{known['networks']['median']:.0f} (" in window


def test_a_report_where_nothing_can_be_written_says_what_helps(study, monkeypatch, refused):
    really = os.access

    def closed(path, mode):  # root, as which tests may run, may write everywhere
        return really(path, mode) and not (mode & os.W_OK and path == study.folder)

    monkeypatch.setattr("fascicle.core.files.os.access", closed)
    words = f"{study.folder / 'report.html'}: cannot be written", "choose another place (--out)"
    refused(["report", study.folder], *words)


@pytest.mark.slow
def test_a_report_against_another_scenario(blank_pictures, study, tmp_path, run, refused):
    asked = ["report", study.folder, "--out", tmp_path / "r.html", "--scenario", "his-pacing"]
    words = "intrinsic, his-pacing; add it to them (--scenario blok)\n"
    refused([*asked, "--against", "blok"], words)
    refused([*asked, "--format", "jpg"], "figures cannot be drawn as 'jpg'; use png, pdf, svg")
    assert not (tmp_path / "r.html").exists()
    block = ["--scenario", "left-bundle-branch-block", "--against", "left-bundle-branch-block"]
    assert run(*asked, *block, "--format", "svg").status == 0
    assert "against left-bundle-branch-block" in (tmp_path / "r.html").read_text()
    assert b"<svg" in (tmp_path / "figures" / "heart.svg").read_bytes()[:2000]


def test_networks_and_gains_are_those_that_were_drawn(study, loaded):
    first, again = study.networks()[0], loaded.networks()[0]
    np.testing.assert_allclose(again.predicted, first.predicted, atol=1e-9)
    with xr.open_dataset(study.folder / "posterior.nc", group="sample_stats") as stats:
        np.testing.assert_array_equal(loaded.gains, stats["gain"].to_numpy().ravel())
    np.testing.assert_array_equal(loaded.gains, study.gains)
    drawn = [network.drawn_gain for network in study.networks(chosen=[5, 0])]
    assert drawn == [study.gains[5], study.gains[0]]
    assert np.ptp(study.gains) > 0
    predicted = fascicle.predict(study, "his-pacing")["his-pacing"]
    assert predicted.effective == study.population.effective_size
    assert 0 < predicted.effective <= len(study.population)


def test_plots_in_a_notebook(study):
    """Every one draws something on axes of a figure of its own, of which pyplot knows."""
    plot, predicted = fascicle.plot, fascicle.predict(study, "left-bundle-branch-pacing")
    assert list(predicted) == ["intrinsic", "left-bundle-branch-pacing"]
    heart = study.simulator.model.heart
    drawn = {
        "ecg": plot.ecg(study),
        "scenario_ecg": plot.scenario_ecg(predicted, "left-bundle-branch-pacing"),
        "activation": plot.activation(heart, predicted, "left-bundle-branch-pacing"),
        "activation_spread": plot.activation_spread(heart, predicted),
        "indices": plot.indices(predicted),
        "pairs": plot.pairs(study),
        "priors": plot.priors(study),
        "convergence": plot.convergence(study),
        "heart": plot.heart(heart),
        "tree": plot.tree(study.best_network.beat.trees[0]),
        "beat": plot.beat(study.best_network.beat),
        "prediction": plot.prediction(predicted["intrinsic"]),
        "target": plot.target(study.recordings[0].target),
    }
    public = {name for name, known in vars(plot).items() if getattr(known, "__module__", "") ==
              plot.__name__ and not name.startswith("_")}  # fmt: skip
    assert drawn.keys() == public
    assert len(pyplot.get_fignums()) == len(drawn)
    assert pyplot.gcf() is drawn["target"][0].figure
    pyplot.close("all")
    for axes in drawn.values():
        assert axes
        assert all(one.figure is axes[0].figure for one in axes)
        assert any(one.has_data() for one in axes)
    assert [len(drawn[name]) for name in ("ecg", "scenario_ecg", "target")] == [12, 12, 12]
    with pytest.raises(fascicle.InputError, match="there is no recording 1; the study has 1, "):
        plot.ecg(study, recording=1)
    with pytest.raises(fascicle.InputError, match="'his-pacing' was not predicted; there"):
        plot.scenario_ecg(predicted, "his-pacing")
    found = fascicle.compare(
        predicted["left-bundle-branch-pacing"], predicted["intrinsic"], "qrs_area"
    )
    assert 0 <= found.probability() <= 1


def test_unfinished_study_is_refused(study, tmp_path, refused):
    for name in ("study.json", "evaluations.sqlite"):
        (tmp_path / name).write_bytes((study.folder / name).read_bytes())
    out = ["--out", tmp_path / "p"]
    for verb in (["report", tmp_path], ["predict", tmp_path, *out],
                 ["study", "export", tmp_path, *out]):  # fmt: skip
        refused(verb, "finish the study")
    assert not (tmp_path / "p").exists()


def test_another_heart_in_the_folder_is_refused(study, tmp_path):
    shutil.copytree(study.folder, tmp_path / "s")
    electrodes = tmp_path / "s" / "heart" / "electrodes.csv"
    electrodes.write_text(electrodes.read_text().replace("V6,-9", "V6,-8"))
    with pytest.raises(fascicle.InputError, match="heart: not the one that was fitted"):
        load_study(tmp_path / "s")


@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("initial", 1, "1: "), ("tolerance", 0, "0: "),
        ("stepz", 5, "no setting of a fit; did you mean 'steps'?"),
    ],
)  # fmt: skip
def test_impossible_settings_are_refused_in_one_line(
    ventricles, target, tmp_path, name, value, fault
):
    with pytest.raises(fascicle.InputError, match=re.escape(f"'{name}' is {fault}")) as caught:
        fascicle.fit(ventricles, target, tmp_path / "s", **{name: value})
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "s").exists()
