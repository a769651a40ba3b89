"""How different two sets of per-beat errors are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.inference.evaluation import Evaluation

BANDWIDTHS = 30  # tried, log-spaced
BANDWIDTH_RANGE = (0.05, 2.0)  # in standard deviations of the errors
NODES_PER_BANDWIDTH = 16
REACH = 8.0  # bandwidths; the Gaussian kernel is below 1e-14 of its peak beyond


@dataclass(frozen=True)
class ErrorDensity:
    """Kernel density estimate q(e; θ) of the errors of θ over the recorded beats.

    q(e) = Σₖ exp(−(e − eₖ)² / 2h²) / (n h √(2π)), the Gaussian `KernelDensity` of scikit-learn,
    which the tests compare with; in one dimension it is one line of NumPy.

    Attributes
    ----------
    errors : (n,) array
        Mismatch with each beat (mV²).
    bandwidth : float
        h (mV²).
    """

    errors: Floats
    bandwidth: float

    @classmethod
    def fit(cls, errors: Floats) -> ErrorDensity:
        """Choose the bandwidth by leave-one-out cross-validation.

        The likelihood of every beat under the others is a closed form, so each beat is left out
        once whatever their number (n from 2 to some hundreds).

        Raises
        ------
        ValueError
            With fewer than two beats there is no distribution.
        """
        e = np.asarray(errors, dtype=np.float64)
        if e.size < 2:
            raise ValueError(f"{e.size} beat(s); a distribution of errors needs at least 2")
        spread = float(e.std(ddof=1))
        scale = max(float(np.abs(e).max()), 1e-12)
        if spread <= 1e-9 * scale:  # equal beats: any narrow kernel will do
            return cls(e, 1e-6 * scale)
        trials = spread * np.geomspace(*BANDWIDTH_RANGE, BANDWIDTHS)
        scores = [_left_out(e, h) for h in trials]
        return cls(e, float(trials[int(np.argmax(scores))]))

    def __call__(self, e: Floats) -> Floats:
        """Density (1/mV²) at errors `e` (m,), shape (m,)."""
        z = (e[:, None] - self.errors[None, :]) / self.bandwidth
        norm = len(self.errors) * self.bandwidth * math.sqrt(2 * math.pi)
        return np.asarray(np.exp(-0.5 * z * z).sum(1) / norm)

    def nodes(self) -> Floats:
        """Errors e ≥ 0 that resolve the density, ascending."""
        margin = REACH * self.bandwidth
        low, high = max(0.0, self.errors.min() - margin), max(0.0, self.errors.max() + margin)
        count = math.ceil((high - low) / self.bandwidth * NODES_PER_BANDWIDTH) + 2
        return np.linspace(low, high, count)


def total_variation(a: ErrorDensity, b: ErrorDensity) -> float:
    """Distance D = ½ ∫₀^∞ |q_a(e) − q_b(e)| de, from 0 (the same) to 1 (nothing in common).

    Trapezoidal rule on the union of two grids, each fine against its own bandwidth (eq. "TV" of
    the paper). What a kernel spreads below e = 0 is not counted.
    """
    nodes = np.unique(np.concatenate([a.nodes(), b.nodes()]))
    return 0.5 * float(np.trapezoid(np.abs(a(nodes) - b(nodes)), nodes))


def from_reference(evaluation: Evaluation, reference: ErrorDensity) -> float:
    """Total variation of an evaluation's per-beat errors from a density; 1 without a tree."""
    if not evaluation.feasible:
        return 1.0
    return total_variation(ErrorDensity.fit(evaluation.beat_errors), reference)


def _left_out(errors: Floats, bandwidth: float) -> float:
    """Mean log-likelihood of each error under the kernels of all the others (constants dropped)."""
    z = (errors[:, None] - errors[None, :]) / bandwidth
    exponent = -0.5 * z * z
    np.fill_diagonal(exponent, -np.inf)
    top = exponent.max(1)
    total = np.exp(exponent - top[:, None]).sum(1)
    return float((top + np.log(total)).mean()) - math.log(bandwidth)
