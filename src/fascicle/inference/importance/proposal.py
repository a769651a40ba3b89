"""What points are drawn from: distributions fitted to weighted points."""

from __future__ import annotations

from typing import Any

import numpy as np

from fascicle.core.arrays import Floats

FREEDOM = 8  # degrees of freedom: tails that are heavier than the posterior's
WIDER = 1.15  # covariance, than that of the points
SMALLEST = 0.01  # variance that is added to each, of the prior's 1


def standard_normal(dimension: int) -> Any:
    """Make the standard normal distribution, as SciPy's frozen ones."""
    from scipy.stats import multivariate_normal

    return multivariate_normal(np.zeros(dimension))


def fitted(points: Floats, weights: Floats) -> Any:
    """Fit Student's t distribution to points (n, d) with weights (n,), as SciPy's frozen ones.

    One is enough, and with few effective points better than a mixture: the posterior of a network
    is broad in most parameters, and bent in none so far that a heavy tail would not cover it.
    """
    from scipy.stats import multivariate_t

    mean = weights @ points
    apart = points - mean
    covariance = WIDER * (weights * apart.T) @ apart + SMALLEST * np.eye(len(mean))
    return multivariate_t(mean, covariance * (FREEDOM - 2) / FREEDOM, df=FREEDOM)
