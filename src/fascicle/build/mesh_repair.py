"""Tetrahedra that touch along an edge alone are drawn apart there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fascicle.build.anatomy import Anatomy
from fascicle.build.surface_checks import place
from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import boundary_triangles, components_of, places_in, unique_edges


def repaired_edges(anatomy: Anatomy) -> Anatomy:
    """Separate tetrahedra that have nothing but an edge in common, where few edges are so.

    In such an edge four or more triangles of the boundary meet, and the boundary is not a surface.
    Each group of tetrahedra around the edge, linked by faces, gets a middle of the edge of its own,
    drawn a little into the group, and its tetrahedra are halved there: no tissue is removed, and
    the groups stay joined at the edge's ends. Fibres, sheets, regions and labels are those of the
    halved tetrahedra and triangles.

    Returns
    -------
    Anatomy
        The same object if there is nothing to repair, or more than one edge in a thousand.
    """
    mesh = anatomy.mesh
    edges, count = unique_edges(mesh.triangles)
    bad = edges[count > 2]
    if not len(bad) or len(bad) > max(2.0, 1e-3 * len(edges)):
        return anatomy
    vertices, tetrahedra = mesh.vertices, mesh.tetrahedra
    parent, ends = np.arange(len(tetrahedra)), np.empty((0, 2), dtype=np.int64)
    for edge in bad:
        fans = _fans(tetrahedra, edge)
        around = np.concatenate(fans)
        kept, halves = np.delete(tetrahedra, around, axis=0), []
        for fan in fans:
            new, middle = len(vertices), _middle(vertices, tetrahedra[fan], edge)
            vertices = np.concatenate([vertices, middle[None]])
            ends = np.concatenate([ends, edge[None]])
            halves += [np.where(tetrahedra[fan] == end, new, tetrahedra[fan]) for end in edge]
        order = np.concatenate([each for fan in fans for each in (fan, fan)])
        tetrahedra = np.concatenate([kept, *halves])
        parent = np.concatenate([np.delete(parent, around), parent[order]])
    triangles, _ = boundary_triangles(tetrahedra)
    whole = triangles.copy()  # the triangles that these are parts of
    for k in range(len(ends) - 1, -1, -1):  # the last ones may lie between earlier ones
        for corner in range(3):
            here = whole[:, corner] == len(mesh.vertices) + k
            there = (whole == ends[k, 0]).any(axis=1)
            whole[here, corner] = np.where(there, ends[k, 1], ends[k, 0])[here]
    note = (
        f"mesh: {len(bad)} of {len(edges)} edges of its boundary had more than two triangles (the "
        f"first at {place(mesh.vertices[bad[0]].mean(axis=0))}): the tetrahedra that met in them "
        f"alone were drawn apart ({len(tetrahedra) - len(mesh.tetrahedra)} tetrahedra halved, none "
        "removed)"
    )
    return replace(
        anatomy,
        mesh=replace(
            mesh,
            vertices=vertices,
            tetrahedra=tetrahedra,
            triangles=triangles,
            labels=mesh.labels[places_in(whole, mesh.triangles)],
            regions=None if mesh.regions is None else mesh.regions[parent],
        ),
        fibres=None if anatomy.fibres is None else anatomy.fibres[parent],
        sheets=None if anatomy.sheets is None else anatomy.sheets[parent],
        notes=(*anatomy.notes, note),
    )


def _fans(tetrahedra: Integers, edge: Integers) -> list[Integers]:
    """Groups of the tetrahedra that have an edge, linked by the faces that have it."""
    around = np.flatnonzero(np.isin(tetrahedra, edge).sum(axis=1) == 2)
    opposite = tetrahedra[around][~np.isin(tetrahedra[around], edge)].reshape(-1, 2)
    _, ring = np.unique(opposite, return_inverse=True)
    ring = ring.reshape(-1, 2)
    group = components_of(ring, int(ring.max()) + 1)[ring[:, 0]]
    return [around[group == k] for k in np.unique(group)]


def _middle(vertices: Floats, fan: Integers, edge: Integers) -> Floats:
    """The middle of an edge, a tenth of the way into its tetrahedra where these stay positive."""
    middle = vertices[edge].mean(axis=0)
    inwards = vertices[fan[~np.isin(fan, edge)]].mean(axis=0) - middle
    trial = np.concatenate([vertices, (middle + 0.1 * inwards)[None]])
    halves = [np.where(fan == end, len(vertices), fan) for end in edge]
    if all((signed_volumes(trial, half) > 0).all() for half in halves):
        return np.asarray(trial[-1])
    return np.asarray(middle)
