"""Files and folders written atomically, the folder of the user's cache, and arrays kept on disk."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import tempfile
import tomllib
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from fascicle.core.errors import FileError, InputError, OutputError, printable
from fascicle.core.ranges import shown

if TYPE_CHECKING:
    from numpy.typing import NDArray

# hearts: an idealised one, one subject's, and those of the population
PACKAGED = ("default", "camps-dti004", "atlas")
DISPOSABLE = ".fascicle-cache"  # folder of caches: its files can be recomputed
MADE_WITH = "made with fascicle"  # in pictures and meshes
# in every target and page; in other files that a command may replace `MADE_WITH`
FILE_MARKS = {".nc": "fascicle target", ".html": '<meta name="generator" content="fascicle '}
# one of them is in every folder that a command may replace
FOLDER_MARKS = (
    *("heart.toml", "study.json", "summary.json", "origin.json"),
    *(".study.lock", "patients", "own-beat"),  # of a fit, a cohort, the demonstration
)
_unfinished: set[Path] = set()  # temporary files and folders that are being written
_outside_allowed = ContextVar("files may name files outside their folder", default=False)


class DiskFullError(OutputError):
    """A file or a folder could not be written for want of space."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f"{path}: could not be written ({reason}); free some space or choose another place "
            "(--out)"
        )
        self.reason = reason


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path, with the same suffix, that is renamed to `path` on success.

    The temporary file lies in the same folder, so the rename is atomic; on any error, and on
    Ctrl-C, it is removed and an earlier file at `path` stays. Raises OutputError if nothing can be
    written there, or the disk is full.
    """
    check_writable(path)
    with _replaced(path, is_folder=False) as temporary:
        yield temporary
        temporary.chmod(0o644)
        os.replace(temporary, path)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file atomically.

    For netCDF, too: on a full disk HDF5 crashes where it writes the file itself.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def atomic_folder(folder: Path, disposable: Collection[str] = ()) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to `folder` on success.

    A folder that stands there already is replaced only once the new one is complete, and only if
    the new one has every file that the old one has, but those that are `disposable`, so that
    files that others put there are not lost. Raises OutputError if they would be, if `folder` is a
    file, or if the disk is full.
    """
    check_folder(folder)
    folder = folder.resolve()  # a link stays a link
    with _replaced(folder, is_folder=True) as temporary:
        yield temporary
        temporary.chmod(0o755)
        if folder.exists():
            new = {str(path.relative_to(temporary)) for path in temporary.rglob("*")}
            check_nothing_lost(folder, new | set(disposable))
            shutil.rmtree(folder)
        os.replace(temporary, folder)


@contextmanager
def _replaced(path: Path, is_folder: bool) -> Iterator[Path]:
    """Give a temporary file or folder next to `path`, removed afterwards if it is still there.

    DiskFullError names `path`, also where a file in its temporary folder did not fit.
    """
    prefix = f".{path.stem.lstrip('.')}."
    try:
        if is_folder:
            temporary = Path(tempfile.mkdtemp(prefix=prefix, dir=path.parent))
        else:
            handle, name = tempfile.mkstemp(prefix=prefix, suffix=path.suffix, dir=path.parent)
            os.close(handle)
            temporary = Path(name)
        _unfinished.add(temporary)
        try:
            yield temporary
        finally:
            _remove(temporary)
            _unfinished.discard(temporary)
    except DiskFullError as error:
        raise DiskFullError(path, error.reason) from None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        raise DiskFullError(path, os.strerror(error.errno)) from None


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def remove_unfinished() -> None:
    """Remove unfinished files, for a process that is about to end without unwinding."""
    for path in list(_unfinished):
        _remove(path)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, before its content is computed."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; give the path of a folder (--out)")
    if folder.resolve() in (Path.cwd(), *Path.cwd().parents):
        raise OutputError(
            f"{folder}: is the folder you are in, or holds it; give a folder of its own (--out)"
        )
    if folder.is_dir() and not any((folder / mark).exists() for mark in FOLDER_MARKS):
        check_nothing_lost(folder, ())
    check_writable(folder.resolve())


def check_replaceable(path: Path, option: str = "--out") -> None:
    """Refuse a file that cannot be written, or would replace one that fascicle has not written."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; give the path of a file ({option})")
    mark = FILE_MARKS.get(path.suffix.lower(), MADE_WITH)
    if path.exists() and not (path.is_file() and mark.encode() in path.read_bytes()):
        raise OutputError(
            f"{path}: exists, and fascicle has not written it; delete it or give another {option}"
        )
    check_writable(path, option)


def check_writable(path: Path, option: str = "--out") -> None:
    """Make the folder that is to hold `path`, or refuse it; `option` gives another place."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror}); choose another place ({option})"
        ) from None


