"""Damaged inputs and their outcomes: an answer or one line, in bounded time and memory."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from benchmarks.fuzzing.calls import CALLS
from benchmarks.fuzzing.kinds import KINDS, small_model
from benchmarks.fuzzing.mutations import mutated
from benchmarks.fuzzing.seeds import Seed, packed, unpacked
from fascicle.core.errors import InputError

SECONDS = 60.0
MEMORY = 2e9  # bytes
SEED = 2024


class TooSlowError(BaseException):
    """An attempt takes too long; no `except Exception` holds it up."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one input.

    Attributes
    ----------
    number : int
        Of the input: the same number is the same input.
    answered : bool
        Whether it was read.
    message : str
        Of the InputError.
    failure : str
        What must not happen; empty if it did not.
    seconds : float
        How long it took.
    """

    number: int
    answered: bool
    message: str
    failure: str
    seconds: float


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise TooSlowError(f"takes more than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def _printed() -> Iterator[list[str]]:
    """Collect what is written to standard output and error by whatever means."""
    printed: list[str] = []
    sys.stdout.flush()
    with tempfile.TemporaryFile() as file, ExitStack() as stack:
        for number in (1, 2):
            stack.callback(os.close, saved := os.dup(number))
            stack.callback(os.dup2, saved, number)
            os.dup2(file.fileno(), number)
        try:
            yield printed
        finally:
            sys.stdout.flush()
            file.seek(0)
            printed.extend(filter(None, [file.read().decode(errors="replace")]))


def _most_memory() -> float:
    """Of this process and of children that have ended (bytes)."""
    import resource

    who = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return max(resource.getrusage(process).ru_maxrss for process in who) * 1024.0


def write_input(kind: str, seeds: list[Seed], number: int, folder: Path) -> Path:
    """Write the damaged files of one number into an empty folder; returns the path to read."""
    rng = np.random.default_rng([SEED, zlib.crc32(kind.encode()), number])
    seed = seeds[rng.integers(len(seeds))]
    victim = seed.damaged[rng.integers(len(seed.damaged))]
    for name, content in seed.files.items():
        if name == victim:
            content = packed(seed, name, mutated(unpacked(seed, name), rng))
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder / seed.main if seed.main else folder


def attempt(work: Callable[[], Any], number: int) -> Outcome:
    """Read one damaged input, or make one call."""
    answered, message, failure = False, "", ""
    start, before = time.monotonic(), _most_memory()
    try:
        with _alarm(SECONDS), warnings.catch_warnings(record=True) as warned, _printed() as printed:
            warnings.simplefilter("always")
            warnings.simplefilter("ignore", DeprecationWarning)
            work()
        answered = True
    except InputError as error:
        message = str(error)
        if not message.isprintable() or len(message) > 1000:
            failure = f"no line: {message[:300]!r}"
    except (Exception, TooSlowError) as error:  # noqa: BLE001 - that there is none is what is tested
        where = traceback.extract_tb(error.__traceback__)
        place = next((f for f in reversed(where) if "fascicle" in f.filename), where[-1])
        failure = f"{type(error).__name__}: {str(error)[-300:]} ({place.filename}:{place.lineno})"
    noise = [str(warning.message) for warning in warned] + printed
    if noise:
        failure = failure or f"says besides: {noise[0][-300:]!r}"
    after = _most_memory()
    if after > max(before, MEMORY):
        failure = failure or f"takes {after / 1e9:.1f} GB"
    return Outcome(number, answered, message, failure, time.monotonic() - start)


def outcomes(name: str, numbers: range, folder: Path) -> Iterator[Outcome]:
    """Outcomes of the inputs of one kind with these numbers; `folder` is for their files."""
    small_model()  # before anything is timed
    if name in CALLS:
        for number in numbers:
            yield attempt(partial(CALLS[name], np.random.default_rng([SEED, number])), number)
        return
    kind = KINDS[name]
    seeds = kind.seeds()
    for number in numbers:
        here = folder / "input"
        here.mkdir()
        path = write_input(name, seeds, number, here)
        yield attempt(partial(kind.read, path), number)
        shutil.rmtree(here)
