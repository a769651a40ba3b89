"""One process a study: a lock that names its host and process, and outlives no crash."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from fascicle.core.errors import InputError, printable
from fascicle.core.files import write_text

LOCK = ".study.lock"  # in the study's folder; held by the operating system
HOLDER = ".study.holder"  # who holds it: a file of its own, since Windows lets no one read LOCK
LONGEST = 300  # characters of it that are read
BEAT = 15.0  # s between signs of life: the holder touches its file
LOST = 180.0  # s without one, after which a process of another host counts as dead


class HeldError(InputError):
    """Another process, or another thread, works on a study."""


@contextmanager
def study_lock(folder: Path) -> Iterator[None]:
    """Hold the study in `folder`, made if it is missing, for this process while the block runs.

    The operating system drops the lock of a process that ends, however it ends, so one left by a
    dead process of this host is taken over. On a network file system the lock may hold on one host
    only; there the name counts, as long as its process gives signs of life: one that has given none
    for `LOST` seconds is taken over. Two hosts that start within the same moment are not told apart
    there. A block within the block holds it, too.

    Raises
    ------
    HeldError
        If another process, or another thread, holds the study.
    InputError
        If the folder cannot be written.
    """
    lock = FileLock(folder.resolve() / LOCK, blocking=False, is_singleton=True)
    if lock.is_locked:
        yield
        return
    _acquire(lock, folder)
    try:
        _claim(folder)
        with _signs_of_life(folder / HOLDER):
            yield
    finally:
        lock.release()


@contextmanager
def _signs_of_life(path: Path) -> Iterator[None]:
    """Touch a file while the block runs, and remove it afterwards."""
    ended = threading.Event()

    def touch() -> None:
        while not ended.wait(BEAT):
            with suppress(OSError):  # the next one may succeed
                os.utime(path)

    thread = threading.Thread(target=touch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        path.unlink(missing_ok=True)


def _acquire(lock: BaseFileLock, folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        holder = _holder(folder)
        remedy = "wait for it or stop it"
        if holder and not _of_this_host(holder):  # a file system may keep the lock of a dead host
            remedy += f"; if that host is surely dead, delete {folder / LOCK} and {folder / HOLDER}"
        raise HeldError(
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
    """Write who holds the lock, unless another host's living process stands there."""
    path = folder / HOLDER
    holder = _holder(folder)
    if holder and not _of_this_host(holder) and _silence(folder) < LOST:
        raise HeldError(
            f"{folder}: {holder} is working on this study; wait for it, or if it no longer runs, "
            f"{LOST / 60:.0f} minutes until it counts as dead"
        )
    write_text(path, f"process {os.getpid()} on {socket.gethostname()}\n")


def _of_this_host(holder: str) -> bool:
    return holder.endswith(f" on {socket.gethostname()}")


def _silence(folder: Path) -> float:
    """Time (s) since the holder's last sign of life, by the clock of the file system."""
    os.utime(folder / LOCK)
    with (folder / HOLDER).open() as held:  # opened, since its time may be an old one's otherwise
        return (folder / LOCK).stat().st_mtime - os.fstat(held.fileno()).st_mtime


def _holder(folder: Path) -> str:
    """Who holds the lock, or held it when it crashed; empty if nobody."""
    try:
        text = (folder / HOLDER).read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return ""
    return printable(text[:LONGEST].strip())
