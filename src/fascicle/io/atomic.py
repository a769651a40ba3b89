"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fascicle.errors import InputError


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path, with the same suffix, that takes the place of `path` on success.

    The temporary file lies in the same folder, so the rename is atomic; on any error, and on
    Ctrl-C, it is removed and what stood at `path` stays.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder that takes the place of `folder` on success.

    A folder that stands there already is replaced only once the new one is complete, and only if
    the new one has every file that the old one has: what somebody else put there is not lost.

    Raises
    ------
    InputError
        If `folder` holds anything that would be lost, or is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; give the path of a folder (--out)")
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield temporary
        temporary.chmod(0o755)
        if folder.exists():
            _check_nothing_lost(folder, temporary)
            shutil.rmtree(folder)
        os.replace(temporary, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _check_nothing_lost(old: Path, new: Path) -> None:
    for path in sorted(old.rglob("*")):
        if not (new / path.relative_to(old)).exists():
            raise InputError(
                f"{old}: holds '{path.relative_to(old)}', which would be lost; give another --out "
                "or empty the folder"
            )
