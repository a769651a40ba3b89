"""The likelihood of a recorded QRS, given a simulated one.

What is compared are a few coefficients: the first cosines (DCT-II) over the QRS window and `MARGIN`
on either side of it, of each independent lead. Finer ones tell how small branches happen to
collide, which is no patient's. The recording is silent outside its QRS window, as it is in the
loss. With V(s) the coefficients of the simulation that is shifted by s, and V̂ those of the mean
recorded beat::

    V̂ = g V(s) + ε,    ε ~ N(0, C + σ² D)

    C     covariance of what is known: noise of the mean beat, roughness of the forward model
    D     covariance of the discrepancy, what no network of this model explains, of unit size: half
          of it is smooth in time, half is rough, as a network's own ECG is in its parameters
    σ     its size (mV), unknown: log-uniform over `SHARES` of the recorded QRS
    g     gain, unknown: normal about 1
    s     shift, unknown: the first activation is the onset of the recorded QRS, give or take its
          uncertainty

g is integrated exactly (it adds the rank-one term sd² V Vᵀ to the covariance), σ and s by sums. In
the basis that makes C the identity and D diagonal, every σ costs one sum over the coefficients.
The separation into noise, discrepancy and model follows M. C. Kennedy and A. O'Hagan, "Bayesian
calibration of computer models", J. R. Statist. Soc. B 63 (2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import idct
from scipy.linalg import eigh
from scipy.special import logsumexp

from fascicle.core.arrays import Floats
from fascicle.forward.loss import Response, placed

MARGIN = 40  # samples (ms) of silence on either side of the QRS
RESOLUTION = 20.0  # ms; half a period of the fastest cosine
CORRELATIONS = 12.0, 4.0  # ms; of the smooth and of the rough half of the discrepancy in time
OWN = 0.5  # share of its variance that is each lead's own
REACH = 3.0  # standard deviations of the shift that are summed over
FIRST_ACTIVATION_SD = 3.0  # ms; of the recorded onset after the first activation, beside its own
SHARES = np.geomspace(0.5, 1.0, 8)  # of the recorded QRS (root mean square): the discrepancy's


@dataclass(frozen=True)
class Fit:
    """How well a simulation explains the recording, and where it lies.

    Attributes
    ----------
    log_likelihood : float
        Of V̂, in coefficients (1/mV each).
    shifts : (n_shifts,) array
        Samples of the simulation at which the window of the cosines may begin, 1 ms apart: the
        cosines are so slow that the sum over them is as good as the integral.
    weights : (n_scales, n_shifts) array
        Posterior probability of each pair of discrepancy and shift; they add up to 1.
    gains, gain_sds : (n_scales, n_shifts) arrays
        Mean and standard deviation of the gain, given the pair.
    """

    log_likelihood: float
    shifts: Floats
    weights: Floats
    gains: Floats
    gain_sds: Floats


@dataclass(frozen=True)
class QrsLikelihood:
    """The likelihood of one recorded mean QRS.

    Attributes
    ----------
    recorded : (n_leads, n_qrs) array
        Mean QRS in independent leads (mV).
    known : (n, n) array
        C (mV²), with n = n_leads · n_modes; leads outside, cosines inside.
    discrepancy : (n, n) array
        D, of unit mean over the samples of a lead.
    onset_sd : float
        Standard deviation of the recorded onset (ms).
    gain_sd : float
        Of the gain about 1; 0 fixes it.
    response : callable, optional
        Gain of the filters that the recording has passed.
    """

    recorded: Floats
    known: Floats
    discrepancy: Floats
    onset_sd: float
    gain_sd: float
    response: Response | None = None

    def fit(self, simulated: Floats, onset: float) -> Fit:
        """Compare a simulation with the recording.

        Parameters
        ----------
        simulated : (n_leads, n) array
            V (mV); zero before its first and after its last sample.
        onset : float
            Sample of the first activation.
        """
        sd = float(np.hypot(self.onset_sd, FIRST_ACTIVATION_SD))
        reach = math.ceil(REACH * sd)
        steps = np.arange(-reach, reach + 1.0)
        shifts = onset - MARGIN + steps
        joint, gains, gain_sds = self._joint(self._whitened(simulated, shifts))
        joint += -0.5 * (steps / sd) ** 2 - math.log(sd * math.sqrt(2 * math.pi))
        total = float(logsumexp(joint))
        weights = np.exp(joint - total)
        return Fit(total - math.log(len(SHARES)), shifts, weights, gains, gain_sds)

    def _whitened(self, simulated: Floats, shifts: Floats) -> Floats:
        """Coefficients in the diagonal basis, (n, n_shifts), at shifts that are 1 apart."""
        length = self.length
        samples = placed(simulated, float(shifts[0]), length + len(shifts) - 1, self.response)
        windows = sliding_window_view(samples, length, axis=1)  # (n_leads, n_shifts, length)
        basis = self._diagonal[0]
        found = np.ascontiguousarray(windows) @ self.modes
        return np.asarray(basis.T @ found.transpose(0, 2, 1).reshape(len(basis), -1))

    def _joint(self, model: Floats) -> tuple[Floats, Floats, Floats]:
        """Log-likelihood, mean gain and its standard deviation, (n_scales, n_shifts) each."""
        _, weights, log_determinants, data = self._diagonal
        size = weights @ model**2
        overlap = weights @ (model * data)
        variance = self.gain_sd**2
        along = overlap - size
        precision = 1 + variance * size
        square = weights @ data**2 - 2 * overlap + size - variance * along**2 / precision
        logs = -0.5 * (square + np.log(precision) + log_determinants[:, None])
        return logs, 1 + variance * along / precision, self.gain_sd / np.sqrt(precision)

    def residual(self, simulated: Floats, shift: float, gain: float) -> Floats:
        """What a simulation at a shift and gain leaves (mV), (n_leads, length)."""
        model = placed(simulated, shift, self.length, self.response)
        return np.pad(self.recorded, ((0, 0), (MARGIN, MARGIN))) - gain * model

    def noise(self, rng: np.random.Generator, scale: int) -> Floats:
        """Draw ε for the discrepancy `scales[scale]`, in coefficients (n_leads, n_modes)."""
        basis, weights, _, _ = self._diagonal
        drawn = rng.standard_normal(len(basis)) / np.sqrt(weights[scale])
        return np.asarray((self.known @ basis @ drawn).reshape(len(self.recorded), -1))

    @property
    def length(self) -> int:
        """Samples of the window of the cosines."""
        return int(self.recorded.shape[1] + 2 * MARGIN)

    @cached_property
    def scales(self) -> Floats:
        """Sizes of the discrepancy that are summed over (mV), shape (n_scales,)."""
        return np.asarray(SHARES * np.sqrt((self.recorded**2).mean()))

    @cached_property
    def modes(self) -> Floats:
        """The cosines, orthonormal, shape (length, n_modes)."""
        return cosines(self.recorded.shape[1])

    @cached_property
    def _diagonal(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Basis (n, n); in it weights (n_scales, n), log-determinants and the recording (n, 1)."""
        values, basis = eigh(self.discrepancy, self.known)
        spread = 1 + self.scales[:, None] ** 2 * np.maximum(values, 0)
        constant = np.linalg.slogdet(2 * np.pi * self.known)[1]
        padded = np.pad(self.recorded, ((0, 0), (MARGIN, MARGIN)))
        data = basis.T @ (padded @ self.modes).reshape(-1, 1)
        return basis, 1 / spread, constant + np.log(spread).sum(axis=1), data


