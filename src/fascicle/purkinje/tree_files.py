"""Purkinje trees as lines in VTU or VTP files, or in openCARP's.

In openCARP's files a tree is a mesh of line elements: openCARP has no format of its own for trees,
and the `.pkje` files of its predecessor CARP allow a cable at most two children and hold no
lengths, so they cannot carry ours. The convention:

``<stem>.pts``, ``<stem>.elem``
    Nodes (µm), in the tree's order, and ``Ln parent child tag`` for every segment, in the order of
    the nodes that they end in. Tag 0 is the bundle, k fascicle k, and the next number the branches.
``<stem>.lon``
    The direction of every segment.
``<stem>_length.dat``
    The length of every segment along the endocardium (µm), which is what the speed refers to; the
    straight line between its nodes is a little shorter.
``<stem>_root.vtx``, ``<stem>_junctions.vtx``
    The node where the bundle starts, which is stimulated, and the Purkinje-myocardium junctions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.files import as_path, check_file
from fascicle.core.ranges import check_array, check_kind, check_position, check_text
from fascicle.mesh import opencarp
from fascicle.mesh.checks import check_units
from fascicle.mesh.measures import unit
from fascicle.mesh.mesh_file import LINE, OPENCARP_FORMATS, MeshFile
from fascicle.mesh.read import read_mesh
from fascicle.mesh.topology import components_of, merged_vertices
from fascicle.mesh.vtk import write_grid
from fascicle.purkinje.tree import PurkinjeTree

SAME_NODE = 1e-4  # mm; ends of polylines closer than this are one node (single precision)


def write_tree(path: Path, tree: PurkinjeTree, activation: Floats | None = None) -> None:
    """Write a tree as VTU lines, with the activation time of each node (n,) (ms) if it is known."""
    write_grid(path, *tree_lines(tree, activation))


def tree_lines(tree: PurkinjeTree, activation: Floats | None = None) -> Any:
    """Points, cells and their kind, point arrays and cell arrays of a tree, for `write_grid`.

    Cell arrays are ``length``, of the segments (mm), and ``direction``, see `directions`; point
    arrays ``activation`` and ``root``, which is 1 at the root.
    """
    child = np.flatnonzero(tree.parents >= 0)
    points: dict[str, Any] = {"root": (tree.parents < 0).astype(np.int64)}
    cells: dict[str, Any] = {"length": tree.lengths[child]}
    if activation is not None:
        points["activation"] = activation
        cells["direction"] = directions(tree, activation)[child]
    return tree.nodes, np.column_stack([tree.parents[child], child]), LINE, points, cells


def directions(tree: PurkinjeTree, activation: Floats) -> Integers:
    """Direction of activation of the segment that ends in each node (n,), by the nodes' times (ms).

    1 where its end nearer to the root is activated first (anterograde), -1 where the other one is
    (retrograde), 0 where an end is not activated, and at the root.
    """
    before = activation[tree.parents]
    reached = np.isfinite(activation) & np.isfinite(before) & (tree.parents >= 0)
    return np.where(reached, np.where(before <= activation, 1, -1), 0)


def write_opencarp_tree(stem: Path, tree: PurkinjeTree) -> None:
    """Write a tree as line elements, by the convention of this module's docstring.

    Positions and lengths keep 1e-9 mm.
    """
    child = np.flatnonzero(tree.parents >= 0)
    parent = tree.parents[child]
    first = 0 if "bundle" in tree.parts else 1
    tags = np.full(len(tree.nodes), first + len(tree.parts))
    for number, part in enumerate(tree.parts.values(), first):
        tags[part] = number
    opencarp.write_opencarp_mesh(
        stem, tree.nodes, "Ln", np.column_stack([parent, child]), tags[child]
    )
    along = tree.nodes[child] - tree.nodes[parent]
    opencarp.write_directions(opencarp.opencarp_file(stem, ".lon"), [unit(along)])
    opencarp.write_values(opencarp.opencarp_file(stem, "_length.dat"), 1000 * tree.lengths[child])
    opencarp.write_vtx(opencarp.opencarp_file(stem, "_root.vtx"), np.array([tree.root]))
    opencarp.write_vtx(opencarp.opencarp_file(stem, "_junctions.vtx"), tree.junctions)


def read_tree(
    path: Path | str, side: str, near: Floats | None = None, *, file_first: bool = False
) -> PurkinjeTree:
    """Read a tree of lines or polylines (mm), or openCARP's by this module's convention.

    Segments take their length from a cell array ``length`` (mm) if there is one, as in trees that
    were written here, else from their ends. Lines that make one tree by their point numbers are
    taken as they are; else points in one place are made one first.

    The root is the node nearest to the point `near` (3,) (mm): an end, a fork or neither. With
    `file_first`, or without that point, a root that the file marks takes precedence. Raises
    InputError if the file is not one connected tree without loops, or if no node is within 2 mm of
    the point. The `side` is ``"lv"``, ``"rv"`` or another name.
    """
    path = as_path(path, "tree")
    check_text(side, "side")
    check_kind(file_first, bool, "file_first", "True or False")
    if near is not None:
        check_position(near, "near")
    purpose = f"{side.upper()} tree"
    check_file(path, (".vtu", ".vtp", ".vtk", *OPENCARP_FORMATS), purpose)
    is_opencarp = path.suffix.lower() in OPENCARP_FORMATS
    mesh = _read_opencarp_tree(path, purpose) if is_opencarp else read_mesh(path, purpose)
    segments, lengths = _segments(mesh)
    used, compact = np.unique(segments, return_inverse=True)
    nodes, segments = mesh.points[used], compact.reshape(-1, 2)
    if np.ptp(nodes, axis=0).max() < SAME_NODE:
        raise InputError(f"{path}: every line has length zero; give a tree with branches, in mm")
    if _why_no_tree(segments, len(nodes)):
        nodes, segments, lengths = _merged(nodes, segments, lengths)
        problem = _why_no_tree(segments, len(nodes))
        if problem:
            raise InputError(f"{path}: {problem}")
    marked = _marked_root(mesh) if file_first or near is None else None
    near = marked if near is None else near
    if near is None:
        raise InputError(f"{path}: marks no root (point array 'root'); give a point near it")
    distances = np.linalg.norm(nodes - (near if marked is None else marked), axis=1)
    root = int(np.argmin(distances))
    furthest = 2.0  # mm, between the place given for a root and the nearest node
    if distances[root] > furthest:
        root_place, nearest_place = (
            ", ".join(f"{x:.4f}" for x in point) for point in (near, nodes[root])
        )
        remedy = "give the place of a node"
        if file_first:
            remedy = (
                "give the tree in the heart's frame, in mm, and mark its root in the file (point "
                "array 'root', 1 there and 0 elsewhere; for openCARP _root.vtx)"
            )
        raise InputError(
            f"{path}: the node nearest to the root given ({root_place}) is {distances[root]:.1f} "
            f"mm away, at ({nearest_place}) mm, more than {furthest:g} mm; {remedy}"
        )
    graph = coo_array((np.ones(len(segments)), segments.T), (len(nodes), len(nodes))).tocsr()
    _, parents = breadth_first_order(graph, root, directed=False)
    parents = np.where(np.arange(len(nodes)) == root, -1, parents).astype(np.int64)
    is_first = parents[segments[:, 1]] == segments[:, 0]
    child = np.where(is_first, segments[:, 1], segments[:, 0])
    to_parent = np.zeros(len(nodes))
    to_parent[child] = lengths
    return PurkinjeTree(side, nodes, parents, to_parent)


def _marked_root(mesh: MeshFile) -> Floats | None:
    """Place of the point that the array ``root`` marks, if there is one."""
    if "root" not in mesh.point_data:
        return None
    marked = np.flatnonzero(mesh.point_data["root"])
    if len(marked) != 1:
        raise InputError(
            f"{mesh.path}: the point array 'root' marks {len(marked)} points; mark one with 1, all "
            "others with 0, or leave it out"
        )
    return np.asarray(mesh.points[marked[0]])


def _why_no_tree(segments: Integers, count: int) -> str:
    """Reason why segments between `count` nodes are not one tree; empty if they are."""
    pieces = components_of(segments, count).max() + 1
    if pieces > 1:
        return f"the lines fall into {pieces} unconnected pieces; give one tree"
    if len(segments) != count - 1:
        return (
            f"{len(segments)} segments between {count} nodes make a loop or repeat "
            "themselves; a tree has one segment fewer than nodes"
        )
    return ""


def _read_opencarp_tree(path: Path | str, purpose: str) -> MeshFile:
    """Read the lines of a tree, with ``length`` (mm) and ``root`` if their files are there."""
    mesh = opencarp.read_opencarp_mesh(path, purpose)
    file = opencarp.opencarp_file(path, "_length.dat")
    if file.exists():
        lines, lengths = mesh.require(LINE, "lines"), opencarp.read_lengths(file)
        if len(lengths) != len(lines):
            raise InputError(
                f"{file}: {len(lengths)} lengths for {len(lines)} lines; export or copy it again"
            )
        mesh = replace(mesh, cell_data={LINE: {**mesh.cell_data[LINE], "length": lengths}})
    file = opencarp.opencarp_file(path, "_root.vtx")
    if file.exists():
        marked = np.zeros(len(mesh.points))
        marked[opencarp.read_vtx(file, len(mesh.points))] = 1
        mesh = replace(mesh, point_data={**mesh.point_data, "root": marked})
    return mesh


def _merged(points: Floats, segments: Integers, lengths: Floats) -> tuple[Floats, Integers, Floats]:
    """Points, segments and lengths, with coincident points merged.

    Only for lines that do not form a tree as they are: polylines often repeat shared points. Two
    nodes of a tree may well lie in one place and be different nodes.
    """
    kept, number = np.unique(merged_vertices(points, SAME_NODE), return_inverse=True)
    segments = number[segments]
    real = segments[:, 0] != segments[:, 1]  # a point repeated along a polyline gives no segment
    return points[kept], segments[real], lengths[real]


def _segments(mesh: MeshFile) -> tuple[Integers, Floats]:
    segments = mesh.require(LINE, "lines")
    check_units(str(mesh.path), mesh.points, (0.0, 400.0))
    ends = mesh.points[segments]
    check_array("coordinate", ends, f"{mesh.path}: a coordinate")
    chords = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    stored = mesh.cell_data.get(LINE, {}).get("length")
    if stored is None:
        return segments, chords
    lengths = np.asarray(stored, dtype=float)
    if lengths.ndim != 1 or mesh.has_polylines:
        return segments, chords  # not one length for each segment
    bad = np.flatnonzero(~np.isfinite(lengths) | (lengths < chords * (1 - 1e-4)))
    if bad.size:
        raise InputError(
            f"{mesh.path}: segment {bad[0]} has length {lengths[bad[0]]:.3g} mm but its ends are "
            f"{chords[bad[0]]:.3g} mm apart; correct or remove the array 'length'"
        )
    return segments, lengths
