"""Free parameters with their priors; parameter files; an example."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import ValueRefusedError, given_in
from fascicle.core.files import check_file, read_toml
from fascicle.core.quantities import (
    DELAY,
    SIDES,
    Changes,
    check,
    check_not_twice,
    checked,
    fascicle_names,
    fascicles,
    quantity,
)

FREE = "free"  # instead of a value, for a quantity learnt with its usual prior
Distribution = Literal["uniform", "normal", "log-uniform", "log-normal"]


@dataclass(frozen=True)
class Infeasible:
    """Outcome for quantities that do not give a beat; a search meets it, so it is not an error.

    Attributes
    ----------
    reason, remedy : str
        Reason in a line, and what to change.
    quantity, most : str and float
        Quantity that is too large, and the largest value that fits, if one is to blame.
    """

    reason: str
    remedy: str = ""
    quantity: str = ""
    most: float = math.nan


@dataclass(frozen=True)
class Parameter:
    """Parameter that is learnt: its unit, its range and its prior within that range.

    Attributes
    ----------
    name, unit : str
        As in `fascicle.core.quantities.QUANTITIES`.
    lower, upper : float
        Its range, in its unit.
    prior : str
        ``"uniform"``; ``"normal"`` with `median` and `sd`; ``"log-uniform"``; ``"log-normal"`` with
        `median`, and `sd` that of the natural logarithm. All are truncated to the range.
    median, sd : float, optional
        In its unit; of a normal prior.
    order : (int, int), optional
        ``(k, n)``: the k-th smallest of n with this prior, drawn independently of one another.
    """

    name: str
    unit: str
    lower: float
    upper: float
    prior: Distribution = "uniform"
    median: float | None = None
    sd: float | None = None
    order: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        ends = f"{self.lower:g} to {self.upper:g}"
        problem = None
        if not -math.inf < self.lower < self.upper < math.inf:
            problem = f"its range {ends} is none; give two finite numbers, the lower first"
        elif self._logarithmic and self.lower <= 0:
            problem = f"a {self.prior} prior needs a range above 0, not {ends}"
        elif self._normal != (self.median is not None) or self._normal != (self.sd is not None):
            problem = f"a {self.prior} prior {'needs' if self._normal else 'has no'} median and sd"
        elif self.median is not None and not self.lower <= self.median <= self.upper:
            problem = f"median {self.median:g}; the median must lie within {ends}"
        elif self.sd is not None and not self.sd > 0:
            problem = f"sd {self.sd:g}; give an sd above 0"
        if problem:
            raise ValueRefusedError(f"parameter '{self.name}': {problem}")

    @property
    def _beta(self) -> tuple[int, int]:
        """Parameters of the beta distribution of an order statistic of uniform draws."""
        assert self.order is not None
        k, n = self.order
        return k, n + 1 - k

    @property
    def _logarithmic(self) -> bool:
        return self.prior.startswith("log")

    @property
    def _normal(self) -> bool:
        return self.prior.endswith("normal")

    def from_unit(self, share: Floats) -> Floats:
        """Quantiles of the prior (its unit) at cumulative probabilities `share`, from 0 to 1."""
        from scipy.special import betaincinv

        return self._quantile(share if self.order is None else betaincinv(*self._beta, share))

    def _quantile(self, share: Floats) -> Floats:
        """Quantiles of the prior, its `order` disregarded."""
        from scipy.special import ndtr, ndtri

        low, high = self._scaled(np.array([self.lower, self.upper]))
        if self._normal:
            centre, sd = self._centre_and_sd()
            below, up_to = ndtr((low - centre) / sd), ndtr((high - centre) / sd)
            scaled = np.clip(centre + sd * ndtri(below + share * (up_to - below)), low, high)
        else:
            scaled = low + np.asarray(share) * (high - low)
        return np.asarray(np.exp(scaled) if self._logarithmic else scaled)

    def to_unit(self, value: Floats) -> Floats:
        """Cumulative probabilities of the prior at values (its unit): inverse of `from_unit`."""
        from scipy.special import betainc

        share = self._share(value)
        return share if self.order is None else np.asarray(betainc(*self._beta, share))

    def _share(self, value: Floats) -> Floats:
        """Inverse of `_quantile`."""
        from scipy.special import ndtr

        low, high = self._scaled(np.array([self.lower, self.upper]))
        scaled = self._scaled(np.asarray(value, dtype=float))
        if self._normal:
            centre, sd = self._centre_and_sd()
            scaled, low, high = (ndtr((x - centre) / sd) for x in (scaled, low, high))
        return np.asarray((scaled - low) / (high - low))

    def density(self, value: Floats) -> Floats:
        """Prior density (per unit) at values in its range."""
        width = 1e-6 * (self.upper - self.lower)
        value = np.clip(value, self.lower + width, self.upper - width)
        return np.asarray((self.to_unit(value + width) - self.to_unit(value - width)) / (2 * width))

    def _scaled(self, value: Floats) -> Floats:
        return np.asarray(np.log(value) if self._logarithmic else value)

    def _centre_and_sd(self) -> tuple[float, float]:
        """Centre and standard deviation of a normal prior; of the logarithm if it is log-normal."""
        assert self.median is not None
        assert self.sd is not None
        return float(self._scaled(np.array(self.median))), self.sd


@dataclass(frozen=True)
class MixedParameter(Parameter):
    """Parameter whose prior is a weighted mixture of several.

    Attributes
    ----------
    parts : tuple of (float, Parameter)
        Weights, which add up to 1, and priors.
    """

    parts: tuple[tuple[float, Parameter], ...] = ()

    def _share(self, value: Floats) -> Floats:
        value = np.asarray(value, dtype=float)
        shares = [weight * p._share(np.clip(value, p.lower, p.upper)) for weight, p in self.parts]
        return np.asarray(np.sum(shares, axis=0))

    def _quantile(self, share: Floats) -> Floats:
        grid = np.linspace(self.lower, self.upper, 10_001)
        return np.asarray(np.interp(share, self._share(grid), grid))


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered set of free parameters; points in it are dictionaries or unit-cube vectors.

    Coordinates in the unit cube are cumulative probabilities: a point drawn uniformly there is a
    draw from the prior. Of n parameters in order, the largest is that of n draws, and every other
    one is the largest of the draws below the next.
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
        return {name: float(value[0]) for name, value in self.columns(point[None]).items()}

    def columns(self, points: Floats) -> dict[str, Floats]:
        """Points of the unit cube (n, d) to named values, (n,) each."""
        shares = np.array(points, dtype=float)
        for alike in self._in_order:
            below = np.ones(len(shares))
            for k in reversed(range(len(alike))):
                below = below * shares[:, alike[k]] ** (1 / (k + 1))
                shares[:, alike[k]] = below
        return {p.name: p._quantile(shares[:, k]) for k, p in enumerate(self.parameters)}

    def to_unit(self, values: Mapping[str, float]) -> Floats:
        """Named values to the point of the unit cube, shape (d,)."""
        shares = np.array([float(p._share(np.array(values[p.name]))) for p in self.parameters])
        for alike in self._in_order:
            for k, place in enumerate(alike):
                below = 1.0 if k + 1 == len(alike) else shares[alike[k + 1]]
                shares[place] = (shares[place] / below) ** (k + 1) if below else 1.0
        return shares

    @cached_property
    def _in_order(self) -> list[list[int]]:
        """Positions of the ordered parameters, a list for each ventricle, the smallest first."""
        places: dict[str, list[int]] = {}
        for place, parameter in enumerate(self.parameters):
            if parameter.order is not None:
                places.setdefault(parameter.name.rpartition("_")[0], []).append(place)
        return list(places.values())


def ordered_fascicles(space: ParameterSpace) -> ParameterSpace:
    """Space with the fascicle angles of each ventricle in order, where their priors agree.

    Exchanging the fascicles of a ventricle hardly changes the ECG, so each network has copies.
    """
    named = {parameter.name: parameter for parameter in space.parameters}
    for side in SIDES:
        angles = [name for name in named if name.startswith(f"{side}_fascicle_angle_")]
        lengths = [name.replace("angle", "length") for name in angles]
        if len(angles) < 2 or not {*angles, *lengths} <= {*named}:
            continue
        priors = ({replace(named[name], name="") for name in names} for names in (angles, lengths))
        if all(len(different) == 1 for different in priors):
            for k, name in enumerate(angles):
                named[name] = replace(named[name], order=(k + 1, len(angles)))
    return ParameterSpace(tuple(named.values()))


def free(name: str, **prior: Any) -> Parameter:
    """Make a parameter of a quantity, with its declared range and prior.

    `prior` overrides these: `lower`, `upper`, `prior`, `median`, `sd`; without `prior` among them
    the prior is then uniform.
    """
    declared = quantity(name)
    if declared.is_integer:
        raise ValueRefusedError(f"parameter '{name}' counts something; it can be fixed, not learnt")
    if not prior and declared.default_prior is not None:
        kind, sd = declared.default_prior
        prior = {"prior": kind, "median": declared.default, "sd": sd}
    lower, upper = declared.prior_range
    fields = {"lower": lower, "upper": upper} | prior
    for end in ("lower", "upper"):
        check(declared, fields[end])
    return Parameter(name, declared.unit, **fields)


def network_space(lv: int = 2, rv: int = 2) -> ParameterSpace:
    """The paper's parameters (table 1), for a number of fascicles on each side."""
    counts = {"lv": lv, "rv": rv}
    names = [f"{side}_initial_length" for side in SIDES]
    for half in (0, 1):  # lengths of both sides, then angles
        for side, count in counts.items():
            names += fascicle_names(side, count)[half * count : (half + 1) * count]
    return ParameterSpace(tuple(free(name) for name in [*names, "root_time", "cv"]))


