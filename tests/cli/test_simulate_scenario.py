"""`fascicle simulate --scenario`: what it writes and says, and what it refuses."""

import csv
import json
import shutil

import numpy as np
import pytest
import pyvista as pv

from fascicle.heart.folder import load_heart
from tests.cli.test_simulate import FILES

pytestmark = pytest.mark.usefixtures("blank_pictures")


@pytest.fixture
def case(tmp_path):
    """Write a scenario file."""

    def write(text):
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def corner(small_heart):
    """The tissue's vertex nearest to the origin."""
    vertices = load_heart(small_heart).vertices
    return vertices[np.linalg.norm(vertices, axis=1).argmin()].tolist()


@pytest.fixture
def simulated(small_heart, parameters, case, outside, run):
    def call(text, *arguments, name="sim"):
        out = outside / name
        ended = run(
            "simulate", small_heart, "--params", parameters(), "--scenario", case(text),
            *arguments, "--out", out,
        )  # fmt: skip
        assert (ended.status, ended.err) == (0, ""), ended
        return out, ended.out

    return call


def activation(folder):
    return np.asarray(pv.read(folder / "activation.vtu")["activation"])


INACTIVE = 'inactive_root = [{tree = "lv"}, {tree = "rv"}]'


class TestOutputs:
    def test_pacing_alone(self, simulated, corner):
        out, said = simulated(f"{INACTIVE}\n[[stimulus]]\nposition = {corner}\ntime = -20.5\n")
        assert sorted(p.name for p in out.iterdir()) == FILES
        assert activation(out).min() == -20.5
        with (out / "ecg.csv").open() as file:
            times = [float(row["time_ms"]) for row in csv.DictReader(file)]
        assert times[0] == -21.0
        with (out / "sites.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert (rows[-1]["kind"], rows[-1]["fired"]) == ("stimulus", "captured")
        assert "1 of 1 captured" in said
        inputs = json.loads((out / "summary.json").read_text())["inputs"]
        assert inputs["scenario"].endswith("case.toml")

    def test_blocked_bundle_is_told_in_numbers(self, simulated, written):
        blocked, said = simulated(
            '[[slow_conduction]]\ntree = "lv"\npart = "bundle"\nspeed = 0\n', name="blocked"
        )
        first, second = (
            json.loads((f / "summary.json").read_text())["trees"]["lv"]["retrograde_junctions"]
            for f in (written, blocked)
        )
        assert second > first
        line = next(line for line in said.splitlines() if line.startswith("lv tree"))
        assert f"{second} retrograde" in line

    def test_scar_is_reported(self, simulated, corner):
        out, said = simulated(f"[[region]]\ncentre = {corner}\nradius = 12\nconductivity = 0\n")
        unreached = np.isinf(activation(out))
        assert unreached.any()
        summary = json.loads((out / "summary.json").read_text())
        assert summary["unreached_vertices"] == unreached.sum()
        assert summary["unreached_volume_ml"] > 0
        assert f"never reached          {unreached.sum()} vertices" in said
        with (out / "ecg.csv").open() as file:
            rows = np.array(list(csv.reader(file))[1:], dtype=float)
        assert np.isfinite(rows).all()

    def test_a_third_tree(self, simulated, written, tmp_path):
        """The left tree under another name, written and named after it."""
        tree = pv.read(shutil.copy(written / "lv_tree.vtu", tmp_path))
        root = np.asarray(tree.points)[np.asarray(tree["activation"]).argmin()].tolist()
        out, said = simulated(
            '[[inactive_root]]\ntree = "lv"\n[[tree]]\nname = "band"\n'
            f'file = "lv_tree.vtu"\ntime = -2.5\nroot = {root}\n',
            name="third",
        )
        assert sorted(p.name for p in out.iterdir()) == sorted([*FILES, "band_tree.vtu"])
        band = pv.read(out / "band_tree.vtu")
        assert np.asarray(band["activation"]).min() == -2.5
        assert "band tree" in said
        assert set(json.loads((out / "summary.json").read_text())["trees"]) == {"lv", "rv", "band"}

    def test_works_with_trees_of_your_own(self, small_heart, written, case, outside, run, corner):
        scenario = case(f"[[stimulus]]\nposition = {corner}\ntime = -40\n")
        out = outside / "own"
        ended = run(
            "simulate", small_heart, "--lv-tree", written / "lv_tree.vtu", "--rv-tree",
            written / "rv_tree.vtu", "--scenario", scenario, "--out", out,
        )  # fmt: skip
        assert (ended.status, ended.err) == (0, "")
        assert activation(out).min() == -40


class TestRefusals:
    def test_one_line_that_names_the_scenario(self, small_heart, case, outside, refused):
        path = case("[[region]]\nconductivity = 0\nlabel = 1")
        command = ["simulate", small_heart, "--scenario", path, "--out", outside / "sim"]
        message = refused(command, "region 1: the heart has no labels")
        assert message.startswith(f"error: {path}: ")
        assert list(outside.iterdir()) == []

    def test_other_files(self, small_heart, outside, tmp_path, refused):
        other = tmp_path / "case.json"
        other.write_text("{}")
        for path, words in (
            (other, "cannot read '.json' as scenario; use one of .toml"),
            (tmp_path / "none.toml", "no such file (scenario)"),
            (tmp_path / "none.json", "no such file (scenario)"),
        ):
            command = ["simulate", small_heart, "--scenario", path, "--out", outside / "sim"]
            refused(command, f"{path}: {words}")
        assert list(outside.iterdir()) == []

    def test_wrong_parameters_are_not_blamed_on_it(
        self, small_heart, parameters, case, outside, refused
    ):
        file = parameters(rv_initial_length=300.0)
        message = refused(
            ["simulate", small_heart, "--params", file, "--scenario", case(""), "--out",
             outside / "sim"],
            "RV bundle leaves the endocardium",
        )  # fmt: skip
        assert message.startswith(f"error: {file}: ")


def test_help_shows_what_a_scenario_looks_like(run):
    ended = run("simulate", "--help")
    assert ended.status == 0
    lines = [line.strip() for line in ended.out.splitlines()]
    start = next(k for k, line in enumerate(lines) if line.startswith("[[stimulus]]"))
    following = [line for line in lines[start + 1 :] if line][:2]
    assert following[0].startswith("position = [")
    assert following[1].startswith("time = ")
