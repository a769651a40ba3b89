"""Ventricles made of truncated ellipsoids, whose volume and walls are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv
from scipy.spatial import cKDTree

from fascicle.build.labelled_files import Anatomy, labelled_surface, labelled_tetrahedra
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.measures import closed_volume
from fascicle.mesh.read import read_mesh

# Half-axes (mm) of ellipsoids cut off at z = 0, the apices below, and how far to the side of the
# left ventricle the right one is. The right cavity is what its inner ellipsoid leaves outside the
# left ventricle, so the septum is the left ventricle's wall.
LV_OUTER, LV_INNER = (32.0, 32.0, 72.0), (22.0, 22.0, 62.0)
RV_OUTER, RV_INNER = (38.0, 38.0, 62.0), (33.0, 33.0, 57.0)
RV_ASIDE = 22.0
LV_WALL, RV_WALL = 10.0, 5.0  # mm
FLAT = 1e-3  # mm that the base is off its plane
BOX = (-36.0, -42.0, -76.0), (64.0, 42.0, 0.0)  # mm, corners around the tissue


def ellipsoid(points, half_axes, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Distance to an ellipsoid (mm), to first order; negative inside."""
    scaled = (points - np.asarray(centre)) / half_axes
    near = np.linalg.norm(scaled, axis=-1)
    return near * (near - 1) / np.maximum(np.linalg.norm(scaled / half_axes, axis=-1), 1e-9)


def _parts(points: np.ndarray) -> dict[Label, np.ndarray]:
    """Functions that are positive outside the tissue through that surface, negative inside."""
    aside = (RV_ASIDE, 0.0, 0.0)
    lv = ellipsoid(points, LV_OUTER)
    return {
        Label.BASE: points[..., 2],  # the base is cut flat
        Label.EPICARDIUM: np.minimum(lv, ellipsoid(points, RV_OUTER, aside)),
        Label.LV_ENDOCARDIUM: -ellipsoid(points, LV_INNER),
        Label.RV_ENDOCARDIUM: np.minimum(-ellipsoid(points, RV_INNER, aside), lv),
    }


def biventricular_surface(edge: float) -> LabelledSurface:
    """The closed surface of two ventricles with triangles of about this edge length (mm)."""
    x, y, z = (np.arange(low, high, edge) + 0.37 * edge for low, high in zip(*BOX, strict=True))
    # two layers next to the base, so that its rim is sharp
    z = np.concatenate([z[z < -0.5 * edge], [-FLAT, FLAT]])
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    parts = _parts(points)
    parts[Label.BASE] *= edge / FLAT  # else the rim would be drawn to the nodes inside
    values = np.max(list(parts.values()), axis=0)
    grid = pv.ImageData(dimensions=values.shape)
    made = grid.contour([0.0], scalars=values.ravel(order="F"), method="flying_edges")
    steps = np.asarray(made.points, dtype=float)
    vertices = np.column_stack(
        [np.interp(steps[:, k], np.arange(len(axis)), axis) for k, axis in enumerate((x, y, z))]
    )
    triangles = np.asarray(made.regular_faces, dtype=np.int64)
    middle = vertices[triangles].mean(axis=1)
    parts = _parts(middle)
    labels = np.array(list(parts))[np.argmax(list(parts.values()), axis=0)]
    labels[vertices[triangles][..., 2].min(axis=1) > -1.5 * FLAT] = Label.BASE
    return LabelledSurface(vertices, triangles, labels.astype(np.int64), "ventricles")


def exact_volume(edge: float = 0.5) -> float:
    """Volume of the tissue (mm³), by a midpoint rule on cubes of this edge (mm)."""
    axes = (np.arange(low + edge / 2, high, edge) for low, high in zip(*BOX, strict=True))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return float((np.max(list(_parts(points).values()), axis=0) < 0).sum()) * edge**3


def volume_of(surface: LabelledSurface) -> float:
    """Volume within a closed surface (mm³), positive where it faces outwards."""
    return closed_volume(surface.vertices, surface.triangles)


def read_labelled_surface(path: Path, **options) -> LabelledSurface:
    """Read a file of triangles; the options are those of `labelled_surface`."""
    return labelled_surface(read_mesh(path), **options)


def read_labelled_mesh(path: Path, **options) -> Anatomy:
    """Read a file of tetrahedra; the options are those of `labelled_tetrahedra`."""
    return labelled_tetrahedra(read_mesh(path), **options)


def in_mesh(mesh, surface) -> np.ndarray:
    """Which vertex of a mesh each vertex of a surface is, or the nearest one."""
    return cKDTree(mesh.vertices).query(surface.vertices)[1]
