"""Tetrahedra of the ventricles from files, with labels of their surface, regions and fibres."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fascicle.build.anatomy import Anatomy
from fascicle.build.file_labels import label_boundary
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.assembly import FIBRE_NAMES, average_to_tetrahedra, region_labels
from fascicle.heart.label_names import Names
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.validate import check_fibres, check_tetrahedra, check_units
from fascicle.mesh.formats.mesh_file import GROUP, TETRAHEDRON, MeshFile
from fascicle.mesh.measures import signed_volumes, unit
from fascicle.mesh.topology import boundary_triangles, without_unused_vertices

REGION_NAMES = ("region", "regions", "elemtag", "elemtags", "tag", "tags", GROUP)
SHEET_NAMES = ("sheet", "sheets", "s0", "sheet_direction")
TURNED = (
    "tetrahedra: all were inverted and have been turned; if left and right are exchanged in the "
    "picture, the file is mirrored"
)


def labelled_tetrahedra(
    mesh: MeshFile, array: str | None = None, names: Names | None = None
) -> Anatomy:
    """Tetrahedra of a file, the labels of their surface, regions, fibres and sheets.

    The labels come from

    - triangles beside the tetrahedra with a cell array ``label`` (or ``class``, ``surface``, ...)
      of `Label` numbers: VTK, VTU;
    - such a point array on the boundary's points; a triangle gets the label of most of its corners
      (ties: the endocardia, then the epicardium, then the base);
    - physical groups of triangles, by name or number: Gmsh;
    - ``.surf`` files, or else ``.vtx`` files, beside the mesh with names like
      ``<stem>_lv_endo.surf``: openCARP.

    Parameters
    ----------
    mesh : MeshFile
        VTK, VTU, Gmsh or openCARP file; in mm, openCARP's in µm.
    array : str, optional
        Name of the array of labels, if it has another one.
    names : mapping of str to Label, optional
        The file's own names or numbers (as text) of labels, where they are not understood;
        `fascicle.heart.label_names.labels_by_number` makes them from ``{"lv": 3}``.

    Returns
    -------
    Anatomy
        Vertices that no tetrahedron has are left out; labels are 0 if the file has none.

    Raises
    ------
    InputError
        If tetrahedra are flat, overlap or are inverted (unless all are: then they are turned, and
        `Anatomy.notes` says so), or lie in several pieces; if labels are missing or unknown,
        contradict one another, or lie on triangles that are not on the boundary; if regions are not
        whole numbers or fibres have no length; if it is not in mm.
    """
    file_tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    name = str(mesh.path)
    vertices, tetrahedra = without_unused_vertices(mesh.points, file_tetrahedra)
    check_units(name, vertices)
    tetrahedra, notes = _positively_oriented(vertices, tetrahedra)
    check_tetrahedra(name, vertices, tetrahedra)
    triangles, _ = boundary_triangles(tetrahedra)
    boundary = np.unique(file_tetrahedra)[triangles]
    labels = label_boundary(mesh, boundary, array, names if names is not None else {})
    if labels is None:
        labels = np.zeros(len(triangles), dtype=np.int64)
    region = _named(mesh.cell_data.get(TETRAHEDRON, {}), REGION_NAMES)
    regions = None if region is None else region_labels(mesh, region[0])
    return Anatomy(
        LabelledMesh(vertices, tetrahedra, triangles, labels, regions, name),
        fibres=_directions(mesh, FIBRE_NAMES),
        sheets=_directions(mesh, SHEET_NAMES),
        notes=notes,
        own_mesh=True,
    )


def _positively_oriented(
    vertices: Floats, tetrahedra: Integers
) -> tuple[Integers, tuple[str, ...]]:
    """Tetrahedra, turned if every single one is inverted, and a note if they were.

    It may be another program's convention, or the file may be mirrored.
    """
    if (signed_volumes(vertices, tetrahedra) < 0).all():
        return tetrahedra[:, [0, 2, 1, 3]], (TURNED,)
    return tetrahedra, ()


def _named(arrays: Mapping[str, Floats], names: tuple[str, ...]) -> tuple[str, Floats] | None:
    """First array with one of these names, in the order of the names."""
    lower = {key.lower(): key for key in arrays}
    return next(((lower[name], arrays[lower[name]]) for name in names if name in lower), None)


def _directions(mesh: MeshFile, names: tuple[str, ...]) -> Floats | None:
    """Unit directions of the tetrahedra, from a cell or else a point array so named."""
    tetrahedra = mesh.cells[TETRAHEDRON]
    found = _named(mesh.cell_data.get(TETRAHEDRON, {}), names)
    per_cell = found is not None
    found = found if found is not None else _named(mesh.point_data, names)
    if found is None:
        return None
    title, values = f"{mesh.path}: array '{found[0]}'", np.asarray(found[1], dtype=float)
    if values.shape[1:] != (3,):
        raise InputError(f"{title} has shape {values.shape}; give three components, or rename it")
    at = np.arange(len(tetrahedra)) if per_cell else np.unique(tetrahedra)
    check_fibres(title, values[at])
    return unit(values) if per_cell else average_to_tetrahedra(values, tetrahedra)
