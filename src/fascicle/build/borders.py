"""The dual graph of a closed surface: random walkers, ambient occlusion, smooth borders."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import ClassVar

import igl
import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledSurface
from fascicle.mesh.measures import edge_lengths, triangle_areas, triangle_normals, unit
from fascicle.mesh.topology import (
    boundary_loops,
    components_of,
    directed_edges,
    merged_vertices,
    unique_edges,
    whole_triangles,
    without_unused_vertices,
)


@dataclass(frozen=True)
class DualGraph:
    """A closed surface as a graph of its triangles.

    Vertices (n, 3) (mm); triangles (m, 3), counter-clockwise seen from outside the tissue.
    """

    # mm between endocardium and epicardium, so that even a thin wall ends in a rim
    narrowest_base: ClassVar[float] = 2.0

    vertices: Floats
    triangles: Integers

    @cached_property
    def centres(self) -> Floats:
        """Centroids (mm), shape (m, 3)."""
        return np.asarray(self.vertices[self.triangles].mean(axis=1))

    @cached_property
    def areas(self) -> Floats:
        """Areas (mm²), shape (m,)."""
        return triangle_areas(self.vertices, self.triangles)

    @cached_property
    def normals(self) -> Floats:
        """Unit normals out of the tissue, shape (m, 3)."""
        return unit(triangle_normals(self.vertices, self.triangles))

    @cached_property
    def edges(self) -> tuple[Integers, Integers]:
        """Triangles on both sides of each edge (e, 2), and the edge's vertices (e, 2)."""
        edges = np.sort(directed_edges(self.triangles), axis=1)
        order = np.lexsort(edges.T)
        owner = np.repeat(np.arange(len(self.triangles)), 3)[order]
        return owner.reshape(-1, 2), edges[order][::2]

    @cached_property
    def lengths(self) -> Floats:
        """Length of each edge (mm), shape (e,)."""
        return edge_lengths(self.vertices, self.edges[1])

    @cached_property
    def smooth_normals(self) -> Floats:
        """Unit normals averaged over 1 mm, shape (m, 3)."""
        system = diags_array(self.areas) + self.laplacian(np.ones(len(self.lengths)))
        solved = splu(csc_array(system)).solve(self.areas[:, np.newaxis] * self.normals)
        return unit(np.asarray(solved))

    @cached_property
    def crease_weights(self) -> Floats:
        """Weight of each edge (e,): 1 between triangles in a plane, nearly 0 across a crease."""
        ahead, behind = self.normals[self.edges[0][:, 0]], self.normals[self.edges[0][:, 1]]
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", ahead, behind), -1.0, 1.0))
        # 1/e at 0.5 rad; the minimum keeps the graph connected across sharp edges
        return np.asarray(np.maximum(np.exp(-((angle / 0.5) ** 2)), 1e-4))

    def laplacian(self, weights: Floats) -> csr_array:
        """Finite-volume Laplacian on triangles, its fluxes times a weight for each edge."""
        pair = self.edges[0]
        between = np.linalg.norm(self.centres[pair[:, 0]] - self.centres[pair[:, 1]], axis=1)
        conductance = weights * self.lengths / np.maximum(between, 1e-3 * self.lengths.mean())
        count = len(self.triangles)
        half = coo_array((conductance, (pair[:, 0], pair[:, 1])), shape=(count, count)).tocsr()
        adjacency = csr_array(half + half.T)
        return csr_array(diags_array(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency)

    def components(self, chosen: Booleans) -> Integers:
        """Number the connected pieces of chosen triangles, the largest area first; -1 elsewhere."""
        pair = self.edges[0][chosen[self.edges[0]].all(axis=1)]
        piece = components_of(pair, len(self.triangles))
        area = np.bincount(piece, np.where(chosen, self.areas, 0.0))
        rank = np.argsort(np.argsort(-area, kind="stable"), kind="stable")
        return np.where(chosen, rank[piece], -1)

    def random_walker(self, seeds: Integers, labels: int) -> Integers:
        """Label every triangle by the seeds that a random walker from it most likely meets first.

        The walker goes along the surface and seldom crosses creases (Grady 2006, IEEE Trans Pattern
        Anal Mach Intell 28:1768-1783). Seeds (m,) are labels, or -1 where a triangle has none.
        """
        free, fixed = np.flatnonzero(seeds < 0), np.flatnonzero(seeds >= 0)
        if not free.size:
            return seeds
        laplacian = self.laplacian(self.crease_weights)
        arrivals = np.eye(labels)[seeds[fixed]]
        inner = splu(csc_array(laplacian[free][:, free]))
        chance = inner.solve(np.asarray(-(laplacian[free][:, fixed] @ arrivals)))
        result = seeds.copy()
        result[free] = np.argmax(chance, axis=1)
        return result


def openness(graph: DualGraph, progress: StageProgress = no_progress) -> Floats:
    """Openness of each triangle (m,): 1 minus its ambient occlusion, weighted by Lambert's cosine.

    It is the share of rays over the half space in front of a triangle that do not meet the surface
    again: 1 on a plane, nearly 0 in a well. (`igl.ambient_occlusion` has no cosine, draws its rays
    at random, so that labels differ from run to run, and takes three times as long.)
    """
    count, samples, rays, chunk = len(graph.triangles), 6000, 48, 500
    chosen = np.arange(count)
    if count > samples:  # the others take the mean of the nearest samples
        share = graph.areas / graph.areas.sum()
        chosen = np.random.default_rng(0).choice(count, samples, replace=False, p=share)
    tree = igl.AABB()
    tree.init(graph.vertices, graph.triangles)
    # directions about z by the cosine law: a sunflower's seeds, projected onto the half sphere
    radius = np.sqrt((np.arange(rays) + 0.5) / rays)
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(rays)
    x, y, z = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)
    directions = np.stack([x, y, z], axis=1)
    unobstructed = np.empty(len(chosen))
    for start in range(0, len(chosen), chunk):
        some = chosen[start : start + chunk]
        normals = graph.normals[some]
        first = unit(np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)]))
        frames = np.stack([first, np.cross(normals, first), normals], axis=1)
        towards = np.ascontiguousarray(np.einsum("rk,skj->srj", directions, frames).reshape(-1, 3))
        origins = np.repeat(graph.centres[some] + 1e-3 * normals, rays, axis=0)
        met, _, _ = tree.intersect_ray_first(graph.vertices, graph.triangles, origins, towards)
        unobstructed[start : start + chunk] = (met.reshape(-1, rays) < 0).mean(axis=1)
        progress(min(start + chunk, len(chosen)), len(chosen))
    # the mean of the four nearest samples that face the same way, not those across a thin wall: a
    # difference between unit normals counts as 10 mm
    place = np.hstack([graph.centres, 10.0 * graph.smooth_normals])
    _, nearest = cKDTree(place[chosen]).query(place, k=4)
    return np.asarray(unobstructed[nearest].mean(axis=1))


