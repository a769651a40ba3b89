"""What a likelihood takes from a target, and posterior predictive checks, on made-up networks."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.emulation.predictive import Checks, predict_recording
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.likelihood import (
    MARGIN,
    QrsLikelihood,
    beat_noise,
    cosines,
    matern,
    separable,
)
from fascicle.forward.loss import placed
from fascicle.networks.target_comparison import Network
from fascicle.recording.criteria import frontal_axis
from fascicle.recording.target import Target

QRS, TIME = 80, np.arange(-100.0, 160.0)
FIRST = 10.0  # sample of the simulations' first activation
NETWORKS = 200


def twelve(independent):
    """Twelve leads from I, II and V1 to V6, along the second axis from the end."""
    one, two = independent[..., 0, :], independent[..., 1, :]
    limb = [one, two, two - one, -(one + two) / 2, one - two / 2, two - one / 2]
    return np.concatenate([np.stack(limb, axis=-2), independent[..., 2:, :]], axis=-2)


def simulated(length=75):
    """Twelve leads of 160 samples (mV), with a QRS of so many ms."""
    t = np.arange(160) - FIRST
    bump = np.where(t > 0, np.sin(np.pi * t / length), 0) * (t < length)
    sizes = np.array([0.5, 0.8, -0.4, -0.6, 0.3, 1.2, 1.0, 0.7])
    return twelve(sizes[:, None] * bump)


def target(rng, beats=40, noise=0.02, length=75):
    """The simulation as a recording of several beats, its onset at -40 ms."""
    start = 60  # sample of the onset
    clean = placed(simulated(length), FIRST - start, len(TIME))
    errors = twelve(noise * rng.standard_normal((beats, 8, len(TIME))))
    return Target(clean + errors, TIME, -40.0, length - 36.0, 60.0, onset_sd=2.0, offset_sd=3.0)


@pytest.fixture(scope="module")
def recorded():
    return target(np.random.default_rng(0))


def likelihood(recorded):
    modes = cosines(recorded.qrs.shape[1])
    known = beat_noise(recorded) + 1e-6 * np.eye(8 * modes.shape[1])
    discrepancy = separable(np.eye(8), matern(len(modes)), modes)
    return QrsLikelihood(recorded, known, discrepancy, 0.3, np.empty((0, 12, 12)))


def network(factor=1.0):
    """A network whose leads are the simulation's times so much."""
    leads = simulated() * factor
    simulation = Beat(leads, 0.0, (), Activation(np.array([FIRST, 85.0])))
    return Network({}, simulation, placed(leads, FIRST - 60, len(TIME)), 1.0, 1.0)


def predict(recorded, networks=None):
    networks = networks or [network()] * NETWORKS
    rng = np.random.default_rng(1)
    return predict_recording(recorded, [likelihood(recorded)] * len(networks), networks, rng)


def test_noise_of_the_mean_beat_and_of_a_single_one(recorded):
    """Of 40 beats; of one, its stated noise."""
    inside = cosines(recorded.qrs.shape[1])[MARGIN:-MARGIN]
    unit = np.kron(np.eye(8), inside.T @ inside)
    found, white = beat_noise(recorded), 0.02**2 / 40 * unit
    assert np.trace(found) == pytest.approx(np.trace(white), rel=0.1)
    assert np.linalg.norm(found - white) < 0.3 * np.linalg.norm(white)
    single = replace(recorded, beats=recorded.beats[:1], noise=0.03)
    assert beat_noise(single) == pytest.approx(0.03**2 * unit, abs=1e-12)


@pytest.fixture(scope="module")
def found(recorded):
    """Prediction of the recording by the network that it is of."""
    return predict(recorded)


def test_a_recording_of_the_model_agrees(recorded, found):
    assert found.checks.disagreeing == []
    assert found.checks.gain == pytest.approx([1, 0.25, 1.75], abs=0.05)
    assert found.gains.mean() == pytest.approx(1, abs=0.05)
    assert found.shifts.mean() == pytest.approx(0, abs=0.5)
    window = recorded.qrs_samples
    assert np.abs(found.ecg.mean(axis=0) - recorded.mean)[:, window].max() < 0.1
    error = found.noisy - found.ecg
    assert np.abs(error[:, 0] + error[:, 2] - error[:, 1]).max() < 1e-9
    assert np.abs(error[:, 3:6].sum(axis=1)).max() < 1e-9
    assert error[:, 0].std() > 0
    assert error[:, :, :10].max() == 0  # far from the QRS


