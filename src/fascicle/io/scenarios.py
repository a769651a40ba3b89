"""Scenario files: TOML with stimuli, slow or blocked segments, delays, regions, extra trees."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fascicle.eikonal.scenario import Scenario, Slowing, Stimulus
from fascicle.errors import InputError
from fascicle.geometry.conduction import Region
from fascicle.io.meshes import check_file
from fascicle.io.trees import read_tree

Point = tuple[float, float, float]
NotNegative = Annotated[float, Field(ge=0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Stimulus(_Table):
    time: float
    position: Point
    tree: str | None = None


class _Slowing(_Table):
    tree: str
    speed: NotNegative
    part: str | None = None
    centre: Point | None = None
    radius: NotNegative | None = None


class _Region(_Table):
    conductivity: NotNegative
    label: int | None = None
    centre: Point | None = None
    radius: NotNegative | None = None


class _Tree(_Table):
    name: str
    file: Path
    time: float
    root: Point


class _Delay(_Table):
    model_config = ConfigDict(extra="forbid")  # inf blocks
    orthodromic: NotNegative = 0.0
    antidromic: NotNegative = 0.0


class _File(_Table):
    stimulus: list[_Stimulus] = []
    slowing: list[_Slowing] = []
    region: list[_Region] = []
    tree: list[_Tree] = []
    silent: list[str] = []
    delay: _Delay = _Delay()


def read_scenario(path: Path | str) -> tuple[Scenario, tuple[Region, ...]]:
    """Read a scenario, and the regions of the myocardium that conduct otherwise in it.

    Files of trees are looked for beside the scenario.

    Raises
    ------
    InputError
        If the file is missing or not TOML, holds an unknown key or a wrong value, or a tree in it
        cannot be read.
    """
    path = Path(path)
    check_file(path, (".toml",), "scenario")
    try:
        content = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: '{key}': {first['msg']}; see docs/files.md") from None
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, of a number too long
        raise InputError(f"{path}: not valid TOML ({error}); see docs/files.md") from None
    trees = tuple(
        (read_tree(path.parent / tree.file, tree.name, np.array(tree.root)), tree.time)
        for tree in content.tree
    )
    scenario = Scenario(
        stimuli=tuple(Stimulus(**dict(s)) for s in content.stimulus),
        slowings=tuple(Slowing(**dict(s)) for s in content.slowing),
        silent=tuple(content.silent),
        orthodromic_delay=content.delay.orthodromic,
        antidromic_delay=content.delay.antidromic,
        trees=trees,
    )
    return scenario, tuple(Region(**dict(region)) for region in content.region)
