"""Labels of a heart's boundary, from its endocardia."""

from __future__ import annotations

import igl
import numpy as np

from fascicle.core.arrays import Booleans, Floats
from fascicle.heart.endocardium import long_axis
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.mesh.topology import boundary_loops

ON_ENDOCARDIUM = 0.35  # mean edges; a triangle whose centre is nearer than that lies on it
SAME_WAY = 0.5  # cosine between the normals of a triangle and the endocardium it lies on
FACING_BASE = 0.5  # cosine; a triangle that faces so much away from the apex may be base
BELOW_OPENING = 0.15  # of the distance from base to apex; none further down is


def labelled_mesh(heart: Heart) -> LabelledMesh:
    """Labels of base, epicardium and endocardia, for a heart whose endocardia are known.

    The base is what faces away from the apex, at the level of the endocardia's openings.

    Parameters
    ----------
    heart : Heart
        Its endocardia need not be in register with the mesh.
    """
    triangles = heart.boundary[0]
    middle = heart.vertices[triangles].mean(axis=1)
    normals = unit(triangle_normals(heart.vertices, triangles))
    labels = np.full(len(triangles), int(Label.EPICARDIUM))
    labels[_basal(heart, middle, normals)] = Label.BASE
    reach = ON_ENDOCARDIUM * heart.edge_length
    sides = {Label.LV_ENDOCARDIUM: heart.lv, Label.RV_ENDOCARDIUM: heart.rv}
    for label, endocardium in sides.items():
        square, face, _ = igl.point_mesh_squared_distance(
            middle, endocardium.vertices, endocardium.triangles
        )
        theirs = unit(triangle_normals(endocardium.vertices, endocardium.triangles)[face])
        # across a thin wall the other side is near too, but faces away; the base faces sideways
        same = np.einsum("ij,ij->i", normals, theirs) > SAME_WAY
        labels[same & (np.asarray(square) < reach**2)] = label
    return LabelledMesh(
        heart.vertices, heart.tetrahedra, triangles, labels, heart.regions, heart.name
    )


def _basal(heart: Heart, middle: Floats, normals: Floats) -> Booleans:
    """Which triangles face away from the apex near the openings of the endocardia."""
    loops = [e.vertices[boundary_loops(e.triangles)[0]] for e in heart.endocardia]
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    length = float(np.linalg.norm(base - apex))
    up = (base - apex) / length
    lowest = min(float(((loop - apex) @ up).min()) for loop in loops)
    high = (middle - apex) @ up > lowest - BELOW_OPENING * length
    return np.asarray(high & (normals @ up > FACING_BASE))
