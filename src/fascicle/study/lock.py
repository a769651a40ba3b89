"""One process a study: a lock that names its host and process, and outlives no crash."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from fascicle.core.errors import InputError, printable
from fascicle.core.files import write_text

LOCK = ".study.lock"  # in the study's folder; held by the operating system
HOLDER = ".study.holder"  # who holds it: a file of its own, since Windows lets no one read LOCK
LONGEST = 300  # characters of it that are read


@contextmanager
def study_lock(folder: Path) -> Iterator[None]:
    """Hold the study in `folder`, made if it is missing, for this process while the block runs.

    The operating system drops the lock of a process that ends, however it ends, so one left by a
    dead process of this host is taken over. On a network file system the lock may hold on one host
    only; there the name counts, and another host's has to be removed by hand. Two hosts that start
    within the same moment are not told apart there. A block within the block holds it, too.

    Raises
    ------
    InputError
        If another process, or another thread, holds the study, or the folder cannot be written.
    """
    lock = FileLock(folder.resolve() / LOCK, blocking=False, is_singleton=True)
    if lock.is_locked:
        yield
        return
    _acquire(lock, folder)
    try:
        _claim(folder)
        try:
            yield
        finally:
            (folder / HOLDER).unlink(missing_ok=True)
    finally:
        lock.release()


def _acquire(lock: BaseFileLock, folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        holder = _holder(folder)
        remedy = "wait for it or stop it"
        if holder and not _of_this_host(holder):  # a file system may keep the lock of a dead host
            remedy += f"; if that host is surely dead, delete {folder / LOCK} and {folder / HOLDER}"
        raise InputError(
            f"{folder}: {holder or 'another process'} is working on this study; {remedy}"
        ) from None
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); give another folder (out)"
        ) from None


def refuse_held(folder: Path) -> None:
    """Refuse a study that another process works on, before the work that a fit's inputs take."""
    if (folder / LOCK).exists():
        with study_lock(folder):
            pass


def _claim(folder: Path) -> None:
    """Write who holds the lock, unless another host's process stands there."""
    path = folder / HOLDER
    holder = _holder(folder)
    if holder and not _of_this_host(holder):
        raise InputError(
            f"{folder}: {holder} is working on this study; wait for it, or if it no longer runs, "
            f"delete {path}"
        )
    write_text(path, f"process {os.getpid()} on {socket.gethostname()}\n")


def _of_this_host(holder: str) -> bool:
    return holder.endswith(f" on {socket.gethostname()}")


def _holder(folder: Path) -> str:
    """Who holds the lock, or held it when it crashed; empty if nobody."""
    try:
        text = (folder / HOLDER).read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return ""
    return printable(text[:LONGEST].strip())
