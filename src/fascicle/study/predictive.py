"""Posterior prediction: what the networks of a posterior say of the recording, and whether it fits.

Of every network one shift, gain and size of the discrepancy is drawn from what the likelihood says
of them, and one error of that size. If the model is right, the recording looks like one of these
ECGs; A. Gelman, X.-L. Meng and H. Stern, "Posterior predictive assessment of model fitness via
realized discrepancies", Statistica Sinica 6 (1996).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS, independent_rows
from fascicle.core.ranges import short_repr
from fascicle.forward.likelihood import Likelihood
from fascicle.forward.simulation import Signals
from fascicle.recording.target import Target
from fascicle.study.target_comparison import Network

RARE = 0.01  # probability under the model below which the recording disagrees with it


@dataclass(frozen=True)
class Checks:
    """Whether a recording looks like what networks predict.

    Attributes
    ----------
    share : float
        Root mean square of a network's residual over that of the recorded QRS, median of the
        networks.
    probabilities : mapping of str to float
        Probability of a recording at least as far from the networks, for each lead, the window QRS
        duration and the axis; for a lead with the smallest discrepancy of the likelihood, since a
        larger one would hide a misfit.
    """

    share: float
    probabilities: Mapping[str, float]

    @classmethod
    def joined(cls, each: Sequence[Checks]) -> Checks:
        """Those of several recordings in one, with the largest of the discrepancies."""
        if len(each) == 1:
            return each[0]
        named = {
            f"{name} of recording {number}": probability
            for number, checks in enumerate(each, 1)
            for name, probability in checks.probabilities.items()
        }
        return cls(max(checks.share for checks in each), named)

    @property
    def disagreeing(self) -> list[str]:
        """Leads and quantities in which the recording would be rare under the model."""
        return [name for name, p in self.probabilities.items() if p < RARE]


@dataclass(frozen=True)
class Prediction:
    """What n networks predict for the recording."""

    ecg: Floats  # (n, 12 + k, n_time), without noise and discrepancy, at the target's times (mV)
    noisy: Floats  # the same with both
    gains: Floats  # (n,), as the following drawn for each
    shifts: Floats  # of the first activation from the recorded onset (ms)
    discrepancies: Floats  # σ (mV)
    checks: Checks

    __repr__ = short_repr


def predict_recording(
    target: Target, likelihood: Likelihood, networks: Sequence[Network], rng: np.random.Generator
) -> Prediction:
    """Draw what n networks of a posterior predict for a recording, and compare it with that."""
    rows, window = independent_rows(target.used), target.qrs_samples
    drawn = [likelihood.predictive(Signals.of(each.simulation), rng) for each in networks]
    rarer, unexplained = np.empty((len(drawn), len(rows))), np.empty(len(drawn))
    for k, each in enumerate(drawn):
        left, error = each.left, each.error
        if left is None or error is None:
            left = ((target.mean - each.ecg)[rows, window] ** 2).sum(axis=1)
            error = ((each.noisy - each.ecg)[rows, window] ** 2).sum(axis=1)
        rarer[k] = error >= left
        unexplained[k] = left.sum() if each.unexplained is None else each.unexplained
    noisy = np.array([each.noisy for each in drawn])
    probabilities = {
        target.leads[row]: float(p) for row, p in zip(rows, rarer.mean(0), strict=True)
    }
    probabilities["window QRS duration"] = _duration(target, networks)
    probabilities["axis"] = _axis(target, noisy)
    return Prediction(
        np.array([each.ecg for each in drawn]),
        noisy,
        np.array([each.gain for each in drawn]),
        np.array([each.shift for each in drawn]),
        np.array([each.discrepancy for each in drawn]),
        Checks(
            float(np.sqrt(np.median(unexplained) / (target.qrs[rows] ** 2).sum())), probabilities
        ),
    )


def _duration(target: Target, networks: Sequence[Network]) -> float:
    """How probable a recorded QRS duration as far from those of the networks is, both ways."""
    durations = np.array([network.simulation.qrs_duration for network in networks])
    spread = np.hypot(target.onset_sd, target.offset_sd)
    return _two_sided(durations, target.qrs_duration, float(spread))


def _axis(target: Target, noisy: Floats) -> float:
    """How probable a frontal axis as far from those of the networks is, both ways."""
    if not target.used[: len(LIMB_LEADS)].any():
        return 1.0
    window = target.qrs_samples
    recorded = frontal_axis(target.mean[:, window])
    away = np.array([frontal_axis(ecg[:, window]) - recorded for ecg in noisy])
    return _two_sided((away + 180) % 360 - 180, 0.0, 0.0)


def frontal_axis(ecg: Floats) -> float:
    """Angle (degrees) of a QRS (12, n) in the frontal plane, from the areas in leads I and aVF."""
    area = ecg.sum(axis=1)
    # aVF is shorter than I by the factor √3/2 of augmented leads
    return float(np.degrees(np.arctan2(2 / np.sqrt(3) * area[5], area[0])))


def _two_sided(predicted: Floats, recorded: float, sd: float) -> float:
    """Twice the smaller tail of predictions (n,), each blurred by `sd`, beyond a value."""
    from scipy.special import ndtr

    sd = max(sd, 1e-6)  # of values in ms or degrees
    below = float(ndtr((recorded - predicted) / sd).mean())
    return min(1.0, 2 * min(below, 1 - below))
