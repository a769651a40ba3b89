"""Residual covariance of targets whose covariance is known."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.recording.residuals import residual_covariance
from fascicle.recording.target import Target

TIME = np.arange(-40.0, 61.0)
LENGTH = 8.0  # ms of the correlation in time


def full(found):
    """The whole covariance (mV²), shape (12, n_qrs, 12, n_qrs)."""
    return np.einsum("lt,ms,lm,ts->ltms", found.sd, found.sd, found.leads, found.time)


def known(rng, beats):
    """Target with residuals of a known separable covariance, and its correlations and SDs."""
    mixing = rng.normal(size=(12, 12))
    of_leads = mixing @ mixing.T
    root = np.sqrt(np.diag(of_leads))
    of_leads /= np.outer(root, root)
    lag = np.subtract.outer(TIME, TIME)
    of_time = np.exp(-((lag / LENGTH) ** 2))
    sd = rng.uniform(0.02, 0.1, 12)[:, None] * (1 + 0.5 * np.sin(TIME / 20))
    white = rng.normal(size=(beats, 12, len(TIME)))
    low_lead = np.linalg.cholesky(of_leads + 1e-9 * np.eye(12))
    low_time = np.linalg.cholesky(of_time + 1e-9 * np.eye(len(TIME)))
    residual = sd * (low_lead @ white @ low_time.T)
    mean = np.exp(-((TIME / 20) ** 2)) * rng.normal(size=(12, 1))
    return Target(mean + residual, TIME, -30.0, 50.0, 60.0), of_leads, of_time, sd


def test_many_beats_give_the_known_covariance():
    target, of_leads, of_time, sd = known(np.random.default_rng(0), 400)
    found = residual_covariance(target)
    window = target.qrs_samples
    assert np.abs(found.leads - of_leads).max() < 0.06
    assert np.abs(found.time - of_time[window, window]).max() < 0.08
    assert found.sd == pytest.approx(sd[:, window], rel=0.2)
    assert found.shrinkage_leads < 0.02
    assert found.shrinkage_time < 0.05


def test_two_beats_show_nothing_of_correlations():
    target, *_ = known(np.random.default_rng(3), 2)
    found = residual_covariance(target)
    assert (found.shrinkage_leads, found.shrinkage_time) == (1, 1)
    assert np.array_equal(found.time, np.eye(81))
    assert np.array_equal(found.leads, np.eye(12))


def test_beats_without_spread():
    target, *_ = known(np.random.default_rng(3), 4)
    same = Target(np.tile(target.mean, (4, 1, 1)), TIME, -30.0, 50.0, 60.0)
    found = residual_covariance(same)
    assert np.array_equal(found.time, np.eye(81))
    assert np.abs(full(found)).max() < 1e-12


@pytest.mark.parametrize("beats", [3, 5, 8])
def test_few_beats_are_shrunk_and_stay_positive(beats):
    rng = np.random.default_rng(beats)
    target, *_ = known(rng, beats)
    found = residual_covariance(target)
    for factor in (found.leads, found.time):
        assert np.linalg.eigvalsh(factor).min() > 0
        assert np.diag(factor) == pytest.approx(1)
    assert found.shrinkage_time > residual_covariance(known(rng, 100)[0]).shrinkage_time


def test_shrinking_brings_the_estimate_closer():
    """Averaged over draws of eight beats, the shrunk correlation in time errs less than the raw."""
    shrunk, raw = [], []
    for seed in range(8):
        target, _, of_time, _ = known(np.random.default_rng(seed), 8)
        window = target.qrs_samples
        found, true = residual_covariance(target), of_time[window, window]
        shrunk.append(((found.time - true) ** 2).sum())
        weight = found.shrinkage_time
        unshrunk = (found.time - weight * np.eye(len(true))) / (1 - weight)
        raw.append(((unshrunk - true) ** 2).sum())
    assert np.mean(shrunk) < np.mean(raw)


def test_full_covariance_multiplies_the_factors():
    target, *_ = known(np.random.default_rng(1), 30)
    found = residual_covariance(target)
    whole = full(found)
    assert whole.shape == (12, 81, 12, 81)
    assert whole[3, 10, 7, 20] == pytest.approx(
        found.sd[3, 10] * found.sd[7, 20] * found.leads[3, 7] * found.time[10, 20]
    )
    variance = np.einsum("ltlt->lt", whole)
    assert np.sqrt(variance) == pytest.approx(target.standard_deviation[:, target.qrs_samples])


def test_unused_leads_have_none():
    target, *_ = known(np.random.default_rng(2), 10)
    beats = target.beats.copy()
    beats[:, 8] = np.nan
    found = residual_covariance(Target(beats, TIME, -30.0, 50.0, 60.0))
    assert np.isnan(found.leads[8]).all()
    assert np.isnan(found.leads[:, 8]).all()
    assert np.isfinite(np.delete(np.delete(found.leads, 8, 0), 8, 1)).all()
    assert np.isfinite(found.time).all()


def test_stated_noise_is_white():
    beat = np.zeros((1, 12, len(TIME)))
    found = residual_covariance(Target(beat, TIME, -30.0, 50.0, float("nan"), noise=0.04))
    assert found.leads == pytest.approx(np.eye(12))
    assert found.time == pytest.approx(np.eye(81))
    assert (found.sd == 0.04).all()
