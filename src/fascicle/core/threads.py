"""Cores, threads of the linear algebra, and objects shared by threads and processes."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakMethod

import numpy as np  # noqa: F401 - NumPy and SciPy each bring a BLAS, both are found below
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

from fascicle.core.errors import FileError

_BLAS = ThreadpoolController().select(user_api="blas")

# Decorator: keep BLAS and LAPACK to one thread within a function. The matrices of a fit are small,
# so that more threads mostly wait, the more the busier the machine; and sums are then always taken
# in the same order, so the result has the same bits whatever the number of cores.
one_thread = _BLAS.wrap(limits=1)


def keep_one_thread() -> None:
    """Keep BLAS and LAPACK to one thread from now on, in a worker process."""
    _BLAS.limit(limits=1)


def blas_threads() -> int:
    """Count the threads that BLAS may use, by default one per core."""
    return max((int(library["num_threads"]) for library in _BLAS.info()), default=1)


def in_chunks(work: Callable[[slice], None], count: int, size: int) -> None:
    """Call `work` on consecutive slices of `size` of `count` items, on as many threads as BLAS may.

    `work` writes its result where no other call does. Each slice is worked on by one thread from
    beginning to end. That gives the same bits whatever the number of threads, and no thread waits
    for another at every operation, which on a busy machine costs far more than the work.
    """
    slices = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    workers = max(1, min(blas_threads(), len(slices)))
    with _BLAS.limit(limits=1):
        if workers == 1:
            for part in slices:
                work(part)
            return
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, slices))


def made_once(make: Callable[[Any], Any], most: int) -> Callable[[Any], Any]:
    """Cache `make` for the last `most` arguments; every result is computed by one thread.

    Threads that need the same result wait for it; other results are computed meanwhile.
    """
    one_at_a_time = Lock()

    @lru_cache(most)
    def places(_: Any) -> tuple[Lock, list[Any]]:
        return Lock(), []

    def get(argument: Any) -> Any:
        with one_at_a_time:  # two threads could otherwise get two places
            lock, results = places(argument)
        with lock:
            if not results:
                results.append(make(argument))
            return results[0]

    return get


def without_its_object(method: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Call a method of an object that lives, without keeping it alive.

    An object that holds a cache of its own method is freed late, by the garbage collector alone,
    which counts objects, not their memory.
    """
    reference = WeakMethod(method)

    def call(argument: Any) -> Any:
        living = reference()
        assert living is not None
        return living(argument)

    return call


def cores() -> int:
    """Count the cores that this process may use: a queue may give it fewer than there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class SharedFile(NamedTuple):
    """A file that `write_shared` has written, and the SHA-256 of its content."""

    path: Path
    digest: str


def write_shared(path: Path, content: object) -> SharedFile:
    """Pickle an object for processes that can read this file."""
    pickled = pickle.dumps(content)
    path.write_bytes(pickled)
    return SharedFile(path, hashlib.sha256(pickled).hexdigest())


def _read(file: SharedFile) -> Any:
    """Unpickle a file; FileError if it was changed, as it could then run somebody else's code."""
    pickled = file.path.read_bytes()
    digest = hashlib.sha256(pickled).hexdigest()
    if digest != file.digest:
        raise FileError(
            f"{file.path}: has been changed since it was written for the workers (SHA-256 "
            f"{digest[:12]}, not {file.digest[:12]}); see who else writes to the temporary folder"
        )
    return pickle.loads(pickled)  # noqa: S301 - by `write_shared`


# The last four objects are kept: a model, and the recordings it is compared with, of two studies.
# Threads of a worker start together, and one heart is enough for all.
read_shared = made_once(_read, 4)
