"""Along the ventricles: from the apex to the base, and how far into an outflow tract."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.fibres.laplace import QuadraticSpace, solve_laplace
from fascicle.heart.labelled_surface import BASAL, Label, LabelledMesh

ARTERIAL = (Label.AORTIC, Label.PULMONARY)


def apex_to_base(space: QuadraticSpace, mesh: LabelledMesh) -> tuple[Floats, Floats]:
    """Direction to the base, and how far into an outflow tract each tetrahedron lies.

    The direction to the base is the gradient of the potential that is 1 on all that is basal, the
    arterial openings among it, and 0 at the two ends of the LV's apex (`lv_apex`). The part h of
    that potential that is due to the arterial openings alone gives the outflow tracts: they are
    where h exceeds one half, so where their opening rather than the rest of the base is at hand,
    and the measure (2h − 1)² rises to 1 at the opening. Doste et al. 2019 (Int J Numer Methods
    Biomed Eng 35:e3185) use such a potential between the two openings of each ventricle.

    Returns
    -------
    (m, 3) and (m,) arrays
        Towards the base, of any length; and 0 outside the outflow tracts to 1 at the openings of
        the great arteries (0 everywhere when these have no label).
    """
    apex = lv_apex(mesh)
    basal = np.setdiff1d(space.on(mesh.having(*BASAL)), apex)
    fixed = np.concatenate([basal, apex])
    given = [np.arange(len(fixed)) < len(basal)]
    arterial = mesh.having(*ARTERIAL)
    if len(arterial):
        given.append(np.isin(fixed, np.setdiff1d(space.on(arterial), apex)))
    solutions = solve_laplace(space, fixed, np.array(given, dtype=float))
    _, baseward = space.at_centroids(solutions[0])
    if not len(arterial):
        return baseward, np.zeros(len(baseward))
    due_to_arteries, _ = space.at_centroids(solutions[1])
    return baseward, np.clip(2 * due_to_arteries - 1, 0, 1) ** 2


def lv_apex(mesh: LabelledMesh) -> Integers:
    """The vertices at the apex of the LV: the endocardial and the epicardial one, shape (2,).

    Those that lie furthest from the endocardium's opening along the long axis, which runs from
    its middle to the endocardial vertex that is furthest from it. Of the epicardium, only what
    is nearer to the LV than to the RV: the RV's apex may reach as low.
    """
    endocardium = np.unique(mesh.having(Label.LV_ENDOCARDIUM))
    opening = mesh.vertices[np.intersect1d(endocardium, mesh.having(*BASAL))].mean(axis=0)
    offset = mesh.vertices[endocardium] - opening
    axis = offset[np.argmax(np.linalg.norm(offset, axis=1))]
    epicardium = np.unique(mesh.having(Label.EPICARDIUM))
    right = np.unique(mesh.having(Label.RV_ENDOCARDIUM))
    if len(right):
        to_left, to_right = (
            KDTree(mesh.vertices[part]).query(mesh.vertices[epicardium])[0]
            for part in (endocardium, right)
        )
        epicardium = epicardium[to_left < to_right]
    lowest = [part[np.argmax(mesh.vertices[part] @ axis)] for part in (endocardium, epicardium)]
    return np.array(lowest)
