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
from fascicle.core.progress import Progress
from fascicle.core.ranges import shown
from fascicle.core.threads import keep_one_thread
from fascicle.forward.model import WrittenModel
from fascicle.study.pool import Question, Remote, run_part

Item = TypeVar("Item")
Result = TypeVar("Result")

TIMEOUT = 30  # s, until a scheduler has answered
NOTICED = 1  # s, after which it is seen that no worker is there
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
        self.folder: Path | None = None

    def setup(self, worker: Worker) -> None:
        """Write the files for this worker to read; BLAS takes one thread here from now on."""
        keep_one_thread()  # jobs of several threads would set it back for one another
        folder = Path(mkdtemp(prefix="fascicle-", dir=worker.local_directory))
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        self.files.clear()  # they are on the worker's disk
        self.folder = folder  # last: a job may already be waiting for it

    def teardown(self, worker: Worker) -> None:
        """Remove the files."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


class Cluster(Remote):
    """Workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``"tcp://10.0.0.1:8786"``.
    progress : Progress, optional
        Called, with the stage "workers", while it has none.

    Raises
    ------
    InputError
        If it is no address, or no scheduler answers there.
    """

    def __init__(self, address: str, progress: Progress | None = None) -> None:
        if not isinstance(address, str) or not re.fullmatch(ADDRESS, address):
            raise InputError(
                f"{shown(address)} is no address of a Dask scheduler; it prints its own when it "
                "starts, such as tcp://10.0.0.1:8786"
            )
        try:
            self.client: Any = Client(address, timeout=TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, TypeError) as error:  # the second of TLS that is not configured
            raise InputError(
                f"{address}: no Dask scheduler answers ({one_line(error)}); start one with "
                "'dask scheduler', and workers with 'dask worker ADDRESS'"
            ) from error
        super().__init__()
        self.address, self.progress = address, progress
        self._known: set[str] = set()
        self._waits = False  # for a worker

    @property
    def workers(self) -> int:  # type: ignore[override]
        """Threads of the workers that are there now, 1 at least."""
        return max(1, self._threads())

    def _threads(self) -> int:
        threads: dict[str, int] = self.client.nthreads()
        return sum(threads.values())

    def _submit(self, *job: Any) -> Any:
        key = f"fascicle-{_name(pickle.dumps(job))}"
        return self.client.submit(_job, *job, key=key, pure=False)

    def _results(self, futures: Sequence[Any]) -> Sequence[Any]:
        """Fetch together what jobs have given: one by one each would take some milliseconds."""
        first = self._result(futures[0])
        try:
            with self.scheduler_there(CancelledError):
                return [first, *self.client.gather(list(futures[1:]))]
        except KilledWorker:  # of one that had ended: what it had given was lost with it
            return [first, *map(self._result, futures[1:])]

    def _result(self, future: Any) -> Any:
        """Wait for a job; where its workers were lost it is done again, by others."""
        with self.scheduler_there(CancelledError):
            for _ in range(RETRIES):
                try:
                    return self._awaited(future)
                except KilledWorker:
                    future.retry()
            return self._awaited(future)

    def _awaited(self, future: Any) -> Any:
        """Result of a job; while it waits for one, it is said that no worker is there."""
        while not future.done():
            try:
                return future.result(timeout=NOTICED)
            except TimeoutError:
                self._say_whether_it_waits()
        return future.result()

    def _say_whether_it_waits(self) -> None:
        with self.scheduler_there(OSError):
            waits = self._threads() == 0
        if self.progress is not None and (waits or self._waits):
            message = f"{self.address} has no worker; waiting for one" if waits else ""
            self.progress("workers", int(not waits), 1, message)
        self._waits = waits

    @contextmanager
    def scheduler_there(self, *errors: type[Exception]) -> Iterator[None]:
        """Say so in one line when it is lost, of which these errors tell."""
        try:
            yield
        except errors as error:
            raise InputError(
                f"{self.address}: the Dask scheduler was lost ({one_line(error)}); what is "
                "evaluated is kept: start it again, and the same command goes on"
            ) from error

    def _send(self, question: Question) -> str:
        with TemporaryDirectory(prefix="fascicle-") as folder:
            written = question.model.write(Path(folder), question.bodies)
            files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
        return self._hold(files, (written.conduction, written.rules, written.action_potential))

    def _rest(self, portable: Any) -> str:
        return self._hold({}, portable)

    def _hold(self, files: dict[str, bytes], small: Any) -> str:
        """Give all workers, those that come later too, something to keep; its name."""
        name = f"fascicle-{_name(pickle.dumps((files, small)))}"
        if name not in self._known:
            with self.scheduler_there(OSError, CancelledError):
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


def _held(name: str) -> tuple[Path, Any]:
    """What this worker was given; a worker that has just joined gets its jobs sooner than that."""
    worker = get_worker()
    until = time.monotonic() + TIMEOUT
    while time.monotonic() < until:
        held = worker.plugins.get(name)
        if isinstance(held, Held) and held.folder is not None:
            return held.folder, held.small
        time.sleep(0.1)
    raise RuntimeError(f"worker {worker.address} was never given {name}")


def _job(
    model: str, rest: str, function: Callable[[Any, Item], Result], items: Sequence[Item]
) -> list[Result]:
    folder, small = _held(model)
    _, portable = _held(rest)
    question: Question = portable.of(WrittenModel(folder, *small).read())
    return run_part(question, function, items)
