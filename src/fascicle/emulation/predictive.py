"""Posterior prediction: recordings predicted by a posterior's networks, and checks of the fit.

For every network a shift, a gain and a size of the discrepancy are drawn from their distribution
under the likelihood, and an error of that size. If the model is right, the recording looks like one
of these ECGs (A. Gelman, X.-L. Meng and H. Stern, "Posterior predictive assessment of model fitness
via realized discrepancies", Statistica Sinica 6, 1996).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import independent_rows
from fascicle.core.ranges import short_repr
from fascicle.forward.activation_sequence import LATE_QRS, SequenceSummary
from fascicle.forward.likelihood import Likelihood, Replicate
from fascicle.networks.agreement import Agreement, agreement
from fascicle.networks.settings import FitSettings
from fascicle.networks.target_comparison import Network
from fascicle.recording.criteria import frontal_axis
from fascicle.recording.target import Target
from fascicle.recording.window import OFFSET_ERROR, ONSET_ERROR

DURATION, AXIS = "QRS duration", "frontal axis"
# Name in `fascicle.networks.agreement.Agreement`, and unit
MEASURED = {DURATION: ("qrs_duration_ms", " ms"), AXIS: ("axis_degrees", "°")}


@dataclass(frozen=True)
class Checks:
    """True if a recording looks like what networks predict.

    A fit is poor if the recording would be rare among those that the model predicts, or if not even
    the best networks explain the QRS. The share that the other networks explain shows how wide the
    posterior is, not how well the model fits.

    Attributes
    ----------
    explained : float
        Share of the variance of the recorded QRS that each of the best networks explains at least;
        0 for a flat line.
    probabilities : mapping of str to float
        For the QRS duration, the frontal axis, each independent lead and all of them together:
        probability of a recording at least as far from the networks, times the number of such
        comparisons (Bonferroni). Leads are compared with the smallest discrepancy of the
        likelihood, since a larger one would hide a misfit.
    measured : mapping of str to list of float
        Global QRS duration (ms) and frontal axis (degrees): recorded, then 5th percentile, median
        and 95th of the networks.
    gain : list of float
        Factor on the simulated ECGs: median of the networks, least and greatest expected.
    emulator : list of float
        Root mean square error of the emulated ECGs of the networks, over that of the ECGs; and the
        error expected from held-out ECGs.
    least_explained : float
        Share that the best networks must explain.
    sequence : SequenceSummary, optional
        Sequence in which the networks activate the ventricles in an intrinsic beat.
    """

    explained: float
    probabilities: Mapping[str, float]
    measured: Mapping[str, list[float]] = field(default_factory=dict)
    gain: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])
    emulator: list[float] = field(default_factory=lambda: [0.0, 0.0])
    least_explained: float = 0.85
    sequence: SequenceSummary | None = None

    # nominal probability that a recording drawn from the model is called rare; the true one is less
    least_probable: ClassVar[float] = 0.1
    best_share: ClassVar[float] = 0.05  # share of the networks that count as the best
    # largest error of the emulator in the networks' ECGs, over that in held-out ECGs
    most_emulator_error: ClassVar[float] = 1.5
    most_gain_sds: ClassVar[float] = 2.5  # largest |median gain − 1|, in SD of its prior

    @classmethod
    def joined(cls, parts: Sequence[Checks]) -> Checks:
        """Join the checks of several recordings, with the least explained and the worst gain."""
        if len(parts) == 1:
            return parts[0]
        numbered = [(f" of recording {number}", checks) for number, checks in enumerate(parts, 1)]
        least = min(parts, key=lambda checks: checks.explained - checks.least_explained)
        return cls(
            least.explained,
            {
                f"{name}{end}": min(1.0, p * len(parts))
                for end, checks in numbered
                for name, p in checks.probabilities.items()
            },
            {f"{name}{end}": m for end, checks in numbered for name, m in checks.measured.items()},
            max((checks.gain for checks in parts), key=lambda gain: abs(gain[0] - 1)),
            max((checks.emulator for checks in parts), key=lambda error: error[0]),
            least.least_explained,
            next((checks.sequence for checks in parts if checks.sequence is not None), None),
        )

    @classmethod
    def from_json(cls, text: str) -> Checks:
        """Read checks from ``json.dumps(asdict(checks))``."""
        values = json.loads(text)
        if (sequence := values.get("sequence")) is not None:
            times = {name: tuple(interval) for name, interval in sequence["times"].items()}
            values["sequence"] = SequenceSummary(**{**sequence, "times": times})
        return cls(**values)

    @property
    def disagreeing(self) -> list[str]:
        """Leads and quantities in which the recording would be rare under the model."""
        return [name for name, p in self.probabilities.items() if p < self.least_probable]

    @property
    def acceptable(self) -> bool:
        """True if the recording looks like what the networks predict."""
        return not self.failures

    @property
    def explained_in_words(self) -> str:
        """Share of the QRS that the best networks explain, in words."""
        # rounded down, so that a value below a limit is not shown as the limit
        share = math.floor(100 * self.explained + 1e-9)
        return f"{share}% of the QRS explained by the best {self.best_share:.0%} of networks"

    @property
    def unmapped(self) -> str:
        """Departure of the activation from that of mapped hearts with this QRS; else empty."""
        recorded = [m[0] for name, m in self.measured.items() if name.startswith(DURATION)]
        if self.sequence is None or not recorded or recorded[0] >= LATE_QRS:
            return ""
        departure = self.sequence.departure
        return f"{departure}: not seen in mapped hearts with this QRS" if departure else ""

    @property
    def emulator_off(self) -> str:
        """Statement that the emulator is not exact enough for these networks; else empty."""
        error, expected = self.emulator
        if error <= self.most_emulator_error * expected:
            return ""
        return f"emulator {error:.0%} off these networks, {expected:.0%} expected"

    def _in_words(self, name: str) -> str:
        recorded, low, middle, high = self.measured[name]
        unit = next(unit for key, (_, unit) in MEASURED.items() if name.startswith(key))
        return (
            f"{name} {recorded:.0f}{unit} recorded, {middle:.0f} ({low:.0f}–{high:.0f}) simulated"
        )

    @property
    def outside(self) -> str:
        """QRS duration and axis beyond 90 % of the networks, in words; empty if there are none."""
        names = [name for name, (x, low, _, high) in self.measured.items() if not low <= x <= high]
        return "; ".join(map(self._in_words, names))

    @property
    def failures(self) -> list[str]:
        """Failed checks in words, in the order in which a cardiologist looks at an ECG."""
        rare = self.disagreeing
        failures = [self._in_words(name) for name in self.measured if name in rare]
        if leads := [name for name in rare if name not in self.measured]:
            failures.append(f"{', '.join(leads)} not reproduced")
        if self.explained < self.least_explained:
            failures.append(f"{self.explained_in_words}, less than {self.least_explained:.0%}")
        gain, low, high = self.gain
        if not low <= gain <= high:
            failures.append(f"ECG scaled by {gain:.2g}, {low:.2g} to {high:.2g} expected")
        return failures


@dataclass(frozen=True)
class Prediction:
    """Predictions of n networks for a recording."""

    ecg: Floats  # (n, 12 + k, n_time), without noise and discrepancy, at the target's times (mV)
    noisy: Floats  # (n, 12 + k, n_time), with noise and discrepancy (mV)
    gains: Floats  # (n,), drawn for each network like the torsos, shifts and discrepancies
    torsos: Floats  # (n, 12 + k, 12 + k), from leads in the plain torso to those in the drawn one
    shifts: Floats  # of the first activation from the recorded onset (ms)
    discrepancies: Floats  # size σ of the discrepancy (mV)
    checks: Checks
    agreement: Agreement  # of `ecg` with the recording

    __repr__ = short_repr


def predict_recording(
    target: Target,
    likelihoods: Sequence[Likelihood],
    networks: Sequence[Network],
    rng: np.random.Generator,
) -> Prediction:
    """Draw predictions of n networks of a posterior for a recording, and compare them with it.

    `likelihoods` holds the likelihood that belongs to each network.
    """
    pairs = zip(likelihoods, networks, strict=True)
    drawn = [likelihood.predictive(n.beat.signals, rng) for likelihood, n in pairs]
    ecg, noisy = (
        np.array([getattr(replicate, name) for replicate in drawn]) for name in ("ecg", "noisy")
    )
    compared = agreement(
        target, [replace(n, predicted=e) for n, e in zip(networks, ecg, strict=True)]
    )
    return Prediction(
        ecg,
        noisy,
        np.array([replicate.gain for replicate in drawn]),
        np.array([np.eye(len(e.ecg)) if e.torso is None else e.torso for e in drawn]),
        np.array([replicate.shift for replicate in drawn]),
        np.array([replicate.discrepancy for replicate in drawn]),
        _checks(target, compared, drawn, getattr(likelihoods[0], "gain_sd", FitSettings().gain_sd)),
        compared,
    )


def _checks(
    target: Target, compared: Agreement, drawn: Sequence[Replicate], gain_sd: float
) -> Checks:
    """Checks of a recording against the recordings drawn from the networks."""
    rows, window = independent_rows(target.used), target.qrs_samples
    residual, error = np.empty((2, len(drawn), len(rows)))
    unexplained = np.empty(len(drawn))
    for k, replicate in enumerate(drawn):
        differences = [
            (target.mean - replicate.ecg)[rows, window],
            (replicate.noisy - replicate.ecg)[rows, window],
        ]
        energies = [(difference**2).sum(axis=1) for difference in differences]
        residual[k] = energies[0] if replicate.residual is None else replicate.residual
        error[k] = energies[1] if replicate.error is None else replicate.error
        unexplained[k] = (
            residual[k].sum() if replicate.unexplained is None else replicate.unexplained
        )
    leads = {target.leads[row]: _tail(residual[:, k], error[:, k]) for k, row in enumerate(rows)}
    leads["all leads together"] = _tail(residual.sum(axis=1), error.sum(axis=1))
    # ends that the user has given have no error of their own, but those of simulations are found
    duration_sd = float(
        np.hypot(max(target.onset_sd, ONSET_ERROR), max(target.offset_sd, OFFSET_ERROR))
    )
    measured = {
        name: [compared.recorded[key], *compared.percentiles(key)]
        for name, (key, _) in MEASURED.items()
        if key in compared.recorded
    }
    quantities = {
        DURATION: _two_tails(
            compared.predicted[MEASURED[DURATION][0]], measured[DURATION][0], duration_sd
        )
    }
    if AXIS in measured:
        axes = np.array([frontal_axis(replicate.noisy[:, window]) for replicate in drawn])
        mean = float(np.degrees(np.angle(np.exp(1j * np.radians(axes)).mean())))
        angles = (np.append(axes, measured[AXIS][0]) - mean + 180) % 360 - 180
        quantities[AXIS] = _two_tails(angles[:-1], float(angles[-1]), 0.0)
    # Bonferroni: all leads together weigh as much as the duration or the axis
    comparisons, far = len(quantities) + 1, Checks.most_gain_sds * gain_sd + 1e-9
    corrected = {n: p * comparisons for n, p in quantities.items()}
    corrected |= {name: p * comparisons * len(leads) for name, p in leads.items()}
    return Checks(
        1
        - float(np.quantile(unexplained, Checks.best_share)) / float((target.qrs[rows] ** 2).sum()),
        {name: min(1.0, p) for name, p in corrected.items()},
        measured,
        [float(np.median([replicate.gain for replicate in drawn])), max(1 - far, 0.0), 1 + far],
    )


def _tail(residual: Floats, error: Floats) -> float:
    """Probability of an error at least as large as the residual of a network.

    Every residual (n,) is compared with the errors (n,) of all networks, which have the same
    distribution.
    """
    return float(1 - np.searchsorted(np.sort(error), residual).mean() / len(error))


def _two_tails(predicted: Floats, recorded: float, sd: float) -> float:
    """Twice the smaller tail of predictions (n,), each with error `sd`, beyond a recorded value."""
    from scipy.special import ndtr

    sd = max(sd, 1e-6)  # ms or degrees; not 0, since it divides
    below = float(ndtr((recorded - predicted) / sd).mean())
    return min(1.0, 2 * min(below, 1 - below))
