"""Every quantity of the model in one table: unit, default, ranges and meaning.

Every number that enters is checked against it once (`checked`), from a file, an option or Python.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from fascicle.core.errors import InputError
from fascicle.core.ranges import check_kind, digits, number

SIDES = ("lv", "rv")
MOST_FASCICLES = 4  # a side
HIS_TIME = 10.0  # ms; docs/files.md says why
USUAL_FASCICLES = 2  # a side, in the paper
_REGION = re.compile(r"region_(\d{1,9})_conductivity")
_FASCICLE = re.compile(r"(lv|rv)_fascicle_(length|angle)_(\d+)")


class Changes(StrEnum):
    """What must be computed again when a quantity changes, from the most to the least."""

    STUDY = "which parameters there are"
    TREES = "trees"
    TISSUE = "speeds of the tissue"
    TIMES = "times alone"
    BODY = "the lead fields"


@dataclass(frozen=True)
class Quantity:
    """One quantity of the model.

    Attributes
    ----------
    name, unit : str
        Name in parameters, files and options; unit of all its values, 1 where it has none.
    default : float
        Its value where nothing else is said; None where it must be said, or follows from others.
    valid_range : (float, float)
        Least and largest value that is not a mistake; those of `INFINITE` may be that, too.
    prior_range : (float, float)
        Range of its uniform prior where it is learnt and nothing else is said.
    meaning : str
        What it is, in a line.
    changes : Changes
        What depends on it.
    is_integer : bool
        Whether it counts something; such quantities can be fixed only.
    default_prior : (str, float), optional
        Prior where it is learnt and nothing else is said, if it is not uniform: "normal" or
        "log-normal" about the default, and its standard deviation (of the logarithm).
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


def _of_trees() -> Iterator[Quantity]:
    """Bundles, fascicles and branches; ranges of table 1 of the paper."""
    trees = Changes.TREES
    length, angle = (0.1, 500.0), (-2 * math.pi, 2 * math.pi)
    for side in SIDES:
        yield Quantity(
            f"{side}_initial_length", "mm", None, length, (30.0, 100.0),
            f"length of the {side.upper()} bundle", trees,
        )  # fmt: skip
    for side in SIDES:
        for k in range(1, MOST_FASCICLES + 1):
            yield Quantity(
                f"{side}_fascicle_length_{k}", "mm", None, length, (2.0, 50.0),
                f"length of {side.upper()} fascicle {k}", trees,
            )  # fmt: skip
    for side in SIDES:
        for k in range(1, MOST_FASCICLES + 1):
            yield Quantity(
                f"{side}_fascicle_angle_{k}", "rad", None, angle,
                (-math.pi / 4, 3 * math.pi / 4),
                f"angle of {side.upper()} fascicle {k} to its bundle, counter-clockwise", trees,
            )  # fmt: skip
    for side in SIDES:
        yield Quantity(
            f"{side}_fascicles", "1", USUAL_FASCICLES, (1, MOST_FASCICLES), (1, MOST_FASCICLES),
            f"number of {side.upper()} fascicles", Changes.STUDY, is_integer=True,
        )  # fmt: skip
    yield Quantity(
        "branch_length", "mm", 8.0, (0.5, 100.0), (4.0, 16.0), "length of a branch", trees
    )
    yield Quantity(
        "branch_angle", "rad", 0.15, (0.0, math.pi), (0.05, 0.5),
        "angle between a branch and its parent", trees,
    )  # fmt: skip
    yield Quantity(
        "repulsion", "1", 0.1, (0.0, 10.0), (0.0, 0.5),
        "weight w of the direction away from the tree", trees,
    )  # fmt: skip
    yield Quantity(
        "generations", "1", 20, (0, 100), (5, 30), "how often ends branch", trees, is_integer=True
    )
    yield Quantity(
        "segments", "1", 8, (1, 1000), (4, 16), "segments of a branch", trees, is_integer=True
    )
    yield Quantity(
        "clearance", "1", 0.9, (0.0, 10.0), (0.5, 1.5),
        "a branch stops nearer than this many segments to another", trees,
    )  # fmt: skip


