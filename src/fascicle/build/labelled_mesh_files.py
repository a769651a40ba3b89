"""Tetrahedra of the ventricles from files, with labels of their surface, regions and fibres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.build.surface_label_arrays import label_boundary
from fascicle.core.errors import InputError
from fascicle.heart.assembly import FIBRE_NAMES
from fascicle.heart.fibres.directions import average_to_tetrahedra
from fascicle.heart.label_names import Names
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.validate import check_fibres, check_tetrahedra, check_units
from fascicle.mesh.formats.mesh_file import GROUP, TETRAHEDRON, MeshFile
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import boundary_triangles

REGION_NAMES = ("region", "regions", "elemtag", "elemtags", "tag", "tags", GROUP)
SHEET_NAMES = ("sheet", "sheets", "s0", "sheet_direction")
TURNED = (
    "tetrahedra: all were inverted and have been turned; if left and right are exchanged in the "
    "picture, the file is mirrored"
)


@dataclass(frozen=True)
class TissueMesh:
    """Tetrahedra of the ventricular myocardium and what their file says about them.

    Attributes
    ----------
    vertices : (n, 3) array
        Positions (mm); every one belongs to a tetrahedron.
    tetrahedra : (m, 4) array
        Vertex indices, positively oriented, in the file's order.
    triangles : (b, 3) array
        The boundary, as vertex indices, counter-clockwise seen from outside the tissue.
    labels : (b,) array or None
        A `Label` for each boundary triangle; None if the file labels none.
    regions : (m,) array or None
        A whole number for each tetrahedron.
    fibres, sheets : (m, 3) array or None
        Unit directions of each tetrahedron.
    name : str
        The file.
    notes : tuple of str
        What was changed on reading, for people.
    """

    vertices: NDArray[np.float64]
    tetrahedra: NDArray[np.int64]
    triangles: NDArray[np.int64]
    labels: NDArray[np.int64] | None
    regions: NDArray[np.int64] | None
    fibres: NDArray[np.float64] | None
    sheets: NDArray[np.float64] | None
    name: str
    notes: tuple[str, ...] = ()

    def boundary_surface(
        self,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Vertices (k, 3) of the boundary alone, its triangles (b, 3), and the k vertex indices.

        The triangles are in the order of `triangles`, so labels found for them fit `labelled`.
        """
        used, corners = np.unique(self.triangles, return_inverse=True)
        return self.vertices[used], corners.reshape(-1, 3).astype(np.int64), used

    def labelled(self, labels: NDArray[np.int64] | None = None) -> LabelledMesh:
        """Mesh with these labels (b,) of its boundary triangles, or with the file's own.

        Raises
        ------
        InputError
            If there are neither.
        """
        chosen = labels if labels is not None else self.labels
        if chosen is None:
            raise InputError(
                f"{self.name}: no surface labels in this file; label the triangles of epicardium, "
                "base, LV and RV endocardium"
            )
        return LabelledMesh(
            self.vertices, self.tetrahedra, self.triangles, chosen, self.regions, self.name
        )


def read_labelled_mesh(
    path: Path | str, *, array: str | None = None, names: Names | None = None
) -> TissueMesh:
    """Read tetrahedra and the labels of their surface.

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
    path : path
        VTK, VTU, Gmsh or openCARP file; in mm, openCARP's in µm.
    array : str, optional
        Name of the array of labels, if it has another one.
    names : mapping of str to Label, optional
        The file's own names or numbers (as text) of labels, where they are not understood;
        `fascicle.heart.label_names.labels_by_number` makes them from ``{"lv": 3}``.

    Raises
    ------
    InputError
        If the file cannot be read; if tetrahedra are flat, overlap or are inverted (unless all
        are: then they are turned, and `TissueMesh.notes` says so), or lie in several pieces; if
        labels are missing or unknown, contradict one another, or lie on triangles that are not on
        the boundary; if regions are not whole numbers or fibres have no length; if it is not in mm.
    """
    mesh = read_mesh(path, "tissue mesh")
    file_tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    name = str(mesh.path)
    used, corners = np.unique(file_tetrahedra, return_inverse=True)
    vertices = mesh.points[used]
    check_units(name, vertices)
    tetrahedra, notes = _positively_oriented(vertices, corners.reshape(-1, 4).astype(np.int64))
    check_tetrahedra(name, vertices, tetrahedra)
    triangles, _ = boundary_triangles(tetrahedra)
    return TissueMesh(
        vertices=vertices,
        tetrahedra=tetrahedra,
        triangles=triangles,
        labels=label_boundary(mesh, used[triangles], array, names if names is not None else {}),
        regions=_regions(mesh),
        fibres=_directions(mesh, FIBRE_NAMES),
        sheets=_directions(mesh, SHEET_NAMES),
        name=name,
        notes=notes,
    )


def _positively_oriented(
    vertices: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Tetrahedra, turned if every single one is inverted, and a note if they were.

    It may be another program's convention, or the file may be mirrored.
    """
    if (signed_volumes(vertices, tetrahedra) < 0).all():
        return tetrahedra[:, [0, 2, 1, 3]], (TURNED,)
    return tetrahedra, ()


def _named(
    arrays: Mapping[str, NDArray[np.float64]], names: tuple[str, ...]
) -> tuple[str, NDArray[np.float64]] | None:
    """First array with one of these names, in the order of the names."""
    lower = {key.lower(): key for key in arrays}
    return next(((lower[name], arrays[lower[name]]) for name in names if name in lower), None)


def _regions(mesh: MeshFile) -> NDArray[np.int64] | None:
    found = _named(mesh.cell_data.get(TETRAHEDRON, {}), REGION_NAMES)
    if found is None:
        return None
    name, values = found[0], np.asarray(found[1], dtype=float)
    if values.ndim != 1 or not (np.isfinite(values) & (values == np.round(values))).all():
        raise InputError(
            f"{mesh.path}: the cell array '{name}' must hold one whole number a tetrahedron; "
            "correct or remove it"
        )
    return values.astype(np.int64)


def _directions(mesh: MeshFile, names: tuple[str, ...]) -> NDArray[np.float64] | None:
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
    if not per_cell:
        everywhere = np.broadcast_to([1.0, 0.0, 0.0], values.shape).copy()  # for unused points
        everywhere[at] = values[at]
        return average_to_tetrahedra(everywhere, tetrahedra)
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))
