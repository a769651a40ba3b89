"""What must stand beside the numbers of a study that has not converged, or does not explain."""

from __future__ import annotations

from dataclasses import dataclass

from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Posterior
from fascicle.study.verdict import explained


@dataclass(frozen=True)
class Caution:
    """Why numbers are not to be taken for facts.

    Attributes
    ----------
    brief : str
        What a sentence begins with.
    text : str
        What stands above tables and figures, and in files.
    """

    brief: str
    text: str


NOT_CONVERGED = Caution("not to be relied on", "not to be relied on: the fit has not converged")
NOT_EXPLAINED = Caution(
    "by a model that does not fit", "intervals are those of a model that does not fit the ECG"
)


def caution(fitted: FittedStudy) -> Caution | None:
    """What to say beside every number of a study; None of one whose posterior can be relied on.

    The population of the paper's method is no posterior, which its verdict says: also None.
    """
    population = fitted.population
    if not isinstance(population, Posterior):
        return None
    if not population.converged:
        return NOT_CONVERGED
    return None if fitted.checks is None or explained(fitted.checks) else NOT_EXPLAINED


def caution_text(fitted: FittedStudy) -> str | None:
    """`Caution.text`, or None."""
    found = caution(fitted)
    return None if found is None else found.text
