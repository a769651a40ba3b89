"""Every quantity of the model, declared once.

The rest follows from the declaration: what ``--fix``, ``--free``, ``fascicle parameters``, settings
files and Python accept, the prior of a fit, the defaults of the model, and docs/quantities.md.
docs/extending.md adds one with `declare`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from fascicle.core.conduction_states import BLOCKABLE, CONDUCTION_STATES, ConductionState
from fascicle.core.errors import ValueRefusedError
from fascicle.core.ranges import Range, check_kind, did_you_mean, shown

SIDES = ("lv", "rv")


class Changes(StrEnum):
    """Part to be computed again when a quantity changes, from the most to the least."""

    STUDY = "which parameters there are"
    HEART = "all of it"
    TREES = "trees"
    TISSUE = "speeds of the tissue"
    BLOCKS = "what is blocked"
    TIMES = "times alone"
    SOURCES = "the ECG alone"
    LEAD_FIELDS = "the lead fields"


@dataclass(frozen=True)
class Quantity:
    """Quantity of the model.

    Attributes
    ----------
    name, unit : str
        Name in parameters, files and options; unit of all its values, 1 where it has none.
    default : float, optional
        Value where none is given; None where one must be given, or follows from others.
    valid_range : (float, float)
        Least and largest value that is not a mistake.
    prior_range : (float, float)
        Range of its prior where it is learnt and no other is given.
    meaning : str
        Description in one line.
    changes : Changes
        Part to be computed again when it changes.
    is_integer : bool
        Whether it counts something; such quantities can be fixed only.
    default_prior : (str, float), optional
        Prior where it is learnt and no other is given, if it is not uniform: "normal" or
        "log-normal" about the default, and its standard deviation (of the logarithm).
    also : float, optional
        One more valid value, such as infinity.
    apply : callable, optional
        ``apply(conduction, value)`` gives the `fascicle.Conduction` with the quantity at a value,
        for quantities that are declared outside the package.
    aliases : tuple of str
        Other names, as `fascicle.core.ranges.plain_name` gives them, for which it is suggested.
    choices : tuple of str
        Names of its values 0, 1, ..., which may be given instead.
    """

    name: str
    unit: str
    default: float | None
    valid_range: tuple[float, float]
    prior_range: tuple[float, float]
    meaning: str
    changes: Changes
    is_integer: bool = False
    default_prior: tuple[str, float] | None = None
    also: float | None = None
    apply: Callable[[Any, float], Any] | None = field(default=None, compare=False)
    aliases: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()

    @property
    def valid(self) -> Range:
        """Range of the valid values."""
        unit = "" if self.unit == "1" else self.unit
        return Range(unit, *self.valid_range, self.meaning, self.also)


def _of_trees() -> Iterator[Quantity]:
    """Bundles, fascicles and branches; ranges of table 1 of the paper."""
    trees = Changes.TREES
    most = 4  # fascicles a side
    length, angle = (0.1, 500.0), (-2 * math.pi, 2 * math.pi)
    angles = (-math.pi / 4, 3 * math.pi / 4)
    numbered = [(side, side.upper(), k) for side in SIDES for k in range(1, most + 1)]
    for side in SIDES:
        meaning = f"length of the {side.upper()} bundle"
        yield Quantity(f"{side}_initial_length", "mm", None, length, (30.0, 100.0), meaning, trees)
    for side, title, k in numbered:
        name, meaning = f"{side}_fascicle_length_{k}", f"length of {title} fascicle {k}"
        yield Quantity(name, "mm", None, length, (2.0, 50.0), meaning, trees)
    for side, title, k in numbered:
        meaning = f"angle of {title} fascicle {k} to its bundle, counter-clockwise"
        yield Quantity(f"{side}_fascicle_angle_{k}", "rad", None, angle, angles, meaning, trees)
    for k in range(1, most + 1):
        name = f"lv_fascicle_direction_{k}"
        meaning = f"direction of LV fascicle {k}: 0 apical, π/2 anterior; stands for its angle"
        yield Quantity(name, "rad", None, angle, (-1.6, 1.6), meaning, trees)
    for side in SIDES:
        name, meaning = f"{side}_fascicles", f"number of {side.upper()} fascicles"
        yield Quantity(name, "1", 2, (1, most), (1, most), meaning, Changes.STUDY, is_integer=True)
    yield Quantity(
        "branch_length", "mm", 8.0, (0.5, 100.0), (4.0, 16.0), "length of a branch", trees
    )
    meaning = "angle between a branch and its parent"
    yield Quantity("branch_angle", "rad", 0.15, (0.0, math.pi), (0.05, 0.5), meaning, trees)
    meaning = "weight w of the direction away from the tree"
    yield Quantity("repulsion", "1", 0.1, (0.0, 10.0), (0.0, 0.5), meaning, trees)
    yield Quantity(
        "generations", "1", 20, (0, 100), (5, 30), "how often ends branch", trees, is_integer=True
    )
    yield Quantity(
        "segments", "1", 8, (1, 1000), (4, 16), "segments of a branch", trees, is_integer=True
    )
    meaning = "a branch stops nearer than this many segments to another"
    yield Quantity("clearance", "1", 0.9, (0.0, 10.0), (0.5, 1.5), meaning, trees)


def _of_hearts() -> Iterator[Quantity]:
    """Heart of an atlas, conduction velocities and delays, and the size of the ECG."""
    times, tissue, numbers = Changes.TIMES, Changes.TISSUE, (0, 999)
    yield Quantity(
        "atlas_heart", "1", None, numbers, numbers, "number of the heart, of those of the atlas",
        Changes.HEART, is_integer=True,
    )  # fmt: skip
    meaning = "t_RV - t_LV of the roots; negative, the left one fires later"
    yield Quantity(
        "root_time", "ms", None, (-1000.0, 1000.0), (-75.0, 50.0), meaning, times,
        aliases=("vvdelay", "lvrvdelay", "rvlvdelay"),
    )  # fmt: skip
    meaning = (
        "arrival at the first right junction after that at the first left one; stands for root_time"
    )
    yield Quantity(
        "interventricular_delay", "ms", None, (-1000.0, 1000.0), (-75.0, 60.0), meaning, times,
        aliases=("ivdelay", "interventricularconductiontime"),
    )  # fmt: skip
    yield Quantity(
        "his_time", "ms", 10.0, (0.0, 500.0), (5.0, 40.0),  # docs/files.md says why
        "from the His bundle to the root that fires first; counts where a scenario has the bundle",
        times, aliases=("hv", "hvinterval"),
    )  # fmt: skip
    velocity = ("conductionvelocity", "velocity", "speed")  # ambiguous: of network or myocardium
    yield Quantity(
        "cv", "mm/ms", None, (0.1, 20.0), (2.0, 4.0), "Purkinje conduction velocity", times,
        aliases=("purkinjeconductionvelocity", "purkinjevelocity", "purkinjespeed", *velocity),
    )  # fmt: skip
    meaning = "speed constant of the myocardium: D = alpha² Gi (Gi+Ge)^-1 Ge"
    yield Quantity("alpha", "cm/ms √(cm/mS)", 0.05, (0.005, 0.5), (0.04, 0.12), meaning, times)
    meaning = "speed along the fibre; stands for alpha"
    yield Quantity(
        "fibre_speed", "mm/ms", None, (0.05, 5.0), (0.5, 1.5), meaning, times,
        aliases=("myocardialconductionvelocity", "myocardialvelocity", "tissuevelocity", *velocity),
    )  # fmt: skip
    yield Quantity(
        "anisotropy_ratio", "1", None, (1.0, 10.0), (1.5, 4.0),
        "speed along the fibre over that across; as the conductivities have it (2.5) if not given",
        tissue,
    )  # fmt: skip
    meaning = "thickness of a layer under the endocardium that conducts faster"
    yield Quantity("endocardial_layer", "mm", 0.0, (0.0, 20.0), (0.0, 3.0), meaning, tissue)
    meaning = "factor on the speeds in that layer"
    yield Quantity("endocardial_speed", "1", 1.0, (0.1, 10.0), (1.0, 4.0), meaning, tissue)
    for name, meaning in (
        ("anterograde", "delay of the junctions from tree to myocardium; inf blocks"),
        ("retrograde", "the same, from myocardium to tree"),
    ):
        yield Quantity(
            f"{name}_delay", "ms", 0.0, (0.0, 10_000.0), (0.0, 10.0), meaning, times, also=math.inf,
            aliases=("junctiondelay", "pmjdelay"),
        )  # fmt: skip
    most = (0, len(CONDUCTION_STATES) - 1)
    yield Quantity(
        "conduction", "1", 0, most, most, "conduction state of the bundle branches and fascicles",
        Changes.BLOCKS, is_integer=True, choices=(*CONDUCTION_STATES,),
    )  # fmt: skip
    yield Quantity("gain", "1", 1.0, (1e-3, 1e3), (0.2, 5.0), "factor on the simulated ECG", times)
    meaning = "factor on the sources of the right ventricle's free wall"
    yield Quantity("rv_source", "1", 1.0, (0.01, 10.0), (0.2, 1.2), meaning, Changes.SOURCES)
    meaning = "factor on the sources along the fibre, beyond those of isotropic tissue"
    yield Quantity("axial_source", "1", 1.0, (0.0, 10.0), (0.0, 1.0), meaning, Changes.SOURCES)


def _of_torso() -> Iterator[Quantity]:
    """Changes of the heart folder's torso; docs/quantities.md says where priors are from."""
    torso, angle = Changes.LEAD_FIELDS, math.radians(20.0)

    def moved(name: str, reach: float, sd: float, meaning: str, unit: str = "mm") -> Quantity:
        ends = (-reach, reach)
        return Quantity(name, unit, 0.0, ends, ends, meaning, torso, default_prior=("normal", sd))

    directions = (("left", "to the left"), ("posterior", "posteriorly"), ("up", "upwards"))
    for direction, where in directions:
        yield moved(f"heart_{direction}", 20.0, 8.0, f"the heart's shift {where}")
    for direction, where in directions:
        meaning = f"the heart's rotation about the axis {where}, right-handed"
        yield moved(f"heart_rotation_{direction}", angle, math.radians(8.0), meaning, "rad")
    for k in range(1, 7):
        yield moved(f"v{k}_left", 25.0, 10.0, f"V{k} moved along the skin to the left")
        yield moved(f"v{k}_up", 25.0, 10.0, f"V{k} moved along the skin upwards")
    yield moved("chest_electrodes_up", 40.0, 15.0, "V1 to V6 together moved along the skin upwards")
    for name, tissue in (
        ("lung", "the lungs"),
        ("blood", "the blood"),
        ("myocardium", "the myocardium, as source and conductor; speeds stay"),
        ("body", "what else is around the heart"),
    ):
        yield Quantity(
            f"{name}_conductivity", "1", 1.0, (0.5, 2.0), (0.5, 2.0),
            f"factor on the conductivity of {tissue}", torso, default_prior=("log-normal", 0.25),
        )  # fmt: skip
    yield Quantity(
        "chest_size", "1", 1.0, (0.85, 1.15), (0.85, 1.15),
        "factor on the trunk around the heart, which stays", torso, default_prior=("normal", 0.05),
    )  # fmt: skip


