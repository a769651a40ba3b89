"""Large objects in files, which worker processes read once."""

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
