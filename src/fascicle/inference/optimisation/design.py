"""The first points of a study."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc


def latin_hypercube(rng: np.random.Generator, count: int, dimension: int) -> NDArray[np.float64]:
    """Latin hypercube sample of the unit cube, shape (count, dimension).

    Every coordinate has exactly one point in each of `count` equal intervals
    (McKay, Beckman & Conover 1979).
    """
    return np.asarray(qmc.LatinHypercube(d=dimension, rng=rng).random(count), dtype=np.float64)
