"""Thick-walled ventricles whose volumes are known, in every kind of file a heart is built from."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import igl
import nibabel
import numpy as np
import pyvista as pv
from scipy.spatial import Delaunay, cKDTree

from fascicle.build.endocardia import endocardia
from fascicle.build.meshing import mesh_surface
from fascicle.build.surface_repair import prepared_surface
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import seeded_endocardia
from fascicle.heart.heart import Atlas, Components, Heart, LeadFields, VentricularCoordinates
from fascicle.heart.labelled_surface import Label, LabelledMesh, LabelledSurface
from fascicle.torso.lead_fields import key_of
from fascicle.torso.surfaces import Surface

EPI, BASE = Label.EPICARDIUM, Label.BASE
LV, RV = Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM
# Half-ellipsoids below z = 0: half-axes, and centre along x (mm). The right cavity is bent around
# the left one by a shear, which leaves its volume as it is.
HALF_AXES = {EPI: (55.5, 38.0, 68.0), LV: (20.0, 20.0, 52.0), RV: (18.0, 25.0, 48.0)}
CENTRE_X = {EPI: 22.5, LV: 0.0, RV: 49.0}  # mm
BEND = {EPI: 0.0, LV: 0.0, RV: 1 / 40}  # 1/mm
SUBDIVISIONS = 4  # of the four triangles of a half octahedron
BASE_EDGE = 5.0  # mm

EDGE = 8.0  # mm; walls of 12 mm have room for two
FINER = 5.0  # mm
COARSER = 10.0  # mm, for which they have none
# About where the idealised torso around these ventricles has its electrodes (mm)
PLACES = {
    "RA": (157, 28, 153), "LA": (-47, 165, -3), "LL": (-2, -172, -286),
    "V1": (117, 9, -36), "V2": (82, 33, -63), "V3": (56, 33, -90),
    "V4": (26, 31, -114), "V5": (-33, 40, -123), "V6": (-98, 21, -96),
}  # fmt: skip
NETWORK = {
    "lv_initial_length": 25.0, "rv_initial_length": 25.0,
    "lv_fascicle_length_1": 10.0, "lv_fascicle_length_2": 12.0,
    "rv_fascicle_length_1": 12.0, "rv_fascicle_length_2": 10.0,
    "lv_fascicle_angle_1": 0.9, "lv_fascicle_angle_2": -0.6,
    "rv_fascicle_angle_1": 0.7, "rv_fascicle_angle_2": -0.4,
    "root_time": 0.0, "cv": 2.5,
}  # fmt: skip

# A sphere around a point outside the left ventricle's free wall
SCAR_CENTRE, SCAR_RADIUS = np.array([-32.0, 0.0, -22.0]), 24.0  # mm
NUMBERS = {LV: 1, RV: 2, EPI: 3}  # of blood and muscle in segmentations
SCAR = 4
VOXEL = 2.0  # mm


def volume_below(label: Label) -> float:
    """Exact volume of a half-ellipsoid (ml)."""
    return float(2 / 3 * np.pi * np.prod(HALF_AXES[label])) / 1000


MYOCARDIUM = volume_below(EPI) - volume_below(LV) - volume_below(RV)  # ml


def enclosed(label: Label, points: np.ndarray) -> np.ndarray:
    """Which points lie within an ellipsoid, above the base too."""
    straight = points - [CENTRE_X[label], 0, 0]
    straight[..., 0] += BEND[label] * points[..., 1] ** 2
    return ((straight / HALF_AXES[label]) ** 2).sum(axis=-1) < 1


def in_wall(points: np.ndarray) -> np.ndarray:
    """Which points lie in the myocardium, below the base or above it."""
    return enclosed(EPI, points) & ~enclosed(LV, points) & ~enclosed(RV, points)


def half_ellipsoid(label: Label) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of one, counter-clockwise seen from outside; the rim is at z = 0."""
    corners = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1.0]])
    faces = np.array([[0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]])
    points, faces = igl.upsample(corners, faces, SUBDIVISIONS)
    points = points / np.linalg.norm(points, axis=1, keepdims=True) * HALF_AXES[label]
    points[:, 0] += CENTRE_X[label] - BEND[label] * points[:, 1] ** 2
    points[np.abs(points[:, 2]) < 1e-9, 2] = 0.0
    return points, np.asarray(faces, dtype=np.int64)


