"""Where networks are evaluated: on threads of this process, or elsewhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import NoneType
from typing import Any, Protocol, Self, TypeVar

from fascicle.core.ranges import check_count, check_kind
from fascicle.core.threads import one_thread
from fascicle.forward.model import ForwardModel, WrittenModel

Item = TypeVar("Item")
Result = TypeVar("Result")

# How items become jobs: a scheduler passes some hundreds a second, and workers should end together
JOBS = 8  # a worker and call at most
FEWEST = 8  # items of each, if there are then enough jobs for all workers
CROWD = 128  # jobs that are enough, however many workers there are


class Task(Protocol):
    """What jobs are about: a forward model, which is large, and the rest, which is small."""

    @property
    def model(self) -> ForwardModel:
        """The forward model."""

    @property
    def bodies(self) -> Sequence[str]:
        """Quantities of the body that the model will be asked for."""

    def portable(self) -> Any:
        """The rest, which can be pickled."""

    def of(self, model: ForwardModel) -> Self:
        """The rest and a model put together again."""


class Pool(ABC):
    """Runs functions of a task and an item; lives as long as its study."""

    @abstractmethod
    def map(
        self, function: Callable[[Any, Item], Result], task: Task, items: Sequence[Item]
    ) -> Iterator[Result]:
        """Results in the order of the items, as soon as they are there.

        Parameters
        ----------
        function : callable
            Called with the task and an item; of a module or a partial of such, so that it can
            be sent.
        task : Task
            The same for all.
        items : sequence
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
        How many.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def map(
        self, function: Callable[[Any, Item], Result], task: Any, items: Sequence[Item]
    ) -> Iterator[Result]:
        """Give results in the order of the items; the task may be anything."""
        if self.workers == 1 or len(items) == 1:
            return map(partial(function, task), items)
        return self._executor.map(partial(function, task), items)

    @cached_property
    def _executor(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.workers)


class Remote(Pool):
    """Workers in other processes: the model goes to them once, jobs are several items each."""

    workers: int

    def __init__(self) -> None:
        self._models: list[tuple[ForwardModel, Any]] = []

    def map(
        self, function: Callable[[Any, Item], Result], task: Task, items: Sequence[Item]
    ) -> Iterator[Result]:
        """Give results in the order of the items."""
        given = self._model(task), self._rest(task.portable())
        futures = [self._submit(*given, function, part) for part in parts(items, self.workers)]
        return self._in_order(futures)

    def _model(self, task: Task) -> Any:
        """What jobs need to find the task's model, which is sent if it has not been."""
        for model, sent in self._models:
            if model is task.model:
                return sent
        sent = self._send(task)
        self._models.append((task.model, sent))
        return sent

    def _in_order(self, futures: list[Any]) -> Iterator[Any]:
        """Results of jobs; what is not begun when nobody waits any more is not begun."""
        futures.reverse()
        try:
            while futures:
                next_ones = [futures.pop()]
                while futures and futures[-1].done():
                    next_ones.append(futures.pop())
                for results in self._results(next_ones):
                    yield from results
        finally:
            self.cancel(futures)

    @abstractmethod
    def _send(self, task: Task) -> Any:
        """Send the task's model, and say what jobs need to find it."""

    @abstractmethod
    def _rest(self, portable: Any) -> Any:
        """What jobs need to find the rest of a task."""

    @abstractmethod
    def _submit(self, *job: Any) -> Any:
        """Send a job, of model, rest, function and items; its future."""

    def cancel(self, futures: Sequence[Any]) -> None:
        """Cancel jobs that have not begun."""
        for future in futures:
            future.cancel()

    @abstractmethod
    def _results(self, futures: Sequence[Any]) -> Sequence[Any]:
        """Wait for the first of some jobs, and fetch what all have given; the others have ended."""


class ExecutorPool(Remote):
    """Workers of any executor in other processes, which see this machine's temporary folder.

    The model goes to each once, through a file.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Whose workers.
    workers : int
        How many it has.
    """

    def __init__(self, executor: Executor, workers: int) -> None:
        super().__init__()
        check_kind(executor, Executor, "executor", "one of concurrent.futures, or a subclass")
        check_count(workers, "workers")
        self.executor, self.workers = executor, workers
        self._folder = TemporaryDirectory(prefix="fascicle-")

    def _send(self, task: Task) -> WrittenModel:
        folder = Path(self._folder.name) / f"{len(self._models)}"
        folder.mkdir()
        return task.model.write(folder, task.bodies)

    def _rest(self, portable: Any) -> Any:
        return portable

    def _submit(self, *job: Any) -> Future[list[Any]]:
        return self.executor.submit(_job, *job)

    def _results(self, futures: Sequence[Future[list[Any]]]) -> list[list[Any]]:
        return [future.result() for future in futures]


def parts(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Items in parts of nearly equal sizes, in order: a job each.

    Parts of unequal sizes would let workers wait for the last one.
    """
    jobs = max(min(len(items) // FEWEST, JOBS * workers), min(workers, CROWD))
    jobs = max(1, min(jobs, len(items)))
    ends = [number * len(items) // jobs for number in range(jobs + 1)]
    return [items[start:end] for start, end in pairwise(ends)]


def run_part(
    task: Task, function: Callable[[Any, Item], Result], items: Sequence[Item]
) -> list[Result]:
    """What a worker does: BLAS takes one thread, since there is a worker for every core."""
    results: list[Result] = one_thread(lambda: [function(task, item) for item in items])()
    return results


def _job(
    written: WrittenModel,
    rest: Task,
    function: Callable[[Any, Item], Result],
    items: Sequence[Item],
) -> list[Result]:
    return run_part(rest.of(written.read()), function, items)
