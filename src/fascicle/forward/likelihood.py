"""The likelihood of a recorded QRS, given a simulated one.

Both are compared in a few coefficients: the first cosines (DCT-II) over the QRS window and `MARGIN`
on either side of it, of each independent lead. Higher cosines depend on where fronts of small
branches happen to collide, which no patient shares. The recording is isoelectric outside its QRS
window, as in the loss. With V(s) the coefficients of the simulation that is shifted by s, and V̂
those of the mean recorded beat::

    V̂ = g V(s) + Σ z_k B_k V(s) + ε,    ε ~ N(0, C + σ² D)

    C     covariance of the known errors: noise of the mean beat, residuals of an emulator
    D     covariance of the discrepancy, the error of the model itself, of unit size: half of it is
          smooth in time, half is rough, as a network's ECG is as a function of its parameters
    σ     size of the discrepancy (mV), unknown: log-uniform over `shares` of the recorded QRS
    g     gain, unknown: normal about 1
    B_k   torso modes: changes of the leads in another torso, each with a standard normal factor z_k
    s     shift, unknown: the first activation is at the recorded QRS onset, within its uncertainty

g and z_k are integrated exactly (they add X Xᵀ to the covariance, the columns of X being sd V and
B_k V), σ and s by sums. In the basis that makes C the identity and D diagonal, every σ costs one
sum over the coefficients.
The separation into noise, discrepancy and model follows M. C. Kennedy and A. O'Hagan, "Bayesian
calibration of computer models", J. R. Statist. Soc. B 63 (2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import idct
from scipy.linalg import eigh
from scipy.special import logsumexp

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LIMB_LEADS, independent_rows, limb_leads_from
from fascicle.core.ranges import short_repr
from fascicle.forward.beat import Signals
from fascicle.forward.loss import placed
from fascicle.kernels.gaussian import integrated
from fascicle.recording.target import Target, residual_covariance

MARGIN = 40  # isoelectric samples (ms) on either side of the QRS
HALF_PERIOD = 20.0  # half of the shortest period of the cosines (ms)


@runtime_checkable
class Likelihood(Protocol):
    """Interface of the likelihood of one recording; `fascicle.fit` takes any object with it."""

    def log_likelihood(self, ecg: Signals) -> float:
        """Log-likelihood of the recording, given the simulated ECG of a network."""

    def predictive(self, ecg: Signals, rng: np.random.Generator) -> Replicate:
        """Draw a recording from the predictive distribution of a network with this ECG."""


@dataclass(frozen=True)
class Replicate:
    """A recording drawn from the predictive distribution of a network, at the target's times.

    Attributes
    ----------
    ecg : (12 + k, n_time) array
        ECG of the network, scaled and shifted, without noise and discrepancy (mV).
    noisy : (12 + k, n_time) array
        ECG with noise and discrepancy (mV).
    gain : float
        Factor on the simulated ECG.
    shift : float
        Time of the first activation from the recorded onset (ms).
    discrepancy : float
        Size of the discrepancy (mV).
    residual, error : (n_leads,) arrays, optional
        Energy of the residual, recording minus `ecg`, and of a drawn error, of each independent
        lead, in the coefficients of the likelihood; by default over the QRS window.
    unexplained : float, optional
        Energy of the whole residual; by default the sum of `residual`.
    torso : (12 + k, 12 + k) array, optional
        Maps the leads in the unchanged torso to those in the drawn torso, without the gain.
    """

    ecg: Floats
    noisy: Floats
    gain: float = 1.0
    shift: float = 0.0
    discrepancy: float = 0.0
    residual: Floats | None = None
    error: Floats | None = None
    unexplained: float | None = None
    torso: Floats | None = None

    __repr__ = short_repr


@dataclass(frozen=True)
class Fit:
    """Match of a simulation with the recording, at every shift.

    Attributes
    ----------
    log_likelihood : float
        Logarithm of the density of V̂ (1/mV for each coefficient).
    shifts : (n_shifts,) array
        Samples of the simulation at which the window of the cosines may begin, `shift_step` apart:
        the cosines are so slow that the sum over them is as good as the integral.
    weights : (n_scales, n_shifts) array
        Posterior probability of each pair of discrepancy and shift; they add up to 1.
    """

    log_likelihood: float
    shifts: Floats
    weights: Floats


@dataclass(frozen=True)
class QrsLikelihood:
    """The likelihood of one recorded mean QRS in its independent leads.

    Attributes
    ----------
    target : Target
        Target of the recording.
    covariance : (n, n) array
        C (mV²), with n = n_leads · n_modes: a block of cosines for each pair of leads.
    discrepancy : (n, n) array
        D, of unit mean over the samples of a lead.
    gain_sd : float
        Standard deviation of the gain about 1; 0 fixes it.
    torso_modes : (k, 12 + a, 12 + a) array
        Torso modes: matrices B_k of all leads, each with a standard normal factor.
    discrepancy_factor : float
        Factor on the sizes of the discrepancy.
    """

    target: Target
    covariance: Floats
    discrepancy: Floats
    gain_sd: float
    torso_modes: Floats
    discrepancy_factor: float = 1.0

    shift_step: ClassVar[int] = 3  # ms between shifts
    # SD (ms) of the first activation about the QRS onset, in addition to that of the onset itself
    first_activation_sd: ClassVar[float] = 3.0
    # sizes σ of the discrepancy, over the root mean square of the recorded QRS
    shares: ClassVar[Floats] = np.geomspace(0.1, 0.4, 4)
    # correlation times (ms) of the smooth and of the rough half of the discrepancy
    correlation_times: ClassVar[tuple[float, float]] = (12.0, 4.0)
    # share of the discrepancy's variance that is independent between leads
    lead_share: ClassVar[float] = 0.5

    __repr__ = short_repr

    def log_likelihood(self, ecg: Signals) -> float:
        """Log-likelihood of the recording, given a simulated ECG."""
        return self.fit(ecg).log_likelihood

    def predictive(self, ecg: Signals, rng: np.random.Generator) -> Replicate:
        """Draw shift, gain, torso and size of the discrepancy, and an error of that size."""
        target, fit = self.target, self.fit(ecg)
        drawn = rng.choice(fit.weights.size, p=fit.weights.ravel() / fit.weights.sum())
        scale, at = np.unravel_index(drawn, fit.weights.shape)
        shift = float(fit.shifts[at])
        models = self.whitened(ecg.leads, ecg.first_activation)[:, :, at]
        factors = self._factors(models, int(scale), rng)
        gain = 1 + self.gain_sd * factors[0]
        mixed = gain * np.eye(len(ecg.leads)) + np.tensordot(factors[1:], self.torso_modes, 1)
        leads = mixed @ ecg.leads
        begin = shift + MARGIN - target.qrs_samples.start
        clean = placed(leads, begin, len(target.time), target.response)
        error, smallest_error = self.noise(rng, int(scale)), self.noise(rng, 0)
        residual = self._padded - placed(leads[self._rows], shift, self.length, target.response)
        return Replicate(
            clean,
            clean + self._in_all_leads(error @ self.modes.T),
            gain,
            ecg.first_activation - shift - MARGIN,
            self.scales[scale],
            ((residual @ self.modes) ** 2).sum(axis=1),
            (smallest_error**2).sum(axis=1),
            float((residual**2).sum()),
            mixed / gain,
        )

    def _factors(self, models: Floats, scale: int, rng: np.random.Generator) -> Floats:
        """Draw the factors (1 + k,) of `_columns` from their posterior; the prior is N(0, I)."""
        _, weights, _, data = self._diagonal
        columns = self._columns(models)
        precision = np.eye(len(columns)) + (weights[scale] * columns) @ columns.T
        root = np.linalg.cholesky(precision)
        along = columns @ (weights[scale] * (data[:, 0] - models[0]))
        mean = np.linalg.solve(precision, along)
        return np.asarray(mean + np.linalg.solve(root.T, rng.standard_normal(len(columns))))

    def fit(self, ecg: Signals) -> Fit:
        """Compare a simulated ECG, zero outside its samples, with the recording."""
        joint = self._log_density(self.whitened(ecg.leads, ecg.first_activation)) + self._log_priors
        total = float(logsumexp(joint))
        shifts = ecg.first_activation - MARGIN + self._shifts
        return Fit(total - math.log(len(self.shares)), shifts, np.exp(joint - total))

    def of_sums(self, parts: Floats, scores: Floats) -> Floats:
        """Log-likelihoods (m,) of ECGs that are sums of parts, weighted by scores (q, m).

        Parts have shape (n_shifts, 1 + k, n, q), as `whitened` computes them.
        """
        logs = np.empty((len(self._shifts), len(self.shares), scores.shape[1]))
        for at, prior in enumerate(self._log_priors):
            logs[at] = self._log_density(parts[at] @ scores) + prior
        return np.asarray(logsumexp(logs, axis=(0, 1)) - math.log(len(self.shares)))

    def whitened(self, leads: Floats, first_activation: float) -> Floats:
        """Coefficients of all leads (12 + k, n), and of the changes by the torso modes.

        In the diagonal basis, at every shift: shape (1 + k, n, n_shifts).
        """
        begin, end = first_activation - MARGIN + self._shifts[[0, -1]]
        samples = placed(leads, begin, self.length + round(end - begin), self.target.response)
        windows = sliding_window_view(samples, self.length, axis=1)[:, :: self.shift_step]
        coefficients = np.ascontiguousarray(windows) @ self.modes  # (12 + k, n_shifts, n_modes)
        mixed = [coefficients, *np.tensordot(self.torso_modes, coefficients, 1)]
        basis = self._diagonal[0]
        independent = [
            part[self._rows].transpose(0, 2, 1).reshape(len(basis), -1) for part in mixed
        ]
        return np.asarray(basis.T @ np.array(independent))

    def _columns(self, models: Floats) -> Floats:
        """Changes of a model by one standard deviation of the gain and of each torso mode."""
        return np.concatenate([self.gain_sd * models[:1], models[1:]])

    def _log_density(self, models: Floats) -> Floats:
        """Log-density (n_scales, m) of V̂ given models (1 + k, n, m), as `whitened` gives them."""
        _, weights, constants, data = self._diagonal
        logs, dtype = np.empty((len(weights), models.shape[2])), models.dtype
        weights, data = weights.astype(dtype), data[:, 0].astype(dtype)
        integrated(models, dtype.type(self.gain_sd), data, weights, constants, logs)
        return logs

    @cached_property
    def _shifts(self) -> Floats:
        """Shifts (ms) about the first activation at the recorded onset."""
        # three standard deviations to either side
        reach = math.ceil(3.0 * self._onset_sd / self.shift_step) * self.shift_step
        return np.arange(-reach, reach + 1.0, self.shift_step)

    @cached_property
    def _log_priors(self) -> Floats:
        """Logarithms of the prior probabilities of the shifts."""
        logs = -0.5 * (self._shifts / self._onset_sd) ** 2
        return np.asarray(logs - logsumexp(logs))

    @property
    def _onset_sd(self) -> float:
        return float(np.hypot(self.target.onset_sd, self.first_activation_sd))

    def noise(self, rng: np.random.Generator, scale: int) -> Floats:
        """Draw ε for the discrepancy `scales[scale]`, in coefficients (n_leads, n_modes)."""
        basis, weights, _, _ = self._diagonal
        drawn = rng.standard_normal(len(basis)) / np.sqrt(weights[scale])
        return np.asarray((self.covariance @ basis @ drawn).reshape(len(self._rows), -1))

    @property
    def length(self) -> int:
        """Samples of the window of the cosines."""
        return int(self._padded.shape[1])

    @cached_property
    def scales(self) -> Floats:
        """Sizes of the discrepancy that are summed over (mV), shape (n_scales,)."""
        size = self.discrepancy_factor * np.sqrt((self.target.qrs[self._rows] ** 2).mean())
        return np.asarray(self.shares * size)

    @cached_property
    def modes(self) -> Floats:
        """The cosines, orthonormal, shape (length, n_modes)."""
        return cosines(self.length - 2 * MARGIN)

    @cached_property
    def _rows(self) -> Integers:
        return independent_rows(self.target.used)

    @cached_property
    def _padded(self) -> Floats:
        """Mean QRS in independent leads (mV), 0 over `MARGIN` on either side."""
        return np.pad(self.target.qrs[self._rows], ((0, 0), (MARGIN, MARGIN)))

    def _in_all_leads(self, independent: Floats) -> Floats:
        """Errors (mV) of all leads at all times, from those of independent leads about the QRS."""
        begin, times = self.target.qrs_samples.start - MARGIN, len(self.target.time)
        errors = np.zeros((len(self.target.leads), times))
        samples = np.arange(independent.shape[1]) + begin
        recorded = (samples >= 0) & (samples < times)
        errors[np.ix_(self._rows, samples[recorded])] = independent[:, recorded]
        limb = limb_leads_from([LIMB_LEADS[row] for row in self._rows if row < len(LIMB_LEADS)])
        if limb is not None:
            errors[: len(LIMB_LEADS)] = limb @ errors[: len(LIMB_LEADS)]
        return errors

    @cached_property
    def _diagonal(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Basis (n, n) in which C is the identity and D diagonal; and, in this basis, three arrays.

        Inverse variances (n_scales, n), log-determinants (n_scales,), and recording V̂ (n, 1).
        """
        values, basis = eigh(self.discrepancy, self.covariance)
        spread = 1 + self.scales[:, None] ** 2 * np.maximum(values, 0)
        constant = np.linalg.slogdet(2 * np.pi * self.covariance)[1]
        data = basis.T @ (self._padded @ self.modes).reshape(-1, 1)
        return basis, 1 / spread, constant + np.log(spread).sum(axis=1), data

    @classmethod
    def constants(cls) -> dict[str, float | str]:
        """Name and constants of the likelihood."""
        return {
            "name": cls.__name__,
            "margin_ms": MARGIN,
            "half_period_ms": HALF_PERIOD,
            "shift_step_ms": cls.shift_step,
            "first_activation_sd_ms": cls.first_activation_sd,
            "discrepancy_shares": " ".join(f"{share:.3g}" for share in cls.shares),
            "discrepancy_correlations_ms": " ".join(f"{time:g}" for time in cls.correlation_times),
            "discrepancy_of_each_lead": cls.lead_share,
        }


