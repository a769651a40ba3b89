"""A queue of nodes in buckets of time, of which the earliest gives the next node.

Who is taken too early is taken again, so that exact order is not asked for; and a node is entered,
moved and taken at a cost that does not grow with the queue. Buckets form a ring: one list holds the
nodes of one bucket of every lap.
"""

import numpy as np

from fascicle.kernels.jit import kernel

PER_MS = 20.0  # buckets; an element's delay is longer than one, but on the finest meshes
RING = 4096  # buckets in a lap, a power of 2: nearly all times that wait lie within 200 ms
LAST = 2_000_000_000.0  # bucket that holds all later times, too; and the first likewise

# Instead of the bucket of a node that is not in the queue: of one that nothing is to be done with,
# and of one whose turn in a batch of taken ones is to come
WAITS_NOT, IN_BATCH = np.iinfo(np.int32).min, np.iinfo(np.int32).min + 1


@kernel(inline="always")
def _unlink(node, queue):
    """Take a node out of its list."""
    before, after = queue.before[node], queue.after[node]
    if before >= 0:
        queue.after[before] = after
    else:
        queue.head[queue.bucket[node] & (RING - 1)] = after
    if after >= 0:
        queue.before[after] = before


@kernel()
def lower(node, time, queue, size):
    """Enter a node, or move it after its time was lowered; returns the queue's size.

    Parameters
    ----------
    node : int
        The node.
    time : (n,) array
        Time of each node (ms).
    queue : Queue
        See `fascicle.kernels.arrays`.
    size : int
        How many nodes are in the queue.
    """
    bucket = int(min(max(time[node] * PER_MS, -LAST), LAST))
    known = queue.bucket[node]
    if known == bucket:
        return size
    if known > IN_BATCH:
        _unlink(node, queue)
        size -= 1
    first = queue.head[bucket & (RING - 1)]
    queue.before[node], queue.after[node], queue.bucket[node] = -1, first, bucket
    if first >= 0:
        queue.before[first] = node
    queue.head[bucket & (RING - 1)] = node
    queue.now[0] = min(queue.now[0], bucket)
    return size + 1


@kernel()
def _earliest(queue):
    """Find the earliest bucket that holds a node, of whatever lap."""
    earliest = int(LAST)
    for k in range(RING):
        node = queue.head[k]
        while node >= 0:
            earliest = min(earliest, queue.bucket[node])
            node = queue.after[node]
    return earliest


@kernel()
def take(queue):
    """Take a node of the earliest bucket out of a queue that holds one; returns the node."""
    now, passed = queue.now[0], 0
    while True:
        node = queue.head[now & (RING - 1)]
        while node >= 0 and queue.bucket[node] != now:
            node = queue.after[node]
        if node >= 0:
            break
        now, passed = now + 1, passed + 1
        if passed == RING:
            now, passed = _earliest(queue), 0
    _unlink(node, queue)
    queue.bucket[node], queue.now[0] = WAITS_NOT, now
    return node
