"""Writing hearts and trees for openCARP, and reading such trees.

A tree is a mesh of line elements. openCARP has no format of its own for trees; the `.pkje` files of
its predecessor CARP allow a cable at most two children and hold no lengths, so they cannot carry
ours. The convention:

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

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Integers
from fascicle.core.files import write_text
from fascicle.heart.electrodes import write_electrodes
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.heart.label_names import SURFACE_NAMES
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.formats.opencarp import (
    opencarp_file,
    rows,
    write_directions,
    write_opencarp_mesh,
    write_vtx,
)
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import write_opencarp_tree

ONE_REGION = 1  # the tag of every element of a heart without regions
# An endocardium whose vertices are this close (mm) to the mesh's is part of it: text files round.
IN_REGISTER = 1e-3


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
    write_opencarp_mesh(stem, heart.vertices, "Tt", heart.tetrahedra, tags)
    axes = [heart.fibres] if heart.sheets is None else [heart.fibres, heart.sheets]
    write_directions(opencarp_file(stem, ".lon"), axes)
    for label, name in SURFACE_NAMES.items():
        _write_surface(stem.with_name(f"{stem.name}_{name}"), surface.having(label))
    for endocardium in heart.endocardia:
        _write_endocardium(
            stem.with_name(f"{stem.name}_{endocardium.side}_endocardium"), endocardium, heart
        )
    write_electrodes(stem.with_name("electrodes.csv"), heart.electrodes)
    for tree in trees:
        write_opencarp_tree(stem.with_name(f"{tree.side}_tree"), tree)


def _write_surface(stem: Path, triangles: Integers) -> None:
    """Write triangles of the mesh, and their vertices; nothing if there are none."""
    if not len(triangles):
        return
    text = rows("Tr %d %d %d", triangles)
    write_text(opencarp_file(stem, ".surf"), f"{len(triangles)}\n{text}")
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
    write_opencarp_mesh(stem, vertices, "Tr", corners, np.full(len(corners), ONE_REGION))
