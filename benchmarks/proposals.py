"""Whether the optimisation finds as much with its own acquisition function as with BoTorch's.

    python -m benchmarks.proposals --data CRTDEMO_FOLDER [--seeds 10] [--initial 60] [--steps 60]
                                   [--only hartmann|levy|crtdemo|cost]

Ten seeds each of two standard functions, Hartmann in 6 dimensions and Levy in 12 (Surjanovic &
Bingham, "Virtual library of simulation experiments", Simon Fraser University), and of a synthetic
ECG of a known network on the crtdemo heart. Both sides begin with the same Latin hypercube, use the
same Gaussian processes (fascicle's) of the loss, and draw the same raw points;
then they go their own ways:

- ours: log expected improvement and its gradient in closed form, by NumPy, all restarts polished
  together by SciPy's L-BFGS-B;
- the baseline: BoTorch's LogExpectedImprovement with PyTorch's gradients, polished by BoTorch's
  `gen_candidates_scipy`.

Printed are the lowest loss of each seed on both sides (of the standard functions above their
minimum), the medians, and how much longer the baseline takes to choose a proposal, from one process
run with one thread each. Rounding alone makes two runs part after some steps; so both sides also
choose from the same states, those that ours passes through with the first seed, and their proposals
and acquisition values are compared.

Last comes what a step costs with 550 known points in 12 dimensions, some of them without a loss:
with the hyper-parameters learnt at every step (the paper; the baseline), and every 10 steps, points
being added to the Gaussian processes in between.

Needs ``pip install '.[reference]'``; without it only our side is run, and without --data only the
standard functions. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
import copy
import importlib.util
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from fascicle.inference import optimisation
from fascicle.inference.gaussian_process import ExponentialGP
from fascicle.inference.optimisation import Surrogates, latin_hypercube, step
from fascicle.inference.surrogates import Observations
from fascicle.networks.settings import FitSettings

if TYPE_CHECKING:
    from torch import Tensor

Array = npt.NDArray[np.float64]
Maximise = Callable[[np.random.Generator, optimisation.FeasibleLogImprovement, Array, Array], Array]

HARTMANN_WEIGHTS = np.array([1.0, 1.2, 3.0, 3.2])
HARTMANN_SHAPES = np.array(
    [
        [10.0, 3.0, 17.0, 3.5, 1.7, 8.0],
        [0.05, 10.0, 17.0, 0.1, 8.0, 14.0],
        [3.0, 3.5, 1.7, 10.0, 17.0, 8.0],
        [17.0, 8.0, 0.05, 10.0, 0.1, 14.0],
    ]
)
HARTMANN_CENTRES = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)
HARTMANN_MINIMUM = -3.32236801141551
LEVY_RANGE = 10.0  # on either side of 0, in every coordinate
SAME = 1e-5  # of the unit cube: how far apart proposals may be that rounding alone sets apart
REFIT_EVERY = FitSettings.model_fields["refit_every"].default
COSTED = 20  # steps, over which their cost is averaged
MINIMUM_VARIANCE = 1e-12  # of the unit of the output; as BoTorch's


@dataclass(frozen=True)
class Task:
    """Losses (m,) to minimise at points (m, d) of the unit cube; NaN where a point has none."""

    name: str
    dimension: int
    losses: Callable[[Array], Array]


@dataclass(frozen=True)
class Outcome:
    """The lowest loss found, and the mean time to choose a proposal (s), fits excluded."""

    best: float
    seconds: float


def hartmann(points: Array) -> Array:
    """Hartmann's function of six variables above its minimum."""
    squares = (points[:, None, :] - HARTMANN_CENTRES) ** 2
    value = -np.exp(-(HARTMANN_SHAPES * squares).sum(2)) @ HARTMANN_WEIGHTS
    return np.asarray(value - HARTMANN_MINIMUM)


def levy(points: Array) -> Array:
    """Levy's function, whose minimum is 0, on ±`LEVY_RANGE`."""
    w = 1 + (LEVY_RANGE * (2 * points - 1) - 1) / 4
    inner, last = w[:, :-1], w[:, -1]
    middle = (inner - 1) ** 2 * (1 + 10 * np.sin(np.pi * inner + 1) ** 2)
    end = (last - 1) ** 2 * (1 + np.sin(2 * np.pi * last) ** 2)
    return np.asarray(np.sin(np.pi * w[:, 0]) ** 2 + middle.sum(1) + end)