class SurfacePart(IntEnum):
    """Parts of a surface while it is divided; the base lies between all others.

    The first cavity has the larger area.
    """

    FIRST = 0
    SECOND = 1
    OUTER = 2
    BASAL = 3


def smoothed_regions(graph: DualGraph, regions: Integers) -> Integers:
    """Regions of triangles (m,) with borders that are as smooth as the triangles allow.

    Cavities and outer surface are smoothed separately, so that a narrow base between them stays;
    the outer surface then keeps the width of the base away from the cavities.
    """
    parts = (SurfacePart.FIRST, SurfacePart.SECOND, SurfacePart.OUTER)
    shares = [_smoothed(graph, regions == part) for part in parts]
    smooth: Integers = np.argmax([*shares, np.full(len(regions), 0.5)], axis=0)
    sides = smooth[graph.edges[0]]
    ends = (sides[:, 0] != sides[:, 1]) & (sides < SurfacePart.OUTER).any(axis=1)
    if not ends.any():
        return smooth
    line = graph.vertices[graph.edges[1][ends]]
    distance, _ = cKDTree(np.concatenate([line[:, 0], line.mean(axis=1)])).query(graph.centres)
    near = (smooth == SurfacePart.OUTER) & (distance < graph.narrowest_base)
    return np.where(near, SurfacePart.BASAL, smooth)


