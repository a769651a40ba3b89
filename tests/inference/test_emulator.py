"""Small neural networks: what they learn, from gradients that are differences', reproducibly."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fascicle.inference.emulator import NeuralNetwork, _forward, _gradients, train

NOISE = 0.3


def smooth(inputs):
    a, b, c = inputs.T
    return np.column_stack([np.sin(2 * a) + b * c, a * b]).astype(np.float32)


def examples(count, seed=0):
    return np.random.default_rng(seed).uniform(-1.7, 1.7, (count, 3)).astype(np.float32)


def test_a_smooth_function_is_learnt_through_noise():
    """Better than its examples by far, so that what is left of others is their noise."""
    inputs, rng = examples(3000), np.random.default_rng(1)
    noisy = smooth(inputs) + NOISE * rng.standard_normal((3000, 2)).astype(np.float32)
    seen = []
    found = train(inputs, noisy, rng, width=32, blocks=2, steps=1000, progress=seen.append)
    others = examples(1000, 2)
    error = found(others) - smooth(others)
    assert np.sqrt((error**2).mean()) < 0.3 * NOISE
    assert seen == [*range(50, 1001, 50)]


def test_gradients_are_slopes():
    rng = np.random.default_rng(0)
    shapes = [(3, 5), (5,), (5, 5), (5,), (5, 5), (5,), (5, 2), (2,)]
    weights = tuple(rng.standard_normal(shape) for shape in shapes)  # in double precision
    inputs, wanted = rng.standard_normal((7, 3)), rng.standard_normal((7, 2))

    def loss(changed):
        return 0.5 * ((NeuralNetwork(changed)(inputs) - wanted) ** 2).sum()

    found = _gradients(
        weights, [*_forward(weights, inputs)], NeuralNetwork(weights)(inputs) - wanted
    )
    for k, weight in enumerate(weights):
        step = np.zeros_like(weight)
        step.flat[:] = 1e-6 * rng.standard_normal(weight.size)
        moved = [(*weights[:k], weight + sign * step, *weights[k + 1 :]) for sign in (1, -1)]
        difference = (loss(moved[0]) - loss(moved[1])) / 2
        assert (found[k] * step).sum() == pytest.approx(difference, rel=1e-5, abs=1e-12)


def test_the_same_seed_gives_the_same_bits():
    inputs = examples(300)
    first, again, other = (
        train(inputs, smooth(inputs), np.random.default_rng(seed), width=16, blocks=1, steps=30)
        for seed in (3, 3, 4)
    )
    for one, two in zip(first.weights, again.weights, strict=True):
        assert_allclose(one, two, rtol=0, atol=0)
    assert not np.array_equal(first.weights[0], other.weights[0])
