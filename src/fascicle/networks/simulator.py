"""Simulations of points of the unit cube by the forward model, on a pool or a backend."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Infeasible
from fascicle.core.ranges import short_repr
from fascicle.forward.beat import Beat, Signals
from fascicle.forward.model import Backend, ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.networks.prior import Prior
from fascicle.pools.pool import Pool, Threads


class BeatMemory:
    """Cache of beats, if they are `kept`, so that a fit simulates each network once.

    The threads of a process share it; a copy in a worker process keeps nothing.
    """

    def __init__(self, kept: bool = False) -> None:
        self.kept = kept
        self._beats: list[tuple[Scenario | None, dict[tuple[Any, ...], Beat]]] = []

    def __reduce__(self) -> tuple[Any, ...]:
        return BeatMemory, ()

    def simulate(
        self, model: ForwardModel, parameters: Mapping[str, float], scenario: Scenario | None
    ) -> Beat | Infeasible:
        """Simulate a network in a scenario, or return its beat from the cache."""
        if not self.kept:
            return model.simulate(parameters, scenario)
        beats = next((beats for other, beats in self._beats if other == scenario), None)
        if beats is None:
            self._beats.append((scenario, beats := {}))
        # a study of the normal state does not name the state, a mixture of states does
        key = tuple(sorted({"conduction": 0.0, **model.heart.values, **parameters}.items()))
        if key in beats:
            return beats[key]
        beat = model.simulate(parameters, scenario)
        if isinstance(beat, Beat):
            beats[key] = beat
        return beat


@dataclass(frozen=True)
class PointSimulator:
    """Forward model of networks given as points of the unit cube, run on a pool or a backend."""

    model: ForwardModel
    prior: Prior
    pool: Pool = field(default=Threads(1), compare=False)
    backend: Backend | None = field(default=None, compare=False)  # in place of the pool
    memory: BeatMemory = field(default_factory=BeatMemory, compare=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Prepare the tissues of the prior, unless they are cached; all commands need them."""
        tissues = self.prior.averaged.tissues
        self.model.keep_tissues({**self.prior.fixed, **tissue} for tissue in tissues)

    def simulate(
        self, points: Iterable[Floats], scenario: Scenario | None = None
    ) -> Iterator[Beat | Infeasible]:
        """Simulate points, in order."""
        return self.of_parameters([self.prior.from_unit(point) for point in points], scenario)

    def of_parameters(
        self, parameters: Iterable[Mapping[str, float]], scenario: Scenario | None = None
    ) -> Iterator[Beat | Infeasible]:
        """Simulate networks, in order."""
        items = [({**self.prior.fixed, **network}, scenario) for network in parameters]
        return self.pool.map(_simulate, items, self.model)

    def from_backend(self, points: Sequence[Floats]) -> list[Signals | str | None]:
        """Signals of intrinsic beats by the backend, or the reasons why they are infeasible.

        None where the backend does not simulate a point: it simulates the plain tissue alone.
        """
        signals: list[Signals | str | None] = [None] * len(points)
        # a mapped prior needs activation times, which a backend does not give
        if self.backend is None or not points or self.prior.mapped:
            return signals
        averaged = self.prior.averaged
        if self.backend.refusal(self.model, averaged.space.names):
            return signals
        tissues = self.prior.tissue(np.asarray(points))
        plain = [k for k, number in enumerate(tissues) if not averaged.tissues[number]]
        plain_parameters = [self.prior.from_unit(points[k]) for k in plain]
        outcomes = self.backend.signals(self.model, plain_parameters)
        for k, outcome in zip(plain, outcomes, strict=True):
            signals[k] = outcome.reason if isinstance(outcome, Infeasible) else outcome
        return signals


def _simulate(
    item: tuple[Mapping[str, float], Scenario | None], model: ForwardModel
) -> Beat | Infeasible:
    return model.simulate(*item)