def heart_task(folder: Path) -> Task:
    """Find a known network of the crtdemo heart again from its ECG."""
    from benchmarks.forward import _heart, build_case
    from examples.recover_known_network import TRUTH, synthetic_target
    from fascicle.core.parameters import NETWORK_SPACE, Infeasible
    from fascicle.forward.model import ForwardModel
    from fascicle.networks.prior import Prior
    from fascicle.networks.simulator import PointSimulator
    from fascicle.networks.target_comparison import TargetComparison, evaluate

    model = ForwardModel(_heart(build_case(folder)))
    simulation = model.simulate(TRUTH)
    assert not isinstance(simulation, Infeasible)
    target = synthetic_target(simulation.leads, np.random.default_rng(0))
    simulator = PointSimulator(model, Prior(NETWORK_SPACE, {"alpha": 0.065}))
    recordings = [TargetComparison(target)]

    def losses(points: Array) -> Array:
        return np.array(
            [evaluation.loss for evaluation in evaluate(simulator, recordings, list(points))]
        )

    return Task("crtdemo (mV²)", len(NETWORK_SPACE), losses)


def tasks(folder: Path | None, only: str | None) -> Iterator[Task]:
    if only in (None, "hartmann"):
        yield Task("Hartmann-6", 6, hartmann)
    if only in (None, "levy"):
        yield Task("Levy-12", 12, levy)
    if only in (None, "crtdemo") and folder is not None:
        yield heart_task(folder)


def minimise(task: Task, seed: int, initial: int, steps: int, maximise: Maximise) -> Outcome:
    """Run the optimisation of a study with `maximise` in the place of fascicle's."""
    seconds: list[float] = []

    def timed(*arguments: Any) -> Array:
        begin = time.perf_counter()
        point = maximise(*arguments)
        seconds.append(time.perf_counter() - begin)
        return point

    points = latin_hypercube(np.random.default_rng(seed), initial, task.dimension)
    losses = task.losses(points)
    surrogates = Surrogates.learn(Observations(points, losses))
    with patch("fascicle.inference.optimisation.maximise", timed):
        for k in range(steps):
            new = step(np.random.default_rng([seed, k]), surrogates)[None, :]
            points, losses = np.vstack([points, new]), np.append(losses, task.losses(new))
            surrogates = surrogates.updated(Observations(points, losses), REFIT_EVERY)
    return Outcome(float(np.nanmin(losses)), float(np.mean(seconds)))


def maximise_by_botorch(
    rng: np.random.Generator,
    acquisition: optimisation.FeasibleLogImprovement,
    best_points: Array,
    evaluated: Array,
) -> Array:
    """Maximise as `optimisation.maximise` does, by BoTorch."""
    import torch
    from botorch.generation.gen import gen_candidates_scipy

    torch.set_num_threads(1)
    function = botorch_acquisition(acquisition)

    def values(points: Array) -> Array:
        with torch.no_grad():
            return np.array(function(torch.tensor(points)[:, None, :]).numpy())

    def best(points: Array) -> Array:
        return points[np.argsort(-values(points), kind="stable")[:4]]

    uniform = rng.random((2000, best_points.shape[1]))
    local = optimisation.perturbed(rng, best_points, 1000)
    starts = np.vstack([best(uniform), best(local)])
    with warnings.catch_warnings(record=True):  # a search that stops early; BoTorch sets filters
        polished, _ = gen_candidates_scipy(
            torch.tensor(starts)[:, None, :],
            function,
            lower_bounds=0.0,
            upper_bounds=1.0,
            options={"maxiter": 60},
        )
    candidates = np.vstack([polished.detach().numpy()[:, 0, :], starts, uniform])
    return optimisation.first_apart(
        candidates[np.argsort(-values(candidates), kind="stable")], evaluated
    )


def botorch_acquisition(acquisition: optimisation.FeasibleLogImprovement) -> Any:
    """Put the same Gaussian processes behind BoTorch's acquisition function."""
    import torch
    from botorch.acquisition import LogExpectedImprovement
    from botorch.models.model import Model

    def moments(gp: ExponentialGP) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
        prior = gp.hyperparameters.variance
        scales = torch.tensor(gp.hyperparameters.length_scales, dtype=torch.float64)
        centre, scaled = torch.tensor(gp.centre), torch.tensor(gp.scaled)
        whitener, alpha = torch.tensor(gp.whitener), torch.tensor(gp.alpha)

        def predict(points: Tensor) -> tuple[Tensor, Tensor]:
            exact = "donot_use_mm_for_euclid_dist"
            r = torch.cdist((points - centre) / scales, scaled, compute_mode=exact)
            kernel = prior * torch.exp(-r)
            white = kernel @ whitener.T
            return kernel @ alpha, (prior - (white * white).sum(1)).clamp_min(MINIMUM_VARIANCE)

        return predict

    loss, feasibility = moments(acquisition.gp), acquisition.feasibility

    class Surrogate(Model):
        num_outputs = 1

        def posterior(self, X: Tensor, **_: Any) -> SimpleNamespace:
            mean, variance = loss(X[:, 0, :])
            return SimpleNamespace(mean=mean[:, None, None], variance=variance[:, None, None])

    improvement = LogExpectedImprovement(Surrogate(), acquisition.best, maximize=False)
    if feasibility.gp is None:
        return improvement
    labels, noise = moments(feasibility.gp), feasibility.gp.hyperparameters.noise

    def feasible_improvement(X: Tensor) -> Tensor:
        mean, variance = labels(X[:, 0, :])
        z = (feasibility.offset + mean) / torch.sqrt(variance + noise)
        value: Tensor = improvement(X) + torch.special.log_ndtr(z)
        return value

    return feasible_improvement


