"""From a label map to the closed, labelled surface of the ventricles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, label, map_coordinates

from fascicle.build.segmentation.base_plane import BasePlane, find_base_plane
from fascicle.build.segmentation.image import (
    Bodies,
    Noted,
    Segmentation,
    SegmentationLabels,
    bodies_of,
)
from fascicle.build.segmentation.level_sets import Grid, closed_by, grid_below, level_set
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.topology import boundary_loops

EDGE = 1.0  # mm, of the cubes that the surface is cut from
# Wall of the RV where none was segmented: it is 3 to 5 mm thick (Ho and Nihoyannopoulos, Heart
# 92 Suppl 1:i2–i13, 2006).
RV_WALL = 3.0  # mm
# The RV has no wall where this fraction of its blood's surface borders on nothing; less are holes.
WALL_MISSING = 0.2
# Thinnest wall and septum that cubes of this edge can tell from a hole.
THINNEST = 1.5 * EDGE  # mm
# A section across the ventricles can be the base if each cavity has this fraction of its largest
# cross-section there, and all but this fraction of its circumference has tissue around it.
OPENING, GAP = 0.3, 0.1
# The base is looked for no lower than this fraction of the ventricles' length.
LOWEST = 0.5
# A cavity with handles is opened with a ball, which takes away threads of blood, then closed with
# larger and larger ones, which fills the gaps around papillary muscles, until none is left.
OPENING_BALL = 1.5  # mm, radius
CLOSING_BALLS = (2.0, 4.0, 6.0)  # mm
# No node lies closer to the surface than this (edges), which keeps slivers away.
SNAP = 0.05
FAR = 1e9  # mm, above the base
STEPS = 6
STRAY = 0.01  # of all triangles; so many may lie outside the largest piece

# Told how many of how many steps are done
Told = Callable[[int, int], None]


@dataclass(frozen=True)
class _Levels:
    """Signed distances to epicardium and both endocardia at a grid's nodes, below the base.

    `gaps` is the distance to the epicardium before holes in the wall were closed.
    """

    outer: NDArray[np.float64]
    lv: NDArray[np.float64]
    rv: NDArray[np.float64]
    gaps: NDArray[np.float64]

    def below(self, layers: int) -> _Levels:
        return _Levels(*(part[:, :, :layers] for part in (self.outer, self.lv, self.rv, self.gaps)))


def surface_from_segmentation(
    segmentation: Segmentation,
    labels: SegmentationLabels,
    told: Told | None = None,
    noted: Noted | None = None,
) -> LabelledSurface:
    """Extract the surface of the ventricles from a label map, cut flat at the base.

    Each body (the LV's blood, the RV's, and all with the tissue) becomes a smooth function on a
    grid whose top layer is the base plane; the tissue lies where the largest of outer, −LV and −RV
    is negative, and its surface is found by marching cubes (Lorensen and Cline, SIGGRAPH Comput
    Graph 21:163–169, 1987). Triangles end on the plane, so the borders of the base are sharp.

    Where less than 80 % of the RV's blood has tissue around it, as in maps of the LV myocardium
    alone, a wall of 3 mm is put around it.

    Parameters
    ----------
    segmentation : Segmentation
        The label map.
    labels : SegmentationLabels
        Which number stands for what.
    told : callable, optional
        Told how many of how many steps are done.
    noted : callable, optional
        Told, in one line each, what was found or changed: islands, an added wall, the base plane,
        mended cavities.

    Returns
    -------
    LabelledSurface
        Closed, in the segmentation's frame (mm), edges near 1 mm. The base is an annulus with two
        holes, the endocardia are disks, and the epicardium is one.

    Raises
    ------
    InputError
        If a label is not in the map, a part falls into pieces, or no plane cuts both cavities open.
    """
    tell = _told_in_turn(told)
    say = noted if noted is not None else _silent
    bodies = _coarsened(bodies_of(segmentation, labels, noted))
    tell()
    plane = find_base_plane(bodies)
    grid = grid_below(plane, bodies, EDGE)
    tell()
    lv = level_set(bodies.lv, bodies, plane, grid)
    rv = level_set(bodies.rv, bodies, plane, grid)
    tell()
    filled = binary_fill_holes(bodies.lv | bodies.rv | bodies.tissue)
    outer = level_set(filled, bodies, plane, grid)
    tell()
    gaps = _with_rv_wall(bodies, plane, outer, rv, say)
    levels = _walled(lv, rv, gaps)
    layers = _base_layer(levels, bodies.name)
    say(f"{bodies.name}: cut at {plane.how}, {(grid.shape[2] - layers) * grid.edge:g} mm below it")
    tell()
    grid = replace(grid, shape=(grid.shape[0], grid.shape[1], layers))
    surface = _closed_surface(levels.below(layers), grid, bodies.name, say)
    tell()
    return surface


def _silent(_: str) -> None:
    pass


def _told_in_turn(told: Told | None) -> Callable[[], None]:
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        if told is not None:
            told(done, STEPS)

    return tell


def _coarsened(bodies: Bodies) -> Bodies:
    """Take every other (third, …) voxel of maps that are finer than the surface can be."""
    spacing = np.linalg.norm(bodies.affine[:3, :3], axis=0)
    every = np.maximum(np.floor(EDGE / spacing * (1 + 1e-6)), 1).astype(np.int64)
    if (every == 1).all():
        return bodies
    take = tuple(slice(n // 2, None, n) for n in every)
    affine = bodies.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ (every // 2)
    affine[:3, :3] *= every
    lv, rv, tissue = (np.pad(mask[take], 1) for mask in (bodies.lv, bodies.rv, bodies.tissue))
    affine[:3, 3] -= affine[:3, :3].sum(axis=1)
    return Bodies(lv, rv, tissue, affine, bodies.name)


def _with_rv_wall(
    bodies: Bodies,
    plane: BasePlane,
    outer: NDArray[np.float64],
    rv: NDArray[np.float64],
    say: Noted,
) -> NDArray[np.float64]:
    """Distance to the epicardium, with a wall around the RV if the map has none."""
    bare = whole = 0.0
    for k in range(3):
        for step in (-1, 1):
            index = np.argwhere(bodies.rv & ~np.roll(bodies.rv, -step, axis=k))
            height = plane.height(index @ bodies.affine[:3, :3].T + bodies.affine[:3, 3])
            index = index[height < -bodies.thickness(plane.normal)]
            index[:, k] += step
            beside = tuple(index.T)
            area = 1 / float(np.linalg.norm(bodies.affine[:3, k]))  # to within a factor for all
            whole += area * len(index)
            bare += area * int((~bodies.tissue[beside] & ~bodies.lv[beside]).sum())
    if whole == 0 or bare < WALL_MISSING * whole:
        return outer
    say(
        f"{bodies.name}: {bare / whole:.0%} of the RV blood borders on no tissue, so an RV wall of "
        f"{RV_WALL:g} mm was added"
    )
    wall = rv - RV_WALL
    # rounded where it meets the LV, as the interventricular groove is; elsewhere the two are
    # further apart than the wall is thick
    fillet = np.maximum(RV_WALL - np.abs(outer - wall), 0) ** 2 / (4 * RV_WALL)
    return np.asarray(np.minimum(outer, wall) - fillet)


def _walled(lv: NDArray[np.float64], rv: NDArray[np.float64], gaps: NDArray[np.float64]) -> _Levels:
    """Close holes in the septum and in the outer walls."""
    rv = np.maximum(rv, THINNEST - lv)
    return _Levels(np.minimum(gaps, np.minimum(lv, rv) - THINNEST), lv, rv, gaps)


def _base_layer(levels: _Levels, name: str) -> int:
    """How many layers are below the highest section that cuts both cavities open, and whole."""
    areas = [(part < 0).sum(axis=(0, 1)) for part in (levels.lv, levels.rv)]
    occupied = np.flatnonzero(areas[0] + areas[1])
    top = levels.outer.shape[2] - 1
    first = ""
    for k in range(top, int(top - LOWEST * (top - occupied[0])), -1):
        wrong = _wrong_with_section(levels, k, areas)
        if not wrong:
            return k + 1
        first = first or wrong
    raise InputError(
        f"{name}: no plane across the LV cuts both ventricles open with complete walls (at the "
        f"base, {first}); correct the labels near the base, or cut the map off below it"
    )


def _wrong_with_section(levels: _Levels, k: int, areas: list[NDArray[np.int64]]) -> str:
    """Why a layer cannot be the base; empty if it can."""
    outer = levels.outer[:, :, k] < 0
    if label(outer)[1] != 1:
        return f"the section has {label(outer)[1]} pieces"
    tissue = outer.copy()
    for side, cavity, area in zip(("LV", "RV"), (levels.lv, levels.rv), areas, strict=True):
        blood = cavity[:, :, k] < 0
        if area[k] < OPENING * area.max():
            return f"the {side} is closed or small"
        if label(blood)[1] != 1:
            return f"the {side} has {label(blood)[1]} openings"
        rim = (cavity[:, :, k] >= 0) & (cavity[:, :, k] < EDGE)
        bare = float((levels.gaps[:, :, k][rim] > 0).mean())
        if bare > GAP:
            return f"{bare:.0%} of the {side} has no wall"
        tissue &= ~blood
    openings = int(label(~tissue)[1]) - 1
    return "" if openings == 2 else f"the section has {openings} openings"


def _closed_surface(levels: _Levels, grid: Grid, name: str, say: Noted) -> LabelledSurface:
    """Extract the surface; mend the cavities where they are not disks."""
    attempts = {Label.LV_ENDOCARDIUM: 0, Label.RV_ENDOCARDIUM: 0}
    cavities = {Label.LV_ENDOCARDIUM: levels.lv, Label.RV_ENDOCARDIUM: levels.rv}
    while True:
        lv, rv = (_mended(cavity, attempts[kind], grid.edge) for kind, cavity in cavities.items())
        tried = _walled(lv, rv, levels.gaps) if any(attempts.values()) else levels
        surface = _extract(tried, grid, name)
        wrong = _wrong_with_topology(surface)
        if not wrong:
            break
        part = next(iter(wrong))
        if attempts.get(part, len(CLOSING_BALLS) + 1) > len(CLOSING_BALLS):
            raise InputError(
                f"{name}: {wrong[part]}; fill holes in the walls and take papillary muscles and "
                "trabeculae that cross the cavities out of the myocardium"
            )
        attempts[part] += 1
    for kind, attempt in attempts.items():
        if attempt:
            gap = 2 * CLOSING_BALLS[attempt - 2]
            how = (
                "threads of blood were taken away"
                if attempt == 1
                else f"gaps up to {gap:g} mm wide around papillary muscles were filled"
            )
            say(f"{name}: {kind.name.replace('_', ' ').lower()}: {how}, to leave no handles")
    return surface


def _mended(cavity: NDArray[np.float64], attempt: int, edge: float) -> NDArray[np.float64]:
    if attempt == 0:
        return cavity
    if attempt == 1:
        return -closed_by(-cavity, OPENING_BALL, edge)
    return closed_by(cavity, CLOSING_BALLS[attempt - 2], edge)


def _extract(levels: _Levels, grid: Grid, name: str) -> LabelledSurface:
    """Marching cubes on the tissue's function, with a layer far outside put on top."""
    tissue = np.maximum(np.maximum(levels.outer, -levels.lv), -levels.rv)
    near = np.abs(tissue) < SNAP * grid.edge
    tissue[near] = np.where(tissue[near] < 0, -SNAP, SNAP) * grid.edge
    top = tissue.shape[2] - 1
    tissue = np.concatenate([tissue, np.full((*tissue.shape[:2], 1), FAR)], axis=2)
    vertices, triangles = _marching_cubes(tissue)
    triangles = _largest_piece(triangles, name)
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], triangles.reshape(-1, 3).astype(np.int64)
    # the last vertices lie a millionth of an edge above the plane, for the layer on top
    vertices[:, 2] = np.minimum(vertices[:, 2], top)
    base = (vertices[triangles, 2] == top).all(axis=1)
    middle = vertices[triangles].mean(axis=1).T
    kinds = (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    active = [
        map_coordinates(part, middle, order=1) for part in (levels.outer, -levels.lv, -levels.rv)
    ]
    labels = np.array(kinds)[np.argmax(active, axis=0)]
    labels[base] = Label.BASE
    return LabelledSurface(grid.positions(vertices), triangles, labels.astype(np.int64), name)


def _marching_cubes(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Surface of {values < 0}, in node indices, with outward normals."""
    inside = values < 0
    corners = np.array(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    )
    shape = np.array(values.shape) - 1
    count = np.zeros(shape, dtype=np.int8)
    for i, j, k in corners:
        count += inside[i : i + shape[0], j : j + shape[1], k : k + shape[2]]
    cells = np.argwhere((count > 0) & (count < len(corners)))
    nodes = np.ravel_multi_index(tuple(np.moveaxis(cells[:, None] + corners, 2, 0)), values.shape)
    used, cubes = np.unique(nodes, return_inverse=True)
    positions = np.stack(np.unravel_index(used, values.shape), axis=1).astype(np.float64)
    vertices, triangles, _ = igl.marching_cubes(
        values.ravel()[used], positions, cubes.reshape(-1, 8).astype(np.int64), 0.0
    )
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    if float(np.einsum("ij,ij->", a, np.cross(b, c))) < 0:
        triangles = triangles[:, ::-1]
    return vertices, np.ascontiguousarray(triangles, dtype=np.int64)


def _largest_piece(triangles: NDArray[np.int64], name: str) -> NDArray[np.int64]:
    _, pieces = igl.facet_components(triangles)
    sizes = np.bincount(pieces)
    if sizes.max() < (1 - STRAY) * len(triangles):
        listed = ", ".join(str(size) for size in np.sort(sizes)[::-1])
        raise InputError(
            f"{name}: the surface of the tissue falls into {len(sizes)} pieces ({listed} triangles)"
            "; correct the labels so that the tissue is in one piece and without closed holes"
        )
    return np.asarray(triangles[pieces == sizes.argmax()])


def _wrong_with_topology(surface: LabelledSurface) -> dict[Label, str]:
    """What keeps parts of a surface from being those of two ventricles, by part."""
    needed = {
        Label.LV_ENDOCARDIUM: 1,
        Label.RV_ENDOCARDIUM: 1,
        Label.EPICARDIUM: 1,
        Label.BASE: 3,
    }
    wrong = {}
    for part, n_loops in needed.items():
        own = surface.having(part)
        loops = len(boundary_loops(own))
        edges = np.unique(np.sort(own[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        euler = np.unique(own).size - len(edges) + len(own)
        # a sphere with n holes has Euler characteristic 2 − n, and each handle takes away 2
        if loops != n_loops or euler != 2 - n_loops:
            handles = (2 - loops - euler) // 2
            wrong[part] = (
                f"the {part.name.replace('_', ' ').lower()} has {loops} borders and {handles} "
                f"handles, {n_loops} and 0 needed"
            )
    triangles = surface.triangles
    whole = igl.is_edge_manifold(triangles)[0] and igl.is_vertex_manifold(triangles).all()
    if not wrong and not whole:
        wrong[Label.EPICARDIUM] = "the surface of the tissue touches itself"
    return wrong
