"""The page of a report: what its words say, what its viewer gets, and that nothing escapes it."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import igl
import numpy as np
import pytest

import fascicle
from fascicle.core.parameters import EXAMPLE_PARAMETERS, Parameter, ParameterSpace
from fascicle.emulation.predictive import Checks
from fascicle.forward.primitives import His, SlowConduction, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.networks.prior import Prior
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.recording.criteria import Criterion
from fascicle.reporting.names import MEASURES, scenario_name
from fascicle.reporting.page.content import meaning, prediction
from fascicle.reporting.page.page import _safe, _template
from fascicle.reporting.page.scene import NONE, _chosen, marks, scene, where
from fascicle.reporting.prediction import scenario_activation_figure, scenario_ecg_figure
from fascicle.study.population import Posterior
from fascicle.study.statements import Caution, ParameterStatement, Statements

SPACE = ParameterSpace(
    (Parameter("root_time", "ms", -75.0, 50.0), Parameter("cv", "mm/ms", 2.0, 4.0))
)


def predicted(total):
    """Four networks; indices are the total activation time, but the QRS is 20 ms longer."""
    values = np.asarray(total, dtype=float)
    indices = dict.fromkeys(INDICES, values) | {"qrs_duration": values + 20}
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
        simulator=SimpleNamespace(prior=Prior(SPACE)),
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
            "delay between the roots and Purkinje conduction velocity are strongly correlated in "
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
        assert sentence.startswith(f"{Caution.NOT_CONVERGED.brief}: QRS duration ")
        alone = prediction("intrinsic", scenarios, against, None)
        assert alone == (
            "QRS duration 135 ms (122 to 148), total activation time 115 ms (102 to 128)."
        )


def decoded(text, kind, columns=1):
    """Array (n, columns), or (n,), of what a scene holds."""
    array = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=kind)
    return array.reshape(-1, columns) if columns > 1 else array


def positions(content, packed):
    """Places (mm) that a scene holds."""
    low, high = (np.array(content["box"][end]) for end in ("low", "high"))
    return low + decoded(packed, "<u2", 3) / NONE * (high - low)


def with_activation(beat, times):
    return replace(beat, coupled=replace(beat.coupled, myocardium=times))


@pytest.fixture(scope="module")
def shown(default_heart, default_model):
    simulation = default_model.simulate(EXAMPLE_PARAMETERS)
    later = default_heart.vertices[:, 0] > default_heart.vertices[:, 0].mean()
    late = with_activation(simulation, np.where(later, np.inf, simulation.activation))
    totals = {"total_activation_time": np.array([90.0, 80.0])}
    found = {
        "intrinsic": Predicted(
            Scenario(description="the intrinsic beat"),
            [simulation.in_single_precision()] * 2,
            totals,
        ),
        "half": Predicted(Scenario(), [late.in_single_precision()] * 2, totals),
    }
    return simulation, scene(default_heart, found)


class TestScene:
    def test_positions_come_back_endocardial_triangles_first(self, shown, default_heart):
        _, content = shown
        (surface,) = content["surfaces"]
        vertices = positions(content, surface["vertices"])
        triangles = decoded(surface["triangles"], "<u4", 3)
        boundary = default_heart.boundary[0]
        used = np.unique(boundary)
        np.testing.assert_allclose(vertices, default_heart.vertices[used], atol=0.01)
        numbers = {tuple(triangle) for triangle in used[triangles]}
        assert numbers == {tuple(triangle) for triangle in boundary}
        middle = vertices[triangles].mean(axis=1)
        apart = np.inf
        for e in default_heart.endocardia:
            square, _, _ = igl.point_mesh_squared_distance(middle, e.vertices, e.triangles)
            apart = np.minimum(apart, np.sqrt(square))
        count = surface["endocardial"]
        assert 0.2 * len(middle) < count < 0.6 * len(middle)
        assert apart[:count].max() < 0.35 * default_heart.edge_length
        assert (apart[count:] > 0.35 * default_heart.edge_length).mean() > 0.95

    def test_times_come_back(self, shown, default_heart):
        """On one scale in all scenarios; what is never reached is none."""
        simulation, content = shown
        used = np.unique(default_heart.boundary[0])
        high = content["times"]["high"]
        first, second = (scenario["activations"] for scenario in content["scenarios"])
        expected = simulation.activation - simulation.activation.min()
        for text in first:
            times = decoded(text, "<u1") / 254 * high
            np.testing.assert_allclose(times, expected[used], atol=0.51 * high / 254)
        right = default_heart.vertices[used, 0] > default_heart.vertices[:, 0].mean()
        for text in second:
            np.testing.assert_array_equal(decoded(text, "<u1") == 255, right)
        one, other = (scenario["fields"] for scenario in content["scenarios"])
        assert (one[0]["name"], one[0]["unit"], one[0]["kind"]) == ("activation_mean", "ms", "time")
        mean = decoded(one[0]["values"], "<u2") / (NONE - 1) * one[0]["high"]
        np.testing.assert_allclose(mean, expected[used], atol=0.01)
        for field in other:
            values = decoded(field["values"], "<u2")
            np.testing.assert_array_equal(values == NONE, right)
        assert [field["high"] for field in one] == [field["high"] for field in other]
        assert {field["low"] for field in one} == {0.0}

    def test_the_scale_ends_with_the_median_network(self, default_heart, shown):
        """One slow network stretches the times that are stored, not the colours."""
        simulation, _ = shown
        beat, totals = simulation.in_single_precision(), np.array([100.0, 100.0, 100.0, 300.0])
        slow = with_activation(beat, 3 * beat.activation)
        found = {"intrinsic": Predicted(Scenario(), [beat] * 3 + [slow], {
            "total_activation_time": totals,
        })}  # fmt: skip
        content = scene(default_heart, found)
        used = np.unique(default_heart.boundary[0])
        longest = np.ptp(simulation.activation)
        mean = 1.5 * (simulation.activation[used].max() - simulation.activation.min())
        assert content["times"]["high"] == pytest.approx(3 * longest, rel=1e-3)
        assert content["times"]["top"] == pytest.approx(max(longest, mean), rel=1e-3)

    def test_trees_come_back(self, shown):
        """Root, forks and ends of each tree once, with their times since the first activation."""
        simulation, content = shown
        assert len(content["trees"]) == 2  # both scenarios in both networks have the same
        scenario, low, high = content["scenarios"][1], *(
            content["times"][end] for end in ("low", "high")
        )  # fmt: skip
        for tree, times, packed, text in zip(
            simulation.trees, simulation.coupled.trees, content["trees"],
            scenario["tree_times"][0], strict=True,
        ):  # fmt: skip
            nodes = positions(content, packed["nodes"])
            apart = np.linalg.norm(nodes[:, None] - tree.nodes, axis=2)
            drawn = apart.argmin(axis=1)
            assert apart.min(axis=1).max() < 0.02
            assert {*tree.junctions, tree.root} <= {*drawn}
            assert len(drawn) < 0.7 * len(tree.nodes)
            before = decoded(packed["before"], "<i4")
            for end in np.flatnonzero(before):  # the parent is the next of those above
                above = tree.parents[drawn[end]]
                while above not in drawn:
                    above = tree.parents[above]
                assert above == drawn[end - before[end]]
            since = low + decoded(text, "<u1") / 254 * (high - low)
            expected = times[drawn] - simulation.activation.min()
            np.testing.assert_allclose(since, expected, atol=0.51 * (high - low) / 254)

    def test_ecgs_begin_with_the_first_activation(self, default_heart, shown):
        """Of beats that are later in the simulation's time, or longer on the way, the same."""
        simulation, content = shown
        window = content["ecg"]
        time = window["start"] + window["step"] * np.arange(window["count"])
        ecg = decoded(content["scenarios"][0]["ecgs"][0], "<i2").reshape(12, -1) / 1000
        begins = simulation.onset - simulation.activation.min()
        for lead, found in zip(simulation.leads, ecg, strict=True):
            own = np.interp(time, begins + np.arange(len(lead)), lead, left=0, right=0)
            np.testing.assert_allclose(found, own, atol=6e-4)

    def test_networks_are_spread_over_total_activation_time(self, default_heart, shown):
        simulation, _ = shown
        totals = np.random.default_rng(0).permutation(np.arange(100.0, 220.0))
        found = {"intrinsic": Predicted(Scenario(), [simulation.in_single_precision()] * 120, {
            "total_activation_time": totals,
        })}  # fmt: skip
        networks = [
            SimpleNamespace(parameters={"cv": total / 100, "alpha": 1.0}, torso=None)
            for total in totals
        ]
        content = scene(default_heart, found, networks)
        assert len(content["networks"]) == 39  # of 40 at most, the median among them
        total, speed = content["orders"]  # alpha is the same in all
        np.testing.assert_array_equal(total["values"], totals[np.array(content["networks"]) - 1])
        assert total["values"][0] == 100
        assert total["values"][-1] == 219
        assert 2 < np.diff(total["values"]).max() < 5
        assert total["values"][content["median"]] == 160
        assert (speed["label"], speed["unit"]) == ("Purkinje conduction velocity", "m/s")

    @pytest.mark.parametrize("total", [3, 100, 300])
    def test_the_median_network_is_among_those_that_fit_on_the_page(self, shown, total):
        totals = {
            "total_activation_time": np.random.default_rng(0).permutation(np.arange(float(total)))
        }
        found = Predicted(Scenario(), [shown[0].in_single_precision()] * total, totals)
        chosen = [_chosen(found, vertices, 4, False) for vertices in range(9000, 200_000, 3000)]
        assert len({len(numbers) for numbers in chosen}) > 10 or total == 3
        assert all(found.percentile_networks()["median"] in numbers for numbers in chosen)


