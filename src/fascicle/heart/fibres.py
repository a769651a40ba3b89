"""Fibres and sheets by rule, from Laplace problems.

The rule is that of Bayer et al. 2012: a fibre lies in the wall, at an angle to the circumference
that goes linearly with depth. Three harmonic potentials that add up to 1, each 1 on one surface
(LV endocardium, RV endocardium, epicardium) and 0 on the other two, give depth and the direction
across the wall; a fourth one gives the direction from apex to base.

Departures from the paper, which mend its known flaws:

- The direction across the wall is kept and the one towards the base made orthogonal to it, not the
  reverse, so that no fibre leaves the wall (as in Piersanti et al. 2021).
- Each surface has its own frame. Turning a frame inside out, and its angle with it, leaves the
  fibre's line unchanged, so the two frames of a wall agree: through the septum the angle passes
  from the LV's to the RV's, seen from the RV, without a step.
- Where three walls meet the frames disagree. The lines are blended, as tensors f⊗f: their principal
  direction can jump along curves only, whereas the nearest of equivalent quaternions jumps across
  whole surfaces. Every field with these angles has such a curve along each junction of the
  ventricles, and one at each apex.

Sources
-------
Bayer, Blake, Plank and Trayanova 2012, Ann Biomed Eng 40:2243-2254.
Doste et al. 2019, Int J Numer Methods Biomed Eng 35:e3185.
Piersanti et al. 2021, Comput Methods Appl Mech Eng 373:113468.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import radians

import numpy as np
from scipy.spatial import KDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import BASAL, Label, LabelledMesh, missing_parts
from fascicle.heart.laplace import QuadraticSpace, quadratic_space, solve_laplace
from fascicle.mesh.measures import principal_axes, unit


@dataclass(frozen=True)
class FibreAngles:
    """Angles of fibres and sheets on the surfaces (rad).

    A fibre's angle is measured in the wall, from the circumference, counter-clockwise around the
    ventricle seen from the base, towards the base: positive for a right-handed helix about the
    axis from apex to base. On the RV's endocardium it is seen from the RV, on its septal side too.

    A sheet's angle is that of Bayer et al.: 0 in the wall, ±π/2 across it.
    """

    lv_endocardium: float = radians(60)  # Streeter et al. 1969, Circ Res 24:339-347
    lv_epicardium: float = radians(-60)
    rv_endocardium: float = radians(90)  # Doste et al. 2019
    rv_epicardium: float = radians(-25)
    # at the openings of the great arteries, where these are labelled: Doste et al. 2019
    outflow_endocardium: float = radians(90)
    outflow_epicardium: float = 0.0
    sheet_endocardium: float = radians(-65)  # Bayer et al. 2012
    sheet_epicardium: float = radians(25)


class Wall(IntEnum):
    """Part of the myocardium, by the two surfaces that it lies between."""

    LV = 0
    RV = 1
    SEPTUM = 2


@dataclass(frozen=True)
class Fibres:
    """Directions of the myocardium in each tetrahedron, and where in the wall it is.

    Unit vectors (m, 3): along the fibre, and across it in the sheet, orthogonal, of either sign;
    across the wall, out of the ventricle (in the septum: the left one), and along it towards the
    base, orthogonal. The depth (m,) is 0 on the endocardium, 1 on the epicardium; in the septum, 0
    on the left, 1 on the right. And a `Wall` for each (m,).
    """

    fibre: Floats
    sheet: Floats
    outward: Floats
    longitudinal: Floats
    depth: Floats
    wall: Integers


def rule_based_fibres(
    mesh: LabelledMesh, angles: FibreAngles | None = None, progress: StageProgress = no_progress
) -> Fibres:
    """Fibres and sheets in each tetrahedron of one or two ventricles.

    With e_t out of the ventricle, e_l towards the base and orthogonal to e_t, and e_c = e_l × e_t,

        f = cos α e_c + sin α e_l,    s = cos β (cos α e_l − sin α e_c) − sin β e_t,

    with the published α and β on the surfaces if no angles are given. The right ventricle may be
    missing. Where openings of the great arteries are labelled, fibres turn towards them on the
    endocardium and around them outside. An error if the surface lacks a label that the rule needs.
    """
    angles = angles if angles is not None else FibreAngles()
    if missing := {*missing_parts(mesh.labels)} - {Label.RV_ENDOCARDIUM.words}:
        raise InputError(
            f"{mesh.name}: no boundary triangle is labelled as {' or '.join(sorted(missing))}, "
            "which the fibres start from; label the surface"
        )
    progress(0, 3)
    space = quadratic_space(mesh.vertices, mesh.tetrahedra)
    potentials, gradients = wall_potentials(space, mesh)
    progress(1, 3)
    baseward, outflow = apex_to_base(space, mesh)
    progress(2, 3)
    fibres = by_rule(potentials, gradients, baseward, outflow, angles)
    progress(3, 3)
    return fibres


def placeholder(directions: Floats) -> str:
    """Reason that vectors (m, 3) cannot be measured fibres, in words; empty if they can.

    They are placeholders if more than half are zero or nearly all (99 %) lie along one axis, and
    no directions if more than 1 % of their lengths differ from the median by a factor above 2.
    Means of unit vectors are shorter than these, but seldom by so much.
    """
    if not (np.abs(directions) < 1e100).all():  # `check_fibres` refuses these
        return ""
    length = np.linalg.norm(directions, axis=1)
    if (length < 1e-6).mean() > 0.5:
        return f"{(length < 1e-6).mean():.0%} of them are zero"
    axis = principal_axes(unit(directions)[None])[0]
    if (np.abs(unit(directions) @ axis) > 1 - 1e-6).mean() > 0.99:
        return "all lie along ({:.2g}, {:.2g}, {:.2g})".format(*axis * np.sign(axis.sum()))
    typical = float(np.median(length))
    if ((length > 2 * typical) | (length < typical / 2)).mean() > 0.01:
        low, high = np.percentile(length, [1, 99])
        return f"their lengths vary from {low:.2g} to {high:.2g}"
    return ""


def is_placeholder(
    kind: str, array: str, directions: Floats, notes: list[str], *, kept: bool
) -> bool:
    """True if directions (m, 3) of an array are a `placeholder` that is not to be kept.

    The notes say that a rule takes their place, or that their length was not 1.
    """
    if not kept and (fault := placeholder(directions)):
        notes.append(
            f"{kind}: {array} is a placeholder, as {fault}; a rule was applied instead (--fibres "
            "file keeps what is in the mesh's file)"
        )
        return True
    length = np.linalg.norm(directions, axis=1)
    if np.abs(length - 1).max() > 1e-3:
        lengths = f"vectors of length {length.min():.3g} to {length.max():.3g}"
        notes.append(f"{kind}: {array} has {lengths}; they were made unit vectors")
    return False


def wall_potentials(space: QuadraticSpace, mesh: LabelledMesh) -> tuple[Floats, Floats]:
    """The harmonic potentials of LV and RV endocardium and epicardium in each tetrahedron's middle.

    Values (3, m), which add up to 1, and gradients (3, m, 3) (1/mm). Where two of the surfaces
    share a node the first one has it.
    """
    surface = np.full(space.size, -1)
    for k, label in ((2, Label.EPICARDIUM), (1, Label.RV_ENDOCARDIUM), (0, Label.LV_ENDOCARDIUM)):
        surface[space.on(mesh.having(label))] = k
    fixed = np.flatnonzero(surface >= 0)
    solved = [k for k in (0, 1) if (surface == k).any()]
    boundary_values = np.array([surface[fixed] == k for k in solved], dtype=float)
    solutions = solve_laplace(space, fixed, boundary_values)
    count = len(space.tetrahedra)
    values, gradients = np.zeros((3, count)), np.zeros((3, count, 3))
    for k, solution in zip(solved, solutions, strict=True):
        values[k], gradients[k] = space.at_centroids(solution)
    values[2], gradients[2] = 1 - values[0] - values[1], -gradients[0] - gradients[1]
    # quadratic functions overshoot a little; the bound keeps the potential of a surface that exists
    # above that of a missing one
    present = [*solved, 2]
    values[present] = np.maximum(values[present], 1e-6)
    return values / values.sum(axis=0), gradients


def apex_to_base(space: QuadraticSpace, mesh: LabelledMesh) -> tuple[Floats, Floats]:
    """Direction to the base (m, 3), and how far into an outflow tract each tetrahedron lies (m,).

    The direction is the gradient of the potential that is 1 on the base, valve openings included,
    and 0 at the two ends of the LV's apex (`lv_apex`). Outflow tracts are where the part h of it
    that is due to the arterial openings exceeds one half; the measure (2h − 1)² rises to 1 at the
    opening. Doste et al. 2019 use such a potential between the two openings of each ventricle.
    """
    apex = lv_apex(mesh)
    basal = np.setdiff1d(space.on(mesh.having(*BASAL)), apex)
    fixed = np.concatenate([basal, apex])
    boundary_values = [np.arange(len(fixed)) < len(basal)]
    if len(arterial := mesh.having(Label.AORTIC, Label.PULMONARY)):
        boundary_values.append(np.isin(fixed, np.setdiff1d(space.on(arterial), apex)))
    solutions = solve_laplace(space, fixed, np.array(boundary_values, dtype=float))
    _, baseward = space.at_centroids(solutions[0])
    if not len(arterial):
        return baseward, np.zeros(len(baseward))
    due_to_arteries, _ = space.at_centroids(solutions[1])
    return baseward, np.clip(2 * due_to_arteries - 1, 0, 1) ** 2


def lv_apex(mesh: LabelledMesh) -> Integers:
    """The vertices at the apex of the LV: the endocardial and the epicardial one, shape (2,).

    Both are furthest along the long axis, from the middle of the endocardium's opening to the
    endocardial vertex furthest from it. Of the epicardium only the part nearer to the LV than to
    the RV counts: the RV's apex may reach as low.
    """
    endocardium = np.unique(mesh.having(Label.LV_ENDOCARDIUM))
    opening = mesh.vertices[np.intersect1d(endocardium, mesh.having(*BASAL))].mean(axis=0)
    offset = mesh.vertices[endocardium] - opening
    axis = offset[np.argmax(np.linalg.norm(offset, axis=1))]
    epicardium = np.unique(mesh.having(Label.EPICARDIUM))
    if len(right := np.unique(mesh.having(Label.RV_ENDOCARDIUM))):
        trees = (KDTree(mesh.vertices[part]) for part in (endocardium, right))
        to_left, to_right = (tree.query(mesh.vertices[epicardium])[0] for tree in trees)
        epicardium = epicardium[to_left < to_right]
    lowest = [part[np.argmax(mesh.vertices[part] @ axis)] for part in (endocardium, epicardium)]
    return np.array(lowest)


def by_rule(
    potentials: Floats, gradients: Floats, baseward: Floats, outflow: Floats, angles: FibreAngles
) -> Fibres:
    """Fibres and sheets from `wall_potentials`, `apex_to_base` and the angles on the surfaces."""
    # the gradient of a ventricle's potential points into it, the epicardium's out of both
    across = unit(gradients * np.array([-1.0, -1.0, 1.0])[:, None, None])
    # row k: sign of each surface's angle in the frame of surface k, as the left and the right
    # ventricle see the septum from opposite sides
    seen_from = np.array([(1.0, -1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, 1.0, 1.0)])
    frames = [_frame(out, baseward) for out in across]
    fibre_angles, sheet_angles = _on_surfaces(potentials, outflow, angles)
    fibre_tensor, sheet_tensor = (np.zeros((len(baseward), 3, 3)) for _ in range(2))
    for k, (around, along) in enumerate(frames):
        alpha, beta = (
            np.einsum("j,jm,jm->m", seen_from[k], at, potentials)[:, None]
            for at in (fibre_angles, sheet_angles)
        )
        fibre = np.cos(alpha) * around + np.sin(alpha) * along
        aside = np.cos(alpha) * along - np.sin(alpha) * around
        sheet = np.cos(beta) * aside - np.sin(beta) * across[k]
        fibre_tensor += potentials[k, :, None, None] * _lines(fibre)
        sheet_tensor += potentials[k, :, None, None] * _lines(sheet)
    fibre = np.linalg.eigh(fibre_tensor)[1][:, :, -1]  # the direction of the largest eigenvalue
    across_fibre = np.eye(3) - _lines(fibre)
    sheet = np.linalg.eigh(across_fibre @ sheet_tensor @ across_fibre)[1][:, :, -1]
    wall, depth = wall_and_depth(potentials)
    # row by `Wall`: sign of each surface's outward direction in the outward direction of the wall
    sides = np.array([(1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (1.0, -1.0, 0.0)])
    outward = unit(np.einsum("mk,km,kmx->mx", sides[wall], potentials, across))
    around, along = _frame(outward, baseward)
    fibre[_dot(fibre, around) < 0] *= -1
    sheet = unit(sheet - _dot(sheet, fibre)[:, None] * fibre)
    return Fibres(fibre, sheet, outward, along, depth, wall)


def wall_and_depth(potentials: Floats) -> tuple[Integers, Floats]:
    """`Wall` and depth of each tetrahedron, as in `Fibres`, from `wall_potentials`."""
    # the wall between the two surfaces of higher potential
    wall = np.array([Wall.RV, Wall.LV, Wall.SEPTUM])[np.argmin(potentials, axis=0)]
    left, right, outside = potentials
    inner = np.where(wall == Wall.RV, right, left)
    outer = np.where(wall == Wall.SEPTUM, right, outside)
    return wall, 1 - inner / (inner + outer)


def _on_surfaces(potentials: Floats, outflow: Floats, angles: FibreAngles) -> tuple[Floats, Floats]:
    """α and β of the three surfaces (rad) for each tetrahedron, shape (3, m)."""
    # epicardial angles pass from the left ventricle's to the right one's along their junction
    right = potentials[1] / np.maximum(potentials[0] + potentials[1], np.finfo(float).tiny)
    everywhere = np.ones_like(right)
    epicardial = angles.lv_epicardium * (1 - right) + angles.rv_epicardium * right
    inside = np.outer((angles.lv_endocardium, angles.rv_endocardium), everywhere)
    fibre = np.vstack([inside, epicardial])
    in_tract = (angles.outflow_endocardium, angles.outflow_endocardium, angles.outflow_epicardium)
    fibre = (1 - outflow) * fibre + np.outer(in_tract, outflow)
    sheet = (angles.sheet_endocardium, angles.sheet_endocardium, angles.sheet_epicardium)
    return fibre, np.outer(sheet, everywhere)


def _frame(out: Floats, baseward: Floats) -> tuple[Floats, Floats]:
    """Directions around the ventricle, e_c, and along it, e_l, for e_t out of it."""
    along = unit(baseward - _dot(baseward, out)[:, None] * out)
    return np.cross(along, out), along


def _lines(vectors: Floats) -> Floats:
    """Tensors v⊗v of the lines along vectors (m, 3), for which the sign does not matter."""
    return vectors[:, :, None] * vectors[:, None, :]


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("mx,mx->m", a, b))
