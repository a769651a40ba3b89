"""Readers that run in a child process, with limits on its time and memory.

The libraries for MATLAB, HDF5 and SCP-ECG files trust the sizes that a file declares: on a damaged
file they may crash, never end, or ask for any amount of memory. In a child process each of these
is one clear refusal. Where Python has no module `resource` (Windows), only the time is limited.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.readers.raw_recording import Channel, RawRecording, ReadOptions
from fascicle.recording.recording import Filters

TIME_LIMIT = 60.0  # s; the longest recording takes some 5 s
MEMORY_LIMIT = 4 * 2**30  # bytes of address space; the longest recording takes some 2 GB
_PYTHON_ERROR = 1  # exit status of Python after an exception that nothing caught
_SPARE = 5.0  # s of computing that the child may go on for should its parent have died


def read_isolated(path: Path, options: ReadOptions, module: str, function: str) -> RawRecording:
    """Call a reader in a child process.

    Parameters
    ----------
    path : path
        The file.
    options : ReadOptions
        What the user says about it.
    module, function : str
        Module of this package and the function in it, called as ``function(path, options)``.

    Returns
    -------
    RawRecording
        What the function returned; it comes as plain arrays and JSON, nothing is unpickled.

    Raises
    ------
    InputError
        What the function raised, or that reading crashed or went beyond the limits.
    """
    arguments = [module, function, str(path), json.dumps(asdict(options))]
    # -P: a module of the library's name in the working folder is not taken for it
    command = [sys.executable, "-P", "-m", __name__, *arguments]
    here = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryFile() as result:
        try:
            child = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=result,
                stderr=subprocess.PIPE,
                env=os.environ | here,
                timeout=TIME_LIMIT,
            )
        except subprocess.TimeoutExpired as error:
            raise InputError(
                f"{path}: not read within {TIME_LIMIT:g} s, the file is damaged; export it again"
            ) from error
        if child.returncode == _PYTHON_ERROR:
            raise RuntimeError(f"{path}: {child.stderr.decode(errors='replace')}")
        if child.returncode:
            raise InputError(
                f"{path}: damaged, the library that reads it crashed (status {child.returncode}); "
                "export it again"
            )
        result.seek(0)
        with np.load(result, allow_pickle=False) as stored:
            return _unpacked(path, stored)


def _unpacked(path: Path, stored: Any) -> RawRecording:
    """Make what `_packed` took apart again."""
    answer = json.loads(stored["answer"].tobytes())
    if "refused" in answer:
        raise InputError(answer["refused"])
    channels = [
        Channel(values=stored[f"values_{k}"], **channel)
        for k, channel in enumerate(answer.pop("channels"))
    ]
    return RawRecording(channels, filters=Filters(**answer.pop("filters")), **answer)


def _packed(raw: RawRecording) -> tuple[dict[str, Any], dict[str, Any]]:
    """Take a raw recording apart: JSON, and arrays by name."""
    arrays = {f"values_{k}": channel.values for k, channel in enumerate(raw.channels)}
    fields = [{k: v for k, v in vars(c).items() if k != "values"} for c in raw.channels]
    return vars(raw) | {"channels": fields, "filters": asdict(raw.filters)}, arrays


def _limit_resources() -> None:
    """Limit the memory and the computing time of this process, where the system can."""
    try:
        import resource
    except ImportError:
        return
    seconds = int(TIME_LIMIT + _SPARE)
    for kind, most in (
        (resource.RLIMIT_AS, MEMORY_LIMIT),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
    ):
        # some systems do not know a limit, or have a lower one already
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (most, most))


def _main(module: str, function: str, path: str, options: str) -> None:
    """Read in this process and write the result to its standard output."""
    _limit_resources()
    arrays: dict[str, Any] = {}
    with os.fdopen(os.dup(1), "wb") as result:
        os.dup2(2, 1)  # what libraries print must not get into the result
        try:
            reader = getattr(import_module(f"{__package__}.{module}"), function)
            answer, arrays = _packed(reader(Path(path), ReadOptions(**json.loads(options))))
        except InputError as error:
            answer = {"refused": str(error)}
        except MemoryError:
            answer = {
                "refused": f"{path}: takes more than {MEMORY_LIMIT / 2**30:g} GB of memory; it is "
                "damaged, or must be cut to a part of it, 10 s are enough"
            }
        text = np.frombuffer(json.dumps(answer).encode(), dtype=np.uint8)
        np.savez(result, answer=text, **arrays)


if __name__ == "__main__":
    _main(*sys.argv[1:])
