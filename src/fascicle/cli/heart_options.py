"""Options of the commands that make hearts, and how their text is read."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer.models import OptionInfo

from fascicle.core.errors import InputError

if TYPE_CHECKING:
    from fascicle.heart.endocardium import ChosenSeed
    from fascicle.heart.fibres import FibreAngles

ANATOMY, FIBRES, BODY, BUNDLES = "Anatomy", "Fibres", "Torso and electrodes", "Bundles"
STEEPEST = 90.0  # degrees


def _option(panel: str, text: str | None = None) -> OptionInfo:
    """Describe an option in one of the panels of ``--help``."""
    option: OptionInfo = typer.Option(help=text, rich_help_panel=panel)
    return option


AnatomyArgument = Annotated[
    Path | None,
    typer.Argument(
        help="Closed surface (VTP, VTK, STL, OBJ, PLY), segmentation (NIfTI, NRRD) or "
        "tetrahedra (VTU, VTK, Gmsh, openCARP .pts)."
    ),
]
NamedOutOption = Annotated[
    Path | None, typer.Option("--out", help="Folder to write; without it, named as the file.")
]
EdgeLengthOption = Annotated[float, typer.Option(help="Mean edge of the mesh (mm).")]
LabelsOption = Annotated[
    str | None,
    _option(
        ANATOMY,
        "Numbers in the file, as base=1,epicardium=2,lv=3,rv=4 (surfaces) or "
        "lv=1,rv=2,myocardium=3,scar=4 (segmentations).",
    ),
]
LabelArrayOption = Annotated[
    str | None,
    _option(
        ANATOMY,
        "Name of the file's array that holds them; without it 'label', 'class', 'surface' or "
        "'boundary' is looked for.",
    ),
]
LabelsFileOption = Annotated[Path | None, _option(ANATOMY, "Labels of an STL: one number a line.")]
FirstPartOption = Annotated[
    Path | None,
    _option(ANATOMY, "Separate surfaces instead of one file; they need not meet exactly."),
]
PartOption = Annotated[Path | None, _option(ANATOMY)]
BaseOption = Annotated[Path | None, _option(ANATOMY, "May be left out: it is made.")]
LvAnglesOption = Annotated[str, _option(FIBRES, "Helix angles, endocardium,epicardium (degrees).")]
RvAnglesOption = Annotated[str, _option(FIBRES)]
TorsoOption = Annotated[
    str,
    _option(BODY, "'idealised', 'none' (unbounded conductor), or a closed surface of the skin."),
]
LungOption = Annotated[
    list[Path] | None, _option(BODY, "Closed surface of a lung, with --torso FILE.")
]
RemeshOption = Annotated[
    bool,
    _option(
        ANATOMY,
        "Mesh the inside of a tetrahedral mesh again, for one with flat elements; its surface, "
        "fibres and regions stay.",
    ),
]
HeightOption = Annotated[float | None, _option(BODY, "Of the person (m).")]
WeightOption = Annotated[float | None, _option(BODY, "kg.")]
ChestOption = Annotated[float | None, _option(BODY, "Circumference (cm).")]
PoseOption = Annotated[
    Literal["standard", "ras", "lps"],
    _option(
        BODY,
        "How the heart lies in the idealised torso: 'standard' by its electrodes, or without "
        "them by its axes; 'ras' (NIfTI) or 'lps' (DICOM) where its coordinates are the "
        "patient's.",
    ),
]
ElectrodesOption = Annotated[
    Path | None,
    _option(
        BODY,
        "Nine electrodes, CSV name,x,y,z or JSON, which the idealised torso is fitted to; "
        "without it, at its standard places.",
    ),
]
SeedOption = Annotated[
    str | None, _option(BUNDLES, "Point of the endocardium: its number, from 0, or x,y,z in mm.")
]


def label_numbers(labels: str | None) -> dict[str, int] | None:
    """Read 'lv=3,rv=4' as names and numbers."""
    if labels is None:
        return None
    numbers: dict[str, int] = {}
    for item in labels.split(","):
        name, _, number = item.partition("=")
        name = name.strip().lower()
        if name in numbers:
            raise InputError(f"--labels {labels}: '{name}' is there twice; give one number each")
        try:
            numbers[name] = int(number)
        except ValueError:
            raise InputError(
                f"--labels {labels}: '{item}' is not a name and a number; write lv=3,rv=4"
            ) from None
    return numbers


def fibre_angles(lv: str, rv: str) -> FibreAngles:
    """Read helix angles as '60,-60' (degrees), endocardium and epicardium."""
    from fascicle.heart.fibres import FibreAngles

    angles: list[float] = []
    for option, text in (("--lv-angles", lv), ("--rv-angles", rv)):
        values = _floats(text)
        if values is None or len(values) != 2 or max(map(abs, values)) > STEEPEST:
            raise InputError(
                f"{option} {text}: give two angles between -{STEEPEST:g} and {STEEPEST:g} degrees, "
                "endocardium,epicardium"
            )
        angles += map(math.radians, values)
    return FibreAngles(*angles)


def known(**given: float | None) -> dict[str, float]:
    """Measures of the person that are given."""
    return {name: value for name, value in given.items() if value is not None}


def seeds_of(
    lv_root: str | None, lv_direction: str | None, rv_root: str | None, rv_direction: str | None
) -> dict[str, tuple[ChosenSeed, ChosenSeed]]:
    """Root and direction of each side's bundle, as the options give them.

    Parameters
    ----------
    lv_root, lv_direction, rv_root, rv_direction : str, optional
        The number of a point, or three coordinates (mm).
    """
    return {
        "lv": (_seed("--lv-root", lv_root), _seed("--lv-direction", lv_direction)),
        "rv": (_seed("--rv-root", rv_root), _seed("--rv-direction", rv_direction)),
    }


def _seed(option: str, text: str | None) -> ChosenSeed:
    if text is None:
        return None
    if re.fullmatch(r"\s*-?\d+\s*", text):
        return int(text)
    values = _floats(text)
    if values is None or len(values) != 3:
        raise InputError(
            f"{option} {text}: give the number of a point of the endocardium, from 0, or its "
            "position x,y,z (mm)"
        )
    return values[0], values[1], values[2]


def _floats(text: str) -> list[float] | None:
    """Finite numbers between commas, or None where they are not."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        return None
    return values if all(map(math.isfinite, values)) else None
