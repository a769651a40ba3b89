"""Hearts of an atlas: each network is shown, measured and written on its own heart."""

import json
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
import pyvista as pv
from anatomies import NETWORK
from builders import recorded

from fascicle import plot
from fascicle.core.errors import InputError
from fascicle.core.parameters import ParameterSpace, free
from fascicle.forward.simulation_files import simulate_inputs
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import TargetComparison
from fascicle.prediction.indices import Territories, indices
from fascicle.prediction.scenarios import simulate_scenarios, with_intrinsic_beat
from fascicle.reporting import activation
from fascicle.reporting.page.content import hearts
from fascicle.reporting.page.page import _file
from fascicle.reporting.page.scene import scene
from fascicle.reporting.prediction import write_prediction
from fascicle.reporting.study import drawings
from fascicle.study import results
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Population
from tests.reporting.test_page import positions
from tests.reporting.test_viewer import differ, picture, settle, slide, state

NUMBERS = np.array([0.0, 1.0, 1.0])  # hearts of the networks


@pytest.fixture(scope="module")
def fitted(atlas_model, tmp_path_factory):
    """Three networks, of which the first and the others are on different hearts."""
    prior = Prior(ParameterSpace((free("cv"),)), {n: v for n, v in NETWORK.items() if n != "cv"})
    simulator = PointSimulator(atlas_model, prior)
    values = {"cv": np.array([2.2, 2.5, 3.0]), "atlas_heart": NUMBERS}
    best = {"cv": 2.5, "atlas_heart": 1.0}
    recording = TargetComparison(recorded(atlas_model.simulate(NETWORK | best)))
    folder = tmp_path_factory.mktemp("study")
    study = SimpleNamespace(
        folder=folder,
        config=SimpleNamespace(
            method="posterior", states={}, heart="", target="", model_dump_json=lambda: "{}"
        ),
        records=list,
    )  # fmt: skip
    population = Population(values, np.array([0.3, 0.1, 0.2]), best, 0.1)
    return FittedStudy(study, simulator, (recording,), population)


@pytest.fixture(scope="module")
def networks(fitted):
    return fitted.networks()


@pytest.fixture(scope="module")
def predicted(fitted, networks):
    scenarios = with_intrinsic_beat({})
    return simulate_scenarios(fitted.simulator, fitted.recordings[0], networks, scenarios)


@pytest.fixture(scope="module")
def content(fitted, networks, predicted):
    model = fitted.simulator.model
    return scene(model.heart, predicted, networks, fitted.recordings[0], model)


def test_a_network_is_on_its_own_heart(fitted, networks):
    template = fitted.simulator.model.heart
    for k, network in enumerate(networks):
        heart = fitted.heart_of(k)
        expected = template.atlas.vertices(int(NUMBERS[k]))
        np.testing.assert_array_equal(heart.vertices, expected)
        for tree, e in zip(network.beat.trees, heart.endocardia, strict=True):
            np.testing.assert_allclose(tree.nodes[tree.root], e.vertices[e.root], atol=1e-6)
    assert fitted.best_model.heart is fitted.heart_of(1)


def test_indices_weigh_by_the_volumes_of_the_own_heart(fitted, networks, predicted):
    model = fitted.simulator.model
    shared = Territories.of(model.heart, model.sites.places)
    for k, network in enumerate(networks):
        own = shared.of_network(model.heart, network.parameters)
        np.testing.assert_allclose(own.volumes, fitted.heart_of(k).volumes)
        np.testing.assert_array_equal(own.segment, shared.segment)
        expected = indices(network.beat.in_single_precision(), own)
        for name in ("activation_time_90", "lv_dyssynchrony"):
            assert predicted["intrinsic"].indices[name][k] == pytest.approx(expected[name])


class TestScene:
    def test_of_an_atlas_has_the_hearts(self, fitted, content):
        shown = np.unique(fitted.simulator.model.heart.boundary[0])
        assert len(content["hearts"]) == 2
        for number, network in zip(content["heart"], content["networks"], strict=True):
            vertices = positions(content, content["hearts"][number])
            expected = fitted.heart_of(network - 1).vertices[shown]
            np.testing.assert_allclose(vertices, expected, atol=0.01)
        (surface,) = content["surfaces"]
        template = fitted.simulator.model.heart.vertices[shown]
        np.testing.assert_allclose(positions(content, surface["vertices"]), template, atol=0.01)
        for scenario in content["scenarios"]:
            assert all("on the template" in field["label"] for field in scenario["fields"])

    def test_of_one_heart_has_none(self, small_model):
        simulated = small_model.simulate(NETWORK)
        network = SimpleNamespace(parameters=NETWORK, beat=simulated, gain=1.0, drawn_gain=None)
        simulator = PointSimulator(small_model, Prior(ParameterSpace((free("cv"),))))
        recording = TargetComparison(recorded(simulated))
        found = simulate_scenarios(simulator, recording, [network], with_intrinsic_beat({}))
        content = scene(small_model.heart, found)
        assert not {"hearts", "heart"} & {*content}
        labels = [field["label"] for field in content["scenarios"][0]["fields"]]
        assert labels[0] == "mean of the networks"


