"""A Dask scheduler and its workers, in processes that a test can stop and kill."""

import subprocess
import sys
from contextlib import contextmanager

import pytest

LOST = r"^tcp://\S+: the Dask scheduler was lost; what is evaluated is kept: start it again"


@contextmanager
def a_scheduler(port="0"):
    """Give the process of a scheduler without workers, and its address."""
    with _process("scheduler", "--port", port) as process:
        yield process, _last_word(process, "Scheduler at:")


@contextmanager
def a_worker_of(address, threads=1):
    with _process("worker", address, "--no-nanny", "--nthreads", f"{threads}") as process:
        _last_word(process, "Registered to:")
        yield


@contextmanager
def a_local_cluster(threads):
    """Give a cluster of two processes that starts each again that is killed.

    It gives up a worker who is not there 15 s after it was lost, if it is not told otherwise:
    under load a new process takes longer.
    """
    distributed = pytest.importorskip("distributed")
    import dask

    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1 hour"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=threads, processes=True, dashboard_address=None
        ) as found,
    ):
        yield found


@contextmanager
def _process(kind, *options):
    with subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options, "--no-dashboard"],
        stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def _last_word(process, text):
    """Wait until a process says something; the last word of the line."""
    return next(line.split()[-1] for line in process.stderr if text in line)
