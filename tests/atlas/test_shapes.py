"""Deformations of one mesh: volumes that are asked for, walls, and that nothing turns over."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.atlas.population import HeartSize
from fascicle.build.surface_checks import wall_thickness
from fascicle.core.errors import InputError
from fascicle.mesh.measures import closed_by_fan, signed_volumes
from tools.heart_family import DENSITY, REACH, HeartFamily, with_drawn_seeds


@pytest.fixture(scope="module")
def family(small_heart):
    return HeartFamily.of(small_heart)


def cavity(endocardium):
    return -closed_by_fan(endocardium.vertices, endocardium.triangles)[0] / 1e3


def test_the_template_s_own_volumes_leave_it_as_it_is(family):
    lv, mass, rv = family.volumes(family.template.vertices)
    heart = family.deformed(HeartSize(lv, mass, rv))
    assert heart.vertices == pytest.approx(family.template.vertices, abs=1e-9)


@pytest.mark.parametrize(
    ("factors", "elongation"),
    [((1.3, 1.0, 1.3), 1.0), ((0.8, 1.3, 0.9), 1.0), ((1.8, 1.4, 1.2), 0.9), ((1, 1, 1.5), 1.1)],
)
def test_hearts_have_the_volumes_that_are_asked_for(family, factors, elongation):
    wanted = family.volumes(family.template.vertices) * factors
    heart = family.deformed(HeartSize(*wanted, elongation))
    tissue = signed_volumes(heart.vertices, heart.tetrahedra)
    assert tissue.min() > 0
    assert cavity(heart.lv) == pytest.approx(wanted[0], rel=2e-3)
    assert DENSITY * tissue[family.left].sum() / 1e3 == pytest.approx(wanted[1], rel=2e-3)
    assert cavity(heart.rv) == pytest.approx(wanted[2], rel=2e-3)
    assert np.linalg.norm(heart.fibres, axis=1) == pytest.approx(np.ones(len(tissue)))
    # endocardia stay parts of the mesh
    for endocardium, numbers in zip(heart.endocardia, family.endocardial, strict=True):
        np.testing.assert_array_equal(endocardium.vertices, heart.vertices[numbers])


def test_mass_alone_makes_the_left_walls_thicker(family):
    volumes = family.volumes(family.template.vertices)
    thicker = family.deformed(HeartSize(volumes[0], 1.4 * volumes[1], volumes[2]))
    before, after = (
        wall_thickness(replace(family.mesh, vertices=v))
        for v in (family.template.vertices, thicker.vertices)
    )
    assert np.median(after.lv) > 1.15 * np.median(before.lv)
    assert np.median(after.septum) > 1.1 * np.median(before.septum)


def test_a_right_wall_twice_as_thick(family):
    volumes = family.volumes(family.template.vertices)
    thicker = family.deformed(HeartSize(*volumes, rv_wall=2.0))
    before, after = (
        wall_thickness(replace(family.mesh, vertices=v)).rv
        for v in (family.template.vertices, thicker.vertices)
    )
    assert np.median(after - before) == pytest.approx(2.0, abs=1.0)  # mm


def test_impossible_volumes_are_refused(family):
    lv, mass, rv = family.volumes(family.template.vertices)
    with pytest.raises(InputError, match="less extreme"):
        family.deformed(HeartSize(lv, 8 * mass, 0.1 * rv))


def test_bundles_start_and_head_for_places_near_those_of_the_heart(small_heart):
    rng = np.random.default_rng(0)
    hearts = [with_drawn_seeds(small_heart, rng) for _ in range(100)]
    drawn = np.array([[(e.root, e.direction) for e in heart.endocardia] for heart in hearts])
    for k, e in enumerate(small_heart.endocardia):
        ends = e.vertices[[e.root, e.direction]]
        distances = np.linalg.norm(e.vertices[drawn[:, k]] - ends, axis=2)
        assert 0.6 * REACH < distances.max() <= REACH
