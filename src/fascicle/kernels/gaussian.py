"""Logarithm of a Gaussian density, integrated over factors of the parts of its mean."""

import math
from functools import partial

import numpy as np

from fascicle.kernels.jit import allocating_kernel

MODELS_AT_ONCE = 64  # models at once: in single precision their sums stay in the first-level cache

fused_kernel = partial(allocating_kernel, fastmath={"contract"}, error_model="numpy")


@fused_kernel()
def integrated(models, first_sd, data, weights, constants, logs):
    """Log densities of a recording given many models, integrated over factors of their parts.

    The recording is m₀ + Σ zᵢcᵢ + ε with zᵢ ~ N(0, 1), where c₀ = `first_sd` m₀ and cᵢ = mᵢ are the
    columns of X, and ε has a diagonal covariance W⁻¹, one of several. The factors add X Xᵀ to it.
    Their precision I + XᵀWX is eliminated column by column, with the residual of the data from m₀
    as a last row.

    Parameters
    ----------
    models : (1 + k, n, m) array
    first_sd : float
        Standard deviation of the factor of m₀ about 1.
    data : (n,) array
    weights : (z, n) array
        Diagonals of W.
    constants : (z,) array
        Log-determinants of 2πW⁻¹.
    logs : (z, m) array
        To be filled.
    """
    count, length, model_count = models.shape
    scales = len(weights)
    rows = np.zeros((count + 1, MODELS_AT_ONCE), models.dtype)  # columns of X, and the residual
    sums = np.empty(((count + 1) * (count + 2) // 2, scales, MODELS_AT_ONCE), models.dtype)
    work, determinant = np.empty((2, MODELS_AT_ONCE), models.dtype), np.empty(MODELS_AT_ONCE)
    for begin in range(0, model_count, MODELS_AT_ONCE):
        size = min(MODELS_AT_ONCE, model_count - begin)
        sums[:] = 0
        for i in range(length):
            for j in range(size):
                rows[0, j] = first_sd * models[0, i, begin + j]
                rows[count, j] = data[i] - models[0, i, begin + j]
            for row in range(1, count):
                for j in range(size):
                    rows[row, j] = models[row, i, begin + j]
            _add_products(rows, weights[:, i], work[0], sums)
        for scale in range(scales):
            _eliminate(sums[:, scale], count, work, determinant)
            for j in range(size):
                total = sums[-1, scale, j] + math.log(determinant[j]) + constants[scale]
                logs[scale, begin + j] = -0.5 * total


@fused_kernel()
def _add_products(rows, weights, work, sums):
    """Add weighted products of pairs of rows (r, MODELS_AT_ONCE), the upper triangle by rows."""
    place = 0
    for row in range(len(rows)):
        for other in range(row, len(rows)):
            for j in range(MODELS_AT_ONCE):
                work[j] = rows[row, j] * rows[other, j]
            for scale in range(len(weights)):
                weight = weights[scale]
                for j in range(MODELS_AT_ONCE):
                    sums[place, scale, j] += weight * work[j]
            place += 1


@fused_kernel()
def _eliminate(sums, count, work, determinant):
    """Eliminate the first `count` columns of symmetric matrices, 1 being added to each pivot.

    `determinant` becomes the product of the pivots.
    """
    pivot, ratio = work
    determinant[:] = 1.0
    start = 0
    for column in range(count):
        width = count + 1 - column
        for j in range(MODELS_AT_ONCE):
            pivot[j] = 1 + sums[start, j]
            determinant[j] *= pivot[j]
        place = start + width
        for other in range(1, width):
            for j in range(MODELS_AT_ONCE):
                ratio[j] = sums[start + other, j] / pivot[j]
            for last in range(other, width):
                for j in range(MODELS_AT_ONCE):
                    sums[place, j] -= ratio[j] * sums[start + last, j]
                place += 1
        start += width
