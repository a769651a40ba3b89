"""What is learnt, with its priors; files of parameters; an example."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import check_file, read_toml
from fascicle.core.quantities import (
    SIDES,
    USUAL_FASCICLES,
    Changes,
    check_one_speed,
    checked,
    fascicle_names,
    fascicles,
    quantity,
)

Prior = Literal["uniform", "normal", "log-uniform", "log-normal"]
LOGARITHMIC = ("log-uniform", "log-normal")
NORMAL = ("normal", "log-normal")


@dataclass(frozen=True)
class Parameter:
    """One parameter that is learnt: its unit, its range and its prior within that range.

    Attributes
    ----------
    name, unit : str
        As in `fascicle.core.quantities.QUANTITIES`.
    lower, upper : float
        Its range, in its unit.
    prior : str
        ``"uniform"``; ``"normal"`` with `median` and `sd`; ``"log-uniform"``; ``"log-normal"`` with
        `median`, and `sd` that of the natural logarithm. All are cut off at the ends of the range.
    median, sd : float, optional
        In its unit; of a normal prior.
    """

    name: str
    unit: str
    lower: float
    upper: float
    prior: Prior = "uniform"
    median: float | None = None
    sd: float | None = None

    def __post_init__(self) -> None:
        if not -math.inf < self.lower < self.upper < math.inf:
            raise InputError(
                f"parameter '{self.name}': its range {self.lower:g} to {self.upper:g} is none; "
                "give two finite numbers, the lower first"
            )
        if self.prior in LOGARITHMIC and self.lower <= 0:
            raise InputError(
                f"parameter '{self.name}': a {self.prior} prior needs a range above 0, not "
                f"{self.lower:g} to {self.upper:g}"
            )
        normal = self.median is not None and self.sd is not None
        if (self.prior in NORMAL) != normal or (self.median, self.sd).count(None) == 1:
            raise InputError(
                f"parameter '{self.name}': a {self.prior} prior "
                + ("needs median and sd" if self.prior in NORMAL else "has no median and sd")
            )
        if self.median is None or self.sd is None:
            return
        if not self.sd > 0 or not self.lower <= self.median <= self.upper:
            raise InputError(
                f"parameter '{self.name}': median {self.median:g} and sd {self.sd:g}; the "
                f"median must lie within {self.lower:g} to {self.upper:g}, sd above 0"
            )

    def from_unit(self, share: Floats) -> Floats:
        """Quantiles: values (its unit) below which the prior has these shares, from 0 to 1."""
        from scipy.special import ndtr, ndtri

        low, high = self._scaled(np.array([self.lower, self.upper]))
        if self.prior in NORMAL:
            centre, sd = self._normal()
            below, up_to = ndtr((low - centre) / sd), ndtr((high - centre) / sd)
            scaled = np.clip(centre + sd * ndtri(below + share * (up_to - below)), low, high)
        else:
            scaled = low + np.asarray(share) * (high - low)
        return np.asarray(np.exp(scaled) if self.prior in LOGARITHMIC else scaled)

    def to_unit(self, value: Floats) -> Floats:
        """Shares of the prior below values in its unit: the inverse of `from_unit`."""
        from scipy.special import ndtr

        low, high = self._scaled(np.array([self.lower, self.upper]))
        scaled = self._scaled(np.asarray(value, dtype=float))
        if self.prior in NORMAL:
            centre, sd = self._normal()
            scaled, low, high = (ndtr((x - centre) / sd) for x in (scaled, low, high))
        return np.asarray((scaled - low) / (high - low))

    def density(self, value: Floats) -> Floats:
        """Prior density (per unit) at values in its range."""
        width = 1e-6 * (self.upper - self.lower)
        value = np.clip(value, self.lower + width, self.upper - width)
        return np.asarray((self.to_unit(value + width) - self.to_unit(value - width)) / (2 * width))

    def _scaled(self, value: Floats) -> Floats:
        return np.asarray(np.log(value) if self.prior in LOGARITHMIC else value)

    def _normal(self) -> tuple[float, float]:
        """Centre and standard deviation, of the logarithm where the prior is logarithmic."""
        assert self.median is not None
        assert self.sd is not None
        return float(self._scaled(np.array(self.median))), self.sd


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered set of free parameters; points in it are dictionaries or unit-cube vectors.

    The unit cube holds the shares of the priors: a point drawn uniformly there is one drawn from
    the prior.
    """

    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names, in the order of the vector's components."""
        return tuple(parameter.name for parameter in self.parameters)

    def __len__(self) -> int:
        return len(self.parameters)

    def from_unit(self, point: Floats) -> dict[str, float]:
        """Point of the unit cube, shape (d,), to named values."""
        return {
            parameter.name: float(parameter.from_unit(share))
            for parameter, share in zip(self.parameters, np.asarray(point), strict=True)
        }

    def to_unit(self, values: Mapping[str, float]) -> Floats:
        """Named values to the point of the unit cube, shape (d,)."""
        return np.array([float(p.to_unit(np.array(values[p.name]))) for p in self.parameters])


