"""Nested sampling: evidence and moments that are known, and what two runs agree on."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.inference.nested.agreement import agreement
from fascicle.inference.nested.sampling import nested_sample

CENTRE, SD = np.array([0.4, 0.6, 0.5]), np.array([0.05, 0.1, 0.03])
SIZES = {"live": 100, "effective": 300, "most": 20_000}


def log_likelihoods(points):
    """A normal density in a cube of which a corner is impossible."""
    exponent = -0.5 * (((points - CENTRE) / SD) ** 2).sum(axis=1)
    normal = exponent - np.log(SD * np.sqrt(2 * np.pi)).sum()
    return np.where(points.sum(axis=1) > 2.5, -np.inf, normal)


@pytest.fixture(scope="module")
def run():
    return nested_sample(1, 3, log_likelihoods, **SIZES)


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


def test_the_same_seed_gives_the_same_bits(run):
    again = nested_sample(1, 3, log_likelihoods, **SIZES)
    assert again.points.tobytes() == run.points.tobytes()
    assert again.weights.tobytes() == run.weights.tobytes()


def test_progress_is_told(run):
    seen = []
    nested_sample(1, 3, log_likelihoods, **SIZES, progress=seen.append)
    assert [state.evaluations for state in seen] == sorted(state.evaluations for state in seen)
    assert seen[-1].log_evidence == pytest.approx(run.state.log_evidence, abs=0.2)


def test_too_few_evaluations_are_no_complete_run():
    short = nested_sample(1, 3, log_likelihoods, **SIZES | {"most": 300})
    assert not short.complete
    assert short.state.evaluations == 300


def test_runs_of_one_density_agree(run):
    other = nested_sample(2, 3, log_likelihoods, **SIZES)
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
