"""What the commands print of their results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fascicle.core.arrays import Floats
    from fascicle.forward.simulation import Simulation
    from fascicle.prediction.predicted import Predicted
    from fascicle.prediction.sweeps import Swept
    from fascicle.study.fitted import FittedStudy
    from fascicle.study.population import Population, Posterior


def print_simulation(simulation: Simulation, summary: Mapping[str, Any]) -> None:
    """Print times, what fired what, and what was never reached."""
    from fascicle.reporting.names import MEASURES

    print(f"total activation time  {simulation.total_activation_time:.1f} ms")
    for key, value in (
        ("qrs_duration_ms", simulation.qrs_duration),
        ("global_qrs_duration_ms", simulation.global_qrs_duration),
    ):
        measure = MEASURES[key]
        print(f"{measure.name:<22} {value:.0f} {measure.unit} ({measure.meaning})")
    for side, tree in summary["trees"].items():
        retrograde, inactive = tree["retrograde_junctions"], tree["not_activated_junctions"]
        print(
            f"{side + ' tree':<22} {tree['junctions']} junctions: "
            f"{tree['junctions'] - retrograde - inactive} activated anterogradely, {retrograde} "
            f"retrogradely, {inactive} not activated; up to "
            f"{tree['largest_junction_distance_mm']:.1f} mm from the tissue"
        )
    captured = simulation.coupled.captured
    if len(captured):
        print(f"stimuli                {captured.sum()} of {len(captured)} captured the myocardium")
    if summary["unreached_vertices"]:
        print(
            f"never reached          {summary['unreached_vertices']} vertices, "
            f"{summary['unreached_volume_ml']} ml: left out of the ECG"
        )


def print_fit(fitted: FittedStudy, summary: Mapping[str, Any]) -> None:
    """Print whether to trust a study, how well its networks match, and what the ECG determines.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    summary : mapping
        Its summary.json.
    """
    from fascicle.study.population import Posterior

    population = fitted.population
    print(f"result                 {fitted.verdict}")
    for warning in fitted.warnings:
        print(f"warning: {warning}")
    print(f"evaluations            {_evaluations(fitted)}")
    if fitted.of_the_paper:
        first = fitted.best_initial_loss
        print(f"best of the first      {first:.4f} mV² (flat line: {fitted.null_loss:.4f})")
    best = f"{population.best_loss:.4f} mV², {max(fitted.explained, 0):.0%} of the QRS explained"
    print(f"best network           {best}")
    _print_agreement(summary)
    for number, other in enumerate(summary.get("other_recordings", []), 2):
        print(f"recording {number}")
        _print_agreement(other)
    if isinstance(population, Posterior):
        _print_posterior(population, fitted)
    else:
        _print_population(population)


def _print_agreement(summary: Mapping[str, Any]) -> None:
    """Print how the mean of the networks' ECGs agrees with the recorded QRS."""
    from fascicle.core.leads import LEADS
    from fascicle.reporting.names import MEASURES

    if "explained_power" not in summary:  # of a study that was fitted before it was measured
        return
    explained, correlation = summary["explained_power"], summary["correlation"]
    leads = [lead for lead in LEADS if explained[lead] is not None]
    print(
        f"mean of the networks   {explained['all']:.0%} of the QRS explained, correlation "
        f"{correlation['all']:.2f} over all leads"
    )
    print(f"{'':<22}" + "".join(f"{lead:>6}" for lead in leads))
    for name, values, form in (
        ("  explained", explained, ".0%"), ("  correlation", correlation, ".2f"),
    ):  # fmt: skip
        print(f"{name:<22}" + "".join(f"{values[lead]:>6{form}}" for lead in leads))
    if any(explained[lead] < 0 for lead in leads):
        print(f"{'':<22} below 0: further from the recorded lead than a flat line")
    for key, measure in MEASURES.items():
        if key in summary:
            of, how = summary[key]["networks"], f"; {measure.meaning}" if measure.meaning else ""
            print(
                f"{measure.name:<22} recorded {summary[key]['recorded']:.0f} {measure.unit}, "
                f"networks {of['median']:.0f} ({of['5 %']:.0f} to {of['95 %']:.0f}){how}"
            )


