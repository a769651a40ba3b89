"""A study comes to the same result whatever happens to its process, its disk and its files."""

import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fascicle import cli
from fascicle.core.errors import InputError
from fascicle.study.evaluations import DamagedStoreError, Database, interrupted_afterwards
from fascicle.study.study import Study, StudyFile
from tests.study.crashing import killed_at_random
from tests.study.test_study_folder import make_config, objective, outcome, summary

FORK = multiprocessing.get_context("fork")
STORE = "evaluations.sqlite"
CONFIG = make_config(initial=80)  # so that the store has a few pages


def run(folder, evaluate=objective):
    study = Study.create_or_resume(folder, CONFIG)
    return study.run(evaluate)


def everything(folder):
    study = Study.open(folder)
    return summary(study, study.run(objective))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A study that nothing happened to."""
    folder = tmp_path_factory.mktemp("whole") / "study"
    run(folder)
    return folder


def test_kill_at_20_random_moments(tmp_path, whole):
    finished = killed_at_random(run, tmp_path, kills=20, longest=0.9, seed=0)
    assert len(finished) >= 1
    for folder in finished:
        assert everything(folder) == everything(whole)
        assert {path.name for path in folder.iterdir()} == {"study.json", STORE, StudyFile.LOCK}


# --- Ctrl-C


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """Hear Ctrl-C, which a process in a shell's background ignores."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_finishes_what_runs(tmp_path, whole):
    folder = tmp_path / "s"
    begun = FORK.Value("i", 0)

    def slow(points):
        for point in points:
            begun.value += 1
            time.sleep(0.1)
            yield from objective([point])

    process = FORK.Process(target=run, args=(folder, slow))
    process.start()
    while begun.value < 3:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGINT)
    process.join(5)
    assert process.exitcode == 1  # of a Python that was interrupted
    assert len(Study.open(folder).records()) == begun.value == 3
    run(folder)
    assert everything(folder) == everything(whole)


def interrupt(times, then):
    """Press Ctrl-C so many times while a block runs that ends with `then`."""
    with interrupted_afterwards():
        for _ in range(times):
            signal.raise_signal(signal.SIGINT)
        then()


def test_a_second_ctrl_c_does_not_wait_and_errors_are_not_hidden():
    done = []
    with pytest.raises(KeyboardInterrupt):
        interrupt(1, lambda: done.append("after one"))
    with pytest.raises(KeyboardInterrupt):
        interrupt(2, lambda: done.append("after two"))
    assert done == ["after one"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(ZeroDivisionError):
        interrupt(1, lambda: 1 / 0)


def test_ctrl_c_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("fascicle.fit", interrupted)
    out = str(tmp_path / "s")
    monkeypatch.setattr(sys, "argv", ["fascicle", "fit", "default", "target.nc", "--out", out])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 130
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"stored in {out}; run the same command again" in error


# --- disks


def refusal(folder, before):
    """What a run says that is refused, in a process in which `before` was called."""
    ours, theirs = FORK.Pipe()

    def attempt():
        before()
        try:
            run(folder)
            theirs.send("nothing was refused")
        except InputError as error:
            theirs.send(str(error))

    process = FORK.Process(target=attempt)
    process.start()
    process.join(20)
    assert process.exitcode == 0
    return ours.recv()


@pytest.mark.parametrize("size", [100, 17_000])
def test_a_full_disk(tmp_path, whole, size):
    """No file may grow beyond `size` bytes: the configuration, the empty tables, some rows."""
    folder = tmp_path / "s"
    said = refusal(folder, lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)))
    assert "\n" not in said
    assert "space" in said
    assert str(folder) in said
    run(folder)
    assert everything(folder) == everything(whole)


def test_a_read_only_folder():
    with tempfile.TemporaryDirectory() as parent:  # pytest's folders are closed to other users
        folder = Path(parent) / "s"
        run(folder)
        before = {path.name: path.read_bytes() for path in folder.iterdir()}
        for path in (parent, folder):
            os.chmod(path, 0o555)
        # root may write everywhere, so in its place nobody does it
        become = (lambda: os.setuid(65534)) if os.geteuid() == 0 else (lambda: None)
        try:
            for place in (folder, Path(parent) / "new"):
                said = refusal(place, become)
                assert "\n" not in said
                assert f"{place}: cannot be written (Permission denied)" in said
                assert "give another folder (out)" in said
            assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
        finally:
            for path in (parent, folder):
                os.chmod(path, 0o755)


# --- a damaged store


@pytest.fixture
def study(tmp_path, whole):
    """A copy of the study that nothing has happened to yet."""
    return Path(shutil.copytree(whole, tmp_path / "s"))


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"not a database" * 100,
        lambda content: content[: len(content) // 2],
        lambda content: content[:4096] + np.random.default_rng(0).bytes(4096) + content[8192:],
    ],
    ids=["no database", "cut off", "page of rubbish"],
)
def test_a_damaged_store_is_moved_aside_and_said(study, whole, damage):
    damaged = damage((study / STORE).read_bytes())
    (study / STORE).write_bytes(damaged)
    with pytest.raises(DamagedStoreError, match=r"damaged \(.*; run 'fascicle fit'"):
        Database(study / STORE)._make_tables()
    said = []
    again = Study.create_or_resume(study, CONFIG, lambda *news: said.append(news))
    assert said[0][0] == "repair"
    assert "is now evaluations.damaged.sqlite" in said[0][-1]
    assert (study / "evaluations.damaged.sqlite").read_bytes() == damaged
    assert again.records() == []
    assert outcome(again.run(objective)) == outcome(Study.open(whole).run(objective))


def test_damage_is_said_in_one_line_wherever_it_is(study):
    """Also in texts, which then are no UTF-8, and where pages and tables are described."""
    rng = np.random.default_rng(0)
    whole = np.frombuffer((study / STORE).read_bytes(), dtype=np.uint8)
    said = set()
    for trial in range(30):
        content = whole.copy()
        reach = len(content) if trial % 2 else 4 * 4096
        content[rng.integers(reach, size=10)] = rng.integers(256, size=10)
        (study / STORE).write_bytes(content)
        database = Database(study / STORE)
        for read in (database._make_tables, database.records):
            try:
                read()
            except InputError as error:
                said.add(str(error))
        database.prepare()
        database.records()
    assert len(said) > 5
    assert all(each.isprintable() for each in said)


def test_what_killed_runs_left_is_removed(study):
    for name in (".study.a.json", ".posterior.b.nc", ".mine"):
        (study / name).write_text("half")
    (study / ".networks.c").mkdir()
    Study.create_or_resume(study, CONFIG)
    assert {path.name for path in study.iterdir()} == {"study.json", STORE, StudyFile.LOCK, ".mine"}
