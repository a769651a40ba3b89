"""Scenario files, read or refused; and the table of what fired what."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
from anatomies import NETWORK
from builders import case

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import His, InactiveRoot, JunctionDelays, SlowConduction, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import read_scenario, scenario_text
from fascicle.forward.simulation_files import (
    simulate_inputs,
    sites_table,
    summary,
    write_simulation,
)
from fascicle.heart.conduction import Conduction, Region
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import write_tree

EVERYTHING = """
[delay]
anterograde = 2
retrograde = inf

[[stimulus]]
position = [1, 2.5, -3]
time = -20

[[stimulus]]
position = [4.0, 5.0, 6.0]
time = 3.5
tree = "lv"

[[slow_conduction]]
tree = "lv"
part = "bundle"
speed = 0

[[slow_conduction]]
tree = "rv"
speed = 0.5
centre = [7.0, 8.0, 9.0]
radius = 4

[[region]]
label = 3
conductivity = 0.25

[[region]]
centre = [1.0, 1.0, 1.0]
radius = 12.5
conductivity = 0

[[inactive_root]]
tree = "rv"

[[inactive_root]]
tree = "band"

[[tree]]
name = "band"
file = "trees/band.vtu"
time = 5
root = [0, 0, 0.5]
"""
FORK = PurkinjeTree(
    "band",
    np.array([[0.0, 0, 0], [0, 0, 10], [5, 0, 15], [-5, 0, 15]]),
    np.array([-1, 0, 1, 1]),
    np.array([0.0, 10.0, 8.0, 8.0]),
)


@pytest.fixture
def file(tmp_path):
    """Write a scenario, with the tree it may ask for beside it."""
    (tmp_path / "trees").mkdir()
    write_tree(tmp_path / "trees" / "band.vtu", FORK, np.zeros(4))

    def write(text, **how):
        path = tmp_path / "case.toml"
        path.write_text(text, encoding=how.get("encoding", "utf-8"))
        return path

    return write


class TestPython:
    """Tables made in Python."""

    def test_too_many_values_or_one_twice(self):
        with pytest.raises(TypeError, match="InactiveRoot takes 1 values, 2 given"):
            InactiveRoot("lv", "rv")
        with pytest.raises(TypeError, match="multiple values"):
            InactiveRoot("lv", tree="rv")

    def test_written_and_read_again_is_equal(self, file):
        """Whatever the order in which the primitives were given, and whatever is in their texts."""
        scenario = Scenario(
            (
                His(-3.25, left=0.0),
                JunctionDelays(retrograde=np.inf),
                InactiveRoot("b 'n\" \\d"),
                SlowConduction("rv", 0.1, centre=(1 / 3, 2.0, -1e-7), radius=4.0),
                Stimulus(5.0, site="l'apex"),
                InactiveRoot("a"),
                Stimulus(-20.0, (1.0, 2.5, -3.0), radius=2.0),
            )
        )
        assert [one.table for one in scenario.primitives[:3]] == [
            "stimulus",
            "stimulus",
            "slow_conduction",
        ]
        assert read_scenario(file(scenario_text(scenario))) == (scenario, ())


class TestReading:
    def test_everything(self, file):
        scenario, regions = read_scenario(file(EVERYTHING))
        (tree, time) = scenario.trees[0]
        assert replace(scenario, trees=()) == case(
            stimuli=(Stimulus(-20.0, (1.0, 2.5, -3.0)), Stimulus(3.5, (4.0, 5.0, 6.0), "lv")),
            slow=(
                SlowConduction("lv", 0.0, "bundle"),
                SlowConduction("rv", 0.5, None, (7.0, 8.0, 9.0), 4.0),
            ),
            inactive=("rv", "band"),
            delays={"anterograde": 2.0, "retrograde": np.inf},
        )
        assert regions == (Region(0.25, label=3), Region(0.0, centre=(1.0, 1.0, 1.0), radius=12.5))
        assert (tree.side, time, len(tree.nodes)) == ("band", 5.0, 4)
        np.testing.assert_array_equal(tree.nodes[tree.root], [0.0, 0.0, 0.0])
        assert sorted(tree.lengths) == [0.0, 8.0, 8.0, 10.0]

    def test_the_tree_is_looked_for_beside_the_file(self, file, monkeypatch, tmp_path_factory):
        path = file(EVERYTHING)
        monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
        assert len(read_scenario(path)[0].trees) == 1

    @pytest.mark.parametrize("text", ["", "# nothing\n", "stimulus = []"])
    def test_nothing_is_the_heart_s_own_beat(self, file, text):
        assert read_scenario(file(text)) == (Scenario(), ())

    def test_mark_of_windows_editors(self, file):
        scenario, _ = read_scenario(file('inactive_root = [{tree = "lv"}]', encoding="utf-8-sig"))
        assert scenario == case(inactive=["lv"])

    def test_where_it_came_from_is_kept_for_messages(self, file):
        path = file(EVERYTHING)
        scenario, regions = read_scenario(path)
        assert scenario.source == str(path)
        assert [region.source for region in regions] == [str(path)] * 2
        assert regions[1].name == f"{path}: region at (1.0, 1.0, 1.0)"


AT = "[[stimulus]]\nposition = [1.0, 2.0, 3.0]\n"
SLOW = '[[slow_conduction]]\ntree = "lv"\n'
TREE = '[[tree]]\nname = "band"\nfile = "trees/band.vtu"\ntime = 0\nroot = [0, 0, 0]\n'


class TestRefusals:
    @pytest.mark.parametrize(
        ("text", "words"),
        [
            # the key, what is there instead, what is needed
            ("x = 1", ["unknown key 'x'", "known: stimulus, slow_conduction, inactive_root"]),
            ("[[stimulus]]\npos = [1, 2, 3]\ntime = 1", ["stimulus 1: unknown key 'pos'"]),
            (SLOW + "speed = 0\nfascicle = 1", ["slow_conduction 1: unknown key 'fascicle'"]),
            ("[delay]\nboth = 1", ["delay: unknown key 'both'; known: anterograde, retrograde"]),
            ("[stimulus]\ntime = 0", ["'stimulus' must be in double brackets: [[stimulus]]"]),
            ("his = []", ["'his' is []", "must be a table: [his]"]),
            (AT + "time = 0\n" + AT, ["stimulus 2: 'time' is missing"]),
            (AT + 'time = "0"', ["stimulus 1: 'time' is '0'", "a number"]),
            (AT + "time = 1e9", ["'time' is 1e+09", "-10000 to 10000 ms"]),
            ("[[stimulus]]\nposition = [1, 2]\ntime = 0", ["'position' is [1, 2]", "three"]),
            (SLOW + "speed = -0.5", ["slow_conduction 1: 'speed' is -0.5", "0.01 to 100, or 0"]),
            (SLOW + "speed = 0\nradius = 3", ["slow_conduction 1: a sphere needs centre and"]),
            ("[[region]]\nconductivity = 0\nlabel = 1.5", ["'label' is 1.5", "whole number"]),
            ("[delay]\nanterograde = -1", ["delay: 'anterograde' is -1", "or inf"]),
            (TREE.replace("band", "../../x", 1), ["tree 1: 'name' is '../../x'", "letters"]),
            (TREE.replace("trees", "wood"), ["wood/band.vtu: no such file"]),
            (
                TREE.replace("[0, 0, 0]", "[0, 0, -30]"),
                ["nearest to the root given", "is 30.0 mm away", "band.vtu"],
            ),
            ("hello\n", ["not valid TOML", "line 1"]),
        ],
    )
    def test_in_one_line_that_names_the_file(self, file, text, words):
        path = file(text)
        with pytest.raises(InputError) as refused:
            read_scenario(path)
        message = str(refused.value)
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
        assert len(message) < 400
        for word in words:
            assert word in message, message

    def test_bytes_that_are_no_text(self, tmp_path):
        path = tmp_path / "case.toml"
        path.write_bytes(b"\xff\xfe\x00")
        with pytest.raises(InputError, match="not valid TOML"):
            read_scenario(path)

    def test_what_does_not_fit_the_heart_names_the_file(self, file, default_model):
        for text, words in (
            ('inactive_root = [{tree = "septum"}]', "there is no tree 'septum'"),
            ('inactive_root = [{tree = "lv"}, {tree = "rv"}]', "nothing activates the myocardium"),
            (TREE, "tree 'band': 2 of 2 leaves lie more than 5 mm"),
        ):
            path = file(text)
            scenario, _ = read_scenario(path)
            with pytest.raises(InputError) as refused:
                simulate_inputs(lambda: default_model, scenario=scenario)
            assert str(refused.value).startswith(f"{path}: "), refused.value
            assert words in str(refused.value)

    def test_what_else_is_wrong_does_not(self, file, default_model):
        scenario, _ = read_scenario(file(""))
        with pytest.raises(InputError) as refused:
            simulate_inputs(lambda: default_model, overrides={"cv": 900.0}, scenario=scenario)
        assert str(refused.value).startswith("parameter 'cv' is 900 mm/ms; give")


class TestTables:
    @pytest.fixture(scope="class")
    def simulation(self, default_model, default_heart):
        """Left bundle blocked; an early stimulus, and one that comes too late."""
        place = tuple(default_heart.vertices[5962].tolist())
        scenario = case(
            stimuli=(Stimulus(-10.0, place), Stimulus(400.0, place)),
            slow=(SlowConduction("lv", 0.0, "bundle"),),
        )
        return default_model.simulate(EXAMPLE_PARAMETERS, scenario)

    @pytest.fixture(scope="class")
    def rows(self, simulation):
        return list(csv.DictReader(io.StringIO(sites_table(simulation))))

    def test_a_row_for_each_junction_and_stimulus_in_order(self, rows, simulation):
        lv, rv = (len(tree.junctions) for tree in simulation.trees)
        assert [int(row["site"]) for row in rows] == list(range(lv + rv + 2))
        kinds = [(row["kind"], row["tree"]) for row in rows]
        assert kinds == (
            [("junction", "lv")] * lv + [("junction", "rv")] * rv + [("stimulus", "")] * 2
        )
        left = simulation.trees[0]
        assert [int(row["node"]) for row in rows[:lv]] == left.junctions.tolist()
        positions = [[float(row[f"{x}_mm"]) for x in "xyz"] for row in rows[:lv]]
        np.testing.assert_allclose(positions, left.nodes[left.junctions], atol=1e-4)

    def test_times_and_ways(self, rows, simulation):
        lv = len(simulation.trees[0].junctions)
        for row, node in zip(rows[:lv], simulation.trees[0].junctions, strict=True):
            assert float(row["time_ms"]) == pytest.approx(
                simulation.coupled.trees[0][node], abs=1e-4
            )
        fired = [row["fired"] for row in rows[:-2]]
        assert fired.count("retrograde") == sum(a.sum() for a in simulation.coupled.retrograde)
        assert fired.count("anterograde") > 300
        assert [row["fired"] for row in rows[-2:]] == ["captured", "came too late"]
        assert [row["time_ms"] for row in rows[-2:]] == ["-10.0000", "400.0000"]

    def test_what_entered_is_told_for_retrograde_junctions_only(self, rows):
        for row in rows:
            assert (row["entered_by"] != "") == (row["fired"] == "retrograde")
            if row["entered_by"]:
                source = rows[int(row["entered_by"])]
                assert float(source["time_ms"]) <= float(row["time_ms"])

    def test_junctions_that_are_not_activated(self, default_model, simulation):
        """Without any way into the trees: no time, never fired."""
        scenario = case(
            (Stimulus(0.0, tuple(simulation.coupled.stimuli[0])),),
            inactive=("lv", "rv"),
            delays={"retrograde": np.inf},
        )
        silent = default_model.simulate(EXAMPLE_PARAMETERS, scenario)
        rows = list(csv.DictReader(io.StringIO(sites_table(silent))))
        assert {(row["fired"], row["time_ms"]) for row in rows[:-1]} == {("never", "")}
        sides = summary(default_model.heart, silent, {})["trees"]
        for tree in silent.trees:
            assert sides[tree.side]["not_activated_junctions"] == len(tree.junctions)

    def test_origins_lead_into_the_table(self, rows, simulation, default_heart, tmp_path):
        """On the written map: -1 nowhere, and every origin fired before the vertex."""
        write_simulation(default_heart, simulation, tmp_path / "out", {})
        mesh = pv.read(tmp_path / "out" / "activation.vtu")
        with (tmp_path / "out" / "sites.csv").open() as file:
            assert list(csv.DictReader(file)) == rows
        origin = np.asarray(mesh["origin"])
        assert np.issubdtype(origin.dtype, np.integer)
        assert origin.min() >= 0
        times = np.array([float(row["time_ms"]) for row in rows])
        assert (times[origin] <= np.asarray(mesh["activation"]) + 1e-4).all()
        assert origin[5962] == len(rows) - 2

    def test_a_stimulus_in_scar_does_not_capture(self, small_heart):
        place = tuple(small_heart.vertices[168].tolist())
        scar = Conduction(regions=(Region(0.0, centre=place, radius=15.0),))
        simulation = ForwardModel(small_heart, scar).simulate(
            NETWORK, case((Stimulus(-50.0, place),))
        )
        assert np.nanmin(simulation.activation) > 0
        assert simulation.coupled.captured.tolist() == [False]
