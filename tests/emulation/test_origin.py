"""Where a beat comes from."""

import json
from functools import partial

import numpy as np
import pytest
import pyvista as pv
from builders import recorded

import fascicle
from fascicle.core.errors import InputError
from fascicle.emulation import heart_emulator
from fascicle.emulation import origin as origin_module
from fascicle.emulation.heart_emulator import packaged
from fascicle.emulation.origin import Origin, ectopic_beats, levels, of_tetrahedra
from fascicle.heart.folder import write_heart
from fascicle.heart.sites import Sites
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.pools.pool import Threads
from fascicle.recording.target import Target
from fascicle.reporting.activation import origin_figure


@pytest.fixture(scope="module")
def small():
    """So few beats, and so little training, that it takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PriorSimulations, "part_size", 150)
        patch.setattr(heart_emulator, "packaged", lambda *_: None)
        learn = partial(origin_module.learn_origins, recording_count=6000, steps=600)
        patch.setattr(origin_module, "learn_origins", learn)
        yield


@pytest.fixture(scope="module")
def folder(small, default_heart, tmp_path_factory):
    folder = tmp_path_factory.mktemp("origin") / "heart"
    write_heart(default_heart, folder)
    return folder


@pytest.fixture(scope="module")
def target(default_model):
    """A beat from the apex of the right ventricle."""
    scenario = fascicle.read_scenarios(["rv-apical-pacing"])["rv-apical-pacing"]
    return recorded(default_model.simulate(fascicle.example_parameters(default_model), scenario))


@pytest.fixture(scope="module")
def origin(folder, target):
    return fascicle.locate(folder, target, prior_simulations=300, workers=2, progress=None)


@pytest.mark.slow
def test_an_apical_beat_is_found(origin):
    apex = np.array(Sites(origin.heart).position("rv apex"))
    assert np.linalg.norm(origin.place - apex) < 30  # 270 beats to learn from
    assert origin.walls["left ventricular free wall"] < 0.4
    assert origin.caution is None
    assert f"with 90% within {origin.radius:.0f} mm of it" in origin.verdict


@pytest.mark.slow
def test_probabilities_add_up(origin):
    assert origin.probabilities.sum() == pytest.approx(1)
    for table in (origin.ventricles, origin.walls, origin.layers, origin.segments):
        assert sum(table.values()) == pytest.approx(1)
    assert origin.segments["right ventricular free wall"] == pytest.approx(
        origin.walls["right ventricular free wall"]
    )
    inside = origin.probabilities[origin.region].sum()
    assert 0.9 <= inside < 0.9 + origin.probabilities.max() + 1e-9


def test_the_packaged_heart_brings_its_classifier(target, monkeypatch):
    monkeypatch.setattr(heart_emulator, "packaged", packaged)
    monkeypatch.setattr(origin_module.EctopicBeats, "simulate", None)
    found = fascicle.locate("default", target, progress=None)
    apex = np.array(Sites(found.heart).position("rv apex"))
    assert np.linalg.norm(found.place - apex) < found.radius < 30
    assert found.caution is None
    # of a beat of another heart, the atlas says what it is of, in a wide region
    of_atlas = fascicle.locate("atlas", target, progress=None)
    assert of_atlas.verdict.startswith("no image: averaged over 64 hearts of the population; ")
    assert of_atlas.radius > found.radius


@pytest.mark.slow
def test_it_is_made_once(origin, folder, target, monkeypatch):
    monkeypatch.setattr(origin_module, "learn", None)
    again = fascicle.locate(folder, target, prior_simulations=300, progress=None)
    np.testing.assert_allclose(again.probabilities, origin.probabilities)


@pytest.mark.slow
def test_it_is_written(origin, tmp_path):
    origin.save(tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "origin.json").read_text())
    assert summary["verdict"] == origin.verdict
    assert summary["held_out"]["distance"] > 0
    mesh = pv.read(tmp_path / "out" / "origin.vtu")
    volumes = origin.heart.volumes / 1000
    assert (mesh.cell_data["probability_per_ml"] * volumes).sum() == pytest.approx(1)
    origin.save(tmp_path / "out")  # again
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds 'notes\.txt', which would be lost"):
        origin.save(tmp_path / "out")
    assert origin_figure(origin).axes


@pytest.mark.slow
def test_a_beat_like_no_simulated_one_has_no_origin(origin, target, folder):
    """As with leads that are exchanged and turned over."""
    beats = target.beats[:, [0, 1, 2, 3, 4, 5, 11, 6, 10, 7, 9, 8]] * np.array(
        [1, 1, 1, 1, 1, 1, -1, 1, -1, 1, -1, 1]
    ).reshape(1, 12, 1)
    wrong = Target(
        beats, target.time, target.qrs_onset, target.qrs_offset, 60.0, {"source": "made"}, 4.0, 5.0
    )
    found = fascicle.locate(folder, wrong, prior_simulations=300, progress=None)
    assert found.explained < origin.explained
    assert found.verdict.startswith(
        "no origin is named: no simulated beat looks like the recording"
    )


@pytest.mark.slow
def test_beats_begin_where_they_are_said_to(folder, default_model):
    beats = ectopic_beats(default_model, folder)
    places, scenarios = beats.origins(0), beats.scenarios(0)
    assert len({*places[9::10]} & {*np.delete(places, np.s_[9::10])}) == 0  # of held-out ones
    (values, *_) = beats.parameters(0)
    simulation = default_model.simulate(values, scenarios[0])
    corners = default_model.heart.tetrahedra[places[0]]
    assert np.argmin(simulation.activation) in corners


def test_patches_and_levels(default_heart):
    centres = default_heart.vertices[default_heart.tetrahedra].mean(axis=1)
    patches = centres[[0, 5000, 40_000]]
    found = of_tetrahedra(default_heart, patches, np.array([[0.2, 0.3, 0.5]]))[0]
    nearest = np.linalg.norm(centres[:, None] - patches, axis=2).argmin(axis=1)
    np.testing.assert_allclose(np.bincount(nearest, found), [0.2, 0.3, 0.5])
    assert levels(np.array([0.1, 0.6, 0.3]), np.ones(3)) == pytest.approx([0.9, 0.0, 0.6])
    assert levels(np.array([0.5, 0.5]), np.array([1.0, 4.0])) == pytest.approx([0.0, 0.5])


def test_what_cannot_be_used_is_refused(default_heart, target):
    with pytest.raises(InputError, match="prior_simulations is 0"):
        fascicle.locate(default_heart, target, prior_simulations=0)
    with pytest.raises(InputError, match="workers is 0"):
        fascicle.locate(default_heart, target, workers=0)
    with pytest.raises(InputError, match="networks is 0"):
        fascicle.simulate_prior("default", 0)


@pytest.mark.slow
def test_the_pool_is_that_of_a_fit(folder, target):
    found = fascicle.locate(folder, target, prior_simulations=300, pool=Threads(1), progress=None)
    assert isinstance(found, Origin)


def test_the_first_line_says_that_no_image_was_used(atlas_model, small_heart):
    even = small_heart.volumes / small_heart.volumes.sum()
    of_atlas, of_heart = (
        Origin(heart, even, 1.0, 0.0, {}).verdict for heart in (atlas_model.heart, small_heart)
    )
    assert of_atlas.startswith("no image: averaged over 2 hearts of the population; left ")
    assert "mm of the mean heart, with 90% within" in of_atlas
    assert of_heart.startswith("left ")
