"""The number of threads changes no bit."""

import numpy as np
from threadpoolctl import threadpool_limits

from fascicle.core.threads import blas_threads, in_chunks, one_thread
from fascicle.inference.gaussian_process import ExponentialGP, Hyperparameters
from fascicle.inference.optimisation import Surrogates, step
from fascicle.inference.surrogates import Observations


def with_threads(answers):
    """Bytes of each answer with one, two and three threads of BLAS."""
    results = []
    for threads in (1, 2, 3):
        with threadpool_limits(threads, user_api="blas"):
            results.append([answer.tobytes() for answer in answers()])
            assert blas_threads() == threads  # as it was before
    return results


def test_predictions_do_not_depend_on_the_threads():
    rng = np.random.default_rng(0)
    points, targets = rng.random((70, 3)), rng.random((7777, 3))
    gp = ExponentialGP.condition(points, points.sum(1), Hyperparameters((1.0,) * 3, 1.0, 1e-3))
    one, two, three = with_threads(lambda: (*gp.predict(targets), *gp.mean_many(targets)))
    assert one == two == three


def test_proposals_do_not_depend_on_the_threads():
    """With so many points that BLAS and LAPACK would share out the work."""
    points = np.random.default_rng(0).random((300, 4))
    losses = np.where(points[:, 0] > 0.8, np.nan, ((points - 0.4) ** 2).sum(1))

    def proposed():
        known = Observations(points, losses)
        surrogates = Surrogates.learn(known.first(290)).updated(known, 100)
        new = step(np.random.default_rng(1), surrogates)
        hyperparameters = surrogates.loss.gp.hyperparameters, surrogates.feasibility.hyperparameters
        return new, surrogates.loss.gp.alpha, *(h.to_logarithms() for h in hyperparameters)

    one, two, three = with_threads(proposed)
    assert one == two == three


def test_chunks_cover_everything_once_on_one_thread():
    seen = np.zeros(1003)

    def work(part):
        assert blas_threads() == 1
        seen[part] += 1

    with threadpool_limits(2, user_api="blas"):
        in_chunks(work, 1003, 100)
    assert (seen == 1).all()
    with threadpool_limits(2, user_api="blas"):
        assert one_thread(blas_threads)() == 1
        assert blas_threads() == 2


def test_no_points_give_no_predictions():
    points = np.random.default_rng(0).random((20, 3))
    gp = ExponentialGP.condition(points, points.sum(1), Hyperparameters((1.0,) * 3, 1.0, 1e-3))
    assert [len(answer) for answer in gp.predict(np.empty((0, 3)))] == [0, 0]
    assert [len(answer) for answer in gp.mean_many(np.empty((0, 3)))] == [0, 0]
