"""Discrimination of conduction states by an ECG: truths of each state, of another physics.

    python -m benchmarks.conduction_states --heart HEART --out FOLDER [--physics 34] [--fits 0]
                                           [--noise TARGET] [--tuning] [--processes 1]
                                           [--classifier HEART] [--own-mesh]

In each of so many draws of another physics (`benchmarks.calibration`: mesh, fibres, anisotropy,
endocardial layer, junction delays) three networks of each state are drawn from its prior, each in a
torso of its own. The recordings are kept (`000-0-0.nc`: physics, network, state), so that the same
command goes on where it stopped. A heart without a torso has its electrodes moved instead. With
`--tuning` truths are others, to choose constants by. With `--classifier` it is that of another
heart that looks at the recordings, as if that were the patient's. With `--own-mesh` truths are
activated on the heart's mesh, not on a finer one, which takes 20 GB for 36,000 vertices.

Printed are, of the classifier of the heart, every state as probable before: the mean probability of
every state for the truths of each, and how often it is the most probable one; the logarithmic score
(mean logarithm of the probability of the true state), and that of the prior; the expected
calibration error, in ten bins, of the probability of every state and of the most probable one
alone; how often the most probable one is right where it has 0.9 or more; what the conventional
criteria say of the same recordings, and the logarithmic score of the states that met them in
recordings of other physics. The figure (`states.png`) is the reliability diagram.

With `--fits` so many of the recordings, of one state and one physics after the other, are fitted
with default settings (`000-0-0.json`). Printed are how many name a state, how long they take, how
much of the QRS the best networks explain, and, as `benchmarks.calibration` does, how often
intervals of the mixture of states hold the truth, which is kept beside the recordings
(`000-0-0.npz`).
"""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import fascicle
from benchmarks.calibration import (
    HELD_OUT,
    LEVELS,
    MAPPED,
    PREDICTED,
    TUNING,
    another_torso,
    coverage,
    finer,
    fired_together,
    in_processes,
    longest_axis,
    other_physics,
    places,
    predicted_and_map,
    recorded,
    residuals,
    truth_of,
)
from fascicle.cli.output import TerminalProgress
from fascicle.core.conduction_states import told_apart
from fascicle.core.files import write_text
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.emulation.heart_emulator import usual_prior
from fascicle.emulation.state_classifier import classifier_of, probabilities, simulations_of_states
from fascicle.forward.model import ForwardModel
from fascicle.networks.settings import FitSettings
from fascicle.pools.pool import Threads
from fascicle.recording.target_files import read_target, write_target
from fascicle.reporting.style import new_figure, save

STATES = told_apart()
NAMES = tuple(state.name for state in STATES)
NETWORKS = 3  # of each state in a physics
BINS = np.linspace(0, 1, 11)
LEAST_PROBABLE = 1e-3  # lower bound of probabilities in a logarithmic score
SURE = 0.9


def truths_of(number: int, options: argparse.Namespace) -> None:
    """Make the recordings of a draw of another physics."""
    paths = [
        [options.out / f"{number:03d}-{network}-{state}.nc" for state in range(len(STATES))]
        for network in range(NETWORKS)
    ]
    if all(path.exists() for row in paths for path in row):
        return
    threadpool_limits(1)
    gc.collect()  # frees the gigabytes of the last draw
    rng = np.random.default_rng([TUNING if options.tuning else HELD_OUT, number, 1])
    heart = fascicle.load_heart(options.heart)
    plain, axis = ForwardModel(heart), longest_axis(heart)
    mesh = fascicle.load_heart if options.own_mesh else finer
    model, of_all_states = other_physics(options.heart, rng, mesh)
    noise = None if options.noise is None else residuals(read_target(options.noise))
    for row in paths:
        for state, path in zip(STATES, row, strict=True):
            prior = of_all_states.narrowed(state)
            point, simulation = truth_of(model, prior, rng)
            values = prior.from_unit(point)
            true = predicted_and_map(simulation, model.simulate(fired_together(values)), axis)
            if heart.lead_fields is not None:
                simulation = another_torso(plain, simulation, len(heart.vertices), rng, values)
            target = recorded(simulation, FitSettings().gain_sd, rng, noise)
            with path.with_suffix(".npz").open("wb") as file:
                np.savez(file, values=json.dumps(values), predicted=true[0], map=true[1])
            write_target(target, path)


