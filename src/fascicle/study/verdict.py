"""What a posterior says, in words: whether to trust it, and what the ECG determines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.forward.likelihood import SHARES
from fascicle.study.population import Posterior
from fascicle.study.predictive import Checks

MOST_DISCREPANCY = 0.35  # of the signal; with more, an eighth of its energy is not the model's
LEAST_SEEN = float(SHARES[1])  # of the signal; the likelihood takes it to be no smaller
DETERMINED = 0.5  # share of a prior's variance; below it, the ECG determines the parameter
TRADED = 0.7  # rank correlation beyond which two parameters stand for one another
INTERVAL = (5, 95)  # percentiles


@dataclass(frozen=True)
class Statement:
    """What the ECG says of one parameter.

    Attributes
    ----------
    name, unit : str
    median, lower, upper : float
        Of the posterior; `lower` and `upper` are its 5th and 95th percentiles.
    contraction : float
        1 less the posterior's variance over the prior's, in shares of the prior; 0 to 1.
    """

    name: str
    unit: str
    median: float
    lower: float
    upper: float
    contraction: float

    @property
    def determined(self) -> bool:
        """Whether the ECG determines it."""
        return self.contraction >= 1 - DETERMINED

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        found = f"{self.median:.3g}{unit}, 90 % within {self.lower:.3g} to {self.upper:.3g}"
        if not self.determined:
            return f"the ECG does not determine this ({found})"
        half = (self.upper - self.lower) / 2
        return f"the ECG determines this to ±{half:.2g}{unit} ({found})"


def verdict(posterior: Posterior, checks: Checks) -> str:
    """Say in one line whether the runs agree, and whether the model explains the recording.

    Parameters
    ----------
    posterior : Posterior
        Of two runs.
    checks : Checks
        Against the recording.
    """
    return f"{_convergence(posterior)}; {_explanation(checks)}"


def _convergence(posterior: Posterior) -> str:
    if posterior.converged:
        return "converged"
    one, other = posterior.log_evidences
    name, apart = max(posterior.means_apart.items(), key=lambda item: item[1])
    return (
        f"NOT CONVERGED (log evidence {one:.1f} and {other:.1f} of two runs, means of {name} "
        f"{apart:.1f} standard deviations apart, {posterior.effective.sum():.0f} effective "
        "draws): raise --evaluations or --bank"
    )


def _explanation(checks: Checks) -> str:
    least = " at most" if checks.share <= LEAST_SEEN else ""
    size = f"what no network explains is{least} {checks.share:.0%} of the signal"
    rare = f", and {', '.join(checks.disagreeing)} disagree" if checks.disagreeing else ""
    return f"{'explained' if explained(checks) else 'NOT EXPLAINED'}: {size}{rare}"


def explained(checks: Checks) -> bool:
    """Whether the recording looks like what the networks predict."""
    return checks.share <= MOST_DISCREPANCY and not checks.disagreeing


def statements(posterior: Posterior, space: ParameterSpace) -> list[Statement]:
    """Say of every parameter what the ECG determines.

    Parameters
    ----------
    posterior : Posterior
        Its draws.
    space : ParameterSpace
        The priors.
    """
    return [_statement(p, posterior.values[p.name]) for p in space.parameters]


def _statement(parameter: Parameter, values: Floats) -> Statement:
    lower, median, upper = np.percentile(values, [INTERVAL[0], 50, INTERVAL[1]])
    left = float(np.var(parameter.to_unit(values)) * 12)  # a uniform share has variance 1/12
    return Statement(
        parameter.name, parameter.unit, float(median), float(lower), float(upper), 1 - min(left, 1)
    )


def prediction_statement(values: Floats, prior: Floats) -> str:
    """Say in words whether the ECG determines something that is predicted (ms).

    Parameters
    ----------
    values, prior : (n,) and (m,) arrays
        Of the networks, and of networks of the prior.
    """
    half, before = (
        float(np.diff(np.percentile(each, INTERVAL))[0]) / 2 for each in (values, prior)
    )
    if np.var(values) <= DETERMINED * np.var(prior):
        return f"the ECG determines this to ±{half:.0f} ms (±{before:.0f} without it)"
    return f"the ECG does not determine this (±{half:.0f} ms, ±{before:.0f} without it)"


def trade_offs(posterior: Posterior) -> list[tuple[str, str, float]]:
    """Pairs of parameters that stand for one another, with their rank correlation."""
    from scipy.stats import spearmanr

    names: Sequence[str] = list(posterior.values)
    found = [(a, b, float(spearmanr(posterior.values[a], posterior.values[b]).statistic))
             for a, b in combinations(names, 2)]  # fmt: skip
    return [pair for pair in found if abs(pair[2]) >= TRADED]
