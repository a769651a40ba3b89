"""Files and folders that appear whole or not at all."""

import errno
import os
from pathlib import Path

import pytest

from fascicle.core.errors import OutputError
from fascicle.core.files import atomic_folder, atomic_path, write_text


def test_file_is_replaced_only_at_the_end(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with atomic_path(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert temporary.suffix == ".txt"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_what_fails_leaves_nothing(tmp_path, error):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "summary.json").write_text("old")

    def fail(folder):
        write_text(folder / "summary.json", "new")
        raise error

    def stop(path):
        path.write_text("half")
        raise error

    with pytest.raises(error), atomic_folder(tmp_path / "out") as folder:
        fail(folder)
    with pytest.raises(error), atomic_path(tmp_path / "b.txt") as path:
        stop(path)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "summary.json").read_text() == "old"


def test_folder_is_replaced_whole(tmp_path):
    out = tmp_path / "out"
    for text in ("old", "new"):
        with atomic_folder(out) as folder:
            write_text(folder / "deep" / "a.txt", text)
            write_text(folder / "summary.json", text)
    assert (out / "deep" / "a.txt").read_text() == "new"
    assert list(tmp_path.iterdir()) == [out]


def test_folder_that_would_lose_a_file(tmp_path):
    out = tmp_path / "out"
    (out / "deep").mkdir(parents=True)
    (out / "deep" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="deep"), atomic_folder(out) as folder:
        write_text(folder / "a.txt", "new")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert [p.name for p in out.iterdir()] == ["deep"]


def test_places_that_cannot_be(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file" / "out", tmp_path / "file" / "deep" / "out"):
        with pytest.raises(OutputError):
            write_text(place, "new")
        with pytest.raises(OutputError, match=r"cannot be written .*; choose another place"):
            atomic_folder(place).__enter__()
    monkeypatch.setattr(os, "access", lambda *_: False)  # as in a read-only folder
    with pytest.raises(OutputError, match=r"cannot be written \(Permission denied\); choose"):
        write_text(tmp_path / "new.txt", "new")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_full_disk_is_said_of_what_was_asked_for(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    wanted = r"a.txt: could not be written \(No space left on device\); free some space"
    with pytest.raises(OutputError, match=wanted):
        write_text(tmp_path / "a.txt", "new")
    with (
        pytest.raises(OutputError, match=r"/out: could not be written \(No space"),
        atomic_folder(tmp_path / "out") as folder,
    ):
        write_text(folder / "a.txt", "new")
    assert list(tmp_path.iterdir()) == []
