"""Printing of the results of commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fascicle import Beat, FittedStudy, Predicted
from fascicle.cli.output import print_row, print_table
from fascicle.core.arrays import Floats
from fascicle.core.quantities import parameter_name
from fascicle.heart.sites import SEGMENTS
from fascicle.prediction.comparison import MEASURABLE, Swept, Varied, compare, missing_blocks
from fascicle.prediction.index_names import COMPARED, INDICES
from fascicle.reporting.names import MEASURES, index_label, index_name
from fascicle.study.population import Posterior
from fascicle.study.statements import prediction_statement


def print_simulation(simulation: Beat, summary: Mapping[str, Any]) -> None:
    """Print activation times, how junctions were activated, and what was not activated."""
    print_row("total activation time", f"{simulation.total_activation_time:.1f} ms")
    print_row("QRS duration", f"{simulation.qrs_duration:.0f} ms")
    for side, tree in summary["trees"].items():
        retrograde, inactive = tree["retrograde_junctions"], tree["not_activated_junctions"]
        print_row(
            f"{side} tree",
            f"{tree['junctions']} junctions: {tree['junctions'] - retrograde - inactive} activated "
            f"anterogradely, {retrograde} retrogradely, {inactive} not activated; up to "
            f"{tree['largest_junction_distance_mm']:.1f} mm from the tissue",
        )
    captured = simulation.coupled.captured
    if len(captured):
        print_row("stimuli", f"{captured.sum()} of {len(captured)} captured the myocardium")
    if count := summary["unreached_vertices"]:
        volume = summary["unreached_volume_ml"]
        print_row("never reached", f"{count} vertices, {volume} ml: left out of the ECG")


def print_fit(fitted: FittedStudy, summary: Mapping[str, Any]) -> None:
    """Print verdict, match and constrained parameters of a study and its summary.json."""
    population = fitted.population
    print_row("result", fitted.verdict)
    for warning in fitted.warnings:
        print(f"warning: {warning}")
    if fitted.of_the_paper:
        print_row("evaluations", len(fitted.study.records()))
        null = f"(flat line: {fitted.null_loss:.4f})"
        print_row("best of the first", f"{fitted.best_initial_loss:.4f} mV² {null}")
    else:
        print_row("prior simulations", fitted.prior_simulations)
    best = f"{population.best_loss:.4f} mV², {max(fitted.explained, 0):.0%} of the QRS explained"
    print_row("best network", best)
    for number, recording in enumerate([summary, *summary.get("other_recordings", [])], 1):
        if number > 1:
            print(f"recording {number}")
        left_out = fitted.recordings[number - 1].target.provenance.get("leads_left_out")
        if left_out:
            print_row("not compared", f"{left_out}: the heart has no electrodes for these leads")
        _print_agreement(recording)
    if isinstance(population, Posterior):
        _print_posterior(population, fitted)
        return
    for name, unit, digits in (("root_time", " ms", 1), ("cv", " m/s", 1), ("alpha", "", 3)):
        if len(population) and name in population.values:
            values = population.values[name]
            ends = np.median(values), values.min(), values.max()
            middle, low, high = (f"{value:.{digits}f}" for value in ends)
            print_row(parameter_name(name), f"{middle}{unit} ({low} to {high})")


def _print_agreement(summary: Mapping[str, Any]) -> None:
    """Print how well the mean ECG of the networks agrees with the recorded QRS."""
    if "explained_power" not in summary:  # a study of an older version
        return
    explained, correlation = summary["explained_power"], summary["correlation"]
    leads = [lead for lead, value in explained.items() if lead != "all" and value is not None]
    share = f"{explained['all']:.0%} of the QRS explained"
    over_all = f"correlation {correlation['all']:.2f} over all leads"
    print_row("mean of the networks", f"{share}, {over_all}")
    shares = ("  explained", *(f"{explained[lead]:.0%}" for lead in leads))
    alike = ("  correlation", *(f"{correlation[lead]:.2f}" for lead in leads))
    print_table([("", *leads), shares, alike])
    if any(explained[lead] < 0 for lead in leads):
        print_row("", "below 0: further from the recorded lead than a flat line")
    for key, measure in MEASURES.items():
        if key in summary:
            of = summary[key]["networks"]
            recorded = f"recorded {summary[key]['recorded']:.0f} {measure.unit}"
            networks = f"networks {of['median']:.0f} ({of['5 %']:.0f} to {of['95 %']:.0f})"
            print_row(measure.name, f"{recorded}, {networks}")


def _print_posterior(posterior: Posterior, fitted: FittedStudy) -> None:
    if not posterior.states:
        first, second = posterior.log_evidences
        print_row("log evidence", f"{first:.1f} and {second:.1f} in two runs")
    print_row("effective sample", f"{posterior.effective.sum():.0f}")
    if not posterior.converged:
        print_row("parameters", "not reported: the runs do not agree")
        return
    if hearts := fitted.statements.hearts:
        print_table([(statement.name, str(statement)) for statement in hearts])
    for line in fitted.statements.sequence:
        print_row("activation", line)
    if len(fitted.recordings) > 1 and posterior.first_alone is None:
        print_row("first recording alone", "not converged: what the others add is unknown")
    print_table([(parameter_name(s.name), str(s)) for s in fitted.statements.parameters])
    for pair in fitted.statements.correlated:
        print(pair)


def print_verdict(fitted: FittedStudy) -> None:
    """Print whether a study can be trusted, and the caution that holds for its numbers."""
    print_row("result", fitted.verdict)
    if (text := fitted.statements.caution_text) is not None:
        print_row("caution", text)


def print_prediction(
    predicted: Mapping[str, Predicted], prior: Mapping[str, Predicted] | None = None
) -> None:
    """Print indices of scenarios; with those of the prior, whether the ECG determines them."""
    shown = ("qrs_duration", "total_activation_time")
    rows = [("scenario", *map(index_label, shown))]
    for name, prediction in predicted.items():
        rows.append((name, *(interval(prediction.indices[index]) for index in shown)))
    print_table(rows)
    print("medians (90 % of the networks)")
    _print_capture(predicted)
    for name, from_prior in (prior or {}).items():
        for index in shown:
            statement = prediction_statement(
                predicted[name].indices[index], from_prior.indices[index]
            )
            print(f"{name}, {index_name(index)}: {statement}")


def interval(values: Floats, digits: str = ".0f") -> str:
    """Median, and the 5th and 95th percentile."""
    low, middle, high = (f"{value:z{digits}}" for value in np.percentile(values, [5, 50, 95]))
    return f"{middle} ({low} to {high})"


def _print_capture(predicted: Mapping[str, Predicted]) -> None:
    """Warn of myocardial stimuli that come too late, or lie in scar, in some networks."""
    for name, prediction in predicted.items():
        for number, share in enumerate(prediction.captured, 1):
            if share < 1:
                print(
                    f"warning: {name}: myocardial stimulus {number} captures in {share:.0%} of "
                    "the networks; in the others its site is already activated, or is scar"
                )


def print_reductions(predicted: Mapping[str, Predicted], against: str) -> None:
    """Print by how much the scenarios after `against` shorten or prolong its activation."""
    names = list(predicted)
    print(f"total activation time against {against}:")
    for name in names[names.index(against) + 1 :]:
        reduction = compare(predicted[name], predicted[against], "total_activation_time")
        print(f"  {name:<30} {reduction.change}; P(shorter) = {reduction.probability():.2f}")


def print_comparison(predicted: Mapping[str, Predicted], result: Mapping[str, Any]) -> None:
    """Print a `comparison_result`: the probability that the first scenario is better."""
    names, index, threshold = result["scenarios"], result["index"], result["threshold"]
    _print_capture({name: predicted[name] for name in names})
    for warning in result["warnings"]:
        print(f"warning: {warning}")
    print(f"{' against '.join(names)}, {result['networks']} networks")
    rows = [("less is better", "P(less)", "median reduction")]
    for name, comparison in result["indices"].items():
        median, (low, high) = comparison["median_gain"], comparison["gain_5_95_%"]
        reduction = f"{round(median)} {comparison['unit']} (90 % CrI {round(low)} to {round(high)})"
        rows.append((index_name(name), f"{comparison['probability']:.2f}", reduction))
    print_table(rows)
    probability = f"{result['probability']:.2f} ± {result['standard_error']:.2f}"
    print(f"{index_name(index)}: P(reduction > {threshold:g} {INDICES[index]}) = {probability}")
    largest = [*result["variance_explained_by"].items()][:3]
    shares = [f"{parameter_name(name)} {share:.0%}" for name, share in largest]
    if not shares:
        print("variance explained by the parameters: too few independent networks")
        return
    print(f"variance explained by {', '.join(shares)} (each alone)")
    print("value of a further measurement, as the share of the variance that it removes:")
    for row in result["value_of_measurement"]:
        scenario, measured = row["scenario"], row["index"]
        error = f"±{MEASURABLE[scenario, measured]:.2g} {INDICES[measured]}"
        print(f"  {row['share']:4.0%}  {index_name(measured)} of {scenario}, measured to {error}")


def comparison_result(
    names: Sequence[str],
    predicted: Mapping[str, Predicted],
    index: str,
    threshold: float,
    parameters: Mapping[str, Floats],
) -> dict[str, Any]:
    """Compare the first of two scenarios with the second, by every index and by one in detail.

    `predicted` holds the two and the scenarios of further measurements, `parameters` the values of
    the networks; `threshold` is the least reduction that matters, in the unit of `index`.
    """
    first, second = (predicted[name] for name in names)
    compared = {name: compare(first, second, name) for name in COMPARED}
    chosen = compared[index]
    pairs = (names, names[::-1])
    return {
        "scenarios": list(names),
        "warnings": [warning for a, b in pairs if (warning := missing_blocks(a, predicted, b))],
        "networks": len(first.beats),
        "indices": {
            name: {
                "unit": comparison.unit,
                "probability": comparison.probability(),
                "median_gain": comparison.median,
                "gain_5_95_%": comparison.interval,
            }
            for name, comparison in compared.items()
        },
        "index": index,
        "threshold": threshold,
        "probability": chosen.probability(threshold),
        "standard_error": chosen.standard_error(threshold),
        "variance_explained_by": dict(chosen.variance_explained_by(parameters)),
        "value_of_measurement": [
            {"scenario": scenario, "index": measured, "share": share}
            for scenario, measured, share in chosen.value_of_measurement(predicted)
        ],
    }


def print_sweep(swept: Swept, index: str) -> None:
    """Print an index of every scenario of a sweep, and how often each is the best."""
    predicted, varied = swept.predicted, swept.varied
    values = np.array([prediction.indices[index] for prediction in predicted.values()])
    least = np.abs(values) == np.abs(values).min(axis=0)
    best = (least / least.sum(axis=0)).mean(axis=1)  # ties share a network
    rows = [(str(varied), f"{index_label(index)}, 90 % of the networks", "how often best")]
    for key, row, share in zip(predicted, values, best, strict=True):
        name = SEGMENTS[int(key) - 1] if varied == Varied.SEGMENT else f"{key:g}"
        rows.append((name, interval(row), f"{share:.0%}"))
    print_table(rows)
    for key, why in swept.impossible.items():
        print(f"warning: {swept.called(key)} left out: {why}")
    _print_capture({swept.called(key): prediction for key, prediction in predicted.items()})