def _evaluations(fitted: FittedStudy) -> str:
    count, config = len(fitted.study.records()), fitted.study.config
    return (
        f"{count}"
        if fitted.of_the_paper
        else f"{count}, {config.prior_simulations} of them of the prior"
    )


def _print_posterior(posterior: Posterior, fitted: FittedStudy) -> None:
    one, other = posterior.log_evidences
    print(f"log evidence           {one:.1f} and {other:.1f} in two runs")
    print(f"effective sample       {posterior.effective.sum():.0f}")
    if not posterior.converged:
        print("parameters             nothing is said of them: the runs do not agree")
        return
    if len(fitted.recordings) > 1 and posterior.first_alone is None:
        print("first recording alone  not converged: what the others add cannot be said")
    for statement in fitted.statements.parameters:
        print(f"{statement.name:<22} {statement}")
    for pair in fitted.statements.correlated:
        print(pair)


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


def print_verdict(fitted: FittedStudy) -> None:
    """Print whether to trust a study, and what to bear in mind of every number that follows."""
    print(f"result                 {fitted.verdict}")
    text = fitted.statements.caution_text
    if text is not None:
        print(f"caution                {text}")


def print_prediction(
    predicted: Mapping[str, Predicted], prior: Mapping[str, Predicted] | None = None
) -> None:
    """Print indices of scenarios: medians, and 90 % of the networks.

    With those of networks of the prior, say whether the ECG determines them, too.
    """
    import numpy as np

    from fascicle.reporting.names import MEASURES, index_label, index_name
    from fascicle.study.statements import prediction_statement

    shown = ("qrs_duration", "global_qrs_duration", "total_activation_time")
    heads = [f"{index_label(index):<27}" for index in shown]
    wide = max(32, *(len(name) + 2 for name in predicted))
    print(f"{'scenario':<{wide}}{''.join(heads)}".rstrip())
    for name, found in predicted.items():
        cells = []
        for index in shown:
            low, middle, high = np.percentile(found.indices[index], [5, 50, 95])
            cells.append(f"{middle:.0f} ({low:.0f} to {high:.0f})")
        print(f"{name:<{wide}}{''.join(f'{cell:<27}' for cell in cells)}".rstrip())
    print("medians (90 % of the networks)")
    for measure in MEASURES.values():
        if measure.meaning:
            print(f"{measure.name}: {measure.meaning}")
    _print_capture(predicted)
    for name, known in (prior or {}).items():
        for index in shown:
            said = prediction_statement(predicted[name].indices[index], known.indices[index])
            print(f"{name}, {index_name(index)}: {said}")


def _print_capture(predicted: Mapping[str, Predicted]) -> None:
    """Warn of stimuli of the tissue that come too late, or lie in scar, in some networks."""
    for name, found in predicted.items():
        for number, share in enumerate(found.captured, 1):
            if share < 1:
                print(
                    f"warning: {name}: stimulus {number} of the tissue captures in {share:.0%} of "
                    "the networks; elsewhere a front is there before it, or it lies in scar"
                )


def print_reductions(predicted: Mapping[str, Predicted], against: str) -> None:
    """Print by how much scenarios shorten the total activation time of one before them."""
    from fascicle.prediction.comparison import compare

    names = list(predicted)
    print(f"total activation time against {against}:")
    for name in names[names.index(against) + 1 :]:
        found = compare(predicted[name], predicted[against], "total_activation_time")
        print(f"  {name:<30} shortened by {found}; P(shorter) = {found.probability():.2f}")


