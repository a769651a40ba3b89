"""Where networks are evaluated changes nothing but the speed: threads, processes, a cluster."""

from __future__ import annotations

import errno
import multiprocessing
import os
import pickle
import random
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import replace

import distributed
import numpy as np
import pytest
from anatomies import NETWORK
from builders import case
from distributed.core import Status

import fascicle
from fascicle.core.errors import FileError, InputError
from fascicle.core.threads import read_shared, write_shared
from fascicle.forward import model as model_module
from fascicle.forward.primitives import His
from fascicle.networks.target_comparison import evaluate, networks
from fascicle.pools import cluster as cluster_module
from fascicle.pools.cluster import Cluster
from fascicle.pools.pool import ExecutorPool, Threads, parts
from tests.dask_processes import LOST, a_local_cluster, a_scheduler, a_worker_of

KILLS = 4


def assert_same(found, expected):
    found = list(found)
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert one.reason == other.reason
        np.testing.assert_array_equal(one.loss, other.loss)
        np.testing.assert_array_equal(one.beat_errors, other.beat_errors)


def evaluated(simulator, recordings, points, pool):
    return list(evaluate(replace(simulator, pool=pool), recordings, points))


def test_threads(simulator, recordings, points, expected):
    assert len({each.loss for each in expected if each.feasible}) == 7
    assert not expected[-1].feasible
    pool = Threads(2)
    for _ in range(2):
        assert_same(evaluated(simulator, recordings, points, pool), expected)


def refuse(point, model):
    raise InputError("this is not to be had")


def test_processes(simulator, recordings, points, expected):
    """The model goes to them once, and further recordings do not send it again.

    Errors arrive as themselves.
    """
    context = multiprocessing.get_context("spawn")
    paced = (replace(recordings[0], scenario=case(his=His())),)
    with ProcessPoolExecutor(2, mp_context=context) as executor:
        pool = ExecutorPool(executor, 2)
        assert_same(evaluated(simulator, recordings, points, pool), expected)
        elsewhere = replace(simulator, pool=pool)
        assert len(list(networks(elsewhere, recordings[0], [NETWORK] * 2))) == 2
        found = evaluated(simulator, paced, points[:2], pool)
        assert_same(found, evaluated(simulator, paced, points[:2], Threads(1)))
        shared = simulator.model, simulator.prior, recordings, simulator.memory
        sent = [id(content) for content, _ in pool._sent]
        assert sent == [*map(id, (*shared, recordings[0], paced))]
        with pytest.raises(InputError, match="not to be had"):
            list(pool.map(refuse, points, simulator.model))


@pytest.mark.parametrize(
    ("count", "workers", "jobs"),
    [(0, 3, 1), (1, 1, 1), (5, 2, 2), (1000, 2, 16), (1000, 64, 125), (1000, 1024, 128)],
)
def test_parts_are_as_many_as_workers_need_and_a_scheduler_passes(count, workers, jobs):
    """In order, and of nearly the same size."""
    found = parts(list(range(count)), workers)
    assert [item for part in found for item in part] == list(range(count))
    assert len(found) == jobs
    sizes = [len(part) for part in found]
    assert max(sizes) - min(sizes) <= 1


def test_threads_of_a_worker_read_one_heart(simulator, tmp_path, monkeypatch):
    file = write_shared(tmp_path / "model", simulator.model)
    reads = []
    load = model_module.from_arrays

    def slowly(*args):
        reads.append(args)
        time.sleep(0.2)
        return load(*args)

    monkeypatch.setattr(model_module, "from_arrays", slowly)
    with ThreadPoolExecutor(4) as threads:
        models = list(threads.map(lambda _: read_shared(file), range(4)))
    assert len(reads) == 1
    assert all(model is models[0] for model in models)


def test_a_shared_file_that_was_changed_is_not_unpickled(tmp_path):
    file = write_shared(tmp_path / "content", ["what workers need"])
    file.path.write_bytes(pickle.dumps(Touching(tmp_path / "run")))
    with pytest.raises(FileError, match="has been changed since it was written for the workers"):
        read_shared(file)
    assert not (tmp_path / "run").exists()
    write_shared(file.path, ["what workers need"])
    assert read_shared(file) == ["what workers need"]


