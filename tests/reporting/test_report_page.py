"""The page of a report: what its words say, what its viewer gets, and that nothing escapes it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.forward.scenario import Scenario
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted, PredictedBeat
from fascicle.reporting.page.answers import answers
from fascicle.reporting.page.page import Picture, _safe, _template
from fascicle.reporting.page.scene import NONE, STEPS, decoded, scene
from fascicle.reporting.scenario import scenario_activation_figure, scenario_ecg_figure
from fascicle.study.population import Posterior
from fascicle.study.predictive import Checks
from fascicle.study.statements import Caution, Kind, ParameterStatement, ResultWarning, Statements

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
    found = SimpleNamespace(
        population=population,
        of_the_paper=paper,
        settings=SimpleNamespace(method="paper" if paper else "posterior"),
        checks=Checks(share, disagreeing or {"V1": 0.5}),
        simulator=SimpleNamespace(space=SPACE),
    )
    found.statements = Statements(found)
    found.statements.__dict__["warnings"] = (ResultWarning(Kind.GAIN, "a warning"),)
    return found


OWN, FASTER, MIXED = (
    predicted([100, 110, 120, 130]),
    predicted([80, 85, 90, 95]),
    predicted([90, 120, 110, 140]),
)


class TestAnswers:
    def test_of_a_posterior_that_explains(self):
        said = answers(study(), {"intrinsic": OWN, "a": FASTER, "b": MIXED})
        assert said.trustworthy
        assert said.caution is None
        assert "Two independent runs agree" in said.meaning[0]
        assert "explains 96% of the QRS (median)" in said.meaning[1]
        assert [s.name for s in said.determined] == ["root_time"]
        assert [s.name for s in said.undetermined] == ["cv"]
        own, faster, mixed = said.predicted
        assert own.startswith(
            "global QRS duration 135 (122 to 148) ms, window QRS duration 115 (102 to 128) ms, "
            "total activation time 115 ("
        )
        assert "shortened against the intrinsic beat by 28 ms (90 % CrI 21 to 34)" in faster
        assert "P(shorter) = 1.00" in faster
        assert "neither surely shorter nor longer" in mixed
        assert "P(shorter) = 0.50" in mixed
        (_, slower) = answers(study(), {"intrinsic": FASTER, "a": OWN}).predicted
        assert "prolonged against the intrinsic beat by 28 ms (90 % CrI 21 to 34)" in slower
        found = {"intrinsic": FASTER, "block": OWN, "a": FASTER}
        own, block, paced = answers(study(), found, "block").predicted
        assert own.endswith("ms.")
        assert block.endswith("ms.")
        assert "shortened against block by 28 ms (90 % CrI 21 to 34)" in paced
        assert "P(shorter) = 0.00" in slower

    def test_of_one_that_does_not_explain(self):
        said = answers(study(share=0.6, disagreeing={"V2": 0.001}), {"intrinsic": OWN})
        assert not said.trustworthy
        assert (
            "do not explain the ECG: a network 64% of the QRS (median), where 88% is "
            in said.meaning[1]
        )
        assert "the least. V2 cannot be theirs." in said.meaning[1]
        assert said.caution is Caution.POOR_FIT
        assert said.predicted[0].startswith("by a model that does not fit: global QRS duration")

    def test_of_one_that_has_not_converged(self):
        said = answers(study(converged=False), {"intrinsic": OWN, "a": FASTER})
        assert not said.trustworthy
        assert said.caution is Caution.NOT_CONVERGED
        _, faster = said.predicted
        assert faster.startswith("not to be relied on: global QRS duration 108 (")
        assert "Activation shortened" not in faster
        assert faster.endswith(
            "shortened against the intrinsic beat by 28 ms (90 % CrI 21 to 34); P(shorter) = 1.00."
        )
        assert "no number below can be relied on" in said.meaning[0]
        assert not said.determined
        assert not said.undetermined

    def test_of_the_paper(self):
        said = answers(study(paper=True, converged=False), {"intrinsic": OWN})
        assert not said.trustworthy
        assert "a population and not a posterior" in said.meaning[0]


def kept(simulation):
    return PredictedBeat.of(simulation, simulation.leads, simulation.leads)


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
            Scenario(description="the intrinsic beat"), [kept(simulation)] * 2, totals
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
        assert {field["low"] for field in one} == {0.0}

    def test_the_scale_ends_with_what_is_shown(self, default_heart, shown):
        """One slow network stretches the scale of the slowest, not that of the median ones."""
        simulation, _ = shown
        found = {}
        for name, factor in (("intrinsic", 1.0), ("slower", 1.5)):
            totals = np.array([100.0, 100.0, 300.0])
            beat = kept(simulation)
            beats = [replace(beat, activation=beat.activation * factor)] * 2
            slow = replace(beat, activation=beat.activation * 3 * factor)
            found[name] = Predicted(Scenario(), [*beats, slow], {"total_activation_time": totals})
        fields = [s["fields"] for s in scene(default_heart, found)["scenarios"]]
        used = np.unique(default_heart.boundary[0])
        longest = np.ptp(simulation.activation) - (
            simulation.activation.max() - simulation.activation[used].max()
        )
        for scenario in fields:
            tops = {field["name"]: field["high"] for field in scenario}
            assert tops["activation_median"] == pytest.approx(1.5 * longest, rel=1e-3)
            assert tops["activation_maximum"] == pytest.approx(4.5 * longest, rel=1e-3)

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


def page(**values):
    """The page with these values, of which the rest are empty."""
    rest = {
        "verdict": "",
        "caution": None,
        "undetermined": [ParameterStatement("cv", "mm/ms", *[3.0] * 4)],
    }
    said = SimpleNamespace(**(rest | values))
    pictures = {name: Picture("", name) for name in ("ecg", "indices", "priors", "pairs")}
    pictures |= {name: Picture("", name, of_networks=False) for name in ("recording", "heart")}
    return _template().render(answers=said, pictures=pictures, predictions=[("a", "b")])


def test_everything_that_cannot_be_relied_on_is_marked():
    text = page(caution=Caution.NOT_CONVERGED)
    for section in ("ecg", "heart", "pacing", "parameters"):
        content = re.search(f'<section id="{section}" class="doubted">(.*?)</section>', text, re.S)[
            1
        ]
        assert Caution.NOT_CONVERGED.text in re.search("<h2>(.*?)</h2>", content)[1]
    for name in ("ecg", "indices", "priors", "pairs"):
        (above,) = re.findall(f'<figure>(.*?)<img src="" alt="{name}">', text)
        assert Caution.NOT_CONVERGED.text in above
    assert '<ul class="doubted"><li><b>a</b>' in text
    inputs = text[text.index('<section id="inputs"') :]
    assert Caution.NOT_CONVERGED.text not in inputs


def test_nothing_is_marked_where_all_is_well():
    text = page()
    assert "doubted" not in text
    assert 'class="caution"' not in text


def test_no_text_can_end_the_page_or_its_script():
    evil = "</script><script>alert(1)</script>"
    assert "</script>" not in _safe({"label": evil})
    assert json.loads(_safe({"label": evil}))["label"] == evil
    pictures = {"ecg": Picture("", evil)}
    verdict = SimpleNamespace(verdict=evil, warnings=[evil])
    text = _template().render(title=evil, heart=evil, answers=verdict, pictures=pictures)
    assert "<script>alert" not in text
    assert "&lt;script&gt;" in text


def test_the_own_beat_is_drawn_as_long_as_that_of_the_scenario(shown):
    simulation, _ = shown
    own = kept(simulation)
    later = np.pad(simulation.leads, ((0, 0), (60, 0)))
    later[:, : simulation.leads.shape[1]] += simulation.leads
    found = {
        name: Predicted(Scenario(), [beat], {"total_activation_time": np.ones(1)})
        for name, beat in (
            ("intrinsic", own),
            ("longer", replace(own, leads=later, filtered=later)),
        )
    }
    for axes in scenario_ecg_figure(found, "longer").axes:
        first, last = (line.get_xdata() for line in axes.lines)
        np.testing.assert_array_equal(first, last)
        assert last[-1] == axes.get_xlim()[1]


def test_rows_of_activations_say_which_time_they_give(default_heart, shown):
    simulation, _ = shown
    beats = [kept(simulation)] * 3
    totals = {"total_activation_time": np.array([90.0, 80.0, 85.0])}
    found = {name: Predicted(Scenario(), beats, totals) for name in ("intrinsic", "paced")}
    figure = scenario_activation_figure(default_heart, found, "paced")
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert [text for text in texts if "time" in text] == [
        "intrinsic: median\ntotal activation\ntime 85 ms",
        "minimum\ntotal activation\ntime 80 ms",
        "median\ntotal activation\ntime 85 ms",
        "maximum\ntotal activation\ntime 90 ms",
    ]


def test_the_ecg_of_a_scenario_says_when_time_begins_and_holds_long_names(shown):
    simulation, _ = shown
    long = "a-scenario-of-one's-own-" * 5
    found = {
        name: Predicted(Scenario(), [kept(simulation)] * 40, {"total_activation_time": np.ones(40)})
        for name in ("intrinsic", long)
    }
    figure = scenario_ecg_figure(found, long)
    assert figure.get_supxlabel() == "time (ms; 0: QRS onset)"
    figure.canvas.draw()
    (legend,) = figure.legends
    assert legend.get_window_extent().x0 > figure._suptitle.get_window_extent().x1
    assert legend.get_window_extent().x1 <= figure.bbox.width
