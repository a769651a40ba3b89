"""Roughness of the loss in each parameter: its response to changes of no consequence.

    python -m benchmarks.loss_roughness [--networks 20]

On the packaged heart, against a simulated target (the example's network): networks drawn from the
paper's ranges, the speed constant alpha with its usual prior; those that do not fit the
endocardia are left out. Each parameter by itself, and all lengths together, are then made a little
larger and a little smaller. Printed are the median, the 90th percentile and the largest of the
absolute change of the loss (mV²); the median of what is left in the mean of the changes both ways
("both ways", next to nothing where the loss is smooth); how many of the changed networks no longer
fit; for comparison the losses themselves. Branches collide, or not, by small differences, and then
the loss jumps.

Takes one to three minutes. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import fascicle
from fascicle.core.parameters import Infeasible
from fascicle.forward.model import ForwardModel
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import TargetComparison

Array = NDArray[np.float64]
Values = dict[str, float]

LENGTH, ANGLE, TIME, SPEED = 0.01, 0.001, 0.01, 0.001  # mm, rad, ms, mm/ms
ALPHA = 0.001  # of its value
LEVELS = (50, 90, 100)  # percentiles of the changes


Problem = tuple[PointSimulator, TargetComparison]


def simulated_problem(model: ForwardModel) -> Problem:
    """The example's ECG on the model's heart as a target, and the paper's ranges with alpha."""
    from examples.recover_known_network import synthetic_target

    simulation = model.simulate(fascicle.EXAMPLE_PARAMETERS)
    if isinstance(simulation, Infeasible):
        raise RuntimeError(f"the example gives no tree: {simulation.reason}")
    target = synthetic_target(simulation.leads, np.random.default_rng(0), noise=0.0)
    prior = Prior.of("paper", {"alpha": "free"}, model.heart)
    return PointSimulator(model, prior), TargetComparison(target)


def loss(problem: Problem, values: Mapping[str, float]) -> float:
    """Loss (mV²) at the best alignment; NaN where the network does not fit."""
    simulator, comparison = problem
    simulation = simulator.model.simulate({**simulator.prior.fixed, **values})
    if isinstance(simulation, Infeasible):
        return np.nan
    return comparison.align(simulation.leads).loss


def networks(problem: Problem, count: int) -> Iterator[Values]:
    """Random networks that fit."""
    rng = np.random.default_rng(0)
    while count > 0:
        space = problem[0].prior.learnt
        values = space.from_unit(rng.uniform(size=len(space)))
        if np.isfinite(loss(problem, values)):
            count -= 1
            yield values


def steps(names: Sequence[str]) -> dict[str, Values]:
    """Changes to try: the label of each, and what is added to which parameters."""
    usual = {"length": LENGTH, "angle": ANGLE, "root": TIME, "cv": SPEED}
    changes = {
        name: {name: next(step for word, step in usual.items() if word in name)}
        for name in names
        if name != "alpha"
    }
    changes["all lengths"] = {name: LENGTH for name in names if "length" in name}
    return changes


def changed(values: Values, added: Values, sign: int) -> Values:
    """Parameters of a network, changed by the steps `added` times `sign`."""
    return values | {name: values[name] + sign * step for name, step in added.items()}


def roughness(problem: Problem, drawn: Sequence[Values], losses: Array) -> Iterator[str]:
    """A row of the table for each change."""
    rows = {
        label: [(values, added) for values in drawn]
        for label, added in steps(problem[0].prior.names).items()
    }
    rows["alpha"] = [(values, {"alpha": ALPHA * values["alpha"]}) for values in drawn]
    for label, cases in rows.items():
        changed_losses = np.array(
            [[loss(problem, changed(*case, sign)) for sign in (-1, 1)] for case in cases]
        )
        change = changed_losses - losses[:, None]
        levels = [
            *np.nanpercentile(np.abs(change), LEVELS),
            np.nanmedian(np.abs(change.mean(axis=1))),
        ]
        row = "".join(f"{level:>12.1e}" for level in levels)
        yield f"{label:<24}{row}{np.isnan(change).sum():>12}"


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--networks", type=int, default=20, help="random networks")
    arguments = parser.parse_args(argv)
    problem = simulated_problem(ForwardModel(fascicle.load_heart("default")))
    drawn = list(networks(problem, arguments.networks))
    losses = np.array([loss(problem, values) for values in drawn])
    print(
        f"{len(drawn)} networks: losses {losses.min():.2f} to {losses.max():.2f} mV², median "
        f"{np.median(losses):.2f}; of a flat line {problem[1].null_loss:.2f}"
    )
    columns = ("median", "90 %", "largest", "both ways", "do not fit")
    print(f"{'change of the loss, mV²':<24}" + "".join(f"{column:>12}" for column in columns))
    for row in roughness(problem, drawn, losses):
        print(row, flush=True)


if __name__ == "__main__":
    main()
