"""How many threads the linear algebra uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep PyTorch to one thread within the block.

    The matrices of a fit are small: with two threads it takes two to five times as long as with
    one. And sums are then always taken in the same order, so the result has the same bits
    whatever the number of cores.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_chunks(work: Callable[[slice], None], count: int, size: int) -> None:
    """Call `work` on consecutive slices of `size` out of `count`, on all of PyTorch's threads.

    Each slice is worked on by one thread from beginning to end, without gradients. That gives the
    same bits whatever the number of threads, and no thread waits for another at every operation,
    which on a busy machine costs far more than the work.
    """
    slices = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    workers = max(1, min(torch.get_num_threads(), len(slices)))

    def share(first: int) -> None:
        torch.set_num_threads(1)  # a property of the calling thread
        with torch.no_grad():
            for part in slices[first::workers]:
                work(part)

    with one_thread():
        if workers == 1:
            share(0)
            return
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(share, range(workers)))