QUANTITIES = {q.name: q for q in (*_of_trees(), *_of_hearts(), *_of_torso())}
TORSO_QUANTITIES = tuple(q.name for q in QUANTITIES.values() if q.changes is Changes.LEAD_FIELDS)
# Names of groups of quantities that can be freed together
GROUPS: dict[str, tuple[str, ...]] = {
    "pose": tuple(n for n in TORSO_QUANTITIES if n.startswith("heart_")),
    "electrodes": tuple(n for n in TORSO_QUANTITIES if n[0] == "v" or n == "chest_electrodes_up"),
    "conductivities": tuple(n for n in TORSO_QUANTITIES if n.endswith("_conductivity")),
}
SPEED = ("alpha", "fibre_speed")  # two names of the myocardium's conduction velocity
DELAY = ("root_time", "interventricular_delay")  # two names of the RV-LV delay


def declare(declared: Quantity) -> None:
    """Add a quantity to the model: parameters, options and settings files may then name it.

    `Quantity.apply` says what it does to the conduction of the tissue; `Quantity.changes` must be
    ``Changes.TIMES`` where that is `alpha` alone, else ``Changes.TISSUE``. Parameters
    of a `fascicle.GrowthTerm` have ``Changes.TREES`` and are declared by that. Raises
    ValueRefusedError if another quantity has this name, or if it changes nothing.
    """
    if QUANTITIES.get(declared.name, declared) != declared or declared.name in GROUPS:
        raise ValueRefusedError(f"parameter '{declared.name}' is taken; choose another name")
    is_applied = declared.apply is not None and declared.changes in (Changes.TIMES, Changes.TISSUE)
    if declared.changes is not Changes.TREES and not is_applied:
        raise ValueRefusedError(
            f"parameter '{declared.name}' changes nothing; give `apply`, and what it changes: "
            "Changes.TIMES or Changes.TISSUE"
        )
    QUANTITIES[declared.name] = declared