def test_names_of_scenarios():
    for name, said in {
        "intrinsic": "intrinsic beat", "left-bundle-branch-block": "left bundle branch block",
        "his-pacing": "His pacing", "rv-apical-pacing": "RV apical pacing", "my-own": "my-own",
    }.items():  # fmt: skip
        assert scenario_name(name) == said


def test_what_is_paced_and_blocked_is_marked(shown, default_model):
    """A fascicle where it begins."""
    simulation, _ = shown
    trees, sites = simulation.in_single_precision().trees, default_model.sites
    his = Scenario((His(time=0.0), Stimulus(time=0.0, site="rv apex")))
    state = EXAMPLE_PARAMETERS | {"conduction": 1.0}  # left bundle branch block
    paced = {m["text"]: m for m in marks(his, EXAMPLE_PARAMETERS, trees, sites)}
    assert {mark["kind"] for mark in paced.values()} == {"paced"}
    assert paced["RV apex"]["place"] == pytest.approx(sites.position("rv apex"), abs=0.05)
    assert "His bundle" in paced
    (block,) = marks(Scenario(), state, trees, sites)
    lv = simulation.trees[0]
    assert (block["kind"], block["text"]) == ("blocked", "left bundle branch")
    assert block["place"] == pytest.approx(lv.nodes[lv.root], abs=0.05)
    slow = SlowConduction(tree="lv", part="anterior fascicle", speed=0.0)
    (block,) = marks(Scenario((slow,)), EXAMPLE_PARAMETERS, trees, sites)
    forks = lv.nodes[np.bincount(lv.parents[1:], minlength=len(lv.parents)) > 1]
    assert block["text"] == "LV anterior fascicle"
    assert np.linalg.norm(forks - block["place"], axis=1).min() < 0.1


