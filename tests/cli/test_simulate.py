"""`fascicle simulate`: what it writes, and what it refuses."""

import csv
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

from fascicle.core.leads import LEADS
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart
from fascicle.recording.window import qrs_window

FILES = [
    "activation.png", "activation.vtu", "ecg.csv", "ecg.png", "junctions.vtu", "lv_tree.vtu",
    "rv_tree.vtu", "sites.csv", "summary.json",
]  # fmt: skip


def read_ecg(folder):
    with (folder / "ecg.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


@pytest.fixture
def simulated(written, outside):
    """A copy of the outputs of a simulation from parameters."""
    return shutil.copytree(written, outside / "from parameters")


@pytest.fixture
def simulate_refused(small_heart, outside, refused):
    def call(arguments, *words):
        before = sorted(outside.rglob("*"))
        message = refused(["simulate", small_heart, *arguments, "--out", outside / "sim"], *words)
        assert sorted(outside.rglob("*")) == before
        return message

    return call


class TestOutputs:
    def test_files(self, simulated, outside):
        assert sorted(p.name for p in simulated.iterdir()) == FILES
        assert list(outside.iterdir()) == [simulated]

    def test_activation(self, simulated, small_heart):
        mesh = pv.read(simulated / "activation.vtu")
        assert list(mesh.point_data) == ["activation", "origin"]
        heart = load_heart(small_heart)
        np.testing.assert_array_equal(mesh.points, heart.vertices)
        assert mesh.n_cells == len(heart.tetrahedra)
        assert 0 <= mesh["activation"].min() < 20
        assert 20 < np.ptp(mesh["activation"]) < 200

    def test_trees(self, simulated):
        for side, first in (("lv", 12.5), ("rv", 0.0)):  # root_time is -12.5 ms
            tree = pv.read(simulated / f"{side}_tree.vtu")
            assert "activation" in tree.point_data
            assert set(tree.celltypes) == {pv.CellType.LINE}
            assert tree.n_cells == tree.n_points - 1
            assert tree["activation"].min() == pytest.approx(first)
            assert tree["activation"].max() <= first + tree["length"].sum() / 2.7 + 1e-9

    def test_ecg(self, simulated):
        header, rows = read_ecg(simulated)
        assert header == ["time_ms", *LEADS]
        np.testing.assert_array_equal(rows[:, 0], np.arange(len(rows)))
        leads = dict(zip(header, rows.T, strict=True))
        np.testing.assert_allclose(leads["III"], leads["II"] - leads["I"], atol=2e-6)
        np.testing.assert_allclose(leads["aVR"], -(leads["I"] + leads["II"]) / 2, atol=2e-6)
        assert np.abs(rows[:, 1:]).max() > 1e-3

    def test_summary(self, simulated):
        summary = json.loads((simulated / "summary.json").read_text())
        activation = pv.read(simulated / "activation.vtu")["activation"]
        assert summary["total_activation_time_ms"] == pytest.approx(np.ptp(activation), abs=1e-3)
        leads = read_ecg(simulated)[1][:, 1:].T
        onset, offset = qrs_window(leads)
        assert summary["qrs_duration_ms"] == pytest.approx(offset - onset, abs=1)
        assert summary["inputs"]["parameters"]["root_time"] == -12.5
        assert summary["trees"]["lv"]["nodes"] == pv.read(simulated / "lv_tree.vtu").n_points
        assert summary["trees"]["rv"]["junctions"] > 1

    def test_options_override_the_file(self, blank_pictures, small_heart, parameters, outside, run):
        out = outside / "sim"
        arguments = ["--params", parameters(), "--cv", 3.5, "--root-time", 0]
        assert run("simulate", small_heart, *arguments, "--out", out).status == 0
        inputs = json.loads((out / "summary.json").read_text())["inputs"]["parameters"]
        assert (inputs["cv"], inputs["root_time"]) == (3.5, 0.0)
        assert pv.read(out / "lv_tree.vtu")["activation"].min() == 0

    def test_action_potential_of_ones_own(
        self, blank_pictures, small_heart, parameters, simulated, outside, run
    ):
        """Half the built-in one: half the ECG, and the summary says which it was."""
        from fascicle.forward.template import default_template

        times = np.linspace(-4.0, 60.0, 12801)
        table = outside.parent / "u.csv"
        rows = np.column_stack([times, default_template()(times) / 2])
        np.savetxt(table, rows, "%.9g", ",", header="time_ms,potential_mV", comments="")
        arguments = ["--params", parameters(), "--action-potential", table]
        assert run("simulate", small_heart, *arguments, "--out", outside / "half").status == 0
        (_, whole), (_, half) = read_ecg(simulated), read_ecg(outside / "half")
        np.testing.assert_allclose(half[:, 1:], whole[:, 1:] / 2, atol=5e-6)
        for folder, name in ((simulated, "built-in"), (outside / "half", str(table))):
            inputs = json.loads((folder / "summary.json").read_text())["inputs"]
            assert inputs["action_potential"].startswith(name)

    def test_nothing_but_a_heart_is_needed(self, ventricles, tmp_path, monkeypatch, run):
        monkeypatch.chdir(tmp_path)
        ended = run("simulate", "default")
        assert (ended.status, ended.err) == (0, "")
        out = tmp_path / "simulation"
        assert sorted(p.name for p in out.iterdir()) == FILES
        inputs = json.loads((out / "summary.json").read_text())["inputs"]
        assert inputs["parameters"] == load_heart("default").example
        header, rows = read_ecg(out)
        v1, v6 = (rows[:, header.index(lead)] for lead in ("V1", "V6"))
        assert -v1.min() > v1.max()  # rS on the right, R on the left
        assert v6.max() > -v6.min()
        # pictures in another format take the place of the first
        assert (out / "ecg.png").read_bytes().startswith(b"\x89PNG")
        ended = run("simulate", ventricles, "--format", "svg")
        assert ended.status == 0
        assert "pictures: simulation/ecg.svg, simulation/activation.svg" in ended.out
        assert b"<svg" in (out / "activation.svg").read_bytes()[:2000]
        assert not (out / "ecg.png").exists()


def changed(values, row, value):
    values = np.array(values, float)
    values[row] = value
    return values


SPOILT = {  # what a tree is saved with, from its points, lines and lengths; and the refusal
    "two pieces": (lambda p, t, n: {"lines": np.delete(t, 5, axis=0)},
                   "2 unconnected pieces; give one tree"),
    "far away": (lambda p, t, n: {"points": p + 300},
                 "mm away, at (", "; give the tree in the heart's frame"),
    "leaves far away": (lambda p, t, n: {"points": np.vstack([p[:1], p[1:] + 300])},
                        "mm from the tissue", "; give the tree in the heart's frame"),
    "nan": (lambda p, t, n: {"points": changed(p, 4, np.nan)}, "not finite (first: 4 at ("),
    "too short": (lambda p, t, n: {"length": changed(n, 6, 0.1)},
                  "segment 6 has length", "; correct or remove the array 'length'"),
}  # fmt: skip


@pytest.mark.usefixtures("blank_pictures")
class TestTrees:
    def arguments(self, simulated, lv=None, rv=None):
        lv = lv if lv is not None else simulated / "lv_tree.vtu"
        rv = rv if rv is not None else simulated / "rv_tree.vtu"
        return ["--lv-tree", lv, "--rv-tree", rv, "--cv", 2.7, "--root-time", -12.5]

    def test_written_trees_give_the_same(self, simulated, small_heart, outside, run):
        out = outside / "again"
        ended = run("simulate", small_heart, *self.arguments(simulated), "--out", out)
        assert (ended.status, ended.err) == (0, "")
        first, second = (pv.read(f / "activation.vtu")["activation"] for f in (simulated, out))
        np.testing.assert_allclose(second, first, rtol=0, atol=1e-9)
        np.testing.assert_allclose(read_ecg(out)[1], read_ecg(simulated)[1], rtol=0, atol=1e-9)
        for name in ("lv_tree.vtu", "rv_tree.vtu"):
            first, second = (np.sort(pv.read(f / name)["activation"]) for f in (simulated, out))
            np.testing.assert_allclose(second, first, rtol=0, atol=1e-9)

    @pytest.mark.parametrize("case", SPOILT)
    def test_spoilt_trees(self, simulated, outside, simulate_refused, case):
        """The left tree, saved with other points, lines or lengths."""
        spoil, *words = SPOILT[case]
        tree = pv.read(simulated / "lv_tree.vtu")
        arrays = {"points": np.array(tree.points), "lines": tree.cells.reshape(-1, 3)[:, 1:]}
        arrays |= spoil(*arrays.values(), tree["length"])
        spoilt = pv.UnstructuredGrid({pv.CellType.LINE: arrays["lines"]}, arrays["points"])
        if "length" in arrays:
            spoilt.cell_data["length"] = arrays["length"]
        spoilt.save(file := outside / "spoilt.vtu")
        simulate_refused(self.arguments(simulated, lv=file), file, *words)

    def test_files_that_do_not_go_together(self, simulated, parameters, simulate_refused):
        lv, rv, tissue = (simulated / f"{n}.vtu" for n in ("lv_tree", "rv_tree", "activation"))
        simulate_refused(self.arguments(simulated, tissue), tissue, "no lines", "; give a mesh")
        words = rv, "given as the LV tree", "; swap the two trees"
        simulate_refused(self.arguments(simulated, rv, lv), *words)
        for option, tree in (("--lv-tree", lv), ("--rv-tree", rv)):
            simulate_refused([option, tree], "only one tree", "; give both")
        arguments = [*self.arguments(simulated), "--params", parameters()]
        simulate_refused(arguments, "exclude each other; give one kind")

    @pytest.mark.parametrize("name", ["t.pkl", "t.obj"])
    def test_files_that_are_no_trees(self, simulated, simulate_refused, outside, name):
        arguments = self.arguments(simulated, lv=outside / name)
        simulate_refused(arguments, name, "no such file")
        (outside / name).write_text("hello\n")
        simulate_refused(arguments, name, "use one of .vtu, .vtp")

    @pytest.mark.parametrize(("option", "value"), [("--cv", "nan"), ("--root-time", "-1e9")])
    def test_options(self, simulated, simulate_refused, option, value):
        arguments = self.arguments(simulated)
        arguments[arguments.index(option) + 1] = value
        simulate_refused(arguments, f"error: {option}: parameter", "; give ")


class TestParameters:
    @pytest.fixture
    def refuse(self, parameters, simulate_refused):
        def call(*words, **replaced):
            file = parameters(**replaced)
            return simulate_refused(["--params", file], file, *words)

        return call

    @pytest.mark.parametrize(
        ("changed", "words"),
        [
            ({"lv_initial_lenght": 3.0}, "unknown parameter 'lv_initial_lenght'; did you mean '"),
            ({"root_time": None, "cv": None}, "missing parameters root_time, cv; add them"),
            ({"cv": '"3"'}, "parameter 'cv' is '3'; give a number"),
            ({"cv": 0}, "parameter 'cv' is 0 mm/ms; give 0.1 to 20 mm/ms"),
            ({"cv": "1" + "0" * 5000}, "; write lines like"),
        ],
    )
    def test_that_cannot_be(self, refuse, changed, words):
        refuse(words, **changed)

    @pytest.mark.parametrize("content", [b"cv = 3\ncv = 4\n", b"\xff\xfe", b"a = " + b"[" * 10_000])
    def test_no_toml(self, tmp_path, simulate_refused, content):
        file = tmp_path / "spoilt.toml"
        file.write_bytes(content)
        simulate_refused(
            ["--params", file], file, "not valid TOML", "; write lines like 'cv = 3.0'"
        )

    def test_other_files(self, tmp_path, simulate_refused):
        simulate_refused(["--params", tmp_path / "no.toml"], "no.toml", "no such file")
        simulate_refused(["--params", tmp_path], tmp_path, "not a file")
        for name in ("p.json", "p.pkl"):
            (tmp_path / name).write_text("{}")
            simulate_refused(["--params", tmp_path / name], name, "use one of .toml")

    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("lv_initial_length", "LV bundle leaves the endocardium after"),
            ("rv_fascicle_length_2", "RV fascicle 2 leaves the endocardium after"),
        ],
    )
    def test_what_does_not_fit(self, refuse, name, words):
        message = refuse(words, "of 300.0 mm", "; shorten it", **{name: 300.0})
        fits = float(message.split("after ")[1].split(" of")[0])
        assert 0 < fits < 60 * math.sqrt(3)


