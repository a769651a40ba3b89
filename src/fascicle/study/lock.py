"""Lock that lets only one process work on a study."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from fascicle.core.errors import InputError

LOCK = (
    ".study.lock"  # in the study's folder; released by the operating system when its process ends
)


class HeldError(InputError):
    """Raised if another process, or another thread, works on a study."""


@contextmanager
def study_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a study's folder, made if it is missing; the lock may be nested."""
    lock = FileLock(folder.resolve() / LOCK, blocking=False, is_singleton=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise HeldError(
            f"{folder}: another process is working on this study; wait for it or stop it"
        ) from None
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); give another folder (out)"
        ) from None
    try:
        yield
    finally:
        lock.release()


def refuse_held(folder: Path) -> None:
    """Refuse a study that another process works on, before a fit's inputs are read."""
    if (folder / LOCK).exists():
        with study_lock(folder):
            pass