@pytest.mark.parametrize(
    ("site", "named"),
    [
        ("mid anteroseptal endocardium", "mid anteroseptal, left side of the septum"),
        ("apical lateral endocardium", "apical lateral"),
        ("rv free wall", "RV free wall"),
    ],
)
def test_a_place_is_named_by_its_segment(default_model, site, named):
    sites = default_model.sites
    away = np.linalg.norm(sites.heart.vertices - sites.position(site), axis=1)
    assert where(int(away.argmin()), sites) == named


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


def test_the_sequence_of_activation_is_among_the_answers():
    """Beside mapped hearts; marked where it cannot be relied on, and left out of the paper's."""
    lines = ["first activated: left septum 90%", "last activation: 75 ms (mapped hearts <100)"]
    text = page(sequence=lines)
    answer = text[text.index('<section id="answer"') : text.index('<section id="ecg"')]
    assert "<li>first activated: left septum 90%</li>" in answer
    assert "&lt;100)</li>" in answer
    assert "Sequence of activation" not in page(sequence=[])
    marked = page(sequence=lines, caution=Caution.UNMAPPED)
    assert '<ul class="doubted"><li>first activated' in marked
    assert Caution.UNMAPPED.text in marked


def test_numbers_and_criteria_of_an_ecg_stand_in_its_tables():
    ecg = {
        "source": "", "text": "the ECG", "leads": [("V1", 0.834, 0.912)],
        "measured": [(MEASURES["axis_degrees"], 59.4, (50.2, 61.0, 70.7))],
    }  # fmt: skip
    text = page(pictures={"ecg": ecg}, rows=[("a", [(1.0, 2.0, 3.0)], ("apex", 0.25))])
    cells = re.findall('<td class="number">(.*?)</td>', text)
    assert cells == ["83%", "0.91", "59 degrees", "61 (50 to 71) degrees", "2 (1 to 3)"]
    assert "<td>apex (25%)</td>" in text
    assert '<th scope="row">a</th><td class="number">2 (1 to 3)</td>' in text
    found = [Criterion(f"block {met}", met, "QRS 90 ms", "them") for met in (True, False, None)]
    rows = re.findall(">block (.*?) \\(them\\)</th><td>(.*?)</td>", page(criteria=[found]))
    assert rows == [("True", "yes"), ("False", "no"), ("None", "not decided")]


