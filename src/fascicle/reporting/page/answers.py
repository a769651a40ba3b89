"""What a study found, in words: whether to believe it, what the ECG told, what pacing would do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.prediction.comparison import compare, missing_blocks
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.reporting.names import index_name, parameter_name
from fascicle.study.fitted import FittedStudy
from fascicle.study.statements import (
    LEAST_EXPLAINED,
    Caution,
    ParameterStatement,
    explained_share,
    fit_acceptable,
)

LIKELY = 0.9  # probability from which on one scenario is called better


@dataclass(frozen=True)
class Answers:
    """The first screen of a report.

    Attributes
    ----------
    verdict : str
        First line of the result.
    trustworthy : bool
        Whether it has converged and explains its recordings.
    caution : Caution, optional
        What is to stand beside every number, if there is anything.
    meaning : list of str
        What the verdict means, in whole sentences.
    warnings : list of str
        What must be known first.
    determined, undetermined : list of ParameterStatement
        What the ECG says of the parameters, and of which it says little.
    traded : list of str
        Parameters that are strongly correlated.
    predicted : list of str
        A sentence for each scenario.
    """

    verdict: str
    trustworthy: bool
    caution: Caution | None
    meaning: list[str]
    warnings: list[str]
    determined: list[ParameterStatement]
    undetermined: list[ParameterStatement]
    traded: list[str]
    predicted: list[str]


def answers(
    fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str = INTRINSIC
) -> Answers:
    """Put a study and its predictions into words.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    predicted : mapping of name to Predicted
        Scenarios over its networks, the intrinsic beat among them.
    against : str
        That of them which the others are compared with, if not the intrinsic beat.
    """
    said = fitted.statements
    traded = [
        f"{parameter_name(pair.first)} and {parameter_name(pair.second)} are strongly correlated "
        f"in the posterior (rank correlation {pair.rank_correlation:.2f})"
        for pair in said.correlated
    ]
    return Answers(
        said.verdict,
        bool(said.converged and said.acceptable),
        said.caution,
        _meaning(fitted, converged=bool(said.converged)),
        [warning.text for warning in said.warnings],
        [statement for statement in said.parameters if statement.constrained],
        [statement for statement in said.parameters if not statement.constrained],
        traded,
        [_prediction(name, predicted, against, said.caution) for name in predicted],
    )


def _meaning(fitted: FittedStudy, *, converged: bool) -> list[str]:
    count = len(fitted.population)
    if fitted.of_the_paper:
        return [
            f"{count} networks were accepted by the paper's rule. They are a population and not a "
            "posterior: how wide it is says nothing of how sure one may be."
        ]
    if not converged:
        return [
            "The two runs have not ended, or do not agree: no number below can be relied on. "
            "A warning says how to go on."
        ]
    said = [
        f"Two independent runs agree. The {count} networks below are equally probable, and what "
        "they span is what the ECG leaves open."
    ]
    checks = fitted.checks
    if checks is None:
        return said
    each = f"{explained_share(checks):.0%}"
    if fit_acceptable(checks):
        said.append(
            f"A network explains {each} of the QRS (median), and none of the independent leads "
            "stands out, nor the window QRS duration or the axis."
        )
    else:
        apart = f" {', '.join(checks.disagreeing)} cannot be theirs." if checks.disagreeing else ""
        said.append(
            f"They do not explain the ECG: a network {each} of the QRS (median), where "
            f"{LEAST_EXPLAINED:.0%} is the least.{apart} The heart, the body or the model is not "
            "the patient's, so that the intervals below are those of a model that does not fit."
        )
    return said


def _prediction(
    name: str, predicted: Mapping[str, Predicted], against: str, warned: Caution | None
) -> str:
    """QRS durations and total activation time of a scenario, and what it shortens."""
    found, other = predicted[name], predicted[against]
    beat = "the intrinsic beat" if against == INTRINSIC else against
    said = ("global_qrs_duration", "qrs_duration", "total_activation_time")
    sentence = ", ".join(f"{index_name(one)} {_interval(found.indices[one])} ms" for one in said)
    if warned is not None:
        sentence = f"{warned.brief}: {sentence}"
    if name in (against, INTRINSIC):
        return f"{sentence}."
    if undone := missing_blocks(name, predicted, against):
        sentence = f"{sentence}. Take care: {undone}"
    pairs = (found, other), (other, found)
    shorter, longer = (compare(*pair, "total_activation_time") for pair in pairs)
    better = shorter.probability()
    if warned is not None:  # nothing is called shorter or longer
        return f"{sentence}; shortened against {beat} by {shorter}; P(shorter) = {better:.2f}."
    likely = "shorter" if better >= LIKELY else "longer" if better <= 1 - LIKELY else "open"
    verb = {
        "shorter": f"Activation shortened against {beat} by {shorter}",
        "longer": f"Activation prolonged against {beat} by {longer}",
        "open": f"Activation against {beat} neither surely shorter nor longer: {shorter}",
    }[likely]
    return f"{sentence}. {verb}; P(shorter) = {better:.2f}."


def _interval(values: Floats) -> str:
    low, middle, high = np.nanpercentile(values, [5, 50, 95])
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"