def _base(rims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 2), the rims' first, and triangles of the flat base between three rims."""
    rows = np.arange(-40, 41, BASE_EDGE * np.sqrt(0.75))
    grid = np.stack(np.meshgrid(np.arange(-40, 85, BASE_EDGE), rows), axis=-1)
    grid[1::2, :, 0] += BASE_EDGE / 2
    inner = grid.reshape(-1, 2)
    inner = inner[in_wall(np.column_stack([inner, np.zeros(len(inner))]))]
    inner = inner[cKDTree(rims).query(inner)[0] > 0.6 * BASE_EDGE]
    points = np.concatenate([rims, inner])
    triangles = Delaunay(points).simplices
    middle = points[triangles].mean(axis=1)
    triangles = triangles[in_wall(np.column_stack([middle, np.zeros(len(middle))]))]
    a, b, c = points[triangles].transpose(1, 0, 2)
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return points, triangles


@cache
def ventricles() -> LabelledSurface:
    """The closed surface; its points are single precision, as STL has them, and in its order."""
    parts = {label: half_ellipsoid(label) for label in HALF_AXES}
    first = np.cumsum([0, *(len(points) for points, _ in parts.values())])
    points = np.concatenate([points for points, _ in parts.values()])
    faces = [
        triangles + start for (_, triangles), start in zip(parts.values(), first, strict=False)
    ]
    faces[1:] = [cavity[:, ::-1] for cavity in faces[1:]]  # normals leave the tissue
    rims = np.flatnonzero(points[:, 2] == 0)
    flat, triangles = _base(points[rims, :2])
    number = np.concatenate([rims, len(points) + np.arange(len(flat) - len(rims))])
    points = np.concatenate([points, np.column_stack([flat, np.zeros(len(flat))])[len(rims) :]])
    faces.append(number[triangles])
    triangles = np.concatenate(faces)
    used, order = np.unique(triangles, return_index=True)
    used = used[np.argsort(order)]
    renumbered = np.empty(len(points), dtype=np.int64)
    renumbered[used] = np.arange(len(used))
    labels = np.repeat([*parts, BASE], [len(part) for part in faces]).astype(np.int64)
    return LabelledSurface(
        points[used].astype(np.float32).astype(float), renumbered[triangles], labels, "ventricles"
    )


@cache
def tissue(edge_length: float = EDGE) -> LabelledMesh:
    """Tetrahedra of the ventricles."""
    return mesh_surface(prepared_surface(ventricles()), edge_length)


def circular_fibres(mesh: LabelledMesh) -> np.ndarray:
    """Unit directions around the z axis through the middle, one a tetrahedron."""
    x, y, _ = (mesh.vertices[mesh.tetrahedra].mean(axis=1) - [CENTRE_X[EPI], 0, 0]).T
    around = np.column_stack([-y, x, np.zeros(len(x))])
    return around / np.linalg.norm(around, axis=1, keepdims=True)


def heart_on(
    mesh: LabelledMesh | None = None, coordinates: VentricularCoordinates | None = None
) -> Heart:
    """A heart with the endocardia of a mesh, the coarse ventricles if no other is given."""
    mesh = tissue() if mesh is None else mesh
    surfaces = dict(zip(("lv", "rv"), endocardia(mesh), strict=True))
    named = {side: (side, *surface) for side, surface in surfaces.items()}
    sides = seeded_endocardia(named, dict.fromkeys(named, (None, None)))
    electrodes = np.array([*PLACES.values()], dtype=float)
    fibres = circular_fibres(mesh)
    return Heart(
        mesh.vertices, mesh.tetrahedra, fibres, *sides, electrodes, coordinates=coordinates
    )


def halves(mesh: LabelledMesh) -> np.ndarray:
    """A region for each tetrahedron: 1 or 2 by the side of y = 0."""
    return 1 + (mesh.vertices[mesh.tetrahedra].mean(axis=1)[:, 1] > 0)


