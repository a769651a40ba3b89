"""Segments of the left ventricle: by hand on ellipsoids, by the electrodes on real hearts."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import FINER, heart_on, tissue
from scipy.spatial.transform import Rotation

from fascicle.core.leads import ELECTRODES
from fascicle.heart.fibres import Wall
from fascicle.heart.sites import APEX, RIGHT, SEGMENTS, places

DEPTH = 52.0  # mm, of the ellipsoids' left cavity


def middle(heart, chosen):
    centres = heart.vertices[heart.tetrahedra[chosen]].mean(axis=1)
    return np.average(centres, axis=0, weights=heart.volumes[chosen])


@pytest.fixture(scope="module")
def ellipsoids():
    """Axis of the left ventricle down z, the right one towards x; so y is anterior."""
    return heart_on(tissue(FINER))


def test_ellipsoids_by_hand(ellipsoids):
    found = places(ellipsoids)
    x, y, z = ellipsoids.vertices[ellipsoids.tetrahedra].mean(axis=1).T
    angle, third = np.degrees(np.arctan2(y, x)), 3 * -z / DEPTH
    by_hand = np.full(len(x), APEX)
    six = [(0, 60, 2), (60, 120, 1), (120, 180, 6), (-180, -120, 5), (-120, -60, 4), (-60, 0, 3)]
    for first, last, number in six:
        sector = (angle >= first) & (angle < last)
        by_hand[sector & (third < 1)] = number
        by_hand[sector & (third >= 1) & (third < 2)] = 6 + number
    apical = (third >= 2) & (third < 3)
    for first, last, number in [(-45, 45, 14), (45, 135, 13), (-135, -45, 15)]:
        by_hand[apical & (angle >= first) & (angle < last)] = number
    by_hand[apical & (np.abs(angle) >= 135)] = 16
    left = found.wall != Wall.RV
    assert (found.segment[~left] == RIGHT).all()
    # the axis ends at a vertex of the mesh, and the middle of the septum is that of its elements
    assert (found.segment == by_hand)[left].mean() > 0.95
    np.testing.assert_allclose(found.height[left], -z[left] / DEPTH, atol=0.05)


@pytest.fixture(params=["default_heart", "crtdemo"])
def heart(request):
    return request.getfixturevalue(request.param)


def test_of_a_heart_in_its_body(heart):
    """Anterior is above inferior, lateral to the left of septal, and the septum is septal."""
    found = places(heart)
    electrodes = dict(zip(ELECTRODES, heart.electrodes, strict=True))
    up = (electrodes["RA"] + electrodes["LA"]) / 2 - electrodes["LL"]
    left = electrodes["LA"] - electrodes["RA"]
    at = {name: middle(heart, found.segment == k) for k, name in enumerate(SEGMENTS, 1)}
    for level in ("basal", "mid", "apical"):
        assert (at[f"{level} anterior"] - at[f"{level} inferior"]) @ up > 0
    for level in ("basal", "mid"):
        for wall in ("antero", "infero"):
            assert (at[f"{level} {wall}lateral"] - at[f"{level} {wall}septal"]) @ left > 0
    assert (at["apical lateral"] - at["apical septal"]) @ left > 0
    for name in ("anteroseptal", "inferoseptal"):
        for level in ("basal", "mid"):
            chosen = found.segment == 1 + SEGMENTS.index(f"{level} {name}")
            assert (found.wall[chosen] == Wall.SEPTUM).mean() > 0.95
    lateral = np.isin(found.segment, [5, 6, 11, 12, 16])
    assert not (found.wall[lateral] == Wall.SEPTUM).any()
    assert set(found.segment) == set(range(18))


def test_it_does_not_matter_how_the_heart_lies(small_heart):
    def moved(vertices):
        turn = Rotation.from_euler("xyz", [40, -110, 75], degrees=True)
        return turn.apply(vertices) + np.array([5, -80, 900.0])

    sides = {e.side: replace(e, vertices=moved(e.vertices)) for e in small_heart.endocardia}
    other = replace(small_heart, vertices=moved(small_heart.vertices), **sides)
    one, two = places(small_heart), places(other)
    assert (one.segment == two.segment).mean() > 0.999
    np.testing.assert_allclose(one.depth, two.depth, atol=1e-3)
