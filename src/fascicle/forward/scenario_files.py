"""Scenario files: TOML with stimuli, His bundle, slow segments, delays, regions, extra trees."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError

from fascicle.core.errors import InputError
from fascicle.core.files import as_path, check_file, named_by, read_toml
from fascicle.core.quantities import check, quantity
from fascicle.core.ranges import RANGES, check_items, shown
from fascicle.forward.scenario import His, Scenario, Slowing, Stimulus
from fascicle.heart.conduction import Region
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import read_tree

FURTHEST_ROOT = 5.0  # mm; a root further from the free ends of its tree is a mistake


def _within(name: str) -> AfterValidator:
    """Check a number against its range, whose message `NEEDED` has."""

    def possible(value: float) -> float:
        if value not in RANGES[name]:
            raise ValueError
        return value

    return AfterValidator(possible)


def _delay_or_block(value: float) -> float:
    try:
        return check(quantity("anterograde_delay"), value)
    except InputError:  # `NEEDED` says it
        raise ValueError from None


Number = Annotated[float, Strict()]
Coordinate = Annotated[Number, _within("coordinate")]
Point = tuple[Coordinate, Coordinate, Coordinate]
Time = Annotated[Number, _within("time")]
Radius = Annotated[Number, _within("radius")]
CaptureRadius = Annotated[Number, _within("capture radius")]
SpeedFactor = Annotated[Number, _within("speed factor")]
ConductivityFactor = Annotated[Number, _within("conductivity factor")]
Delay = Annotated[Number, AfterValidator(_delay_or_block)]
TimeOrNever = Annotated[Number, _within("firing time")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]  # files are named after it

POINT = f"a point [x, y, z], each {RANGES['coordinate']}"
TIME = f"a number from {RANGES['time']}"
DELAY = "a number from 0 to {:g} ms, or inf (block)".format(
    quantity("anterograde_delay").valid_range[1]
)
FACTOR = f"a factor: {RANGES['speed factor']} (block)"
NEEDED = {
    "time": TIME,
    "position": POINT,
    "centre": POINT,
    "root": POINT,
    "radius": f"a number from {RANGES['radius']}",
    "tree": "the name of a tree, in quotes",
    "site": "the name of a site, in quotes, such as 'rv apex'",
    "part": "'bundle', 'fascicle 1', 'fascicle 2', …",
    "speed": FACTOR,
    "conductivity": f"a factor: {RANGES['conductivity factor']} (scar)",
    "label": "a whole number",
    "name": "made of letters, digits, '-' and '_'",
    "file": "a path in quotes",
    "anterograde": DELAY,
    "retrograde": DELAY,
    "silent": "a list of names of trees, such as ['lv']",
    "delay": "one table: [delay]",
    "his": "one table: [his]",
    "description": "a text in quotes",
    "reference": "a text in quotes",
    "root_time": TIME,
    "left": FACTOR,
    "right": FACTOR,
}
# what a key must be in one table, where it differs
NEEDED_IN = {
    ("his", "time"): f"a number from {RANGES['firing time']} (it does not fire)",
    ("stimulus", "radius"): f"a number from {RANGES['capture radius']}",
}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Stimulus(_Table):
    time: Time
    position: Point | None = None
    tree: str | None = None
    site: str | None = None
    radius: CaptureRadius = 0.0
    part: str | None = None


class _Slowing(_Table):
    tree: str
    speed: SpeedFactor
    part: str | None = None
    centre: Point | None = None
    radius: Radius | None = None


class _Region(_Table):
    conductivity: ConductivityFactor
    label: Annotated[int, Strict()] | None = None
    centre: Point | None = None
    radius: Radius | None = None


class _Tree(_Table):
    name: Name
    file: Path
    time: Time
    root: Point


class _Delay(_Table):
    model_config = ConfigDict(allow_inf_nan=True)  # inf blocks
    anterograde: Delay | None = None
    retrograde: Delay | None = None


class _His(_Table):
    model_config = ConfigDict(allow_inf_nan=True)  # inf: it does not fire
    time: TimeOrNever | None = None
    root_time: Time | None = None
    left: SpeedFactor = 1.0
    right: SpeedFactor = 1.0


class _File(_Table):
    stimulus: list[_Stimulus] = []
    slowing: list[_Slowing] = []
    region: list[_Region] = []
    tree: list[_Tree] = []
    silent: list[str] = []
    delay: _Delay = _Delay()
    his: _His | None = None
    description: str = ""
    reference: str = ""


TABLES: dict[str, type[_Table]] = {
    "stimulus": _Stimulus,
    "slowing": _Slowing,
    "region": _Region,
    "tree": _Tree,
    "delay": _Delay,
    "his": _His,
}
ONCE = ("delay", "his")  # tables in single brackets


def library() -> dict[str, Path]:
    """The scenarios that come with the package, by name."""
    folder = Path(str(files("fascicle") / "data" / "scenarios"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def name_in_library(scenario: Scenario) -> str | None:
    """What the `library` calls a scenario that was read from it; None of any other."""
    return next((name for name, path in library().items() if str(path) == scenario.source), None)


def find_scenario(name: str) -> Path:
    """The file of a scenario of the `library`, or of one's own.

    Raises
    ------
    InputError
        If it is neither.
    """
    known = library()
    if name in known:
        return known[name]
    if not Path(name).exists() and not name.endswith(".toml"):
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise InputError(
            f"there is no scenario '{name}'; did you mean '{near}'? 'fascicle scenarios' lists "
            "them; a file of your own ends in .toml"
        )
    return Path(name)


def read_scenarios(names: Sequence[str | Path] | str | Path) -> dict[str, Scenario]:
    """Scenarios by name, of the `library` or of files, which are called as they are without .toml.

    Parameters
    ----------
    names : one or several of str or Path
        Names of the library, and paths of files.

    Raises
    ------
    InputError
        If one is not there or cannot be read, two have the same name, or one changes the heart by
        regions, which a population that was learnt without them cannot have.
    """
    if isinstance(names, str | Path):
        names = [names]
    check_items(names, (str, Path), "scenarios", "names and paths of files")
    found: dict[str, Scenario] = {}
    for name in names:
        path = find_scenario(str(as_path(name, "scenario")))
        scenario, regions = read_scenario(path)
        if regions:
            raise InputError(
                f"{path}: has regions; put them into the heart (heart.toml) and fit again"
            )
        if path.stem in found:
            raise InputError(f"two scenarios are called '{path.stem}'; give another, or rename one")
        found[path.stem] = scenario
    return found


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
    values = read_toml(path, "see docs/files.md")
    try:
        content = _File.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {_complaint(error, values)}; see docs/files.md") from None
    try:
        scenario = Scenario(
            stimuli=tuple(
                Stimulus(**table.model_dump(exclude_none=True)) for table in content.stimulus
            ),
            slowings=tuple(Slowing(**dict(s)) for s in content.slowing),
            silent=tuple(content.silent),
            anterograde_delay=content.delay.anterograde,
            retrograde_delay=content.delay.retrograde,
            trees=tuple((_read_tree(tree, path), tree.time) for tree in content.tree),
            his=His(**dict(content.his)) if content.his is not None else None,
            source=str(path),
            description=content.description,
            reference=content.reference,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}; see docs/files.md") from None
    regions = (Region(**dict(region), source=str(path)) for region in content.region)
    return scenario, tuple(regions)


def scenario_text(scenario: Scenario) -> str:
    """The TOML of which `read_scenario` makes a scenario.

    Raises
    ------
    InputError
        If it has trees of its own, which are files that it only names.
    """
    if scenario.trees:
        raise InputError(f"{scenario.source}: has trees of its own, which cannot be kept with it")
    lines = [f"silent = {list(scenario.silent)!r}"]
    for name, delay in (
        ("anterograde", scenario.anterograde_delay),
        ("retrograde", scenario.retrograde_delay),
    ):
        if delay is not None:
            lines.append(f"delay.{name} = {delay!r}")
    for key, value in vars(scenario.his).items() if scenario.his is not None else ():
        if value is not None:
            lines.append(f"his.{key} = {value!r}")
    for table, items in (("stimulus", scenario.stimuli), ("slowing", scenario.slowings)):
        for item in items:
            lines.append(f"\n[[{table}]]")
            for key, value in vars(item).items():
                if value is not None:
                    written = [float(x) for x in value] if isinstance(value, tuple) else value
                    lines.append(f"{key} = {written!r}")
    return "\n".join(lines) + "\n"


def _read_tree(table: _Tree, scenario: Path) -> PurkinjeTree:
    root = np.array(table.root)
    tree = read_tree(named_by(scenario, str(table.file)), table.name, root)
    distance = float(np.linalg.norm(tree.nodes[tree.root] - root))
    if distance > FURTHEST_ROOT:
        raise InputError(
            f"tree '{table.name}': 'root' is {list(table.root)}, {distance:.1f} mm from the "
            f"nearest free end in {table.file}; give the position of the end that fires (mm)"
        )
    return tree


def _complaint(error: ValidationError, values: dict[str, Any]) -> str:
    """Name the table, counted from 1, which key, the value found and what is needed."""
    errors = error.errors(include_url=False)
    unknown = [e for e in errors if e["type"] == "extra_forbidden"]  # it explains what is missing
    first = (unknown + errors)[0]
    location = first["loc"]
    *tables, key = (step for step in location if isinstance(step, str))
    number = next((step for step in location if isinstance(step, int)), None)
    where, known, found = "", _File.model_fields, values
    if tables:
        table = tables[0]
        where, known, found = f"{table}: ", TABLES[table].model_fields, values[table]
        if number is not None:
            where, found = f"{table} {number + 1}: ", values[table][number]
    if first["type"] == "extra_forbidden":
        return f"{where}unknown key '{key}'; known: {', '.join(known)}"
    needed = NEEDED_IN.get((tables[0] if tables else "", key), NEEDED.get(key))
    if not tables and key in TABLES and key not in ONCE:
        needed = None
    needed = needed if needed is not None else f"in double brackets: [[{key}]]"
    if key not in found:
        return f"{where}'{key}' is missing; it must be {needed}"
    return f"{where}'{key}' is {shown(found[key])}; it must be {needed}"
