"""Simulations of points of the unit cube: the one place that runs the forward model for a study."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.ranges import short_repr
from fascicle.forward.model import Backend, ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Signals, Simulation
from fascicle.purkinje.tree import InvalidTree
from fascicle.study.pool import Pool, Threads
from fascicle.study.prior_simulations import PriorSimulations, signals_of
from fascicle.torso.variation.conductor import InvalidTorso


@dataclass(frozen=True)
class PointSimulator:
    """Simulates points of the unit cube."""

    model: ForwardModel
    space: ParameterSpace  # what is learnt: from a point to named parameters
    fixed: Mapping[str, float] = field(default_factory=dict)  # at other values than defaults
    pool: Pool = field(default=Threads(1), compare=False)
    prior: PriorSimulations | None = None  # networks that need not be simulated again
    backend: Backend | None = field(default=None, compare=False)  # in place of the pool

    __repr__ = short_repr

    def parameters(self, point: Floats) -> dict[str, float]:
        """All parameters of a point (d,) that are not at their defaults, by name."""
        return {**self.fixed, **self.space.from_unit(point)}

    def simulate(
        self, points: Iterable[Floats], scenario: Scenario | None = None
    ) -> Iterator[Simulation | InvalidTree | InvalidTorso]:
        """Simulate points, in order."""
        items = [(self.parameters(point), scenario) for point in points]
        return self.pool.map(_simulate, items, self.model)

    def signals(
        self, points: Iterable[Floats], scenario: Scenario | None = None
    ) -> Iterator[Signals | str]:
        """What of simulations is compared with recordings, or why a point gives no network."""
        items = [(self.parameters(point), scenario) for point in points]
        return self.pool.map(signals_of, items, self.model)

    def known(self, points: Sequence[Floats]) -> list[Signals | str | None]:
        """Intrinsic beats that the pool need not simulate: stored ones, and those of the backend.

        None for all others.
        """
        stored = [self.prior.get(point) if self.prior is not None else None for point in points]
        if self.backend is None:
            return stored
        missing = [number for number, there in enumerate(stored) if there is None]
        parameters = [self.parameters(points[number]) for number in missing]
        new = self.backend.signals(self.model, parameters)
        for number, found in zip(missing, new, strict=True):
            stored[number] = found.reason if isinstance(found, InvalidTree) else found
        return stored


def _simulate(
    item: tuple[Mapping[str, float], Scenario | None], model: ForwardModel
) -> Simulation | InvalidTree | InvalidTorso:
    return model.simulate(*item)
