"""Whatever the public interface is given: an answer, or one line of an InputError."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.quantities import BODY, QUANTITIES
from fascicle.forward.model import ForwardModel
from fascicle.study.settings import checked_settings
from fascicle.study.space import study_space

NUMBER = 500
VALUES: tuple[Any, ...] = (
    0, 1, -1, 0.5, 3, 1e-300, 1e9, -1e9, 1e155, 1e308, -1e308, 10**400, np.nan, np.inf, -np.inf,
    np.float32(2.0), np.int64(3), True, None, "", "lv", "bundle", "rv apex", "nonsense", "a\0b",
    "x" * 5000, b"lv", (), (1.0, 2.0, 3.0), (np.nan, 0.0, 0.0), (1e308,) * 3, [1, 2], ("lv", "rv"),
    np.zeros(3), np.zeros((0, 3)), np.full(3, np.nan), {}, {"cv": 1}, object(), Path("/nowhere"),
)  # fmt: skip
KEPT = ("stimuli", "slowings", "trees", "regions", "source", "around")  # made by others


def built(kind: type, **given: Any) -> Callable[[np.random.Generator], Any]:
    """Make a dataclass with some of its fields spoilt."""
    names = [field.name for field in fields(kind) if field.init and field.name not in KEPT]

    def make(rng: np.random.Generator) -> Any:
        spoilt = rng.choice(names, size=rng.integers(1, 3), replace=False)
        return kind(**given | {name: VALUES[rng.integers(len(VALUES))] for name in spoilt})

    return make


def any_value(rng: np.random.Generator) -> Any:
    return VALUES[rng.integers(len(VALUES))]


def calls(model: ForwardModel) -> dict[str, Callable[[np.random.Generator], Any]]:
    """Every public function that is quick enough, of a generator that chooses what it gets."""
    example, heart = dict(fascicle.EXAMPLE_PARAMETERS), model.heart

    def simulate(rng: np.random.Generator) -> Any:
        # those of the body take minutes once; `tests/core/test_ranges.py` has them
        names = [name for name in QUANTITIES if name not in BODY]
        name = rng.choice([*names, "region_1_conductivity", "nonsense"])
        return model.simulate(example | {str(name): any_value(rng)})

    def paced(rng: np.random.Generator) -> Any:
        kind = rng.integers(3)
        if kind == 0:
            stimulus = built(fascicle.Stimulus, time=0.0, position=(0.0, 0.0, 0.0))(rng)
            return model.simulate(example, fascicle.Scenario(stimuli=(stimulus,)))
        if kind == 1:
            slowing = built(fascicle.Slowing, tree="lv", speed=0.5)(rng)
            return model.simulate(example, fascicle.Scenario(slowings=(slowing,)))
        his = built(fascicle.His)(rng)
        return model.simulate(example, fascicle.Scenario(his=his))

    def regional(rng: np.random.Generator) -> Any:
        region = built(fascicle.Region, conductivity=0.5, centre=(0.0, 0.0, 0.0), radius=5.0)(rng)
        return fascicle.Conduction(regions=(region,)).scale(heart)

    def settings(rng: np.random.Generator) -> Any:
        names = [*fascicle.FitSettings.model_fields, "nonsense"]
        return checked_settings({str(rng.choice(names)): any_value(rng)})

    def space(rng: np.random.Generator) -> Any:
        name = str(rng.choice([*QUANTITIES, "pose", "nonsense"]))
        wanted = any_value(rng)
        if rng.random() < 0.5:
            wanted = {str(rng.choice(["lower", "upper", "prior", "median", "sd"])): any_value(rng)}
        return study_space("posterior", {name: wanted}, heart)

    return {
        "Stimulus": built(fascicle.Stimulus, time=0.0, position=(0.0, 0.0, 0.0)),
        "Slowing": built(fascicle.Slowing, tree="lv", speed=0.5),
        "His": built(fascicle.His),
        "Region": built(fascicle.Region, conductivity=0.5, label=1),
        "Conduction": built(fascicle.Conduction),
        "GrowthRules": built(fascicle.GrowthRules),
        "Choices": built(fascicle.Choices),
        "simulate": simulate,
        "scenarios": paced,
        "regions": regional,
        "settings": settings,
        "parameters": space,
        "load_heart": lambda rng: fascicle.load_heart(any_value(rng)),
        "load_study": lambda rng: fascicle.load_study(any_value(rng)),
        "read_target": lambda rng: fascicle.read_target(any_value(rng)),
        "read_recording": lambda rng: fascicle.read_recording(any_value(rng)),
        "read_scenarios": lambda rng: fascicle.read_scenarios([any_value(rng)]),
    }


@pytest.fixture(scope="module")
def functions(default_model: ForwardModel) -> dict[str, Callable[[np.random.Generator], Any]]:
    return calls(default_model)


@pytest.mark.parametrize(
    "name",
    [
        "Stimulus", "Slowing", "His", "Region", "Conduction", "GrowthRules", "Choices", "simulate",
        "scenarios", "regions", "settings", "parameters", "load_heart", "load_study", "read_target",
        "read_recording", "read_scenarios",
    ],
)  # fmt: skip
def test_an_answer_or_one_line(functions, name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    refused, failures = 0, set()
    for number in range(NUMBER):
        rng = np.random.default_rng([7, number])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                functions[name](rng)
            except InputError as error:
                refused += 1
                if not str(error).isprintable() or len(str(error)) > 1000:
                    failures.add(f"{number}: no line: {str(error)[:200]!r}")
            except Exception as error:  # noqa: BLE001 - that there is none is what is tested
                failures.add(f"{number}: {type(error).__name__}: {error!s:.150}")
    assert not failures, sorted(failures)[:12]
    assert refused > 10