def classified(paths: list[Path], options: argparse.Namespace) -> list[dict[str, Any]]:
    """State probabilities of recordings by a heart's classifier, and the conventional criteria."""
    heart = fascicle.load_heart(options.classifier or options.heart)
    assert heart.folder is not None
    model, count = ForwardModel(heart), FitSettings().prior_simulations
    simulations = simulations_of_states(model, usual_prior(heart), heart.folder, count)
    rows, pool = np.array(INDEPENDENT_ROWS), Threads(options.processes)
    with TerminalProgress() as progress:
        classifier = classifier_of(simulations, rows, heart.folder, count, pool, progress)
    priors = dict.fromkeys(NAMES, 1.0)
    classifications = []
    for path in paths:
        target = read_target(path)
        classifications.append(
            {
                "physics": path.stem[:3],
                "state": NAMES[int(path.stem[-1])],
                "states": probabilities(classifier, simulations, priors, target),
                "criteria": [
                    criterion.name for criterion in target.conventional_criteria if criterion.met
                ],
            }
        )
    return classifications


def one_fit(path: Path, options: argparse.Namespace) -> None:
    """Fit a recording, and keep its verdict and the ranks of the truth."""
    result = path.with_suffix(".json")
    if result.exists():
        return
    threadpool_limits(1)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fitted = fascicle.fit(options.heart, path, Path(folder) / "study", workers=1, progress=None)
        seconds = time.perf_counter() - begun
        networks = fitted.networks(None)
    with np.load(path.with_suffix(".npz")) as kept:
        true = json.loads(str(kept["values"])), kept["predicted"], kept["map"]
    rng, simulator = np.random.default_rng(0), fitted.simulator
    some = [networks[k] for k in rng.permutation(len(networks))[:MAPPED]]
    axis = longest_axis(simulator.model.heart)
    summary = {
        **places(simulator, fitted.population, some, true, axis, rng),
        "verdict": fitted.verdict,
        "explained": None if fitted.checks is None else fitted.checks.explained,
        "converged": fitted.statements.converged,
        "failures": [] if fitted.checks is None else fitted.checks.failures,
        "seconds": seconds,
    }
    write_text(result, json.dumps(summary, indent=1) + "\n")


def summarise_fits(fits: list[dict[str, Any]]) -> None:
    """Print how often fits name a state, and how often their intervals hold the truth."""
    poor = [f["failures"] for f in fits if f["failures"]]
    explained = np.quantile([f["explained"] for f in fits], (0, 0.1, 0.5))
    print(
        f"{len(fits)} fits, {np.mean([f['converged'] for f in fits]):.0%} converged, {len(poor)} "
        "poor; explained {:.0%} (least), {:.0%} (a tenth below), {:.0%} (median); ".format(
            *explained
        )
        + f"{np.median([f['seconds'] for f in fits]):.0f} s on one core (median)"
    )
    print(*poor, sep="\n")
    ranks = {name: np.array([f["ranks"][name] for f in fits]) for name in fits[0]["ranks"]}
    parts = {
        "parameters": [ranks[name] for name in ranks if name not in PREDICTED],
        "predictions": [ranks[name] for name in PREDICTED],
        "TARP": [np.array([f["tarp"] for f in fits])],
    }
    for name, values in parts.items():
        shares = (coverage(np.concatenate(values), level) for level in LEVELS)
        print(f"{name:<14}" + " ".join(f"{share:6.0%}" for share in shares))
    maps = np.mean([f["map"] for f in fits], axis=0)
    print(f"{'map, vertices':<14}" + " ".join(f"{share:6.0%}" for share in maps))