def test_the_torso_that_was_drawn_is_kept(recorded):
    bodies = np.random.default_rng(2).normal(0, 1.0, (2, 12, 12))
    one = network()
    drawn = replace(likelihood(recorded), torso_modes=bodies).predictive(
        one.beat.signals, np.random.default_rng(3)
    )
    leads = drawn.gain * drawn.torso @ one.beat.leads
    begin = one.beat.first_activation - drawn.shift - recorded.qrs_samples.start
    np.testing.assert_allclose(
        drawn.ecg, placed(leads, begin, len(TIME), recorded.response), atol=1e-12
    )
    assert np.abs(drawn.torso - np.eye(12)).max() > 0.01


def test_a_lead_or_a_gain_that_disagrees_is_named(recorded):
    beats = recorded.beats.copy()
    beats[:, 9] *= -1  # V4 upside down
    checks = predict(replace(recorded, beats=beats)).checks
    assert "V4" in checks.disagreeing
    assert checks.explained < 0.7
    assert not checks.acceptable
    checks = predict(replace(recorded, beats=3 * recorded.beats)).checks
    assert 2 < checks.gain[0] < 3  # less than 3, since its prior is about 1
    assert checks.failures == [f"ECG scaled by {checks.gain[0]:.2g}, 0.25 to 1.8 expected"]


def test_the_best_networks_count(recorded):
    """Half of the networks far from the recording make a wide posterior, not a poor fit."""
    flat = network(0.001)
    checks = predict(recorded, [network(), flat] * (NETWORKS // 2)).checks
    assert checks.explained > 0.95
    assert "all leads together" not in checks.disagreeing
    best = round(0.5 * Checks.best_share * NETWORKS)
    few = predict(recorded, [network()] * best + [flat] * (NETWORKS - best)).checks
    assert few.explained < 0.2


def test_another_duration_and_another_axis_are_named(recorded):
    """The recorded QRS is 40 ms longer, and the limb leads are upside down."""
    wide = target(np.random.default_rng(0), length=115)
    checks = predict(wide).checks
    recorded_ms, low, middle, high = checks.measured["QRS duration"]
    assert recorded_ms - middle == pytest.approx(27, abs=5)  # kinks are seen 6 ms early
    assert low == middle == high
    assert checks.probabilities["QRS duration"] < checks.least_probable
    assert checks.failures[0] == (
        f"QRS duration {recorded_ms:.0f} ms recorded, {middle:.0f} ({low:.0f}–{high:.0f}) simulated"
    )
    beats = recorded.beats.copy()
    beats[:, :6] *= -1
    checks = predict(replace(recorded, beats=beats)).checks
    assert "frontal axis" in checks.disagreeing
    assert checks.measured["frontal axis"][0] - checks.measured["frontal axis"][2] == pytest.approx(
        180, abs=5
    )


def test_failures_share_the_level_and_come_in_the_order_of_a_cardiologist():
    one = Checks(0.95, {"V1": 0.04}, {})
    assert one.disagreeing == ["V1"]
    assert Checks.joined([one, Checks(0.90, {"V1": 0.5})]) == Checks(
        0.90, {"V1 of recording 1": 0.08, "V1 of recording 2": 1.0}
    )
    rare = {"QRS duration": 0.03, "frontal axis": 0.001, "V1": 0.0, "V2": 0.5, "V4": 0.01}
    measured = {"QRS duration": [191, 131, 148, 161], "frontal axis": [-80.2, 20, 30, 40]}
    assert Checks(0.6, rare, measured).failures == [
        "QRS duration 191 ms recorded, 148 (131–161) simulated",
        "frontal axis -80° recorded, 30 (20–40) simulated",
        "V1, V4 not reproduced",
        "60% of the QRS explained by the best 5% of networks, less than 85%",
    ]


@pytest.mark.parametrize("angle", [-80.0, 0.0, 60.0, 170.0])
def test_axis(angle):
    dipole = np.radians(angle)
    ecg = np.zeros((12, 5))
    ecg[0] = np.cos(dipole)
    ecg[1] = np.cos(dipole - np.radians(60))
    ecg[5] = ecg[1] - ecg[0] / 2
    assert frontal_axis(ecg) == pytest.approx(angle)
