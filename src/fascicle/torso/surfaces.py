"""Closed triangle surfaces of the body: their measures, and what must not be wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import igl
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.measures import closed_volume
from fascicle.mesh.meshing import remeshed_triangles

MM3_PER_LITRE = 1e6
REMESHING_ERROR = 0.25  # largest distance between old and new surface, of the new edge length


class Surface(NamedTuple):
    """A triangle surface.

    Attributes
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices; of a closed surface, counter-clockwise seen from outside.
    """

    vertices: Floats
    triangles: Integers

    @property
    def corners(self) -> Floats:
        """Corners of every triangle (mm), shape (m, 3, 3)."""
        return np.asarray(self.vertices[self.triangles])

    @property
    def litres(self) -> float:
        """Enclosed volume of a closed surface."""
        return closed_volume(*self) / MM3_PER_LITRE


def signed_distance(points: Floats, surface: Surface) -> Floats:
    """Distance to a closed surface (mm), negative inside, shape (n,)."""
    distance = igl.signed_distance(np.ascontiguousarray(points), *surface)[0]
    return np.asarray(distance, dtype=float)


def remeshed(surface: Surface, edge: float) -> Surface:
    """Triangulate a closed surface again, with edges of about this length (mm)."""
    alike = np.zeros(len(surface.triangles), dtype=np.int64)
    vertices, triangles, _ = remeshed_triangles(
        *surface, alike, hsiz=edge, hausd=REMESHING_ERROR * edge, angle=0
    )
    return Surface(vertices, triangles)


@dataclass(frozen=True)
class TorsoSurfaces:
    """The body around a heart, in the heart's coordinates.

    Attributes
    ----------
    skin : Surface
        Closed surface of the trunk (mm).
    lungs : tuple of Surface
        Closed surfaces within it (mm): left, right.
    electrodes : (9, 3) array, optional
        Positions on the skin (mm), in the order of `fascicle.core.leads.ELECTRODES`; those of a
        torso of the user's own are not known.
    """

    skin: Surface
    lungs: tuple[Surface, ...]
    electrodes: Floats | None = None
