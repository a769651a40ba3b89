"""A tetrahedral mesh with flat elements: its inside is meshed again, what it carries stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.anatomy import Anatomy
from fascicle.build.volume_meshing import remeshed_inside
from fascicle.core.arrays import Floats
from fascicle.mesh.measures import principal_axes
from fascicle.mesh.quality import quality

NEAREST = 4  # tetrahedra that a direction is averaged over
ROUNDING = 1e-9  # mm, added to distances, so that a tetrahedron that is still there counts alone


def remeshed_anatomy(anatomy: Anatomy) -> Anatomy:
    """Mesh the inside of a mesh again, with edges as long as they were; the boundary stays.

    Fibres and sheets are axes without a sign: the new one is the principal axis of the mean of
    f fᵀ over the nearest tetrahedra, weighted by the inverse of their distance. A region is that of
    the nearest tetrahedron. Endocardia and labels do not change.

    Parameters
    ----------
    anatomy : Anatomy
        Of tetrahedra, labelled.

    References
    ----------
    Dapogny, Dobrzynski and Frey 2014, J Comput Phys 262:358-378 (Mmg).
    """
    mesh = anatomy.mesh
    new = remeshed_inside(mesh, mesh.vertices, mesh.tetrahedra, optim=1)
    before, after = (quality(each.vertices, each.tetrahedra).angles.min() for each in (mesh, new))
    centres = [each.vertices[each.tetrahedra].mean(axis=1) for each in (mesh, new)]
    distance, near = cKDTree(centres[0]).query(centres[1], k=NEAREST)
    weights = 1 / (distance + ROUNDING)
    note = (
        f"mesh: its inside was meshed again and its surface kept: {len(mesh.tetrahedra)} "
        f"tetrahedra before, {len(new.tetrahedra)} after; smallest dihedral angle {before:.1f} "
        f"degrees before, {after:.1f} after; fibres, sheets and regions are those of the nearest "
        "tetrahedra"
    )
    return replace(
        anatomy,
        mesh=replace(new, regions=None if mesh.regions is None else mesh.regions[near[:, 0]]),
        fibres=None if anatomy.fibres is None else mean_axes(anatomy.fibres[near], weights),
        sheets=None if anatomy.sheets is None else mean_axes(anatomy.sheets[near], weights),
        notes=(*anatomy.notes, note),
        own_mesh=False,
    )


def mean_axes(directions: Floats, weights: Floats) -> Floats:
    """Mean axis of some directions whose signs do not count.

    Parameters
    ----------
    directions : (n, k, 3) array
        Unit vectors.
    weights : (n, k) array
        How much each counts.

    Returns
    -------
    (n, 3) array
        Unit vectors, with the sign of the first direction.
    """
    axes = principal_axes(np.sqrt(weights)[..., None] * directions)
    sign = np.sign(np.einsum("ni,ni->n", axes, directions[:, 0]))
    return np.asarray(axes * np.where(sign == 0, 1, sign)[:, None])
