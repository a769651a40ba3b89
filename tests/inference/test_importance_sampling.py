"""Importance sampling: evidence and moments that are known, and what two runs agree on."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.inference.importance_sampling import (
    BATCH,
    TRUSTED,
    agreement,
    importance_sample,
    sampling,
)

CENTRE, SD = np.array([0.4, 0.6, 0.5]), np.array([0.05, 0.1, 0.03])
SIZES = {"effective": 300, "most": 10_000}


def log_likelihoods(points):
    """A normal density in a cube of which a corner is impossible."""
    exponent = -0.5 * (((points - CENTRE) / SD) ** 2).sum(axis=1)
    normal = exponent - np.log(SD * np.sqrt(2 * np.pi)).sum()
    return np.where(points.sum(axis=1) > 2.5, -np.inf, normal)


def sample(seed, likelihoods=log_likelihoods, dimension=3, **sizes):
    rng = np.random.default_rng(seed)
    prior = rng.random((500, dimension))
    return importance_sample(likelihoods, sampling(rng, prior, **SIZES | sizes))[0]


@pytest.fixture(scope="module")
def run():
    return sample(1)


def test_evidence_and_moments_of_a_normal_density(run):
    assert run.complete
    assert run.state.log_evidence == pytest.approx(0, abs=0.2)  # it lies within the cube
    assert run.state.effective >= 300
    mean = run.weights @ run.points
    sd = np.sqrt(run.weights @ (run.points - mean) ** 2)
    assert mean == pytest.approx(CENTRE, abs=4 * SD.max() / np.sqrt(300))
    assert sd == pytest.approx(SD, rel=0.2)
    assert run.log_likelihoods == pytest.approx(log_likelihoods(run.points))


def test_draws_follow_the_weights(run):
    drawn = run.points[run.draw(np.random.default_rng(0), 2000)]
    assert drawn.mean(axis=0) == pytest.approx(run.weights @ run.points, abs=0.01)
    assert not (drawn.sum(axis=1) > 2.5).any()


def test_the_same_seed_gives_the_same_bits_and_progress_is_reported(run):
    seen = []
    again = sample(1, progress=seen.append)
    assert again.points.tobytes() == run.points.tobytes()
    assert again.weights.tobytes() == run.weights.tobytes()
    assert [state.evaluations for state in seen] == sorted(state.evaluations for state in seen)
    assert seen[-1] == run.state


def test_two_modes_keep_their_shares():
    """One holds a quarter of the posterior, and lies where the first proposal does not."""

    def likelihoods(points):
        each = [np.exp(-0.5 * (((points - c) / 0.04) ** 2).sum(axis=1)) for c in (0.25, 0.75)]
        return np.log(each[0] + 3 * each[1] + 1e-300)

    run = sample(3, likelihoods, 2, effective=1000)
    assert run.weights @ (run.points[:, 0] > 0.5) == pytest.approx(0.75, abs=0.06)


def test_rough_likelihoods_are_distrusted():
    """Every point has a likelihood that its neighbours say nothing of."""

    def spikes(points):
        noise = np.modf(np.abs(np.sin(points @ [12.9898e4, 78.233e4, 37.719e4])) * 43758.5453)[0]
        return -2 * np.log(noise + 1e-12)

    run = sample(4, spikes, most=2000)
    assert run.state.tail > TRUSTED
    assert not run.complete


def test_too_few_evaluations_are_no_complete_run():
    short = sample(1, most=300)
    assert not short.complete
    assert short.state.evaluations == 300
    assert sample(1, effective=10).state.evaluations == 2 * BATCH  # the proposals are tested first


def test_runs_of_one_density_agree(run):
    other = sample(2)
    found = agreement(run, other)
    assert found.converged
    assert found.log_evidence < 0.3
    assert (found.means < 0.3).all()


def test_runs_that_differ_do_not(run):
    moved = replace(run, points=run.points + np.array([0, 0.08, 0]))
    assert agreement(run, moved).means == pytest.approx([0, 0.74, 0], abs=0.1)
    assert not agreement(run, moved).converged
    assert not agreement(run, replace(run, complete=False)).converged
    less = replace(run, state=replace(run.state, log_evidence=run.state.log_evidence - 2))
    assert not agreement(run, less).converged