def _of_conduction() -> Iterator[Quantity]:
    """Speeds and delays, and the size of the ECG."""
    times, tissue = Changes.TIMES, Changes.TISSUE
    yield Quantity(
        "root_time", "ms", None, (-1000.0, 1000.0), (-75.0, 50.0),
        "t_RV - t_LV of the roots; negative, the left one fires later", times,
    )  # fmt: skip
    yield Quantity(
        "his_time", "ms", HIS_TIME, (0.0, 500.0), (5.0, 40.0),
        "from the His bundle to the root that fires first; counts where a scenario has the bundle",
        times,
    )  # fmt: skip
    yield Quantity(
        "cv", "mm/ms", None, (0.1, 20.0), (2.0, 4.0), "Purkinje conduction velocity", times
    )
    yield Quantity(
        "alpha", "cm/ms √(cm/mS)", 0.05, (0.005, 0.5), (0.04, 0.12),
        "speed constant of the myocardium: D = alpha² Gi (Gi+Ge)^-1 Ge", times,
    )  # fmt: skip
    yield Quantity(
        "fibre_speed", "mm/ms", None, (0.05, 5.0), (0.5, 1.5),
        "speed along the fibre; stands for alpha", times,
    )  # fmt: skip
    yield Quantity(
        "anisotropy_ratio", "1", None, (1.0, 10.0), (1.5, 4.0),
        "speed along the fibre over that across; as the conductivities have it (2.5) if not given",
        tissue,
    )  # fmt: skip
    yield Quantity(
        "endocardial_layer", "mm", 0.0, (0.0, 20.0), (0.0, 3.0),
        "thickness of a layer under the endocardium that conducts faster", tissue,
    )  # fmt: skip
    yield Quantity(
        "endocardial_speed", "1", 1.0, (0.1, 10.0), (1.0, 4.0),
        "factor on the speeds in that layer", tissue,
    )  # fmt: skip
    yield Quantity(
        "anterograde_delay", "ms", 0.0, (0.0, 10_000.0), (0.0, 10.0),
        "delay of the junctions from tree to myocardium; inf blocks", times,
    )  # fmt: skip
    yield Quantity(
        "retrograde_delay", "ms", 0.0, (0.0, 10_000.0), (0.0, 10.0),
        "the same, from myocardium to tree", times,
    )  # fmt: skip
    yield Quantity("gain", "1", 1.0, (1e-3, 1e3), (0.2, 5.0), "factor on the simulated ECG", times)


def _of_body() -> Iterator[Quantity]:
    """What differs from the heart folder's torso; docs/quantities.md says where priors are from."""
    body, angle = Changes.BODY, math.radians(20.0)

    def moved(name: str, reach: float, sd: float, meaning: str, unit: str = "mm") -> Quantity:
        ends = (-reach, reach)
        return Quantity(name, unit, 0.0, ends, ends, meaning, body, default_prior=("normal", sd))

    for way, where in (("left", "to the left"), ("back", "to the back"), ("up", "up")):
        yield moved(f"heart_{way}", 20.0, 8.0, f"the heart's displacement {where}")
    for way, where in (("left", "to the left"), ("back", "to the back"), ("up", "upwards")):
        yield moved(
            f"heart_turn_{way}", angle, math.radians(8.0),
            f"the heart's rotation about the axis {where}, right-handed", "rad",
        )  # fmt: skip
    for k in range(1, 7):
        yield moved(f"v{k}_left", 25.0, 10.0, f"V{k} moved along the skin to the left")
        yield moved(f"v{k}_up", 25.0, 10.0, f"V{k} moved along the skin upwards")
    yield moved("chest_electrodes_up", 40.0, 15.0, "V1 to V6 together moved along the skin upwards")
    for name, what in (
        ("lung", "the lungs"),
        ("blood", "the blood"),
        ("myocardium", "the myocardium, as source and conductor; speeds stay"),
        ("body", "what else is around the heart"),
    ):
        yield Quantity(
            f"{name}_conductivity", "1", 1.0, (0.5, 2.0), (0.5, 2.0),
            f"factor on the conductivity of {what}", body, default_prior=("log-normal", 0.25),
        )  # fmt: skip
    yield Quantity(
        "chest_size", "1", 1.0, (0.85, 1.15), (0.85, 1.15),
        "factor on the trunk about the heart, which stays", body, default_prior=("normal", 0.05),
    )  # fmt: skip


