"""Workers of a Dask cluster, which may die, join late and be restarted."""

from __future__ import annotations

import asyncio
import hashlib
import pickle
import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import suppress
from threading import Lock
from typing import Any, ClassVar

from distributed import Client, KilledWorker, Worker, WorkerPlugin, get_worker

from fascicle.core.errors import InputError, one_line
from fascicle.core.progress import Lines, Progress, progress_of
from fascicle.core.ranges import shown
from fascicle.core.threads import keep_one_thread
from fascicle.pools.pool import Remote, run_part

TIMEOUT = 30  # s, until a scheduler has answered


class WorkerData(WorkerPlugin):
    """Data that every worker receives pickled when it joins, and unpacks at the first use."""

    reading: ClassVar[Lock] = Lock()

    def __init__(self, name: str, content: bytes) -> None:
        self.name, self.content = name, content
        self.unpacked: list[Any] = []

    def setup(self, worker: Worker) -> None:
        """Keep BLAS to one thread from now on: jobs of several threads would set it back."""
        keep_one_thread()

    def read(self) -> Any:
        """Unpack the content, once for all threads."""
        with self.reading:
            if not self.unpacked:
                content = pickle.loads(self.content)  # noqa: S301 - as Dask does with jobs
                self.unpacked.append(content)
                self.content = b""
        return self.unpacked[0]