def write_electrodes(path: Path, places=PLACES) -> Path:
    """Electrodes, the nine standard ones if no others are given, as CSV."""
    rows = [",".join(map(str, [name, *place])) for name, place in places.items()]
    path.write_text("\n".join(["name,x,y,z", *rows]) + "\n")
    return path


def write_surface(path: Path, points=None, triangles=None, **arrays) -> Path:
    """A surface, the ventricles' if no other is given, with arrays of its triangles."""
    points = ventricles().vertices if points is None else points
    triangles = ventricles().triangles if triangles is None else triangles
    if path.suffix == ".obj":
        lines = ["v " + " ".join(map(repr, row)) for row in np.asarray(points).tolist()]
        lines += ["f " + " ".join(map(str, row)) for row in (np.asarray(triangles) + 1).tolist()]
        path.write_text("\n".join(lines) + "\n")
        return path
    data = pv.PolyData.from_regular_faces(np.asarray(points), np.asarray(triangles))
    for name, values in arrays.items():
        data.cell_data[name] = values
    data.save(path)
    return path


def write_labelled(path: Path, points=None, labels=None) -> Path:
    """The ventricles with their labels in the array `class`."""
    labels = ventricles().labels if labels is None else labels
    return write_surface(path, points, **{"class": labels})


def write_parts(folder: Path, gap: float = 0.0) -> dict[str, Path]:
    """One STL file for each label; the base lies `gap` mm beside the others' rims."""
    whole, files = ventricles(), {}
    names = {LV: "lv-endocardium", RV: "rv-endocardium", EPI: "epicardium", BASE: "base"}
    for label, name in names.items():
        used, corners = np.unique(whole.having(label), return_inverse=True)
        points = whole.vertices[used] + gap * np.array([0.6, 0.8, 0.0]) * (label == BASE)
        files[name] = write_surface(folder / f"{name}.stl", points, corners.reshape(-1, 3))
    return files


def options_of(files: dict[str, Path], without: str = "") -> list[object]:
    """Options of `heart build` that name parts."""
    return [word for name, file in files.items() if name != without for word in (f"--{name}", file)]


def in_scar(mesh: LabelledMesh) -> np.ndarray:
    """Region 1 where the middle of a tetrahedron lies in the scar, else 0."""
    middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    return (np.linalg.norm(middle - SCAR_CENTRE, axis=1) < SCAR_RADIUS).astype(np.int64)


def write_vtu(
    path: Path, *, labelled: bool, scar: bool = False, labels=None, vertices=None
) -> Path:
    """Tetrahedra, perhaps with their labelled boundary, perhaps with a region of scar."""
    mesh = tissue()
    labels = mesh.labels if labels is None else labels
    vertices = mesh.vertices if vertices is None else vertices
    blocks = {pv.CellType.TETRA: mesh.tetrahedra}
    if labelled:
        blocks = {pv.CellType.TRIANGLE: mesh.triangles, **blocks}
    grid = pv.UnstructuredGrid(blocks, vertices)
    if labelled:
        none = np.zeros(len(mesh.tetrahedra), dtype=np.int64)
        grid.cell_data["label"] = np.concatenate([labels, none])
    if scar:
        none = np.zeros(grid.n_cells - len(mesh.tetrahedra), dtype=np.int64)
        grid.cell_data["region"] = np.concatenate([none, in_scar(mesh)])
    grid.save(path)
    return path


