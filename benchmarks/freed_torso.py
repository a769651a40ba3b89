"""Gain of freeing the torso, from a network that was fitted in the torso as it is.

    python -m benchmarks.freed_torso STUDY [--free pose electrodes] [--generations 100] [--seed 0]

STUDY is a finished study of a heart in a torso. Its best network in the neutral torso, and others
of its points that are apart from it in torsos drawn from the prior, are refined with the quantities
of the torso free. Printed are the mismatch (mV²) before and after, and the values learnt.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import fascicle
from benchmarks.refinement import refine, spread
from fascicle.cli.output import TerminalProgress
from fascicle.core.parameters import ParameterSpace, free
from fascicle.core.progress import stage_progress
from fascicle.core.quantities import DELAY, GROUPS, QUANTITIES, TORSO_QUANTITIES
from fascicle.inference.evaluation import best_of
from fascicle.networks.target_comparison import evaluate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path)
    parser.add_argument("--free", nargs="+", default=["pose", "electrodes"])
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    fitted = fascicle.load_study(arguments.study)
    earlier = [record.evaluation for record in fitted.study.records()]
    names = [name for group in arguments.free for name in GROUPS.get(group, (group,))]
    prior = fitted.simulator.prior
    torso = ParameterSpace(tuple(free(name) for name in names))
    space = ParameterSpace((*prior.learnt.parameters, *torso.parameters))
    prior = replace(prior, space=space, states={})
    simulator = replace(fitted.simulator, prior=prior)
    networks = spread(earlier)
    torsos = rng.random((len(networks), len(torso)))
    torsos[0] = torso.to_unit({name: QUANTITIES[name].default for name in torso.names})
    points = list(np.hstack([networks, torsos]))
    starts = list(evaluate(simulator, fitted.recordings, points))
    evaluated = list(starts)

    def objective(points):
        evaluations = list(evaluate(simulator, fitted.recordings, points))
        evaluated.extend(evaluations)
        return evaluations

    with TerminalProgress() as progress:
        refine(
            rng,
            starts,
            objective,
            arguments.generations,
            stage_progress(progress, "refinement", ""),
        )
    best = best_of(evaluated)
    print(f"flat line {fitted.null_loss:.3f}, torso as it is {best_of(earlier).loss:.3f}, "
          f"freed {best.loss:.3f} mV² after {arguments.generations} generations")  # fmt: skip
    values = space.from_unit(best.point)
    for name in (n for n in (*DELAY, *TORSO_QUANTITIES) if n in values):
        print(f"{name} {fitted.population.best.get(name, 0.0):.3f} -> {values[name]:.3f}")


if __name__ == "__main__":
    main()
