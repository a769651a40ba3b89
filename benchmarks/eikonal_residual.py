"""Residual of a computed activation in the discrete anisotropic eikonal equation.

NumPy only, so that the two environments of the forward benchmark measure themselves alike.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def eikonal_residual(
    vertices: Array, tetrahedra: IntArray, velocity_metric: Array, activation: Array
) -> float:
    """Largest amount by which one full sweep of exact local updates still lowers a vertex.

    Each vertex x₄ of each tetrahedron is offered

        τ₄ = min over λ ≥ 0, Σλᵢ = 1 of  Σ λᵢτᵢ + √(λᵀAλ),   A_ij = eᵢᵀ D⁻¹ eⱼ,  eᵢ = xᵢ − x₄,

    the exact solution for a linear interpolation of τ on the opposite face. All updates read the
    activation given (Jacobi), so the result is zero for the exact discrete solution only.

    Parameters
    ----------
    vertices : array, shape (n, 3)
        Positions, mm.
    tetrahedra : array of int, shape (m, 4)
        Vertex indices.
    velocity_metric : array, shape (m, 3, 3)
        D, mm²/ms², one per tetrahedron.
    activation : array, shape (n,)
        τ, ms.

    Returns
    -------
    float
        Residual, ms. Infinite where a vertex was never reached but could be.
    """
    slowness_metric = np.linalg.inv(velocity_metric)
    lowest = activation.astype(np.float64).copy()
    for apex in range(4):
        face = [corner for corner in range(4) if corner != apex]
        e = vertices[tetrahedra[:, face]] - vertices[tetrahedra[:, [apex]]]
        A = np.einsum("mia,mab,mjb->mij", e, slowness_metric, e)
        offered = _local_minimum(A, activation[tetrahedra[:, face]])
        np.minimum.at(lowest, tetrahedra[:, apex], offered)
    lowered = activation > lowest
    return float(np.max(activation[lowered] - lowest[lowered], initial=0.0))


def _local_minimum(A: Array, tau: Array) -> Array:
    """Minimum over the simplex: the smallest of the stationary values on its 7 (sub)faces."""
    best = np.full(len(tau), np.inf)
    for size in (1, 2, 3):
        for corners in combinations(range(3), size):
            chosen = np.array(corners)
            sub_A = A[:, chosen[:, None], chosen[None, :]]
            best = np.minimum(best, _stationary_value(sub_A, tau[:, chosen]))
    return best


def _stationary_value(A: Array, tau: Array) -> Array:
    """Stationary value μ inside one face of the simplex, infinite where there is none."""
    reached = np.all(np.isfinite(tau), axis=1)
    finite_tau = np.where(reached[:, None], tau, 0.0)
    Q = np.linalg.inv(A)
    Q_one = Q.sum(axis=2)
    Q_tau = np.einsum("mij,mj->mi", Q, finite_tau)
    a = Q_one.sum(axis=1)
    b = Q_tau.sum(axis=1)
    c = np.einsum("mi,mi->m", finite_tau, Q_tau)
    discriminant = b**2 - a * (c - 1.0)
    mu = (b + np.sqrt(np.maximum(discriminant, 0.0))) / a
    # λ is parallel to Q(μ1 − τ), hence admissible where this is nowhere negative.
    inside = np.all(mu[:, None] * Q_one - Q_tau >= 0.0, axis=1)
    return np.where(reached & (discriminant >= 0.0) & inside, mu, np.inf)