@cache
def label_map(voxel: float = VOXEL) -> tuple[np.ndarray, np.ndarray]:
    """Labels of voxels, whose uppermost layer ends at the base, and the affine from index to mm."""
    first, last = np.array([-36.0, -42.0, -74.0]), np.array([82.0, 42.0, 0.0])
    axes = [np.arange(a + voxel / 2, b, voxel) for a, b in zip(first, last, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    labels = np.where(in_wall(points), NUMBERS[EPI], 0)
    scar = np.linalg.norm(points - SCAR_CENTRE, axis=-1) < SCAR_RADIUS
    labels[(labels > 0) & scar] = SCAR
    for cavity in (LV, RV):
        labels[enclosed(cavity, points)] = NUMBERS[cavity]
    affine = np.diag([voxel, voxel, voxel, 1.0])
    affine[:3, 3] = first + voxel / 2
    return np.pad(labels, ((0, 0), (0, 0), (0, 3))).astype(np.int16), affine


@cache
def scar_volume() -> float:
    """Volume of the scar (ml), by a fine midpoint rule."""
    labels, _ = label_map(0.75)
    return float((labels == SCAR).sum()) * 0.75**3 / 1000


def write_nifti(path: Path, labels=None, factor: float = 1.0) -> Path:
    """The label map in RAS+, its last voxel axis running down."""
    own, affine = label_map()
    labels = own if labels is None else labels
    turned = affine.copy()
    turned[:3, 3] += affine[:3, 2] * (labels.shape[2] - 1)
    turned[:3, 2] *= -1
    turned[:3] *= factor
    image = nibabel.Nifti1Image(np.ascontiguousarray(labels[:, :, ::-1]), turned)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    return path


BODY, BODY_CENTRE = (130.0, 105.0, 150.0), (22.0, 0.0, -30.0)  # half-axes and centre (mm)


def body(half_axes=BODY, centre=BODY_CENTRE, subdivisions: int = 4) -> Surface:
    """A coarse closed ellipsoid, of itself a skin around the ventricles."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    upper = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2)])
    faces = np.concatenate([upper, np.where(upper == 2, 5, upper)[:, ::-1]]).astype(np.int64)
    points, faces = igl.upsample(corners, faces, subdivisions)
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    return Surface(points * np.asarray(half_axes) + np.asarray(centre), faces.astype(np.int64))


def places_on_body() -> dict[str, tuple[float, ...]]:
    """The electrodes, moved towards the middle of that skin onto it."""
    moved = {}
    for name, place in PLACES.items():
        way = np.subtract(place, BODY_CENTRE)
        moved[name] = tuple(BODY_CENTRE + way / np.linalg.norm(way / np.array(BODY)))
    return moved


def write_built_heart(folder: Path) -> Path:
    """Folder of a heart built from the ventricles, with a region of scar in which they conduct."""
    from fascicle.build.build_heart import TorsoOptions, build_heart
    from fascicle.build.read_anatomy import Source
    from fascicle.heart.folder import write_heart

    source = Source(write_vtu(folder / "mesh.vtu", labelled=True, scar=True))
    around = TorsoOptions("none", electrodes=write_electrodes(folder / "electrodes.csv"))
    heart = build_heart(source, torso=around, name="ventricles").heart
    write_heart(replace(heart, example=NETWORK), folder / "heart")
    return folder / "heart"


def atlas_on(heart: Heart) -> Heart:
    """A heart as template of an atlas of two: larger and smaller, each elsewhere, in free space."""
    scales, shifts = (1.06, 0.95), np.array([(30.0, 0.0, 10.0), (0.0, -20.0, 0.0)])
    of_hearts = [heart.vertices * s + shift for s, shift in zip(scales, shifts, strict=True)]
    electrodes = np.array(
        [heart.electrodes * s + shift for s, shift in zip(scales, shifts, strict=True)]
    )
    fields = np.concatenate([_fields(*pair) for pair in zip(of_hearts, electrodes, strict=True)])
    shapes = Components.of(np.array([vertices.ravel() for vertices in of_hearts]), 1)
    tissues, sizes = ({}, {"anisotropy_ratio": 2.0}), {"size": np.array(scales)}
    seeds = np.array([[(e.root, e.direction) for e in heart.endocardia]] * 2)
    fields = Components.of(fields, 18)
    atlas = Atlas(shapes, electrodes, seeds, np.ones(2), fields, tissues, sizes, np.full(2, 0.5))
    key = key_of(heart, Conduction.of(heart))
    template = LeadFields(_fields(heart.vertices, heart.electrodes), key, "")
    return replace(heart, name="atlas", example=NETWORK, lead_fields=template, atlas=atlas)


def _fields(vertices: np.ndarray, electrodes: np.ndarray) -> np.ndarray:
    """Potentials (9, n) of point sources, of any size."""
    return 10 / np.linalg.norm(vertices - electrodes[:, None], axis=2)
