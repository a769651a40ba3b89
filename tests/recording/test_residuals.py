"""Residual covariance of targets whose covariance is known."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.recording.target import Target, repeated, residual_covariance

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


def test_two_beats_and_beats_without_spread_show_nothing_of_correlations():
    target, *_ = known(np.random.default_rng(3), 2)
    found = residual_covariance(target)
    assert (found.shrinkage_leads, found.shrinkage_time) == (1, 1)
    same = residual_covariance(replace(target, beats=np.tile(target.mean, (4, 1, 1))))
    for covariance in (found, same):
        assert np.array_equal(covariance.time, np.eye(81))
        assert np.array_equal(covariance.leads, np.eye(12))
    assert np.abs(full(same)).max() < 1e-12


@pytest.mark.parametrize("beats", [3, 8])
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


def test_unused_leads_have_none_and_stated_noise_is_white():
    target, *_ = known(np.random.default_rng(2), 10)
    beats = target.beats.copy()
    beats[:, 8] = np.nan
    found = residual_covariance(replace(target, beats=beats))
    absent = np.isnan(found.leads)
    assert absent[8].all()
    assert absent[:, 8].all()
    assert absent.sum() == 23
    assert np.isfinite(found.time).all()
    found = residual_covariance(replace(target, beats=target.beats[:1], noise=0.04))
    assert np.array_equal(found.leads, np.eye(12))
    assert np.array_equal(found.time, np.eye(81))
    assert (found.sd == 0.04).all()


def test_repetitions_of_a_single_beat():
    target, *_ = known(np.random.default_rng(2), 10)
    one = replace(target, beats=target.beats[:1], noise=0.04)
    again = repeated(one, np.random.default_rng(0))
    assert len(again.beats) == 10
    assert again.noise is None
    assert again.mean == pytest.approx(one.beats[0])
    assert again.standard_deviation.mean() == pytest.approx(0.04, rel=0.05)
