"""What `check_heart` measures on ventricles whose figures are known, and when it warns."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from math import radians

import anatomies
import numpy as np
import pytest
from anatomies import CENTRE_X, EPI, HALF_AXES, LV, PLACES, RV
from shapes import biventricular_surface

from fascicle.build.build_heart import heart_of
from fascicle.build.check import cavity_volume, check_heart
from fascicle.build.labelled_files import Anatomy
from fascicle.build.meshing import filled
from fascicle.build.refinement import refined
from fascicle.build.surface_repair import prepared_surface
from fascicle.core.leads import ELECTRODES
from fascicle.heart.fibres import FibreAngles
from fascicle.heart.heart import Heart
from fascicle.purkinje.chart import build_chart

ELECTRODE_PLACES = np.array([PLACES[name] for name in ELECTRODES], dtype=float)


@cache
def heart_with(lv=(60.0, -60.0), rv=(90.0, -25.0)) -> Heart:
    """The ventricles with rule-based fibres of these helix angles (degrees)."""
    angles = FibreAngles(*map(radians, (*lv, *rv)))
    return replace(heart_of(Anatomy(anatomies.tissue()), angles), electrodes=ELECTRODE_PLACES)


def check(heart):
    return check_heart(heart, {e.side: build_chart(e) for e in heart.endocardia})


def through(angles, ratio=1.0):
    """Angles in the middle of five layers between two surfaces (degrees).

    The rule's depth is harmonic: between cylinders whose radii have this ratio it goes with the
    logarithm of the radius, and so it does nearly between these ellipsoids.
    """
    depth = (np.arange(5) + 0.5) / 5
    if ratio > 1:
        depth = np.log(1 + (ratio - 1) * depth) / np.log(ratio)
    return angles[0] + depth * (angles[1] - angles[0])


# From the middle of the left ventricle to its two surfaces, on the left
RATIO = (HALF_AXES[EPI][0] - CENTRE_X[EPI]) / HALF_AXES[LV][0]


def test_helix_of_each_wall_is_as_specified():
    helix = check(heart_with(lv=(45.0, 10.0))).helix["LV free wall"]
    np.testing.assert_allclose(helix.in_layers(), through((45.0, 10.0), RATIO), atol=4)
    helix = check(heart_with(lv=(30.0, -30.0), rv=(20.0, -40.0))).helix
    free_wall = helix["LV free wall"].in_layers()
    np.testing.assert_allclose(free_wall, through((30.0, -30.0), RATIO), atol=4)
    np.testing.assert_allclose(helix["RV free wall"].in_layers(), through((20, -40)), atol=7)
    # what rises on the septum's right side, seen from there, falls seen from the left
    np.testing.assert_allclose(helix["septum"].in_layers(), through((30, -20)), atol=7)


def test_layers_average_directions_without_a_sign():
    helix = check(heart_with()).helix["LV free wall"]
    steep = replace(helix, angle=np.where(np.arange(len(helix.angle)) % 2, 89.0, -89.0))
    assert np.abs(steep.in_layers()).min() > 88.9
    assert np.isnan(replace(helix, depth=np.full_like(helix.depth, 0.5)).in_layers()[0])


def test_figures_are_those_of_the_ellipsoids():
    heart = heart_with()
    found = check(heart)
    rows = dict(found.rows)
    lv, rv = map(cavity_volume, heart.endocardia)
    assert [lv, rv] == pytest.approx(list(map(anatomies.volume_below, (LV, RV))), rel=0.1)
    assert rows["myocardium"].startswith(f"{heart.volumes.sum() / 1000:.1f} ml")
    assert f"LV {lv:.0f}, RV {rv:.0f} ml" in rows["myocardium"]
    extent = [float(word) for word in rows["extent"].removesuffix(" mm").split(" x ")]
    np.testing.assert_allclose(extent, np.multiply(HALF_AXES[EPI], (2, 2, 1)), atol=2)
    thickness = HALF_AXES[EPI][0] - CENTRE_X[EPI] - HALF_AXES[LV][0]  # at the left
    assert np.median(found.walls.lv) == pytest.approx(thickness, abs=2.5)
    assert f"{len(heart.tetrahedra)} tetrahedra" in rows["mesh"]
    z = heart.lv.vertices[:, 2]  # up, from apex to base
    places = 100 * (z.max() - z[[heart.lv.root, heart.lv.direction]]) / np.ptp(z)
    said = re.fullmatch(
        rf"starts at point {heart.lv.root}, (\d+)% of the way from base to apex, and heads for "
        rf"point {heart.lv.direction}, at (\d+)%",
        rows["LV bundle"],
    )
    assert [float(share) for share in said.groups()] == pytest.approx(places, abs=5)
    assert re.search(
        r"stretched up to \d\.\d times more one way .* \(fine up to 12\)", rows["RV map"]
    )
    assert rows["torso"] == "none (unbounded conductor)"
    assert rows["electrodes"].startswith("9; nearest to the heart V2, 3")
    assert found.warnings == ()


def assert_only_warning(heart, start):
    """There is one warning, a line that begins with `start`."""
    (warning,) = check(heart).warnings
    assert warning.startswith(start)
    assert "\n" not in warning


def test_walls_thinner_than_the_edges_give_a_warning():
    """An RV wall of 5 mm with edges of 6.5 mm; the refined heart has no such warning."""
    mesh = filled(prepared_surface(biventricular_surface(3.0)), 6.5)
    heart = replace(heart_of(Anatomy(mesh)), electrodes=ELECTRODE_PLACES)
    (warning,) = (w for w in check(heart).warnings if w.startswith("mesh: "))
    assert re.search(r"longer than the RV free wall is thick in \d\d% of it", warning)
    assert not [w for w in check(refined(heart)).warnings if w.startswith("mesh: ")]


def test_fibres_of_the_wrong_helix_sense_give_a_warning():
    mirrored = heart_with(lv=(-60.0, 60.0))
    assert_only_warning(mirrored, "fibres: the helix angle of the LV free wall")
    assert "mirrored" in check(mirrored).warnings[0]


def test_electrodes_exchanged_or_almost_on_the_heart_give_a_warning():
    heart = heart_with()
    for pair in (["RA", "LA"], ["V3", "V4"]):
        places, rows = ELECTRODE_PLACES.copy(), [ELECTRODES.index(name) for name in pair]
        places[rows] = places[rows[::-1]]
        assert_only_warning(replace(heart, electrodes=places), f"electrodes {' and '.join(pair)}")
    places = ELECTRODE_PLACES.copy()
    nearest = heart.vertices[np.argmin(np.linalg.norm(heart.vertices - places[4], axis=1))]
    places[4] = nearest + 4 * (places[4] - nearest) / np.linalg.norm(places[4] - nearest)
    assert_only_warning(replace(heart, electrodes=places), "electrode V2 is 4 mm from the heart")


def test_a_small_heart_gives_warnings_with_its_volumes():
    heart = heart_with()
    small = replace(
        heart,
        vertices=0.55 * heart.vertices,
        lv=replace(heart.lv, vertices=0.55 * heart.lv.vertices),
        rv=replace(heart.rv, vertices=0.55 * heart.rv.vertices),
    )
    found = [line.split(":")[0] for line in check(small).warnings]
    assert found[:3] == ["LV cavity", "RV cavity", "myocardium"]
    assert f"{cavity_volume(small.lv):.3g} ml" in check(small).warnings[0]
