"""How well a fit keeps many workers busy, by simulation of its schedule from measured parts.

    python -m benchmarks.schedule [--heart HEART]

Measured on this machine, on one core: how long networks of the prior take, how long the sampler
thinks between two rounds, how many jobs a second pass through a Dask scheduler (two workers that do
nothing). Simulated from these: a fit with 8000 networks of the prior and 10,000 more, which is what
recorded ECGs take, in rounds of 1000 points, on 1 to 1024 workers. Jobs leave one after the other
at the measured rate, the worker that is free first takes the next, and a round ends with its last
job. Efficiency is the time of one worker that waits for nothing over that of all workers together.

Then a cohort of 256 such fits, each on 16 threads of a worker of its own, the next patient wherever
a worker is free first.
"""

from __future__ import annotations

import argparse
import heapq
import time
from collections.abc import Sequence

import numpy as np

import fascicle
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.core.threads import one_thread
from fascicle.forward.model import ForwardModel
from fascicle.inference.importance_sampling import BATCH, sampling
from fascicle.recording.target import Target
from fascicle.study.pool import parts
from fascicle.study.posterior import RUNS
from fascicle.study.prior_simulations import prior_points
from fascicle.study.simulator import PointSimulator
from fascicle.study.space import study_space
from fascicle.study.target_comparison import TargetComparison, evaluate

NETWORKS = 200  # that are timed
PRIOR, EVALUATIONS = 8000, 10_000  # of a fit
WORKERS = (1, 2, 16, 64, 256, 1024)
THREADS_TIMED, CALL, ITEMS = 32, 1000, 10_000  # threads of idle workers; items a call, and in all
PATIENTS, THREADS = 256, 16


def the_problem(heart: str) -> tuple[PointSimulator, TargetComparison]:
    """A target of the example network, with the default parameters to learn."""
    model = fascicle.ForwardModel(fascicle.load_heart(heart))
    ecg = model.simulate(fascicle.example_parameters(model) | EXAMPLE_PARAMETERS).leads
    beat = np.pad(ecg, ((0, 0), (40, 40)))
    beats = beat + 0.02 * np.random.default_rng(0).normal(size=(10, *beat.shape))
    times = np.arange(beat.shape[1]) - 60.0
    space, fixed = study_space("posterior", {}, model.heart)
    target = Target(beats, times, -20.0, 60.0, 60.0)
    return PointSimulator(model, space, fixed), TargetComparison(target)


def network_seconds(simulator: PointSimulator, comparison: TargetComparison) -> np.ndarray:
    """Seconds that networks of the prior take, each on one core, shape (n,)."""
    points = prior_points(len(simulator.space), NETWORKS + 1)
    seconds = []
    for point in points:
        began = time.perf_counter()
        list(evaluate(simulator, [comparison], [point]))
        seconds.append(time.perf_counter() - began)
    return np.array(seconds[1:])  # the first compiles


@one_thread
def thinking_seconds(dimension: int) -> list[float]:
    """Seconds that a run of the sampler thinks after each round, on a rugged posterior."""
    prior = prior_points(dimension, PRIOR)[::RUNS]
    each = EVALUATIONS // RUNS
    run = sampling(np.random.default_rng(0), prior, effective=each, most=each)
    points, seconds = next(run), []
    try:
        while True:
            values = -0.5 * (((points - 0.6) / 0.2) ** 2).sum(axis=1) + np.sin(90 * points).sum(1)
            began = time.perf_counter()
            points = run.send(values)
            seconds.append(time.perf_counter() - began)
    except StopIteration:
        seconds.append(time.perf_counter() - began)
    return seconds[1:]  # the first imports


def _nothing(item: float, model: ForwardModel) -> float:
    return item


def jobs_a_second(model: ForwardModel) -> float:
    """How many jobs a second pass through a Dask scheduler, to workers that do nothing."""
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
    """When the last of a round's jobs is done (s).

    Parameters
    ----------
    seconds : (n,) array
        That its points take.
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


def fit_seconds(seconds: np.ndarray, thinking: float, workers: int, rate: float) -> float:
    """How long a fit takes (s), a round of its two runs after the other."""
    rng, total, size = np.random.default_rng(0), 0.0, RUNS * BATCH
    for count in (PRIOR, *[size] * (EVALUATIONS // size)):
        total += round_seconds(rng.choice(seconds, count), workers, rate) + RUNS * thinking
    return total


def cohort_seconds(of_a_fit: float, workers: int) -> float:
    """How long a cohort takes (s): patients one after the other on every worker."""
    rng = np.random.default_rng(0)
    free = [0.0] * workers
    for length in of_a_fit * rng.uniform(0.5, 2.0, PATIENTS):  # fits end sooner or later
        heapq.heappush(free, heapq.heappop(free) + length)
    return max(free)


def table(seconds: np.ndarray, thinking: float, rate: float) -> None:
    """Print how long a fit takes and how busy workers are, with and without a scheduler."""
    work = (PRIOR + EVALUATIONS) * seconds.mean()
    print(f"{'workers':>8} {'fit':>9} {'efficiency':>11} {'if jobs left at once':>21}")
    for workers in WORKERS:
        taken = [fit_seconds(seconds, thinking, workers, each) for each in (rate, np.inf)]
        busy = [work / (workers * each) for each in taken]
        print(f"{workers:8} {taken[0]:7.0f} s {busy[0]:11.0%} {busy[1]:21.0%}")
    alone = fit_seconds(seconds, thinking, THREADS, np.inf)
    for workers in (4, 64):
        taken = cohort_seconds(alone, workers)
        share = work / (THREADS * alone) * cohort_seconds(alone, 1) / (workers * taken)
        print(
            f"{PATIENTS} fits on {workers} workers of {THREADS} threads: {taken / 60:.0f} min, "
            f"efficiency {share:.0%}"
        )


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", default="default")
    given = parser.parse_args(argv)
    simulator, comparison = the_problem(given.heart)
    seconds = network_seconds(simulator, comparison)
    thinking = thinking_seconds(len(simulator.space))
    rate = jobs_a_second(simulator.model)
    low, high = 1e3 * np.percentile(seconds, [5, 95])
    print(
        f"a network takes {1e3 * seconds.mean():.0f} ms ({low:.0f} to {high:.0f} in 90 %), a run "
        f"thinks {1e3 * np.mean(thinking):.0f} ms after a round, and {rate:.0f} jobs a second pass "
        "through the scheduler"
    )
    table(seconds, float(np.mean(thinking)), rate)


if __name__ == "__main__":
    main()
