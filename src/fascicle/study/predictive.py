"""Posterior prediction: what the networks of a posterior say of the recording, and whether it fits.

Of every network one shift, gain and size of the discrepancy is drawn from what the likelihood says
of them, and one error of that size. If the model is right, the recording looks like one of these
ECGs; A. Gelman, X.-L. Meng and H. Stern, "Posterior predictive assessment of model fitness via
realized discrepancies", Statistica Sinica 6 (1996).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import independent_rows
from fascicle.core.ranges import short_repr
from fascicle.forward.activation_sequence import LATE_QRS, SequenceSummary
from fascicle.forward.likelihood import Likelihood, Replicate
from fascicle.forward.simulation import Signals
from fascicle.recording.criteria import frontal_axis
from fascicle.recording.target import Target
from fascicle.study.agreement import Agreement, agreement
from fascicle.study.settings import FitSettings
from fascicle.study.target_comparison import Network

# What makes a fit poor: a recording that would be rare among those that the model gives, or a QRS
# that not even the best networks explain. What a posterior's other networks explain shows how wide
# it is, not how well the model fits.
LEVEL = 0.1  # nominal chance to call a recording of the model rare; it happens less often
BEST = 0.05  # share of the networks that are the best
LEAST_EXPLAINED = 0.85  # share of the variance of the QRS that the best networks explain
LEAST_IN_TORSO = 0.75  # the same in a torso, which is never quite the patient's
MOST_OFF = 1.5  # times the error of held-out ECGs, by which the emulator may be off the networks'
MOST_SCALED = 2.5  # standard deviations of the gain's prior, by which the median gain is off 1
DURATION, AXIS, ALL_LEADS = "QRS duration", "frontal axis", "all leads together"
# Name in `fascicle.study.agreement.Agreement`, and unit
MEASURED = {DURATION: ("global_qrs_duration_ms", " ms"), AXIS: ("axis_degrees", "°")}


@dataclass(frozen=True)
class Checks:
    """Whether a recording looks like what networks predict.

    Attributes
    ----------
    explained : float
        Share of the variance of the recorded QRS that each of the best networks explains; of a flat
        line 0.
    probabilities : mapping of str to float
        For the QRS duration, the frontal axis, each independent lead and all of them together:
        probability of a recording at least as far from the networks, times how many are looked at
        (Bonferroni). For leads with the smallest discrepancy of the likelihood, since a larger one
        would hide a misfit.
    measured : mapping of str to list of float
        Global QRS duration (ms) and frontal axis (degrees): recorded, then 5th percentile, median
        and 95th of the networks.
    gain : list of float
        By which simulated ECGs are scaled, median of the networks; least and greatest expected.
    emulator : list of float
        Root mean square error of the emulated ECGs of the networks, over that of the ECGs; and of
        held-out ones.
    least_explained : float
        What the best networks must explain.
    sequence : SequenceSummary, optional
        In which sequence the networks activate the ventricles in an intrinsic beat.
    """

    explained: float
    probabilities: Mapping[str, float]
    measured: Mapping[str, list[float]] = field(default_factory=dict)
    gain: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])
    emulator: list[float] = field(default_factory=lambda: [0.0, 0.0])
    least_explained: float = LEAST_EXPLAINED
    sequence: SequenceSummary | None = None

    @classmethod
    def joined(cls, each: Sequence[Checks]) -> Checks:
        """Those of several recordings in one; the least explained, and the gain farthest from 1."""
        if len(each) == 1:
            return each[0]
        numbered = [(f" of recording {number}", checks) for number, checks in enumerate(each, 1)]
        least = min(each, key=lambda checks: checks.explained - checks.least_explained)
        return cls(
            least.explained,
            {
                f"{name}{of}": min(1.0, p * len(each))
                for of, checks in numbered
                for name, p in checks.probabilities.items()
            },
            {f"{name}{of}": m for of, checks in numbered for name, m in checks.measured.items()},
            max((checks.gain for checks in each), key=lambda gain: abs(gain[0] - 1)),
            max((checks.emulator for checks in each), key=lambda error: error[0]),
            least.least_explained,
            next((checks.sequence for checks in each if checks.sequence is not None), None),
        )

    @classmethod
    def from_json(cls, text: str) -> Checks:
        """The inverse of ``json.dumps(asdict(checks))``."""
        values = json.loads(text)
        if (sequence := values.get("sequence")) is not None:
            times = {name: tuple(each) for name, each in sequence["times"].items()}
            values["sequence"] = SequenceSummary(**{**sequence, "times": times})
        return cls(**values)

    @property
    def disagreeing(self) -> list[str]:
        """Leads and quantities in which the recording would be rare under the model."""
        return [name for name, p in self.probabilities.items() if p < LEVEL]

    @property
    def acceptable(self) -> bool:
        """Whether the recording looks like what the networks predict."""
        return not self.failures

    @property
    def said(self) -> str:
        """What the best networks explain."""
        share = math.floor(100 * self.explained + 1e-9)  # what is less than a limit looks it
        return f"{share}% of the QRS explained by the best {BEST:.0%} of networks"

    @property
    def unmapped(self) -> str:
        """How networks are activated otherwise than mapped hearts with this QRS; else empty."""
        recorded = [m[0] for name, m in self.measured.items() if name.startswith(DURATION)]
        if self.sequence is None or not recorded or recorded[0] >= LATE_QRS:
            return ""
        departure = self.sequence.departure
        return f"{departure}: not seen in mapped hearts with this QRS" if departure else ""

    @property
    def emulator_off(self) -> str:
        """Say that the emulator is not of these networks; else empty."""
        found, expected = self.emulator
        if found <= MOST_OFF * expected:
            return ""
        return f"emulator {found:.0%} off these networks, {expected:.0%} expected"

    @property
    def failures(self) -> list[str]:
        """What is wrong, in the order in which a cardiologist looks at it."""
        rare = self.disagreeing
        found = [
            f"{name} {_compared(name, m)}" for name, m in self.measured.items() if name in rare
        ]
        if leads := [name for name in rare if name not in self.measured]:
            found.append(f"{', '.join(leads)} not reproduced")
        if self.explained < self.least_explained:
            found.append(f"{self.said}, less than {self.least_explained:.0%}")
        gain, low, high = self.gain
        if not low <= gain <= high:
            found.append(f"ECG scaled by {gain:.2g}, {low:.2g} to {high:.2g} expected")
        return found


def _compared(name: str, measured: Sequence[float]) -> str:
    recorded, low, middle, high = measured
    unit = next(unit for of, (_, unit) in MEASURED.items() if name.startswith(of))
    return f"{recorded:.0f}{unit} recorded, {middle:.0f} ({low:.0f}–{high:.0f}) simulated"


@dataclass(frozen=True)
class Prediction:
    """What n networks predict for the recording."""

    ecg: Floats  # (n, 12 + k, n_time), without noise and discrepancy, at the target's times (mV)
    noisy: Floats  # the same with both
    gains: Floats  # (n,), as the following drawn for each
    torsos: Floats  # (n, 12 + k, 12 + k), from leads in the plain torso to those in the drawn one
    shifts: Floats  # of the first activation from the recorded onset (ms)
    discrepancies: Floats  # σ (mV)
    checks: Checks
    agreement: Agreement  # of `ecg` with the recording

    __repr__ = short_repr


def predict_recording(
    target: Target,
    likelihoods: Sequence[Likelihood],
    networks: Sequence[Network],
    rng: np.random.Generator,
) -> Prediction:
    """Draw what n networks of a posterior predict for a recording, and compare it with that.

    `likelihoods` are those of each network.
    """
    pairs = zip(likelihoods, networks, strict=True)
    drawn = [likelihood.predictive(Signals.of(n.simulation), rng) for likelihood, n in pairs]
    ecg, noisy = (np.array([getattr(each, name) for each in drawn]) for name in ("ecg", "noisy"))
    found = agreement(target, [replace(n, predicted=e) for n, e in zip(networks, ecg, strict=True)])
    return Prediction(
        ecg,
        noisy,
        np.array([each.gain for each in drawn]),
        np.array([np.eye(len(e.ecg)) if e.torso is None else e.torso for e in drawn]),
        np.array([each.shift for each in drawn]),
        np.array([each.discrepancy for each in drawn]),
        _checks(target, found, drawn, getattr(likelihoods[0], "gain_sd", FitSettings().gain_sd)),
        found,
    )


def _checks(target: Target, found: Agreement, drawn: Sequence[Replicate], gain_sd: float) -> Checks:
    rows, window = independent_rows(target.used), target.qrs_samples
    left, error = np.empty((2, len(drawn), len(rows)))
    unexplained = np.empty(len(drawn))
    for k, each in enumerate(drawn):
        apart = [(target.mean - each.ecg)[rows, window], (each.noisy - each.ecg)[rows, window]]
        energies = [(one**2).sum(axis=1) for one in apart]
        left[k] = energies[0] if each.left is None else each.left
        error[k] = energies[1] if each.error is None else each.error
        unexplained[k] = left[k].sum() if each.unexplained is None else each.unexplained
    leads = {target.leads[row]: _rarer(left[:, k], error[:, k]) for k, row in enumerate(rows)}
    leads[ALL_LEADS] = _rarer(left.sum(axis=1), error.sum(axis=1))
    spread = float(np.hypot(*target.global_qrs_sd))
    measured = {
        name: [found.recorded[key], *found.percentiles(key)]
        for name, (key, _) in MEASURED.items()
        if key in found.recorded
    }
    others = {
        DURATION: _two_sided(found.predicted[MEASURED[DURATION][0]], measured[DURATION][0], spread)
    }
    if AXIS in measured:
        axes = np.array([frontal_axis(each.noisy[:, window]) for each in drawn])
        others[AXIS] = _rare_axis(axes, measured[AXIS][0])
    # the leads together weigh as much as the duration or the axis
    parts, off = len(others) + 1, MOST_SCALED * gain_sd + 1e-9
    weighted = {n: p * parts for n, p in others.items()}
    weighted |= {name: p * parts * len(leads) for name, p in leads.items()}
    return Checks(
        1 - float(np.quantile(unexplained, BEST)) / float((target.qrs[rows] ** 2).sum()),
        {name: min(1.0, p) for name, p in weighted.items()},
        measured,
        [float(np.median([each.gain for each in drawn])), max(1 - off, 0.0), 1 + off],
    )


def _rarer(left: Floats, error: Floats) -> float:
    """How probable an error (n,) as large as what a network leaves (n,) is.

    Every network with the errors of all, whose distribution is the same.
    """
    return float(1 - np.searchsorted(np.sort(error), left).mean() / len(error))


def _rare_axis(axes: Floats, recorded: float) -> float:
    """How probable an axis (degrees) as far from those of networks (n,) is, both ways."""
    mean = float(np.degrees(np.angle(np.exp(1j * np.radians(axes)).mean())))
    turns = (np.append(axes, recorded) - mean + 180) % 360 - 180
    return _two_sided(turns[:-1], float(turns[-1]), 0.0)


def _two_sided(predicted: Floats, recorded: float, sd: float) -> float:
    """Twice the smaller tail of predictions (n,), each blurred by `sd`, beyond a value."""
    from scipy.special import ndtr

    sd = max(sd, 1e-6)  # of values in ms or degrees
    below = float(ndtr((recorded - predicted) / sd).mean())
    return min(1.0, 2 * min(below, 1 - below))
