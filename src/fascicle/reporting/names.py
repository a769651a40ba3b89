"""Names of quantities, indices and measures in figures, tables and sentences."""

from __future__ import annotations

import re
from typing import NamedTuple

from fascicle.core.quantities import SHOWN_UNITS, in_words, parameter_name
from fascicle.forward.scenario_files import library
from fascicle.heart.heart import Heart
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.scenarios import INTRINSIC


class Measure(NamedTuple):
    """A measure of recorded and simulated ECGs."""

    name: str
    unit: str


# By their names in `fascicle.networks.agreement.Agreement`
MEASURES = {
    "qrs_duration_ms": Measure("QRS duration", "ms"),
    "axis_degrees": Measure("frontal axis", "degrees"),
}


def parameter_label(name: str, unit: str) -> str:
    """Name and unit of a quantity of the model, for an axis."""
    return _with_unit(parameter_name(name), SHOWN_UNITS.get(unit, unit))


def index_name(index: str) -> str:
    """Name of an index for readers."""
    return in_words(index).replace("LV RV", "LV-RV").replace(" r ", " R ")


def index_label(index: str) -> str:
    """Name and unit of an index, for an axis or the head of a column."""
    return _with_unit(index_name(index), INDICES[index])


def on_template(heart: Heart) -> str:
    """Note on a map over networks, which is drawn on an atlas's template; else empty."""
    return "" if heart.atlas is None else ", drawn on the template heart of the atlas"


def _with_unit(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} ({unit})"


def scenario_name(name: str) -> str:
    """Name of a scenario for readers: that of the library in words, any other as it is."""
    if name == INTRINSIC:
        return "intrinsic beat"
    return capitals(name.replace("-", " ")) if name in library() else name


def capitals(text: str) -> str:
    """The text with the capitals of names: His, LV, RV, PVC."""
    text = re.sub(r"\bhis\b", "His", text)
    return re.sub(r"\b(lv|rv|pvc)\b", lambda match: match[0].upper(), text)
