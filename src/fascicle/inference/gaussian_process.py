"""Zero-mean Gaussian process with the exponential kernel: its hyper-parameters and predictions.

With n ≲ 1000 points the closed form of the marginal likelihood costs a sixth of GPyTorch's autograd
graph and is bitwise repeatable. The tests compare with the Gaussian process of scikit-learn.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, blas, cho_solve, cholesky, lapack
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from fascicle.core.arrays import Floats
from fascicle.core.threads import in_chunks, one_thread


@dataclass(frozen=True)
class Hyperparameters:
    """Kernel k(x, x') = variance · exp(−|(x − x') / length_scales|) and noise variance.

    Length scales have the units of the input; `variance` and `noise`, η² of the paper and σₙ², the
    squared unit of the (standardised) output.
    """

    length_scales: tuple[float, ...]
    variance: float
    noise: float

    def to_json(self) -> str:
        """Text from which every float is restored exactly."""
        return json.dumps([list(self.length_scales), self.variance, self.noise])

    @classmethod
    def from_json(cls, text: str) -> Hyperparameters:
        """From the text of `to_json`."""
        length_scales, variance, noise = json.loads(text)
        return cls(tuple(length_scales), variance, noise)

    def to_logarithms(self) -> Floats:
        """Vector (d + 2,) of logarithms: length scales, variance, noise."""
        return np.asarray(np.log([*self.length_scales, self.variance, self.noise]))

    @classmethod
    def from_logarithms(cls, vector: Floats) -> Hyperparameters:
        """From the vector of `to_logarithms`."""
        *length_scales, variance, noise = map(float, np.exp(vector))
        return cls(tuple(length_scales), variance, noise)


def _cholesky(covariance: Floats) -> Floats:
    """Lower Cholesky factor; the diagonal is raised, tenfold each time, until it exists."""
    jitter = 1e-10 * covariance.diagonal().mean()
    raised = covariance
    while True:
        try:
            return np.asfortranarray(cholesky(raised, lower=True))
        except LinAlgError:
            raised = covariance + jitter * np.eye(len(covariance))
            jitter *= 10


def _bordered(whitener: Floats, covariance: Floats, variance: float) -> Floats:
    """L⁻¹ of a matrix with one more row: `covariance` k (n,), `variance` on the diagonal.

    With w = L⁻¹k the new row of L is (wᵀ, s), s² = variance − |w|², and of L⁻¹ (−wᵀL⁻¹, 1) / s.
    """
    count = len(covariance)
    w = whitener @ covariance
    # rounding may leave nothing of the variance where points coincide
    s = math.sqrt(max(variance - float(w @ w), 1e-10 * variance))
    larger = np.zeros((count + 1, count + 1), order="F")
    larger[:count, :count] = whitener
    larger[count, :count] = -(w @ whitener) / s
    larger[count, count] = 1 / s
    return larger


def log_marginal_likelihood(
    points: Floats, outputs: Floats, hyperparameters: Hyperparameters
) -> tuple[float, Floats]:
    """Log marginal likelihood, and its gradient (d + 2,) with respect to the logarithms.

    With A = K + σₙ²I, α = A⁻¹y and G = ααᵀ − A⁻¹ (Rasmussen & Williams 2006, eqs 5.8 and 5.9)::

        log p(y) = −½ yᵀα − ½ log|A| − ½ n log 2π,    ∂ log p / ∂β = ½ tr(G ∂K/∂β)
    """
    scaled = points / np.array(hyperparameters.length_scales)
    r = cdist(scaled, scaled)
    kernel = hyperparameters.variance * np.exp(-r)
    factor = _cholesky(kernel + hyperparameters.noise * np.eye(len(r)))
    lower, _ = lapack.dpotri(factor, lower=True)  # leaves the zeros of the upper triangle
    inverse = np.asarray(lower + lower.T)
    np.fill_diagonal(inverse, lower.diagonal())
    alpha = inverse @ outputs
    fit = -0.5 * outputs @ alpha - np.log(factor.diagonal()).sum()
    value = float(fit) - 0.5 * len(r) * math.log(2 * math.pi)

    g = np.outer(alpha, alpha) - inverse
    gk = g * kernel
    # ∂k/∂log ℓᵢ = (k / r) Δzᵢ²; coincident points have Δz = 0, so 0/0 counts as 0.
    w = np.divide(gk, r, out=np.zeros_like(r), where=r > 0)
    by_length = w.sum(1) @ scaled**2 - (scaled * (w @ scaled)).sum(0)
    by_variance = 0.5 * gk.sum()
    by_noise = 0.5 * hyperparameters.noise * np.trace(g)
    return value, np.append(by_length, [by_variance, by_noise])


@one_thread
def fit(
    points: Floats, outputs: Floats, start: Hyperparameters | None, iterations: int
) -> Hyperparameters:
    """Hyper-parameters of highest posterior density (L-BFGS-B on the logarithms).

    Points (n, d) lie in the unit cube, outputs (n,) have mean zero and a variance near one. The
    priors on the logarithms are normal; length scales have the dimension-scaled one of Hvarfner,
    Hellsten and Nardi (ICML 2024), BoTorch's default. Without a `start` the search starts at their
    modes.
    """
    dimension = points.shape[1]
    scale = math.sqrt(2) + 0.5 * math.log(dimension)
    centre = np.array([*[scale] * dimension, 0.0, -5.0])
    spread = np.array([*[math.sqrt(3)] * dimension, 1.0, 2.0])
    # of length scales, variance and noise: the least noise keeps the Cholesky factorisation alive
    # with nearly coincident points
    bounds = np.log([*[(0.02, 200.0)] * dimension, (1e-2, 1e3), (1e-6, 1.0)])

    def negative(vector: Floats) -> tuple[float, Floats]:
        value, gradient = log_marginal_likelihood(
            points, outputs, Hyperparameters.from_logarithms(vector)
        )
        z = (vector - centre) / spread
        return 0.5 * float(z @ z) - value, z / spread - gradient

    begin = centre if start is None else start.to_logarithms()
    first = np.clip(begin, bounds[:, 0], bounds[:, 1])
    options = {"maxiter": iterations}
    result = minimize(negative, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return Hyperparameters.from_logarithms(result.x)


@dataclass(frozen=True)
class ExponentialGP:
    """The process conditioned on data; predictions in the unit of the data.

    Attributes
    ----------
    centre : (d,) array
        Subtracted from the input, so that the expanded square of a distance loses few digits.
    scaled : (n, d) array
        The data points, centred and divided by the length scales.
    whitener : (n, n) array
        L⁻¹ of the lower Cholesky factor L of K + σₙ²I, by columns as BLAS wants it: a product with
        it takes half the time of a triangular solve with L.
    alpha : (n,) array
        (K + σₙ²I)⁻¹ y.
    """

    hyperparameters: Hyperparameters
    centre: Floats
    scaled: Floats
    whitener: Floats
    alpha: Floats

    @classmethod
    @one_thread
    def condition(
        cls, points: Floats, outputs: Floats, hyperparameters: Hyperparameters
    ) -> ExponentialGP:
        """Condition on data: points (n, d) and outputs (n,) of mean zero."""
        centre = points.mean(0)
        scaled = (points - centre) / np.array(hyperparameters.length_scales)
        kernel = hyperparameters.variance * np.exp(-cdist(scaled, scaled))
        factor = _cholesky(kernel + hyperparameters.noise * np.eye(len(points)))
        whitener, _ = lapack.dtrtri(factor, lower=True)
        alpha = cho_solve((factor, True), outputs)
        return cls(hyperparameters, centre, scaled, whitener, alpha)

    @one_thread
    def extended(self, points: Floats, outputs: Floats) -> ExponentialGP:
        """Condition on more points (m, d): a row of L⁻¹ for each, instead of all rows again.

        The outputs (n + m,) are of all points, the new ones last; those before may have changed.
        """
        variance, noise = self.hyperparameters.variance, self.hyperparameters.noise
        scaled, whitener = np.vstack([self.scaled, self.scale(points)]), self.whitener
        for k in range(len(self.scaled), len(scaled)):
            kernel = variance * np.exp(-cdist(scaled[:k], scaled[k : k + 1])[:, 0])
            whitener = _bordered(whitener, kernel, variance + noise)
        alpha = whitener.T @ (whitener @ outputs)
        return ExponentialGP(self.hyperparameters, self.centre, scaled, whitener, alpha)

    def scale(self, points: Floats) -> Floats:
        """Input (..., d) in the coordinates in which the kernel is exp(−distance)."""
        return np.asarray((points - self.centre) / np.array(self.hyperparameters.length_scales))

    @property
    def _least_variance(self) -> float:
        """Lower bound of predicted variances, against rounding."""
        return 1e-12 * self.hyperparameters.variance

    def moments_and_gradients(self, points: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Posterior mean m, variance v, (k,) each, and ∇m and ∇v, (k, d), at a few `points` (k, d).

        With z the scaled input, ∂k/∂z = −k (z − zⱼ)/|z − zⱼ| at the data points zⱼ, so that
        ∇m = ∇kᵀα and ∇v = −2 ∇kᵀ(K + σₙ²I)⁻¹k. At a data point, where the kernel has a cusp, that
        point contributes nothing.
        """
        away = self.scale(points)[:, None, :] - self.scaled
        r = np.sqrt(np.einsum("kij,kij->ki", away, away))
        kernel = self.hyperparameters.variance * np.exp(-r)
        white = blas.dtrmm(1.0, self.whitener, kernel.T, lower=True)
        variance = self.hyperparameters.variance - np.einsum("ij,ij->j", white, white)
        slope = np.divide(-kernel, r, out=np.zeros_like(r), where=r > 0)
        by_kernel = blas.dtrmm(-2.0, self.whitener, white, lower=True, trans_a=1).T
        weights = slope[:, None, :] * np.stack([np.broadcast_to(self.alpha, r.shape), by_kernel], 1)
        gradients = weights @ away / np.array(self.hyperparameters.length_scales)
        by_mean, by_variance = gradients[:, 0], gradients[:, 1]
        by_variance[variance < self._least_variance] = 0.0
        variance = np.maximum(variance, self._least_variance)
        return kernel @ self.alpha, variance, by_mean, by_variance

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Posterior mean m and variance v of the latent function at `points` (m, d), (m,) each.

        With the rows k of the kernel matrix, a chunk of them at a time: m = kᵀα, v = η² − |L⁻¹k|².
        """
        prior = self.hyperparameters.variance
        mean, variance = np.empty(len(points)), np.empty(len(points))

        def work(part: slice) -> None:
            kernel = prior * np.exp(-cdist(self.scale(points[part]), self.scaled))
            mean[part] = kernel @ self.alpha
            white = blas.dtrmm(1.0, self.whitener, kernel.T, lower=True, overwrite_b=True)
            variance[part] = prior - np.einsum("ij,ij->j", white, white)

        in_chunks(work, len(points), 1000)
        return mean, np.maximum(variance, self._least_variance)

    def mean_many(self, points: Floats) -> tuple[Floats, Floats]:
        """Posterior mean at very many points, and how close each is to the data.

        The squared distances come from one matrix product, |a|² − 2a·b + |b|², which is exact to
        rounding except within about 1e-7 length scales of a data point.
        Nearness is exp(−distance to the nearest data point), in (0, 1]. Shapes are (m,).
        """
        z = self.scaled
        right = np.vstack([-2 * z.T, (z * z).sum(1), np.ones(len(z))])
        mean, nearness = np.empty(len(points)), np.empty(len(points))

        def work(part: slice) -> None:
            c = self.scale(points[part])
            left = np.column_stack([c, np.ones(len(c)), (c * c).sum(1)])
            kernel = left @ right
            np.maximum(kernel, 0, out=kernel)
            for function in (np.sqrt, np.negative, np.exp):
                function(kernel, out=kernel)
            mean[part] = kernel @ self.alpha
            nearness[part] = kernel.max(1)

        in_chunks(work, len(points), 200)  # chunks that fit the cache
        return self.hyperparameters.variance * mean, nearness

    def variance_limit(self, nearness: Floats) -> Floats:
        """Upper limit of the posterior variance from `nearness` (m,) of `mean_many`, shape (m,).

        It is the variance given the nearest data point alone; more data cannot raise it.
        """
        variance, noise = self.hyperparameters.variance, self.hyperparameters.noise
        return np.asarray(variance - (variance * nearness) ** 2 / (variance + noise))
