"""A binary heap of node numbers, ordered by time, in which a node's time can be lowered."""

from fascicle.kernels.jit import kernel


@kernel()
def lower(node, time, queue, size):
    """Enter a node, or move it up after its time was lowered; returns the heap's size.

    Parameters
    ----------
    node : int
        The node.
    time : (n,) array
        Time of each node (ms).
    queue : Queue
        See `fascicle.kernels.arrays`.
    size : int
        How many nodes are in the heap.
    """
    heap, place = queue
    i = place[node]
    if i < 0:
        i = size
        size += 1
    key = time[node]
    while i > 0:
        up = (i - 1) >> 1
        if time[heap[up]] <= key:
            break
        heap[i] = heap[up]
        place[heap[i]] = i
        i = up
    heap[i] = node
    place[node] = i
    return size


@kernel()
def pop(time, queue, size):
    """Take the earliest node out; returns it and the heap's size.

    Parameters
    ----------
    time, queue, size
        See `lower`.
    """
    heap, place = queue
    first = heap[0]
    place[first] = -1
    size -= 1
    if size == 0:
        return first, size
    node = heap[size]
    key = time[node]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and time[heap[child + 1]] < time[heap[child]]:
            child += 1
        if time[heap[child]] >= key:
            break
        heap[i] = heap[child]
        place[heap[i]] = i
        i = child
    heap[i] = node
    place[node] = i
    return first, size
