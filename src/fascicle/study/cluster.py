"""Workers of a Dask cluster, which may die, join late and be restarted.

The heart goes to every worker once, and to those that come later when they come; the scheduler
keeps it for them. Jobs are named by their content, so that one that is sent again is the same job.
"""

from __future__ import annotations

import hashlib
import pickle
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, TypeVar

from distributed import Client, KilledWorker, Worker, WorkerPlugin, get_worker

from fascicle.core.errors import InputError, one_line
from fascicle.forward.model import ForwardModel, WrittenModel
from fascicle.study.pool import Pool, Question, parts, run_part

Item = TypeVar("Item")
Result = TypeVar("Result")

TIMEOUT = 30  # s, until a scheduler has answered
RETRIES = 20  # of a job whose workers were lost, which a walltime does to all that wait there
ADDRESS = r"(tcp|tls)://[^/\s]+:\d{1,5}"
KEY = 24  # digits of a name by content


class Held(WorkerPlugin):
    """What a worker is given when it joins, and keeps: a model, or what is asked of one.

    Parameters
    ----------
    name : str
        Of its content.
    files : dict of name to bytes
        Of a model.
    small : object
        What is not in them.
    """

    def __init__(self, name: str, files: dict[str, bytes], small: Any) -> None:
        self.name, self.files, self.small = name, files, small

    def setup(self, worker: Worker) -> None:
        """Write the files for this worker to read."""
        self.folder = Path(mkdtemp(prefix="fascicle-", dir=worker.local_directory))
        for name, content in self.files.items():
            (self.folder / name).write_bytes(content)
        self.files.clear()  # they are on the worker's disk

    def teardown(self, worker: Worker) -> None:
        """Remove the files."""
        shutil.rmtree(self.folder, ignore_errors=True)


class Cluster(Pool):
    """Workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``"tcp://10.0.0.1:8786"``.

    Raises
    ------
    InputError
        If it is no address, or no scheduler answers there.
    """

    def __init__(self, address: str) -> None:
        if not re.fullmatch(ADDRESS, address):
            raise InputError(
                f"'{address}' is no address of a Dask scheduler; it prints its own when it starts, "
                "such as tcp://10.0.0.1:8786"
            )
        try:
            self.client: Any = Client(address, timeout=TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, TypeError) as error:  # the second of TLS that is not configured
            raise InputError(
                f"{address}: no Dask scheduler answers ({one_line(error)}); start one with "
                "'dask scheduler', and workers with 'dask worker ADDRESS'"
            ) from error
        self.address = address
        self._sent: list[tuple[ForwardModel, str]] = []
        self._known: set[str] = set()

    @property
    def workers(self) -> int:
        """Threads of the workers that are there now, 1 at least."""
        threads: dict[str, int] = self.client.nthreads()
        return max(1, sum(threads.values()))

    def map(
        self, function: Callable[[Any, Item], Result], question: Question, items: Sequence[Item]
    ) -> Iterator[Result]:
        """Give results in the order of the items."""
        model = self._model(question)
        rest = self._hold({}, question.portable())
        futures = [
            self.submit(_job, model, rest, function, part) for part in parts(items, self.workers)
        ]
        return self._in_order(futures)

    def _in_order(self, futures: Sequence[Any]) -> Iterator[Any]:
        try:
            for future in futures:
                yield from self.result(future)
                future.release()
        finally:
            left = [future for future in futures if not future.done()]
            self.client.cancel(left)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Send a job, under the name of its content; its future."""
        key = _name(pickle.dumps((function.__module__, function.__qualname__, arguments)))
        return self.client.submit(function, *arguments, key=f"fascicle-{key}", pure=False)

    def result(self, future: Any) -> Any:
        """Wait for a job; where its workers were lost it is done again, by others.

        Raises
        ------
        InputError
            If the scheduler is lost.
        """
        with self._scheduler_there(CancelledError):
            for _ in range(RETRIES):
                try:
                    return future.result()
                except KilledWorker:
                    future.retry()
            return future.result()

    @contextmanager
    def _scheduler_there(self, *errors: type[Exception]) -> Iterator[None]:
        """Say so in one line when it is lost, of which these errors tell."""
        try:
            yield
        except errors as error:
            raise InputError(
                f"{self.address}: the Dask scheduler was lost ({one_line(error)}); what is "
                "evaluated is kept: start it again, and the same command goes on"
            ) from error

    def _model(self, question: Question) -> str:
        for model, name in self._sent:
            if model is question.model:
                return name
        with TemporaryDirectory(prefix="fascicle-") as folder:
            written = question.model.write(Path(folder), question.bodies)
            files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
        name = self._hold(files, (written.conduction, written.rules, written.action_potential))
        self._sent.append((question.model, name))
        return name

    def _hold(self, files: dict[str, bytes], small: Any) -> str:
        """Give all workers, those that come later too, something to keep; its name."""
        name = f"fascicle-{_name(pickle.dumps((files, small)))}"
        if name not in self._known:
            with self._scheduler_there(OSError, CancelledError):
                self._register(Held(name, files, small))
            self._known.add(name)
        return name

    def _register(self, held: Held) -> None:
        """Give it to all; again where a worker was lost meanwhile, of which its others know too."""
        for _ in range(RETRIES):
            try:
                self.client.register_plugin(held)
                return
            except OSError:
                if self.client.status != "running":  # the scheduler itself is gone
                    raise
                time.sleep(0.5)
        self.client.register_plugin(held)


def _name(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:KEY]


def _held(name: str) -> Held:
    """What this worker was given; a worker that has just joined gets its jobs sooner than that."""
    worker = get_worker()
    until = time.monotonic() + TIMEOUT
    while name not in worker.plugins:
        if time.monotonic() > until:
            raise RuntimeError(f"worker {worker.address} was never given {name}")
        time.sleep(0.1)
    held = worker.plugins[name]
    assert isinstance(held, Held)
    return held


def _job(
    model: str, rest: str, function: Callable[[Any, Item], Result], items: Sequence[Item]
) -> list[Result]:
    held = _held(model)
    written = WrittenModel(held.folder, *held.small)
    question: Question = _held(rest).small.of(written.read())
    return run_part(question, function, items)
