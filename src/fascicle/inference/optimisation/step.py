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
    Box,
    FeasibleLogImprovement,
    maximise,
)
from fascicle.inference.surrogate.exponential import Hyperparameters
from fascicle.inference.surrogate.surrogates import FeasibilityGP, LossGP, Observations

LOCAL_SHARE = 0.6  # of the proposals
LOCAL_RADIUS = (0.03, 0.3)  # of the unit cube, log-uniform
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
class State:
    """All that a step depends on besides its random numbers.

    Attributes
    ----------
    observations : Observations
        At least one of them feasible.
    loss, feasibility : Hyperparameters or None
        Of the last fits; None before the first one (and while every point is feasible).
    """

    observations: Observations
    loss: Hyperparameters | None = None
    feasibility: Hyperparameters | None = None

    def hyperparameters_to_json(self) -> str:
        """Give the hyper-parameters as text; every float comes back exactly."""
        both = {"loss": self.loss, "feasibility": self.feasibility}
        return json.dumps(
            {name: h.to_json() if h is not None else None for name, h in both.items()}
        )

    @classmethod
    def from_json(cls, observations: Observations, text: str | None) -> State:
        """Make the state with hyper-parameters from text; None for a cold start."""
        both = json.loads(text) if text is not None else {"loss": None, "feasibility": None}
        known = {
            k: Hyperparameters.from_json(v) if v is not None else None for k, v in both.items()
        }
        return cls(observations, **known)


def refit(state: State) -> tuple[State, LossGP, FeasibilityGP]:
    """Learn the hyper-parameters anew, from those of the state, and condition on its data."""
    loss = LossGP.fit(state.observations, state.loss, _iterations(state.loss))
    feasibility = FeasibilityGP.fit(
        state.observations, state.feasibility, _iterations(state.feasibility)
    )
    fitted = replace(state, loss=loss.gp.hyperparameters, feasibility=feasibility.hyperparameters)
    return fitted, loss, feasibility


@one_thread
def step(rng: np.random.Generator, state: State, batch: int = 1) -> tuple[State, Floats]:
    """Propose the next points to evaluate.

    Refits the surrogates, then maximises expected improvement times the probability of
    feasibility. The points of a batch are chosen one after another, each believing the surrogate's
    mean at those before it (kriging believer; Ginsbourger, Le Riche & Carraro 2010).

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    state : State
        Observations so far and the hyper-parameters of the last step.
    batch : int
        How many points to propose.

    Returns
    -------
    state : State
        The same observations with the new hyper-parameters.
    points : (batch, d) array
        In the unit cube.
    """
    fitted, loss, feasibility = refit(state)
    known = state.observations
    proposals: list[Floats] = []
    for _ in range(batch):
        if proposals:
            loss, known = loss.with_guess(known, proposals[-1])
        proposals.append(_propose(rng, known, loss, feasibility))
    return fitted, np.array(proposals)


def _iterations(start: Hyperparameters | None) -> int:
    return COLD_ITERATIONS if start is None else WARM_ITERATIONS


def _propose(
    rng: np.random.Generator, observations: Observations, loss: LossGP, feasibility: FeasibilityGP
) -> Floats:
    points = observations.points[observations.feasible]
    mean, _ = loss.gp.predict(points)
    order = np.argsort(mean, kind="stable")
    acquisition = FeasibleLogImprovement(loss.gp, feasibility, float(mean[order[0]]))
    centres = points[order[:LOCAL_CENTRES]]
    return maximise(rng, acquisition, centres, observations.points, _box(rng, centres[0]))


def _box(rng: np.random.Generator, best: Floats) -> Box:
    """Where to look for the next point: near the best one, or everywhere.

    In twelve dimensions expected improvement everywhere is mostly that of corners far from all
    data; looking more often than not in a box about the best point, as trust-region methods do
    (Eriksson et al., NeurIPS 2019), is what finds improvements.
    """
    if rng.random() >= LOCAL_SHARE:
        return Box(np.zeros(len(best)), np.ones(len(best)))
    low, high = np.log(LOCAL_RADIUS)
    return Box.around(best, float(np.exp(rng.uniform(low, high))))
