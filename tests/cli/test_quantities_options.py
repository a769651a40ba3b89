"""`fascicle parameters`, and the options --fix, --free and --settings."""

import json
import re

import pytest
import xarray as xr

from fascicle.core.parameters import HUMAN_SPACE, NETWORK_SPACE
from fascicle.core.quantities import QUANTITIES
from fascicle.study.study import Study

pytestmark = pytest.mark.usefixtures("blank_pictures")
SMALL = ("--prior-simulations", 100, "--effective", 20, "--fix", "conduction=normal")
PAPER = ("--method", "paper", "--initial", 8, "--steps", 2, "--samples", 2, "--draws", 2000,
         "--rounds", 1)  # fmt: skip


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


def test_fixed_in_a_simulation(run, outside):
    out = outside / "sim"
    options = ["--fix", "alpha=0.08", "--fix", "gain=2"]
    assert run("simulate", "default", *options, "--out", out).status == 0
    inputs = json.loads((out / "summary.json").read_text())["inputs"]["parameters"]
    assert (inputs["alpha"], inputs["gain"]) == (0.08, 2.0)


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("interventricular_delay", "root_time"), ("lv_fascicle_direction_1", "lv_fascicle_angle_1"),
    ],
)  # fmt: skip
def test_what_stands_for_another_is_simulated_in_its_place(run, outside, name, other):
    out = outside / "sim"
    ended = run("simulate", "default", "--fix", f"{name}=0.5", "--out", out)
    assert ended.status == 0, ended.err
    inputs = json.loads((out / "summary.json").read_text())["inputs"]["parameters"]
    assert inputs[name] == 0.5
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
def test_wrong_fixes_of_a_simulation(refused, outside, options, words):
    refused(["simulate", "default", *options, "--out", outside / "sim"], words)


@pytest.fixture(scope="module")
def target(tmp_path_factory, default_model):
    import numpy as np

    from examples.recover_known_network import synthetic_target
    from fascicle.recording.target_files import write_target

    # in the middle of the prior, which the fits of a posterior look at
    human = HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5))
    human |= {"interventricular_delay": 7.5, "rv_source": 0.35, "axial_source": 0.25}
    leads = default_model.simulate(human).leads
    path = tmp_path_factory.mktemp("target") / "target.nc"
    write_target(synthetic_target(leads, np.random.default_rng(0)), path)
    return path


class TestFit:
    def space(self, out):
        config = json.loads((out / "study.json").read_text())
        return [p["name"] for p in config["space"]], config

    def test_the_speed_is_learnt_unless_it_is_fixed(self, run, outside, target):
        options = ["--fix", "fibre_speed=0.6", "--free", "gain"]
        ended = run("fit", "default", target, "--out", outside / "b", *SMALL, *options)
        assert ended.status == 0, ended.err
        names, config = self.space(outside / "b")
        assert names == [*(n for n in HUMAN_SPACE.names if n != "fibre_speed"), "gain"]
        assert config["fixed"] == {"fibre_speed": 0.6}
        assert config["mapped"] is True
        written = (outside / "b" / "networks" / "best" / "parameters.toml").read_text()
        assert "fibre_speed = 0.6" in written
        assert "alpha" not in written

    def test_settings_file_and_options_over_it(self, run, outside, target):
        settings = outside / "study.toml"
        settings.write_text(
            'seed = 5\nmethod = "paper"\n[parameters]\ncv = 2.5\n'
            'alpha = {prior = "log-normal", median = 0.07, sd = 0.2}\n'
        )
        arguments = ["--settings", settings, "--fix", "cv=2.7", *PAPER]
        ended = run("fit", "default", target, "--out", outside / "a", *arguments)
        assert ended.status == 0, ended.err
        names, config = self.space(outside / "a")
        assert "cv" not in names
        assert config["fixed"] == {"cv": 2.7}
        assert (config["seed"], config["method"], config["initial"]) == (5, "paper", 8)
        assert config["space"][-1]["prior"] == "log-normal"

    def test_the_paper_gives_a_population_and_says_what_it_lacks(self, run, outside, target):
        arguments = [*PAPER[:-3], 60, "--rounds", 1, "--leads", "8"]
        ended = run("fit", "default", target, "--out", outside / "a", *arguments)
        assert ended.status == 0
        names, config = self.space(outside / "a")
        assert names == list(NETWORK_SPACE.names)
        assert config["leads"] == "8"
        assert "warning: the recording has 10 beats" in ended.out
        assert re.search(r"warning: \d of 2 networks were accepted of \d+ candidates", ended.out)
        assert re.search(r"result +\d networks, a population and not a posterior\n", ended.out)
        assert not (outside / "a" / "posterior.nc").exists()
        with xr.open_dataset(outside / "a" / "population.nc", engine="h5netcdf") as file:
            assert file.attrs["networks_are"].endswith("a population and not a posterior")
        stages = {r.stage for r in Study.open(outside / "a").records()}
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
    def test_wrong_options(self, refused, outside, target, options, words):
        refused(["fit", "default", target, "--out", outside / "s", *options], words)
        assert not (outside / "s").exists()

    def test_wrong_settings_files_are_named(self, refused, outside, target):
        path = outside / "study.toml"
        path.write_text("[parameters]\nkv = 3")
        arguments = ["fit", "default", target, "--out", outside / "s", "--settings", path]
        refused(arguments, path, "unknown parameter 'kv'")