def cut_along_borders(surface: LabelledSurface, edge_length: float = 0.0) -> LabelledSurface:
    """Divide the triangles of a surface so that borders need not follow their edges.

    The surface is closed, with `Label.BASE` between the other labels. The base becomes nowhere
    narrower than 2 mm, or the edge length (mm) that the surface is to be meshed with.
    """
    for part in (*ENDOCARDIA, Label.EPICARDIUM):
        inside = surface.labels == part
        graph = DualGraph(surface.vertices, surface.triangles)
        # a function of the vertices that is positive inside and zero on the smooth border
        corners, count = graph.triangles.ravel(), len(graph.vertices)
        weights = np.repeat(graph.areas, 3)
        share = np.repeat(_smoothed(graph, inside) - 0.5, 3)
        level = np.bincount(corners, weights * share, count) / np.bincount(corners, weights, count)
        if part == Label.EPICARDIUM:
            rims = [boundary_loops(surface.having(label)) for label in ENDOCARDIA]
            rim = np.concatenate([loop for loops in rims for loop in loops])
            away, _ = cKDTree(surface.vertices[rim]).query(surface.vertices)
            level = np.minimum(level, away / max(graph.narrowest_base, edge_length) - 1)
        vertices, triangles, parent, side = cut_at_zero(graph.vertices, graph.triangles, level)
        before = surface.labels[parent]
        outside = np.where(before == part, Label.BASE, before)
        labels = np.where(side > 0, part, outside)
        surface = LabelledSurface(vertices, triangles, labels, surface.name)
    return surface


def _smoothed(graph: DualGraph, chosen: Booleans) -> Floats:
    """Share of the surface about each triangle that is chosen, shape (m,).

    It is the characteristic function after an implicit step of diffusion that hardly crosses
    creases: its level ½ is the border without teeth (Merriman, Bence and Osher 1992, Diffusion
    generated motion by mean curvature), and a border that follows a crease stays there.
    """
    reach = max(2.5, 1.5 * float(graph.lengths.mean()))  # mm over which a border is smoothed
    system = diags_array(graph.areas) + reach**2 * graph.laplacian(graph.crease_weights)
    return np.asarray(splu(csc_array(system)).solve(graph.areas * chosen))


def cut_at_zero(
    vertices: Floats, triangles: Integers, values: Floats
) -> tuple[Floats, Integers, Integers, Integers]:
    """Divide the triangles that the zero level of a function, given at the vertices, crosses.

    Returns vertices, triangles (m, 3), the old triangle that each is part of (m,), and its side
    (m,): 1 where the function is positive, -1 where negative.
    """
    import pyvista as pv

    near = 0.15  # share of an edge; a line that passes a vertex this closely is moved onto it
    edges, _ = unique_edges(triangles)
    first, second = values[edges].T
    crossing = first * second < 0
    share = np.divide(first, first - second, out=np.full(len(edges), 0.5), where=crossing)
    surface = pv.PolyData.from_regular_faces(vertices, triangles)
    surface["level"] = values
    surface["level"][np.r_[edges[share < near, 0], edges[share > 1 - near, 1]]] = 0.0
    surface.cell_data["parent"] = np.arange(len(triangles))
    parts = [part.triangulate() for part in surface.clip_scalar(scalars="level", both=True)]
    for part, side in zip(parts, (-1, 1), strict=True):
        part.cell_data["side"] = np.full(part.n_cells, side)
    cut = pv.merge(parts)
    corners = merged_vertices(np.asarray(cut.points))[cut.regular_faces]
    whole = whole_triangles(corners)  # VTK leaves some of no area on the line
    parent, sides = (np.asarray(cut.cell_data[name])[whole] for name in ("parent", "side"))
    return *without_unused_vertices(np.asarray(cut.points), corners[whole]), parent, sides
