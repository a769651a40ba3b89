"""The page of a report: what its words say, what its viewer gets, and that nothing escapes it."""

from __future__ import annotations

import base64
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
from fascicle.recording.criteria import Criterion
from fascicle.reporting.names import MEASURES
from fascicle.reporting.page.content import meaning, prediction
from fascicle.reporting.page.page import _safe, _template
from fascicle.reporting.page.scene import NONE, scene
from fascicle.reporting.scenarios import scenario_activation_figure, scenario_ecg_figure
from fascicle.study.population import Posterior
from fascicle.study.predictive import Checks
from fascicle.study.statements import Caution, ParameterStatement, Statements

SPACE = ParameterSpace(
    (Parameter("root_time", "ms", -75.0, 50.0), Parameter("cv", "mm/ms", 2.0, 4.0))
)


def predicted(total):
    """Four networks; indices are the total activation time, but the global QRS is 20 ms longer."""
    values = np.asarray(total, dtype=float)
    indices = dict.fromkeys(INDICES, values) | {"global_qrs_duration": values + 20}
    return Predicted(Scenario(), [], indices)


def study(*, converged=True, share=0.96, disagreeing=None, paper=False):
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
    return found


OWN, FASTER, MIXED, SLOWER = (
    predicted([100, 110, 120, 130]),
    predicted([80, 85, 90, 95]),
    predicted([90, 120, 110, 140]),
    predicted([120, 135, 150, 165]),
)


class TestAnswers:
    def test_of_a_posterior_that_explains(self):
        fitted = study()
        first, second = meaning(fitted)
        assert "Two independent runs agree" in first
        assert second.startswith("96% of the QRS explained by the best 5% of networks. ")
        assert (
            "RV–LV activation delay and Purkinje conduction velocity are strongly correlated in "
            "the posterior (rank correlation 1.00)."
        ) in " ".join(page(correlated=fitted.statements.correlated).split())

    def test_of_others_says_why_not(self):
        fitted = study(share=0.64, disagreeing={"V2": 0.001})
        (_, sentence) = meaning(fitted)
        assert "reproduce the recorded QRS: V2 not reproduced; 64% of the QRS explained" in sentence
        fitted = study(converged=False)
        assert "do not rely on any number below" in meaning(fitted)[0]
        assert "a population and not a posterior" in meaning(study(paper=True, converged=False))[0]

    @pytest.mark.parametrize(
        ("found", "against", "said"),
        [
            (FASTER, "intrinsic", "shortened by 28 ms (90 % CrI 21 to 34) compared with the "
             "intrinsic beat; P(shorter) = 1.00."),
            (MIXED, "intrinsic", "P(shorter) = 0.50."),
            (SLOWER, "intrinsic", "prolonged by 28 ms (90 % CrI 21 to 34) compared with the "
             "intrinsic beat; P(shorter) = 0.00."),
            (FASTER, "block", "shortened by 28 ms (90 % CrI 21 to 34) compared with block; "
             "P(shorter) = 1.00."),
        ],
    )  # fmt: skip
    def test_of_a_scenario(self, found, against, said):
        scenarios = {"intrinsic": OWN, "block": OWN, "a": found}
        sentence = prediction("a", scenarios, against, Caution.NOT_CONVERGED)
        assert sentence.endswith(said)
        assert sentence.startswith(f"{Caution.NOT_CONVERGED.brief}: global QRS duration ")
        alone = prediction("intrinsic", scenarios, against, None)
        assert alone == (
            "global QRS duration 135 ms (122 to 148), window QRS duration 115 ms (102 to 128), "
            "total activation time 115 ms (102 to 128)."
        )


def decoded(text, kind, columns=1):
    """Array (n, columns), or (n,), of what a scene holds."""
    array = np.frombuffer(base64.b64decode(text), dtype=kind)
    return array.reshape(-1, columns) if columns > 1 else array


