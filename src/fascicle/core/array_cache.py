"""Disk cache of arrays that take long to compute; its keys are all that they depend on."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path


@dataclass(frozen=True)
class ArrayCache:
    """NPZ files in a folder, named by their kind and a hash of a key and the package version."""

    folder: Path
    kind: str

    def file(self, key: str) -> Path:
        """Path of the arrays that depend on `key`, a text."""
        name = hashlib.sha256(f"{version('fascicle')} {key}".encode()).hexdigest()[:32]
        return self.folder / f"{self.kind}-{name}.npz"

    def read(self, key: str) -> dict[str, NDArray[Any]] | None:
        """Read the arrays; None if there are none, or their file is damaged."""
        try:
            with (
                self.file(key).open("rb") as stream,
                np.load(stream, allow_pickle=False) as content,
            ):
                return {name: content[name] for name in content.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def write(self, key: str, arrays: Mapping[str, Any], *, compress: bool = False) -> None:
        """Write arrays, whole or not at all; OutputError if that fails."""
        save = np.savez_compressed if compress else np.savez
        with atomic_path(self.file(key)) as temporary:
            save(temporary, allow_pickle=False, **arrays)

    def keep(self, key: str, arrays: Mapping[str, Any], most: int | None = None) -> None:
        """Write arrays if possible; of more than `most` files the oldest are deleted."""
        # a full disk, a folder of somebody else, or another process that tidies up
        with suppress(OSError, InputError):
            self.write(key, arrays)
            if most is not None:
                files = self.folder.glob(f"{self.kind}-*.npz")
                for old in sorted(files, key=lambda file: file.stat().st_mtime)[:-most]:
                    old.unlink(missing_ok=True)