def compare_choices(task: Task, initial: int, steps: int) -> None:
    """Print how far both sides' proposals from the same states are apart, and which are better."""
    apart, gains = [], []

    def both(
        rng: np.random.Generator, acquisition: optimisation.FeasibleLogImprovement, *rest: Any
    ) -> Array:
        twin = copy.deepcopy(rng)
        ours = optimisation.maximise(rng, acquisition, *rest)
        theirs = maximise_by_botorch(twin, acquisition, *rest)
        value, other = acquisition(np.array([ours, theirs]))
        apart.append(float(np.abs(ours - theirs).max()))
        gains.append(float(value - other))
        return ours

    minimise(task, 0, initial, steps, both)
    same = sum(gap <= SAME for gap in apart)
    print(
        f"  from the same state: {same} of {steps} proposals within {SAME:g}; "
        f"log acquisition, ours less BoTorch's: {min(gains):.1e} to {max(gains):.1e}, "
        f"mean {np.mean(gains):.1e}"
    )


def compare(task: Task, sides: dict[str, Maximise], seeds: int, initial: int, steps: int) -> None:
    """Print the lowest losses of every seed, and the ratio of the times."""
    print(f"\n{task.name + ': lowest loss':<30}" + "".join(f"{side:>12}" for side in sides))
    outcomes: dict[str, list[Outcome]] = {side: [] for side in sides}
    for seed in range(seeds):
        for side, maximise in sides.items():
            outcomes[side].append(minimise(task, seed, initial, steps, maximise))
        best = "".join(f"{of_side[-1].best:12.4g}" for of_side in outcomes.values())
        print(f"  {f'seed {seed}':<28}" + best, flush=True)
    medians = [float(np.median([o.best for o in of_side])) for of_side in outcomes.values()]
    print(f"  {'median':<28}" + "".join(f"{median:12.4g}" for median in medians))
    means = [
        math.exp(float(np.mean([math.log(o.best) for o in of_side])))
        for of_side in outcomes.values()
    ]
    print(f"  {'geometric mean':<28}" + "".join(f"{mean:12.4g}" for mean in means))
    if len(sides) > 1:
        ours, baseline = (sum(o.seconds for o in of_side) for of_side in outcomes.values())
        print(f"  BoTorch takes {baseline / ours:.1f} times as long to choose a proposal")
        compare_choices(task, initial, steps)


def cost() -> None:
    """Print what a step costs with as many points as a study of the paper's size ends with."""
    rng = np.random.default_rng(0)
    design = latin_hypercube(rng, 250, 12)
    around = optimisation.perturbed(rng, design[np.argsort(levy(design))[:5]], 290 + COSTED)
    points = np.vstack([design, around])
    observations = Observations(points, np.where(points[:, 0] > 0.9, np.nan, levy(points)))
    start = Surrogates.learn(observations.first(len(observations) - COSTED))
    seconds = {}
    for refit_every in (1, REFIT_EVERY):
        surrogates, begin = start, time.process_time()
        for k in range(COSTED):
            surrogates = surrogates.updated(
                observations.first(len(start.observations) + k), refit_every
            )
            step(np.random.default_rng(k), surrogates)
        seconds[refit_every] = (time.process_time() - begin) / COSTED
    baseline, ours = seconds.values()
    print(
        f"\na step with {len(observations)} points: {baseline:.2f} s with a fit at every step, "
        f"{ours:.2f} s with one every {REFIT_EVERY}: {baseline / ours:.1f} times less "
        "(CPU time, one thread)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--initial", type=int, default=60)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--only", choices=("hartmann", "levy", "crtdemo", "cost"))
    arguments = parser.parse_args()
    sides: dict[str, Maximise] = {"ours": optimisation.maximise}
    if importlib.util.find_spec("botorch") is not None:
        sides["BoTorch"] = maximise_by_botorch
    else:
        print("BoTorch is not installed (pip install '.[reference]'): our side only")
    for task in tasks(arguments.data, arguments.only):
        compare(task, sides, arguments.seeds, arguments.initial, arguments.steps)
    if arguments.only in (None, "cost"):
        cost()


if __name__ == "__main__":
    main()
