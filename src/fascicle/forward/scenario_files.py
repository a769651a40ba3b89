"""Scenario files: TOML tables of primitives, regions of the myocardium and additional trees."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

import fascicle.forward.primitives  # noqa: F401  registers those of the package
from fascicle.core.declared import Name, Point, Table, Time
from fascicle.core.errors import InputError, given_in
from fascicle.core.files import as_path, check_file, named_by, read_toml
from fascicle.core.ranges import check_items, check_text, did_you_mean
from fascicle.forward.scenario import PRIMITIVES, Scenario
from fascicle.heart.conduction import Region
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import read_tree

Kind = TypeVar("Kind", bound=Table)


class TreeFile(Table, table="tree"):
    """A tree in addition to the heart's own."""

    name: Annotated[Name, "letters, digits, - and _; it is written to `name_tree.vtu`"]
    file: Annotated[Name, "lines (VTU, VTP, VTK), in the folder of this file"]
    root: Annotated[
        Point, "the node nearest to this point, within 2 mm, fires: an end, a fork or neither"
    ]
    time: Annotated[Time, "when it fires"]

    def __post_init__(self) -> None:
        if not self.name.replace("-", "").replace("_", "").isalnum() or not self.name.isascii():
            raise InputError(f"'name' is '{self.name}'; give letters, digits, '-' and '_'")

    def read(self, scenario: Path) -> PurkinjeTree:
        """Read the tree of a scenario file."""
        with given_in(f"tree '{self.name}'"):
            return read_tree(named_by(scenario, self.file), self.name, np.array(self.root))


def tables() -> dict[str, type[Table]]:
    """The tables of a scenario file by name, in the order of the documentation."""
    return {**PRIMITIVES, "region": Region, "tree": TreeFile}


