"""The parameter space: names, units, ranges, the map from the unit cube; files of parameters."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import check_file


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


def read_parameters(path: Path | str) -> dict[str, float]:
    """Read the twelve parameters of a network from a TOML file.

    Raises
    ------
    InputError
        If the file is missing or not TOML, or a parameter is unknown, missing or not finite.
    """
    path = Path(path)
    check_file(path, (".toml",), "parameters")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, of a number too long
        raise InputError(f"{path}: not valid TOML ({error}); write lines like 'cv = 3.0'") from None
    try:
        check_names(values, NETWORK_SPACE.names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except OverflowError:
        raise InputError(f"{path}: a number has too many digits; correct it") from None
    return {name: float(values[name]) for name in NETWORK_SPACE.names}


# A network with an ECG within normal limits: QRS 90 to 100 ms, normal axis, transition at V3 or V4.
# Found by a random search on the packaged heart and on the mean shape of 1000 hearts (Cobiveco's
# geo1), both in the idealised torso; with root_time -60 both show left bundle branch block.
EXAMPLE_PARAMETERS: dict[str, float] = {
    "lv_initial_length": 98.0,
    "rv_initial_length": 86.0,
    "lv_fascicle_length_1": 48.5,
    "lv_fascicle_length_2": 36.5,
    "rv_fascicle_length_1": 20.0,
    "rv_fascicle_length_2": 49.5,
    "lv_fascicle_angle_1": 1.25,
    "lv_fascicle_angle_2": -0.02,
    "rv_fascicle_angle_1": -0.78,
    "rv_fascicle_angle_2": 0.87,
    "root_time": 2.0,
    "cv": 3.1,
}