def cosines(qrs: int) -> Floats:
    """Orthonormal cosines over a QRS of so many samples and its margins, (length, n_modes)."""
    length = qrs + 2 * MARGIN
    return np.asarray(idct(np.eye(length)[:, : round(length / RESOLUTION)], axis=0, norm="ortho"))


def discrepancy_in_time(length: int) -> Floats:
    """Correlation of the discrepancy of so many samples 1 ms apart, (length, length).

    The residuals of fits to recordings fall as the smooth half does over the first 10 ms (0.94 at
    3 ms, 0.78 at 6 ms). Without the rough half, fast deflections would decide between networks.
    """
    return np.asarray(np.mean([matern(length, each) for each in CORRELATIONS], axis=0))


def matern(length: int, correlation: float = CORRELATIONS[0]) -> Floats:
    """Matérn correlation (order 3/2) of so many samples 1 ms apart, (length, length)."""
    lag = np.sqrt(3.0) * np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
    scaled = lag / correlation
    return np.asarray((1 + scaled) * np.exp(-scaled))


def separable(leads: Floats, time: Floats, modes: Floats) -> Floats:
    """Covariance (n, n) of coefficients: of leads (n_leads, n_leads), and of samples."""
    return np.asarray(np.kron(leads, modes.T @ time @ modes))


def lead_pattern(signals: Sequence[Floats], own: float = OWN) -> Floats:
    """Correlation of leads of the differences between simulations, scaled to unit mean.

    Parameters
    ----------
    signals : sequence of (n_leads, n) arrays
        Differences (mV).
    own : float
        Share of the variance that is each lead's own, such as by its electrode's place. With a
        small share the likelihood would rather have twice the mismatch than one that differences
        between networks do not look like.
    """
    products = [signal @ signal.T for signal in signals]
    total = np.asarray(np.sum(products, axis=0) / np.sum(np.trace(products, axis1=1, axis2=2)))
    total *= len(total)
    return (1 - own) * total + own * np.eye(len(total))