def check_nothing_lost(folder: Path, new: Collection[str]) -> None:
    """Refuse to replace a folder with files that are not among `new`, relative paths."""
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        if DISPOSABLE not in relative.parts and str(relative) not in new:
            raise OutputError(
                f"{folder}: holds '{relative}', which would be lost; give another --out or empty "
                "the folder"
            )


def as_path(value: object, label: str, needed: str = "a path") -> Path:
    """Check a value that must be a path; `label` and `needed` are for the message."""
    if not isinstance(value, str | os.PathLike) or "\0" in str(value):
        raise FileError(f"{label} is {shown(value)}; give {needed}")
    path = Path(value)
    try:
        path.exists()
    except OSError as error:  # a name that is too long, for one
        raise FileError(f"{shown(str(path))}: {error.strerror} ({label}); check the path") from None
    return path


def check_file(path: Path, formats: Iterable[str], purpose: str) -> None:
    """Refuse a path that is not a file, or whose suffix is none of `formats`, such as ``".csv"``.

    Suffixes of Python pickles, which run code when opened, are never among them. `purpose` says in
    the message what the file is for.
    """
    if not os.path.isfile(path):
        reason = "is a folder, not a file" if os.path.isdir(path) else "no such file"
        raise FileError(f"{path}: {reason} ({purpose}); check the path")
    if path.suffix.lower() not in (formats := tuple(formats)):
        raise FileError(
            f"{path}: cannot read '{path.suffix.lower() or 'no suffix'}' as {purpose}; "
            f"use one of {', '.join(formats)}"
        )


@contextmanager
def outside_allowed() -> Iterator[None]:
    """Let files name files outside their own folder while the block runs.

    Hearts, scenarios and images from others are then trusted: any file that they name is read.

    Examples
    --------
    >>> import fascicle
    >>> with fascicle.outside_allowed():
    ...     heart = fascicle.load_heart("default")
    """
    token = _outside_allowed.set(True)
    try:
        yield
    finally:
        _outside_allowed.reset(token)


def is_outside_allowed() -> bool:
    """True if files may name files outside their own folder now."""
    return _outside_allowed.get()


def named_by(file: Path, name: str) -> Path:
    """Path of a file that another file names, relative to the folder of the latter.

    A path outside that folder, also by a link, is refused unless allowed (`outside_allowed`): a
    file from somebody else must not choose what is read here.
    """
    if "\0" in name:
        raise FileError(f"{file}: names '{printable(name)}', which is no file; correct the name")
    path, folder = file.parent / name, file.parent.resolve()
    if not is_outside_allowed() and folder not in path.resolve().parents:
        raise FileError(
            f"{file}: names '{printable(name)}', which lies outside its folder; copy that file "
            "into the folder, or allow it with --allow-outside (Python: fascicle.outside_allowed())"
        )
    return path


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """Read a TOML file; `remedy` ends the message if it is not valid."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # Notepad writes a BOM
    except (ValueError, RecursionError) as error:  # invalid TOML or UTF-8, or a number too long
        raise FileError(f"{path}: not valid TOML ({error}); {remedy}") from None


def packaged_heart(name: Path | str) -> Path | None:
    """Folder of the packaged heart of this name; None if a local file or folder has the name."""
    if str(name) not in PACKAGED or Path(name).exists():
        return None
    return Path(str(files("fascicle"))) / "data" / "hearts" / str(name)


def user_cache() -> Path:
    """Folder of the cache outside hearts and studies, or FASCICLE_CACHE; it may be deleted."""
    chosen = os.environ.get("FASCICLE_CACHE")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("fascicle"))


@dataclass(frozen=True)
class ArrayCache:
    """NPZ files in a folder, named by their kind and a hash of a key and the package version."""

    folder: Path
    kind: str

    def file(self, key: str) -> Path:
        """Path of the arrays that depend on `key`, a text."""
        from fascicle import __version__

        name = hashlib.sha256(f"{__version__} {key}".encode()).hexdigest()[:32]
        return self.folder / f"{self.kind}-{name}.npz"

    def read(self, key: str) -> dict[str, NDArray[Any]] | None:
        """Read the arrays; None if there are none, or their file is damaged."""
        import numpy as np  # the command line starts without it

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
        import numpy as np  # the command line starts without it

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
