"""Acceptance, on a loss whose acceptance region is known."""

import numpy as np
import pytest

from fascicle.inference.abc import ErrorDensity, sample, total_variation
from fascicle.inference.evaluation import Evaluation

BEATS = np.array([-0.9, -0.4, 0.0, 0.3, 1.0])
CENTRE = np.array([0.4, 0.6])


def evaluate(point):
    """Quadratic loss; every beat has the same error profile, shifted by the loss."""
    point = np.asarray(point, dtype=float)
    if point[0] > 0.9:
        return Evaluation.infeasible(point, "left the endocardium")
    loss = 10 + 100 * float(((point - CENTRE) ** 2).sum())
    return Evaluation(point, loss, loss + BEATS)


class Objective:
    """Evaluates, and keeps count."""

    def __init__(self):
        self.evaluated = 0

    def __call__(self, points):
        self.evaluated += len(points)
        return [evaluate(point) for point in points]


@pytest.fixture
def objective():
    return Objective()


def acceptance_radius():
    """Where the distance reaches 0.9, by bisection on the shift of the errors."""
    low, high = 0.0, 20.0
    best = ErrorDensity.fit(10 + BEATS)
    for _ in range(60):
        middle = 0.5 * (low + high)
        shifted = ErrorDensity.fit(10 + middle + BEATS)
        low, high = (middle, high) if total_variation(shifted, best) < 0.9 else (low, middle)
    return np.sqrt(low / 100)


def uniform(number):
    return np.random.default_rng([5, number]).random((400, 2))


@pytest.mark.parametrize("workers", [1, 7])
def test_accepted_set_is_the_known_disc(objective, workers):
    settings = {"samples": 20, "refit_after": 200, "workers": workers}
    seen = []
    result = sample(
        evaluate(CENTRE), uniform, objective, **settings, progress=lambda *news: seen.append(news)
    )
    radius = acceptance_radius()
    assert 0.1 < radius < 0.3
    tried = uniform(0)
    inside = tried[np.hypot(*(tried - CENTRE).T) < radius][:20]
    np.testing.assert_array_equal([e.point for e in result.evaluations], inside)
    assert (result.distances < 0.9).all()
    last = int(np.flatnonzero((tried == inside[-1]).all(1))[0])
    assert objective.evaluated == workers * int(np.ceil((last + 1) / workers))
    assert seen[-1] == (20, objective.evaluated, 1)


@pytest.mark.parametrize(
    ("candidates", "asked"),
    [
        (np.full((400, 2), 0.01), [(0, 0), (1, 10), (2, 20)]),  # all too far
        (np.empty((0, 2)), [(0, 0), (1, 0), (2, 0)]),
        (np.array([[0.95, 0.6]] * 5), [(0, 0), (1, 5), (2, 10)]),  # no tree
    ],
)
def test_rejections_end_a_round_and_rounds_end_the_sampling(objective, candidates, asked):
    seen = []

    def propose(number):
        seen.append((number, objective.evaluated))
        return candidates

    result = sample(evaluate(CENTRE), propose, objective, refit_after=10, rounds=3)
    assert seen == asked
    assert (objective.evaluated, len(result.evaluations)) == (3 * asked[1][1], 0)


def test_a_better_candidate_is_rejected_like_any_other(objective):
    start = evaluate([0.8, 0.1])
    near_start = np.array([0.79, 0.11])
    candidates = np.array([CENTRE, near_start])
    result = sample(start, lambda _: candidates, objective, samples=2, rounds=1)
    assert (result.reference.point == start.point).all()
    np.testing.assert_array_equal([e.point for e in result.evaluations], [near_start])
    assert objective.evaluated == 2
