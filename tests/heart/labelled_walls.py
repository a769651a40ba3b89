"""Walls whose fibres are known exactly, meshed and labelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import boundary_triangles

Floats = NDArray[np.float64]


def layered(flat: Floats, triangles: NDArray[np.int64], layers: int) -> NDArray[np.int64]:
    """Tetrahedra between copies of a triangulation; copy k starts at vertex k·len(flat)."""
    a, b, c = np.sort(triangles, axis=1).T
    count = len(flat)
    prisms = [
        np.stack(split, axis=1)
        for split in (
            (a, b, c, c + count),
            (a, b, b + count, c + count),
            (a, a + count, b + count, c + count),
        )
    ]
    return np.concatenate([np.concatenate(prisms) + k * count for k in range(layers)])


def oriented(vertices: Floats, tetrahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same, all of positive volume."""
    inverted = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[inverted] = tetrahedra[inverted][:, [0, 1, 3, 2]]
    return tetrahedra


def slab(
    thickness: float,
    layers: int,
    inner: Label = Label.LV_ENDOCARDIUM,
    outer: Label = Label.EPICARDIUM,
) -> LabelledMesh:
    """A wall 10 mm wide along x and 80 mm long along z; out of the ventricle is y, base at z = 80.

    What is neither inner, outer nor base has no label: 0.
    """
    x, z = np.meshgrid(np.linspace(0, 10, 5), np.linspace(0, 80, 33), indexing="ij")
    flat = np.stack([x.ravel(), z.ravel()], axis=1)
    vertices = np.concatenate(
        [np.insert(flat, 1, y, axis=1) for y in np.linspace(0, thickness, layers + 1)]
    )
    tetrahedra = oriented(vertices, layered(flat, Delaunay(flat).simplices, layers))
    triangles, _ = boundary_triangles(tetrahedra)
    corners = vertices[triangles]
    labels = np.zeros(len(triangles), dtype=np.int64)
    labels[np.all(corners[..., 2] == 80, axis=1)] = Label.BASE
    labels[np.all(corners[..., 1] == 0, axis=1)] = inner
    labels[np.all(corners[..., 1] == thickness, axis=1)] = outer
    return LabelledMesh(vertices, tetrahedra, triangles, labels, name="slab")


@dataclass(frozen=True)
class Spheroid:
    """A ventricle between confocal prolate spheroids, cut along a hyperboloid: x(ξ, ν, azimuth).

    Both families of surfaces are orthogonal, so the potential of the wall depends on ξ alone:
    it is linear in ln tanh(ξ/2).
    """

    inner: tuple[float, float] = (24.5, 68.0)  # semi-axes of the endocardium (mm)
    outer_radius: float = 34.0  # short semi-axis of the epicardium (mm)
    opening: float = np.radians(105)  # ν of the base; 0 at the apex

    @property
    def focus(self) -> float:
        return float(np.sqrt(self.inner[1] ** 2 - self.inner[0] ** 2))

    @property
    def walls(self) -> tuple[float, float]:
        """ξ of endocardium and epicardium."""
        return (
            float(np.arcsinh(self.inner[0] / self.focus)),
            float(np.arcsinh(self.outer_radius / self.focus)),
        )

    def place(self, xi: Floats, nu: Floats, azimuth: Floats) -> Floats:
        radius = self.focus * np.sinh(xi) * np.sin(nu)
        z = -self.focus * np.cosh(xi) * np.cos(nu)
        return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)

    def coordinates(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """ξ, ν, azimuth from the distances to the two foci."""
        away, near = (
            np.linalg.norm(points - [0, 0, z], axis=-1) for z in (self.focus, -self.focus)
        )
        xi = np.arccosh((away + near) / (2 * self.focus))
        nu = np.arccos(np.clip((away - near) / (2 * self.focus), -1, 1))
        return xi, nu, np.arctan2(points[..., 1], points[..., 0])

    def depth(self, xi: Floats) -> Floats:
        inner, outer = (np.log(np.tanh(wall / 2)) for wall in self.walls)
        return (np.log(np.tanh(xi / 2)) - inner) / (outer - inner)

    def fibres(self, points: Floats, inner: float, outer: float) -> Floats:
        """Exact fibres, for angles (rad) on the two surfaces."""
        xi, nu, azimuth = self.coordinates(points)
        angle = (inner + (outer - inner) * self.depth(xi))[:, None]
        meridian = np.stack(
            [
                np.sinh(xi) * np.cos(nu) * np.cos(azimuth),
                np.sinh(xi) * np.cos(nu) * np.sin(azimuth),
                np.cosh(xi) * np.sin(nu),
            ],
            axis=1,
        )
        meridian /= np.linalg.norm(meridian, axis=1, keepdims=True)
        # with z from apex to base, azimuth grows counter-clockwise seen from the base
        around = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=1)
        return np.cos(angle) * around + np.sin(angle) * meridian

    def mesh(self, rings: int, layers: int) -> LabelledMesh:
        """A ring k of 6k vertices around the apex, repeated through the wall."""
        ring = np.repeat(np.arange(rings + 1), np.maximum(6 * np.arange(rings + 1), 1))
        first = np.searchsorted(ring, ring)
        azimuth = 2 * np.pi * (np.arange(len(ring)) - first) / np.maximum(6 * ring, 1)
        flat = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth)], axis=1)
        nu = self.opening * ring / rings
        vertices = np.concatenate(
            [
                self.place(np.full(len(nu), xi), nu, azimuth)
                for xi in np.linspace(*self.walls, layers + 1)
            ]
        )
        disk = Delaunay(flat).simplices
        tetrahedra = oriented(vertices, layered(flat, disk, layers))
        triangles, _ = boundary_triangles(tetrahedra)
        layer = triangles // len(flat)
        labels = np.full(len(triangles), Label.BASE, dtype=np.int64)
        labels[np.all(layer == 0, axis=1)] = Label.LV_ENDOCARDIUM
        labels[np.all(layer == layers, axis=1)] = Label.EPICARDIUM
        return LabelledMesh(vertices, tetrahedra, triangles, labels, name="spheroid")
