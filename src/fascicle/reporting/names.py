"""What quantities, indices and measures are called in figures, tables and words."""

from __future__ import annotations

import re
import textwrap
from typing import NamedTuple

from fascicle.prediction.index_names import INDICES
from fascicle.reporting.fitted_text import KEPT

_PART = re.compile(r"(lv|rv)_(initial|fascicle)_(length|angle)(?:_(\d+))?")
CAPITALS = {"lv": "LV", "rv": "RV", "qrs": "QRS", **{f"v{k}": f"V{k}" for k in range(1, 7)}}
NARROW = 10  # characters of a line on a narrow axis


class Measure(NamedTuple):
    """What is measured in recorded and in simulated ECGs alike.

    Attributes
    ----------
    name, unit : str
    meaning : str
        How it is measured, where there are several ways.
    """

    name: str
    unit: str
    meaning: str = ""

    def __str__(self) -> str:
        """Name, and how it is measured."""
        return f"{self.name} ({self.meaning})" if self.meaning else self.name


# By their names in `fascicle.study.agreement.Agreement`
MEASURES = {
    "qrs_duration_ms": Measure("window QRS duration", "ms", "all leads together"),
    "global_qrs_duration_ms": Measure(
        "global QRS duration", "ms", "outermost leads, as clinics measure it"
    ),
    "axis_degrees": Measure("frontal axis", "degrees"),
}


def parameter_name(name: str) -> str:
    """Name of a quantity of the model as a reader knows it, such as ``LV fascicle 1 length``."""
    match = _PART.fullmatch(name)
    if match is not None:
        side, stretch, what, number = match.groups()
        part = "bundle" if stretch == "initial" else f"fascicle{KEPT}{number}"
        return f"{side.upper()} {part} {what}"
    return {"cv": "tree speed"}.get(name, _words(name))


def index_name(index: str) -> str:
    """Name of an index as a reader knows it."""
    if f"{index}_ms" in MEASURES:
        return MEASURES[f"{index}_ms"].name
    return _words(index).replace("LV RV", "LV-RV")


def index_label(index: str) -> str:
    """Name and unit of an index, for an axis or the head of a column."""
    return with_unit(index_name(index), INDICES[index])


def with_unit(name: str, unit: str) -> str:
    """Name and unit, if it has one."""
    return name if unit == "1" else f"{name} ({unit})"


def on_narrow_axis(label: str) -> str:
    """Break a label into lines."""
    return textwrap.fill(label, NARROW, break_long_words=False)


def _words(name: str) -> str:
    return " ".join(CAPITALS.get(word, word) for word in name.split("_"))
