"""Reading of foreign files in a child process with limits on its time and memory.

The libraries for VTK, HDF5, MATLAB and other files trust the sizes that a file states: on a damaged
or hostile one they crash, never end, or ask for any amount of memory. In a child process each of
these is one clear refusal, and what they leak goes with it.

The child stays to read the next file, since to start one and import VTK takes 0.3 s, and goes when
it has read a large file, or when this process ends. A worker of `multiprocessing` would run the
user's script again. Where Python has no module `resource` (Windows), only the time is limited.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from fascicle.core.errors import InputError, one_line

if TYPE_CHECKING:
    import xarray as xr

# What the libraries raise on damaged files
DAMAGED: tuple[type[Exception], ...] = (
    OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, ArithmeticError,
    AssertionError, NameError, EOFError,
)  # fmt: skip


def available_memory() -> float:
    """Memory (bytes) that is available to programs; infinite if the system does not state it."""
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():  # Linux, which counts what its caches would give back
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    if "SC_PHYS_PAGES" in getattr(os, "sysconf_names", {}):
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return float("inf")


@dataclass(frozen=True)
class Limits:
    """Memory (bytes of address space) and computing time (s) that reading a file may take."""

    least_seconds: ClassVar[float] = 3.0  # plus one microsecond per byte of the file
    least_patience: ClassVar[float] = 40.0  # s that may pass besides
    large: ClassVar[int] = 64 * 2**20  # bytes; such a file leaves a child that holds much memory

    memory: float
    seconds: float
    size: int

    @classmethod
    def of(cls, *paths: Path) -> Limits:
        """Limits that grow with the size of the files; never more memory than is free."""
        size, least = sum(path.stat().st_size for path in paths), 3 * 2**29
        memory = min(least + 64 * size, max(available_memory(), least))
        return cls(memory, cls.least_seconds + 1e-6 * size, size)

    def too_much_memory(self, path: Path) -> InputError:
        """Error for a file that needs more memory than is allowed."""
        return InputError(
            f"{path}: takes more than {self.memory / 2**30:.1f} GB of memory, the limit for a file "
            f"of {self.size / 2**20:.3g} MB (1.5 GB and 64 times its size, or what is free); it is "
            "damaged, export it again, or too large, give a part of it"
        )


def read_isolated(
    reader: Callable[..., Any], path: Path, *, companions: tuple[Path, ...] = (), **options: Any
) -> Any:
    """Return ``reader(path, **options)``, called in a child process.

    The size of the file and its companions decides the limits. Raises the reader's InputError, or
    an InputError if the reader crashed or went beyond the limits.
    """
    limits = Limits.of(path, *companions)
    with _Child.lock:
        child, start = _Child.current(), time.monotonic()
        # on a busy machine many times the seconds of computing may pass, and the child starts first
        patience = limits.least_patience + 5.0 * limits.seconds
        timer = threading.Timer(patience, child.process.kill)
        timer.start()
        try:
            value, error, exhausted = child.ask((reader, path, options, limits, os.getcwd()))
        except EOFError:
            raise _why_ended(child, path, limits, time.monotonic() - start > patience) from None
        except BaseException:  # such as Ctrl-C: a late answer would be read as the next one
            child.end()
            raise
        finally:
            timer.cancel()
        if exhausted or limits.size > Limits.large:
            child.end()
    if error is not None:
        raise error
    return value


def _why_ended(child: _Child, path: Path, limits: Limits, late: bool) -> Exception:
    """The error of a child that ended without an answer."""
    status, printed = child.end(patience=5.0)
    if late or status == -getattr(signal, "SIGXCPU", 0):
        return InputError(
            f"{path}: not read within {limits.seconds:.0f} s of computing, the limit for a file of "
            "its size; it is damaged, export it again"
        )
    if any(word in printed for word in (b"bad_alloc", b"MemoryError", b"nable to allocate")):
        return limits.too_much_memory(path)
    if status == 1:  # an exception that nothing caught
        return RuntimeError(f"{path}: {printed.decode(errors='replace')}")
    return InputError(
        f"{path}: damaged, the library that reads it crashed (status {status}); export it again"
    )


class _Child:
    """A process that reads one file after another."""

    lock = threading.Lock()
    kept: _Child | None = None

    def __init__(self) -> None:
        # -P: a module of the library's name in the working folder is not taken for it
        command = [sys.executable, "-P", "-c", f"from {__name__} import _serve; _serve()"]
        settings = {
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "OPENBLAS_NUM_THREADS": "1",
        }
        self.printed = tempfile.TemporaryFile("a+b")  # noqa: SIM115 - `end` closes it
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.printed,
            env=os.environ | settings,
        )

    @classmethod
    def current(cls) -> _Child:
        """Child process ready for a request; starts one if necessary."""
        if cls.kept is not None and cls.kept.process.poll() is not None:
            cls.kept.end()
        cls.kept = cls.kept or cls()
        return cls.kept

    def ask(self, request: Any) -> Any:
        """Answer to a request; EOFError if the child ends instead."""
        self.printed.truncate(0)
        with contextlib.suppress(BrokenPipeError):  # found out below, when no answer comes
            pickle.dump(request, self.process.stdin)  # type: ignore[arg-type]
            self.process.stdin.flush()  # type: ignore[union-attr]
        try:
            # by pickle: the child has the rights of this process, so it could do harm without it
            return pickle.load(self.process.stdout)  # type: ignore[arg-type] # noqa: S301
        except pickle.UnpicklingError:  # the child ended within its answer
            raise EOFError from None

    def end(self, patience: float = 0.0) -> tuple[int, bytes]:
        """End the process after at most `patience` s; return its exit status and output."""
        _Child.kept = None
        with contextlib.suppress(BrokenPipeError, subprocess.TimeoutExpired):
            self.process.communicate(timeout=patience)
        self.process.kill()
        self.process.communicate()
        self.printed.seek(0)
        with self.printed:
            return self.process.returncode, self.printed.read()


@atexit.register
def end_child() -> None:
    """End the child process that waits for the next file, if there is one."""
    if _Child.kept is not None:
        _Child.kept.end()


def _after_fork() -> None:
    """Leave the reading child to the process that started it."""
    _Child.kept, _Child.lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def _limit_resources(limits: Limits) -> None:
    """Limit the memory and the computing time of this process, where the system can."""
    try:
        import resource
    except ImportError:
        return
    for kind, most in (
        (resource.RLIMIT_AS, int(limits.memory)),
        (resource.RLIMIT_CPU, math.ceil(time.process_time() + limits.seconds)),
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
        os.dup2(2, 1)  # text printed by libraries must not mix with answers
        with contextlib.suppress(EOFError):
            while True:
                reader, path, options, limits, folder = pickle.load(sys.stdin.buffer)  # noqa: S301
                os.chdir(folder)  # so that relative paths of the parent are valid
                _limit_resources(limits)
                pickle.dump(_answer(reader, path, options, limits), answers, protocol=5)
                answers.flush()


def _answer(
    reader: Callable[..., Any], path: Path, options: dict[str, Any], limits: Limits
) -> tuple[Any, Exception | None, bool]:
    """Value that a reader returns or the error to raise, and whether memory was exhausted."""
    try:
        return reader(path, **options), None, False
    except InputError as error:
        if error.__cause__ is not None:  # does not go through the pipe; a note does
            error.add_note("".join(traceback.format_exception(error.__cause__)))
        return None, error, False
    except MemoryError:
        return None, limits.too_much_memory(path), True
    except Exception:  # noqa: BLE001 - raised again where the file was asked for
        return None, RuntimeError(f"{path}: {traceback.format_exc()}"), False


def load_netcdf(path: Path, group: str = "/") -> xr.Dataset:
    """Load one group of a file, in a child process: HDF5 may crash or never end.

    Variables are as stored: fill values are not replaced, times are not decoded. Raises InputError
    if the file cannot be read, or has no such group.
    """
    import xarray as xr

    parts = read_isolated(read_group, path, group=group)
    variables = {name: (dims, values, attrs) for name, dims, values, attrs in parts["variables"]}
    try:
        return xr.Dataset(variables, attrs=parts["attributes"])
    except ValueError as error:  # sizes that contradict one another
        raise InputError(f"{path}: damaged ({one_line(error)})") from None


def read_group(path: Path, group: str) -> dict[str, Any]:
    """Attributes and variables of a group, as plain data."""
    import h5netcdf

    try:
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            h5_group = file if group == "/" else file[group]
            variables = [
                (name, variable.dimensions, _plain(variable[...]), _attributes(variable))
                for name, variable in h5_group.variables.items()
            ]
            return {"variables": variables, "attributes": _attributes(h5_group)}
    except (*DAMAGED, h5netcdf.CompatibilityError) as error:
        raise InputError(f"{path}: not a readable netCDF file ({one_line(error)})") from None


def _attributes(item: Any) -> dict[str, Any]:
    return {str(name): _plain(value) for name, value in item.attrs.items()}


def _plain(value: Any) -> Any:
    """Value without Python objects: texts become arrays of fixed width."""
    if isinstance(value, np.ndarray) and value.dtype.hasobject:
        return value.astype(str)
    return value
