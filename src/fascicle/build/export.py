"""Hearts for other software: openCARP, ParaView (VTU) and Gmsh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fascicle.build.opencarp import ONE_REGION, write_opencarp
from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError
from fascicle.core.files import DISK_FULL, atomic_folder, atomic_path
from fascicle.core.leads import ELECTRODES
from fascicle.heart.assembly import REGION, SHEET
from fascicle.heart.boundary_labels import labelled_mesh
from fascicle.heart.folder import LEAD_FIELD
from fascicle.heart.heart import Heart
from fascicle.heart.label_names import SURFACE_NAMES
from fascicle.mesh.formats.mesh_file import GROUP, TETRAHEDRON
from fascicle.mesh.formats.vtk import write_grid
from fascicle.purkinje.tree import PurkinjeTree

ExportFormat = Literal["opencarp", "vtu", "gmsh"]
SUFFIXES = {"vtu": ".vtu", "gmsh": ".msh"}
FIBRE = "fibre"


def export_heart(heart: Heart, out: Path, kind: str, trees: Sequence[PurkinjeTree] = ()) -> None:
    """Write a heart for other software, whole or not at all.

    Parameters
    ----------
    heart : Heart
        The heart.
    out : Path
        openCARP: a folder, see `fascicle.build.opencarp.write_opencarp`; the files are called
        ``heart``. VTU: a file; tetrahedra with the cell arrays ``fibre``, ``sheet`` and ``region``
        and the point arrays ``lead_field_RA``, ... (kΩ), as far as the heart has them. Gmsh: a file
        (format 2.2), see `write_gmsh`. VTU and Gmsh are in mm, openCARP in µm. openCARP and Gmsh
        have the whole boundary, labelled by `fascicle.heart.boundary_labels.labelled_mesh`, so that
        `fascicle.build.labelled_mesh_files.read_labelled_mesh` reads it.
    kind : str
        ``"opencarp"``, ``"vtu"`` or ``"gmsh"``.
    trees : sequence of PurkinjeTree
        Trees to write beside the heart; openCARP only.

    Raises
    ------
    InputError
        If the kind is unknown, the suffix is not its own, or `out` cannot be written.
    """
    if kind not in get_args(ExportFormat):
        raise InputError(
            f"format '{kind}' is unknown; use one of {', '.join(get_args(ExportFormat))}"
        )
    if kind == "opencarp":
        with atomic_folder(out) as temporary:
            write_opencarp(heart, labelled_mesh(heart), temporary / "heart", trees)
        return
    if out.suffix.lower() != SUFFIXES[kind]:
        raise InputError(f"{out}: a {kind} file must end in {SUFFIXES[kind]}; rename it (--out)")
    if out.is_dir():
        raise InputError(f"{out}: is a folder; give the path of a file (--out)")
    if trees:
        raise InputError(
            f"{out}: trees are exported for openCARP only; for other software use the VTU files of "
            "'fascicle simulate'"
        )
    write = write_vtu if kind == "vtu" else write_gmsh
    try:
        write(heart, out)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        raise InputError(
            f"{out}: could not be written ({error.strerror}); free some space or choose another "
            "place (--out)"
        ) from None


def write_vtu(heart: Heart, path: Path) -> None:
    """Write the tetrahedra and every array of a heart as one VTU file (mm)."""
    points: dict[str, NDArray[Any]] = {}
    if heart.lead_fields is not None:
        for electrode, values in zip(ELECTRODES, heart.lead_fields.values, strict=True):
            points[f"{LEAD_FIELD}{electrode}"] = values
    write_grid(
        path,
        heart.vertices,
        heart.tetrahedra,
        TETRAHEDRON,
        point_data=points,
        cell_data=_cell_arrays(heart),
    )


def write_gmsh(heart: Heart, path: Path) -> None:
    """Write a heart as a Gmsh file (2.2, binary, mm).

    The physical groups are a volume for each region (``region 3``; ``myocardium`` without regions)
    and the surfaces ``lv_endo``, ``rv_endo``, ``epi`` and ``base``, together the whole boundary.
    Element data are ``fibre``, ``sheet`` and ``region``; meshio wants them zero on triangles.
    """
    import meshio

    surface = labelled_mesh(heart)
    tags, groups = _volume_groups(heart)
    cells, numbers = [("tetra", heart.tetrahedra)], [tags]
    for label, name in SURFACE_NAMES.items():
        triangles = surface.having(label)
        if len(triangles):
            cells.append(("triangle", triangles))
            numbers.append(np.full(len(triangles), int(label)))
            groups[name] = np.array([int(label), 2])
    data = {GROUP: numbers, "gmsh:geometrical": numbers}
    for name, values in _cell_arrays(heart).items():
        data[name] = [np.asarray(values, dtype=float)]
        data[name] += [np.zeros((len(block), *values.shape[1:])) for _, block in cells[1:]]
    mesh = meshio.Mesh(heart.vertices, cells, cell_data=data, field_data=groups)
    with atomic_path(path) as temporary:
        meshio.gmsh.write(temporary, mesh, fmt_version="2.2", binary=True)


def _volume_groups(heart: Heart) -> tuple[Integers, dict[str, Integers]]:
    """Group number of each tetrahedron, and number and dimension of each group by name.

    Numbers of groups start at 1, while regions may be 0 or less.
    """
    if heart.regions is None:
        tags = np.full(len(heart.tetrahedra), ONE_REGION)
        return tags, {"myocardium": np.array([ONE_REGION, 3])}
    regions, which = np.unique(heart.regions, return_inverse=True)
    groups = {f"region {region}": np.array([k, 3]) for k, region in enumerate(regions, 1)}
    return which.astype(np.int64) + 1, groups


def _cell_arrays(heart: Heart) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {FIBRE: heart.fibres}
    if heart.sheets is not None:
        arrays[SHEET] = heart.sheets
    if heart.regions is not None:
        arrays[REGION] = heart.regions
    return arrays