def declare_state(state: ConductionState) -> None:
    """Add a conduction state; studies infer its probability if it has a prior probability.

    Raises ValueRefusedError if there is such a state, or it names an unknown quantity or part.
    """
    if state.name in CONDUCTION_STATES:
        raise ValueRefusedError(f"conduction state '{state.name}' is taken; choose another name")
    for part in state.blocked:
        if part not in BLOCKABLE:
            raise ValueRefusedError(f"'{part}' cannot be blocked; give some of {BLOCKABLE}")
    for name in state.ranges:
        quantity(name)
    CONDUCTION_STATES[state.name] = state
    most = (0, len(CONDUCTION_STATES) - 1)
    QUANTITIES["conduction"] = replace(
        QUANTITIES["conduction"], valid_range=most, prior_range=most, choices=(*CONDUCTION_STATES,)
    )


def default_of(name: str) -> float:
    """Default of a quantity that has one."""
    default = QUANTITIES[name].default
    assert default is not None
    return default


def quantity(name: str) -> Quantity:
    """Look a quantity up; ``region_N_conductivity`` exists for every label N."""
    if name in QUANTITIES:
        return QUANTITIES[name]
    if not region_labels([str(name)]):
        aliases = [(alias, q.name) for q in QUANTITIES.values() for alias in q.aliases]
        hint = did_you_mean(str(name), [*QUANTITIES, *GROUPS], aliases)
        hint = hint or "'fascicle parameters' lists what there is"
        raise ValueRefusedError(f"unknown parameter '{name}'; {hint}")
    (label,) = region_labels([name])
    meaning = f"factor on the conductivities of the elements labelled {label}; 0 is scar"
    return Quantity(name, "1", 1.0, (0.0, 1e4), (0.0, 1.0), meaning, Changes.TISSUE)


