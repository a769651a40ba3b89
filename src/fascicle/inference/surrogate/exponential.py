"""Zero-mean Gaussian process with the exponential kernel: its hyper-parameters and predictions.

The marginal likelihood and its gradient are written out here instead of taken from GPyTorch:
with n ≲ 1000 points the closed form costs a sixth of the autograd graph, uses no random numbers
and is bitwise repeatable. GPyTorch is the second implementation that the tests compare with.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from fascicle.inference.surrogate.threads import in_chunks, one_thread

# Normal priors on the logarithms, for inputs in the unit cube and outputs of variance one. Length
# scales: the dimension-scaled prior of Hvarfner, Hellsten & Nardi (ICML 2024), BoTorch's default.
LENGTH_SCALE_SPREAD = math.sqrt(3)
VARIANCE_PRIOR = (0.0, 1.0)
NOISE_PRIOR = (-5.0, 2.0)
LENGTH_SCALE_BOUNDS = (0.02, 200.0)
VARIANCE_BOUNDS = (1e-2, 1e3)
# The lower end keeps the Cholesky factorisation alive with nearly coincident points.
NOISE_BOUNDS = (1e-6, 1.0)

CHUNK = 1000  # rows of a kernel matrix held at once; stays in the cache, larger is slower


@dataclass(frozen=True)
class Hyperparameters:
    """Kernel k(x, x') = variance · exp(−|(x − x') / length_scales|) and noise variance.

    Attributes
    ----------
    length_scales : tuple of d floats
        In the units of the input.
    variance, noise : float
        η² of the paper and σₙ², in the squared unit of the (standardised) output.
    """

    length_scales: tuple[float, ...]
    variance: float
    noise: float

    @classmethod
    def default(cls, dimension: int) -> Hyperparameters:
        """Take the modes of the priors."""
        scale = math.exp(_length_scale_centre(dimension))
        return cls((scale,) * dimension, math.exp(VARIANCE_PRIOR[0]), math.exp(NOISE_PRIOR[0]))

    def to_json(self) -> str:
        """As text; every float comes back exactly."""
        return json.dumps([list(self.length_scales), self.variance, self.noise])

    @classmethod
    def from_json(cls, text: str) -> Hyperparameters:
        """From the text of `to_json`."""
        length_scales, variance, noise = json.loads(text)
        return cls(tuple(length_scales), variance, noise)

    def to_logarithms(self) -> NDArray[np.float64]:
        """Vector (d + 2,) of logarithms: length scales, variance, noise."""
        return np.asarray(np.log([*self.length_scales, self.variance, self.noise]))

    @classmethod
    def from_logarithms(cls, vector: NDArray[np.float64]) -> Hyperparameters:
        """From the vector of `to_logarithms`."""
        *length_scales, variance, noise = map(float, np.exp(vector))
        return cls(tuple(length_scales), variance, noise)


def _length_scale_centre(dimension: int) -> float:
    return math.sqrt(2) + 0.5 * math.log(dimension)


def to_tensor(array: NDArray[np.float64]) -> Tensor:
    """Copy to a float64 tensor (a copy is aligned, so that BLAS repeats itself bit for bit)."""
    return torch.tensor(np.ascontiguousarray(array), dtype=torch.float64)


def _cholesky(matrix: Tensor) -> Tensor:
    """Lower Cholesky factor; the diagonal is raised, tenfold each time, until there is one."""
    factor: Tensor
    factor, failed = torch.linalg.cholesky_ex(matrix)
    jitter = 1e-10 * float(matrix.diagonal().mean())
    eye = torch.eye(len(matrix), dtype=matrix.dtype)
    while int(failed):
        factor, failed = torch.linalg.cholesky_ex(matrix + jitter * eye)
        jitter *= 10
    return factor


def _distances(a: Tensor, b: Tensor) -> Tensor:
    r: Tensor = torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")
    return r


def log_marginal_likelihood(
    points: Tensor, outputs: Tensor, hyperparameters: Hyperparameters
) -> tuple[float, NDArray[np.float64]]:
    """Log marginal likelihood and its gradient.

    With A = K + σₙ²I, α = A⁻¹y and G = ααᵀ − A⁻¹ (Rasmussen & Williams 2006, eqs 5.8 and 5.9)::

        log p(y) = −½ yᵀα − ½ log|A| − ½ n log 2π,    ∂ log p / ∂β = ½ tr(G ∂K/∂β)

    Parameters
    ----------
    points : (n, d) tensor
    outputs : (n,) tensor
    hyperparameters : Hyperparameters

    Returns
    -------
    value : float
    gradient : (d + 2,) array
        With respect to `Hyperparameters.to_logarithms`.
    """
    scaled = points / to_tensor(np.array(hyperparameters.length_scales))
    r = _distances(scaled, scaled)
    kernel = hyperparameters.variance * torch.exp(-r)
    noise = hyperparameters.noise * torch.eye(len(r), dtype=r.dtype)
    factor = _cholesky(kernel + noise)
    inverse = torch.cholesky_inverse(factor)
    alpha = inverse @ outputs
    fit = -0.5 * outputs @ alpha - factor.diagonal().log().sum()
    value = float(fit) - 0.5 * len(r) * math.log(2 * math.pi)

    g = torch.outer(alpha, alpha) - inverse
    # ∂k/∂log ℓᵢ = (k / r) Δzᵢ²; coincident points have Δz = 0, so 0/0 counts as 0.
    w = torch.where(r > 0, g * kernel / r, torch.zeros_like(r))
    by_length = w.sum(1) @ scaled**2 - (scaled * (w @ scaled)).sum(0)
    by_variance = 0.5 * (g * kernel).sum()
    by_noise = 0.5 * hyperparameters.noise * g.diagonal().sum()
    gradient = torch.cat([by_length, by_variance[None], by_noise[None]])
    return value, np.array(gradient.numpy())


@one_thread()
def fit(
    points: NDArray[np.float64],
    outputs: NDArray[np.float64],
    start: Hyperparameters | None,
    iterations: int,
) -> Hyperparameters:
    """Hyper-parameters of highest posterior density (L-BFGS-B on the logarithms).

    Parameters
    ----------
    points : (n, d) array
        In the unit cube.
    outputs : (n,) array
        Of mean zero and variance near one.
    start : Hyperparameters or None
        Where to start; None starts at the modes of the priors.
    iterations : int
        At most so many L-BFGS-B iterations.
    """
    dimension = points.shape[1]
    centre = np.full(dimension + 2, _length_scale_centre(dimension))
    spread = np.full(dimension + 2, LENGTH_SCALE_SPREAD)
    centre[-2:], spread[-2:] = zip(VARIANCE_PRIOR, NOISE_PRIOR, strict=True)
    bounds = np.log([*[LENGTH_SCALE_BOUNDS] * dimension, VARIANCE_BOUNDS, NOISE_BOUNDS])
    x, y = to_tensor(points), to_tensor(outputs)

    def negative(vector: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        value, gradient = log_marginal_likelihood(x, y, Hyperparameters.from_logarithms(vector))
        z = (vector - centre) / spread
        return 0.5 * float(z @ z) - value, z / spread - gradient

    begin = start if start is not None else Hyperparameters.default(dimension)
    first = np.clip(begin.to_logarithms(), bounds[:, 0], bounds[:, 1])
    options = {"maxiter": iterations}
    result = minimize(negative, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return Hyperparameters.from_logarithms(result.x)


@dataclass(frozen=True)
class ExponentialGP:
    """The process conditioned on data; predictions in the unit of the data.

    Attributes
    ----------
    hyperparameters : Hyperparameters
    centre : (d,) tensor
        Subtracted from the input, so that the expanded square of a distance loses few digits.
    scaled : (n, d) tensor
        The data points, centred and divided by the length scales.
    factor : (n, n) tensor
        Lower Cholesky factor of K + σₙ²I.
    alpha : (n,) tensor
        (K + σₙ²I)⁻¹ y.
    """

    hyperparameters: Hyperparameters
    centre: Tensor
    scaled: Tensor
    factor: Tensor
    alpha: Tensor

    @classmethod
    @one_thread()
    def condition(
        cls,
        points: NDArray[np.float64],
        outputs: NDArray[np.float64],
        hyperparameters: Hyperparameters,
    ) -> ExponentialGP:
        """Condition on `outputs` (n,) at `points` (n, d)."""
        x = to_tensor(points)
        centre = x.mean(0)
        scaled = (x - centre) / to_tensor(np.array(hyperparameters.length_scales))
        kernel = hyperparameters.variance * torch.exp(-_distances(scaled, scaled))
        eye = torch.eye(len(x), dtype=x.dtype)
        factor = _cholesky(kernel + hyperparameters.noise * eye)
        alpha = torch.cholesky_solve(to_tensor(outputs)[:, None], factor)[:, 0]
        return cls(hyperparameters, centre, scaled, factor, alpha)

    def scale(self, points: Tensor) -> Tensor:
        """Input (m, d) in the coordinates in which the kernel is exp(−distance)."""
        return (points - self.centre) / to_tensor(np.array(self.hyperparameters.length_scales))

    def moments(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and variance of the latent function, (m,) each; differentiable."""
        kernel = self.hyperparameters.variance * torch.exp(
            -_distances(self.scale(points), self.scaled)
        )
        return kernel @ self.alpha, self._variance(kernel)

    def _variance(self, kernel: Tensor) -> Tensor:
        """Variance η² − |L⁻¹k|² for the rows k of `kernel` (m, n)."""
        v = torch.linalg.solve_triangular(self.factor, kernel.mT, upper=False)
        floor = 1e-12 * self.hyperparameters.variance
        variance: Tensor = (self.hyperparameters.variance - (v * v).sum(0)).clamp_min(floor)
        return variance

    def predict(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Posterior mean and variance at `points` (m, d), (m,) each, a chunk at a time."""
        mean, variance = np.empty(len(points)), np.empty(len(points))

        def work(part: slice) -> None:
            chunk = self.moments(to_tensor(points[part]))
            mean[part], variance[part] = (moment.numpy() for moment in chunk)

        in_chunks(work, len(points), CHUNK)
        return mean, variance

    def mean_many(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Posterior mean at very many points, and how close each is to the data.

        The squared distances come from one matrix product, |a|² − 2a·b + |b|², which is exact to
        rounding except within about 1e-7 length scales of a data point.

        Parameters
        ----------
        points : (m, d) array

        Returns
        -------
        mean : (m,) array
        nearness : (m,) array
            exp(−distance to the nearest data point), in (0, 1].
        """
        z = self.scaled
        one = torch.ones((len(z), 1), dtype=z.dtype)
        right = torch.cat([-2 * z, (z * z).sum(1, keepdim=True), one], 1).T.contiguous()
        mean, nearness = np.empty(len(points)), np.empty(len(points))

        def work(part: slice) -> None:
            c = self.scale(to_tensor(points[part]))
            left = torch.cat([c, torch.ones_like(c[:, :1]), (c * c).sum(1, keepdim=True)], 1)
            kernel = (left @ right).clamp_min_(0).sqrt_().neg_().exp_()
            mean[part] = (kernel @ self.alpha).numpy()
            nearness[part] = kernel.amax(1).numpy()

        in_chunks(work, len(points), CHUNK)
        return self.hyperparameters.variance * mean, nearness

    def variance_limit(self, nearness: NDArray[np.float64]) -> NDArray[np.float64]:
        """Upper limit of the posterior variance from `nearness` (m,) of `mean_many`, shape (m,).

        It is the variance given the nearest data point alone; more data cannot raise it.
        """
        variance, noise = self.hyperparameters.variance, self.hyperparameters.noise
        return np.asarray(variance - (variance * nearness) ** 2 / (variance + noise))
