"""Efficiency of many workers in prior simulations, by simulation of their schedule.

    python -m benchmarks.schedule [--heart HEART]

Measured on this machine: how long networks of the prior take, on one core, and how many jobs a
second pass through a Dask scheduler (two workers that do nothing). Simulated from these: the prior
simulations of a heart, in parts of 500, on 1 to 1024 workers. Jobs leave one after the other at the
measured rate, the worker that is free first takes the next, and a part ends with its last job.
Efficiency is the time of one worker that waits for nothing over that of all workers together. What
follows in a fit, training and sampling, is for this machine alone.
"""

from __future__ import annotations

import argparse
import heapq
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

import fascicle
from fascicle.emulation.heart_emulator import simulations_of, usual_prior
from fascicle.forward.model import ForwardModel
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.networks.settings import FitSettings
from fascicle.pools.pool import parts

FIRST, NETWORKS = 50, 200  # that prepare every tissue; that are timed
PRIOR = FitSettings().prior_simulations
WORKERS = (1, 2, 16, 64, 256, 1024)
PART = PriorSimulations.part_size
THREADS_TIMED, CALL, ITEMS = 32, PART, 10_000  # threads of idle workers; items a call, and in all


def prior_simulations(heart: str) -> PriorSimulations:
    """Prior simulations of a fit with the default parameters."""
    model = ForwardModel(fascicle.load_heart(heart))
    return simulations_of(model, usual_prior(model.heart), Path())


def network_seconds(prior: PriorSimulations) -> np.ndarray:
    """Seconds that networks of the prior take, each on one core, shape (n,)."""
    seconds = []
    for values in islice(prior.parameters(0), FIRST + NETWORKS):
        began = time.perf_counter()
        prior.model.simulate(values)
        seconds.append(time.perf_counter() - began)
    return np.array(seconds[FIRST:])


def _nothing(item: float, model: ForwardModel) -> float:
    return item


def jobs_a_second(model: ForwardModel) -> float:
    """Jobs a second that pass through a Dask scheduler, to workers that do nothing."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=THREADS_TIMED // 2, dashboard_address=None
    ) as cluster:
        pool = fascicle.Cluster(cluster.scheduler_address)
        list(pool.map(_nothing, [0.5] * 64, model))  # the heart goes to the workers
        began, jobs = time.perf_counter(), 0
        for start in range(0, ITEMS, CALL):
            items = [float(item) for item in range(start, start + CALL)]
            jobs += len(parts(items, pool.workers))
            list(pool.map(_nothing, items, model))
        return jobs / (time.perf_counter() - began)


def round_seconds(seconds: np.ndarray, workers: int, rate: float) -> float:
    """Time at which the last job of a round is done (s).

    Parameters
    ----------
    seconds : (n,) array
        Times of its points (s).
    workers : int
    rate : float
        Jobs that leave a second; inf without a scheduler.
    """
    free = [0.0] * workers
    end = 0.0
    for number, job in enumerate(parts(list(seconds), workers), 1):
        begins = max(heapq.heappop(free), number / rate)
        heapq.heappush(free, begins + sum(job))
        end = max(end, begins + sum(job))
    return end


def prior_seconds(seconds: np.ndarray, workers: int, rate: float) -> float:
    """Time that the prior simulations take (s), one part after the other."""
    rng = np.random.default_rng(0)
    return sum(
        round_seconds(rng.choice(seconds, PART), workers, rate) for _ in range(PRIOR // PART)
    )


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", default="default")
    prior = prior_simulations(parser.parse_args(argv).heart)
    seconds, rate = network_seconds(prior), jobs_a_second(prior.model)
    low, high = 1e3 * np.percentile(seconds, [5, 95])
    print(
        f"a network takes {1e3 * seconds.mean():.0f} ms ({low:.0f} to {high:.0f} in 90 %), and "
        f"{rate:.0f} jobs a second pass through the scheduler"
    )
    print(f"{'workers':>8} {'simulations':>12} {'efficiency':>11} {'if jobs left at once':>21}")
    for workers in WORKERS:
        totals = [prior_seconds(seconds, workers, job_rate) for job_rate in (rate, np.inf)]
        busy = [PRIOR * seconds.mean() / (workers * total) for total in totals]
        print(f"{workers:8} {totals[0]:10.0f} s {busy[0]:11.0%} {busy[1]:21.0%}")


if __name__ == "__main__":
    main()
