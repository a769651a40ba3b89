"""Something large in a file, that the workers of other processes read once."""

from __future__ import annotations

import hashlib
import pickle
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

from fascicle.core.errors import FileError

_READING = Lock()


class SharedFile(NamedTuple):
    """A file that `write_shared` has written, and the SHA-256 of its content."""

    path: Path
    digest: str


def write_shared(path: Path, content: object) -> SharedFile:
    """Write it for processes that see this file."""
    pickled = pickle.dumps(content)
    path.write_bytes(pickled)
    return SharedFile(path, hashlib.sha256(pickled).hexdigest())


def read_shared(file: SharedFile) -> Any:
    """Read it; what this process has read last is remembered.

    FileError is that it was changed: to unpickle what somebody else wrote would run their code.
    """
    with _READING:  # threads of a worker begin together, and one heart is enough for all
        return _read(file)


@lru_cache(4)  # a model, and the recordings it is compared with, of two studies
def _read(file: SharedFile) -> Any:
    pickled = file.path.read_bytes()
    found = hashlib.sha256(pickled).hexdigest()
    if found != file.digest:
        raise FileError(
            f"{file.path}: has been changed since it was written for the workers (SHA-256 "
            f"{found[:12]}, not {file.digest[:12]}); see who else writes to the temporary folder"
        )
    return pickle.loads(pickled)  # noqa: S301 - of `write_shared`
