"""How long the first answer on a heart of one's own takes, and how much few simulations teach.

    python -m benchmarks.first_answer times HEART TARGET --out FOLDER [--against CHECKOUT]
    python -m benchmarks.first_answer learning HEART --out FOLDER

``times`` runs `fascicle fit` on a copy of a heart without anything that was made for it before (the
first fit), then again with other random numbers, then with normal conduction given. With another
checkout the same is done with its code, and ratios are printed. ``learning`` prints the error of
emulators of the normal state, begun with the atlas's and at random, on the last 2000 of 8000
networks, by the number learnt from. Run it on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import fascicle
from fascicle.cli.output import TerminalProgress
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.files import DISPOSABLE
from fascicle.emulation.ecg_emulator import (
    EcgEmulator,
    cosines_of,
    emulated_quantities,
    learn,
    tissue_inputs,
)
from fascicle.emulation.heart_emulator import atlas_emulator, simulations_of, usual_prior
from fascicle.heart.folder import load_heart, write_heart
from fascicle.networks.prior_simulations import HELD_OUT, Examples
from fascicle.pools.pool import Threads

RUNS = {"first": [], "later": ["--seed", "5"], "normal": ["--fix", "conduction=normal"]}
COUNTS = (500, 1000, 2000, 4000)
SIMULATED, TESTED = 8000, 2000


def seconds(heart: Path, target: Path, out: Path, source: Path) -> dict[str, float]:
    """Seconds of each run with the code of a checkout, on a copy of the heart."""
    copy = out / "heart"
    shutil.copytree(heart, copy, ignore=shutil.ignore_patterns(DISPOSABLE))
    taken = {}
    for name, options in RUNS.items():
        command = [
            sys.executable, "-c", "from fascicle.cli import main; main()", "fit", str(copy),
            str(target), "--out", str(out / name), "--quiet", *options,
        ]  # fmt: skip
        began = time.perf_counter()
        subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": str(source / "src")})
        taken[name] = time.perf_counter() - began
    return taken


def times(options: argparse.Namespace) -> None:
    """Print how long fits take, here and with another checkout."""
    here = Path(__file__).parents[1]
    sources = {"here": here} | ({"there": options.against} if options.against else {})
    taken = {}
    for name, source in sources.items():
        shutil.rmtree(options.out / name, ignore_errors=True)
        taken[name] = seconds(options.heart, options.target, options.out / name, source.resolve())
        print(name, {run: f"{number:.0f} s" for run, number in taken[name].items()}, flush=True)
    if options.against:
        print({run: f"{taken['there'][run] / taken['here'][run]:.1f} times" for run in RUNS})


def first(examples: Examples, count: int) -> Examples:
    """The first points of examples, and their ECGs."""
    feasible = examples.feasible[:count]
    tested = examples.held_out[:count] & feasible
    return replace(
        examples,
        points=examples.points[:count], feasible=feasible, kept=examples.kept[:count],
        ecgs=examples.ecgs[: feasible.sum()], in_torsos=examples.in_torsos[: tested.sum()],
        torsos=examples.torsos[: tested.sum()],
    )  # fmt: skip


def learning(options: argparse.Namespace) -> None:
    """Print errors of emulators by the number of networks that they have learnt from."""
    if not (options.out / "heart.toml").exists():
        write_heart(load_heart(str(options.heart)), options.out)
    model = fascicle.ForwardModel(options.out)
    prior = usual_prior(model.heart, CONDUCTION_STATES["normal"])
    simulations = simulations_of(model, prior, options.out)
    with TerminalProgress() as progress:
        simulations.simulate(SIMULATED, Threads(os.cpu_count() or 1), progress)
    examples = simulations.examples(SIMULATED)
    ratio = float(np.divide(*model.conduction.speeds))
    tissues = tissue_inputs(prior.averaged, ratio)[prior.tissue(examples.points)]
    values = emulated_quantities(prior, examples.points)
    tested = np.flatnonzero(examples.kept & (np.arange(SIMULATED) >= SIMULATED - TESTED))
    place = (np.cumsum(examples.feasible) - 1)[tested]

    def error(emulator: EcgEmulator) -> float:
        ecgs = examples.lasting(max(emulator.length, examples.ecgs.shape[2])).ecgs
        true = cosines_of(ecgs[place][..., : emulator.length], emulator.mean.shape[1])
        inputs = emulator.inputs({n: v[tested] for n, v in values.items()}, tissues[tested])
        errors = emulator.cosines(emulator.scores(inputs)) - true
        return float(np.sqrt((errors**2).sum() / (true**2).sum()))

    for count in (*COUNTS, SIMULATED - TESTED):
        some = first(examples, count // HELD_OUT * HELD_OUT)
        for name, atlas in (("atlas", atlas_emulator(prior)), ("random", None)):
            emulator = learn(some, prior, ratio, np.random.default_rng(1), atlas=atlas)
            print(f"{count} networks, begun with {name}: {error(emulator):.3f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    of_times, of_learning = commands.add_parser("times"), commands.add_parser("learning")
    for of_command in (of_times, of_learning):
        of_command.add_argument("heart", type=Path)
        of_command.add_argument("--out", type=Path, required=True)
    of_times.add_argument("target", type=Path)
    of_times.add_argument("--against", type=Path)
    options = parser.parse_args()
    (times if options.command == "times" else learning)(options)


if __name__ == "__main__":
    main()
