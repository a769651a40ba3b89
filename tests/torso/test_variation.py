"""Lead fields as a function of the body, on a ball of all tissues."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spheres import heart_in_torso

from fascicle.core.parameters import Infeasible
from fascicle.core.quantities import QUANTITIES, TORSO_QUANTITIES
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.measures import signed_volumes
from fascicle.torso.conductor import (
    TorsoState,
    build_conductor,
    build_morph,
    pulled_back,
    torso_axes,
)
from fascicle.torso.lead_fields import assemble_stiffness, solve_neumann
from fascicle.torso.response import LEFT, UPWARD, TorsoResponse, at_electrodes, near_field
from fascicle.torso.training import (
    build_response,
    currents,
    electrode_places,
    exterior,
    hull_modes,
    inner_energies,
    plain_hull,
    random_torsos,
    solve_torso,
)

RADIUS = 100.0  # mm
TISSUES = [TorsoTissue.BLOOD, None, TorsoTissue.LUNG, TorsoTissue.OTHER]
state = TorsoState.of
NEUTRAL = state({})


def angles(azimuth, elevation):
    """Points of the sphere; degrees from the front (-y) to the left (+x), and upwards."""
    azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    flat = np.cos(elevation)
    return RADIUS * np.stack(
        [flat * np.sin(azimuth), -flat * np.cos(azimuth), np.sin(elevation)], 1
    )


@pytest.fixture(scope="module")
def conductor():
    at = [-60, 60, 40, -10, 10, 25, 40, 60, 80], [45, 45, -45, 5, 5, 0, -5, -5, -5]
    fibre = np.array([2.0, 0.0, 1.0]) / np.sqrt(5.0)
    heart, torso = heart_in_torso(
        8, [20.0, 40.0, 70.0, RADIUS], [0.25, 0.5, 0.75, 1.0], TISSUES, angles(*at), fibre
    )
    return build_conductor(heart, torso, Conduction())


@pytest.fixture(scope="module")
def places(conductor):
    return electrode_places(conductor)


@pytest.fixture(scope="module")
def response(conductor):
    rng = np.random.default_rng(1)
    return build_response(conductor, rng, mode_torsos=16, modes=40, outer_torsos=80)


def solve(conductor, places, body):
    """Potentials (n, 9) of all electrodes by finite elements."""
    return solve_torso(conductor, places, body, tolerance=1e-8, most=500)


def direct(conductor, places, body):
    """Lead fields in the heart (9, n)."""
    return solve(conductor, places, body)[: len(conductor.heart.vertices)].T


def relative(conductor, found, expected):
    """Difference of fields in the energy of the heart, as part of the expected ones."""
    heart = conductor.heart
    stiffness = assemble_stiffness(heart.vertices, heart.tetrahedra, conductor.of_heart)
    norms = [np.sqrt(np.sum(z * (stiffness @ z.T).T)) for z in (found - expected, expected)]
    return norms[0] / norms[1]


class TestAxesAndMotion:
    def test_axes_do_not_depend_on_where_the_leg_electrode_is(self):
        electrodes = np.zeros((9, 3))
        electrodes[:3] = (-150, -80, 130), (150, -80, 130), (110, -80, -300)
        np.testing.assert_allclose(torso_axes(electrodes), np.eye(3), atol=1e-12)

    def test_left_is_left(self, conductor):
        """The heart 10 mm to the left: seen from it, the skin lies 10 mm further right."""
        skin = conductor.motion(state({"heart_left": 10.0}))(np.zeros((1, 3)))
        np.testing.assert_allclose(skin, [[-10.0, 0.0, 0.0]], atol=1e-9)

    def test_neutral_is_every_default(self):
        body = state({name: QUANTITIES[name].default for name in TORSO_QUANTITIES})
        for found, expected in zip(vars(body).values(), vars(NEUTRAL).values(), strict=True):
            np.testing.assert_array_equal(found, expected)


class TestMovedConductor:
    def test_neutral_body_is_the_torso(self, conductor):
        expected = assemble_stiffness(
            conductor.torso.vertices, conductor.tetrahedra, conductor.conductivity
        )
        difference = conductor.stiffness(NEUTRAL) - expected
        assert abs(difference).max() < 1e-9 * abs(expected).max()

    def test_all_conductivities_alike_change_nothing_but_the_scale(self):
        names = ("lung", "blood", "myocardium", "body")
        alike = state({f"{name}_conductivity": 1.6 for name in names})
        np.testing.assert_allclose(alike.ratios, 1.0)

    def test_tissues_conduct_as_their_factors_say(self, conductor):
        body = state({"lung_conductivity": 2.0, "myocardium_conductivity": 0.5})
        factors = conductor.moved(body) / conductor.moved(NEUTRAL)
        for tissue, factor in zip(TISSUES[2:], (4.0, 2.0), strict=True):
            own = factors[conductor.torso.tissues == tissue]
            assert own[:, range(3), range(3)] == pytest.approx(factor)

    def test_a_rotation_leaves_the_tensors_of_what_moves_with_the_skin(self):
        jacobians = Rotation.from_rotvec([[0.1, -0.2, 0.3]]).as_matrix()
        np.testing.assert_allclose(pulled_back(jacobians)[0], np.eye(3), atol=1e-12)

    @pytest.mark.parametrize(
        "values",
        [
            {"heart_posterior": -15.0, "heart_rotation_up": 0.2},
            {"chest_size": 0.9, "heart_up": 8.0},
        ],
    )
    def test_against_the_moved_mesh(self, conductor, places, values):
        """Corners moved by the same map, and tissues as they are."""
        body = state(values)
        heart, torso = conductor.heart, conductor.torso
        motion = conductor.motion(body)
        inner = np.linalg.norm(heart.vertices, axis=1).max()
        radius = np.linalg.norm(torso.vertices, axis=1)
        share = np.clip((radius - inner) / (RADIUS - inner), 0, 1)
        moved = torso.vertices + share[:, None] * (motion(torso.vertices) - torso.vertices)
        assert signed_volumes(moved, torso.tetrahedra).min() > 0
        loads = currents(places, body, len(torso.vertices))
        stiffness = assemble_stiffness(moved, conductor.tetrahedra, conductor.conductivity)
        expected = solve_neumann(stiffness, loads.T)[:, : len(heart.vertices)]
        assert relative(conductor, direct(conductor, places, body), expected) < 0.04
        assert relative(conductor, direct(conductor, places, NEUTRAL), expected) > 0.1

    def test_the_hull_feels_the_outside_as_the_skin_does(self, conductor, places):
        """With a body's own fields as modes, hull and outside give them back."""
        body = state({
            "heart_left": 12.0, "heart_rotation_up": 0.2,
            "chest_size": 1.1, "lung_conductivity": 1.7,
        })  # fmt: skip
        fields = solve(conductor, places, body)
        # nine fields less their mean: eight modes
        modes = hull_modes(conductor, fields - fields.mean(axis=1, keepdims=True), 8)
        surface = modes[conductor.hull_surface]
        energy, driven = exterior(conductor, surface, places, tolerance=1e-8)(body)
        inner = np.tensordot(np.append(1.0, body.ratios), inner_energies(conductor, modes), axes=1)
        at = at_electrodes(driven, body.chest / body.geometry[6])
        found = np.linalg.solve(inner + body.ratios[0] * energy, (at - at.mean(axis=0)).T)
        expected = fields.T - fields.T.mean(axis=0)
        hearts = slice(len(conductor.heart.vertices))
        assert relative(conductor, (modes @ found).T[:, hearts], expected[:, hearts]) < 1e-4

    def test_morph_has_the_slope_of_its_share(self, conductor):
        """By differences along a ray, on which heart and skin are spheres."""
        morph = build_morph(conductor.heart, conductor.torso, conductor.skin)
        radius = np.linalg.norm(morph.centres, axis=1)
        outside = (radius > 45) & (radius < 95)
        slope = np.einsum("mi,mi->m", morph.slope, morph.centres / radius[:, None])
        np.testing.assert_allclose(slope[outside], 1 / 60.0, rtol=0.25)
        assert (morph.share[radius < 35] == 0).all()


