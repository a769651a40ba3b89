"""Ctrl-C and SIGTERM end the program soon, whatever runs, and leave nothing half-written."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

HANG = 60  # s; what ends within two seconds on a quiet machine
NUMBER = {"Ctrl-C": signal.SIGINT, "SIGTERM": signal.SIGTERM}


def interrupted(program, number, folder):
    """Exit status and standard error of a Python program that is sent a signal once it prints."""
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert child.stdout.readline() == "running\n"
    time.sleep(0.2)
    child.send_signal(number)
    _, error = child.communicate(timeout=HANG)
    return child.returncode, error


START = """
import hashlib, os, signal, sys
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the tests run under
import fascicle.cli, fascicle.cli.commands
from fascicle.core.files import atomic_folder, atomic_path

def program(work):
    fascicle.cli.commands.app = work
    fascicle.cli.main()

def minutes_in_compiled_code():
    print("running", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)

"""


@pytest.mark.parametrize(("name", "status"), [("Ctrl-C", 130), ("SIGTERM", 143)])
def test_compiled_code_does_not_hold_it_up(name, status, tmp_path):
    program = """
    def work():
        with atomic_path(Path("result.txt")) as one, atomic_folder(Path("results")) as other:
            one.write_text("half")
            (other / "half.txt").write_text("half")
            minutes_in_compiled_code()

    program(work)
    """
    found = interrupted(START + textwrap.dedent(program), NUMBER[name], tmp_path)
    assert found == (status, "")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", NUMBER)
@pytest.mark.parametrize("waits", ["minutes_in_compiled_code", "signal.pause"])
def test_what_resumes_says_so(name, waits, tmp_path):
    program = f"""
    def work():
        with fascicle.cli.resumable(Path("study")):
            print("running", flush=True)
            {waits}()

    program(work)
    """
    ended = interrupted(START + textwrap.dedent(program), NUMBER[name], tmp_path)
    words = "interrupted; simulations are stored in study; run the same command again to resume\n"
    assert ended == (128 + NUMBER[name], words)


def test_it_may_come_out_of_a_callback_as_another_error(tmp_path):
    """SciPy's differential evolution makes a RuntimeError of what its callback raises."""
    program = """
    def work():
        try:
            print("running", flush=True)
            signal.pause()
        except KeyboardInterrupt as interrupt:
            raise RuntimeError("the map-like callable must be of the form f(func, iterable)")

    program(work)
    """
    assert interrupted(START + textwrap.dedent(program), signal.SIGINT, tmp_path) == (130, "")


def test_such_an_error_without_an_interrupt_is_a_bug_to_be_seen(tmp_path):
    program = START + "def work(): raise RuntimeError('a bug')\nprogram(work)\n"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 1
    assert done.stderr.endswith("RuntimeError: a bug\n")


def test_what_ends_by_itself_is_left_to(tmp_path):
    """The work has its time to clean up; the handlers of before are back afterwards."""
    program = """
    def work():
        try:
            print("running", flush=True)
            signal.pause()
        finally:
            Path("cleaned.txt").write_text("yes")

    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    try:
        program(work)
    except SystemExit as error:
        assert error.code == 130
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
    assert signal.set_wakeup_fd(-1) == -1
    """
    assert interrupted(START + textwrap.dedent(program), signal.SIGINT, tmp_path) == (0, "")
    assert os.listdir(tmp_path) == ["cleaned.txt"]


def test_meshers_do_not_take_it_away(tmp_path):
    """Mmg sets what happens on a signal, and leaves it so."""
    program = """
    import numpy as np, pyvista as pv
    from fascicle.mesh.meshing import remeshed_triangles
    ball = pv.Icosphere(radius=10, nsub=2)
    vertices, triangles = np.array(ball.points, float), np.array(ball.regular_faces)
    try:
        remeshed_triangles(vertices, triangles, np.ones(len(triangles), int), hsiz=4.0)
        print("running", flush=True)
        signal.pause()
    except KeyboardInterrupt:
        sys.exit(5)
    """
    assert interrupted(START + textwrap.dedent(program), signal.SIGINT, tmp_path)[0] == 5


@pytest.mark.slow
def test_a_thousand_stimuli(tmp_path):
    """Rays from each to every vertex: a kernel of half a minute."""
    tables = [
        f"[[stimulus]]\ntime = {k}\nsite = 'segment {1 + k % 17} epicardium'\n" for k in range(1000)
    ]
    (tmp_path / "many.toml").write_text("\n".join(tables))
    words = ["simulate", "default", "--scenario", "many.toml", "--out", "o"]
    run = f"sys.argv[1:] = {words}\nprint('running', flush=True)\nfascicle.cli.main()\n"
    child = subprocess.Popen([sys.executable, "-c", START + run], cwd=tmp_path)
    time.sleep(15)
    child.send_signal(signal.SIGINT)
    assert child.wait(HANG) == 130
    assert os.listdir(tmp_path) == ["many.toml"]
