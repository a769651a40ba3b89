"""One process at a time works on a study."""

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

import fascicle
from fascicle.core.errors import InputError
from fascicle.study.study import HeldError, study_lock

HOLD = (
    "import sys, time; from pathlib import Path; from fascicle.study.study import study_lock\n"
    "with study_lock(Path(sys.argv[1])):\n    print('held', flush=True); time.sleep(60)\n"
)


def test_a_living_process_holds_it_and_a_killed_one_does_not(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(HeldError, match="another process is working on this study"):
            # before it reads the heart and the target, which are not there
            fascicle.fit(tmp_path / "no heart", tmp_path / "no target", tmp_path)
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
    with study_lock(tmp_path):
        pass


def test_an_impossible_fit_leaves_nothing_behind(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="not a study"):
        fascicle.fit(tmp_path / "no heart", tmp_path / "no target", tmp_path)
    with pytest.raises(InputError, match="no such heart"):
        fascicle.fit(tmp_path / "no heart", tmp_path / "no target", tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_block_within_a_block_holds_it_and_another_thread_does_not(tmp_path):
    def take():
        with study_lock(tmp_path):
            return True

    with ThreadPoolExecutor(1) as pool:
        with study_lock(tmp_path):
            with study_lock(tmp_path):
                pass
            with pytest.raises(HeldError):
                pool.submit(take).result()
        assert pool.submit(take).result()
    with pytest.raises(KeyboardInterrupt), study_lock(tmp_path):
        raise KeyboardInterrupt
    assert take()
