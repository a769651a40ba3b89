"""What the commands print of their results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fascicle.core.arrays import Floats
    from fascicle.forward.simulation import Simulation
    from fascicle.predict.pacing import Pacing
    from fascicle.study.population import Population, Posterior
    from fascicle.study.results import FittedStudy


def print_simulation(simulation: Simulation, summary: Mapping[str, Any]) -> None:
    """Print times, what fired what, and what was never reached."""
    print(f"total activation time  {simulation.total_activation_time:.1f} ms")
    print(f"QRS duration           {simulation.qrs_duration:.0f} ms")
    for side, tree in summary["trees"].items():
        backwards, silent = tree["antidromic_junctions"], tree["silent_junctions"]
        print(
            f"{side + ' tree':<22} {tree['junctions']} junctions: "
            f"{tree['junctions'] - backwards - silent} orthodromic, {backwards} antidromic, "
            f"{silent} silent; up to {tree['largest_junction_distance_mm']:.1f} mm from the tissue"
        )
    captured = simulation.coupled.captured
    if len(captured):
        print(f"stimuli                {captured.sum()} of {len(captured)} captured the myocardium")
    if summary["unreached_vertices"]:
        print(
            f"never reached          {summary['unreached_vertices']} vertices, "
            f"{summary['unreached_volume_ml']} ml: left out of the ECG"
        )


def print_fit(fitted: FittedStudy) -> None:
    """Print whether to trust a study, how well its networks match, and what the ECG determines."""
    from fascicle.study.population import Posterior

    population = fitted.population
    print(f"result                 {fitted.verdict}")
    for warning in fitted.warnings:
        print(f"warning: {warning}")
    print(f"evaluations            {_evaluations(fitted)}")
    if fitted.of_the_paper:
        first = fitted.best_initial_loss
        print(f"best of the first      {first:.4f} mV² (flat line: {fitted.problem.flat:.4f})")
    best = f"{population.best_loss:.4f} mV², {max(fitted.explained, 0):.0%} of the QRS explained"
    print(f"best                   {best}")
    if isinstance(population, Posterior):
        _print_posterior(population, fitted)
    else:
        _print_population(population)


def _evaluations(fitted: FittedStudy) -> str:
    count, config = len(fitted.study.records()), fitted.study.config
    return f"{count}" if fitted.of_the_paper else f"{count}, {config.bank} of them of the prior"


def _print_posterior(posterior: Posterior, fitted: FittedStudy) -> None:
    from fascicle.study.verdict import statements, trade_offs

    one, other = posterior.log_evidences
    print(f"log evidence           {one:.1f} and {other:.1f} in two runs")
    print(f"effective sample       {posterior.effective.sum():.0f}")
    if not posterior.converged:
        print("parameters             nothing is said of them: the runs do not agree")
        return
    if len(fitted.problem.recordings) > 1 and posterior.first_alone is None:
        print("first recording alone  not converged: what the others add cannot be said")
    for statement in statements(posterior, fitted.problem.space):
        print(f"{statement.name:<22} {statement}")
    for first, second, correlation in trade_offs(posterior):
        print(f"{first} and {second} stand for one another (rank correlation {correlation:.2f})")


def _print_population(population: Population) -> None:
    import numpy as np

    if not len(population):
        return
    shown = {"root_time": ("ms", 1), "cv": ("m/s", 1), "alpha": ("", 3)}
    for name in (name for name in shown if name in population.values):
        values, (unit, digits) = population.values[name], shown[name]
        middle, low, high = (
            f"{value:.{digits}f}" for value in (np.median(values), values.min(), values.max())
        )
        print(f"{name:<22} {middle} {unit}{' ' * bool(unit)}({low} to {high})")


def print_pacing(pacing: Pacing, prior: Mapping[str, Floats] | None = None) -> None:
    """Print durations before and after pacing: medians, and 90 % of the networks.

    With those of the prior, say whether the ECG determines them, too.
    """
    import numpy as np

    from fascicle.study.verdict import prediction_statement

    for key, name, before, after in (
        ("qrs_after", "QRS duration", pacing.qrs_before, pacing.qrs_after),
        ("tat_after", "total activation time", pacing.tat_before, pacing.tat_after),
    ):
        low, middle, high = np.percentile(after, [5, 50, 95])
        print(
            f"{name:<22} {np.median(before):.0f} ms -> {middle:.0f} ms paced "
            f"(90 % of the networks: {low:.0f} to {high:.0f})"
        )
        if prior is not None:
            print(f"{'':<22} {prediction_statement(after, prior[key])}")


def print_template(measures: Mapping[str, Mapping[str, float]]) -> None:
    """Print the measures of each cell's action potential."""
    print(f"{'':<18} rest (mV)  overshoot (mV)  dV/dt max (V/s)  APD90 (ms)  speed (m/s)")
    for cell, values in measures.items():
        print(
            f"{cell:<18} {values['resting_potential']:9.1f}  {values['overshoot']:14.1f}  "
            f"{values['max_upstroke']:15.0f}  {values['apd90']:10.0f}  "
            f"{values['conduction_velocity']:11.2f}"
        )


def print_demo(out: Path) -> None:
    """Print what the demonstration leaves in its folder."""
    print(f"\nin {out}:")
    for name, what in (
        ("target.png", "the recording: beats by class, their overlay, the QRS window"),
        ("target.nc", "beats, mean, standard deviation, QRS window"),
        ("study/population.nc", "the networks' parameters and predicted ECGs (ArviZ)"),
        ("study/networks", "their trees, for ParaView"),
        ("study/activation.vtu", "activation of the best network, mean and spread over all"),
        ("study/figures", "ECG, pair plot, activation map, convergence"),
        ("pacing", "what firing both trees together would do"),
    ):
        print(f"  {name:<21} {what}")
