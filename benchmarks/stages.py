"""Time of a forward run, stage by stage, and whether a change made it shorter.

    python -m benchmarks.stages HEART [--networks 50] [--against CHECKOUT]

HEART is a heart's folder, or `default`. Networks are drawn from the prior of a posterior, as those
of prior simulations are. Times are processor time of one thread, medians over the networks, each
the least of `REPEATS` runs.

With --against, the same networks are simulated by the code in another checkout of this repository,
too, in a process beside this one's: network by network in turn, so that both see the same state of
the machine. The ratio is the median over the networks of its time over this one's. The largest
difference between the two activations, and between the two ECGs as a part of the ECG's largest
value, says whether both compute the same.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.forward import ONE_THREAD, pin_to_one_core

Array = npt.NDArray[Any]

HERE = Path(__file__).resolve().parents[1]
REPEATS = 3
STAGES = {
    "grow": "grow both trees",
    "attach": "find their junctions in the tissue, and rays",
    "solve": "couple trees and myocardium",
    "ecg": "one ECG",
    "whole": "whole forward run",
}


def serve(heart: str) -> None:
    """Simulate the network whose number each line of input says, and print the stages' seconds.

    Results go into the file that the line names after the number. What is imported here is the same
    in every checkout that can be compared.
    """
    from fascicle.core.parameters import Infeasible
    from fascicle.forward.eikonal.activation import solve
    from fascicle.forward.eikonal.myocardium import attach
    from fascicle.forward.model import ForwardModel
    from fascicle.heart.folder import load_heart
    from fascicle.networks.prior import study_space
    from fascicle.purkinje.growth import grow_from_parameters

    model = ForwardModel(load_heart(heart))
    space, fixed = study_space("paper", {"alpha": "free"}, model.heart)
    prepared, alpha = model.prepared, model.conduction.alpha

    def staged(parameters: dict[str, float]) -> dict[str, Any] | None:
        seconds: dict[str, Any] = {}

        def timed(stage: str, work: Callable[[], Any]) -> Any:
            begin = time.thread_time()
            result = work()
            seconds[stage] = time.thread_time() - begin
            return result

        trees = timed(
            "grow",
            lambda: [
                grow_from_parameters(s, c, prepared.seeds[s], parameters, model.rules)
                for s, c in prepared.charts.items()
            ],
        )
        if any(isinstance(tree, Infeasible) for tree in trees):
            return None
        coupling = timed("attach", lambda: attach(model.myocardium, trees))
        roots, cv = parameters["root_time"], parameters["cv"]
        speed = parameters.get("alpha", alpha) / alpha
        start = [max(0.0, -roots), max(0.0, roots)]
        solved = timed("solve", lambda: solve(coupling, start, cv, tissue_speed=speed))
        times = solved.myocardium
        timed("ecg", lambda: model.electrocardiograph.leads(times))
        model._grow.cache_clear()
        seconds["outcome"] = timed("whole", lambda: model.simulate(parameters))
        return seconds

    for line in sys.stdin:
        number, path = line.split()
        point = np.random.default_rng([20240, int(number)]).random(len(space))
        parameters = {**fixed, **space.from_unit(point)}
        runs = [staged(parameters) for _ in range(REPEATS)]
        if None in runs:
            print(json.dumps(None), flush=True)
            continue
        outcome = runs[-1]["outcome"]
        np.savez(path, activation=outcome.activation, leads=outcome.leads)
        print(json.dumps({s: min(run[s] for run in runs) for s in STAGES}), flush=True)


class Server:
    """A process that simulates with the code of one checkout."""

    def __init__(self, checkout: Path, heart: str) -> None:
        paths = os.pathsep.join([str(checkout / "src"), str(HERE)])
        self.process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.stages", heart, "--serve"],
            env=os.environ | ONE_THREAD | {"PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(self, number: int, result: Path) -> dict[str, float] | None:
        """Simulate a network; the stages' seconds, or None where a tree does not fit."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(number, result, file=self.process.stdin, flush=True)
        answer: dict[str, float] | None = json.loads(self.process.stdout.readline())
        return answer


def compare(heart: str, checkouts: Sequence[Path], count: int) -> Iterator[tuple[Any, Any]]:
    """Seconds of each stage and results, by checkout, of one network after the other."""
    servers = [Server(checkout, heart) for checkout in checkouts]
    number = done = 0
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{k}.npz" for k in range(len(servers))]
        for server, file in zip(servers, files, strict=True):
            server(0, file)  # a warm-up
        while done < count:
            pairs = zip(servers, files, strict=True)
            seconds = [server(number, file) for server, file in pairs]
            if None not in seconds:
                done += 1
                yield (
                    [[s[stage] for stage in STAGES] for s in seconds if s],
                    [dict(np.load(file)) for file in files],
                )
            number += 1


def difference(first: Array, second: Array) -> float:
    """Largest difference between two arrays; inf where they have not the same shape."""
    if first.shape != second.shape or not np.array_equal(np.isinf(first), np.isinf(second)):
        return np.inf
    finite = np.isfinite(first)
    return float(np.abs(first[finite] - second[finite]).max(initial=0.0))


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("heart", help="folder of a heart, or 'default'")
    parser.add_argument("--networks", type=int, default=50)
    parser.add_argument("--against", type=Path, help="another checkout of this repository")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    pin_to_one_core()
    if arguments.serve:
        serve(arguments.heart)
        return
    checkouts = [HERE] if arguments.against is None else [HERE, arguments.against.resolve()]
    seconds, times, ecgs = [], [], []
    for spent, results in compare(arguments.heart, checkouts, arguments.networks):
        seconds.append(spent)
        mine, theirs = results[0], results[-1]
        times.append(difference(mine["activation"], theirs["activation"]))
        ecgs.append(difference(mine["leads"], theirs["leads"]) / np.abs(theirs["leads"]).max())
    spent = np.array(seconds)
    both = len(checkouts) > 1
    print(f"{'ms':<48}{'this':>8}" + f"{'other':>8}{'ratio':>8}" * both)
    for k, label in enumerate(STAGES.values()):
        row = f"{label:<48}" + "".join(f"{1e3 * t:>8.2f}" for t in np.median(spent[:, :, k], 0))
        print(row + (f"{np.median(spent[:, 1, k] / spent[:, 0, k]):>8.2f}" if both else ""))
    if both:
        print(f"largest difference: activation {max(times):.1e} ms, ECG {max(ecgs):.1e}")


if __name__ == "__main__":
    main()
