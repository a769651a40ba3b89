"""Electrode positions as CSV (name,x,y,z) or JSON ({"RA": [x, y, z], …}), in mm."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from pathlib import Path

import igl
import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import check_file, write_text
from fascicle.core.leads import (
    ELECTRODES,
    FRANK,
    FRANK_ELECTRODES,
    LEADS,
    POSTERIOR_LEADS,
    RIGHT_LEADS,
)
from fascicle.core.ranges import check_position, shown
from fascicle.heart.heart import Heart
from fascicle.mesh.checks import check_units

Electrodes = dict[str, Floats]  # positions (3,) by name, mm


def read_electrodes(path: Path | str) -> tuple[Floats, Electrodes]:
    """Read electrodes (mm): positions (9, 3) of `fascicle.core.leads.ELECTRODES`, then others.

    Names of the IEC (R, L, F, C1 to C6) are read, too. Any other name is an additional electrode,
    except RL or N (the right leg, grounded), which is in no lead and left out; Frank's seven are
    given all or none. An error if the file is missing, a pickle or unreadable, or an electrode is
    missing, misnamed or not at a finite position.
    """
    path = Path(path)
    check_file(path, (".csv", ".json"), "electrodes")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; give electrodes as CSV or JSON") from None
    rows = _rows_of_json(path, text) if path.suffix.lower() == ".json" else _rows_of_csv(path, text)
    canonical = {
        name.upper(): name
        for name in (*ELECTRODES, *FRANK_ELECTRODES, *POSTERIOR_LEADS, *RIGHT_LEADS)
    }
    names = {name.strip().upper() for name, _ in rows}
    if "R" in names and "RA" not in names:  # names of IEC 60601-2-25; Frank's F is the same foot
        canonical |= {"R": "RA", "L": "LA", "F": "LL", "N": "RL"}
        canonical |= {f"C{number}": f"V{number}" for number in range(1, 7)}
    of_leads = {name.upper() for name in (*LEADS[:6], *FRANK)} - set(FRANK_ELECTRODES)
    positions: dict[str, list[float]] = {}
    for name, values in rows:
        electrode = canonical.get(name.strip().upper(), name.strip())
        if electrode.upper() == "RL":
            continue
        if electrode.upper() in of_leads or not re.fullmatch(r"[\w.+ -]{1,24}", electrode):
            raise InputError(
                f"{path}: {electrode[:40]!r} is not a name of an electrode; the nine are "
                f"{', '.join(ELECTRODES)}, others have up to 24 letters and digits, and no lead's "
                "name"
            )
        if electrode.upper() in map(str.upper, positions):
            raise InputError(f"{path}: electrode {electrode} is given twice; keep one")
        positions[electrode] = _position(path, electrode, values)
    if missing := [name for name in ELECTRODES if name not in positions]:
        raise InputError(f"{path}: electrodes missing: {', '.join(missing)}; add their positions")
    missing = [name for name in FRANK_ELECTRODES if name not in positions]
    if 0 < len(missing) < len(FRANK_ELECTRODES):
        raise InputError(
            f"{path}: of Frank's electrodes ({', '.join(FRANK_ELECTRODES)}) {', '.join(missing)} "
            "are missing; add their positions, or give electrodes that are not Frank's other names"
        )
    more = {n: np.array(at) for n, at in positions.items() if n not in ELECTRODES}
    return np.array([positions[name] for name in ELECTRODES]), more


def _rows_of_csv(path: Path, text: str) -> list[tuple[str, list[object]]]:
    # strict, so that a quote that is never closed does not swallow the rest
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True, strict=True)
    try:
        header = [(name or "").strip().lower() for name in reader.fieldnames or []]
        if not {"name", "x", "y", "z"} <= set(header):
            raise InputError(
                f"{path}: the first line is '{','.join(header)[:60]}'; it must be name,x,y,z"
            )
        reader.fieldnames = header
        return [(row["name"] or "", [row["x"], row["y"], row["z"]]) for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}: not a readable CSV table ({error}); correct it") from None


def _rows_of_json(path: Path, text: str) -> list[tuple[str, list[object]]]:
    try:
        content = json.loads(text, object_pairs_hook=tuple)  # pairs, so that duplicates are seen
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}); correct it") from None
    if not isinstance(content, tuple) or not all(isinstance(v, list) for _, v in content):
        raise InputError(
            f"{path}: the JSON is not one list of three numbers for every electrode; write it "
            'as {"RA": [x, y, z], ...}'
        )
    return list(content)


def _position(path: Path, name: str, values: list[object]) -> list[float]:
    try:
        position = [float(value) for value in values]  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        position = []
    boolean = any(isinstance(value, bool) for value in values)
    if len(position) != 3 or boolean or not np.isfinite(position).all():
        raise InputError(
            f"{path}: electrode {name} is at {shown(values)}; give three finite numbers (mm)"
        )
    check_position(position, f"{path}: electrode {name}")
    return position


def write_electrodes(
    path: Path, electrodes: Floats, additional: Mapping[str, Floats] | None = None
) -> None:
    """Write the nine positions (9, 3) and additional ones (mm) as CSV or, by the suffix, JSON."""
    positions = dict(zip(ELECTRODES, np.asarray(electrodes, dtype=float).tolist(), strict=True))
    positions |= {name: list(map(float, at)) for name, at in (additional or {}).items()}
    if path.suffix.lower() == ".json":
        write_text(path, json.dumps(positions, indent=1) + "\n")
    else:
        rows = [",".join([name, *map(repr, position)]) for name, position in positions.items()]
        write_text(path, "\n".join(["name,x,y,z", *rows]) + "\n")


def check_electrodes(name: str, heart: Heart) -> None:
    """Refuse electrodes in other units, inside the tissue, or far from any torso."""
    electrodes = heart.electrodes
    off = np.linalg.norm(electrodes - np.median(electrodes, axis=0), axis=1)
    # the two furthest may be misplaced; those of the chest alone span 150 to 250 mm on an adult
    check_units(f"{name} (electrodes)", electrodes[np.argsort(off)[:7]], (120.0, 1200.0))
    electrodes = heart.electrode_positions
    tree = igl.AABB()
    tree.init(heart.vertices, heart.tetrahedra)
    inside = np.asarray(igl.in_element(heart.vertices, heart.tetrahedra, electrodes, tree))
    distance = np.linalg.norm(electrodes - heart.vertices.mean(axis=0), axis=1)
    for k, electrode in enumerate(heart.electrode_names):
        where = "lies inside the tissue" if inside[k] >= 0 else ""
        if distance[k] > 1500:  # mm
            where = f"is {distance[k]:.0f} mm from the heart"
        if where:
            raise InputError(
                f"{name}: electrode {electrode} {where}; check its position, and that electrodes "
                "and heart share frame and units (mm)"
            )
