"""The torso of a heart folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fascicle.core.errors import InputError
from fascicle.heart.heart import Heart
from fascicle.heart.torso import Torso, TorsoTissue
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.formats.vtk import write_grid
from fascicle.mesh.measures import signed_volumes

TISSUE = "tissue"  # cell array of labels, see `fascicle.heart.torso.TorsoTissue`


def write_torso(path: Path, torso: Torso) -> None:
    """Write a torso as VTU, with its tissues as the cell array ``tissue``."""
    tissues = {TISSUE: torso.tissues.astype(np.float64)}
    write_grid(path, torso.vertices, torso.tetrahedra, TETRAHEDRON, cell_data=tissues)


def read_torso(path: Path, heart: Heart) -> Torso:
    """Read a torso that `write_torso` wrote.

    Parameters
    ----------
    path : Path
        The file.
    heart : Heart
        The heart it was made around.

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
    count = len(heart.vertices)
    if not np.array_equal(mesh.points[:count], heart.vertices):
        raise InputError(f"{path}: its first {count} points are not the heart's; {again}")
    inverted = np.flatnonzero(signed_volumes(mesh.points, tetrahedra) <= 0)
    if inverted.size:
        raise InputError(
            f"{path}: {inverted.size} of {len(tetrahedra)} tetrahedra are flat or inverted "
            f"(first: {inverted[0]}); {again}"
        )
    return Torso(mesh.points, tetrahedra, tissues.astype(np.int64))