class Touching:
    """Makes a file wherever it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return self.path.touch, ()


def fill(point, model):
    raise OSError("the disk is full")


def pause(point, simulator, recordings):
    """A slow evaluation, in which a worker can be killed."""
    time.sleep(0.2)
    return next(evaluate(simulator, recordings, [point]))


@pytest.fixture(scope="module")
def cluster():
    with a_local_cluster(threads=1) as found:
        yield found


@pytest.fixture
def scheduler(monkeypatch):
    """Give the process of a scheduler without workers, and its address."""
    monkeypatch.setattr(cluster_module, "TIMEOUT", 5)
    with a_scheduler() as found:
        yield found


@pytest.fixture
def connected():
    """Give a function for a cluster at an address, whose client is closed in the end."""
    with ExitStack() as stack:

        def connect(*given):
            pool = Cluster(*given)
            stack.callback(pool.client.close)
            return pool

        yield connect


class TestCluster:
    def test_the_same_as_here(self, cluster, simulator, recordings, points, expected):
        pool = Cluster(cluster.scheduler_address)
        assert pool.workers == 2
        assert_same(evaluated(simulator, recordings, points, pool), expected)
        assert_same(evaluated(simulator, recordings, points, pool), expected)
        assert len(pool._sent) == 4  # the model, its prior, the recordings, and no beats
        with pytest.raises(InputError, match="not to be had"):
            list(pool.map(refuse, points, simulator.model))
        # of the worker, not of the connection: nothing is tried again
        with pytest.raises(OSError, match="the disk is full"):
            list(pool.map(fill, points, simulator.model))

    @pytest.mark.slow
    def test_workers_that_are_killed_and_join_late(
        self, cluster, simulator, recordings, points, expected
    ):
        """Nothing is lost, and nothing is counted twice."""

        def watch(*news):
            waits.append(news)
            assert len(waits) < 300, "no worker is started again"

        waits, rng, killed = [], random.Random(0), []
        pool = Cluster(cluster.scheduler_address, watch)
        ended = threading.Event()

        def kill():
            while len(killed) < KILLS and not ended.is_set():
                time.sleep(rng.uniform(0.3, 1.5))
                # a nanny starts none again that ends before it has said that it runs
                processes = [nanny.process for nanny in list(cluster.workers.values())]
                running = {p.pid for p in processes if p and p.pid and p.status is Status.running}
                if alive := sorted(running.difference(killed)):
                    killed.append(rng.choice(alive))
                    with suppress(ProcessLookupError):
                        os.kill(killed[-1], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        cluster.scale(3)
        many = points * 6
        found = []
        while killer.is_alive() or not found:
            found = list(pool.map(pause, many, simulator, recordings))
        ended.set()
        killer.join()
        assert len(killed) == KILLS
        assert_same(found, expected * 6)

    def test_a_scheduler_that_is_lost(self, scheduler, connected, simulator, points):
        process, address = scheduler
        pool = connected(address)

        def kill():
            while not pool.client.futures:
                time.sleep(0.05)
            process.kill()

        threading.Thread(target=kill).start()
        with pytest.raises(InputError, match=LOST):
            list(pool.map(str, points))  # there is no worker
        process.wait()
        for call in (lambda: pool._send("something else"), lambda: pool.workers):
            with pytest.raises(InputError, match=LOST):
                call()

    def test_a_scheduler_that_is_silent_and_then_lost(self, scheduler, connected, monkeypatch):
        """While results are fetched: it is waited for as long as it is there."""
        monkeypatch.setattr(Cluster, "answer_time", 0.2)
        process, address = scheduler
        seen = []

        def watch(*news):
            seen.append(news)
            process.send_signal(signal.SIGCONT if len(seen) < 4 else signal.SIGKILL)

        pool = connected(address, watch)
        with a_worker_of(address):
            futures = [pool.client.submit(str, number) for number in range(4)]
            while not all(future.done() for future in futures):
                time.sleep(0.05)
            process.send_signal(signal.SIGSTOP)
            assert pool._results(futures) == ["0", "1", "2", "3"]
            assert seen[0] == ("workers", 0, 1, f"{address} does not answer; waiting for it")
            seen[:] = [()] * 3
            process.send_signal(signal.SIGSTOP)
            with pytest.raises(InputError, match=LOST):
                pool._results(futures)

    def test_workers_that_take_no_heart(self, cluster, connected):
        """One line, which does not say that the disk of this machine is full."""

        async def full():
            raise OSError(errno.ENOSPC, "No space left on device")

        with pytest.raises(InputError, match=r"its workers fail \(.*No space left on device"):
            connected(cluster.scheduler_address)._ask(full)

    def test_jobs_that_are_cancelled(self, cluster, connected):
        """By whom ever, while the scheduler is there."""
        pool = connected(cluster.scheduler_address)
        futures = [pool.client.submit(time.sleep, 20, pure=False)]
        threading.Timer(1.0, pool.client.cancel, [futures]).start()
        with pytest.raises(InputError, match=r"jobs were cancelled there .* the same command goes"):
            pool._results(futures)

    @pytest.mark.slow
    def test_a_scheduler_that_is_restarted(
        self, connected, simulator, recordings, points, expected
    ):
        """What was sent to the first is sent again to the second."""
        with a_scheduler() as (process, address):
            pool = connected(address)
            with a_worker_of(address):
                assert_same(evaluated(simulator, recordings, points[:2], pool), expected[:2])
            process.kill()
            process.wait()
        with a_scheduler(address.rpartition(":")[2]), a_worker_of(address):
            until = time.monotonic() + 30
            while pool.client.status != "running" and time.monotonic() < until:
                time.sleep(0.1)
            assert_same(evaluated(simulator, recordings, points[:2], pool), expected[:2])

    def test_a_scheduler_without_workers(self, simulator, recordings, points, expected):
        """It is said once a second that nobody works, until somebody does."""
        seen = []
        with distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None) as empty:
            address = empty.scheduler_address

            def watch(*news):
                seen.append(news)
                if len(seen) == 2:
                    empty.scale(1)

            pool = Cluster(address, watch)
            assert_same(evaluated(simulator, recordings, points[:1], pool), expected[:1])
        assert len(seen) >= 2
        assert seen[0] == ("workers", 0, 1, f"{address} has no worker; waiting for one")
        assert {news[:3] for news in seen} <= {("workers", 0, 1), ("workers", 1, 1)}

    @pytest.mark.parametrize(
        ("address", "message"),
        [
            ("", "is not an address of a Dask scheduler; it prints"),
            ("http://a:1", "is not an address of a Dask scheduler; it prints"),
            ("tcp://a:b", "is not an address of a Dask scheduler; it prints"),
            ("tcp://127.0.0.1:1", r"127.0.0.1:1: no Dask scheduler answers .*; start"),
            ("tls://a:1", r"tls://a:1: no Dask scheduler answers .*TLS"),
        ],
    )
    def test_where_no_scheduler_is(self, address, message, monkeypatch):
        monkeypatch.setattr(cluster_module, "TIMEOUT", 1)
        with pytest.raises(InputError, match=message):
            Cluster(address)


@pytest.mark.slow
def test_a_fit_on_a_cluster_is_that_of_one_machine(cluster, model, recordings, tmp_path):
    """To the last bit, by the command."""
    from fascicle.recording.target_files import write_target

    write_target(recordings[0].target, tmp_path / "target.nc")
    small = ["--effective", "20", "--prior-simulations", "100"]
    small += ["--fix", "conduction=left bundle branch block"]
    found = []
    for name, more in (("here", []), ("there", ["--scheduler", cluster.scheduler_address])):
        folder = tmp_path / name
        asked = ["fit", model.heart.folder, tmp_path / "target.nc", "--out", folder, *small, *more]
        subprocess.run([sys.executable, "-m", "fascicle.cli", *asked], check=True)
        found.append(fascicle.load_study(folder))
    one, other = found
    for name, values in one.population.values.items():
        np.testing.assert_array_equal(values, other.population.values[name])
    np.testing.assert_array_equal(one.population.log_evidences, other.population.log_evidences)
