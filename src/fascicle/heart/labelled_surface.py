"""The closed surface of the ventricles, with a label for every triangle."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import igl
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.endocardium import long_axis
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.mesh.topology import boundary_loops


class Label(IntEnum):
    """What a part of the surface is.

    Valve openings are parts of the base: tissue was cut there, and nothing is endocardium. They
    need not be told apart; where the arterial ones are, fibres turn towards them.
    """

    BASE = 1
    EPICARDIUM = 2
    LV_ENDOCARDIUM = 3
    RV_ENDOCARDIUM = 4
    MITRAL = 5
    AORTIC = 6
    TRICUSPID = 7
    PULMONARY = 8

    @property
    def words(self) -> str:
        """Name for messages."""
        return self.name.replace("_", " ").lower()


BASAL = (Label.BASE, Label.MITRAL, Label.AORTIC, Label.TRICUSPID, Label.PULMONARY)
NEEDED = (Label.BASE, Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)


def missing_parts(labels: Integers) -> list[str]:
    """Names of the parts that no triangle is labelled as; a valve opening counts as base."""
    found = {Label.BASE if label in BASAL else label for label in np.unique(labels)}
    return [label.words for label in NEEDED if label not in found]


class _Labelled:
    """A boundary with a label for every triangle."""

    triangles: Integers
    labels: Integers

    def having(self, *labels: Label) -> Integers:
        """Triangles of the boundary with any of these labels, shape (k, 3)."""
        return self.triangles[np.isin(self.labels, labels)]


@dataclass(frozen=True)
class LabelledSurface(_Labelled):
    """The boundary of the ventricular myocardium.

    Vertices (n, 3) (mm); triangles (m, 3), counter-clockwise seen from outside the tissue; a
    `Label` for each (m,); what to call it in messages, usually the file; and how it was repaired,
    for the user.
    """

    vertices: Floats
    triangles: Integers
    labels: Integers
    name: str = "surface"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class LabelledMesh(_Labelled):
    """Tetrahedra of the ventricular myocardium and its labelled boundary, in register.

    Vertices (n, 3) (mm); tetrahedra (m, 4), positively oriented; the boundary as in
    `LabelledSurface`; and perhaps a region's label for each tetrahedron (m,), scar for one.
    """

    vertices: Floats
    tetrahedra: Integers
    triangles: Integers
    labels: Integers
    regions: Integers | None = None
    name: str = "mesh"


def labelled_mesh(heart: Heart) -> LabelledMesh:
    """Labels of base, epicardium and endocardia, for a heart whose endocardia are known.

    The base is what faces away from the apex, at the level of the endocardia's openings. The
    endocardia need not be in register with the mesh.
    """
    triangles = heart.boundary[0]
    middle = heart.vertices[triangles].mean(axis=1)
    normals = unit(triangle_normals(heart.vertices, triangles))

    loops = [e.vertices[boundary_loops(e.triangles)[0]] for e in heart.endocardia]
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    length = float(np.linalg.norm(base - apex))
    up = (base - apex) / length
    lowest = min(float(((loop - apex) @ up).min()) for loop in loops)
    # the base lies at most 15 % of the way to the apex below the openings, and faces up (60°)
    basal = ((middle - apex) @ up > lowest - 0.15 * length) & (normals @ up > 0.5)
    labels = np.where(basal, int(Label.BASE), int(Label.EPICARDIUM))

    reach = 0.35 * heart.edge_length  # a triangle whose centre is nearer lies on the endocardium
    for label, e in ((Label.LV_ENDOCARDIUM, heart.lv), (Label.RV_ENDOCARDIUM, heart.rv)):
        square, face, _ = igl.point_mesh_squared_distance(middle, e.vertices, e.triangles)
        theirs = unit(triangle_normals(e.vertices, e.triangles)[face])
        # across a thin wall the other side is near too, but faces away; the base faces sideways
        same_way = np.einsum("ij,ij->i", normals, theirs) > 0.5
        labels[same_way & (np.asarray(square) < reach**2)] = label
    return LabelledMesh(
        heart.vertices, heart.tetrahedra, triangles, labels, heart.regions, heart.name
    )
