"""Nodes leave the queue in the order of their buckets, wherever the buckets lie in the ring."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.forward.eikonal.activation import empty_queue
from fascicle.kernels.queue import PER_MS, RING, WAITS_NOT, lower, take

LAP = RING / PER_MS  # ms
TIMES = {
    "within a lap": np.linspace(0.0, 0.9 * LAP, 200),
    "before zero": np.linspace(-0.5 * LAP, 0.4 * LAP, 200),
    "laps apart": np.linspace(0.0, 40 * LAP, 200),
    "far away": np.array([3.0, 1e7, 5e7]),
}


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES)
def test_the_earliest_leaves_first(times):
    shuffled = np.random.default_rng(0).permutation(times)
    queue, size = empty_queue(len(times)), 0
    for node in range(len(times)):
        size = lower(node, shuffled, queue, size)
    assert size == len(times)
    taken = [take(queue) for _ in times]
    np.testing.assert_array_equal(shuffled[taken], times)
    assert (queue.bucket == WAITS_NOT).all()


def test_a_node_that_is_lowered_moves():
    time, queue, size = np.array([5.0, 6.0, 7.0]), empty_queue(3), 0
    for node in range(3):
        size = lower(node, time, queue, size)
    time[2] = 1.0
    size = lower(2, time, queue, size)
    assert size == 3
    assert take(queue) == 2
    time[1] = 0.0  # earlier than what was taken
    lower(1, time, queue, 2)
    assert [take(queue), take(queue)] == [1, 0]
