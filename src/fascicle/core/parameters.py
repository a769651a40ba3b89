"""The parameter space: names, units, ranges, and and the map to the unit cube and back."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One parameter: its name, its unit and the range it is searched in."""

    name: str
    unit: str
    lower: float
    upper: float


def _network_parameters() -> Iterator[Parameter]:
    """Ranges of table 1 of the paper."""
    sides = ("lv", "rv")
    for side in sides:
        yield Parameter(f"{side}_initial_length", "mm", 30.0, 100.0)
    for side in sides:
        for k in (1, 2):
            yield Parameter(f"{side}_fascicle_length_{k}", "mm", 2.0, 50.0)
    for side in sides:
        for k in (1, 2):
            yield Parameter(f"{side}_fascicle_angle_{k}", "rad", -math.pi / 4, 3 * math.pi / 4)
    yield Parameter("root_time", "ms", -75.0, 50.0)
    yield Parameter("cv", "mm/ms", 2.0, 4.0)


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered set of free parameters; points in it are dictionaries or unit-cube vectors."""

    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names, in the order of the vector's components."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def lower(self) -> Floats:
        """Lower ends of the ranges, each in its own unit."""
        return np.array([parameter.lower for parameter in self.parameters])

    @property
    def upper(self) -> Floats:
        """Upper ends of the ranges, each in its own unit."""
        return np.array([parameter.upper for parameter in self.parameters])

    def __len__(self) -> int:
        return len(self.parameters)

    def to_unit(self, values: Mapping[str, float]) -> Floats:
        """Named values to a point of the unit cube, shape (d,)."""
        check_names(values, self.names)
        vector = np.array([float(values[name]) for name in self.names])
        return np.asarray((vector - self.lower) / (self.upper - self.lower))

    def from_unit(self, point: Floats) -> dict[str, float]:
        """Point of the unit cube, shape (d,), to named values."""
        vector = self.lower + np.asarray(point) * (self.upper - self.lower)
        return dict(zip(self.names, map(float, vector), strict=True))


NETWORK_SPACE = ParameterSpace(tuple(_network_parameters()))


def check_names(values: Mapping[str, float], names: tuple[str, ...]) -> None:
    """Refuse unknown, missing or non-finite parameters.

    Raises
    ------
    InputError
        With the name, and the names that are known.
    """
    for name, value in values.items():
        if name not in names:
            raise InputError(f"unknown parameter '{name}'; known are: {', '.join(names)}")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"parameter '{name}' is {value!r}; give a number")
        if not math.isfinite(value):
            raise InputError(f"parameter '{name}' is {value}; give a finite number")
    missing = [name for name in names if name not in values]
    if missing:
        raise InputError(
            f"missing parameters {', '.join(missing)}; add them"
            if len(missing) > 1
            else f"missing parameter {missing[0]}; add it"
        )


# A network with an ECG within normal limits: QRS 90 to 100 ms, normal axis, transition at V3 or V4.
# Found by a random search on the packaged heart and on the mean shape of 1000 hearts (Cobiveco's
# geo1), both in the idealised torso; with root_time -60 both show left bundle branch block.
EXAMPLE_PARAMETERS: dict[str, float] = {
    "lv_initial_length": 86.5,
    "rv_initial_length": 79.0,
    "lv_fascicle_length_1": 42.5,
    "lv_fascicle_length_2": 28.5,
    "rv_fascicle_length_1": 20.5,
    "rv_fascicle_length_2": 43.5,
    "lv_fascicle_angle_1": 1.75,
    "lv_fascicle_angle_2": 0.78,
    "rv_fascicle_angle_1": -0.72,
    "rv_fascicle_angle_2": -0.29,
    "root_time": 2.0,
    "cv": 2.8,
}