class Cluster(Remote):
    """Workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as ``"tcp://10.0.0.1:8786"``.
    progress : Progress, "lines" or None
        Progress callback, called with the stage "workers" while the cluster has no workers or does
        not answer; "lines" writes to standard error; None is silent.

    Raises
    ------
    InputError
        If the address is malformed, or no scheduler answers there.
    """

    answer_time: ClassVar[float] = 5  # s that a scheduler has to say which workers it has
    # of a job whose workers were lost, as happens to waiting jobs at a walltime
    retries: ClassVar[int] = 20

    def __init__(self, address: str, progress: Progress | Lines | None = "lines") -> None:
        if not isinstance(address, str) or not re.fullmatch(
            r"(tcp|tls)://[^/\s]+:\d{1,5}", address
        ):
            raise InputError(
                f"{shown(address)} is not an address of a Dask scheduler; it prints its own when "
                "it starts, such as tcp://10.0.0.1:8786"
            )
        self.progress = progress_of(progress)
        try:
            self.client: Any = Client(address, timeout=TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, TypeError, ValueError) as error:  # TypeError of TLS without configuration
            raise InputError(
                f"{address}: no Dask scheduler answers ({one_line(error)}); start one with "
                "'dask scheduler', and workers with 'dask worker ADDRESS'"
            ) from error
        super().__init__()
        self.address = address
        self._connection = self.client.scheduler_comm
        self._waits = False  # for a worker, or for the scheduler

    @property
    def workers(self) -> int:  # type: ignore[override]
        """Number of threads of the present workers, at least 1."""
        return max(1, sum(self.threads().values()))

    def threads(self) -> dict[str, int]:
        """Number of threads of each present worker, by its address."""
        threads: dict[str, int] = self._ask(self.client.nthreads)
        return threads

    def _place(self, content: Any) -> Any:
        if not self._same_scheduler:  # a restarted scheduler has lost the shared data
            self._connection = self.client.scheduler_comm
            self._sent.clear()
        return super()._place(content)

    def _send(self, content: Any) -> str:
        pickled = pickle.dumps(content)
        name = f"fascicle-{hashlib.sha256(pickled).hexdigest()[:24]}"
        self._ask(self.client.register_plugin, WorkerData(name, pickled))
        return name

    def _submit(self, function: Callable[..., Any], items: Sequence[Any], *places: str) -> Any:
        self._check_there()
        return self.client.submit(_job, function, items, *places, pure=False)

    def cancel(self, futures: Sequence[Any]) -> None:
        """Cancel jobs, unless losing the scheduler has done so."""
        with suppress(InputError):  # a silent scheduler is not waited for
            wait([self._begin(self.client.cancel, list(futures))], self.answer_time)

    def _results(self, futures: Sequence[Any]) -> Sequence[Any]:
        """Fetch results together, since each would take some milliseconds by itself."""
        first = self._result(futures[0])
        try:
            return [first, *(self._gather(futures[1:]) if len(futures) > 1 else ())]
        except KilledWorker:  # a finished job lost its result with its worker
            return [first, *map(self._result, futures[1:])]

    def _result(self, future: Any) -> Any:
        """Wait for a job; if its workers were lost, other workers run it again."""
        for _ in range(self.retries):
            try:
                return self._gather([future])[0]
            except KilledWorker:
                self._ask(self.client.retry, [future])
        return self._gather([future])[0]

    def _gather(self, futures: Sequence[Any]) -> list[Any]:
        results: list[Any] = self._ask(self.client.gather, list(futures), jobs=futures)
        return results

    def _ask(self, method: Callable[..., Any], *arguments: Any, jobs: Sequence[Any] = ()) -> Any:
        """Call a method of the client, again if a connection broke, as when a worker is lost.

        A job's own error is raised as it is.
        """
        for attempt in range(self.retries + 1):
            try:
                return self._wait_for(method, *arguments)
            except OSError as error:
                if any(job.status == "error" and job.exception() is error for job in jobs):
                    raise
                self._check_there(error)
                of_workers = error.errno is not None and not isinstance(error, ConnectionError)
                if of_workers or attempt == self.retries:
                    raise InputError(
                        f"{self.address}: its workers fail ({one_line(error)}); see what they say"
                    ) from error
                time.sleep(0.5)  # before a broken connection is tried again
            except CancelledError as error:
                if self._same_scheduler:
                    raise InputError(
                        f"{self.address}: jobs were cancelled there ({one_line(error)}); what is "
                        "evaluated is kept, and the same command goes on"
                    ) from error
                raise self._lost() from error  # by the client, when it lost its scheduler
        raise AssertionError("the last try returns or raises")

    def _wait_for(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Wait without a limit, since jobs may be long; report a missing worker or scheduler."""
        answer = self._begin(method, *arguments)
        try:
            while not wait([answer], 1.0).done:
                self._say(self._what_is_missing(answer))
            result = answer.result()
            self._say("")
            return result
        finally:
            answer.cancel()  # if it is interrupted

    def _begin(self, method: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Call a method of the client in its event loop, without waiting for the answer."""
        self._check_there()

        async def call() -> Any:
            return await method(*arguments)

        return asyncio.run_coroutine_threadsafe(call(), self.client.loop.asyncio_loop)

    def _what_is_missing(self, answer: Future[Any]) -> str:
        """Reason, in words, why an answer does not come; empty if it just takes long."""
        threads = self._begin(self.client.nthreads)
        try:
            wait([threads, answer], self.answer_time, FIRST_COMPLETED)
            if answer.done() or threads.result(timeout=0):
                return ""
            return "has no worker; waiting for one"
        except OSError as error:  # includes a timeout
            self._check_there(error)
            return "does not answer; waiting for it"
        finally:
            threads.cancel()

    def _say(self, missing: str) -> None:
        if self.progress is not None and (missing or self._waits):
            message = f"{self.address} {missing}" if missing else ""
            self.progress("workers", int(not missing), 1, message)
        self._waits = bool(missing)

    @property
    def _same_scheduler(self) -> bool:
        """True if the connection is the one through which shared data were sent."""
        running: bool = self.client.status == "running"
        return running and self.client.scheduler_comm is self._connection

    def _check_there(self, error: OSError | None = None) -> None:
        """Raise an error of one line if the scheduler is lost."""
        if self.client.status != "running":
            raise self._lost() from error

    def _lost(self) -> InputError:
        return InputError(
            f"{self.address}: the Dask scheduler was lost; what is evaluated is kept: start it "
            "again, and the same command goes on"
        )


def _read(name: str) -> Any:
    """Read this worker's data, waiting for it, since a new worker may get a job before it."""
    worker = get_worker()
    until = time.monotonic() + TIMEOUT
    while time.monotonic() < until:
        data = worker.plugins.get(name)
        if isinstance(data, WorkerData):
            return data.read()
        time.sleep(0.1)
    raise RuntimeError(f"worker {worker.address} was never given {name}")


def _job(function: Callable[..., Any], items: Sequence[Any], *names: str) -> list[Any]:
    return run_part(function, items, [_read(name) for name in names])
