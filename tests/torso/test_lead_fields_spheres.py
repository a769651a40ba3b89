"""Lead fields of balls against closed forms and series."""

from dataclasses import replace

import numpy as np
import pytest
from spheres import (
    at_eccentricity,
    ball,
    concentric,
    gradients_around,
    heart_in_torso,
    homogeneous,
    isotropic,
    radial_and_tangential,
    rim_points,
)

from benchmarks.references import unbounded
from fascicle.forward.electrocardiogram import nodal_gradients
from fascicle.heart.conduction import Conduction, transversely_isotropic
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.measures import barycentric_gradients, signed_volumes
from fascicle.torso.lead_fields import (
    assemble_stiffness,
    lead_fields,
    place_electrodes,
    solve_neumann,
)

pytestmark = pytest.mark.slow

RADIUS = 100.0  # mm, about a chest
RADII, AT = [50.0, 75.0, 100.0], [0.5, 0.75, 1.0]
LAYERS = 20
SPREAD = 10.0  # mm: radius of a dipole, two layers; it stays in its shell


def solved_at(vertices, tetrahedra, sigma, electrodes):
    """Lead fields of electrodes that touch the nearest points of the skin."""
    contacts = place_electrodes(vertices, tetrahedra, electrodes)
    return solve_neumann(
        assemble_stiffness(vertices, tetrahedra, sigma), contacts.currents(len(vertices))
    )


@pytest.fixture(scope="module")
def chest():
    return ball(LAYERS, RADII, AT)


def referenced(values):
    """To the mean of the electrodes, as lead fields are."""
    return values - values.mean(axis=0)


def touching(vertices, tetrahedra, electrodes):
    """The points at which the current enters."""
    return place_electrodes(vertices, tetrahedra, electrodes).points(vertices)


def slopes_by_differences(field, points, step=1e-3):
    """Gradient by central differences, shape (p, 3)."""
    shifts = step * np.eye(3)
    return np.stack([(field(points + d) - field(points - d)) / (2 * step) for d in shifts], axis=1)


def lead_error(computed, exact, dipoles):
    """Relative L2 error of the potentials of all dipoles on all electrodes.

    In a sphere only the place of an electrode relative to the dipole counts, so that all pairs
    together sample the surface potential of one dipole.
    """
    potentials, truth = (np.einsum("epi,pi->ep", slopes, dipoles) for slopes in (computed, exact))
    return np.linalg.norm(potentials - truth) / np.linalg.norm(truth)


class TestDipoles:
    """Potentials of eccentric dipoles on six electrodes, by reciprocity."""

    @pytest.fixture(scope="class")
    def homogeneous_fields(self, chest):
        return self.solved(chest, (2.0, 2.0, 2.0))

    @pytest.fixture(scope="class", params=[(6.0, 0.5, 2.0), (2.4, 7.0, 0.4)], ids=str)
    def shells(self, chest, request):
        return request.param, self.solved(chest, request.param)

    def solved(self, chest, sigma):
        vertices, tetrahedra, shell = chest
        return solved_at(
            vertices, tetrahedra, isotropic(np.array(sigma)[shell]), rim_points(6, RADIUS)
        )

    @pytest.mark.parametrize("eccentricity", [0.25, 0.6])
    def test_homogeneous_ball(self, chest, homogeneous_fields, eccentricity):
        def slopes(points, electrode):
            return homogeneous(points, electrode, np.linalg.norm(electrode), 2.0)[1]

        assert self.worst(chest, homogeneous_fields, eccentricity, slopes) < 0.03

    @pytest.mark.parametrize("eccentricity", [0.25, 0.6])
    def test_concentric_balls(self, chest, shells, eccentricity):
        sigma, fields = shells

        def slopes(points, electrode):
            return slopes_by_differences(lambda x: concentric(x, electrode, RADII, sigma), points)

        assert self.worst(chest, fields, eccentricity, slopes) < 0.03

    def worst(self, chest, fields, eccentricity, slopes):
        """The larger error of forty radial and of forty tangential dipoles."""
        vertices, tetrahedra, _ = chest
        points = vertices[at_eccentricity(vertices, eccentricity * RADIUS, 40)]
        entries = touching(vertices, tetrahedra, rim_points(6, RADIUS))
        exact = referenced(np.stack([slopes(points, entry) for entry in entries]))
        computed = gradients_around(vertices, tetrahedra, fields, points, SPREAD)
        return max(
            lead_error(computed, exact, dipoles) for dipoles in radial_and_tangential(points)
        )