@pytest.fixture
def page(visit, content, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(
        "<!DOCTYPE html><style>body { margin: 8px; background: #fff }</style><div id=viewer></div>"
        f"<script>{_file('viewer.js')}</script><script>window.viewer = fascicleViewer("
        f"document.getElementById('viewer'), {json.dumps(content)})</script>",
        encoding="utf-8",
    )
    opened = visit(path.as_uri(), viewport={"width": 700, "height": 700})
    settle(opened)
    return opened


def drawn(page):
    """Positions (n, 3) of the surface that is drawn (mm)."""
    found = page.evaluate(
        "Array.from(viewer.panels[0].heart.mesh.geometry.getAttribute('position').array)"
    )
    return np.reshape(found, (-1, 3))


def test_the_slider_shows_each_network_on_its_heart(page, fitted, content):
    shown = np.unique(fitted.simulator.model.heart.boundary[0])
    pictures = {}
    for rank in range(3):
        slide(page, rank, "network")
        k = state(page)["network"] - 1
        np.testing.assert_allclose(drawn(page), fitted.heart_of(k).vertices[shown], atol=0.01)
        pictures[k] = picture(page)
        edge = np.concatenate([pictures[k][0], pictures[k][-1]])
        assert edge.min() > 0.98  # no part of the heart is cut off
    assert differ(pictures[0], pictures[1]) > 0.02
    page.get_by_label("compare with").select_option(label="intrinsic beat")
    cameras = page.evaluate(
        "viewer.panels.map(({ stage: { camera, centre } }) => "
        "camera.position.clone().sub(centre).toArray())"
    )
    np.testing.assert_allclose(cameras[0], cameras[1], atol=1e-3)
    page.get_by_label("shown", exact=True).select_option(index=1)
    np.testing.assert_allclose(drawn(page), fitted.simulator.model.heart.vertices[shown], atol=0.01)
    assert page.evaluate("viewer.panels[0].trees.map(({ mesh }) => mesh.visible)") == [False] * 2


@pytest.fixture
def surfaces(monkeypatch):
    """Vertices of the hearts that figures of activation draw."""
    found, draw = [], activation.draw_surfaces

    def draw_surfaces(axes, view, *parts, **options):
        found.append(parts[0].vertices)
        draw(axes, view, *parts, **options)

    monkeypatch.setattr(activation, "draw_surfaces", draw_surfaces)
    return found


def rows_of(surfaces, columns=6):
    return surfaces[::columns]


def test_figures_draw_each_network_on_its_heart(fitted, networks, predicted, surfaces):
    plot.activation(fitted, predicted, "intrinsic")
    shown = predicted["intrinsic"].percentile_networks()
    for row, k in zip(rows_of(surfaces), shown.values(), strict=True):
        np.testing.assert_array_equal(row, fitted.heart_of(k).vertices)
    template = fitted.simulator.model.heart
    surfaces.clear()
    (*_, bar) = plot.activation_spread(fitted, predicted)
    assert "on the template" in bar.get_ylabel()
    np.testing.assert_array_equal(surfaces[0], template.vertices)
    with pytest.raises(InputError, match="give the study"):
        plot.activation(template, predicted, "intrinsic")
    plot.beat(networks[0].beat, fitted.heart_of(0))
    with pytest.raises(InputError, match="another heart of the atlas"):
        plot.beat(networks[0].beat, template)


def test_figures_of_a_study_are_of_the_best_network(fitted, networks, surfaces):
    found = drawings(fitted, networks)
    np.testing.assert_array_equal(surfaces[0], fitted.best_model.heart.vertices)
    np.testing.assert_array_equal(surfaces[6], fitted.simulator.model.heart.vertices)
    assert found["heart"].text.startswith("The heart of the best network: ")
    assert found["activation-spread"].text.endswith("on the template heart of the atlas.")


def test_files_of_predictions(fitted, predicted, tmp_path):
    write_prediction(fitted, predicted, tmp_path / "out")
    folder = tmp_path / "out" / "intrinsic"
    template = pv.read(folder / "activation.vtu")
    np.testing.assert_array_equal(template.points, fitted.simulator.model.heart.vertices)
    assert {*template.point_data} == {*predicted["intrinsic"].maps}
    (note,) = meshio.read(folder / "activation.vtu").field_data
    assert note.endswith("on the template")
    for which, k in predicted["intrinsic"].percentile_networks().items():
        own, heart = (
            pv.read(folder / f"activation-{which}.vtu".replace(" ", "-")),
            fitted.heart_of(k),
        )
        np.testing.assert_array_equal(own.points, heart.vertices)
        np.testing.assert_array_equal(own["fibre"], heart.fibres)
        assert np.nanmin(own["activation"]) == 0


def test_files_of_a_study(fitted, networks, monkeypatch):
    monkeypatch.setattr(results, "_summary", lambda *_: {})
    monkeypatch.setattr(results, "write_population", lambda *_: None)
    results.write_results(fitted, networks, [])
    best = pv.read(fitted.folder / "networks" / "best" / "activation.vtu")
    np.testing.assert_array_equal(best.points, fitted.best_model.heart.vertices)
    maps = pv.read(fitted.folder / "activation.vtu")
    np.testing.assert_array_equal(maps.points, fitted.simulator.model.heart.vertices)
    assert "activation" not in maps.point_data
    assert "activation_mean" in maps.point_data


def test_the_page_says_which_hearts(fitted):
    averaged = SimpleNamespace(averaged={"atlas_heart": NUMBERS})
    of_posterior = SimpleNamespace(simulator=fitted.simulator, population=averaged)
    expected = "2 of the 2 of the atlas: number 1 in 67%, number 0 in 33%"
    assert hearts(of_posterior) == [("hearts of the networks", expected)]
    assert hearts(fitted) == []


def test_a_simulation_is_of_the_heart_that_the_parameters_name(atlas_model):
    beat, _, heart = simulate_inputs(lambda: atlas_model, overrides={"atlas_heart": 1.0})
    np.testing.assert_array_equal(heart.vertices, atlas_model.heart.atlas.vertices(1))
    np.testing.assert_allclose(beat.trees[0].nodes[0], heart.lv.vertices[heart.lv.root], atol=1e-6)
    _, _, heart = simulate_inputs(lambda: atlas_model)
    assert heart is atlas_model.heart
