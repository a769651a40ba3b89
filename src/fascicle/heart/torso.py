"""The body around the heart, as the lead fields see it, and its file in a heart folder."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.short_repr import short_repr
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.formats.vtk import write_grid
from fascicle.mesh.measures import signed_volumes

TISSUE = "tissue"  # cell array of `TorsoTissue` labels


class TorsoTissue(IntEnum):
    """What a tetrahedron outside the myocardium is."""

    BODY = 1
    LUNG = 2
    BLOOD = 3


@dataclass(frozen=True)
class Torso:
    """A conforming mesh of everything outside the myocardium.

    Attributes
    ----------
    vertices : (k, 3) array
        Positions (mm). The first ones are all vertices of the heart, in its order.
    tetrahedra : (m, 4) array
        Vertex indices, positively oriented; the myocardium's own are not among them.
    tissues : (m,) array
        A `TorsoTissue` for each.
    """

    vertices: Floats
    tetrahedra: Integers
    tissues: Integers

    __repr__ = short_repr


@dataclass(frozen=True)
class LeadFields:
    """Lead fields at the heart's vertices, and what they were computed from.

    Attributes
    ----------
    values : (9, n) array
        Potential for unit current through each electrode (kΩ), up to a constant.
    key : str
        `fascicle.torso.lead_fields.key_of` heart and conduction.
    torso : str
        `fascicle.torso.lead_fields.torso_key` of the body they were computed in.
    """

    values: Floats
    key: str
    torso: str

    __repr__ = short_repr


def write_torso(path: Path, torso: Torso) -> None:
    """Write a torso as VTU, with its tissues as the cell array ``tissue``."""
    tissues = {TISSUE: torso.tissues.astype(np.float64)}
    write_grid(path, torso.vertices, torso.tetrahedra, TETRAHEDRON, cell_data=tissues)


def read_torso(path: Path, heart_vertices: Floats) -> Torso:
    """Read a torso that `write_torso` wrote.

    Parameters
    ----------
    path : Path
        The file.
    heart_vertices : (n, 3) array
        Vertices (mm) of the heart it was made around.

    Raises
    ------
    InputError
        If the file cannot be read, has no or unknown tissues, is of another heart, or has inverted
        tetrahedra.
    """
    mesh = read_mesh(path, "torso")
    tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    again = "build the heart's torso again"
    tissues = mesh.cell_data[TETRAHEDRON].get(TISSUE)
    if tissues is None or tissues.ndim != 1:
        raise InputError(f"{path}: no cell array '{TISSUE}' with a label each; {again}")
    unknown = np.setdiff1d(tissues, list(TorsoTissue))
    if unknown.size:
        known = ", ".join(f"{tissue.value} ({tissue.name.lower()})" for tissue in TorsoTissue)
        raise InputError(f"{path}: unknown tissue {unknown[0]:g}; the labels are {known}")
    count = len(heart_vertices)
    if not np.array_equal(mesh.points[:count], heart_vertices):
        raise InputError(f"{path}: its first {count} points are not the heart's; {again}")
    inverted = np.flatnonzero(signed_volumes(mesh.points, tetrahedra) <= 0)
    if inverted.size:
        raise InputError(
            f"{path}: {inverted.size} of {len(tetrahedra)} tetrahedra are flat or inverted "
            f"(first: {inverted[0]}); {again}"
        )
    return Torso(mesh.points, tetrahedra, tissues.astype(np.int64))
