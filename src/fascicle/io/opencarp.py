"""Writing hearts and trees for openCARP, and reading such trees.

A tree is a mesh of line elements. openCARP has no format of its own for trees; the `.pkje` files of
its predecessor CARP allow a cable two sons at most and hold no lengths, so they cannot carry ours.
The convention:

``<stem>.pts``, ``<stem>.elem``
    Nodes (µm), in the tree's order, and ``Ln parent child tag`` for every segment, in the order of
    the nodes that they end in. Tag 0 is the bundle, k fascicle k, and the next number the branches.
``<stem>.lon``
    The direction of every segment.
``<stem>_length.dat``
    The length of every segment along the endocardium (µm), which is what the speed refers to; the
    straight line between its nodes is a little shorter.
``<stem>_root.vtx``, ``<stem>_junctions.vtx``
    The node where the bundle starts, to be stimulated, and the Purkinje-myocardium junctions.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fascicle.errors import InputError
from fascicle.geometry.endocardium import Endocardium
from fascicle.geometry.heart import Heart
from fascicle.geometry.surface import LabelledMesh
from fascicle.io.atomic import write_text
from fascicle.io.electrodes import write_electrodes
from fascicle.io.label_names import SURFACE_NAMES
from fascicle.io.meshes import LINE, Mesh
from fascicle.io.opencarp_mesh import (
    MICROMETRES,
    opencarp_file,
    read_lengths,
    read_opencarp_mesh,
)
from fascicle.tree.purkinje import PurkinjeTree

ONE_REGION = 1  # the tag of every element of a heart without regions
# An endocardium whose vertices are this close (mm) to the mesh's is part of it: text files round.
IN_REGISTER = 1e-3
COORDINATE, DIRECTION = "%.6f", "%.15f"  # 1e-6 µm


def write_opencarp(
    heart: Heart, surface: LabelledMesh, stem: Path, trees: Iterable[PurkinjeTree] = ()
) -> None:
    """Write a heart for openCARP.

    There are ``<stem>.pts``, ``<stem>.elem`` (tags are the regions; 1 without any), ``<stem>.lon``
    (fibres, and sheets if the heart has them) and ``electrodes.csv`` (mm). The boundary is
    in ``<stem>_lv_endo``, ``_rv_endo``, ``_epi`` and ``_base``, each as ``.surf`` and ``.vtx``. An
    endocardium that is no part of the mesh is ``<stem>_lv_endocardium.pts`` and ``.elem`` besides,
    with triangles of its own, less what spans a valve opening.

    Parameters
    ----------
    heart : Heart
        The heart.
    surface : LabelledMesh
        Its boundary with labels.
    stem : Path
        Folder and name of the files, without a suffix.
    trees : iterable of PurkinjeTree
        Written beside it as ``lv_tree`` and ``rv_tree``; see this module's convention.
    """
    regions = heart.regions
    tags = regions if regions is not None else np.full(len(heart.tetrahedra), ONE_REGION)
    _write_mesh(stem, heart.vertices, "Tt", heart.tetrahedra, tags)
    axes = [heart.fibres] if heart.sheets is None else [heart.fibres, heart.sheets]
    _write_directions(opencarp_file(stem, ".lon"), axes)
    for label, name in SURFACE_NAMES.items():
        _write_surface(stem.with_name(f"{stem.name}_{name}"), surface.having(label))
    for endocardium in heart.endocardia:
        _write_endocardium(
            stem.with_name(f"{stem.name}_{endocardium.side}_endocardium"), endocardium, heart
        )
    write_electrodes(stem.with_name("electrodes.csv"), heart.electrodes)
    for tree in trees:
        write_opencarp_tree(stem.with_name(f"{tree.side}_tree"), tree)


def _write_surface(stem: Path, triangles: NDArray[np.int64]) -> None:
    """Write triangles of the mesh, and their vertices; nothing if there are none."""
    if not len(triangles):
        return
    rows = _rows("Tr %d %d %d", triangles)
    write_text(opencarp_file(stem, ".surf"), f"{len(triangles)}\n{rows}")
    write_vtx(opencarp_file(stem, ".vtx"), np.unique(triangles))


def _write_endocardium(stem: Path, endocardium: Endocardium, heart: Heart) -> None:
    """Write an endocardium as a mesh of triangles, unless it is part of the heart's."""
    wall = endocardium.triangles
    if endocardium.valves is not None:
        wall = wall[~endocardium.valves]
    used, corners = np.unique(wall, return_inverse=True)
    vertices = endocardium.vertices[used]
    distance, _ = cKDTree(heart.vertices).query(vertices)
    if (distance <= IN_REGISTER).all():
        return
    corners = corners.reshape(-1, 3)
    _write_mesh(stem, vertices, "Tr", corners, np.full(len(corners), ONE_REGION))


