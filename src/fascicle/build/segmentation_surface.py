"""From a label map to the closed, labelled surface of the ventricles."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from scipy.ndimage import binary_fill_holes, label, map_coordinates

from fascicle.build.level_sets import (
    BasePlane,
    Grid,
    closed_by,
    find_base_plane,
    grid_below,
    level_set,
)
from fascicle.build.segmentation import (
    Masks,
    Segmentation,
    SegmentationLabels,
    blood_faces,
    masks_of,
)
from fascicle.build.surface_checks import Volumes
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledSurface
from fascicle.mesh.meshing import marching_cubes
from fascicle.mesh.topology import boundary_loops, unique_edges, without_unused_vertices


class _Levels(NamedTuple):
    """Signed distances to epicardium and both endocardia at a grid's nodes, below the base.

    `gaps` is the distance to the epicardium before holes in the wall were closed.
    """

    outer: Floats
    lv: Floats
    rv: Floats
    gaps: Floats


def surface_from_segmentation(
    segmentation: Segmentation,
    labels: SegmentationLabels,
    progress: StageProgress = no_progress,
    notes: list[str] | None = None,
    edge_length: float = 2.0,
) -> tuple[LabelledSurface, Volumes]:
    """Extract the surface of the ventricles from a label map, cut flat at the base.

    Each part (the LV's blood, the RV's, and all with the tissue) becomes a smooth function on a
    grid whose top layer is the base plane; the tissue lies where the largest of outer, −LV and −RV
    is negative, and its surface is found by marching cubes (Lorensen and Cline, SIGGRAPH Comput
    Graph 21:163–169, 1987). Triangles end on the plane, so the borders of the base are sharp.
    Where less than 80 % of the RV's blood has tissue around it, as in maps of the LV myocardium
    alone, a wall is added, of 3 mm or as thick as two elements of the later mesh (edge length in
    mm) need, up to 5 mm. Each decision adds a line to the notes.

    The surface is closed, in the segmentation's frame (mm), with edges near 1 mm: the base is an
    annulus with two holes, the endocardia and the epicardium are disks. The volumes are those
    of the label map and the added wall, which the surface should have.
    """
    notes = notes if notes is not None else []
    longest = 15.0  # mm; short-axis slices are 6 to 10 mm thick, with gaps of up to 4 mm
    if (thickest := float(segmentation.spacing.max())) > longest:
        raise InputError(
            f"{segmentation.name}: voxels up to {thickest:.3g} mm long; give a map with slices at "
            f"most {longest:g} mm apart"
        )
    masks = masks_of(segmentation, labels, notes)
    counts = (float(part.sum()) for part in (masks.lv, masks.rv, masks.tissue))
    map_volumes = Volumes(*(count * segmentation.voxel_volume / 1e3 for count in counts))
    masks = _coarsened(masks)
    progress(1, 6)
    plane = find_base_plane(masks)
    _check_apex(masks, plane)
    grid = grid_below(plane, masks)
    progress(2, 6)
    lv = level_set(masks.lv, masks, plane, grid)
    rv = level_set(masks.rv, masks, plane, grid)
    progress(3, 6)
    filled = binary_fill_holes(masks.lv | masks.rv | masks.tissue)
    outer = level_set(filled, masks, plane, grid)
    progress(4, 6)
    walled, added = _with_rv_wall(masks, plane, outer, rv, edge_length, notes)
    levels = _walled(lv, rv, walled)
    layers = _base_layer(levels, masks.name)
    below = (grid.shape[2] - layers) * grid.edge
    voxel = abs(np.linalg.det(masks.affine[:3, :3])) / 1e3
    above = [
        f"{voxel * int((plane.height(masks.positions(mask)) > -below).sum()):.1f} ml of {part}"
        for mask, part in ((masks.lv, "LV blood"), (masks.rv, "RV blood"))
    ]
    notes.append(
        f"{masks.name}: cut at {plane.how}, {below:g} mm below it; {' and '.join(above)} lie above"
    )
    _check_septum(masks, plane, -below, notes)
    progress(5, 6)
    levels = _Levels(*(part[:, :, :layers] for part in levels))
    surface = _closed_surface(levels, grid, masks.name, notes)
    progress(6, 6)
    return surface, map_volumes._replace(myocardium=map_volumes.myocardium + added)


def _check_septum(masks: Masks, plane: BasePlane, top: float, notes: list[str]) -> None:
    """Refuse a large hole in the septum, below a height (mm); a small one is closed, with a note.

    Activation would be conducted across it.
    """
    largest = 100.0  # mm²
    faces = blood_faces(masks, masks.lv, masks.rv)
    hole = faces.shared & (plane.height(faces.centres) < top)
    if not hole.any():
        return
    area = float(np.linalg.norm(faces.areas[hole].sum(axis=0)))
    where = "({:.0f}, {:.0f}, {:.0f})".format(*faces.centres[hole].mean(axis=0))
    touching = f"{masks.name}: LV and RV blood touch over {area:.0f} mm² about {where} mm"
    if area > largest:
        raise InputError(
            f"{touching}, more than {largest:.0f}; label the septum there: a defect of that size "
            "is not modelled"
        )
    notes.append(f"{touching}, where a thin wall that conducts was put between them")


def _check_apex(masks: Masks, plane: BasePlane) -> None:
    faces = blood_faces(masks, masks.lv, masks.rv)
    up = faces.areas @ plane.normal
    apical = -float(up[faces.free & (up < 0)].sum())
    if apical > 0.25 * float(np.abs(up).sum()) / 2:  # share of the area projected along the axis
        raise InputError(
            f"{masks.name}: the LV blood ends at the apex in an opening of {apical / 100:.1f} cm² "
            "without tissue, so the map is truncated there; add the missing slices, or label "
            "tissue below it"
        )


def _coarsened(masks: Masks) -> Masks:
    """Take every other (third, …) voxel of maps that are finer than the surface can be."""
    spacing = np.linalg.norm(masks.affine[:3, :3], axis=0)
    stride = np.maximum(np.floor(Grid.edge / spacing * (1 + 1e-6)), 1).astype(np.int64)
    if (stride == 1).all():
        return masks
    take = tuple(slice(n // 2, None, n) for n in stride)
    affine = masks.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ (stride // 2)
    affine[:3, :3] *= stride
    lv, rv, tissue = (np.pad(mask[take], 1) for mask in (masks.lv, masks.rv, masks.tissue))
    affine[:3, 3] -= affine[:3, :3].sum(axis=1)
    return Masks(lv, rv, tissue, affine, masks.name)


def _with_rv_wall(
    masks: Masks, plane: BasePlane, outer: Floats, rv: Floats, edge_length: float, notes: list[str]
) -> tuple[Floats, float]:
    """Distance to the epicardium, with a wall around the RV if a fifth of its blood has none.

    The second result is the volume of the wall (ml).
    """
    faces = blood_faces(masks, masks.rv, masks.lv)
    deep = plane.height(faces.voxels) < -masks.thickness(plane.normal)
    size = np.linalg.norm(faces.areas, axis=1) * deep
    bare_area, area = float(size[faces.free].sum()), float(size.sum())
    if area == 0 or bare_area < 0.2 * area:
        return outer, 0.0
    # a little more than `check_edge_length` demands, within the range of RV walls, 3 to 5 mm (Ho
    # and Nihoyannopoulos, Heart 92 Suppl 1:i2–i13, 2006)
    thickness = float(np.clip(1.05 * np.sqrt(2) * edge_length, 3.0, 5.0))
    # between thick slices the interpolated distance is too small where contours move far
    wall, near = rv - thickness, (rv > 0) & (rv < 2 * thickness)
    nodes = np.argwhere(near).astype(np.float64)
    square = igl.point_mesh_squared_distance(nodes, *marching_cubes(rv))[0]
    wall[near] = np.sqrt(square) * Grid.edge - thickness
    # rounded where it meets the LV, as the interventricular groove is; elsewhere the two are
    # further apart than the wall is thick
    fillet = np.maximum(thickness - np.abs(outer - wall), 0) ** 2 / (4 * thickness)
    walled = np.minimum(outer, wall) - fillet
    added = float(((walled < 0) & (outer >= 0) & (rv >= 0)).sum()) * Grid.edge**3 / 1e3
    notes.append(
        f"{masks.name}: {bare_area / area:.0%} of the RV blood borders on no tissue, so an RV wall "
        f"of {thickness:.2g} mm was added ({added:.1f} ml, which the input lacks)"
    )
    return np.asarray(walled), added


def _walled(lv: Floats, rv: Floats, gaps: Floats) -> _Levels:
    """Close holes in the septum and in the free walls."""
    thinnest = 1.5 * Grid.edge  # thinner walls have holes on a grid of this edge
    rv = np.maximum(rv, thinnest - lv)
    return _Levels(np.minimum(gaps, np.minimum(lv, rv) - thinnest), lv, rv, gaps)


def _base_layer(levels: _Levels, name: str) -> int:
    """Number of layers up to the highest section that opens both cavities within whole walls."""
    areas = [(part < 0).sum(axis=(0, 1)) for part in (levels.lv, levels.rv)]
    occupied = np.flatnonzero(areas[0] + areas[1])
    top = levels.outer.shape[2] - 1
    first = ""
    for k in range(top, int(top - 0.5 * (top - occupied[0])), -1):  # sections of the upper half
        wrong = _wrong_with_section(levels, k, areas)
        if not wrong:
            return k + 1
        first = first or wrong
    raise InputError(
        f"{name}: no plane across the LV cuts both ventricles open with complete walls (at the "
        f"base, {first}); correct the labels near the base, or cut the map off below it"
    )


def _wrong_with_section(levels: _Levels, k: int, areas: list[Integers]) -> str:
    """Reason that a layer cannot be the base; empty if it can.

    A cavity must be open there, in a nearly complete wall, as `BasePlane` has it.
    """
    outer = levels.outer[:, :, k] < 0
    if label(outer)[1] != 1:
        return f"the section has {label(outer)[1]} pieces"
    tissue = outer.copy()
    for side, cavity, area in zip(("LV", "RV"), (levels.lv, levels.rv), areas, strict=True):
        blood = cavity[:, :, k] < 0
        if area[k] < BasePlane.least_open * area.max():
            return f"the {side} is closed or small"
        if label(blood)[1] != 1:
            return f"the {side} has {label(blood)[1]} openings"
        border = (cavity[:, :, k] >= 0) & (cavity[:, :, k] < Grid.edge)
        bare = float((levels.gaps[:, :, k][border] > 0).mean())
        if bare > BasePlane.most_bare:
            return f"{bare:.0%} of the {side} has no wall"
        tissue &= ~blood
    openings = int(label(~tissue)[1]) - 1
    return "" if openings == 2 else f"the section has {openings} openings"


def _closed_surface(levels: _Levels, grid: Grid, name: str, notes: list[str]) -> LabelledSurface:
    """Extract the surface; mend the cavities until the endocardia are disks.

    A cavity with handles is opened with the first ball, which removes threads of blood, then closed
    with larger and larger balls, which fills gaps around papillary muscles, until no handle is
    left.
    """
    attempts, balls = dict.fromkeys(ENDOCARDIA, 0), (1.5, 2.0, 4.0, 6.0)  # mm, radius

    def mended(cavity: Floats, attempt: int) -> Floats:
        if attempt == 1:
            return -closed_by(-cavity, balls[0], grid.edge)
        return closed_by(cavity, balls[attempt - 1], grid.edge) if attempt else cavity

    while True:
        lv, rv = map(mended, (levels.lv, levels.rv), attempts.values())
        walled = _walled(lv, rv, levels.gaps) if any(attempts.values()) else levels
        surface = _extract(walled, grid, name)
        if (wrong := _wrong_topology(surface)) is None:
            break
        part, fault = wrong
        if attempts.get(part, len(balls)) == len(balls):
            raise InputError(
                f"{name}: {fault}; fill holes in the walls and take papillary muscles and "
                "trabeculae that cross the cavities out of the myocardium"
            )
        attempts[part] += 1
    for kind, attempt in attempts.items():
        if attempt:
            gap = 2 * balls[attempt - 1]
            how = f"gaps up to {gap:g} mm wide around papillary muscles were filled"
            if attempt == 1:
                how = "threads of blood were taken away"
            notes.append(f"{name}: {kind.words}: {how}, to leave no handles")
    return surface


def _extract(levels: _Levels, grid: Grid, name: str) -> LabelledSurface:
    """Extract the tissue's surface by marching cubes, with an empty layer put on top."""
    tissue = np.maximum(np.maximum(levels.outer, -levels.lv), -levels.rv)
    snap = 0.05 * grid.edge  # least distance of a node from the surface, which avoids slivers
    near = np.abs(tissue) < snap
    tissue[near] = np.where(tissue[near] < 0, -snap, snap)
    top = tissue.shape[2] - 1
    far = np.full((*tissue.shape[:2], 1), 1e9)
    vertices, triangles = marching_cubes(np.concatenate([tissue, far], axis=2))
    _, pieces = igl.facet_components(triangles)
    if (sizes := np.bincount(pieces)).max() < 0.99 * len(triangles):
        listed = ", ".join(str(size) for size in np.sort(sizes)[::-1])
        raise InputError(
            f"{name}: the surface of the tissue falls into {len(sizes)} pieces ({listed} triangles)"
            "; correct the labels so that the tissue is in one piece and without closed holes"
        )
    largest = np.asarray(triangles[pieces == sizes.argmax()])
    vertices, triangles = without_unused_vertices(vertices, largest)
    # the last vertices lie a millionth of an edge above the plane, for the layer on top
    vertices[:, 2] = np.minimum(vertices[:, 2], top)
    base = (vertices[triangles, 2] == top).all(axis=1)
    middle = vertices[triangles].mean(axis=1).T
    parts = (levels.outer, -levels.lv, -levels.rv)
    active = [map_coordinates(part, middle, order=1) for part in parts]
    labels = np.array([Label.EPICARDIUM, *ENDOCARDIA])[np.argmax(active, axis=0)]
    labels[base] = Label.BASE
    return LabelledSurface(grid.positions(vertices), triangles, labels.astype(np.int64), name)


def _wrong_topology(surface: LabelledSurface) -> tuple[Label, str] | None:
    """First part of a surface whose topology is not that of two ventricles, and its fault."""
    for part in (*ENDOCARDIA, Label.EPICARDIUM, Label.BASE):
        n_loops = 3 if part == Label.BASE else 1
        part_triangles = surface.having(part)
        loops = len(boundary_loops(part_triangles))
        euler = (
            np.unique(part_triangles).size
            - len(unique_edges(part_triangles)[0])
            + len(part_triangles)
        )
        # a sphere with n holes has Euler characteristic 2 − n, and each handle takes away 2
        if loops != n_loops or euler != 2 - n_loops:
            handles = (2 - loops - euler) // 2
            return part, (
                f"the {part.words} has {loops} borders and {handles} handles, {n_loops} and 0 "
                "needed"
            )
    triangles = surface.triangles
    if not (igl.is_edge_manifold(triangles)[0] and igl.is_vertex_manifold(triangles).all()):
        return Label.EPICARDIUM, "the surface of the tissue touches itself"
    return None
