"""`heart.toml`: the names of a heart folder's files, and where the bundles start."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from fascicle.core.errors import InputError
from fascicle.heart.heart import Heart

MANIFEST = "heart.toml"
FORMAT = "fascicle heart 1"


class Seeds(BaseModel):
    """Where one bundle starts and heads for: vertices of its endocardium."""

    model_config = ConfigDict(extra="forbid")
    root: int
    direction: int


class LeadFieldKeys(BaseModel):
    """What the lead fields in the mesh were computed from; see `fascicle.torso.resolve`."""

    model_config = ConfigDict(extra="forbid")
    heart: str
    torso: str


class Manifest(BaseModel):
    """Contents of `heart.toml`; file names are relative to the folder."""

    model_config = ConfigDict(extra="forbid")
    format: Literal["fascicle heart 1"]
    name: str
    units: Literal["mm"]
    mesh: str
    lv_endocardium: str
    rv_endocardium: str
    electrodes: str
    torso: str | None = None
    lead_fields: LeadFieldKeys | None = None
    lv: Seeds
    rv: Seeds


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a heart folder.

    Raises
    ------
    InputError
        If there is none, or it is not valid.
    """
    path = folder / MANIFEST
    if not folder.exists():
        raise InputError(f"{folder}: no such heart folder; make one with 'fascicle heart build'")
    if not path.is_file():
        raise InputError(
            f"{folder}: not a heart folder (no {MANIFEST}); make one with 'fascicle heart build'"
        )
    try:
        return Manifest.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{path}: '{key}': {first['msg']}; correct it or import the heart again"
        ) from None
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, of a number too long
        raise InputError(f"{path}: not valid TOML ({error}); import the heart again") from None


def manifest_text(heart: Heart, files: dict[str, str]) -> str:
    """Text of the manifest of a heart whose parts are in these files."""
    lines = [f'format = "{FORMAT}"', f"name = {_toml_string(heart.name)}", 'units = "mm"']
    lines += [f'{part} = "{file}"' for part, file in files.items()]
    if heart.lead_fields is not None:
        keys = f'heart = "{heart.lead_fields.key}", torso = "{heart.lead_fields.torso}"'
        lines.append(f"lead_fields = {{ {keys} }}")
    for endocardium in heart.endocardia:
        lines += [
            "",
            f"[{endocardium.side}]  # points of the endocardium",
            f"root = {endocardium.root}",
            f"direction = {endocardium.direction}",
        ]
    return "\n".join(lines) + "\n"


def _toml_string(text: str) -> str:
    """TOML string of a name; what cannot be UTF-8 (odd bytes in a path) becomes '?'."""
    readable = text.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(readable, ensure_ascii=False).replace("\x7f", "\\u007f")
