"""Fibres by rule: exact ones on a slab and a spheroid; angles and continuity in a whole heart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from labelled_walls import Spheroid, slab
from scipy.spatial import cKDTree

from fascicle.core.errors import InputError
from fascicle.heart.fibres import (
    FibreAngles,
    Fibres,
    Wall,
    apex_to_base,
    by_rule,
    rule_based_fibres,
    wall_potentials,
)
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label, LabelledMesh, labelled_mesh
from fascicle.heart.laplace import quadratic_space
from fascicle.mesh.topology import faces_in_order

# the same in both ventricles
STREETER = FibreAngles(rv_endocardium=np.radians(60), rv_epicardium=np.radians(-60))


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle (degrees) between lines."""
    return np.degrees(np.arccos(np.clip(np.abs(np.sum(a * b, axis=1)), 0, 1)))


def steps(fibres: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Neighbouring tetrahedra (k, 2), and the angle (degrees) between their fibres."""
    order, same = faces_in_order(tetrahedra)
    pairs = np.stack([order[:-1][same], order[1:][same]], axis=1) // 4
    return pairs, between(fibres[pairs[:, 0]], fibres[pairs[:, 1]])


def helix_angle(fibres: Fibres) -> np.ndarray:
    """Angle (rad) of the part within the wall to the circumference, in (-π/2, π/2], shape (m,)."""
    around = np.cross(fibres.longitudinal, fibres.outward)
    along, across = (np.sum(fibres.fibre * axis, axis=1) for axis in (fibres.longitudinal, around))
    return np.pi / 2 - (np.pi / 2 - np.arctan2(along, across)) % np.pi


def angle_at(fibres: Fibres, wall: Wall, surface: float, among: np.ndarray | bool = True) -> float:
    """Helix angle (degrees) at depth 0 or 1: where the line through the nearest third ends."""
    near = among & (fibres.wall == wall) & (np.abs(fibres.depth - surface) < 1 / 3)
    # angles near ±90 degrees are neighbours: unfold around their mean
    angle = helix_angle(fibres)[near]
    mean = np.angle(np.exp(2j * angle).mean()) / 2
    unfolded = mean + (angle - mean + np.pi / 2) % np.pi - np.pi / 2
    slope, start = np.polyfit(fibres.depth[near] - surface, unfolded, 1)
    assert slope < 0
    return float(np.degrees(start))


@pytest.fixture(scope="module")
def spheroid() -> tuple[Spheroid, LabelledMesh, Fibres]:
    shape = Spheroid()
    mesh = shape.mesh(rings=16, layers=5)
    return shape, mesh, rule_based_fibres(mesh)


@pytest.fixture(scope="module")
def laplace(default_heart: Heart) -> tuple[LabelledMesh, tuple[np.ndarray, ...]]:
    """The packaged heart, and what the rule takes: potentials, gradients, way to base, outflow."""
    mesh = labelled_mesh(default_heart)
    space = quadratic_space(mesh.vertices, mesh.tetrahedra)
    return mesh, (*wall_potentials(space, mesh), *apex_to_base(space, mesh))


@pytest.fixture(scope="module")
def biventricular(laplace) -> tuple[LabelledMesh, Fibres]:
    mesh, fields = laplace
    return mesh, by_rule(*fields, STREETER)


@pytest.mark.parametrize(("thickness", "layers"), [(8, 4), (3, 1)])  # one is enough
def test_across_a_slab_angles_are_linear_and_as_prescribed(thickness, layers):
    mesh = slab(thickness, layers)
    fibres = rule_based_fibres(mesh)
    middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    far = middle[:, 2] > 30  # from the apex, so that its end is the only way to the base
    depth = middle[:, 1] / thickness
    angle = np.radians(60) * (1 - 2 * depth)
    # out of the ventricle is y, to the base z, and so around it -x
    expected = np.stack([-np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    assert between(fibres.fibre, expected)[far].max() < 0.5
    np.testing.assert_allclose(fibres.depth, depth, atol=1e-4)
    np.testing.assert_allclose(helix_angle(fibres)[far], angle[far], atol=np.radians(0.5))
    # sheets turn through the wall as Bayer et al. have them
    tilt = np.degrees(np.arcsin(np.abs(fibres.sheet[:, 1])))  # y is across the wall
    np.testing.assert_allclose(tilt[far], np.abs(-65 + 90 * depth[far]), atol=0.5)


def test_an_angle_of_zero_is_an_angle():
    mesh = slab(thickness=8, layers=2)
    fibres = rule_based_fibres(mesh, FibreAngles(lv_endocardium=0.0, lv_epicardium=0.0))
    np.testing.assert_allclose(helix_angle(fibres), 0, atol=1e-9)


def test_fibres_of_a_spheroid_are_the_exact_helices(spheroid):
    """Right-handed inside, left-handed outside."""
    shape, mesh, fibres = spheroid
    middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    exact = shape.fibres(middle, np.radians(60), np.radians(-60))
    error = between(fibres.fibre, exact)
    _, nu, _ = shape.coordinates(middle)
    assert np.median(error) < 1
    assert error[nu > np.radians(20)].max() < 5  # but for the apex, where there is no direction
    # counter-clockwise seen from the base, +z
    around = np.stack([-middle[:, 1], middle[:, 0]], axis=1)
    along = np.sum(fibres.fibre[:, :2] * around, axis=1) * fibres.fibre[:, 2]
    away = middle[:, 2] > -40  # from the apex
    assert np.all(along[away & (fibres.depth < 0.4)] > 0)
    assert np.all(along[away & (fibres.depth > 0.6)] < 0)


def test_directions_are_unit_vectors_and_orthogonal(biventricular):
    _, fibres = biventricular
    across = np.cross(fibres.sheet, fibres.fibre)
    for directions in (fibres.fibre, fibres.sheet, across, fibres.longitudinal):
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)


def test_walls_have_the_prescribed_angles_and_no_steps_but_along_the_junctions(biventricular):
    mesh, fibres = biventricular
    for wall in Wall:
        assert angle_at(fibres, wall, 0) == pytest.approx(60, abs=2)
        assert angle_at(fibres, wall, 1) == pytest.approx(-60, abs=2)
    pairs, angle = steps(fibres.fibre, mesh.tetrahedra)
    turned = 120 * np.abs(np.diff(fibres.depth[pairs], axis=1)[:, 0])
    same = fibres.wall[pairs[:, 0]] == fibres.wall[pairs[:, 1]]
    beyond = angle - turned
    assert np.mean(beyond[same] > 15) < 0.01
    septum = same & (fibres.wall[pairs[:, 0]] == Wall.SEPTUM)
    assert np.percentile(beyond[septum], 99) < 12
    assert np.mean(angle > 60) < 0.005


def test_the_rv_has_angles_of_its_own(laplace):
    mesh, fields = laplace
    fibres = by_rule(*fields, FibreAngles())
    # the epicardium's angle passes to the LV's along their junction
    middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    from_left, _ = cKDTree(middle[fibres.wall != Wall.RV]).query(middle)
    free = from_left > 6
    assert angle_at(fibres, Wall.RV, 0, free) == pytest.approx(90, abs=2)
    assert angle_at(fibres, Wall.RV, 1, free) == pytest.approx(-25, abs=2)
    # the septum's right side is the RV's endocardium, seen from the left
    assert abs(angle_at(fibres, Wall.SEPTUM, 1)) == pytest.approx(90, abs=2)


@pytest.mark.parametrize("missing", [Label.BASE, Label.EPICARDIUM, Label.LV_ENDOCARDIUM])
def test_a_missing_label_is_named(missing):
    mesh = slab(thickness=8, layers=2)
    mesh = replace(mesh, labels=np.where(mesh.labels == missing, 0, mesh.labels))
    words = f"slab: no boundary triangle is labelled as {missing.words}, "
    with pytest.raises(InputError, match=words):
        rule_based_fibres(mesh)


def test_fibres_of_the_rv_turn_towards_a_labelled_pulmonary_opening(laplace, biventricular):
    mesh, (potentials, gradients, _, _) = laplace
    _, plain = biventricular
    centres = mesh.vertices[mesh.triangles].mean(axis=1)
    to_right, to_left = (
        cKDTree(mesh.vertices[np.unique(mesh.having(label))]).query(centres)[0]
        for label in (Label.RV_ENDOCARDIUM, Label.LV_ENDOCARDIUM)
    )
    base = mesh.labels == Label.BASE
    right = base & (to_right < to_left) & (to_left > 12)
    # its third that lies furthest to the front of the body, -y
    opening = right & (centres[:, 1] < np.quantile(centres[right, 1], 1 / 3))
    mesh = replace(mesh, labels=np.where(opening, Label.PULMONARY, mesh.labels))
    space = quadratic_space(mesh.vertices, mesh.tetrahedra)
    baseward, outflow = apex_to_base(space, mesh)
    fibres = by_rule(potentials, gradients, baseward, outflow, STREETER)
    middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    distance, _ = cKDTree(centres[opening]).query(middle)
    near = (distance < 4) & (fibres.wall == Wall.RV)
    inside, outside = near & (fibres.depth < 0.3), near & (fibres.depth > 0.7)
    lengthwise = np.degrees(np.abs(helix_angle(fibres)))
    before = np.degrees(np.abs(helix_angle(plain)))
    assert np.median(before[inside]) < 55
    assert np.median(lengthwise[inside]) > np.median(before[inside]) + 8
    assert np.median(lengthwise[outside]) < np.median(before[outside]) - 15
    # and no further than the tract
    far = distance > 40
    assert between(fibres.fibre, plain.fibre)[far].max() < 1
