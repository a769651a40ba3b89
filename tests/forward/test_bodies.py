"""Random bodies: what is drawn, where electrodes are then, and ECGs in an unbounded conductor."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK

import fascicle
from fascicle.networks import prior_simulations
from fascicle.networks.prior_simulations import moved_electrodes, random_bodies
from fascicle.torso.conductor import TorsoState, torso_axes
from fascicle.torso.training import torsos_of_the_prior

CHEST = slice(3, 9)


@pytest.fixture(scope="module")
def model(small_heart):
    """Of the small heart with LA again as an additional electrode, in an unbounded conductor."""
    more = {"E1": small_heart.electrodes[1]}
    return fascicle.ForwardModel(replace(small_heart, additional_electrodes=more))


@pytest.fixture
def displaced(small_heart):
    """How far (mm) electrodes move to the left, posteriorly and up, given the heart's centroid."""
    heart = small_heart
    places = np.array([*heart.electrodes, [0.0, 100.0, 0.0]])
    centroid = heart.vertices.mean(axis=0)

    def displaced(**values):
        moved = moved_electrodes(places, centroid, TorsoState.of(values))
        return (moved - places) @ torso_axes(places).T

    displaced.outwards = (places - centroid) @ torso_axes(places).T
    return displaced


def test_priors_are_those_of_the_documentation_and_the_impossible_is_drawn_again(monkeypatch):
    drawn = []
    monkeypatch.setattr(TorsoState, "of", lambda values: drawn.append(values) or len(drawn))
    torsos = torsos_of_the_prior(np.random.default_rng(0), 2000, lambda number: number % 2 == 0)
    assert torsos == list(range(2, 4001, 2))
    spread = {name: np.std([values[name] for values in drawn]) for name in drawn[0]}
    assert len(spread) == 24
    logs = np.log([values["lung_conductivity"] for values in drawn])
    # cut off at 2.5 standard deviations and more
    for found, sd in (
        (spread["heart_posterior"], 8.0), (spread["heart_rotation_up"], np.radians(8.0)),
        (spread["v1_left"], 10.0), (spread["v6_up"], 10.0), (spread["chest_electrodes_up"], 15.0),
        (spread["chest_size"], 0.05), (logs.std(), 0.25),
    ):  # fmt: skip
        assert 0.9 * sd < found < 1.02 * sd


def test_electrodes_move_as_the_skin_does_around_the_heart(displaced):
    outwards = displaced.outwards
    np.testing.assert_allclose(displaced(), 0, atol=1e-12)
    np.testing.assert_allclose(displaced(heart_up=5.0), [[0, 0, -5.0]] * 10, atol=1e-9)
    np.testing.assert_allclose(displaced(chest_size=1.1), 0.1 * outwards, atol=1e-9)
    turned = outwards + displaced(heart_rotation_up=np.radians(8.0))
    angles = np.degrees(np.arctan2(turned[:, 1], turned[:, 0]))
    before = np.degrees(np.arctan2(outwards[:, 1], outwards[:, 0]))
    np.testing.assert_allclose((before - angles + 180) % 360 - 180, 8.0, atol=1e-9)
    np.testing.assert_allclose(turned[:, 2], outwards[:, 2], atol=1e-9)


def test_chest_electrodes_move_at_right_angles_to_the_line_to_the_heart(displaced):
    for name in ("left", "up"):
        moved = displaced(**{f"v{k}_{name}": 10.0 for k in range(1, 7)})
        np.testing.assert_allclose(np.linalg.norm(moved[CHEST], axis=1), 10.0)
        np.testing.assert_allclose((moved * displaced.outwards).sum(axis=1), 0, atol=1e-6)
        assert np.abs(moved[[0, 1, 2, 9]]).max() < 1e-9
    left, up = displaced(v1_left=10.0, v6_left=10.0), displaced(chest_electrodes_up=15.0)
    assert left[3, 0] > 8  # V1 to the left, V6 to the back
    assert left[8, 1] > 8
    assert (up[CHEST, 2] > 12).all()


def test_ecgs_in_an_unbounded_conductor(model):
    beat = model.simulate(NETWORK)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prior_simulations, "torsos_of_the_prior", lambda *_: [TorsoState.of({})])
        (neutral,) = random_bodies(model, np.random.default_rng(0), 1)
    np.testing.assert_allclose(neutral.leads(beat.activation), beat.leads, atol=1e-6)
    one, again = (random_bodies(model, np.random.default_rng(0), 2) for _ in range(2))
    leads = [body.leads(beat.activation) for body in one]
    for body, found in zip(again, leads, strict=True):
        np.testing.assert_array_equal(body.leads(beat.activation), found)
        change = np.sqrt(((found - beat.leads) ** 2).mean() / (beat.leads**2).mean())
        assert 0.05 < change < 1.5
        # LA less Wilson's terminal is 2/3 aVL: additional electrodes move with the limbs'
        np.testing.assert_allclose(found[12], found[4] * 2 / 3, atol=1e-5)
    assert np.abs(leads[0] - leads[1]).max() > 0.05  # mV
