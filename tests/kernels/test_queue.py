"""Nodes leave the queue in the order of their buckets, wherever the buckets lie in the ring."""

import numpy as np
import pytest

from fascicle.forward.eikonal.activation import empty_queue
from fascicle.kernels.arrays import STATE
from fascicle.kernels.queue import NOT_QUEUED, PER_MS, RING, lower, take

LAP = RING / PER_MS  # ms
TIMES = {
    "within a lap": np.linspace(0.0, 0.9 * LAP, 200),
    "before zero": np.linspace(-0.5 * LAP, 0.4 * LAP, 200),
    "laps apart": np.linspace(0.0, 40 * LAP, 200),
    "far away": np.array([3.0, 1e7, 5e7]),
}


def nodes_with(times):
    """Nodes that are not in the queue yet."""
    nodes = np.zeros(len(times), STATE)
    nodes["time"], nodes["bucket"] = times, NOT_QUEUED
    return nodes


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES)
def test_the_earliest_leaves_first(times):
    shuffled = np.random.default_rng(0).permutation(times)
    nodes, queue, size = nodes_with(shuffled), empty_queue(), 0
    for node in range(len(times)):
        size = lower(node, nodes, queue, size)
    assert size == len(times)
    taken = [take(nodes, queue) for _ in times]
    np.testing.assert_array_equal(shuffled[taken], times)
    assert (nodes["bucket"] == NOT_QUEUED).all()


def test_a_node_that_is_lowered_moves():
    nodes, queue, size = nodes_with([5.0, 6.0, 7.0]), empty_queue(), 0
    for node in range(3):
        size = lower(node, nodes, queue, size)
    nodes[2]["time"] = 1.0
    size = lower(2, nodes, queue, size)
    assert size == 3
    assert take(nodes, queue) == 2
    nodes[1]["time"] = 0.0  # earlier than what was taken
    lower(1, nodes, queue, 2)
    assert [take(nodes, queue), take(nodes, queue)] == [1, 0]
