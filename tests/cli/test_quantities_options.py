"""`fascicle parameters`, and the options --fix, --free and --settings."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from anatomies import NETWORK

from examples.recover_known_network import synthetic_target
from fascicle.core.parameters import HUMAN_SPACE, NETWORK_SPACE
from fascicle.core.quantities import QUANTITIES
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart
from fascicle.recording.target_files import write_target
from fascicle.study.study import Study

pytestmark = pytest.mark.usefixtures("blank_pictures")


def test_every_quantity_is_listed(run):
    ended = run("parameters")
    assert ended.status == 0
    for name, known in QUANTITIES.items():
        if "_fascicle_" not in name:
            assert name in ended.out
            assert known.meaning.split()[0] in ended.out
    usual = ended.out.partition("By default a fit learns")[2].partition("Groups")[0]
    for parameter in HUMAN_SPACE.parameters:
        assert re.search(rf"{parameter.name} .*{parameter.lower:g} to {parameter.upper:g}\b", usual)


@pytest.mark.parametrize(
    ("fixed", "other"),
    [
        ({"interventricular_delay": 0.5, "alpha": 0.08, "gain": 2.0}, "root_time"),
        ({"lv_fascicle_direction_1": 0.5}, "lv_fascicle_angle_1"),
    ],
)
def test_fixed_in_a_simulation(run, ventricles, outside, fixed, other):
    """What stands for another is simulated in its place."""
    out = outside / "sim"
    options = [word for name, value in fixed.items() for word in ("--fix", f"{name}={value}")]
    ended = run("simulate", ventricles, *options, "--out", out)
    assert ended.status == 0, ended.err
    inputs = json.loads((out / "summary.json").read_text())["inputs"]["parameters"]
    assert fixed.items() <= inputs.items()
    assert other not in inputs


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--fix", "alpha"], "--fix alpha: not a name and a number"),
        (["--fix", "aplha=0.1"], "did you mean 'alpha'"),
        (["--fix", "alpha=0.1", "--fix", "alpha=0.2"], "given twice"),
        (["--cv", "3", "--fix", "cv=2"], "given twice"),
        (["--fix", "cv=200"], "--fix cv=200: parameter 'cv' is 200 mm/ms; give"),
        (["--fix", "alpha=0.1", "--fix", "fibre_speed=0.6"], "say the same; give one"),
    ],
)
def test_wrong_fixes_of_a_simulation(refused, ventricles, outside, options, words):
    refused(["simulate", ventricles, *options, "--out", outside / "sim"], words)


@pytest.fixture(scope="module")
def target(tmp_path_factory, ventricles):
    leads = ForwardModel(load_heart(ventricles)).simulate(NETWORK).leads
    path = tmp_path_factory.mktemp("target") / "target.nc"
    write_target(synthetic_target(leads, np.random.default_rng(0)), path)
    return path


class TestFit:
    def test_options_over_a_settings_file_give_a_population_of_the_paper(
        self, run, ventricles, outside, target
    ):
        """Which says what it lacks."""
        settings, out = outside / "study.toml", outside / "a"
        settings.write_text(
            'seed = 5\nmethod = "paper"\n[parameters]\ncv = 2.5\n'
            'alpha = {prior = "log-normal", median = 0.07, sd = 0.2}\n'
            "lv_initial_length = {lower = 15, upper = 30}\n"
            "rv_initial_length = {lower = 15, upper = 30}\n"
        )
        ended = run(
            "fit", ventricles, target, "--out", out, "--settings", settings, "--fix", "cv=2.7",
            "--free", "gain", "--leads", 8, "--initial", 8, "--steps", 2, "--samples", 2,
            "--draws", 60, "--rounds", 1,
        )  # fmt: skip
        assert ended.status == 0, ended.err
        config = json.loads((out / "study.json").read_text())
        learnt = {p["name"]: p["prior"] for p in config["space"]}
        assert learnt.keys() == {*NETWORK_SPACE.names, "gain", "alpha"} - {"cv"}
        assert (config["fixed"], learnt["alpha"]) == ({"cv": 2.7}, "log-normal")
        assert (config["seed"], config["method"], config["initial"]) == (5, "paper", 8)
        assert config["leads"] == "8"
        assert "warning: the recording has 10 beats" in ended.out
        assert re.search(r"warning: \d of 2 networks were accepted of \d+ candidates", ended.out)
        assert re.search(r"result +\d networks, a population and not a posterior\n", ended.out)
        assert not (out / "posterior.nc").exists()
        with xr.open_dataset(out / "population.nc", engine="h5netcdf") as file:
            assert file.attrs["networks_are"].endswith("a population and not a posterior")
        stages = {r.stage for r in Study.open(out).records()}
        assert stages == {"initial", "optimisation", "rejection"}

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (["--free", "generations"], "fixed, not learnt"),
            (["--free", "alpha", "--fix", "alpha=0.1"], "--free alpha: it is fixed as well"),
            (["--method", "paper", "--free", "gain", "--free-gain"], "leave --free-gain out"),
            (["--fix", "region_1_conductivity=0"], "no labels"),
            (["--settings", "none.toml"], "none.toml"),
            (
                ["--method", "paper", "--prior-simulations", 900],
                "'prior_simulations' is 900: the method 'paper' has no such",
            ),
            (["--steps", 5], "'steps' is 5: the method 'posterior' has no such setting"),
        ],
    )
    def test_wrong_options(self, refused, small_heart, outside, target, options, words):
        refused(["fit", small_heart, target, "--out", outside / "s", *options], words)
        assert not (outside / "s").exists()

    def test_wrong_settings_files_are_named(self, refused, small_heart, outside, target):
        path = outside / "study.toml"
        path.write_text("[parameters]\nkv = 3")
        arguments = ["fit", small_heart, target, "--out", outside / "s", "--settings", path]
        refused(arguments, path, "unknown parameter 'kv'")
