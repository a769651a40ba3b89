"""Logarithm of expected improvement, safe where improvement is next to impossible.

For a predicted mean m and standard deviation s, expected improvement is s h(u), u = (best − m)/s,

    h(u) = φ(u) + u Φ(u),

φ and Φ being the density and the distribution function of the standard normal. Far below zero h
underflows, and u Φ(u) cancels φ(u) long before; so its logarithm is taken in three regimes, as by
Ament et al.:

    u > −1            log(φ(u) + u Φ(u))
    −1000 < u ≤ −1    log φ(u) + log(1 − |u| M(|u|)),    M(x) = Φ(−x)/φ(x) = √(π/2) erfcx(x/√2)
    u ≤ −1000         log φ(u) + log((1 − 3/u²)/u²)

M is Mills' ratio. The last line has the first two terms of its asymptotic series; what these leave
out at u = −1000, and what the cancellation in the second line loses there, is about 1e-10.

References
----------
S. Ament, S. Daulton, D. Eriksson, M. Balandat, E. Bakshy, "Unexpected improvements to expected
improvement for Bayesian optimization", NeurIPS 2023.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erfcx, ndtr

from fascicle.core.arrays import Floats

CANCELLING, ASYMPTOTIC = -1.0, -1e3  # values of u between the regimes
LOG_ROOT_2PI = 0.5 * math.log(2 * math.pi)


def log_h(u: Floats | float) -> Floats:
    """Logarithm of h(u) = φ(u) + u Φ(u), elementwise."""
    upper, lower = np.maximum(u, CANCELLING), np.minimum(u, CANCELLING)
    direct = np.log(_density(upper) + upper * ndtr(upper))
    safe = -0.5 * lower**2 - LOG_ROOT_2PI + np.log(_h_over_density(lower))
    return np.asarray(np.where(u > CANCELLING, direct, safe))


def log_expected_improvement(mean: Floats | float, variance: Floats | float, best: float) -> Floats:
    """Logarithm of the expected improvement below `best`.

    Parameters
    ----------
    mean, variance : (m,) arrays or floats
        Of the normal predictions, in the unit of the output and its square.
    best : float
        The value to improve on, in the unit of the output.
    """
    deviation = np.sqrt(variance)
    return np.asarray(log_h((best - mean) / deviation) + np.log(deviation))


def log_expected_improvement_slopes(
    mean: Floats | float, variance: Floats | float, best: float
) -> tuple[Floats, Floats]:
    """Derivatives of `log_expected_improvement` with respect to mean and variance, elementwise.

    ∂/∂m = −Φ(u)/(s h) and ∂/∂s² = φ(u)/(2 s² h), for predictions m, s². Of Φ/h and φ/h neither
    underflows.

    Parameters
    ----------
    mean, variance, best
        As there.
    """
    deviation = np.sqrt(variance)
    u = (best - mean) / deviation
    upper, lower = np.maximum(u, CANCELLING), np.minimum(u, CANCELLING)
    h, safe_ratio = np.exp(log_h(upper)), 1 / _h_over_density(lower)
    density_ratio = np.where(u > CANCELLING, _density(upper) / h, safe_ratio)
    probability_ratio = np.where(u > CANCELLING, ndtr(upper) / h, _mills(-lower) * safe_ratio)
    return np.asarray(-probability_ratio / deviation), np.asarray(density_ratio / (2 * variance))


def _density(u: Floats | float) -> Floats:
    return np.asarray(np.exp(-0.5 * np.square(u) - LOG_ROOT_2PI))


def _mills(x: Floats | float) -> Floats:
    """Mills' ratio Φ(−x)/φ(x)."""
    return np.asarray(math.sqrt(math.pi / 2) * erfcx(np.asarray(x) / math.sqrt(2)))


def _h_over_density(u: Floats | float) -> Floats:
    """h(u)/φ(u) = 1 − |u| M(|u|) where u ≤ `CANCELLING`."""
    x = -np.asarray(u)
    near = np.minimum(x, -ASYMPTOTIC)
    far = (1 - 3 / x**2) / x**2
    return np.asarray(np.where(x < -ASYMPTOTIC, 1 - near * _mills(near), far))
