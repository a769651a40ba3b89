"""The one place that binds the forward model and the loss to the inference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fascicle.core.parameters import ParameterSpace
from fascicle.forward.loss import Alignment, align, placed
from fascicle.forward.model import ForwardModel
from fascicle.forward.simulation import Simulation
from fascicle.inference.evaluation import Evaluation
from fascicle.purkinje.tree import InvalidTree
from fascicle.recording.synthetic import repeated
from fascicle.recording.target import Target


@dataclass(frozen=True)
class Problem:
    """The question which network of a parameter space explains a target on a heart.

    Calling it evaluates points of the unit cube, which is all the inference ever sees. The
    forward model runs outside Python's global lock, so threads are enough to use every core.

    Attributes
    ----------
    model : ForwardModel
        The forward model of the heart.
    target : Target
        What is to be explained.
    space : ParameterSpace
        What is learnt.
    free_gain : bool
        Whether each simulation is scaled by its best global gain first.
    workers : int
        Simulations that run at the same time.
    """

    model: ForwardModel
    target: Target
    space: ParameterSpace
    free_gain: bool = False
    workers: int = 1

    def __call__(self, points: Sequence[NDArray[np.float64]]) -> list[Evaluation]:
        """Evaluate points of the unit cube, in order."""
        if self.workers == 1 or len(points) == 1:
            return [self.evaluate(point) for point in points]
        with ThreadPoolExecutor(self.workers) as pool:
            return list(pool.map(self.evaluate, points))

    def evaluate(self, point: NDArray[np.float64]) -> Evaluation:
        """Run the forward model at one point and compare it with the mean and with every beat."""
        outcome = self.model.simulate(self.space.from_unit(point))
        if isinstance(outcome, InvalidTree):
            return Evaluation(point, float("nan"), np.empty(0), outcome.reason)
        alignment = self.align(outcome)
        return Evaluation(point, alignment.loss, self.beat_errors(outcome, alignment))

    def align(self, simulation: Simulation) -> Alignment:
        """Best alignment of a simulation with the mean recorded QRS, over the target's leads."""
        used = self.target.used
        return align(simulation.leads[used], self.target.qrs[used], free_gain=self.free_gain)

    def predicted(self, simulation: Simulation, alignment: Alignment) -> NDArray[np.float64]:
        """The simulated ECG under the whole recorded beat, shape (12, n_time) (mV)."""
        start = self.target.qrs_samples.start
        at_beat = Alignment(alignment.loss, alignment.shift - start, alignment.gain)
        return placed(simulation.leads, at_beat, len(self.target.time))

    def beat_errors(self, simulation: Simulation, alignment: Alignment) -> NDArray[np.float64]:
        """Mismatch with every recorded beat (mV²), shape (n_beats,).

        The beats are aligned with one another, so one alignment with their mean serves all.
        """
        recorded = self._recorded_beats
        simulated = placed(simulation.leads[self.target.used], alignment, recorded.shape[2])
        return np.asarray(((recorded - simulated) ** 2).sum(axis=(1, 2)) / recorded.shape[2])

    @cached_property
    def _recorded_beats(self) -> NDArray[np.float64]:
        """QRS of every beat in the target's leads; a single one is repeated with its noise."""
        target = self.target
        if target.noise is not None:
            # one seed for all time: every evaluation, and a resumed study, sees the same beats
            target = repeated(target, np.random.default_rng(0))
        return np.asarray(target.qrs_beats[:, target.used])


def simulate_valid(model: ForwardModel, parameters: Mapping[str, float]) -> Simulation:
    """Simulate parameters that are known to give trees, as those of a posterior are."""
    outcome = model.simulate(parameters)
    if isinstance(outcome, InvalidTree):
        raise RuntimeError(f"a network that was accepted does not grow: {outcome.reason}")
    return outcome
