"""Calls of the public Python interface with arguments that are wrong, extreme or neither."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

import fascicle
from benchmarks.fuzzing.kinds import small_model
from benchmarks.fuzzing.seeds import parameters
from fascicle.core.quantities import QUANTITIES, TORSO_QUANTITIES
from fascicle.networks.prior import study_space
from fascicle.networks.settings import checked_settings

Call = Callable[[np.random.Generator], Any]

VALUES: tuple[Any, ...] = (
    0, 1, -1, 0.5, 3, 1e-300, 1e9, -1e9, 1e155, 1e308, -1e308, 10**400, np.nan, np.inf, -np.inf,
    np.float32(2.0), np.int64(3), True, None, "", "lv", "bundle", "rv apex", "nonsense", "a\0b",
    "x" * 5000, b"lv", (), (1.0, 2.0, 3.0), (np.nan, 0.0, 0.0), (1e308,) * 3, [1, 2], ("lv", "rv"),
    np.zeros(3), np.zeros((0, 3)), np.full(3, np.nan), {}, {"cv": 1}, object(), Path("/nowhere"),
)  # fmt: skip
KEPT = ("primitives", "trees", "regions", "source")  # made by others


def built(kind: type, **arguments: Any) -> Call:
    """Make a dataclass with some of its fields spoilt."""
    names = [field.name for field in fields(kind) if field.init and field.name not in KEPT]

    def make(rng: np.random.Generator) -> Any:
        number = rng.integers(1, min(2, len(names)) + 1)
        spoilt = rng.choice(names, size=number, replace=False)
        return kind(**arguments | {name: VALUES[rng.integers(len(VALUES))] for name in spoilt})

    return make


def any_value(rng: np.random.Generator) -> Any:
    return VALUES[rng.integers(len(VALUES))]


def _simulate(rng: np.random.Generator) -> Any:
    # those of the torso take minutes once; `tests/core/test_ranges.py` has them
    names = [name for name in QUANTITIES if name not in TORSO_QUANTITIES]
    name = rng.choice([*names, "region_1_conductivity", "nonsense"])
    return small_model().simulate(parameters() | {str(name): any_value(rng)})


def _paced(rng: np.random.Generator) -> Any:
    makers = (
        built(fascicle.Stimulus, time=0.0, position=(0.0, 0.0, 0.0)),
        built(fascicle.SlowConduction, tree="lv", speed=0.5),
        built(fascicle.His),
    )
    primitive = makers[rng.integers(len(makers))](rng)
    return small_model().simulate(parameters(), fascicle.Scenario([primitive]))


def _regional(rng: np.random.Generator) -> Any:
    region = built(fascicle.Region, conductivity=0.5, centre=(0.0, 0.0, 0.0), radius=5.0)(rng)
    return fascicle.Conduction(regions=(region,)).scale(small_model().heart)


def _settings(rng: np.random.Generator) -> Any:
    names = [*fascicle.FitSettings.model_fields, "nonsense"]
    return checked_settings({str(rng.choice(names)): any_value(rng)})


def _space(rng: np.random.Generator) -> Any:
    name = str(rng.choice([*QUANTITIES, "pose", "nonsense"]))
    prior = any_value(rng)
    if rng.random() < 0.5:
        prior = {str(rng.choice(["lower", "upper", "prior", "median", "sd"])): any_value(rng)}
    return study_space("posterior", {name: prior}, small_model().heart)


# Every public function that is quick enough, of a generator that chooses what it gets
CALLS: dict[str, Call] = {
    "Stimulus()": built(fascicle.Stimulus, time=0.0, position=(0.0, 0.0, 0.0)),
    "SlowConduction()": built(fascicle.SlowConduction, tree="lv", speed=0.5),
    "InactiveRoot()": built(fascicle.InactiveRoot, tree="lv"),
    "JunctionDelays()": built(fascicle.JunctionDelays),
    "His()": built(fascicle.His),
    "Region()": built(fascicle.Region, conductivity=0.5, label=1),
    "Conduction()": built(fascicle.Conduction),
    "GrowthRules()": built(fascicle.GrowthRules),
    "TargetOptions()": built(fascicle.TargetOptions),
    "simulate()": _simulate,
    "simulate(scenario)": _paced,
    "Conduction(regions)": _regional,
    "fit(settings)": _settings,
    "fit(parameters)": _space,
    "load_heart()": lambda rng: fascicle.load_heart(any_value(rng)),
    "load_study()": lambda rng: fascicle.load_study(any_value(rng)),
    "read_target()": lambda rng: fascicle.read_target(any_value(rng)),
    "read_recording()": lambda rng: fascicle.read_recording(any_value(rng)),
    "read_scenarios()": lambda rng: fascicle.read_scenarios([any_value(rng)]),
}
