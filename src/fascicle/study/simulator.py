"""Simulations of points of the unit cube: the one place that runs the forward model for a study."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.ranges import short_repr
from fascicle.forward.model import Backend, ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Signals, SimulatedBeat, Simulation
from fascicle.purkinje.tree import InvalidTree
from fascicle.study.pool import Pool, Threads
from fascicle.study.space import AveragedOver, is_kept
from fascicle.torso.variation.conductor import InvalidTorso

# Simulations by sorted parameters and the identity of a scenario
Remembered = dict[tuple[tuple[tuple[str, float], ...], int], Simulation]


@dataclass(frozen=True)
class PointSimulator:
    """Simulates points of the unit cube."""

    model: ForwardModel
    space: ParameterSpace  # what is learnt: from a point to named parameters
    fixed: dict[str, float] = field(default_factory=dict)  # at other values than defaults
    pool: Pool = field(default=Threads(1), compare=False)
    averaged: AveragedOver = field(default_factory=AveragedOver)  # its coordinates come last
    backend: Backend | None = field(default=None, compare=False)  # in place of the pool
    # by threads of this process, where draws are evaluated first and then looked at
    remembered: Remembered | None = field(default=None, compare=False)
    mapped: bool = False  # whether intrinsic beats must be activated as mapped human hearts are

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Have the tissues, which every command on a study needs, prepared once a heart."""
        self.model.keep_tissues({**self.fixed, **tissue} for tissue in self.averaged.tissues)

    def parameters(self, point: Floats) -> dict[str, float]:
        """All parameters of a point (d,) that are not at their defaults, by name."""
        learnt, rest = point[: len(self.space)], point[len(self.space) :]
        return self.fixed | self.space.from_unit(learnt) | self.averaged.values(rest)

    def keeps(self, point: Floats, beat: SimulatedBeat) -> bool:
        """Whether the intrinsic beat of a point (d,) belongs to the prior."""
        return not self.mapped or is_kept(point, self.model.surfaces.sequence(beat.activation))

    @property
    def dimension(self) -> int:
        """Number of coordinates of a point."""
        return len(self.space) + len(self.averaged)

    def simulate(
        self, points: Iterable[Floats], scenario: Scenario | None = None
    ) -> Iterator[Simulation | InvalidTree | InvalidTorso]:
        """Simulate points, in order."""
        return self.of_parameters([self.parameters(point) for point in points], scenario)

    def of_parameters(
        self, parameters: Iterable[Mapping[str, float]], scenario: Scenario | None = None
    ) -> Iterator[Simulation | InvalidTree | InvalidTorso]:
        """Simulate networks, in order."""
        items = [({**self.fixed, **each}, scenario) for each in parameters]
        return self.pool.map(_simulate, items, self.model)

    def from_backend(self, points: Sequence[Floats]) -> list[Signals | str | None]:
        """Intrinsic beats that a backend simulates, in the plain tissue; None for all others."""
        found: list[Signals | str | None] = [None] * len(points)
        if self.backend is None or not points or self.mapped:  # that takes the activation
            return found
        if self.backend.refusal(self.model, self.averaged.space.names):
            return found
        tissues = self.averaged.tissue(np.asarray(points)[:, len(self.space) :])
        plain = [k for k, number in enumerate(tissues) if not self.averaged.tissues[number]]
        asked = [self.parameters(points[k]) for k in plain]
        for k, each in zip(plain, self.backend.signals(self.model, asked), strict=True):
            found[k] = each.reason if isinstance(each, InvalidTree) else each
        return found


def _simulate(
    item: tuple[Mapping[str, float], Scenario | None], model: ForwardModel
) -> Simulation | InvalidTree | InvalidTorso:
    return model.simulate(*item)
