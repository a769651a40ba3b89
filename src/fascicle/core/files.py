"""Files and folders that appear whole or not at all, and where the user's cache is."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import tomllib
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import platformdirs

from fascicle.core.errors import InputError, printable
from fascicle.core.ranges import shown

CACHE_VARIABLE = "FASCICLE_CACHE"  # environment variable with another folder for the cache
DISPOSABLE = ".fascicle-cache"  # what is in a folder of this name can be computed again
_UNFINISHED: set[Path] = set()  # temporary files and folders that are being written
_OUTSIDE_ALLOWED = ContextVar("files may name files outside their folder", default=False)
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary path, with the same suffix, that takes the place of `path` on success.

    The temporary file lies in the same folder, so the rename is atomic; on any error, and on
    Ctrl-C, it is removed and what stood at `path` stays.

    Raises
    ------
    InputError
        If nothing can be written there, or the disk is full.
    """
    check_writable(path)
    prefix = f".{path.stem.lstrip('.')}."
    with _full_disk_named(path):
        handle, name = tempfile.mkstemp(prefix=prefix, suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        _UNFINISHED.add(temporary)
        try:
            yield temporary
            temporary.chmod(0o644)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
            _UNFINISHED.discard(temporary)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file whole or not at all.

    For netCDF, too: on a full disk HDF5 crashes where it writes the file itself.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def atomic_folder(folder: Path, disposable: Collection[str] = ()) -> Iterator[Path]:
    """Give a temporary folder that takes the place of `folder` on success.

    A folder that stands there already is replaced only once the new one is complete, and only if
    the new one has every file that the old one has: what others put there is not lost.
    Files whose names are `disposable` may go.

    Raises
    ------
    InputError
        If `folder` holds anything that would be lost, or is a file.
    """
    check_folder(folder)
    folder = folder.resolve()  # a link stays a link
    with _full_disk_named(folder):
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        _UNFINISHED.add(temporary)
        try:
            yield temporary
            temporary.chmod(0o755)
            if folder.exists():
                new = {str(path.relative_to(temporary)) for path in temporary.rglob("*")}
                check_nothing_lost(folder, new | set(disposable))
                shutil.rmtree(folder)
            os.replace(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
            _UNFINISHED.discard(temporary)


def remove_unfinished() -> None:
    """Remove what is being written, for a process that is about to end without unwinding."""
    for path in list(_UNFINISHED):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


class _DiskFullError(InputError):
    """A file or a folder could not be written for want of space."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f"{path}: could not be written ({reason}); free some space or choose another place "
            "(--out)"
        )
        self.reason = reason


@contextmanager
def _full_disk_named(path: Path) -> Iterator[None]:
    """Say that the disk is full while `path` is written, also of a file in its temporary folder."""
    try:
        yield
    except _DiskFullError as error:
        raise _DiskFullError(path, error.reason) from None
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        raise _DiskFullError(path, os.strerror(error.errno)) from None


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, before the work that its content takes.

    Raises
    ------
    InputError
        If it is a file, holds the current folder, or lies where nothing can be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; give the path of a folder (--out)")
    if folder.resolve() in (Path.cwd(), *Path.cwd().parents):
        raise InputError(
            f"{folder}: is the folder you are in, or holds it; give a folder of its own (--out)"
        )
    check_writable(folder.resolve())


def check_writable(path: Path, option: str = "--out") -> None:
    """Make the folder that is to hold `path`, or say why that cannot be.

    Parameters
    ----------
    path : Path
        What is to be written.
    option : str
        How the user gives it another place.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose another place ({option})"
        ) from None


def check_nothing_lost(folder: Path, new: Collection[str]) -> None:
    """Refuse to replace a folder that holds what the new one (these relative paths) does not."""
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        if DISPOSABLE not in relative.parts and str(relative) not in new:
            raise InputError(
                f"{folder}: holds '{relative}', which would be lost; give another --out or empty "
                "the folder"
            )


PICKLE_FORMATS = (".pkl", ".pickle", ".npy", ".npz")


def as_path(value: object, what: str, needed: str = "a path") -> Path:
    """A path as it was given, if it can be one.

    Parameters
    ----------
    value : path
        What was given.
    what, needed : str
        What lies there, and what to give, for the message.

    Raises
    ------
    InputError
        If it is no path, or one that no file system takes.
    """
    if not isinstance(value, str | os.PathLike) or "\0" in str(value):
        raise InputError(f"{what} is {shown(value)}; give {needed}")
    path = Path(value)
    try:
        path.exists()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shown(str(path))}: {reason} ({what}); check the path") from None
    return path


def check_file(path: Path, formats: Iterable[str], purpose: str) -> None:
    """Refuse a path that is missing, a folder, a pickle or of another format, in one line.

    Parameters
    ----------
    path : Path
        The file.
    formats : iterable of str
        The suffixes that are read, such as ``".csv"``.
    purpose : str
        What the file holds, for the message.
    """
    formats = tuple(formats)
    suffix = path.suffix.lower()
    if suffix in PICKLE_FORMATS and suffix not in formats:
        raise InputError(
            f"{path}: {suffix} files can hold a Python pickle, which runs code when opened, and "
            f"are never read; in a Python you trust, save the {purpose} as {formats[0]} instead"
        )
    try:
        exists = path.exists()
    except OSError as error:  # a name that is too long, for one
        raise InputError(f"{path}: {error.strerror} ({purpose}); check the path") from None
    if not exists:
        raise InputError(f"{path}: no such file ({purpose}); check the path")
    if not path.is_file():
        raise InputError(f"{path}: is not a file ({purpose}); give the file itself")
    if suffix not in formats:
        raise InputError(
            f"{path}: cannot read '{suffix or 'no suffix'}' as {purpose}; "
            f"use one of {', '.join(formats)}"
        )


@contextmanager
def outside_allowed() -> Iterator[None]:
    """Let files name files outside their own folder while the block runs.

    Hearts, scenarios and images that come from others are then trusted: whatever they name is read.

    Examples
    --------
    >>> import fascicle
    >>> with fascicle.outside_allowed():
    ...     heart = fascicle.load_heart("default")
    """
    token = _OUTSIDE_ALLOWED.set(True)
    try:
        yield
    finally:
        _OUTSIDE_ALLOWED.reset(token)


def is_outside_allowed() -> bool:
    """Whether files may name files outside their own folder now."""
    return _OUTSIDE_ALLOWED.get()


def named_by(file: Path, name: str) -> Path:
    """Path of a file that another file names, from that one's folder.

    Raises
    ------
    InputError
        If it lies outside that folder, also by a link, unless that is allowed
        (`outside_allowed`): a file from somebody else must not choose what is read here.
    """
    if "\0" in name:
        raise InputError(f"{file}: names '{printable(name)}', which is no file; correct the name")
    path, folder = file.parent / name, file.parent.resolve()
    if not is_outside_allowed() and folder not in path.resolve().parents:
        raise InputError(
            f"{file}: names '{printable(name)}', which lies outside its folder; copy that file "
            "into the folder, or allow it with --allow-outside (Python: fascicle.outside_allowed())"
        )
    return path


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """Read a TOML file; `remedy` ends the message where it is none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # Notepad writes a mark
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, of a number too long
        raise InputError(f"{path}: not valid TOML ({error}); {remedy}") from None


def user_cache() -> Path:
    """Folder for what belongs to no heart and no study; it may be deleted at any time."""
    chosen = os.environ.get(CACHE_VARIABLE)
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("fascicle"))
