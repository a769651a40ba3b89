"""How well an ECG tells conduction states apart: truths of each, of another physics.

    python -m benchmarks.conduction_states --heart HEART --out FOLDER [--truths 100] [--processes 2]
                                           [--physics other|same] [--noise TARGET]

So many truths of each state are drawn from its prior, with the physics and in the torsos of
`benchmarks.calibration`. Each is fitted with default settings and ``--free conduction``, every
state as probable before. The probabilities are kept (`truth-0007.json`), so that the same command
goes on where it stopped, or adds truths. With `--tuning` truths are others, to choose constants by.

Printed are: the mean probability of every state for the truths of each, and how often it is the
most probable one; the logarithmic score (mean logarithm of the probability of the true state), and
that of the prior; the expected calibration error, in ten bins of the probability of every state;
the same without the fits whose first line names no state; what the conventional criteria say of the
same recordings. The figure (`states.png`) is the reliability diagram.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import fascicle
from benchmarks.calibration import (
    HELD_OUT,
    TUNING,
    another_torso,
    other_physics,
    recorded,
    residuals,
    truth_of,
)
from fascicle.cli.output import TerminalProgress
from fascicle.core.files import write_text
from fascicle.forward.model import ForwardModel
from fascicle.recording.target_files import read_target
from fascicle.reporting.style import new_figure, save
from fascicle.study.conduction_states import STATES
from fascicle.study.population import Posterior
from fascicle.study.settings import FitSettings
from fascicle.study.space import study_space

NAMES = tuple(state.name for state in STATES)
BINS = np.linspace(0, 1, 11)
LEAST_PROBABLE = 1e-3  # what a probability is taken for at least in a logarithmic score


def one_truth(number: int, given: argparse.Namespace) -> dict[str, Any]:
    """Make a truth of the next state in turn, fit it, and say how probable each state is."""
    threadpool_limits(1)
    state = STATES[number % len(STATES)]
    rng = np.random.default_rng([TUNING if given.tuning else HELD_OUT, number, 1])
    heart = fascicle.load_heart(given.heart)
    if given.physics == "other":
        model, space, fixed = other_physics(given.heart, rng)
    else:
        model = ForwardModel(heart)
        space, fixed = study_space("posterior", {}, heart)
    own = state.narrowed(space, fixed)
    assert own is not None
    simulation = truth_of(model, own, fixed | state.blocks, rng)[1]
    if given.physics == "other" and heart.lead_fields is not None:
        simulation = another_torso(ForwardModel(heart), simulation, len(heart.vertices), rng)
    noise = None if given.noise is None else residuals(read_target(given.noise))
    target = recorded(simulation, FitSettings().gain_sd, rng, noise)
    begun = time.perf_counter()
    priors = dict.fromkeys(NAMES, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        fitted = fascicle.fit(
            given.heart, target, Path(folder) / "study", parameters={"conduction": priors},
            prior_simulations=given.prior_simulations, workers=1, seed=number, progress=None,
        )  # fmt: skip
    population = fitted.population
    assert isinstance(population, Posterior)
    return {
        "state": state.name,
        "states": dict(population.states),
        "verdict": fitted.verdict,
        "named": fitted.statements.caution is None,
        "converged": population.converged,
        "criteria": [each.name for each in target.conventional_criteria if each.met],
        "seconds": time.perf_counter() - begun,
    }


def summarise(results: list[dict[str, Any]], folder: Path) -> None:
    """Print the tables and draw the figure."""
    print(f"{'':<56}" + " ".join(f"{number:>5}" for number in range(len(NAMES))) + "   first")
    for number, name in enumerate(NAMES):
        its = [r["states"] for r in results if r["state"] == name]
        if its:
            means = " ".join(f"{np.mean([p[other] for p in its]):5.2f}" for other in NAMES)
            first = np.mean([max(p, key=p.__getitem__) == name for p in its])
            print(f"{number} {name:<54}{means}   {first:4.0%} of {len(its)}")
    scored("all", results, folder / "states.png")
    scored("named", [r for r in results if r["named"]])
    print(f"converged: {np.mean([r['converged'] for r in results]):.0%}")
    print(f"seconds on one core: {np.median([r['seconds'] for r in results]):.0f} (median)")
    for name in NAMES:
        its = [r["criteria"] for r in results if r["state"] == name]
        met = Counter(criterion for criteria in its for criterion in criteria)
        said = ", ".join(f"{criterion} {count}" for criterion, count in met.most_common())
        print(f"criteria met by {len(its)} of {name}: {said or 'none'}")


def scored(label: str, results: list[dict[str, Any]], path: Path | None = None) -> None:
    """Print scores, and draw the reliability diagram."""
    if not results:
        print(f"{label}: none")
        return
    stated = np.array([[r["states"][name] for name in NAMES] for r in results])
    true = np.array([[r["state"] == name for name in NAMES] for r in results])
    score = np.log(np.maximum(stated[true], LEAST_PROBABLE)).mean()
    place = np.clip(np.digitize(stated, BINS) - 1, 0, len(BINS) - 2).ravel()
    counts = np.bincount(place, minlength=len(BINS) - 1)
    mean = np.bincount(place, stated.ravel(), len(BINS) - 1) / np.maximum(counts, 1)
    share = np.bincount(place, true.ravel(), len(BINS) - 1) / np.maximum(counts, 1)
    error = float((counts * np.abs(mean - share)).sum() / counts.sum())
    right = np.mean(stated.argmax(axis=1) == true.argmax(axis=1))
    print(
        f"{label}: {len(results)} truths, most probable one right {right:.0%}, logarithmic score "
        f"{score:.2f} (prior {-np.log(len(NAMES)):.2f}), expected calibration error {error:.3f}"
    )
    if path is None:
        return
    figure = new_figure(4.0, 4.0)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    there = counts > 0
    error_bars = np.sqrt(share * (1 - share) / np.maximum(counts, 1))
    axes.errorbar(mean[there], share[there], error_bars[there], fmt="o")
    axes.set_xlabel("probability stated of a state")
    axes.set_ylabel("share of truths that are of it")
    save(figure, path)


def _run(given: argparse.Namespace, number: int) -> int:
    path = given.out / f"truth-{number:04d}.json"
    write_text(path, json.dumps(one_truth(number, given), indent=1) + "\n")
    return number


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--truths", type=int, default=100, help="of each state")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--physics", choices=["same", "other"], default="other")
    parser.add_argument("--noise", type=Path)
    parser.add_argument("--tuning", action="store_true")
    default = FitSettings.model_fields["prior_simulations"].default
    parser.add_argument("--prior-simulations", type=int, default=default)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    every = range(given.truths * len(NAMES))
    left = [k for k in every if not (given.out / f"truth-{k:04d}.json").exists()]
    with TerminalProgress() as progress, ProcessPoolExecutor(given.processes) as pool:
        for done, _ in enumerate(pool.map(partial(_run, given), left), 1):
            progress("truths", done, len(left), "")
    paths = sorted(given.out.glob("truth-*.json"))
    summarise([json.loads(path.read_text()) for path in paths], given.out)


if __name__ == "__main__":
    main()
