"""Something large in a file, that the workers of other processes read once."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path
from typing import Any, NamedTuple

from fascicle.core.errors import FileError
from fascicle.core.threads import made_once


class SharedFile(NamedTuple):
    """A file that `write_shared` has written, and the SHA-256 of its content."""

    path: Path
    digest: str


def write_shared(path: Path, content: object) -> SharedFile:
    """Write it for processes that see this file."""
    pickled = pickle.dumps(content)
    path.write_bytes(pickled)
    return SharedFile(path, hashlib.sha256(pickled).hexdigest())


def _read(file: SharedFile) -> Any:
    """Read it; FileError is that it was changed: to unpickle it could then run another's code."""
    pickled = file.path.read_bytes()
    found = hashlib.sha256(pickled).hexdigest()
    if found != file.digest:
        raise FileError(
            f"{file.path}: has been changed since it was written for the workers (SHA-256 "
            f"{found[:12]}, not {file.digest[:12]}); see who else writes to the temporary folder"
        )
    return pickle.loads(pickled)  # noqa: S301 - of `write_shared`


# What this process has read last is remembered: a model, and the recordings it is compared with, of
# two studies. Threads of a worker begin together, and one heart is enough for all.
read_shared = made_once(_read, 4)