class TestOrder:
    def test_second_in_the_potential_and_first_in_its_gradient(self):
        electrodes = np.array([[0.0, 0.0, RADIUS], [0.0, RADIUS, 0.0]])
        errors = np.array([self.errors(layers, electrodes) for layers in (6, 12, 24)])
        orders = np.log2(errors[:-1] / errors[1:])
        assert orders[:, 0] == pytest.approx(2.0, abs=0.35)
        assert orders[:, 1] == pytest.approx(1.0, abs=0.25)

    def errors(self, layers, electrodes):
        """Relative L2 errors of Z and of ∇Z in the inner part of a ball."""
        vertices, tetrahedra, _ = ball(layers, [RADIUS])
        sigma = isotropic(np.full(len(tetrahedra), 2.0))
        first, second = solved_at(vertices, tetrahedra, sigma, electrodes)
        ends = touching(vertices, tetrahedra, electrodes)
        inner = np.linalg.norm(vertices[tetrahedra], axis=2).max(axis=1) < 0.6 * RADIUS
        used, elements = np.unique(tetrahedra[inner], return_inverse=True)
        points, elements = vertices[used], elements.reshape(-1, 4)
        volumes = signed_volumes(points, elements)
        weights = np.bincount(elements.ravel(), np.repeat(volumes, 4))

        exact = np.subtract(*(homogeneous(points, end, RADIUS, 2.0)[0] for end in ends))
        error = (first - second)[used] - exact
        error -= np.average(error, weights=weights)
        potential = np.sqrt((weights @ error**2) / (weights @ exact**2))

        gradients = barycentric_gradients(points, elements)
        computed = nodal_gradients((first - second)[None, used], elements, gradients)[0]
        centres = points[elements].mean(axis=1)
        slope = np.subtract(*(homogeneous(centres, end, RADIUS, 2.0)[1] for end in ends))
        missed = volumes @ ((computed - slope) ** 2).sum(axis=1)
        return potential, np.sqrt(missed / (volumes @ (slope**2).sum(axis=1)))


class TestAnisotropy:
    def test_a_stretched_ball_with_fibres(self):
        """x' = Ax turns σ into AσAᵀ/det A and leaves Z alone: an exact anisotropic solution."""
        fibre = np.array([2.0, 1.0, 0.7]) / np.linalg.norm([2.0, 1.0, 0.7])
        tensor = transversely_isotropic(fibre[None], 6.0, 1.5)[0]
        root = transversely_isotropic(fibre[None], np.sqrt(6.0), np.sqrt(1.5))[0]
        stretch = 2.0 / np.sqrt(np.linalg.det(tensor)) * root  # from 2 mS/cm to the tensor
        round_, tetrahedra, _ = ball(12, [RADIUS])
        electrodes = round_[at_eccentricity(round_, RADIUS, 9)]
        vertices, at = round_ @ stretch, at_eccentricity(round_, 0.5 * RADIUS, 12)
        fields = solved_at(
            vertices, tetrahedra, np.tile(tensor, (len(tetrahedra), 1, 1)), electrodes @ stretch
        )
        exact = referenced(
            np.stack([homogeneous(round_[at], e, RADIUS, 2.0)[0] for e in electrodes])
        )
        error = fields[:, at] - exact
        error -= error.mean(axis=1, keepdims=True)
        assert np.linalg.norm(error) < 0.02 * np.linalg.norm(exact)


class TestHeartInTorso:
    def test_every_tissue_has_its_conductivity(self):
        """Blood, myocardium, lung and body as shells of one sphere, against the series."""
        radii, at = [30.0, 50.0, 70.0, 100.0], [0.3, 0.5, 0.7, 1.0]
        tissues = [TorsoTissue.BLOOD, None, TorsoTissue.LUNG, TorsoTissue.OTHER]
        electrodes = rim_points(12, RADIUS + 4.0)  # three of them besides the nine
        heart, torso = heart_in_torso(20, radii, at, tissues, electrodes[:9])
        more = {f"E{k}": place for k, place in enumerate(electrodes[9:])}
        heart = replace(heart, additional_electrodes=more)
        conduction = Conduction(1.0, 1.0, 2.5, 2.5, body=2.0, lung=0.5, blood=8.0)
        fields = lead_fields(heart, torso, conduction)
        assert fields.shape == (12, len(heart.vertices))

        everything = np.concatenate([heart.tetrahedra, torso.tetrahedra])
        entries = touching(torso.vertices, everything, electrodes)
        series = [concentric(heart.vertices, e, radii, [8.0, 3.5, 0.5, 2.0]) for e in entries]
        exact = np.stack(series)
        exact -= exact[:9].mean(axis=0)
        error = fields - exact
        error -= error.mean(axis=1, keepdims=True)
        assert np.linalg.norm(error) < 0.03 * np.linalg.norm(exact)
        assert np.linalg.norm(error[9:]) < 0.03 * np.linalg.norm(exact[9:])

    def test_far_from_the_skin_it_is_the_unbounded_field(self):
        """Between two points near the middle of a ball eight times as wide as they are apart."""
        outer = 60.0 * 1.3 ** np.arange(9)
        vertices, tetrahedra, _ = ball(20, outer, np.arange(12, 21) / 20)
        there = at_eccentricity(vertices, 30.0, 300)
        source, sink = there[0], there[np.argmin(vertices[there] @ vertices[there[0]])]
        current = np.zeros((1, len(vertices)))
        current[0, [source, sink]] = 1.0, -1.0
        stiffness = assemble_stiffness(
            vertices, tetrahedra, isotropic(np.full(len(tetrahedra), 2.0))
        )
        potential = solve_neumann(stiffness, current)[0]
        ends = vertices[[source, sink]]
        away = np.linalg.norm(vertices[:, None] - ends, axis=2).min(axis=1)
        near = (np.linalg.norm(vertices, axis=1) < 55.0) & (away > 20.0)
        first, second = unbounded(vertices[near], ends, 2.0)
        error = potential[near] - (first - second)
        assert np.linalg.norm(error) < 0.05 * np.linalg.norm(first - second)
