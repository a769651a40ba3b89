"""The networks that a study finds, and their file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.ranges import short_repr
from fascicle.inference.abc import Accepted
from fascicle.inference.evaluation import Evaluation
from fascicle.inference.importance_sampling import RunAgreement, State
from fascicle.study.settings import Method

# The file that holds the networks, called what it is
RESULT: dict[Method, str] = {"paper": "population.nc", "posterior": "posterior.nc"}


@dataclass(frozen=True)
class Population:
    """The networks that explain a target, and the best one.

    Attributes
    ----------
    values : mapping of name to (n,) array
        Parameters of the networks, in their units.
    losses : (n,) array
        Mismatch (mV²).
    best : mapping of name to float
        The parameters with the least mismatch that the search has found.
    best_loss : float
        That mismatch (mV²).
    """

    values: Mapping[str, Floats]
    losses: Floats
    best: Mapping[str, float]
    best_loss: float

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.losses)

    @property
    def effective_size(self) -> float:
        """How many independent networks they are worth."""
        return float(len(self))

    def parameters(self, k: int) -> dict[str, float]:
        """Named parameters of network `k`."""
        return {name: float(values[k]) for name, values in self.values.items()}


@dataclass(frozen=True)
class PaperPopulation(Population):
    """What the paper's rule of acceptance keeps.

    Attributes
    ----------
    distances : (n,) array
        Total-variation distance of the per-beat errors from the best network's.
    """

    distances: Floats

    __repr__ = short_repr

    @classmethod
    def of(cls, space: ParameterSpace, accepted: Accepted) -> PaperPopulation:
        """Name the parameters of accepted evaluations."""
        best, losses = accepted.reference, np.array([e.loss for e in accepted.evaluations])
        values = _named(space, accepted.evaluations)
        return cls(values, losses, space.from_unit(best.point), best.loss, accepted.distances)


@dataclass(frozen=True)
class Posterior(Population):
    """Equally weighted draws from a posterior, those of one run after those of the other.

    Attributes
    ----------
    log_likelihoods : (n, n_recordings) array
    log_evidences, effective, evaluations : (2,) arrays
        Of each run: log-evidence, effective sample size, evaluations.
    means_apart : mapping of name to float
        Between the runs, in standard deviations.
    converged : bool
        Whether both runs ended by themselves, and agree.
    first_alone : mapping of name to (m,) array, optional
        Of several recordings, draws from the posterior of the first, if that has converged.
    """

    log_likelihoods: Floats
    log_evidences: Floats
    effective: Floats
    evaluations: Floats
    means_apart: Mapping[str, float]
    converged: bool
    first_alone: Mapping[str, Floats] | None = None

    __repr__ = short_repr

    @property
    def effective_size(self) -> float:
        """How many independent draws they are worth: half of them are of each run."""
        each = np.minimum(self.effective, len(self) / len(self.effective))
        return float(len(each) ** 2 / (1 / each).sum())

    @classmethod
    def of(
        cls,
        space: ParameterSpace,
        draws: Sequence[Evaluation],
        best: Evaluation,
        ends: Sequence[State],
        agreed: RunAgreement,
    ) -> Posterior:
        """Name the parameters of draws.

        Parameters
        ----------
        space : ParameterSpace
            The d parameters.
        draws : sequence of Evaluation
            As many of each run.
        best : Evaluation
            The one with the least mismatch of all.
        ends : sequence of State
            Of each run.
        agreed : RunAgreement
            Between them.
        """
        return cls(
            _named(space, draws),
            np.array([draw.loss for draw in draws]),
            space.from_unit(best.point),
            best.loss,
            np.array([draw.log_likelihoods for draw in draws]),
            np.array([end.log_evidence for end in ends]),
            np.array([end.effective for end in ends]),
            np.array([float(end.evaluations) for end in ends]),
            dict(zip(space.names, map(float, agreed.means), strict=True)),
            agreed.converged,
        )


def _named(space: ParameterSpace, evaluations: Sequence[Evaluation]) -> dict[str, Floats]:
    named = [space.from_unit(evaluation.point) for evaluation in evaluations]
    return {name: np.array([values[name] for values in named]) for name in space.names}
