"""Gradients by differences, to compare closed forms with."""

import numpy as np


def central_differences(function, point, step=1e-6):
    """Gradient (d,) of a function of points (m, d) at one point (d,)."""
    steps = step * np.eye(len(point))
    return (function(point + steps) - function(point - steps)) / (2 * step)
