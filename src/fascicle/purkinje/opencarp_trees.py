"""Trees in openCARP files.

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

from dataclasses import replace
from pathlib import Path

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import write_text
from fascicle.mesh.formats.mesh_file import LINE, MeshFile
from fascicle.mesh.formats.opencarp import (
    COORDINATE,
    MICROMETRES,
    opencarp_file,
    read_lengths,
    read_opencarp_mesh,
    rows,
    write_directions,
    write_opencarp_mesh,
    write_vtx,
)
from fascicle.mesh.measures import unit
from fascicle.purkinje.tree import PurkinjeTree


def write_opencarp_tree(stem: Path, tree: PurkinjeTree) -> None:
    """Write a tree as line elements, by this module's convention.

    Positions and lengths keep 1e-9 mm.
    """
    child = np.flatnonzero(tree.parents >= 0)
    parent = tree.parents[child]
    tags = np.full(len(tree.nodes), len(tree.parts))
    for number, part in enumerate(tree.parts.values()):
        tags[part] = number
    write_opencarp_mesh(stem, tree.nodes, "Ln", np.column_stack([parent, child]), tags[child])
    along = tree.nodes[child] - tree.nodes[parent]
    write_directions(opencarp_file(stem, ".lon"), [unit(along)])
    lengths = rows(COORDINATE, tree.lengths[child] * MICROMETRES)
    write_text(opencarp_file(stem, "_length.dat"), lengths)
    write_vtx(opencarp_file(stem, "_root.vtx"), np.array([tree.root]))
    write_vtx(opencarp_file(stem, "_junctions.vtx"), tree.junctions)


def read_opencarp_tree(path: Path | str, purpose: str) -> MeshFile:
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
