"""The paper's synthetic experiment: what its method finds of a known network.

    python -m benchmarks.synthetic --data CRTDEMO_FOLDER --out FOLDER
                                   [--truth paper|inside] [--seeds 1] [--beats 300]
                                   [--initial 250] [--steps 300] [--draws 5000000] [--samples 30]

The heart is the published demonstration heart in the unbounded conductor. Its ECG is simulated with

- paper: the paper's twelve values. Five of them lie at an end of their range (three angles at 3π/4,
  which the paper rounds to 2.36, root time and speed), where a search that stays in the range is
  right for the wrong reason;
- inside: the same with these five moved inside.

In both the left tree fires late, as in left bundle branch block; how many of its junctions the
front from the right ventricle reaches first is printed. Beats are made of the ECG that vary as
recorded ones do (`examples.recover_known_network`), 300 as in the paper's five minutes, and
`fascicle.fit` with ``method="paper"`` looks for the network. Printed are the mismatch (mV²) after
each stage; for each parameter the range of the networks, the contraction 1 − variance / variance of
the prior (with 30 networks chance alone makes that ±0.16), and the rank of the truth among the
networks; and the mean contraction of the left tree, the right tree, and of root time and speed. The
figures are those of the paper: activation of truth and best network, ECGs, pair plot, trees. Run
from the root of the repository.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import fascicle
from benchmarks.forward import _heart, build_case
from examples.recover_known_network import synthetic_target
from fascicle.cli.output import TerminalProgress
from fascicle.forward.beat import Beat
from fascicle.networks.target_comparison import Network, evaluate
from fascicle.reporting.activation import ActivationRow, activation_figure
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.parameters import pair_figure
from fascicle.reporting.style import Colour, new_figure, save
from fascicle.reporting.surfaces import heart_views
from fascicle.study.evaluations import Stage
from fascicle.study.fitted import FittedStudy

LARGEST_ANGLE = 3 * math.pi / 4
PAPER = {
    "lv_initial_length": 35.93,
    "rv_initial_length": 79.86,
    "lv_fascicle_length_1": 9.42,
    "lv_fascicle_length_2": 18.25,
    "rv_fascicle_length_1": 43.41,
    "rv_fascicle_length_2": 11.59,
    "lv_fascicle_angle_1": 1.44,
    "lv_fascicle_angle_2": LARGEST_ANGLE,
    "rv_fascicle_angle_1": LARGEST_ANGLE,
    "rv_fascicle_angle_2": LARGEST_ANGLE,
    "root_time": -75.0,  # "75 ms in the left ventricle": the left root fires later
    "cv": 2.0,
}
INSIDE = PAPER | {
    "lv_fascicle_angle_2": 1.9,
    "rv_fascicle_angle_1": 1.9,
    "rv_fascicle_angle_2": 1.9,
    "root_time": -60.0,
    "cv": 2.4,
}
TRUTHS = {"paper": PAPER, "inside": INSIDE}
TREE_COLUMNS = 8
PANEL = 1.1  # inch


def simulate(model: fascicle.ForwardModel, parameters: Mapping[str, float]) -> Beat:
    outcome = model.simulate(parameters)
    assert isinstance(outcome, Beat), outcome.reason
    return outcome


def contraction(values: np.ndarray[Any, Any], lower: float, upper: float) -> float:
    """1 − variance / variance of the uniform prior."""
    return 1 - float(values.var()) * 12 / (upper - lower) ** 2


def print_losses(fitted: FittedStudy, truth: Mapping[str, float]) -> None:
    """Print the mismatch after each stage, and that of the truth, which is noise alone."""
    population, space = fitted.population, fitted.simulator.prior.learnt
    at_truth = next(evaluate(fitted.simulator, fitted.recordings, [space.to_unit(truth)])).loss
    drawn = [e.loss for e in fitted.candidates if e.feasible]
    rounds = fitted.study.steps(Stage.REJECTION)
    print(f"  mismatch (mV²)   flat line {fitted.null_loss:.3f}, truth {at_truth:.4f}")
    print(f"    design         {fitted.best_initial_loss:.4f}")
    print(f"    optimisation   {population.best_loss:.4f}")
    print(f"    candidates     {min(drawn):.4f} to {max(drawn):.4f} ({len(drawn)} with a tree of "
          f"{len(fitted.candidates)}, {rounds} rounds)")  # fmt: skip
    if len(population):
        low, high = population.losses.min(), population.losses.max()
        print(f"    networks       {low:.4f} to {high:.4f} ({len(population)})")


def print_parameters(fitted: FittedStudy, truth: Mapping[str, float]) -> None:
    """Print range, contraction and rank of the truth of every parameter, and the trees' means."""
    population = fitted.population
    print(f"  {'':<22} {'truth':>7} {'best':>7} {'lowest':>7} {'median':>7} {'highest':>7}"
          f" {'contraction':>11} {'rank':>7}")  # fmt: skip
    contractions: dict[str, list[float]] = {
        "left tree": [],
        "right tree": [],
        "root time, speed": [],
    }
    groups = {"lv": "left tree", "rv": "right tree"}
    for parameter in fitted.simulator.prior.learnt.parameters:
        name, values = parameter.name, population.values[parameter.name]
        shrunk = contraction(values, parameter.lower, parameter.upper)
        contractions[groups.get(name[:2], "root time, speed")].append(shrunk)
        rank = f"{(values < truth[name]).sum()}/{len(values)}"
        print(
            f"  {name:<22} {truth[name]:7.2f} {population.best[name]:7.2f} {values.min():7.2f} "
            f"{np.median(values):7.2f} {values.max():7.2f} {shrunk:11.2f} {rank:>7}"
        )
    for name, shares in contractions.items():
        print(f"  mean contraction, {name}: {np.mean(shares):.2f}")