def free(name: str, **prior: Any) -> Parameter:
    """Make a parameter of a quantity, with its usual range and prior.

    Where `prior` says anything, it is that, or else uniform.

    Parameters
    ----------
    name : str
        A quantity of `fascicle.core.quantities`.
    **prior
        Fields of `Parameter`: `lower`, `upper`, `prior`, `median`, `sd`.

    Raises
    ------
    InputError
        If the quantity is unknown or can only be fixed, or the prior is impossible.
    """
    known = quantity(name)
    if known.is_integer:
        raise InputError(f"parameter '{name}' counts something; it can be fixed, not learnt")
    lower, upper = known.prior_range
    if not prior and known.default_prior is not None:
        kind, sd = known.default_prior
        prior = {"prior": kind, "median": known.default, "sd": sd}
    fields = {"lower": lower, "upper": upper} | prior
    for end in ("lower", "upper"):
        checked({name: fields[end]})
    return Parameter(name, known.unit, **fields)


def network_space(lv: int = USUAL_FASCICLES, rv: int = USUAL_FASCICLES) -> ParameterSpace:
    """The paper's parameters (table 1), for a number of fascicles on each side."""
    counts = dict(zip(SIDES, (lv, rv), strict=True))
    names = [f"{side}_initial_length" for side in SIDES]
    for what in (0, 1):  # lengths of both sides, then angles
        for side, count in counts.items():
            names += fascicle_names(side, count)[what * count : (what + 1) * count]
    return ParameterSpace(tuple(free(name) for name in [*names, "root_time", "cv"]))


NETWORK_SPACE = network_space()


def complete(values: Mapping[str, Any]) -> dict[str, float]:
    """Check the parameters of a network: names, numbers, ranges, and that none is missing.

    Raises
    ------
    InputError
        With the name, of the first that is wrong.
    """
    numbers = checked(values)
    for name in numbers:
        if quantity(name).changes is Changes.STUDY:
            raise InputError(f"parameter '{name}': the names of the others say it; leave it out")
    check_one_speed(numbers)
    needed = (*(f"{side}_initial_length" for side in SIDES), "root_time", "cv")
    missing = [name for name in needed if name not in numbers]
    if missing:
        raise InputError(f"missing parameters {', '.join(missing)}; add them")
    for side in SIDES:
        fascicles(side, numbers)
    return numbers


def read_parameters(path: Path | str) -> dict[str, float]:
    """Read the parameters of a network from a TOML file.

    Raises
    ------
    InputError
        If the file is missing or not TOML, or a parameter is unknown, missing or impossible.
    """
    path = Path(path)
    check_file(path, (".toml",), "parameters")
    values = read_toml(path, "write lines like 'cv = 3.0'")
    try:
        return complete(values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


# A network with an ECG within normal limits: QRS 90 to 100 ms, normal axis, transition at V3 or V4.
# Found by a random search on the packaged heart and on the mean shape of 1000 hearts (Cobiveco's
# geo1), both in the idealised torso; with root_time -60 both show left bundle branch block.
EXAMPLE_AREAS = {"lv": 11_349.0, "rv": 14_620.0}  # mm², of the packaged heart's endocardia
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
