"""The number of threads changes no bit."""

import numpy as np
import torch

from fascicle.inference.surrogate.exponential import ExponentialGP, Hyperparameters
from fascicle.inference.surrogate.threads import in_chunks, one_thread


def test_predictions_do_not_depend_on_the_threads():
    rng = np.random.default_rng(0)
    points, targets = rng.random((70, 3)), rng.random((7777, 3))
    gp = ExponentialGP.condition(points, points.sum(1), Hyperparameters((1.0,) * 3, 1.0, 1e-3))
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            answers = (*gp.predict(targets), *gp.mean_many(targets))
            results.append([answer.tobytes() for answer in answers])
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert results[0] == results[1] == results[2]


def test_chunks_cover_everything_once():
    seen = np.zeros(1003)

    def work(part):
        assert torch.get_num_threads() == 1
        assert not torch.is_grad_enabled()
        seen[part] += 1

    in_chunks(work, 1003, 100)
    assert (seen == 1).all()


def test_no_points_give_no_predictions():
    points = np.random.default_rng(0).random((20, 3))
    gp = ExponentialGP.condition(points, points.sum(1), Hyperparameters((1.0,) * 3, 1.0, 1e-3))
    assert [len(answer) for answer in gp.predict(np.empty((0, 3)))] == [0, 0]
    assert [len(answer) for answer in gp.mean_many(np.empty((0, 3)))] == [0, 0]


def test_one_thread_is_undone():
    before = torch.get_num_threads()
    with one_thread():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