def test_near_field_is_that_of_an_insulated_plane(conductor):
    """Far from the hull its projection is an almost constant gradient, 2/(4πσr²)."""
    body = conductor.around[conductor.torso.tissues == TorsoTissue.OTHER][0, 0, 0]
    # the potentials x, y and z
    surface = conductor.torso.vertices[conductor.hull_surface]
    hull, projection, filled = plain_hull(conductor, surface)
    distance = 1e3
    electrode = np.array([[distance, 0.0, 0.0]])
    found = near_field(electrode, hull, projection, filled) @ np.linalg.inv(filled)
    expected = 10.0 / (2 * np.pi * body) / distance**2  # kΩ/mm, distances in cm
    np.testing.assert_allclose(found[0], [expected, 0.0, 0.0], atol=0.02 * expected)


def test_places_along_a_sphere(conductor, places):
    """Distances along the skin are arcs."""
    points = places.points(conductor.torso.vertices)
    grid = points[3:].reshape(6, len(LEFT), len(UPWARD), 3)
    middle = len(LEFT) // 2
    elevation = np.degrees(
        np.arcsin(grid[0, middle, :, 2] / np.linalg.norm(grid[0, middle], axis=1))
    )
    # the skin is a polyhedron, a little smaller than the sphere
    np.testing.assert_allclose(elevation, 5 + np.degrees(UPWARD / RADIUS), atol=2.5)
    east = grid[2, :, len(UPWARD) // 2]
    azimuth = np.degrees(np.arctan2(east[:, 0], -east[:, 1]))
    np.testing.assert_allclose(azimuth, 25 + np.degrees(LEFT / RADIUS), atol=2.0)


class TestResponse:
    def test_neutral(self, conductor, places, response):
        found = response(NEUTRAL) @ response.modes
        assert relative(conductor, found, direct(conductor, places, NEUTRAL)) < 0.06

    def test_random_torsos(self, conductor, places, response):
        """A third of the bodies of a heart's own response; a tenth of what changes is left."""
        errors, changes = [], []
        for body in random_torsos(conductor, 6, np.random.default_rng(9)):
            expected = direct(conductor, places, body)
            errors.append(relative(conductor, response(body) @ response.modes, expected))
            changes.append(relative(conductor, direct(conductor, places, NEUTRAL), expected))
        assert np.median(errors) < 0.1
        assert np.median(changes) > 3 * np.median(errors)

    def test_a_heart_that_would_touch_the_skin(self, response):
        body = TorsoState(np.array([60.0, 0, 0, 0, 0, 0, 1.0]), np.ones(3), np.zeros((6, 2)))
        assert isinstance(response(body), Infeasible)

    def test_arrays_say_it_all(self, response):
        body = state({"v2_left": 13.0, "heart_up": 4.0})
        assert np.abs(response(body).sum(axis=0)).max() < 1e-9
        again = TorsoResponse(**response.arrays())
        np.testing.assert_array_equal(again(body), response(body))