def positions(content, packed):
    """Places (mm) that a scene holds."""
    low, high = (np.array(content["box"][end]) for end in ("low", "high"))
    return low + decoded(packed, "<u2", 3) / NONE * (high - low)


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
        vertices = positions(content, surface["vertices"])
        triangles = decoded(surface["triangles"], "<u4", 3)
        used, boundary = np.unique(default_heart.boundary[0]), default_heart.boundary[0]
        np.testing.assert_allclose(vertices, default_heart.vertices[used], atol=0.01)
        expected = default_heart.vertices[boundary]
        np.testing.assert_allclose(vertices[triangles], expected, atol=0.01)

    def test_times_come_back(self, shown, default_heart):
        """On one scale in all scenarios; what is never reached is none."""
        simulation, content = shown
        used = np.unique(default_heart.boundary[0])
        field = content["scenarios"][0]["fields"][0]
        assert (field["name"], field["unit"], field["kind"]) == ("activation_median", "ms", "time")
        times = decoded(field["values"], "<u2") / (NONE - 1) * field["high"]
        expected = simulation.activation - simulation.activation.min()
        np.testing.assert_allclose(times, expected[used], atol=0.01)
        right = default_heart.vertices[used, 0] > default_heart.vertices[:, 0].mean()
        one, other = (scenario["fields"] for scenario in content["scenarios"])
        for field in other:
            values = decoded(field["values"], "<u2")
            np.testing.assert_array_equal(values == NONE, right)
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
        trees = simulation.trees, simulation.coupled.trees, content["scenarios"][0]["trees"]
        for tree, times, packed in zip(*trees, strict=True):
            nodes = positions(content, packed["nodes"])
            np.testing.assert_allclose(nodes, tree.nodes, atol=0.01)
            segments = decoded(packed["segments"], "<u4", 2)
            assert (tree.parents[segments[:, 1]] == segments[:, 0]).all()
            shares = decoded(packed["times"], "<u2") / (NONE - 1)
            since = packed["low"] + shares * (packed["high"] - packed["low"])
            np.testing.assert_allclose(since, times - simulation.activation.min(), atol=0.02)


def page(**values):
    """The page with these values, of which the rest are empty."""
    pictures = {
        name: {"source": "", "text": name}
        for name in ("ecg", "indices", "priors", "pairs", "recording", "heart")
    }
    rest = {
        "unidentifiable": [ParameterStatement("cv", "mm/ms", *[3.0] * 4)],
        "predictions": [("a", "b")],
    }
    return _template().render({"pictures": pictures} | rest | values)


def test_everything_that_cannot_be_relied_on_is_marked():
    sound = page()
    assert "doubted" not in sound
    assert 'class="caution"' not in sound
    text = page(caution=Caution.NOT_CONVERGED)
    for section in ("ecg", "heart", "pacing", "parameters"):
        marked = re.search(f'<section id="{section}" class="doubted">(.*?)</section>', text, re.S)
        assert Caution.NOT_CONVERGED.text in re.search("<h2>(.*?)</h2>", marked[1])[1]
    assert '<ul class="doubted"><li><b>a</b>' in text
    inputs = text[text.index('<section id="inputs"') :]
    assert Caution.NOT_CONVERGED.text not in inputs


def test_numbers_of_an_ecg_stand_in_its_tables():
    ecg = {
        "source": "", "text": "the ECG", "leads": [("V1", 0.834, 0.912)],
        "measured": [(MEASURES["axis_degrees"], 59.4, (50.2, 61.0, 70.7))],
    }  # fmt: skip
    text = page(pictures={"ecg": ecg}, rows=[("a", [(1.0, 2.0, 3.0)], ("apex", 0.25))])
    cells = re.findall('<td class="number">(.*?)</td>', text)
    assert cells == ["83%", "0.91", "59 degrees", "61 (50 to 71) degrees", "2 (1 to 3)"]
    assert "<td>apex (25%)</td>" in text


def test_every_criterion_says_whether_it_is_met():
    found = [Criterion(f"block {met}", met, "QRS 90 ms", "them") for met in (True, False, None)]
    rows = re.findall("<th>block (.*?) \\(them\\)</th><td>(.*?)</td>", page(criteria=[found]))
    assert rows == [("True", "yes"), ("False", "no"), ("None", "not decided")]


def test_no_text_can_end_the_page_or_its_script():
    evil = "</script><script>alert(1)</script>"
    assert "</script>" not in _safe({"label": evil})
    assert json.loads(_safe({"label": evil}))["label"] == evil
    pictures = {"ecg": {"source": "", "text": evil}}
    text = page(study=evil, heart=evil, verdict=evil, warnings=[evil], pictures=pictures)
    assert "<script>alert" not in text
    assert "&lt;script&gt;" in text


def test_the_intrinsic_beat_is_drawn_as_long_as_that_of_the_scenario(shown):
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
    beats, total = [kept(simulation)] * 40, {"total_activation_time": np.ones(40)}
    found = {name: Predicted(Scenario(), beats, total) for name in ("intrinsic", long)}
    figure = scenario_ecg_figure(found, long)
    assert figure.get_supxlabel() == "time (ms; 0: QRS onset)"
    figure.canvas.draw()
    legend = figure.legends[0].get_window_extent()
    assert legend.x0 > figure._suptitle.get_window_extent().x1
    assert legend.x1 <= figure.bbox.width