@pytest.mark.usefixtures("blank_pictures")
class TestOut:
    def test_bad_input_leaves_good_output(self, simulated, small_heart, parameters, refused):
        before = {p.name: p.read_bytes() for p in simulated.iterdir()}
        bad = ["--params", parameters(cv="nan"), "--out", simulated]
        refused(["simulate", small_heart, *bad], "parameter 'cv' is nan")
        assert {p.name: p.read_bytes() for p in simulated.iterdir()} == before

    def test_again_replaces(self, simulated, small_heart, parameters, run, outside):
        again = ["--params", parameters(), "--cv", 4, "--out", simulated]
        assert run("simulate", small_heart, *again).status == 0
        assert "4.0" in (simulated / "summary.json").read_text()
        assert list(outside.iterdir()) == [simulated]

    def test_somebodys_file(self, simulated, small_heart, parameters, refused, outside):
        (simulated / "notes.txt").write_text("mine")
        before = {p.name: p.read_bytes() for p in simulated.iterdir()}
        again = ["--params", parameters(), "--out", simulated]
        refused(["simulate", small_heart, *again], "'notes.txt', which would be lost; give another")
        assert {p.name: p.read_bytes() for p in simulated.iterdir()} == before
        assert list(outside.iterdir()) == [simulated]


def test_leads_of_additional_electrodes_follow_the_twelve(
    blank_pictures, small_heart, parameters, simulated, outside, run
):
    heart = outside / "with a vest"
    shutil.copytree(small_heart, heart, ignore=shutil.ignore_patterns(".fascicle-cache"))
    nine = (heart / "electrodes.csv").read_text().splitlines()[1:]
    places = [line.partition(",")[2] for line in nine]
    names = ["v7", *(f"E{k}" for k in range(1, 10)), *"ACEFHIM"]
    with (heart / "electrodes.csv").open("a") as file:
        for name, place in zip(names, [*places, *places[:8]], strict=True):
            file.write(f"{name},{place}\n")
    out = outside / "leads of a vest"
    ended = run("simulate", heart, "--params", parameters(), "--out", out)
    assert (ended.status, ended.err) == (0, "")
    (header, rows), (_, plain) = read_ecg(out), read_ecg(simulated)
    more = ["V7", *names[1:10], "X", "Y", "Z"]
    assert header == ["time_ms", *LEADS, *more]
    np.testing.assert_array_equal(rows[:, :13], plain)
    lead = dict(zip(header, rows.T, strict=True))
    np.testing.assert_allclose(lead["E8"], lead["V6"], atol=2e-5)  # places[8] is V6's
    assert np.abs(lead["X"]).max() > 0.01  # mV


