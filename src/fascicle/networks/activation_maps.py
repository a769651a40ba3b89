"""Maps of activation over networks: mean, spread, and probability of late activation."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Singles


def since_first(activation: Floats | Singles) -> Floats:
    """Activation times (..., n) (ms) from the first of each row on; NaN where no front arrives."""
    times = np.where(np.isfinite(activation), activation, np.nan).astype(float)
    return np.asarray(times - activation.min(axis=-1, keepdims=True))


def nearest_to_median(activations: Floats | Singles) -> int:
    """Index of the network whose activation map (n_networks, n) is nearest to the median map.

    Times count from the first activation of each network on. The median map is that of the medians
    at each vertex; distance is the root mean square over the vertices that a network reaches.
    """
    times = since_first(activations)
    times = times[:, np.isfinite(times).any(axis=0)]
    squares = (times - np.nanmedian(times, axis=0)) ** 2
    return int(np.nanmean(squares, axis=1).argmin())


def activation_maps(activations: Floats | Singles) -> dict[str, Floats]:
    """Activation over networks at each of n vertices, from the first of each network on.

    Mean and standard deviation (ms), and the probability that the vertex is among the latest fifth,
    of activation times (n_networks, n), which are inf where no front arrives. A vertex that no
    network reaches is NaN; elsewhere only networks that reach the vertex count.
    """
    times = since_first(activations)
    reached = np.isfinite(times).sum(axis=0)
    counts = np.where(reached > 0, reached, np.nan)
    mean = np.nansum(times, axis=0) / counts
    spread = np.sqrt(np.nansum((times - mean) ** 2, axis=0) / counts)
    late = times >= np.nanquantile(times, 0.8, axis=1, keepdims=True)
    return {
        "activation_mean": mean,
        "activation_sd": spread,
        "probability_latest_fifth": late.sum(axis=0) / counts,
    }