def cosines(qrs: int) -> Floats:
    """Orthonormal cosines over a QRS of `qrs` samples and its margins, (length, n_modes)."""
    length = qrs + 2 * MARGIN
    return np.asarray(idct(np.eye(length)[:, : round(length / HALF_PERIOD)], axis=0, norm="ortho"))


def beat_noise(target: Target) -> Floats:
    """Covariance (n, n) of the coefficients of the mean beat (mV²).

    The covariance of one beat, over the number of beats; a single beat has its stated noise.
    """
    rows, covariance = independent_rows(target.used), residual_covariance(target)
    count = 1 if target.noise is not None else len(target.beats)
    modes = cosines(target.qrs.shape[1])[MARGIN:-MARGIN]
    scaled = [covariance.sd[row][:, None] * modes for row in rows]
    pairs = list(zip(rows, scaled, strict=True))
    blocks = [
        [covariance.leads[i, j] * left.T @ covariance.time @ right for j, right in pairs]
        for i, left in pairs
    ]
    return np.asarray(np.block(blocks) / count)


def discrepancy_in_time(length: int) -> Floats:
    """Correlation (length, length) of the discrepancy between samples 1 ms apart.

    Half of it is smooth (12 ms), half rough (4 ms). The residuals of fits to recordings fall as the
    smooth half does over the first 10 ms (0.94 at 3 ms, 0.78 at 6 ms). Without the rough half, fast
    deflections would decide between networks.
    """
    times = QrsLikelihood.correlation_times
    return np.asarray(np.mean([matern(length, time) for time in times], axis=0))


def matern(length: int, correlation: float = 12.0) -> Floats:
    """Matérn correlation (order 3/2) between samples 1 ms apart, (length, length)."""
    lag = np.sqrt(3.0) * np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
    scaled = lag / correlation
    return np.asarray((1 + scaled) * np.exp(-scaled))


def separable(leads: Floats, time: Floats, modes: Floats) -> Floats:
    """Covariance (n, n) of coefficients, from the covariances of leads and of samples."""
    return np.asarray(np.kron(leads, modes.T @ time @ modes))


def lead_pattern(signals: Sequence[Floats]) -> Floats:
    """Covariance of the leads in differences of simulations (n_leads, n), of unit mean variance.

    A share of the variance, `QrsLikelihood.lead_share`, is independent between leads, such as from
    misplaced electrodes. With a small share the likelihood would prefer twice the mismatch to a
    mismatch that is unlike the differences between networks.
    """
    products = [signal @ signal.T for signal in signals]
    total = np.asarray(np.sum(products, axis=0) / np.sum(np.trace(products, axis1=1, axis2=2)))
    total *= len(total)
    share = QrsLikelihood.lead_share
    return (1 - share) * total + share * np.eye(len(total))