def test_standard_electrodes_need_a_skin(small_heart, outside, refused):
    out = outside / "more"
    words = "lies in an unbounded conductor", "electrodes.csv"
    refused(["heart", "add-electrodes", small_heart, "--out", out], *words)
    asked = ["heart", "add-electrodes", small_heart, "--out", out, "--leads", "V7,V1"]
    refused(asked, "lead V1: its electrodes have no standard place")


def test_the_picture_shows_every_lead_and_says_when_time_begins(ventricles):
    from fascicle.reporting import prediction as drawing

    drawn = {}

    def keep(figure, path):
        drawn[path.name] = figure
        return path

    heart = load_heart(ventricles)
    simulation = ForwardModel(heart).simulate(heart.example)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "save", keep)
        drawing.draw_simulation(heart, simulation, Path(), "png", "the stimulus")
    figure = drawn["ecg.png"]
    assert figure.get_supxlabel() == "time (ms; 0: the stimulus)"
    assert drawn["activation.png"].axes[-1].get_ylabel() == "activation (ms)\n0: the stimulus"
    for index, lead in enumerate(LEADS):  # in three rows and four columns
        (line,) = figure.axes[4 * (index % 3) + index // 3].get_lines()[-1:]
        np.testing.assert_allclose(line.get_ydata(), simulation.ecg.sel(lead=lead))