QUANTITIES: dict[str, Quantity] = {
    q.name: q for q in (*_of_trees(), *_of_conduction(), *_of_body())
}
# Names that stand for several quantities where these are freed
GROUPS: dict[str, tuple[str, ...]] = {
    "pose": tuple(n for n in QUANTITIES if n.startswith("heart_")),
    "electrodes": (
        *(n for n in QUANTITIES if n[0] == "v" and n[1].isdigit()),
        "chest_electrodes_up",
    ),
    "conductivities": tuple(
        f"{tissue}_conductivity" for tissue in ("lung", "blood", "myocardium", "body")
    ),
}
BODY = tuple(q.name for q in QUANTITIES.values() if q.changes is Changes.BODY)
SPEED = ("alpha", "fibre_speed")  # of the myocardium: two names for one thing
INFINITE = ("anterograde_delay", "retrograde_delay")


def quantity(name: str) -> Quantity:
    """Look a quantity up; ``region_N_conductivity`` is there for every label N.

    Raises
    ------
    InputError
        If there is none of this name.
    """
    if name in QUANTITIES:
        return QUANTITIES[name]
    match = _REGION.fullmatch(str(name))
    if match is None:
        near = difflib.get_close_matches(str(name), [*QUANTITIES, *GROUPS], n=1)
        hint = f"did you mean '{near[0]}'?" if near else "'fascicle parameters' lists what there is"
        raise InputError(f"unknown parameter '{name}'; {hint}")
    return Quantity(
        name, "1", 1.0, (0.0, 1e4), (0.0, 1.0),
        f"factor on the conductivities of the elements labelled {int(match[1])}; 0 is scar",
        Changes.TISSUE,
    )  # fmt: skip


def check_one_speed(names: Collection[str]) -> None:
    """Refuse quantities that say the speed of the myocardium twice."""
    if all(name in names for name in SPEED):
        raise InputError("parameters 'alpha' and 'fibre_speed' say the same; give one")


def region_labels(values: Iterable[str]) -> dict[int, str]:
    """Labels of the regions that quantities of these names are about, with the names."""
    matches = ((name, _REGION.fullmatch(name)) for name in values)
    return {int(match[1]): name for name, match in matches if match is not None}


def fascicle_names(side: str, count: int) -> list[str]:
    """Names of the lengths, then of the angles, of so many fascicles of a side."""
    return [
        f"{side}_fascicle_{what}_{k}" for what in ("length", "angle") for k in range(1, count + 1)
    ]


def fascicles(side: str, names: Iterable[str]) -> int:
    """How many fascicles of a side have parameters of these names.

    Raises
    ------
    InputError
        Unless they are numbered 1, 2, … and each has a length and an angle.
    """
    found = [match for name in names if (match := _FASCICLE.fullmatch(name)) and match[1] == side]
    count = max((int(match[3]) for match in found), default=0)
    wanted = set(fascicle_names(side, count))
    missing = sorted(wanted - {match[0] for match in found})
    if missing or not count:
        listed = ", ".join(missing) or f"{side}_fascicle_length_1, {side}_fascicle_angle_1"
        raise InputError(f"missing parameters {listed}; add them")
    return count


def checked(values: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of quantities as floats, each within what is possible.

    Parameters
    ----------
    values : mapping of name to number
        Python's or NumPy's numbers, in the units of `QUANTITIES`.

    Raises
    ------
    InputError
        With the name, the value and the range, of the first that is unknown, no number, not finite
        or impossible.
    """
    check_kind(values, Mapping, "parameters", "a dict of names to numbers")
    return {name: check(quantity(name), value) for name, value in values.items()}


def check(known: Quantity, value: Any) -> float:
    """One number as a float, if it is possible for this quantity; see `checked`."""
    name, unit = known.name, "" if known.unit == "1" else f" {known.unit}"
    found = number(value, f"parameter '{name}'")
    low, high = known.valid_range
    if not low <= found <= high and not (found == math.inf and name in INFINITE):
        other = ", or inf" if name in INFINITE else ""
        raise InputError(
            f"parameter '{name}' is {digits(found)}{unit}; give {digits(low)} to "
            f"{digits(high)}{unit}{other}"
        )
    if known.is_integer and found != int(found):
        raise InputError(f"parameter '{name}' is {found:.4g}; give a whole number")
    return found


def body_values(values: Mapping[str, float]) -> dict[str, float]:
    """Those of the body that are not as in the heart folder's torso."""
    return {
        name: values[name]
        for name in BODY
        if name in values and values[name] != QUANTITIES[name].default
    }
