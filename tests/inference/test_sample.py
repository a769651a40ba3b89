"""Acceptance, on a loss whose acceptance region is known."""

import numpy as np
import pytest

from fascicle.inference.abc.distance import ErrorDensity, total_variation
from fascicle.inference.abc.rejection import Rules, sample
from fascicle.inference.evaluation import Evaluation

BEATS = np.array([-0.9, -0.4, 0.0, 0.3, 1.0])
CENTRE = np.array([0.4, 0.6])


def evaluate(point):
    """Quadratic loss; every beat has the same error profile, shifted by the loss."""
    point = np.asarray(point, dtype=float)
    if point[0] > 0.9:
        return Evaluation(point, np.nan, np.empty(0), "left the endocardium")
    loss = 10 + 100 * float(((point - CENTRE) ** 2).sum())
    return Evaluation(point, loss, loss + BEATS)


def objective(points):
    return [evaluate(point) for point in points]


def acceptance_radius():
    """Where the distance reaches 0.9, by bisection on the shift of the errors."""
    low, high = 0.0, 20.0
    best = ErrorDensity.fit(10 + BEATS)
    for _ in range(60):
        middle = 0.5 * (low + high)
        shifted = ErrorDensity.fit(10 + middle + BEATS)
        low, high = (middle, high) if total_variation(shifted, best) < 0.9 else (low, middle)
    return np.sqrt(low / 100)


def uniform(number, evaluations):
    return np.random.default_rng([5, number]).random((400, 2))


@pytest.mark.parametrize("batch", [1, 7])
def test_accepted_set_is_the_known_disc(batch):
    rules = Rules(samples=20, patience=200, batch=batch)
    result = sample([evaluate(CENTRE)], uniform, objective, rules)
    radius = acceptance_radius()
    assert 0.1 < radius < 0.3
    tried = uniform(0, [])
    inside = tried[np.hypot(*(tried - CENTRE).T) < radius][:20]
    np.testing.assert_array_equal([e.point for e in result.accepted], inside)
    assert result.rounds == 1
    assert (result.distances < 0.9).all()
    last = int(np.flatnonzero((tried == inside[-1]).all(1))[0])
    assert result.evaluated == batch * int(np.ceil((last + 1) / batch))


def test_patience_ends_a_round_and_rounds_end_the_sampling():
    far = np.full((400, 2), 0.01)
    asked = []

    def propose(number, evaluations):
        asked.append((number, len(evaluations)))
        return far

    result = sample([evaluate(CENTRE)], propose, objective, Rules(patience=10, rounds=3))
    assert asked == [(0, 1), (1, 11), (2, 21)]
    assert (result.rounds, result.evaluated, len(result.accepted)) == (3, 30, 0)


def test_rounds_without_candidates_end():
    nothing = np.empty((0, 2))
    result = sample([evaluate(CENTRE)], lambda *_: nothing, objective, Rules(rounds=4))
    assert (result.rounds, result.evaluated) == (4, 0)


def test_infeasible_candidates_are_rejected():
    outside = np.array([[0.95, 0.6]] * 5)
    result = sample([evaluate(CENTRE)], lambda *_: outside, objective, Rules(rounds=1))
    assert (result.evaluated, len(result.accepted)) == (5, 0)


def test_a_better_candidate_becomes_the_reference():
    start = evaluate([0.8, 0.1])
    near_start, near_best = np.array([0.79, 0.11]), CENTRE + 0.01
    candidates = np.array([near_start, CENTRE, near_best, near_start])
    result = sample(
        [start], lambda number, _: candidates[2 * number :], objective, Rules(samples=2, rounds=2)
    )
    assert (result.reference.point == CENTRE).all()
    np.testing.assert_array_equal([e.point for e in result.accepted], [CENTRE, near_best])
    assert result.distances[0] == 0.0
    assert result.rounds == 2
