"""A queue of nodes in buckets of time, of which the earliest gives the next node.

A node that is taken too early is taken again, so exact order is not needed; and a node is entered,
moved and taken at a cost that does not grow with the queue. Buckets form a ring: one list holds the
nodes of one bucket of every lap.
"""

import numpy as np

from fascicle.kernels.jit import kernel

PER_MS = 20.0  # buckets; an element's delay is longer than one, but on the finest meshes
RING = 4096  # buckets in a lap, a power of 2: nearly all times that wait lie within 200 ms
LAST = 2_000_000_000.0  # bucket of all later times, too; −LAST likewise of earlier ones

# Bucket of a node that is not in the queue: nothing is to be done with it, or its turn in a batch
# of taken ones is to come
NOT_QUEUED, IN_BATCH = np.iinfo(np.int32).min, np.iinfo(np.int32).min + 1


@kernel(inline="always")
def _unlink(node, nodes, queue):
    before, after = nodes[node].before, nodes[node].after
    if before >= 0:
        nodes[before].after = after
    else:
        queue.head[nodes[node].bucket & (RING - 1)] = after
    if after >= 0:
        nodes[after].before = before


@kernel()
def lower(node, nodes, queue, size):
    """Enter a node, or move it after its time was lowered, into a queue of `size` nodes.

    `nodes` is an array of STATE, and the `Queue` is one of `fascicle.kernels.arrays`. Returns the
    queue's size.
    """
    state = nodes[node]
    bucket = int(min(max(state.time * PER_MS, -LAST), LAST))
    previous = state.bucket
    if previous == bucket:
        return size
    if previous > IN_BATCH:
        _unlink(node, nodes, queue)
        size -= 1
    first = queue.head[bucket & (RING - 1)]
    state.before, state.after, state.bucket = -1, first, bucket
    if first >= 0:
        nodes[first].before = node
    queue.head[bucket & (RING - 1)] = node
    queue.now[0] = min(queue.now[0], bucket)
    return size + 1


@kernel()
def _earliest(nodes, queue):
    """Find the earliest bucket that holds a node, of whatever lap."""
    earliest = int(LAST)
    for k in range(RING):
        node = queue.head[k]
        while node >= 0:
            earliest = min(earliest, nodes[node].bucket)
            node = nodes[node].after
    return earliest


@kernel()
def take(nodes, queue):
    """Take a node of the earliest bucket out of a queue that holds one; returns the node."""
    now, passed = queue.now[0], 0
    while True:
        node = queue.head[now & (RING - 1)]
        while node >= 0 and nodes[node].bucket != now:
            node = nodes[node].after
        if node >= 0:
            break
        now, passed = now + 1, passed + 1
        if passed == RING:
            now, passed = _earliest(nodes, queue), 0
    _unlink(node, nodes, queue)
    nodes[node].bucket, queue.now[0] = NOT_QUEUED, now
    return node
