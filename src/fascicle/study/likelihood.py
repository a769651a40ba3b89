"""The likelihood of a study's target: its noise, and what networks of the prior tell beforehand.

Two things are learnt from a few networks of the prior, before any is compared with the recording.
How differences between networks are spread over the leads is how a discrepancy is expected to be:
large where all signals are large, and alike in neighbouring leads. And the same networks with all
parameters changed by next to nothing show how rough the forward model is: where branches just
collide or just do not, the ECG jumps.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import independent_rows
from fascicle.core.progress import Progress, stage_progress
from fascicle.forward.likelihood import (
    QrsLikelihood,
    cosines,
    discrepancy_in_time,
    lead_pattern,
    matern,
    separable,
)
from fascicle.forward.loss import placed
from fascicle.forward.simulation import Simulation
from fascicle.recording.covariance import residual_covariance
from fascicle.recording.target import Target
from fascicle.study.problem import Problem

NETWORKS = 100  # of the prior
CHANGE = 0.001  # of the range of every parameter: standard deviation of "next to nothing"
FEWEST = 10  # networks that must fit
BEFORE, LENGTH = 20, 320  # samples of an ECG before its first activation, and in all


@dataclass(frozen=True)
class PriorKnowledge:
    """What networks of the prior tell.

    Attributes
    ----------
    pattern : (n_leads, n_leads) array
        Covariance of the leads of the discrepancy, of unit mean variance.
    roughness : (n_leads, n_leads) array
        Covariance of the leads (mV²) of what changes by next to nothing change, over the QRS.
    """

    pattern: Floats
    roughness: Floats


def qrs_likelihood(
    problem: Problem, rng: np.random.Generator, gain_sd: float, progress: Progress | None = None
) -> QrsLikelihood:
    """Make the likelihood of a problem's target.

    Parameters
    ----------
    problem : Problem
        Forward model, target, and the prior.
    rng : numpy.random.Generator
        Draws the networks of the prior.
    gain_sd : float
        Standard deviation of the gain about 1.
    progress : Progress, optional
        Called as networks are simulated.
    """
    rows = independent_rows(problem.target.used)
    return likelihood_of(problem.target, prior_knowledge(problem, rows, rng, progress), gain_sd)


def likelihood_of(target: Target, known: PriorKnowledge, gain_sd: float) -> QrsLikelihood:
    """Make the likelihood of a target, with what is known beforehand.

    Parameters
    ----------
    target : Target
        What was recorded.
    known : PriorKnowledge
        Of the leads that it has.
    gain_sd : float
        Standard deviation of the gain about 1.
    """
    rows = independent_rows(target.used)
    modes = cosines(target.qrs.shape[1])
    smooth, discrepancy = matern(len(modes)), discrepancy_in_time(len(modes))
    return QrsLikelihood(
        target.qrs[rows],
        beat_noise(target, rows) + separable(known.roughness, smooth, modes),
        separable(known.pattern, discrepancy, modes),
        target.onset_sd,
        gain_sd,
        target.response,
    )


def beat_noise(target: Target, rows: Integers) -> Floats:
    """Covariance (n, n) of the coefficients of the mean beat (mV²): of one beat, over their number.

    A single beat has its stated noise.
    """
    covariance = residual_covariance(target)
    count = 1 if target.noise is not None else len(target.beats)
    modes = cosines(target.qrs.shape[1])
    margin = (len(modes) - target.qrs.shape[1]) // 2
    scaled = [covariance.sd[row][:, None] * modes[margin:-margin] for row in rows]
    pairs = list(zip(rows, scaled, strict=True))
    blocks = [
        [covariance.leads[i, j] * left.T @ covariance.time @ right for j, right in pairs]
        for i, left in pairs
    ]
    return np.asarray(np.block(blocks) / count)


def prior_knowledge(
    problem: Problem, rows: Integers, rng: np.random.Generator, progress: Progress | None = None
) -> PriorKnowledge:
    """Simulate networks of the prior, and each once more with next to nothing changed.

    Parameters
    ----------
    problem, rng, progress
        As for `qrs_likelihood`.
    rows : (n_leads,) array
        The leads that are compared.

    Raises
    ------
    InputError
        If hardly any network of the prior fits the heart.
    """
    points = rng.random((NETWORKS, len(problem.space)))
    changed = np.abs(points + CHANGE * rng.standard_normal(points.shape))
    changed = np.where(changed > 1, 2 - changed, changed)
    report = stage_progress(progress, "prior")
    found: list[tuple[Floats, Floats]] = []
    for start in range(0, NETWORKS, NETWORKS // 10):
        part = slice(start, start + NETWORKS // 10)
        both = problem.simulate([*points[part], *changed[part]])
        for one, other in zip(both[: len(both) // 2], both[len(both) // 2 :], strict=True):
            if isinstance(one, Simulation) and isinstance(other, Simulation):
                found.append(_from_activation(one, other, rows))
        report(part.stop, NETWORKS)
    if len(found) < FEWEST:
        raise InputError(
            f"only {len(found)} of {NETWORKS} networks of the prior fit this heart; check the "
            "heart, or narrow the ranges of the lengths"
        )
    differences = [first - second for (first, _), (second, _) in pairwise(found)]
    rough = [(one - other) / np.sqrt(2) for one, other in found]
    # The median: a few networks lose a whole branch, which the discrepancy's size must cover.
    energy = float(np.median([(each**2).sum() for each in rough]))
    variance = energy / (len(rows) * problem.target.qrs.shape[1])
    return PriorKnowledge(lead_pattern(differences), variance * lead_pattern(rough))


def _from_activation(one: Simulation, other: Simulation, rows: Integers) -> tuple[Floats, Floats]:
    """Both ECGs (mV) from a little before their first activation on, as long as all ECGs here."""
    cut = (
        placed(each.leads[rows], each.first_activation - BEFORE, LENGTH) for each in (one, other)
    )
    return next(cut), next(cut)
