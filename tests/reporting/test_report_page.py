"""The page of a report: what its words say, what its viewer gets, and that nothing escapes it."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import read_scenarios
from fascicle.prediction.indices import INDICES
from fascicle.prediction.predicted import Predicted, PredictedBeat
from fascicle.prediction.scenarios import with_own_beat
from fascicle.reporting.page.answers import answers
from fascicle.reporting.page.page import _command, _safe, _template
from fascicle.reporting.page.scene import NONE, STEPS, decoded, scene
from fascicle.study.population import Posterior
from fascicle.study.predictive import Checks

SPACE = ParameterSpace(
    (Parameter("root_time", "ms", -75.0, 50.0), Parameter("cv", "mm/ms", 2.0, 4.0))
)


def predicted(total):
    """Four networks; indices are the total activation time, but the global QRS is 20 ms longer."""
    values = np.asarray(total, dtype=float)
    indices = dict.fromkeys(INDICES, values) | {"global_qrs_duration": values + 20}
    return Predicted(Scenario(), [], indices)


def study(*, converged=True, share=0.2, disagreeing=None, paper=False):
    values = {"root_time": np.linspace(-12, -8, 40), "cv": np.linspace(2.0, 4.0, 40)}
    population = Posterior(
        values, np.ones(40), {}, 0.1, np.zeros((40, 1)), np.array([-5.0, -5.1]),
        np.array([150.0, 160.0]), np.array([1000.0, 1000.0]), {"cv": 0.1}, converged,
    )  # fmt: skip
    return SimpleNamespace(
        population=population,
        of_the_paper=paper,
        checks=Checks(share, disagreeing or {"V1": 0.5}),
        verdict="the verdict",
        warnings=["a warning"],
        problem=SimpleNamespace(space=SPACE),
    )


OWN, FASTER, MIXED = (
    predicted([100, 110, 120, 130]),
    predicted([80, 85, 90, 95]),
    predicted([90, 120, 110, 140]),
)


class TestAnswers:
    def test_of_a_posterior_that_explains(self):
        said = answers(study(), {"intrinsic": OWN, "a": FASTER, "b": MIXED})
        assert said.trustworthy
        assert "Two independent runs agree" in said.meaning[0]
        assert "but for 20% of its size" in said.meaning[1]
        assert [s.name for s in said.determined] == ["root_time"]
        assert [s.name for s in said.undetermined] == ["cv"]
        own, faster, mixed = said.predicted
        assert own.startswith(
            "QRS duration 135 (122 to 148) ms in the outermost leads, as clinics measure it, and "
            "115 (102 to 128) ms in all leads together; total activation time 115 ("
        )
        assert "is shorter than that of the own beat, by 28 ms (21 to 34)" in faster
        assert "probability to be shorter 1.00" in faster
        assert "is open" in mixed
        assert "probability to be shorter 0.50" in mixed
        (_, slower) = answers(study(), {"intrinsic": FASTER, "a": OWN}).predicted
        assert "is longer than that of the own beat, by 28 ms (21 to 34)" in slower
        found = {"intrinsic": FASTER, "block": OWN, "a": FASTER}
        own, block, paced = answers(study(), found, "block").predicted
        assert own.endswith("ms.")
        assert block.endswith("ms.")
        assert "is shorter than that of block, by 28 ms (21 to 34)" in paced
        assert "probability to be shorter 0.00" in slower

    def test_of_one_that_does_not_explain(self):
        said = answers(study(share=0.6, disagreeing={"V2": 0.001}), {"intrinsic": OWN})
        assert not said.trustworthy
        assert (
            "They do not explain the ECG: they leave 60% of its size. V2 cannot" in said.meaning[1]
        )

    def test_of_one_that_has_not_converged(self):
        said = answers(study(converged=False), {"intrinsic": OWN})
        assert not said.trustworthy
        assert "no number below can be relied on" in said.meaning[0]
        assert not said.determined
        assert not said.undetermined

    def test_of_the_paper(self):
        said = answers(study(paper=True, converged=False), {"intrinsic": OWN})
        assert not said.trustworthy
        assert "a population and not a posterior" in said.meaning[0]


def kept(simulation):
    return PredictedBeat.of(simulation, *2 * [simulation.leads], simulation.coupled.captured)


@pytest.fixture(scope="module")
def shown(default_heart, default_model):
    from fascicle.core.parameters import EXAMPLE_PARAMETERS

    simulation = default_model.simulate(EXAMPLE_PARAMETERS)
    late = replace(simulation, activation=np.where(
        default_heart.vertices[:, 0] > default_heart.vertices[:, 0].mean(), np.inf,
        simulation.activation,
    ))  # fmt: skip
    totals = {"total_activation_time": np.array([90.0, 80.0])}
    found = {
        "intrinsic": Predicted(
            Scenario(description="the own beat"), [kept(simulation)] * 2, totals
        ),
        "half": Predicted(Scenario(), [kept(late)] * 2, totals),
    }
    return simulation, scene(default_heart, found)


class TestScene:
    def test_positions_come_back(self, shown, default_heart):
        _, content = shown
        (surface,) = content["surfaces"]
        low, high = (np.array(content["box"][end]) for end in ("low", "high"))
        vertices = low + decoded(surface["vertices"], "<u2", 3) / NONE * (high - low)
        triangles = decoded(surface["triangles"], "<u4", 3)
        used = np.unique(default_heart.boundary[0])
        np.testing.assert_allclose(vertices, default_heart.vertices[used], atol=0.01)
        assert len(triangles) == len(default_heart.boundary[0])
        np.testing.assert_allclose(
            vertices[triangles], default_heart.vertices[default_heart.boundary[0]], atol=0.01
        )

    def test_times_come_back(self, shown, default_heart):
        simulation, content = shown
        used = np.unique(default_heart.boundary[0])
        field = content["scenarios"][0]["fields"][0]
        assert (field["name"], field["unit"], field["kind"]) == ("activation_median", "ms", "time")
        times = decoded(field["values"], "<u2") / STEPS * field["high"]
        expected = simulation.activation - simulation.activation.min()
        np.testing.assert_allclose(times, expected[used], atol=0.01)
        assert content["scenarios"][0]["duration"] == pytest.approx(expected[used].max(), abs=0.01)

    def test_what_is_never_reached_is_none(self, shown, default_heart):
        _, content = shown
        used = np.unique(default_heart.boundary[0])
        right = default_heart.vertices[used, 0] > default_heart.vertices[:, 0].mean()
        for field in content["scenarios"][1]["fields"]:
            values = decoded(field["values"], "<u2")
            np.testing.assert_array_equal(values == NONE, right)

    def test_colours_mean_the_same_in_every_scenario(self, shown):
        _, content = shown
        one, other = (scenario["fields"] for scenario in content["scenarios"])
        assert [field["high"] for field in one] == [field["high"] for field in other]
        assert len({field["high"] for field in one if field["kind"] == "time"}) == 1
        assert {field["low"] for field in one} == {0.0}

    def test_trees_come_back(self, shown):
        simulation, content = shown
        low, high = (np.array(content["box"][end]) for end in ("low", "high"))
        for tree, times, packed in zip(
            simulation.trees,
            simulation.coupled.trees,
            content["scenarios"][0]["trees"],
            strict=True,
        ):
            nodes = low + decoded(packed["nodes"], "<u2", 3) / NONE * (high - low)
            np.testing.assert_allclose(nodes, tree.nodes, atol=0.01)
            segments = decoded(packed["segments"], "<u4", 2)
            assert (tree.parents[segments[:, 1]] == segments[:, 0]).all()
            since = packed["low"] + decoded(packed["times"], "<u2") / STEPS * (
                packed["high"] - packed["low"]
            )
            np.testing.assert_allclose(since, times - simulation.activation.min(), atol=0.02)


def test_the_command_makes_the_page_again(tmp_path):
    """With the file of a scenario of one's own, and names with spaces in quotes."""
    path = tmp_path / "my case.toml"
    path.write_text("silent = ['rv']\n")
    found = {
        name: SimpleNamespace(scenario=scenario)
        for name, scenario in with_own_beat(read_scenarios(["his-pacing", path])).items()
    }
    command = _command(SimpleNamespace(folder=tmp_path / "S"), found, "my case")
    words = ["fascicle", "report", str(tmp_path / "S"), "--scenario", "his-pacing"]
    assert shlex.split(command) == [*words, "--scenario", str(path), "--against", "my case"]


def test_no_text_can_end_the_page_or_its_script():
    evil = "</script><script>alert(1)</script>"
    assert "</script>" not in _safe({"label": evil})
    assert json.loads(_safe({"label": evil}))["label"] == evil
    pictures = {"ecg": SimpleNamespace(source="", text=evil)}
    verdict = SimpleNamespace(verdict=evil, warnings=[evil])
    text = _template().render(title=evil, heart=evil, answers=verdict, pictures=pictures)
    assert "<script>alert" not in text
    assert "&lt;script&gt;" in text
