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
    beat_noise,
    cosines,
    discrepancy_in_time,
    lead_pattern,
    matern,
    separable,
)
from fascicle.forward.loss import placed
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Signals
from fascicle.recording.target import Target
from fascicle.study.simulator import PointSimulator


@dataclass(frozen=True)
class PriorKnowledge:
    """What networks of the prior tell: covariances of the leads, of shape (n_leads, n_leads)."""

    pattern: Floats  # of the discrepancy, of unit mean variance
    roughness: Floats  # of what changes by next to nothing change, over the QRS (mV²)


def likelihood_of(target: Target, known: PriorKnowledge, gain_sd: float) -> QrsLikelihood:
    """Make the likelihood of a target; `gain_sd` is the standard deviation of the gain about 1."""
    modes = cosines(target.qrs.shape[1])
    smooth, discrepancy = matern(len(modes)), discrepancy_in_time(len(modes))
    known_covariance = beat_noise(target) + separable(known.roughness, smooth, modes)
    return QrsLikelihood(
        target, known_covariance, separable(known.pattern, discrepancy, modes), gain_sd
    )


def prior_knowledge(
    simulator: PointSimulator,
    target: Target,
    scenario: Scenario | None,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> PriorKnowledge:
    """Simulate 100 networks of the prior, and each once more with next to nothing changed.

    The independent leads of the target, which was recorded in the scenario, are compared.
    """
    count, rows = 100, independent_rows(target.used)
    points = rng.random((count, len(simulator.space)))
    # by a thousandth of the range of every parameter, reflected at its ends
    changed = np.abs(points + 0.001 * rng.standard_normal(points.shape))
    changed = np.where(changed > 1, 2 - changed, changed)
    report = stage_progress(progress, "prior")
    found: list[tuple[Floats, Floats]] = []
    for start in range(0, count, 10):
        part = slice(start, start + 10)
        both = [*simulator.signals([*points[part], *changed[part]], scenario)]
        for one, other in zip(both[:10], both[10:], strict=True):
            if isinstance(one, Signals) and isinstance(other, Signals):
                found.append((_from_activation(one, rows), _from_activation(other, rows)))
        report(part.stop, count)
    if len(found) < 10:
        raise InputError(
            f"only {len(found)} of {count} networks of the prior fit this heart; check the "
            "heart, or narrow the ranges of the lengths"
        )
    differences = [first - second for (first, _), (second, _) in pairwise(found)]
    rough = [(one - other) / np.sqrt(2) for one, other in found]
    # The median: a few networks lose a whole branch, which the discrepancy's size must cover.
    energy = float(np.median([(each**2).sum() for each in rough]))
    variance = energy / (len(rows) * target.qrs.shape[1])
    return PriorKnowledge(lead_pattern(differences), variance * lead_pattern(rough))


def _from_activation(ecg: Signals, rows: Integers) -> Floats:
    """Some leads (mV) from 20 ms before the first activation on, for 320 ms."""
    return placed(ecg.leads[rows], ecg.first_activation - 20, 320)
