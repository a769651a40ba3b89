"""The likelihood of a recorded QRS: against brute force, and what it must not depend on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from fascicle.forward.beat import Signals
from fascicle.forward.likelihood import (
    MARGIN,
    QrsLikelihood,
    cosines,
    lead_pattern,
    matern,
    separable,
)
from fascicle.forward.loss import placed
from fascicle.kernels.gaussian import MODELS_AT_ONCE
from fascicle.recording.target import Target

QRS = 60  # samples
ONSET = 15.3  # sample of the simulation's first activation


def signal(width: float = 8.0) -> np.ndarray:
    """Two smooth leads of 100 samples that begin at `ONSET`."""
    t = np.arange(100) - ONSET
    rise = np.where(t > 0, t, 0) / 20
    return np.array(
        [
            rise * np.exp(-0.5 * ((t - 25) / width) ** 2),
            -0.7 * rise * np.exp(-0.5 * ((t - 35) / 9) ** 2),
        ]
    )


def ecg(leads: np.ndarray, onset: float = ONSET) -> Signals:
    """V1 and V2, and nothing in the others."""
    return Signals(np.pad(leads, ((6, 4), (0, 0))), onset, (1, 1))


def target(recorded: np.ndarray) -> Target:
    """One beat, which is all QRS, in V1 and V2."""
    beat = np.full((1, 12, QRS), np.nan)
    beat[0, 6:8] = recorded
    return Target(beat, np.arange(float(QRS)), 0.0, QRS - 1.0, 60.0, onset_sd=4.0)


def example(gain_sd: float = 0.3, noise: float = 0.02) -> QrsLikelihood:
    """The same signal, louder, later by 1.6 samples and with an error, as a recording."""
    modes = cosines(QRS)
    rng = np.random.default_rng(0)
    recorded = 1.2 * placed(signal(), ONSET + 1.6, QRS) + 0.05 * np.sin(
        np.arange(QRS) / 9
    ) * rng.standard_normal((2, 1))
    known = noise**2 * np.eye(2 * modes.shape[1])
    leads = np.array([[1.0, -0.3], [-0.3, 1.0]])
    discrepancy = separable(leads, matern(len(modes)), modes)
    bodies = np.zeros((2, 12, 12))
    bodies[:, 6:8, 6:8] = [[[0.2, -0.1], [0.0, 0.1]], [[0.0, 0.3], [-0.1, 0.0]]]
    return QrsLikelihood(target(recorded), known, discrepancy, gain_sd, bodies)


def brute_force(likelihood: QrsLikelihood, simulated: np.ndarray, scale: float) -> float:
    """The same integral over the shift for one discrepancy, by plain sums and whole matrices."""
    covariance = likelihood.covariance + scale**2 * likelihood.discrepancy
    data = (
        np.pad(likelihood.target.qrs[6:8], ((0, 0), (MARGIN, MARGIN))) @ likelihood.modes
    ).ravel()
    sd = np.hypot(4.0, 3.0)
    logs = []
    for offset in np.arange(-3 * sd, 3 * sd, 0.05):
        model = placed(simulated, ONSET - MARGIN + offset, likelihood.length) @ likelihood.modes
        added = [likelihood.gain_sd * model, *(likelihood.torso_modes[:, 6:8, 6:8] @ model)]
        columns = np.array([each.ravel() for each in added])
        each = multivariate_normal.logpdf(data, model.ravel(), cov=covariance + columns.T @ columns)
        logs.append(each + norm.logpdf(offset, 0, sd) + np.log(0.05))
    return float(logsumexp(logs))


@pytest.mark.parametrize(("noise", "scale"), [(0.02, 0.1), (0.003, 0.15), (0.02, 0.3)])
def test_against_brute_force(noise, scale, monkeypatch):
    likelihood = example(noise=noise)
    coarse, shares = QrsLikelihood.shift_step, QrsLikelihood.shares[:1]
    monkeypatch.setattr(QrsLikelihood, "shares", scale * shares / likelihood.scales[0])
    monkeypatch.setattr(QrsLikelihood, "shift_step", 1)
    likelihood = example(noise=noise)
    assert likelihood.scales == pytest.approx([scale])
    expected = brute_force(likelihood, signal(), scale)
    assert likelihood.fit(ecg(signal())).log_likelihood == pytest.approx(expected, abs=0.02)
    # fewer shifts, which is faster, are as good with what an emulator leaves: 20 % of the QRS
    left = 0.2 * np.linalg.norm(likelihood.target.qrs[6:8]) / np.sqrt(len(likelihood.covariance))
    likelihood = example(noise=np.hypot(noise, left))
    expected = brute_force(likelihood, signal(), scale)
    monkeypatch.setattr(QrsLikelihood, "shift_step", coarse)
    likelihood = example(noise=np.hypot(noise, left))
    assert likelihood.log_likelihood(ecg(signal())) == pytest.approx(expected, abs=0.1)


def test_the_sizes_of_the_discrepancy_are_averaged(monkeypatch):
    monkeypatch.setattr(QrsLikelihood, "shares", QrsLikelihood.shares[[0, 2, 3]])
    monkeypatch.setattr(QrsLikelihood, "shift_step", 1)
    likelihood = example()
    each = [brute_force(likelihood, signal(), scale) for scale in likelihood.scales]
    fit = likelihood.fit(ecg(signal()))
    assert fit.log_likelihood == pytest.approx(logsumexp(each) - np.log(3), abs=0.02)
    assert fit.weights.sum(axis=1) == pytest.approx(np.exp(each - logsumexp(each)), abs=0.02)


@pytest.mark.parametrize("gain_sd", [0.0, 0.3])
def test_sums_are_compared_as_simulations_are(gain_sd):
    """ECGs that are sums of a mean and of parts, many at a time, in single precision, too."""
    likelihood, rng = example(gain_sd), np.random.default_rng(0)
    mean, *parts = (np.pad(signal(width), ((6, 4), (0, 0))) for width in (8.0, 5.0, 13.0))
    count = 2 * MODELS_AT_ONCE + 5
    scores, gains = rng.standard_normal((count, 2)), rng.uniform(0.5, 2, count)
    each = gains[:, None, None] * (mean + np.tensordot(scores, parts, 1))
    expected = [likelihood.log_likelihood(Signals(leads, ONSET, (1, 1))) for leads in each]
    seen = np.array([likelihood.whitened(leads, ONSET) for leads in (mean, *parts)])
    given = seen.transpose(3, 1, 2, 0)
    weights = gains * np.concatenate([np.ones((1, count)), scores.T])
    assert np.ptp(expected) > 10
    for kind, exact in ((np.float64, 1e-9), (np.float32, 1e-4)):
        found = likelihood.of_sums(*(np.ascontiguousarray(a, kind) for a in (given, weights)))
        assert found == pytest.approx(expected, rel=exact)


def test_gain_and_shift_are_found():
    """By the posterior, and so by what is drawn of it."""
    likelihood, rng = example(gain_sd=1.0), np.random.default_rng(1)
    fit = likelihood.fit(ecg(signal()))
    by_shift = fit.weights.sum(axis=0)
    assert by_shift @ fit.shifts == pytest.approx(ONSET - MARGIN + 1.6, abs=1.0)
    alone = replace(likelihood, torso_modes=likelihood.torso_modes[:0])
    drawn = [alone.predictive(ecg(signal()), rng) for _ in range(100)]
    assert np.mean([each.gain for each in drawn]) == pytest.approx(1.2, abs=0.1)


def test_a_body_of_the_prior_is_found():
    """What it adds to the leads is in the networks' recordings that are drawn."""
    likelihood, rng = example(gain_sd=0.1), np.random.default_rng(1)
    recorded = placed(signal() + 2 * likelihood.torso_modes[1, 6:8, 6:8] @ signal(), ONSET, QRS)
    given = replace(likelihood, target=target(recorded))
    left = [
        np.mean([((each.predictive(ecg(signal()), rng).ecg[6:8] - recorded) ** 2).sum()
                 for _ in range(30)])
        for each in (given, replace(given, torso_modes=given.torso_modes[:0]))
    ]  # fmt: skip
    assert left[0] < 0.5 * left[1]


def test_a_fixed_gain_is_the_limit_of_a_certain_one():
    fixed = example(gain_sd=0.0).fit(ecg(signal()))
    almost = example(gain_sd=1e-5).fit(ecg(signal()))
    assert fixed.log_likelihood == pytest.approx(almost.log_likelihood, abs=1e-6)
    assert example(gain_sd=0.0).predictive(ecg(signal()), np.random.default_rng(0)).gain == 1


def test_moved_in_time_by_parts_of_a_sample():
    likelihood = example()
    later = placed(signal(), -0.37, 110)
    assert likelihood.fit(ecg(later, ONSET + 0.37)).log_likelihood == pytest.approx(
        likelihood.fit(ecg(signal())).log_likelihood, abs=1e-3
    )


def test_covariances_are_of_rank():
    modes = cosines(QRS)
    assert np.linalg.eigvalsh(matern(len(modes))).min() > 0
    pattern = lead_pattern([signal(), signal(5.0)])
    assert np.trace(pattern) == pytest.approx(2)
    assert np.linalg.eigvalsh(pattern).min() >= 0.5
