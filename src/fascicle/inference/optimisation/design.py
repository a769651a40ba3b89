"""The first points of a study."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from fascicle.core.arrays import Floats


def latin_hypercube(rng: np.random.Generator, count: int, dimension: int) -> Floats:
    """Latin hypercube sample of the unit cube, shape (count, dimension).

    Every coordinate has exactly one point in each of `count` equal intervals.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    count, dimension : int

    References
    ----------
    M. D. McKay, R. J. Beckman, W. J. Conover, "A comparison of three methods for selecting values
    of input variables in the analysis of output from a computer code", Technometrics 21 (1979).
    """
    return np.asarray(qmc.LatinHypercube(d=dimension, rng=rng).random(count), dtype=np.float64)