def draw_tree(axes: Axes, heart: fascicle.Heart, simulation: Beat, label: str) -> None:
    """Both trees, seen from the front."""
    view = heart_views(heart)["anterior"]
    for tree, colour in zip(simulation.trees, (Colour.VERMILION, Colour.BLUE), strict=True):
        child = np.flatnonzero(tree.parents >= 0)
        ends = view.project(tree.nodes[np.stack([tree.parents[child], child], axis=1)])[..., :2]
        axes.add_collection(LineCollection(list(ends), colors=colour, linewidths=0.4))
    low, high = view.box(heart.vertices)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_title(label, fontsize=7, pad=1)


def tree_figure(heart: fascicle.Heart, simulations: Mapping[str, Beat]) -> Figure:
    """Trees of the truth and of every network: left red, right blue."""
    rows = math.ceil(len(simulations) / TREE_COLUMNS)
    figure = new_figure(PANEL * TREE_COLUMNS, 0.8 * PANEL * rows)
    panels = figure.subplots(rows, TREE_COLUMNS, squeeze=False).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, (label, simulation) in zip(panels, simulations.items(), strict=False):
        draw_tree(axes, heart, simulation, label)
    return figure


def write_figures(
    folder: Path, fitted: FittedStudy, networks: list[Network], truth: Mapping[str, float]
) -> None:
    target, population = fitted.recordings[0].target, fitted.population
    model, space, window = fitted.simulator.model, fitted.simulator.prior.learnt, target.qrs_samples
    heart, true = model.heart, simulate(model, truth)
    drawn = {"truth": true, "best": fitted.best_network.beat}
    rows = [ActivationRow.of(name, simulation).since_first() for name, simulation in drawn.items()]
    save(activation_figure(heart, rows), folder / "activation.png")
    time_axis = target.time[window]
    predicted = np.stack([network.predicted for network in networks])[:, :, window]
    reference = EcgGroup("reference", "beat", time_axis, target.qrs_beats, Colour.BLUE)
    simulated = EcgGroup("networks", "network", time_axis, predicted, Colour.VERMILION)
    save(ecg_figure([reference, simulated], fitted.statements.networks_called), folder / "ecg.png")
    pairs = pair_figure(space, population.values, population.best, truth)
    save(pairs, folder / "pairs.png")
    trees = {"truth": true} | {f"{k}": n.beat for k, n in enumerate(networks)}
    save(tree_figure(heart, trees), folder / "trees.png")


def experiment(
    model: fascicle.ForwardModel, name: str, seed: int, beats: int, out: Path, **budget: float
) -> FittedStudy:
    """Fit the ECG of a known network, and print and draw how well it is recovered."""
    truth, folder = TRUTHS[name], out / f"{name}-{seed}"
    true = simulate(model, truth)
    target = synthetic_target(true.leads, np.random.default_rng(seed), beats)
    begin = time.process_time()
    with TerminalProgress() as progress:
        fitted = fascicle.fit(
            model.heart, target, folder / "study", method="paper", seed=seed, progress=progress,
            **budget,
        )  # fmt: skip
    print(f"\n{name} truth, seed {seed}: {fitted.statements.networks_called}"
          f" ({time.process_time() - begin:.0f} s of CPU time)")  # fmt: skip
    fired = ", ".join(
        f"{by.sum()} of {len(by)} ({tree.side.upper()})"
        for tree, by in zip(true.trees, true.coupled.retrograde, strict=True)
    )
    print(f"  the truth's junctions that fire from the tissue: {fired}")
    for warning in fitted.warnings:
        print(f"  warning: {warning}")
    print_losses(fitted, truth)
    if len(fitted.population):
        print_parameters(fitted, truth)
        write_figures(folder, fitted, fitted.networks(), truth)
    return fitted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the crtdemo heart")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--truth", choices=list(TRUTHS), action="append")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--beats", type=int, default=300)
    parser.add_argument("--initial", type=int, default=250)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--draws", type=int, default=5_000_000)
    parser.add_argument("--samples", type=int, default=30)
    arguments = parser.parse_args()
    model = fascicle.ForwardModel(_heart(build_case(arguments.data)))
    for name in arguments.truth or TRUTHS:
        for seed in range(arguments.seeds):
            experiment(
                model, name, seed, arguments.beats, arguments.out, initial=arguments.initial,
                steps=arguments.steps, draws=arguments.draws, samples=arguments.samples,
            )  # fmt: skip


if __name__ == "__main__":
    main()