def summarise(results: list[dict[str, Any]], folder: Path) -> None:
    """Print the tables and draw the figure."""
    print(f"{'':<56}" + " ".join(f"{number:>5}" for number in range(len(NAMES))) + "   first")
    for number, name in enumerate(NAMES):
        of_state = [r["states"] for r in results if r["state"] == name]
        if of_state:
            means = " ".join(f"{np.mean([p[other] for p in of_state]):5.2f}" for other in NAMES)
            first = np.mean([max(p, key=p.__getitem__) == name for p in of_state])
            print(f"{number} {name:<54}{means}   {first:4.0%} of {len(of_state)}")
    scored(results, folder / "states.png")
    print(f"logarithmic score by the conventional criteria: {score_of_criteria(results):.2f}")
    for name in NAMES:
        of_state = [r["criteria"] for r in results if r["state"] == name]
        met = Counter(criterion for criteria in of_state for criterion in criteria)
        counts = ", ".join(f"{criterion} {count}" for criterion, count in met.most_common())
        print(f"criteria met by {len(of_state)} of {name}: {counts or 'none'}")


def scored(results: list[dict[str, Any]], path: Path) -> None:
    """Print scores, and draw the reliability diagram."""
    stated = np.array([[r["states"][name] for name in NAMES] for r in results])
    true = np.array([[r["state"] == name for name in NAMES] for r in results])
    score = np.log(np.maximum(stated[true], LEAST_PROBABLE)).mean()
    most, right = stated.max(axis=1), true[np.arange(len(true)), stated.argmax(axis=1)]
    counts, mean, share = binned(stated.ravel(), true.ravel())
    of_most = binned(most, right)
    errors = [
        float((n * np.abs(m - s)).sum() / n.sum()) for n, m, s in ((counts, mean, share), of_most)
    ]
    print(
        f"{len(results)} truths, most probable state right {right.mean():.0%}, logarithmic score "
        f"{score:.2f} (prior {-np.log(len(NAMES)):.2f}), expected calibration error "
        f"{errors[0]:.3f} of all states, {errors[1]:.3f} of the most probable one; {SURE} or more "
        f"in {np.mean(most >= SURE):.0%}, then right {right[most >= SURE].mean():.0%}"
    )
    figure = new_figure(4.0, 4.0)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    filled = counts > 0
    error_bars = np.sqrt(share * (1 - share) / np.maximum(counts, 1))
    axes.errorbar(mean[filled], share[filled], error_bars[filled], fmt="o")
    axes.set_xlabel("probability stated of a state")
    axes.set_ylabel("share of truths that are of it")
    save(figure, path)


def score_of_criteria(results: list[dict[str, Any]]) -> float:
    """Logarithmic score of the states of recordings of other physics that met the same criteria.

    One recording of each state is added, so that no state is impossible.
    """
    logs = []
    for recording in results:
        alike = [
            other["state"]
            for other in results
            if other["criteria"] == recording["criteria"]
            and other["physics"] != recording["physics"]
        ]
        logs.append(np.log((alike.count(recording["state"]) + 1) / (len(alike) + len(NAMES))))
    return float(np.mean(logs))


def binned(stated: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number of probabilities in each bin, their mean, and the share of truths."""
    place = np.clip(np.digitize(stated, BINS) - 1, 0, len(BINS) - 2)
    counts = np.bincount(place, minlength=len(BINS) - 1)
    sums = (np.bincount(place, values, len(BINS) - 1) for values in (stated, true))
    mean, share = (total / np.maximum(counts, 1) for total in sums)
    return counts, mean, share


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--physics", type=int, default=34, help="draws of it")
    parser.add_argument("--fits", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1, help="2 GB each")
    parser.add_argument("--noise", type=Path)
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--classifier", help="heart; by default the same")
    parser.add_argument("--own-mesh", action="store_true", help="for hearts of many vertices")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with TerminalProgress() as progress:
        make = partial(truths_of, options=options)
        in_processes(make, range(options.physics), options.processes, progress, "truths")
    paths = sorted(options.out.glob("*.nc"))
    summarise(classified(paths, options), options.out)
    if options.fits:
        numbers = range(options.fits)
        chosen = [
            options.out / f"{k % options.physics:03d}-{k // options.physics}-{k % len(NAMES)}.nc"
            for k in numbers
        ]
        with TerminalProgress() as progress:
            fit = partial(one_fit, options=options)
            in_processes(fit, chosen, options.processes, progress, "fits")
        fits = [json.loads(path.with_suffix(".json").read_text()) for path in chosen]
        summarise_fits(fits)


if __name__ == "__main__":
    main()
