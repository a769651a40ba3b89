"""Files that others made, read in a child process with limits on its time and memory.

The libraries for VTK, HDF5, MATLAB and other files trust the sizes that a file states: on a damaged
or hostile one they crash, never end, or ask for any amount of memory. In a child process each of
these is one clear refusal, and what they leak goes with it.

A child stays to read the next file, since to start one and import VTK takes 0.3 s, ten times what
most files take, and goes when it has read a large file, or when this process ends. Where Python has
no module `resource` (Windows), only the time is limited, not the memory.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.memory import available_memory

MEMORY, MEMORY_PER_BYTE = 3 * 2**29, 64  # bytes of address space, and more for each of the file
SECONDS, SECONDS_PER_BYTE = 3.0, 1e-6  # of computing, likewise
BUSY = 5.0  # on a busy machine so many times the seconds of computing may pass
DYING = 5.0  # s in which a child that has closed its output is gone
LARGE = 64 * 2**20  # bytes; a file that leaves a child with more memory than is worth keeping
_PYTHON_ERROR = 1  # exit status of Python after an exception that nothing caught
_EXHAUSTED = (b"bad_alloc", b"MemoryError", b"nable to allocate")  # printed by what then aborts
_ARRAY = "\0array"  # key of what stands for an array in JSON


@dataclass(frozen=True)
class Limits:
    """What reading a file may take: memory (bytes of address space) and computing time (s)."""

    memory: float
    seconds: float

    @classmethod
    def of(cls, path: Path) -> Limits:
        """Limits that grow with the size of the file; never more memory than is free."""
        size = path.stat().st_size
        memory = min(MEMORY + MEMORY_PER_BYTE * size, max(available_memory(), MEMORY))
        return cls(memory, SECONDS + SECONDS_PER_BYTE * size)


def read_isolated(reader: Callable[..., Any], path: Path, **options: Any) -> Any:
    """Call a reader in a child process.

    Parameters
    ----------
    reader : function
        Called as ``reader(path, **options)``; it is found by its module and name.
    path : Path
        The file, which decides the limits.
    **options
        Numbers, texts and the like, as JSON has them.

    Returns
    -------
    object
        What the reader returned: dictionaries with text as keys, lists, texts, numbers and arrays.
        Nothing is unpickled.

    Raises
    ------
    InputError
        What the reader raised, or that reading crashed or went beyond the limits.
    """
    limits = Limits.of(path)
    request = {
        "module": reader.__module__, "reader": reader.__name__, "path": str(path),
        "options": options, "limits": asdict(limits), "folder": os.getcwd(),
    }  # fmt: skip
    child = _idle_child()
    try:
        answer = child.ask(request, BUSY * limits.seconds)
    except EOFError:
        raise _why_ended(child, path, limits) from None
    except BaseException:  # such as Ctrl-C: what it says now answers nothing
        child.end()
        raise
    if "exhausted" in answer or path.stat().st_size > LARGE:
        child.end()
    else:
        _idle.append(child)
    if "exhausted" in answer:
        raise _too_much_memory(path, limits)
    if "refused" in answer:
        raise InputError(answer["refused"])
    return answer["value"]


def _why_ended(child: _Child, path: Path, limits: Limits) -> Exception:
    """The error of a child that ended without an answer."""
    status, printed = child.end(DYING)
    if child.is_late or status == -getattr(signal, "SIGXCPU", 0):
        return InputError(
            f"{path}: not read within {limits.seconds:.0f} s of computing, the limit for a file of "
            "its size; it is damaged, export it again"
        )
    if status == _PYTHON_ERROR and b"MemoryError" not in printed:
        return RuntimeError(f"{path}: {printed.decode(errors='replace')}")
    if any(word in printed for word in _EXHAUSTED):
        return _too_much_memory(path, limits)
    return InputError(
        f"{path}: damaged, the library that reads it crashed (status {status}); export it again"
    )


def _too_much_memory(path: Path, limits: Limits) -> InputError:
    limit, size = limits.memory / 2**30, path.stat().st_size / 2**20
    return InputError(
        f"{path}: takes more than {limit:.1f} GB of memory, the limit for a file of {size:.3g} MB "
        f"({MEMORY / 2**30:g} GB and {MEMORY_PER_BYTE} times its size, or what is free); it is "
        "damaged, export it again, or too large, give a part of it"
    )


class _Child:
    """A process that reads one file after another.

    Attributes
    ----------
    is_late : bool
        Whether it was ended because time was up.
    """

    def __init__(self) -> None:
        # -P: a module of the library's name in the working folder is not taken for it
        command = [sys.executable, "-P", "-m", __name__]
        here = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
        self.is_late = False
        self._printed = tempfile.TemporaryFile("a+b")  # noqa: SIM115 - `end` closes it
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._printed,
            env=os.environ | here,
        )

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def ask(self, request: dict[str, Any], seconds: float) -> dict[str, Any]:
        """Answer to a request, within so many seconds; EOFError if the child ends instead."""
        self._printed.truncate(0)
        timer = threading.Timer(seconds, self._give_up)
        timer.start()
        try:
            assert self._process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # no answer will tell
                self._process.stdin.write(json.dumps(request).encode() + b"\n")
                self._process.stdin.flush()
            return self._answer()
        finally:
            timer.cancel()

    def _answer(self) -> dict[str, Any]:
        stream: Any = self._process.stdout
        line = stream.readline()
        if not line.endswith(b"\n"):
            raise EOFError
        head = json.loads(line)
        arrays = []
        for dtype, shape in head["arrays"]:
            array: NDArray[Any] = np.empty(shape, dtype)
            if stream.readinto(array.reshape(-1).view(np.uint8)) < array.nbytes:
                raise EOFError
            arrays.append(array)

        def restored(found: dict[str, Any]) -> Any:
            return arrays[found[_ARRAY]] if _ARRAY in found else found

        answer: dict[str, Any] = json.loads(head["answer"], object_hook=restored)
        return answer

    def _give_up(self) -> None:
        self.is_late = True
        self._process.kill()

    def end(self, patience: float = 0.0) -> tuple[int, bytes]:
        """End it, after so many seconds; its exit status, and what it has printed."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        self._process.kill()
        status = self._process.wait()
        self._process.stdout.close()
        self._printed.seek(0)
        printed = self._printed.read()
        self._printed.close()
        return status, printed


