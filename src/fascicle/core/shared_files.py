"""Something large in a file, that the workers of other processes read once."""

from __future__ import annotations

import pickle
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

_READING = Lock()


def write_shared(path: Path, content: object) -> Path:
    """Write it for processes that see this file; the path, for `read_shared`."""
    path.write_bytes(pickle.dumps(content))
    return path


def read_shared(path: Path) -> Any:
    """Read it; what this process has read last is remembered."""
    with _READING:  # threads of a worker begin together, and one heart is enough for all
        return _read(path)


@lru_cache(4)  # a model, and the recordings it is compared with, of two studies
def _read(path: Path) -> Any:
    return pickle.loads(path.read_bytes())  # noqa: S301 - written by `write_shared`