def library() -> dict[str, Path]:
    """The scenarios that come with the package, by name."""
    folder = Path(str(files("fascicle") / "data" / "scenarios"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def name_in_library(scenario: Scenario) -> str | None:
    """Name in the `library` of a scenario that was read from it; None for any other."""
    return next((name for name, path in library().items() if str(path) == scenario.source), None)


def find_scenario(name: str) -> Path:
    """File of a scenario: that of a name in the `library`, else the path itself.

    InputError if the name, which is no path, is not in the library.
    """
    packaged, path = library(), Path(name)
    if name in packaged:
        return packaged[name]
    if not path.exists() and path.name == name and not path.suffix:
        # keys as `plain_name` simplifies a name
        abbreviations = {
            "lbbb": "left-bundle-branch-block", "rbbb": "right-bundle-branch-block",
            "lafb": "left-anterior-fascicular-block", "lpfb": "left-posterior-fascicular-block",
            "crt": "biventricular-pacing", "biv": "biventricular-pacing",
            "bivp": "biventricular-pacing",
            "bivcrt": "biventricular-pacing", "hbp": "his-pacing", "hisbundlepacing": "his-pacing",
            "nshbp": "his-pacing-nonselective", "lbbp": "left-bundle-branch-pacing",
            "lbbap": "left-bundle-branch-pacing-nonselective",
            "nslbbp": "left-bundle-branch-pacing-nonselective", "lvsp": "left-septal-pacing",
            "hotcrt": "his-optimised-pacing", "lotcrt": "left-bundle-optimised-pacing",
            "rvp": "rv-apical-pacing", "rvpacing": "rv-apical-pacing", "rvap": "rv-apical-pacing",
            "rvsp": "rv-septal-pacing", "rvotpacing": "rv-outflow-pacing", "pvc": "pvc-rv-outflow",
            "sinus": "intrinsic", "sinusrhythm": "intrinsic", "baseline": "intrinsic",
        }  # fmt: skip
        hint = did_you_mean(name, packaged, abbreviations.items())
        raise InputError(
            f"there is no scenario '{name}'; {hint + ' ' if hint else ''}'fascicle scenarios' "
            "lists them; a file of your own ends in .toml"
        )
    return path


def read_scenarios(names: Sequence[str | Path] | str | Path) -> dict[str, Scenario]:
    """Scenarios by name, of the `library` or of files, whose names lose their ending .toml.

    Parameters
    ----------
    names : one or several of str or Path
        Names of the library, and paths of files.

    Raises
    ------
    InputError
        If a scenario does not exist or cannot be read, two have the same name, or one changes the
        heart by regions, without which the population was learnt.
    """
    if isinstance(names, str | Path):
        names = [names]
    check_items(names, (str, Path), "scenarios", "names and paths of files")
    scenarios: dict[str, Scenario] = {}
    for name in names:
        path = find_scenario(str(as_path(name, "scenario")))
        scenario, regions = read_scenario(path)
        if regions:
            raise InputError(
                f"{path}: has regions; put them into the heart (heart.toml) and fit again"
            )
        if path.stem in scenarios:
            raise InputError(f"two scenarios are called '{path.stem}'; give another, or rename one")
        scenarios[path.stem] = scenario
    return scenarios


def read_scenario(path: Path | str) -> tuple[Scenario, tuple[Region, ...]]:
    """Read a scenario, and the regions of the myocardium that conduct otherwise in it.

    Paths of tree files count from the folder of the scenario. InputError if the file is missing or
    not TOML, holds an unknown key or a wrong value, or a tree in it cannot be read.
    """
    path = Path(path)
    check_file(path, (".toml",), "scenario")
    values = read_toml(path, "see 'fascicle docs files'")
    texts = {key: values.pop(key, "") for key in ("description", "reference")}
    try:
        for key, text in texts.items():
            check_text(text, f"'{key}'")
        kinds = tables()
        for key in values:
            if key not in kinds:
                names = ", ".join([*kinds, *texts])
                raise InputError(f"unknown key '{key}'; known: {names}")
        primitives = [
            primitive for kind in PRIMITIVES.values() for primitive in _read(kind, values)
        ]
        regions = tuple(replace(r, source=str(path)) for r in _read(Region, values))
        trees = tuple((tree.read(path), tree.time) for tree in _read(TreeFile, values))
        scenario = Scenario(primitives, trees, str(path), **texts)
    except InputError as error:
        raise InputError(f"{path}: {error}; see 'fascicle docs files'") from None
    return scenario, regions


def _read(kind: type[Kind], values: Mapping[str, Any]) -> Iterator[Kind]:
    """Read the tables of one kind."""
    if kind.table not in values:
        return
    section = values[kind.table]
    if kind.once:
        yield kind.of(section)
    elif isinstance(section, list):
        yield from (kind.of(table, number) for number, table in enumerate(section, 1))
    else:
        raise InputError(f"'{kind.table}' must be in double brackets: {kind.header()}")


def scenario_text(scenario: Scenario, regions: Sequence[Region] = ()) -> str:
    """TOML text from which `read_scenario` restores a scenario and regions of the myocardium.

    InputError if the scenario has additional trees, whose files the text would only name.
    """
    if scenario.trees:
        raise InputError(f"{scenario.source}: has trees of its own, which cannot be kept with it")
    lines = []
    for table in (*scenario.primitives, *regions):
        lines.append(table.header())
        for key in table.key_names():
            value = getattr(table, key)
            if value is not None:
                lines.append(f"{key} = {_written(value)}")
    return "\n".join(lines) + "\n"


def _written(value: Any) -> str:
    """A value of a table in TOML."""
    if isinstance(value, Table):
        keys = (f"{key} = {_written(getattr(value, key))}" for key in value.key_names())
        return "{" + ", ".join(keys) + "}"
    written = repr(list(value) if isinstance(value, tuple) else value)
    # TOML does not read all escapes of Python, but those of JSON
    return json.dumps(value, ensure_ascii=False) if "\\" in written else written