_idle: list[_Child] = []


def _idle_child() -> _Child:
    """A child that waits for a request, if need be a new one."""
    while True:
        try:
            child = _idle.pop()
        except IndexError:
            return _Child()
        if child.is_alive:
            return child
        child.end()


@atexit.register
def _end_idle() -> None:
    while _idle:
        _idle.pop().end()


# a process that is forked off shares the pipes to the children of this one
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)


def _limit_resources(memory: float, seconds: float) -> None:
    """Limit the memory and the computing time of this process, where the system can."""
    try:
        import resource
    except ImportError:
        return
    for kind, most in (
        (resource.RLIMIT_AS, int(memory)),
        (resource.RLIMIT_CPU, math.ceil(time.process_time() + seconds)),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(kind)
        soft = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with contextlib.suppress(ValueError, OSError):  # some systems do not know a limit
            resource.setrlimit(kind, (soft, hard))


def _serve() -> None:
    """Answer the requests on standard input, until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends this
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # what libraries print must not get into the answers
        while line := sys.stdin.buffer.readline():
            request = json.loads(line)
            os.chdir(request["folder"])  # where a relative path of the parent's begins
            _limit_resources(**request["limits"])
            _write(answers, _answer_to(request))
            answers.flush()


def _answer_to(request: dict[str, Any]) -> dict[str, Any]:
    try:
        reader = getattr(import_module(request["module"]), request["reader"])
        return {"value": reader(Path(request["path"]), **request["options"])}
    except InputError as error:
        return {"refused": str(error)}
    except MemoryError:
        return {"exhausted": True}


def _write(stream: Any, answer: dict[str, Any]) -> None:
    """Write an answer: a line of JSON, then the bytes of its arrays."""
    arrays: list[NDArray[Any]] = []

    def stored(value: Any) -> Any:
        if isinstance(value, np.generic):
            return value.item()
        if not isinstance(value, np.ndarray) or value.dtype.hasobject:
            raise TypeError(f"{type(value).__name__} is no plain data")
        arrays.append(np.ascontiguousarray(value).reshape(value.shape))
        return {_ARRAY: len(arrays) - 1}

    text = json.dumps(answer, default=stored)
    head = {"answer": text, "arrays": [(array.dtype.str, array.shape) for array in arrays]}
    stream.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        stream.write(array.reshape(-1).view(np.uint8))


if __name__ == "__main__":
    _serve()
