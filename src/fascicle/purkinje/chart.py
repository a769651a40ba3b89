"""Harmonic map of an endocardium to the unit disk, and its metric, by which lengths are exact."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import igl
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import MatrixRankWarning, spsolve

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.endocardium import Endocardium
from fascicle.mesh.checks import refuse
from fascicle.mesh.topology import boundary_loops


class Chart(NamedTuple):
    """A bijective map between an endocardium and the unit disk, linear on each triangle.

    The disk is seen from inside the cavity: counter-clockwise there is counter-clockwise on the
    endocardium for an observer in the blood.

    Points (n, 2) in the disk, vertices (n, 3) on the endocardium (mm), triangles (m, 3); neighbours
    (m, 3) across the edge opposite to each corner, -1 at the base and at valve openings; and as
    metric (m, 3) G₁₁, G₁₂, G₂₂ of G = JᵀJ with J = ∂x/∂u (mm²): a step Δu has length √(ΔuᵀGΔu).
    """

    points: Floats
    vertices: Floats
    triangles: Integers
    neighbours: Integers
    metric: Floats


def build_chart(endocardium: Endocardium) -> Chart:
    """Map an endocardium to the unit disk.

    Harmonic map with the boundary placed by arc length: Δu = 0 on the surface, u on the circle at
    the base, once for each coordinate (Álvarez-Barrientos et al., section "Purkinje network
    generation"). Obtuse triangles can make it fold; then mean-value weights replace the cotangents:
    they are positive and so give a bijection by Tutte's theorem. They are also used if the harmonic
    map stretches some triangle 20 times more one way than the other, and they stretch it less. In
    either case the metric is that of the endocardium, so lengths are exact. InputError if that map
    folds, too, which happens with degenerate triangles only.

    References
    ----------
    Remacle et al., Int J Numer Methods Eng 83 (2010) 403-425. Floater, Mean value coordinates,
    Comput Aided Geom Des 20 (2003) 19-27.
    """
    vertices, triangles = endocardium.vertices, endocardium.triangles
    loop = boundary_loops(triangles)[0]
    circle = _circle_by_arc_length(vertices[loop])
    points = np.asarray(igl.harmonic(vertices, triangles, loop, circle, 1))
    folds = (signed_areas(points, triangles) <= 0).any()

    def most_stretched(points: Floats) -> float:
        return float(stretch(_metric(points, vertices, triangles)).max())

    if folds or most_stretched(points) > 20.0:
        other = _mean_value_map(vertices, triangles, loop, circle)
        is_bijective = (signed_areas(other, triangles) > 0).all()
        if folds or (is_bijective and most_stretched(other) < most_stretched(points)):
            points = other
    refuse(
        f"{endocardium.side.upper()} endocardium",
        ~(signed_areas(points, triangles) > 0),  # NaN among them
        "triangles fold when mapped to the disk",
        "remove degenerate triangles or remesh the surface",
        vertices,
        triangles,
    )
    neighbours = np.asarray(igl.triangle_triangle_adjacency(triangles)[0], dtype=np.int64)
    # libigl numbers edges from their first corner; the walk wants the corner opposite to them
    neighbours = np.ascontiguousarray(neighbours[:, [1, 2, 0]])
    for outside in (endocardium.valves, endocardium.bare):  # where no tree may grow
        if outside is not None:
            neighbours[outside[neighbours]] = -1
    return Chart(points, vertices, triangles, neighbours, _metric(points, vertices, triangles))


def stretch(metric: Floats) -> Floats:
    """Ratio of the largest to the smallest stretch for each metric (m, 3), shape (m,).

    1 where a triangle is mapped conformally, infinite where it is a line.
    """
    g11, g12, g22 = metric.T
    mean, half = (g11 + g22) / 2, np.hypot((g11 - g22) / 2, g12)
    with np.errstate(divide="ignore"):
        return np.asarray(np.sqrt((mean + half) / np.maximum(mean - half, 0.0)))


def signed_areas(points: Floats, triangles: Integers) -> Floats:
    """Signed area of every triangle in the disk; positive means not folded."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    return np.asarray((ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) / 2)


def _circle_by_arc_length(loop: Floats) -> Floats:
    """Points on the unit circle, counter-clockwise, spaced as the loop's vertices are."""
    steps = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
    angle = 2 * np.pi * np.concatenate([[0.0], np.cumsum(steps)[:-1]]) / steps.sum()
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _mean_value_map(
    vertices: Floats, triangles: Integers, loop: Integers, circle: Floats
) -> Floats:
    """Map with inner vertices at mean-value-weighted averages of neighbours (Floater 2003)."""
    n = len(vertices)
    weights = sp.csr_matrix((n, n))
    for k in range(3):
        i, j, l = (triangles[:, (k + s) % 3] for s in range(3))  # noqa: E741
        to_j, to_l = vertices[j] - vertices[i], vertices[l] - vertices[i]
        length_j, length_l = np.linalg.norm(to_j, axis=1), np.linalg.norm(to_l, axis=1)
        cosine = np.einsum("ij,ij->i", to_j, to_l) / (length_j * length_l)
        cosine = cosine.clip(-1.0, 1.0)  # rounding may exceed the range
        with np.errstate(divide="ignore"):  # degenerate triangles; see below
            half_tangent = np.sqrt((1 - cosine) / (1 + cosine))  # tan(α/2)
        for column, length in ((j, length_j), (l, length_l)):
            weights += sp.csr_matrix((half_tangent / length, (i, column)), shape=(n, n))
    inner = np.setdiff1d(np.arange(n), loop)
    points = np.zeros((n, 2))
    points[loop] = circle
    total = sp.diags(np.asarray(weights.sum(axis=1)).ravel())
    matrix = (total - weights).tocsr()[inner]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatrixRankWarning)  # a NaN counts as folded below
        points[inner] = spsolve(matrix[:, inner].tocsc(), -matrix[:, loop] @ circle)
    return points


def _metric(points: Floats, vertices: Floats, triangles: Integers) -> Floats:
    """G = JᵀJ of every triangle, as (G₁₁, G₁₂, G₂₂)."""
    flat = np.stack([points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2)], axis=-1)
    curved = np.stack(
        [vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2)], axis=-1
    )
    jacobian = curved @ np.linalg.inv(flat)
    metric = np.swapaxes(jacobian, 1, 2) @ jacobian
    return np.ascontiguousarray(metric[:, [0, 0, 1], [0, 1, 1]])
