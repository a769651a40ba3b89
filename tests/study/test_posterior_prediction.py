"""What a likelihood takes from a target, and posterior predictive checks, on made-up networks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.forward.likelihood import (
    MARGIN,
    QrsLikelihood,
    beat_noise,
    cosines,
    matern,
    separable,
)
from fascicle.forward.loss import placed
from fascicle.recording.target import Target
from fascicle.study.predictive import RARE, frontal_axis, predict_recording

QRS, TIME = 80, np.arange(-100.0, 160.0)
FIRST = 10.0  # sample of the simulations' first activation
NETWORKS = 200


def twelve(independent):
    """Twelve leads from I, II and V1 to V6, along the second axis from the end."""
    one, two = independent[..., 0, :], independent[..., 1, :]
    limb = [one, two, two - one, -(one + two) / 2, one - two / 2, two - one / 2]
    return np.concatenate([np.stack(limb, axis=-2), independent[..., 2:, :]], axis=-2)


def simulated():
    """Twelve leads of 120 samples (mV)."""
    t = np.arange(120) - FIRST
    bump = np.where(t > 0, np.sin(np.pi * t / 75), 0) * (t < 75)
    sizes = np.array([0.5, 0.8, -0.4, -0.6, 0.3, 1.2, 1.0, 0.7])
    return twelve(sizes[:, None] * bump)


def target(rng, beats=40, noise=0.02):
    """The simulation as a recording of several beats, its onset at -40 ms."""
    start = 60  # sample of the onset
    clean = placed(simulated(), FIRST - start, len(TIME))
    errors = twelve(noise * rng.standard_normal((beats, 8, len(TIME))))
    return Target(clean + errors, TIME, -40.0, 39.0, 60.0, onset_sd=2.0, offset_sd=3.0)


@pytest.fixture(scope="module")
def recorded():
    return target(np.random.default_rng(0))


def likelihood(recorded):
    modes = cosines(recorded.qrs.shape[1])
    known = beat_noise(recorded) + 1e-6 * np.eye(8 * modes.shape[1])
    discrepancy = separable(np.eye(8), matern(len(modes)), modes)
    return QrsLikelihood(recorded, known, discrepancy, 0.3)


def predict(recorded):
    network = SimpleNamespace(
        simulation=SimpleNamespace(
            leads=simulated(), first_activation=FIRST, qrs_duration=80.0, trees=()
        )
    )
    rng = np.random.default_rng(1)
    return predict_recording(recorded, likelihood(recorded), [network] * NETWORKS, rng)


def test_noise_of_the_mean_beat(recorded):
    found = beat_noise(recorded)
    inside = cosines(recorded.qrs.shape[1])[MARGIN:-MARGIN]
    white = 0.02**2 / 40 * np.kron(np.eye(8), inside.T @ inside)
    assert np.trace(found) == pytest.approx(np.trace(white), rel=0.1)
    assert np.linalg.norm(found - white) < 0.3 * np.linalg.norm(white)


def test_noise_of_a_single_beat_is_the_stated_one(recorded):
    single = replace(recorded, beats=recorded.beats[:1], noise=0.03)
    inside = cosines(single.qrs.shape[1])[MARGIN:-MARGIN]
    expected = 0.03**2 * np.kron(np.eye(8), inside.T @ inside)
    assert beat_noise(single) == pytest.approx(expected, abs=1e-12)


def test_a_recording_of_the_model_agrees(recorded):
    found = predict(recorded)
    assert found.checks.disagreeing == []
    assert found.gains.mean() == pytest.approx(1, abs=0.05)
    assert found.shifts.mean() == pytest.approx(0, abs=0.5)
    window = recorded.qrs_samples
    assert np.abs(found.ecg.mean(axis=0) - recorded.mean)[:, window].max() < 0.1


def test_noise_obeys_the_laws_of_the_limb_leads(recorded):
    found = predict(recorded)
    error = found.noisy - found.ecg
    assert np.abs(error[:, 0] + error[:, 2] - error[:, 1]).max() < 1e-9
    assert np.abs(error[:, 3:6].sum(axis=1)).max() < 1e-9
    assert error[:, 0].std() > 0
    assert error[:, :, :10].max() == 0  # far from the QRS


def test_a_lead_that_disagrees_is_named(recorded):
    beats = recorded.beats.copy()
    beats[:, 9] *= -1  # V4 upside down
    found = predict(replace(recorded, beats=beats))
    assert found.checks.disagreeing == ["V4"]
    assert found.checks.share > 0.5


def test_what_networks_leave_is_named(recorded):
    """A recording twice as large, with the gain near 1, leaves what is not scaled."""
    checks = predict(recorded).checks
    assert checks.share < 0.1
    assert predict(replace(recorded, beats=2 * recorded.beats)).checks.share > checks.share


def test_another_duration_and_another_axis_are_named(recorded):
    wide = replace(recorded, qrs_offset=75.0)
    assert predict(wide).checks.probabilities["window QRS duration"] < RARE
    beats = recorded.beats.copy()
    beats[:, :6] *= -1
    assert predict(replace(recorded, beats=beats)).checks.share > 0.3


@pytest.mark.parametrize("angle", [-80.0, 0.0, 60.0, 170.0])
def test_axis(angle):
    dipole = np.radians(angle)
    ecg = np.zeros((12, 5))
    ecg[0] = np.cos(dipole)
    ecg[1] = np.cos(dipole - np.radians(60))
    ecg[5] = ecg[1] - ecg[0] / 2
    assert frontal_axis(ecg) == pytest.approx(angle)