NETWORK_SPACE = network_space()


def human_space(lv: int = 3, rv: int = 2) -> ParameterSpace:
    """Parameters with priors of human anatomy, for a number of fascicles on each side.

    Of three left fascicles the first is the anterior one, the second the septal one, the third the
    posterior one; of two there is no septal one.
    """
    # docs/quantities.md names the source of each range; lengths (mm), then directions of left
    # fascicles and angles of right ones (rad)
    anterior, septal = ((20.0, 50.0), (0.6, 1.5)), ((5.0, 20.0), (-0.8, 0.8))
    posterior, other = ((20.0, 50.0), (-1.6, -0.6)), ((5.0, 50.0), (-1.6, 1.6))
    left = [] if lv < 2 else [anterior, posterior] if lv == 2 else [anterior, septal, posterior]
    right = [] if rv < 2 else [((5.0, 30.0), (-2.0, 0.0)), ((5.0, 30.0), (0.3, 1.8))]
    sides = ("lv", left, lv), ("rv", right, rv)
    ranges = {"lv_initial_length": (5.0, 20.0), "rv_initial_length": (35.0, 60.0)}
    for number, kinds in enumerate((("length", "length"), ("direction", "angle"))):
        for (side, named, count), kind in zip(sides, kinds, strict=True):
            for k, fascicle in enumerate([*named, *[other] * count][:count], 1):
                ranges[f"{side}_fascicle_{kind}_{k}"] = fascicle[number]
    ranges |= {
        "interventricular_delay": (-75.0, 60.0), "cv": (1.5, 3.5), "fibre_speed": (0.4, 0.8),
    }  # fmt: skip
    return ParameterSpace(
        tuple(free(name, lower=lower, upper=upper) for name, (lower, upper) in ranges.items())
    )


HUMAN_SPACE = human_space()


def complete(values: Mapping[str, Any]) -> dict[str, float]:
    """Check the parameters of a network: names, numbers, ranges, and that none is missing."""
    numbers = checked(values)
    for name in numbers:
        if quantity(name).changes is Changes.STUDY:
            raise ValueRefusedError(
                f"parameter '{name}': the names of the others say it; leave it out"
            )
    check_not_twice(numbers)
    needed = [f"{side}_initial_length" for side in SIDES]
    needed += ["cv"] if DELAY[1] in numbers else ["root_time", "cv"]
    missing = [name for name in needed if name not in numbers]
    if missing:
        raise ValueRefusedError(f"missing parameters {', '.join(missing)}; add them")
    for side in SIDES:
        fascicles(side, numbers)
    return numbers


def read_parameters(path: Path | str) -> dict[str, float]:
    """Read the parameters of a network from a TOML file."""
    path = Path(path)
    check_file(path, (".toml",), "parameters")
    values = read_toml(path, "write lines like 'cv = 3.0'")
    with given_in(path):
        return complete(values)


# A network in the paper's parameters, which grows on most hearts; it is not of human anatomy, and
# activates the right ventricle first. With root_time -60 it shows left bundle branch block.
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
