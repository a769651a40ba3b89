"""Patients on the workers of a Dask cluster, which are killed."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from functools import partial

import numpy as np
import pytest

import fascicle
from fascicle.core.errors import InputError, OutputError
from fascicle.patients.patient import Status, read_table
from tests.dask_processes import LOST, a_local_cluster, a_scheduler, a_worker_of

distributed = pytest.importorskip("distributed")
# so that a worker can be killed within
LONGER = {"heart": "default", "method": "posterior", "effective": "20", "prior_simulations": "100"}


@pytest.fixture(autouse=True)
def as_many_particles_as_on_workers(monkeypatch):
    from fascicle.study.methods import PosteriorFit

    monkeypatch.setattr(PosteriorFit, "least_particles", 600)
    monkeypatch.setattr(PosteriorFit, "most_batches", 16)


@pytest.fixture(scope="module")
def address():
    with a_local_cluster(threads=2) as found:
        yield found.scheduler_address


@pytest.fixture
def workers(monkeypatch):
    """Those that are lost, or wait for one another, are tried again soon, and not often."""
    from fascicle.patients import workers

    soon = partial(workers.fit_on_workers, attempts=3, pause=0.5)
    monkeypatch.setattr(workers, "fit_on_workers", soon)
    return workers


def kill_at_work(client):
    """Kill the workers that fit a patient now; how many there were."""
    pids = client.run(os.getpid)
    busy = [pids[address] for address, tasks in client.processing().items() if tasks]
    for pid in busy:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return len(busy)


def kill_first_at_work(address, folder, killed):
    """Kill the first worker that has stored evaluations of a study."""
    while not (folder / "evaluations.sqlite").exists():
        time.sleep(0.05)
    with distributed.Client(address, set_as_default=False) as client:
        killed.append(kill_at_work(client))


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_nothing_but_time(address, workers, table, tmp_path):
    """Same bits as here; a bad file stops nobody there either."""
    path, killed = table("anna", "bert", **LONGER), []
    out = tmp_path / "out"
    study = out / "studies" / "anna"
    killer = threading.Thread(target=kill_first_at_work, args=(address, study, killed))
    killer.start()
    found = fascicle.cohort(path, out, cluster=fascicle.Cluster(address))
    killer.join()
    assert killed in ([1], [2])  # bert may be at work, too
    assert {each.patient: str(each.status) for each in found} == {
        "anna": "fitted",
        "bert": "failed",
    }
    assert (study / "report.html").stat().st_size > 1e5
    row, _ = read_table(path, out)
    alone = fascicle.fit("default", row.recording, tmp_path / "here", **row.settings)
    there = fascicle.load_study(study)
    np.testing.assert_array_equal(alone.population.losses, there.population.losses)
    for key, values in alone.population.values.items():
        np.testing.assert_array_equal(values, there.population.values[key])


@pytest.mark.slow
def test_a_patient_who_loses_every_worker_is_given_up(address, workers, table, tmp_path):
    ended = threading.Event()

    def kill():
        with distributed.Client(address, set_as_default=False) as client:
            while not ended.is_set():
                with contextlib.suppress(OSError, KeyError):
                    kill_at_work(client)
                time.sleep(0.1)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        (found,) = fascicle.cohort(
            table("anna", **LONGER), tmp_path / "out", cluster=fascicle.Cluster(address)
        )
    finally:
        ended.set()
        killer.join()
    assert found.status is Status.FAILED
    assert "its worker was lost 3 times" in found.reason
    assert "lost 3 times" in (tmp_path / "out" / "results.csv").read_text()


@pytest.mark.slow
def test_a_fit_for_which_nobody_waits_ends(address, workers, table, tmp_path):
    """And the next run goes on with it."""
    path, out = table("anna", **LONGER), tmp_path / "out"

    def interrupted(stage, done, total, message):
        if (out / "studies" / "anna" / "evaluations.sqlite").exists():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fascicle.cohort(path, out, cluster=fascicle.Cluster(address), progress=interrupted)
    until = time.monotonic() + 60
    with distributed.Client(address, set_as_default=False) as client:
        while any(client.processing().values()):
            assert time.monotonic() < until
            time.sleep(0.1)
    assert not (out / "patients" / "anna" / "outcome.json").exists()
    assert not (out / "studies" / "anna" / "population.nc").exists()
    assert "1 not done yet" in (out / "index.html").read_text()


def test_a_worker_that_does_not_see_the_folder(tmp_path, workers, table):
    (one,) = read_table(table("anna"), tmp_path / "out")
    with pytest.raises(OutputError, match="out: not seen by the worker on"):
        workers._check_seen(one, patience=0.1)


def test_such_a_worker_stops_all(address, workers, table, tmp_path, monkeypatch):
    """What it raises is no patient's."""
    monkeypatch.setattr(workers, "_fit_here", refuse)
    with pytest.raises(InputError, match="not seen"):
        fascicle.cohort(table("anna"), tmp_path / "out", cluster=fascicle.Cluster(address))
    assert not (tmp_path / "out" / "patients" / "anna").exists()


def refuse(*_):
    raise InputError("not seen")


@pytest.mark.slow  # two minutes of waiting
def test_a_scheduler_that_is_lost_while_a_patient_is_fitted(table, tmp_path):
    """One line, and the next one goes on with what was evaluated."""
    out = tmp_path / "out"
    stored = out / "studies" / "anna" / "evaluations.sqlite"
    with a_scheduler() as (process, address), a_worker_of(address, threads=2):

        def kill():
            while not stored.exists():
                time.sleep(0.05)
            process.kill()

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        with pytest.raises(InputError, match=LOST):
            fascicle.cohort(table("anna", **LONGER), out, cluster=fascicle.Cluster(address))
        killer.join()
    found = fascicle.cohort(out.parent / "patients.csv", out)
    assert [str(each.status) for each in found] == ["fitted"]
