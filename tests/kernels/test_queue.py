"""Nodes leave the queue in the order of their buckets, wherever the buckets lie in the ring."""

import numpy as np
import pytest

from fascicle.kernels.arrays import STATE, Queue
from fascicle.kernels.coupled import LAST, Bucket, lower, take

TIMES = {  # ms; a lap of 256 buckets is 12.8
    "within a lap": np.linspace(0.0, 11.5, 200),
    "before zero": np.linspace(-6.4, 5.1, 200),
    "laps apart": np.linspace(0.0, 512.0, 200),
    "far away": np.array([3.0, 1e7, 5e7]),
}


def queued(times):
    """Nodes, and the queue and its size after they were entered."""
    nodes = np.zeros(len(times), STATE)
    nodes["time"], nodes["bucket"] = np.inf, Bucket.NOT_QUEUED
    queue, size = Queue(np.full(256, -1, np.int32), np.array([LAST], np.int64)), 0
    for node, time in enumerate(times):
        size = lower(node, time, -1, nodes, queue, size)
    return nodes, queue, size


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES)
def test_the_earliest_leaves_first(times):
    shuffled = np.random.default_rng(0).permutation(times)
    nodes, queue, size = queued(shuffled)
    assert size == len(times)
    taken = [take(nodes, queue) for _ in times]
    np.testing.assert_array_equal(shuffled[taken], times)
    np.testing.assert_array_equal(nodes["time"], shuffled)
    assert (nodes["bucket"] == Bucket.NOT_QUEUED).all()


def test_a_node_that_is_lowered_moves():
    nodes, queue, size = queued([5.0, 6.0, 7.0])
    size = lower(2, 1.0, -1, nodes, queue, size)
    assert size == 3
    assert take(nodes, queue) == 2
    lower(1, 0.0, -1, nodes, queue, 2)  # earlier than what was taken
    assert [take(nodes, queue), take(nodes, queue)] == [1, 0]