def stand_ins(name: str) -> set[str]:
    """Other quantities that determine the same property as the named one."""
    angle = {name, name.replace("lv_fascicle_angle", "lv_fascicle_direction")}
    direction = {name, name.replace("lv_fascicle_direction", "lv_fascicle_angle")}
    pairs = ({*SPEED}, {*DELAY}, angle, direction)
    return {other for pair in pairs if name in pair for other in pair} - {name}


def overridden(values: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """Values with changes, which also replace their `stand_ins`."""
    replaced = {other for name in changes for other in stand_ins(name)}
    return {n: value for n, value in values.items() if n not in replaced} | dict(changes)


def check_not_twice(names: Collection[str]) -> None:
    """Refuse two quantities that determine the same thing, such as the myocardium's speed."""
    for name in names:
        for other in sorted(stand_ins(name) & {*names}):
            raise ValueRefusedError(f"parameters '{name}' and '{other}' say the same; give one")


def region_labels(values: Iterable[str]) -> dict[int, str]:
    """Labels of the regions in names like ``region_N_conductivity``, with these names."""
    matches = ((re.fullmatch(r"region_(\d{1,9})_conductivity", name), name) for name in values)
    return {int(match[1]): name for match, name in matches if match is not None}


def fascicle_names(side: str, count: int) -> list[str]:
    """Names of the lengths, then of the angles, of a number of fascicles of a side."""
    return [
        f"{side}_fascicle_{kind}_{k}" for kind in ("length", "angle") for k in range(1, count + 1)
    ]


def fascicles(side: str, names: Iterable[str]) -> int:
    """Count the fascicles of a side by these names: from 1, each a length and an angle.

    A direction may stand for an angle.
    """
    pattern = rf"{side}_fascicle_(?:length|angle|direction)_(\d+)"
    numbers = {name: int(m[1]) for name in names if (m := re.fullmatch(pattern, name))}
    count = max(numbers.values(), default=0)
    present = {name.replace("direction", "angle") for name in numbers}
    missing = sorted({*fascicle_names(side, max(count, 1))} - present)
    if missing:
        raise ValueRefusedError(f"missing parameters {', '.join(missing)}; add them")
    return count


def checked(values: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of Python or NumPy, by the names of quantities, as floats that are possible."""
    check_kind(values, Mapping, "parameters", "a dict of names to numbers")
    return {name: check(quantity(name), value) for name, value in values.items()}


def check(declared: Quantity, value: Any) -> float:
    """Number as a float, if it is possible for this quantity; see `checked`."""
    if declared.choices and isinstance(value, str):
        if value not in declared.choices:
            hint = did_you_mean(value, declared.choices)
            hint = hint or f"give one of {', '.join(declared.choices)}"
            raise ValueRefusedError(f"parameter '{declared.name}' is {shown(value)}; {hint}")
        value = declared.choices.index(value)
    number = declared.valid.check(value, f"parameter '{declared.name}'")
    if declared.is_integer and number != int(number):
        raise ValueRefusedError(
            f"parameter '{declared.name}' is {shown(number)}; give a whole number"
        )
    return number


def torso_values(values: Mapping[str, float]) -> dict[str, float]:
    """Quantities of the torso that differ from the heart folder's torso."""
    named = [n for n in TORSO_QUANTITIES if n in values]
    return {n: values[n] for n in named if values[n] != QUANTITIES[n].default}


SHOWN_UNITS = {"mm/ms": "m/s"}  # for readers, in place of a quantity's own


def parameter_name(name: str) -> str:
    """Name of a quantity of the model for readers, such as ``LV fascicle 1 length``."""
    match = re.fullmatch(r"(lv|rv)_(initial|fascicle)_(length|angle|direction)(?:_(\d+))?", name)
    if match is not None:
        side, stretch, kind, number = match.groups()
        part = "bundle" if stretch == "initial" else f"fascicle\N{NO-BREAK SPACE}{number}"
        return f"{side.upper()} {part} {kind}"
    titles = {
        "cv": "Purkinje conduction velocity",
        "root_time": "delay between the roots",
        "his_time": "time from the His bundle to the first root",
        "alpha": "conduction velocity constant α",
        "fibre_speed": "conduction velocity along fibres",
    }
    return titles.get(name, in_words(name))


def in_words(name: str) -> str:
    """Words of an identifier, with abbreviations in capitals."""
    return re.sub(r"\b(lv|rv|qrs|v\d)\b", lambda m: m[0].upper(), name.replace("_", " "))