def test_headers_of_tables_say_what_they_head():
    pages = [page.read_text("utf-8") for page in Path(fascicle.__file__).parent.rglob("*.html")]
    headers = [re.findall(r"<th(?: scope=.(\w+))?", page.replace("<thead", "")) for page in pages]
    assert {"col", "row"} == {scope for scopes in headers for scope in scopes}


def test_no_text_can_end_the_page_or_its_script():
    evil = "</script><script>alert(1)</script>"
    assert "</script>" not in _safe({"label": evil})
    assert json.loads(_safe({"label": evil}))["label"] == evil
    pictures = {"ecg": {"source": "", "text": evil}}
    text = page(study=evil, heart=evil, verdict=evil, warnings=[evil], pictures=pictures)
    assert "<script>alert" not in text
    assert "&lt;script&gt;" in text


def test_the_ecg_of_a_scenario(shown):
    simulation, _ = shown
    own = simulation.in_single_precision()
    later = np.pad(simulation.leads, ((0, 0), (60, 0)))
    later[:, : simulation.leads.shape[1]] += simulation.leads
    found = {
        name: Predicted(Scenario(), [beat], {"total_activation_time": np.ones(1)})
        for name, beat in (("intrinsic", own), ("longer", replace(own, leads=later)))
    }
    for axes in scenario_ecg_figure(found, "longer").axes:
        first, last = (line.get_xdata() for line in axes.lines)
        np.testing.assert_array_equal(first, last)
        assert last[-1] == axes.get_xlim()[1]
    long = "a-scenario-of-one's-own-" * 5
    beats, total = [simulation.in_single_precision()] * 40, {"total_activation_time": np.ones(40)}
    found = {name: Predicted(Scenario(), beats, total) for name in ("intrinsic", long)}
    figure = scenario_ecg_figure(found, long)
    assert figure.get_supxlabel() == "time (ms; 0: QRS onset)"
    figure.canvas.draw()
    legend = figure.legends[0].get_window_extent()
    assert legend.x0 > figure._suptitle.get_window_extent().x1
    assert legend.x1 <= figure.bbox.width


def test_rows_of_activations_say_which_time_they_give(default_heart, shown):
    simulation, _ = shown
    beats = [simulation.in_single_precision()] * 3
    totals = {"total_activation_time": np.array([90.0, 80.0, 85.0])}
    found = {name: Predicted(Scenario(), beats, totals) for name in ("intrinsic", "paced")}
    figure = scenario_activation_figure(default_heart, found, "paced")
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert [text for text in texts if "time" in text] == [
        "intrinsic beat\nmedian\ntotal activation\ntime 85 ms",
        "paced\n5th percentile\ntotal activation\ntime 80 ms",
        "paced\nmedian\ntotal activation\ntime 85 ms",
        "paced\n95th percentile\ntotal activation\ntime 90 ms",
    ]
