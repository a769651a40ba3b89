"""One process at a time works on a study."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from filelock import FileLock

import fascicle
from fascicle.core.errors import InputError
from fascicle.study import lock
from fascicle.study.lock import HOLDER, LOCK, LOST, HeldError, study_lock

HOLD = (
    "import sys, time; from pathlib import Path; from fascicle.study.lock import study_lock\n"
    "with study_lock(Path(sys.argv[1])):\n    print('held', flush=True); time.sleep(60)\n"
)


@pytest.fixture
def holder(tmp_path):
    """A process that holds the study."""
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_holder_is_named_and_a_killed_one_is_replaced(tmp_path, holder):
    wanted = f"process {holder.pid} on {socket.gethostname()} is working on this study"
    with pytest.raises(InputError, match=wanted) as caught, study_lock(tmp_path):
        pass
    assert "\n" not in str(caught.value)
    assert "delete" not in str(caught.value)
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    assert (tmp_path / HOLDER).exists()
    with study_lock(tmp_path):
        named = (tmp_path / HOLDER).read_text()
        assert named == f"process {os.getpid()} on {socket.gethostname()}\n"
    assert not (tmp_path / HOLDER).exists()


def test_a_second_fit_is_refused_before_it_reads_anything(tmp_path, holder):
    """The heart and the target, which it would read first, are not there."""
    (tmp_path / "study.json").write_text("{}")
    with pytest.raises(InputError, match=f"process {holder.pid} .* is working on this study"):
        fascicle.fit(tmp_path / "no heart", tmp_path / "no target", tmp_path)


def test_an_impossible_fit_leaves_nothing_behind(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="not a study"):
        fascicle.fit(tmp_path / "no heart", tmp_path / "no target", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(InputError, match="no such heart"):
        fascicle.fit(tmp_path / "no heart", tmp_path / "no target", tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_another_host_holds_it_as_long_as_it_gives_signs_of_life(tmp_path):
    holder = tmp_path / HOLDER
    holder.write_text("process 17 on elsewhere\n")
    now = holder.stat().st_mtime
    os.utime(holder, (now, now - LOST + 30))
    with (
        pytest.raises(HeldError, match=r"process 17 on elsewhere .* 3 minutes until it counts"),
        study_lock(tmp_path),
    ):
        pass
    assert holder.read_text() == "process 17 on elsewhere\n"
    os.utime(holder, (now, now - LOST - 30))
    with study_lock(tmp_path):
        assert holder.read_text() == f"process {os.getpid()} on {socket.gethostname()}\n"
    assert not holder.exists()


def test_who_holds_it_gives_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "BEAT", 0.02)
    with study_lock(tmp_path):
        os.utime(tmp_path / HOLDER, (0, 0))
        until = time.monotonic() + 10
        while not (tmp_path / HOLDER).stat().st_mtime:
            assert time.monotonic() < until
            time.sleep(0.01)
    threads = [each for each in threading.enumerate() if "touch" in each.name]
    assert threads == []


def test_a_lock_that_a_dead_host_still_has_says_how_to_remove_it(tmp_path):
    """As a network file system may keep it."""
    (tmp_path / HOLDER).write_text("process 17 on elsewhere\n")
    remedy = rf"17 on elsewhere is .* that host is surely dead, delete .*{LOCK} and .*{HOLDER}"
    with (
        FileLock(tmp_path / LOCK, is_singleton=False),
        pytest.raises(InputError, match=remedy) as caught,
        study_lock(tmp_path),
    ):
        pass
    assert "\n" not in str(caught.value)


def test_a_block_within_a_block_holds_it_and_another_thread_does_not(tmp_path):
    def take():
        with study_lock(tmp_path):
            return True

    with ThreadPoolExecutor(1) as pool:
        with study_lock(tmp_path):
            with study_lock(tmp_path):
                pass
            assert (tmp_path / HOLDER).exists()
            with pytest.raises(InputError, match="is working on this study"):
                pool.submit(take).result()
        assert pool.submit(take).result()


def test_an_error_releases_it(tmp_path):
    with pytest.raises(KeyboardInterrupt), study_lock(tmp_path):
        raise KeyboardInterrupt
    with study_lock(tmp_path):
        assert (tmp_path / LOCK).exists()
