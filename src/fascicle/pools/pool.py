"""Pools that evaluate networks: threads of this process, or workers in other processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import NoneType
from typing import Any, TypeVar

from fascicle.core.ranges import check_count, check_kind
from fascicle.core.threads import SharedFile, one_thread, read_shared, write_shared

Item = TypeVar("Item")
Result = TypeVar("Result")


class Pool(ABC):
    """Runs a function on many items; lives as long as its study."""

    @abstractmethod
    def map(
        self, function: Callable[..., Result], items: Sequence[Item], *shared: Any
    ) -> Iterator[Result]:
        """Yield results in the order of the items, as soon as they are available.

        Parameters
        ----------
        function : callable
            Called with an item and the shared arguments; a module's function or a `partial` of one,
            so that it can be pickled.
        items : sequence
        *shared
            Arguments shared by all items, such as the forward model; sent to each worker once.
        """


def check_pool(pool: object) -> None:
    """Refuse what is neither None nor a pool, such as an executor by itself."""
    needed = "fascicle.ExecutorPool(executor, workers) or fascicle.Cluster(address)"
    check_kind(pool, (Pool, NoneType), "pool", needed)


class Threads(Pool):
    """Threads of this process: the forward model runs outside Python's global lock.

    Parameters
    ----------
    workers : int
        Number of threads.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def map(
        self, function: Callable[..., Result], items: Sequence[Item], *shared: Any
    ) -> Iterator[Result]:
        """Give results in the order of the items."""
        if self.workers == 1 or len(items) == 1:
            return (function(item, *shared) for item in items)
        return self._executor.map(lambda item: function(item, *shared), items)

    @cached_property
    def _executor(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.workers)


class Remote(Pool):
    """Workers in other processes; they get shared arguments once, and jobs of several items."""

    workers: int

    def __init__(self) -> None:
        self._sent: list[tuple[Any, Any]] = []

    def map(
        self, function: Callable[..., Result], items: Sequence[Item], *shared: Any
    ) -> Iterator[Result]:
        """Give results in the order of the items."""
        places = [self._place(content) for content in shared]
        jobs = [self._submit(function, part, *places) for part in parts(items, self.workers)]
        return self._in_order(jobs)

    def _place(self, content: Any) -> Any:
        """Return the place where workers find a shared argument, sending it if necessary."""
        for sent, place in self._sent:
            if sent is content:
                return place
        place = self._send(content)
        self._sent.append((content, place))
        return place

    def _in_order(self, futures: list[Any]) -> Iterator[Any]:
        """Yield results of jobs; jobs are cancelled when the results are no longer wanted."""
        futures.reverse()
        try:
            while futures:
                next_futures = [futures.pop()]
                while futures and futures[-1].done():
                    next_futures.append(futures.pop())
                for results in self._results(next_futures):
                    yield from results
        finally:
            self.cancel(futures)

    @abstractmethod
    def _send(self, content: Any) -> Any:
        """Send an object to all workers, and return where they find it."""

    @abstractmethod
    def _submit(self, function: Callable[..., Any], items: Sequence[Any], *places: Any) -> Any:
        """Submit a job, and return its future."""

    @abstractmethod
    def _results(self, futures: Sequence[Any]) -> Sequence[Any]:
        """Wait for the first of some jobs, the others having ended, and fetch all results."""

    def cancel(self, futures: Sequence[Any]) -> None:
        """Cancel jobs that have not begun."""
        for future in futures:
            future.cancel()


class ExecutorPool(Remote):
    """Workers of any executor in other processes, which see this machine's temporary folder.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Executor to use.
    workers : int
        Number of its workers.
    """

    def __init__(self, executor: Executor, workers: int) -> None:
        super().__init__()
        check_kind(executor, Executor, "executor", "one of concurrent.futures, or a subclass")
        check_count(workers, "workers")
        self.executor, self.workers = executor, workers
        self._folder = TemporaryDirectory(prefix="fascicle-")

    def _send(self, content: Any) -> SharedFile:
        return write_shared(Path(self._folder.name) / f"{len(self._sent)}", content)

    def _submit(
        self, function: Callable[..., Any], items: Sequence[Any], *places: SharedFile
    ) -> Future[list[Any]]:
        return self.executor.submit(_job, function, items, *places)

    def _results(self, futures: Sequence[Future[list[Any]]]) -> list[list[Any]]:
        return [future.result() for future in futures]


def parts(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Split items, in order, into parts of nearly equal sizes, one for each job.

    A scheduler passes some hundreds of jobs a second. Jobs therefore have at least 8 items, and
    there are at most 8 for each worker, unless some of up to 128 workers would then get none. Parts
    of unequal sizes would let workers wait for the last one.
    """
    jobs = max(min(len(items) // 8, 8 * workers), min(workers, 128))
    jobs = max(1, min(jobs, len(items)))
    ends = [number * len(items) // jobs for number in range(jobs + 1)]
    return [items[start:end] for start, end in pairwise(ends)]


def run_part(
    function: Callable[..., Result], items: Sequence[Any], shared: Sequence[Any]
) -> list[Result]:
    """Run a job in a worker, with one thread of BLAS, since every core has a worker."""
    results: list[Result] = one_thread(lambda: [function(item, *shared) for item in items])()
    return results


def _job(
    function: Callable[..., Result], items: Sequence[Any], *places: SharedFile
) -> list[Result]:
    return run_part(function, items, [read_shared(place) for place in places])
