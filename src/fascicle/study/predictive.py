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
from fascicle.core.leads import LEADS, LIMB_LEADS, independent_rows, limb_leads_from
from fascicle.core.ranges import short_repr
from fascicle.forward.likelihood import MARGIN, QrsLikelihood
from fascicle.forward.loss import placed
from fascicle.recording.target import Target
from fascicle.study.problem import Network, Problem

RARE = 0.01  # probability under the model below which the recording disagrees with it


@dataclass(frozen=True)
class Checks:
    """Whether a recording looks like what networks predict.

    Attributes
    ----------
    share : float
        Size (root mean square) of what a network leaves of the recorded QRS over that of the QRS,
        median of the networks.
    probabilities : mapping of str to float
        How probable a recording at least as far from the networks is, of every lead, of the window
        QRS duration and of the axis. Of a lead, with the least discrepancy that the likelihood
        knows: a larger one would excuse what it is there to show.
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
    """What n networks predict for the recording.

    Attributes
    ----------
    ecg : (n, 12, n_time) array
        Without noise and discrepancy, at the times of the target (mV).
    noisy : (n, 12, n_time) array
        With both (mV).
    gains, shifts, discrepancies : (n,) arrays
        Drawn for each: gain, time of the first activation from the recorded onset (ms), σ (mV).
    checks : Checks
        Against the recording.
    """

    ecg: Floats
    noisy: Floats
    gains: Floats
    shifts: Floats
    discrepancies: Floats
    checks: Checks

    __repr__ = short_repr


def predict_recording(
    problem: Problem,
    likelihood: QrsLikelihood,
    networks: Sequence[Network],
    rng: np.random.Generator,
) -> Prediction:
    """Draw what networks predict for a problem's recording, and compare it with the recording.

    Parameters
    ----------
    problem : Problem
        Its target is what was recorded.
    likelihood : QrsLikelihood
        Of that target.
    networks : sequence of Network
        n of the posterior.
    rng : numpy.random.Generator
        Draws shifts, gains and errors.
    """
    target = problem.target
    rows, begin = independent_rows(target.used), target.qrs_samples.start
    ecg = np.zeros((len(networks), len(LEADS), len(target.time)))
    noisy = ecg.copy()
    drawn, rarer = np.empty((3, len(networks))), np.empty((len(networks), len(rows)))
    unexplained = np.empty(len(networks))
    for k, network in enumerate(networks):
        simulation = network.simulation
        fit = likelihood.fit(simulation.leads[rows], simulation.first_activation)
        place = rng.choice(fit.weights.size, p=fit.weights.ravel() / fit.weights.sum())
        scale, at = np.unravel_index(place, fit.weights.shape)
        gain = rng.normal(fit.gains[scale, at], fit.gain_sds[scale, at])
        shift = float(fit.shifts[at])
        ecg[k] = gain * placed(
            simulation.leads, shift + MARGIN - begin, len(target.time), target.response
        )
        error, least = likelihood.noise(rng, int(scale)), likelihood.noise(rng, 0)
        noisy[k] = ecg[k] + _in_twelve_leads(error @ likelihood.modes.T, target)
        left = likelihood.residual(simulation.leads[rows], shift, gain)
        rarer[k] = (least**2).sum(axis=1) >= ((left @ likelihood.modes) ** 2).sum(axis=1)
        unexplained[k] = (left**2).sum()
        drawn[:, k] = gain, simulation.first_activation - shift - MARGIN, likelihood.scales[scale]
    probabilities = {LEADS[row]: float(p) for row, p in zip(rows, rarer.mean(0), strict=True)}
    probabilities["window QRS duration"] = _duration(target, networks)
    probabilities["axis"] = _axis(target, noisy)
    share = float(np.sqrt(np.median(unexplained) / (target.qrs[rows] ** 2).sum()))
    gains, shifts, discrepancies = drawn
    return Prediction(ecg, noisy, gains, shifts, discrepancies, Checks(share, probabilities))


def _in_twelve_leads(independent: Floats, target: Target) -> Floats:
    """Errors (mV) in independent leads about the QRS, in all leads at the target's times."""
    rows, begin = independent_rows(target.used), target.qrs_samples.start - MARGIN
    out = np.zeros((len(LEADS), len(target.time)))
    inside = np.arange(independent.shape[1]) + begin
    there = (inside >= 0) & (inside < len(target.time))
    out[np.ix_(rows, inside[there])] = independent[:, there]
    limb = limb_leads_from([LEADS[row] for row in rows if row < len(LIMB_LEADS)])
    if limb is not None:
        out[: len(LIMB_LEADS)] = limb @ out[: len(LIMB_LEADS)]
    return out


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
    """Angle (degrees) of the QRS in the frontal plane, from the areas in leads I and aVF.

    Parameters
    ----------
    ecg : (12, n) array
        The QRS (mV).
    """
    area = ecg.sum(axis=1)
    # aVF is shorter than I by the factor √3/2 of augmented leads
    return float(np.degrees(np.arctan2(2 / np.sqrt(3) * area[5], area[0])))


def _two_sided(predicted: Floats, recorded: float, sd: float) -> float:
    """Twice the smaller tail of predictions (n,), each blurred by `sd`, beyond a value."""
    from scipy.special import ndtr

    sd = max(sd, 1e-6)  # of values in ms or degrees
    below = float(ndtr((recorded - predicted) / sd).mean())
    return min(1.0, 2 * min(below, 1 - below))
