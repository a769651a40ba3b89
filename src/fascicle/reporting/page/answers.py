"""What a study found, in words: whether to believe it, what the ECG told, what pacing would do."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fascicle.prediction.comparison import compare, missing_blocks
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.reporting.names import index_name, parameter_name
from fascicle.study.fitted import FittedStudy
from fascicle.study.statements import LEAST_EXPLAINED, Caution, explained_share, fit_acceptable


def meaning(fitted: FittedStudy) -> list[str]:
    """What the verdict means, in whole sentences."""
    count, checks = len(fitted.population), fitted.checks
    if fitted.of_the_paper:
        return [
            f"{count} networks were accepted by the paper's rule. They are a population and not a "
            "posterior: their spread is no measure of uncertainty."
        ]
    if not fitted.statements.converged:
        return [
            "The two runs have not ended, or do not agree: no number below can be relied on. "
            "A warning says how to go on."
        ]
    said = [
        f"Two independent runs agree. The {count} networks below are equally probable, and their "
        "spread is what the ECG leaves open."
    ]
    if checks is None:
        return said
    each = f"{explained_share(checks):.0%}"
    if fit_acceptable(checks):
        return [
            *said,
            f"A network explains {each} of the variance of the QRS (median). The independent "
            "leads, the window QRS duration and the axis are all within what networks predict.",
        ]
    apart = f" {', '.join(checks.disagreeing)} cannot be theirs." if checks.disagreeing else ""
    return [
        *said,
        f"They do not explain the ECG: a network explains {each} of the variance of the QRS "
        f"(median), where {LEAST_EXPLAINED:.0%} is the least.{apart} The heart, the torso or the "
        "model is not the patient's: the intervals below are those of a model that does not fit.",
    ]


def correlations(fitted: FittedStudy) -> list[str]:
    """Which parameters are strongly correlated in the posterior."""
    return [
        f"{parameter_name(pair.first)} and {parameter_name(pair.second)} are strongly correlated "
        f"in the posterior (rank correlation {pair.rank_correlation:.2f})."
        for pair in fitted.statements.correlated
    ]


def prediction(
    name: str, predicted: Mapping[str, Predicted], against: str, caution: Caution | None
) -> str:
    """QRS durations and total activation time of a scenario, and how it compares with another."""
    found, other = predicted[name], predicted[against]
    said = []
    for index in ("global_qrs_duration", "qrs_duration", "total_activation_time"):
        low, middle, high = np.nanpercentile(found.indices[index], [5, 50, 95])
        said.append(f"{index_name(index)} {middle:.0f} ms ({low:.0f} to {high:.0f})")
    sentence = ", ".join(said)
    if caution is not None:
        sentence = f"{caution.brief}: {sentence}"
    if name in (against, INTRINSIC):
        return f"{sentence}."
    if undone := missing_blocks(name, predicted, against):
        sentence = f"{sentence}. Take care: {undone}"
    beat = "the intrinsic beat" if against == INTRINSIC else against
    index = "total_activation_time"
    reduction = compare(found, other, index)
    change = f"shortened by {reduction}"
    if reduction.median < 0:
        change = f"prolonged by {compare(other, found, index)}"
    shorter = f"P(shorter) = {reduction.probability():.2f}"
    return f"{sentence}. Activation {change} against {beat}; {shorter}."
