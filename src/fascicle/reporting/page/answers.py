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
    """QRS durations and total activation time of a scenario, and how it compares.

    Parameters
    ----------
    name, against : str
        The scenario, and the one that it is compared with.
    predicted : mapping of name to Predicted
        Both, the intrinsic beat among them.
    caution : Caution, optional
        Why numbers are not to be taken for facts.
    """
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
    gain, loss = (
        compare(*pair, "total_activation_time") for pair in ((found, other), (other, found))
    )
    change = f"shortened by {gain}" if gain.median >= 0 else f"prolonged by {loss}"
    return f"{sentence}. Activation {change} against {beat}; P(shorter) = {gain.probability():.2f}."
