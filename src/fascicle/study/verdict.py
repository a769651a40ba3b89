"""What a posterior says, in words: whether to trust it, and what the ECG determines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.inference.importance_sampling import EVIDENCE_APART, MEANS_APART
from fascicle.study.population import Posterior
from fascicle.study.predictive import Checks

MOST_LEFT = 0.35  # of the signal (root mean square): an eighth of its energy is not the model's
LEAST_EXPLAINED = 1 - MOST_LEFT**2  # of its energy
DETERMINED = 0.5  # share of a prior's variance; below it, the ECG determines the parameter
TRADED = 0.7  # rank correlation beyond which two parameters are strongly correlated
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
    first_alone : float, optional
        Of several recordings, half of the 90 % interval that the first alone leaves.
    """

    name: str
    unit: str
    median: float
    lower: float
    upper: float
    contraction: float
    first_alone: float | None = None

    @property
    def determined(self) -> bool:
        """Whether the ECG determines it."""
        return self.contraction >= 1 - DETERMINED

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        found = f"{self.median:.3g}{unit}, 90 % within {self.lower:.3g} to {self.upper:.3g}"
        half = (self.upper - self.lower) / 2
        known = f"±{half:.2g}{unit}"
        if self.first_alone is not None:
            known += f", by the first recording alone ±{self.first_alone:.2g}{unit}"
        if not self.determined:
            before = f"{known}; " if self.first_alone is not None else ""
            return f"the ECG does not determine this ({before}{found})"
        return f"the ECG determines this to {known} ({found})"


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
    why = [f"{posterior.effective.sum():.0f} effective draws"]
    if abs(one - other) > EVIDENCE_APART:
        why.append(f"log evidence {one:.1f} and {other:.1f} of two runs")
    if apart > MEANS_APART:
        why.append(f"means of {name} {apart:.1f} standard deviations apart")
    return f"NOT CONVERGED ({', '.join(why)})"


def _explanation(checks: Checks) -> str:
    each = f"a network explains {explained_share(checks):.0%} of the QRS"
    if explained(checks):
        return f"explained: {each}"
    little = f", less than {LEAST_EXPLAINED:.0%}" if checks.share > MOST_LEFT else ""
    rare = f", and {', '.join(checks.disagreeing)} disagree" if checks.disagreeing else ""
    return f"NOT EXPLAINED: {each}{little}{rare}"


def explained_share(checks: Checks) -> float:
    """Share of the energy of the QRS that a network explains (median).

    Below 0, it is further from the recording than a flat line.
    """
    return 1 - checks.share**2


def how_to_go_on(posterior: Posterior, effective: int, evaluations: int) -> str:
    """Say with which settings a fit whose runs do not agree goes on; empty if they agree.

    Parameters
    ----------
    posterior : Posterior
        Of two runs.
    effective, evaluations : int
        The settings of both together.
    """
    if posterior.converged:
        return ""
    if posterior.evaluations.sum() < evaluations:
        return (
            f"both runs have their {effective} effective draws, but do not agree: the same command "
            f"with --effective {2 * effective} goes on where they stopped"
        )
    # the effective sample grows with the evaluations, of the slower run, too
    slowest = float((posterior.evaluations / posterior.effective).max())
    enough = _rounded_up(max(slowest * effective, 2 * posterior.evaluations.sum()))
    return (
        f"the runs have {posterior.effective.sum():.0f} of {effective} effective draws after "
        f"{posterior.evaluations.sum():.0f} evaluations beside the bank: the same command with "
        f"--evaluations {enough} goes on where they stopped, and at this rate that is enough"
    )


def _rounded_up(number: float) -> int:
    """The next number of two digits and zeros."""
    step = 10 ** max(0, int(np.log10(number)) - 1)
    return int(step * np.ceil(number / step))


def explained(checks: Checks) -> bool:
    """Whether the recording looks like what the networks predict."""
    return checks.share <= MOST_LEFT and not checks.disagreeing


def statements(posterior: Posterior, space: ParameterSpace) -> list[Statement]:
    """Say of every parameter what the ECG determines.

    Parameters
    ----------
    posterior : Posterior
        Its draws.
    space : ParameterSpace
        The priors.
    """
    alone = posterior.first_alone or {}
    return [_statement(p, posterior.values[p.name], alone.get(p.name)) for p in space.parameters]


def _statement(parameter: Parameter, values: Floats, first_alone: Floats | None) -> Statement:
    left = float(np.var(parameter.to_unit(values)) * 12)  # a uniform share has variance 1/12
    median, lower, upper = (float(np.percentile(values, share)) for share in (50, *INTERVAL))
    before = None if first_alone is None else half_width(first_alone)
    return Statement(parameter.name, parameter.unit, median, lower, upper, 1 - min(left, 1), before)


def half_width(values: Floats) -> float:
    """Half of the 90 % interval of draws (n,)."""
    return float(np.diff(np.percentile(values, INTERVAL))[0]) / 2


def prediction_statement(values: Floats, prior: Floats) -> str:
    """Say in words whether the ECG determines something that is predicted (ms).

    Parameters
    ----------
    values, prior : (n,) and (m,) arrays
        Of the networks, and of networks of the prior.
    """
    half, before = half_width(values), half_width(prior)
    if np.var(values) <= DETERMINED * np.var(prior):
        return f"the ECG determines this to ±{half:.0f} ms (±{before:.0f} without it)"
    return f"the ECG does not determine this (±{half:.0f} ms, ±{before:.0f} without it)"


def trade_offs(posterior: Posterior) -> list[tuple[str, str, float]]:
    """Pairs of parameters that are strongly correlated, with their rank correlation."""
    from scipy.stats import spearmanr

    names: Sequence[str] = list(posterior.values)
    found = [(a, b, float(spearmanr(posterior.values[a], posterior.values[b]).statistic))
             for a, b in combinations(names, 2)]  # fmt: skip
    return [pair for pair in found if abs(pair[2]) >= TRADED]