def print_comparison(
    names: Sequence[str],
    predicted: Mapping[str, Predicted],
    index: str,
    threshold: float,
    parameters: Mapping[str, Floats],
) -> None:
    """Print how probably the first of two named scenarios is better, by every index."""
    from fascicle.prediction.comparison import MEASURABLE, compare
    from fascicle.prediction.index_names import COMPARED, INDICES
    from fascicle.reporting.names import index_name

    one, other = (predicted[name] for name in names)
    _print_capture({name: predicted[name] for name in names})
    for said in _undone(names, predicted):
        print(f"warning: {said}")
    print(f"{' against '.join(names)}, {len(one.beats)} networks")
    print(f"{'less is better':<24}{'P(less)':<14}median reduction")
    for name in COMPARED:
        found = compare(one, other, name)
        print(f"{index_name(name):<24}{found.probability():<14.2f}{found}")
    chosen = compare(one, other, index)
    print(
        f"{index_name(index)}: P(reduction > {threshold:g} {chosen.unit}) = "
        f"{chosen.probability(threshold):.2f} ± {chosen.standard_error(threshold):.2f}"
    )
    explained_by = [
        f"{name} {share:.0%}" for name, share in chosen.variance_explained_by(parameters)[:3]
    ]
    if not explained_by:
        print("variance explained by the parameters: too few independent networks")
        return
    print(f"variance explained by {', '.join(explained_by)} (each alone)")
    print("value of a further measurement, as the share of the variance that it removes:")
    for scenario, what, share in chosen.value_of_measurement(predicted):
        error = f"±{MEASURABLE[scenario, what]:.2g} {INDICES[what]}"
        print(f"  {share:4.0%}  {index_name(what)} of {scenario}, measured to {error}")


def _undone(names: Sequence[str], predicted: Mapping[str, Predicted]) -> list[str]:
    """What is to be known of two scenarios of which one blocks what the other does not."""
    from fascicle.prediction.comparison import missing_blocks

    first, second = names
    pairs = (first, second), (second, first)
    return [said for a, b in pairs if (said := missing_blocks(a, predicted, b))]


def comparison_result(
    names: Sequence[str],
    predicted: Mapping[str, Predicted],
    index: str,
    threshold: float,
    parameters: Mapping[str, Floats],
) -> dict[str, Any]:
    """What `print_comparison` prints, as a program wants it."""
    from fascicle.prediction.comparison import compare
    from fascicle.prediction.index_names import COMPARED

    one, other = (predicted[name] for name in names)
    compared = {name: compare(one, other, name) for name in COMPARED}
    chosen = compared[index]
    return {
        "scenarios": list(names),
        "warnings": _undone(names, predicted),
        "networks": len(one.beats),
        "indices": {
            name: {
                "unit": found.unit,
                "probability": found.probability(),
                "median_gain": found.median,
                "gain_5_95_%": found.interval,
            }
            for name, found in compared.items()
        },
        "index": index,
        "threshold": threshold,
        "probability": chosen.probability(threshold),
        "standard_error": chosen.standard_error(threshold),
        "variance_explained_by": dict(chosen.variance_explained_by(parameters)),
        "value_of_measurement": [
            {"scenario": scenario, "index": what, "share": share}
            for scenario, what, share in chosen.value_of_measurement(predicted)
        ],
    }


def print_sweep(swept: Swept, index: str) -> None:
    """Print an index of every scenario of a sweep, and how often each is the best."""
    import numpy as np

    from fascicle.heart.sites import SEGMENTS
    from fascicle.prediction.sweeps import SEGMENT
    from fascicle.reporting.names import index_label

    found, varied = swept.predicted, swept.varied
    values = np.array([each.indices[index] for each in found.values()])
    least = np.abs(values) == np.abs(values).min(axis=0)
    best = (least / least.sum(axis=0)).mean(axis=1)  # those that tie share a network
    print(varied)
    print(f"{'':<24}{index_label(index)}, 90 % of the networks; how often best")
    for key, row, share in zip(found, values, best, strict=True):
        low, middle, high = np.percentile(row, [5, 50, 95])
        name = SEGMENTS[int(key) - 1] if varied == SEGMENT else f"{key:g}"
        print(f"{name:<24}{f'{middle:.0f} ({low:.0f} to {high:.0f})':<24}{share:.0%}")
    for key, why in swept.impossible.items():
        print(f"warning: {swept.called(key)} left out: {why}")
    _print_capture({swept.called(key): each for key, each in found.items()})


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
        ("figures", "ECG, pair plot, activation map, convergence"),
        ("pacings", "what three pacings would do for a left bundle branch block"),
    ):
        print(f"  {name:<21} {what}")
    print(f"\nto read in a browser: {(out / 'report.html').resolve().as_uri()}")
