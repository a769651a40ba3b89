"""Bayesian optimisation: the first points, and one step."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from fascicle.core.arrays import Floats
from fascicle.core.threads import one_thread
from fascicle.inference.optimisation.acquisition import (
    LOCAL_CENTRES,
    FeasibleLogImprovement,
    maximise,
)
from fascicle.inference.surrogate.exponential import Hyperparameters
from fascicle.inference.surrogate.surrogates import FeasibilityGP, LossGP, Observations

COLD_ITERATIONS = 100
WARM_ITERATIONS = 10


def latin_hypercube(rng: np.random.Generator, count: int, dimension: int) -> Floats:
    """Latin hypercube sample of the unit cube, shape (count, dimension).

    Every coordinate has exactly one point in each of `count` equal intervals.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    count, dimension : int

    References
    ----------
    M. D. McKay, R. J. Beckman, W. J. Conover, "A comparison of three methods for selecting values
    of input variables in the analysis of output from a computer code", Technometrics 21 (1979).
    """
    return np.asarray(qmc.LatinHypercube(d=dimension, rng=rng).random(count), dtype=np.float64)


@dataclass(frozen=True)
class Surrogates:
    """What the optimisation knows: observations, and Gaussian processes conditioned on them.

    Attributes
    ----------
    observations : Observations
        At least one of them feasible.
    learnt_from : int
        How many of them, the first ones, the hyper-parameters were learnt from.
    loss : LossGP
    feasibility : FeasibilityGP
        Not in the paper, whose trees always grow; used to propose points, and for nothing else.
    """

    observations: Observations
    learnt_from: int
    loss: LossGP
    feasibility: FeasibilityGP

    @classmethod
    def learn(cls, observations: Observations, before: Surrogates | None = None) -> Surrogates:
        """Learn the hyper-parameters, starting from earlier ones where there are any."""
        start = before.loss.gp.hyperparameters if before is not None else None
        loss = LossGP.fit(observations, start, iterations(start))
        start = before.feasibility.hyperparameters if before is not None else None
        feasibility = FeasibilityGP.fit(observations, start, iterations(start))
        return cls(observations, len(observations), loss, feasibility)

    def extended(self, observations: Observations) -> Surrogates:
        """Condition on more observations, the new ones last, with the same hyper-parameters."""
        return replace(
            self,
            observations=observations,
            loss=self.loss.extended(observations),
            feasibility=self.feasibility.extended(observations),
        )

    def updated(self, observations: Observations, refit_every: int) -> Surrogates:
        """Condition on more observations; learn again where it is time, or a first tree failed."""
        first_failure = self.feasibility.gp is None and not observations.feasible.all()
        if first_failure or len(observations) - self.learnt_from >= refit_every:
            return Surrogates.learn(observations, self)
        return self.extended(observations)

    def to_json(self) -> str:
        """Give what the observations do not tell, as text; every float comes back exactly."""
        feasibility = self.feasibility.hyperparameters
        return json.dumps(
            {
                "loss": self.loss.gp.hyperparameters.to_json(),
                "feasibility": feasibility.to_json() if feasibility is not None else None,
                "learnt_from": self.learnt_from,
                "observations": len(self.observations),
            }
        )

    @classmethod
    def from_json(cls, text: str, observations: Observations) -> Surrogates:
        """The same again, bit for bit, from the text of `to_json` and the observations since."""
        known = json.loads(text)
        loss = Hyperparameters.from_json(known["loss"])
        labels = known["feasibility"]
        first = observations.first(known["learnt_from"])
        learnt = cls(
            first,
            known["learnt_from"],
            LossGP.condition(first, loss),
            FeasibilityGP.condition(first, Hyperparameters.from_json(labels) if labels else None),
        )
        return learnt.extended(observations.first(known["observations"]))


@one_thread
def step(rng: np.random.Generator, surrogates: Surrogates) -> Floats:
    """Propose the next point to evaluate, shape (d,).

    It maximises expected improvement times the probability of feasibility.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    surrogates : Surrogates
        All that is known.
    """
    observations, loss = surrogates.observations, surrogates.loss
    points = observations.points[observations.feasible]
    mean, _ = loss.gp.predict(points)
    order = np.argsort(mean, kind="stable")
    best = float(mean[order[0]])
    acquisition = FeasibleLogImprovement(loss.gp, surrogates.feasibility, best)
    return maximise(rng, acquisition, points[order[:LOCAL_CENTRES]], observations.points)


def iterations(start: Hyperparameters | None) -> int:
    """How many L-BFGS-B iterations a fit may take from there."""
    return COLD_ITERATIONS if start is None else WARM_ITERATIONS