def write_vtx(
    path: Path, indices: NDArray[np.int64], domain: Literal["intra", "extra"] = "intra"
) -> None:
    """Write vertex numbers (k,) as a `.vtx` file of a domain, whole or not at all."""
    write_text(path, f"{len(indices)}\n{domain}\n" + _rows("%d", indices))


def write_opencarp_tree(stem: Path, tree: PurkinjeTree) -> None:
    """Write a tree as line elements, by this module's convention.

    Positions and lengths keep 1e-9 mm.
    """
    child = np.flatnonzero(tree.parents >= 0)
    parent = tree.parents[child]
    tags = np.full(len(tree.nodes), len(tree.parts))
    for number, part in enumerate(tree.parts.values()):
        tags[part] = number
    _write_mesh(stem, tree.nodes, "Ln", np.column_stack([parent, child]), tags[child])
    along = tree.nodes[child] - tree.nodes[parent]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    _write_directions(opencarp_file(stem, ".lon"), [along / np.where(size > 0, size, 1)])
    lengths = _rows(COORDINATE, tree.lengths[child] * MICROMETRES)
    write_text(opencarp_file(stem, "_length.dat"), lengths)
    write_vtx(opencarp_file(stem, "_root.vtx"), np.array([tree.root]))
    write_vtx(opencarp_file(stem, "_junctions.vtx"), tree.junctions)


def read_opencarp_tree(path: Path | str, purpose: str) -> Mesh:
    """Read the lines of a tree, with the cell array ``length`` (mm) if its file is there.

    Raises
    ------
    InputError
        If a file is missing or damaged, or there is not one length for each line.
    """
    mesh = read_opencarp_mesh(path, purpose)
    file = opencarp_file(path, "_length.dat")
    if not file.exists():
        return mesh
    lines, lengths = mesh.require(LINE, "lines"), read_lengths(file)
    if len(lengths) != len(lines):
        raise InputError(
            f"{file}: {len(lengths)} lengths for {len(lines)} lines; export or copy it again"
        )
    return replace(mesh, cell_data={LINE: {**mesh.cell_data[LINE], "length": lengths}})


def _write_mesh(
    stem: Path,
    points: NDArray[np.float64],
    code: str,
    cells: NDArray[np.int64],
    tags: NDArray[np.int64],
) -> None:
    positions = _rows(" ".join([COORDINATE] * 3), points * MICROMETRES)
    write_text(opencarp_file(stem, ".pts"), f"{len(points)}\n{positions}")
    rows = _rows(" ".join([code, *["%d"] * (cells.shape[1] + 1)]), np.column_stack([cells, tags]))
    write_text(opencarp_file(stem, ".elem"), f"{len(cells)}\n{rows}")


def _write_directions(path: Path, axes: list[NDArray[np.float64]]) -> None:
    rows = _rows(" ".join([DIRECTION] * (3 * len(axes))), np.hstack(axes))
    write_text(path, f"{len(axes)}\n{rows}")


def _rows(form: str, values: NDArray[np.float64] | NDArray[np.int64]) -> str:
    text = io.StringIO()
    np.savetxt(text, values, fmt=form)
    return text.getvalue()
