"""Reading in a child process: what comes back, and that no file can do this process harm."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from fascicle.core import isolated
from fascicle.core.errors import InputError
from fascicle.core.isolated import read_isolated
from fascicle.recording.recording import MissingMetadataError

ARRAYS = {
    "numbers": np.arange(6.0).reshape(2, 3),
    "none": np.empty((0, 3), np.int32),
    "one": np.array(7, dtype=">i2"),
    "texts": np.array(["a", "bcd"]),
    "columns": np.arange(6, dtype=np.uint8).reshape(2, 3, order="F"),
}


def everything(path, factor):
    """A reader that is found by its name in the child."""
    assert path.exists()
    return {"arrays": dict(ARRAYS), "list": [ARRAYS["one"], np.float32(0.5) * factor, None, "ä\0"]}


def process(path):
    return os.getpid()


def crashed(path):
    os.kill(os.getpid(), signal.SIGSEGV)


def aborted(path):
    os.write(2, b"terminate called after throwing an instance of 'std::bad_alloc'\n")
    os.abort()


def endless(path):
    while True:
        pass


def printing(path):
    os.write(1, b"rubbish" * 1000)
    sys.stdout.write("rubbish")
    sys.stdout.flush()
    return 1


def greedy(path):
    return np.empty(2**28).size  # 2 GB


def asleep(path):
    time.sleep(60)


def broken(path):
    return path.no_such_attribute


def refusing(path):
    try:
        broken(path)
    except AttributeError as error:
        raise InputError(f"{path}: damaged") from error


def missing(path):
    raise MissingMetadataError(f"{path}: no unit", "unit", "mV", "a guess")


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"1")
    return path


def test_plain_data_and_arrays_come_back(path):
    found = read_isolated(everything, path, factor=3)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found["arrays"][name], array)
        assert found["arrays"][name].dtype == array.dtype
        assert found["arrays"][name].shape == array.shape
    assert found["list"] == [7, 1.5, None, "ä\0"]


def test_one_child_reads_many_files_but_not_after_a_large_one(path, monkeypatch):
    first = read_isolated(process, path)
    assert first != os.getpid()
    assert read_isolated(process, path) == first
    monkeypatch.setattr(isolated.Limits, "large", 0)
    assert read_isolated(process, path) == first
    assert read_isolated(process, path) != first


@pytest.mark.parametrize(
    ("reader", "words"),
    [
        (crashed, "the library that reads it crashed (status -11)"),
        (aborted, "takes more than 1.5 GB of memory"),
        (greedy, "takes more than 1.5 GB of memory"),
    ],
)
def test_crash_and_want_of_memory_are_refusals(path, reader, words):
    with pytest.raises(InputError) as info:
        read_isolated(reader, path)
    assert str(info.value).startswith(f"{path}: ")
    assert words in str(info.value)
    assert read_isolated(process, path)


def test_larger_files_may_take_more(path):
    with path.open("r+b") as file:
        file.truncate(30 * 2**20)
    assert read_isolated(greedy, path) == 2**28


@pytest.mark.parametrize(("reader", "seconds"), [(endless, 1.0), (asleep, 0.2)])
def test_what_does_not_end_is_a_refusal(path, monkeypatch, reader, seconds):
    monkeypatch.setattr(isolated.Limits, "least_seconds", seconds)
    monkeypatch.setattr(isolated.Limits, "least_patience", 0.0)
    with pytest.raises(InputError, match=f"not read within {seconds:.0f} s of computing"):
        read_isolated(reader, path)


def test_bugs_stay_loud(path):
    with pytest.raises(RuntimeError, match="no_such_attribute"):
        read_isolated(broken, path)


def test_what_made_a_refusal_is_its_note(path):
    """The user sees one line, a developer where it comes from."""
    with pytest.raises(InputError) as info:
        read_isolated(refusing, path)
    assert str(info.value) == f"{path}: damaged"
    assert "in broken" in info.value.__notes__[0]
    assert "no_such_attribute" in info.value.__notes__[0]


def test_refusals_keep_their_attributes(path):
    with pytest.raises(MissingMetadataError, match="no unit") as info:
        read_isolated(missing, path)
    assert (info.value.name, info.value.guess) == ("unit", "mV")


def test_what_is_printed_is_no_answer(path, capfd):
    assert read_isolated(printing, path) == 1
    assert capfd.readouterr() == ("", "")


def test_interruption_ends_the_child(path):
    """What it says later must not be taken for the answer to the next request."""
    before = read_isolated(process, path)
    # a shell starts what runs in the background with interruptions ignored
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        read_isolated(asleep, path)
    signal.signal(signal.SIGINT, handler)
    assert read_isolated(process, path) != before


def test_a_relative_path_begins_where_this_process_is(tmp_path, monkeypatch):
    """Also when the child was started elsewhere."""
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.bin").write_bytes(name.encode())
        monkeypatch.chdir(tmp_path / name)
        assert read_isolated(size, Path("a.bin")) == len(name)


def test_child_that_is_gone_is_replaced(path):
    before = read_isolated(process, path)
    os.kill(before, signal.SIGKILL)
    time.sleep(0.2)
    assert read_isolated(process, path) != before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_forked_process_has_a_child_of_its_own(path):
    mine = read_isolated(process, path)
    pid = os.fork()
    if not pid:
        os._exit(read_isolated(process, path) == mine)
    assert os.waitpid(pid, 0)[1] == 0
    assert read_isolated(process, path) == mine


def test_threads_do_not_get_each_others_answers(tmp_path):
    paths = [tmp_path / f"{k}.bin" for k in range(4)]
    for k, one in enumerate(paths):
        one.write_bytes(bytes(k))
    found = {}

    def read(one):
        found[one] = [read_isolated(size, one) for _ in range(20)]

    threads = [threading.Thread(target=read, args=(one,)) for one in paths]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {one: [k] * 20 for k, one in enumerate(paths)}


def size(path):
    return path.stat().st_size
