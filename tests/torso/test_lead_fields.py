"""Lead fields: what holds on any mesh."""

from dataclasses import replace

import numpy as np
import pytest
from builders import OBLIQUE, box
from spheres import ball, boundary_area_vectors, heart_in_torso, rim_points

from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES, lead_matrix
from fascicle.forward.electrocardiogram import nodal_gradients
from fascicle.heart.conduction import Conduction, Region, transversely_isotropic
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.measures import barycentric_gradients, signed_volumes
from fascicle.torso.lead_fields import (
    assemble_stiffness,
    lead_fields,
    place_electrodes,
    solve_neumann,
    total_conductivity,
)

RADIUS = 100.0  # mm
TISSUES = [TorsoTissue.BLOOD, None, TorsoTissue.LUNG, TorsoTissue.OTHER]


def chest(layers=8, electrodes=None):
    """Shells of all tissues around fibres along x + z/2."""
    electrodes = rim_points(9, RADIUS) if electrodes is None else electrodes
    fibre = np.array([2.0, 0.0, 1.0]) / np.sqrt(5.0)
    at = [0.25, 0.5, 0.75, 1.0]
    return heart_in_torso(layers, [25.0, 50.0, 75.0, RADIUS], at, TISSUES, electrodes, fibre)


@pytest.fixture(scope="module")
def mesh():
    """Vertices, tetrahedra and conductivity of a chest, and its lead fields."""
    heart, torso = chest()
    tetrahedra = np.concatenate([heart.tetrahedra, torso.tetrahedra])
    sigma = total_conductivity(heart, torso, Conduction())
    contacts = place_electrodes(torso.vertices, tetrahedra, heart.electrodes)
    fields = solve_neumann(
        assemble_stiffness(torso.vertices, tetrahedra, sigma),
        contacts.currents(len(torso.vertices)),
    )
    return torso.vertices, tetrahedra, sigma, fields


def test_scar_keeps_the_intact_conductivity():
    heart, torso = chest(4)
    scar = Conduction(regions=(Region(0.0, centre=(0.0, 0.0, 40.0), radius=30.0),))
    assert (lead_fields(heart, torso, scar) == lead_fields(heart, torso, Conduction())).all()


def test_linear_potentials_across_a_layered_anisotropic_box():
    """A field that is exact in linear elements: the normal current is continuous at x = 6."""
    block = box(12.0, 6, jitter=0.0)
    left = block.vertices[block.tetrahedra].mean(axis=1)[:, 0] < 6.0
    sigma = transversely_isotropic(np.tile(OBLIQUE, (len(left), 1)), 6.0, 1.5)
    sigma[~left] = 2.4 * np.eye(3)
    slope = np.array([0.7, -0.4, 0.2])  # mV/mm, on the left
    beyond = slope.copy()
    beyond[0] = (sigma[left][0] @ slope)[0] / 2.4
    x = block.vertices
    potential = x @ slope + np.maximum(x[:, 0] - 6.0, 0) * (beyond - slope)[0]

    triangles, owner, area = boundary_area_vectors(x, block.tetrahedra)
    slopes = np.where(left[owner, None], slope, beyond)
    # mS/cm · mV/mm · mm²: 10 mm/cm · (1 cm/10 mm)² leave a tenth of a µA
    inflow = 0.1 * np.einsum("ti,tij,tj->t", area, sigma[owner], slopes) / 3
    current = np.bincount(triangles.ravel(), np.repeat(inflow, 3), len(x))
    stiffness = assemble_stiffness(x, block.tetrahedra, sigma)
    assert np.abs(stiffness @ potential - current).max() < 1e-12 * np.abs(current).max() * 100

    # tangential currents differ across the interface, but close within each face
    solved = solve_neumann(stiffness, current[None])[0]
    assert solved == pytest.approx(potential - potential.mean(), abs=1e-8)


class TestReciprocity:
    def test_of_additional_electrodes(self, mesh):
        """What a dipole puts on an electrode, less the mean of the nine, is its lead field's fall.

        With the additional electrodes the fields of the nine stay the same to the last bit.
        """
        vertices, tetrahedra, sigma, nine = mesh
        more = {"V7": np.array([80.0, 0.0, 60.0]), "E3": np.array([60.0, -80.0, 0.0])}
        heart, torso = chest()
        fields = lead_fields(replace(heart, additional_electrodes=more), torso, Conduction())
        np.testing.assert_array_equal(fields[:9], nine[:, : len(heart.vertices)])
        source, sink = 0, len(heart.vertices) - 1
        dipole = np.zeros((1, len(vertices)))
        dipole[0, [source, sink]] = 1.0, -1.0
        potential = solve_neumann(assemble_stiffness(vertices, tetrahedra, sigma), dipole)[0]
        places = [*heart.electrodes, *more.values()]
        contacts = place_electrodes(vertices, tetrahedra, np.array(places))
        at = contacts.points(potential[:, None])[:, 0]
        expected = at - at[:9].mean()
        assert np.abs(expected[9:]).min() > 0.01 * np.abs(expected).max()
        falls = fields[:, source] - fields[:, sink]
        np.testing.assert_allclose(falls, expected, atol=1e-6 * np.abs(expected).max())


class TestCurrents:
    def test_through_a_surface_around_an_electrode_flows_what_it_is_given(self, mesh):
        """8/9 µA: one in, and a ninth of the common return out of the same electrode."""
        vertices, tetrahedra, sigma, fields = mesh
        electrodes = rim_points(9, RADIUS)
        gradients = barycentric_gradients(vertices, tetrahedra)
        volumes = signed_volumes(vertices, tetrahedra)
        slopes = nodal_gradients(fields, tetrahedra, gradients)
        for k, electrode in enumerate(electrodes):
            inside = np.linalg.norm(vertices - electrode, axis=1) < 40.0
            step = np.einsum("mk,mki->mi", inside[tetrahedra], gradients)
            density = np.einsum("mij,emj->emi", sigma, slopes)
            out = 0.1 * np.einsum("m,emi,mi->e", volumes, density, step)
            assert out == pytest.approx(np.where(np.arange(9) == k, 8 / 9, -1 / 9), abs=1e-7)


class TestReference:
    def test_leads_do_not_depend_on_it(self, mesh):
        vertices, tetrahedra, sigma, fields = mesh
        contacts = place_electrodes(vertices, tetrahedra, rim_points(9, RADIUS))
        currents = contacts.currents(len(vertices))
        others = currents - currents[ELECTRODES.index("V4")]
        stiffness = assemble_stiffness(vertices, tetrahedra, sigma)
        elsewhere = solve_neumann(stiffness, others)
        leads = lead_matrix() @ fields
        assert np.abs(elsewhere - fields).max() > 0.1 * np.abs(fields).max()
        assert np.abs(lead_matrix() @ elsewhere - leads).max() < 1e-7 * np.abs(leads).max()


class TestElectrodes:
    def test_enter_at_the_nearest_point_of_the_skin(self):
        block = box(10.0, 5)
        given = np.array([[3.3, 4.1, 12.0], [-0.5, 5.0, 5.0], [4.0, 4.0, 9.0]])
        contacts = place_electrodes(block.vertices, block.tetrahedra, given)
        entries = contacts.points(block.vertices)
        assert entries == pytest.approx(np.array([[3.3, 4.1, 10.0], [0.0, 5.0, 5.0], [4, 4, 10]]))
        assert contacts.moved == pytest.approx([2.0, 0.5, 1.0])
        currents = contacts.currents(len(block.vertices))
        assert currents @ block.vertices == pytest.approx(entries - entries.mean(axis=0))
        assert currents.sum(axis=1) == pytest.approx(np.zeros(3), abs=1e-14)

    def test_do_not_enter_in_holes(self):
        vertices, tetrahedra, shell = ball(10, [50.0, RADIUS], [0.5, 1.0])
        hollow = tetrahedra[shell == 1]
        contacts = place_electrodes(vertices, hollow, np.array([[0.0, 0.0, 52.0]]))
        assert contacts.moved[0] == pytest.approx(48.0, abs=1.5)

    def test_far_away_are_refused_by_name(self):
        electrodes = rim_points(9, RADIUS)
        electrodes[ELECTRODES.index("V2")] *= 1.42
        heart, torso = chest(4, electrodes)
        with pytest.raises(InputError, match=r"^heart: electrode V2 is 4[2-9] mm from the skin"):
            lead_fields(heart, torso, Conduction())


class TestRefusals:
    def test_pieces(self):
        heart, torso = chest(4)
        count = len(torso.vertices)
        apart = replace(
            torso,
            vertices=np.concatenate([torso.vertices, torso.vertices[torso.tetrahedra[0]] + 500.0]),
            tetrahedra=np.concatenate([torso.tetrahedra, [count + np.arange(4)]]),
            tissues=np.append(torso.tissues, TorsoTissue.OTHER),
        )
        with pytest.raises(InputError, match="falls into 2 pieces"):
            lead_fields(heart, apart, Conduction())

    def test_unused_vertices(self):
        heart, torso = chest(4)
        count = len(torso.vertices)
        more = replace(torso, vertices=np.concatenate([torso.vertices, np.ones((1, 3))]))
        with pytest.raises(InputError, match=f"1 of {count + 1} vertices.*first: {count} at"):
            lead_fields(heart, more, Conduction())

    def test_a_solver_that_is_stuck(self, mesh):
        vertices, tetrahedra, _, _ = mesh
        contacts = place_electrodes(vertices, tetrahedra, rim_points(9, RADIUS))
        stiffness, loads = assemble_stiffness(*mesh[:3]), contacts.currents(len(vertices))
        with pytest.raises(InputError, match="no lead field in 2 iterations"):
            solve_neumann(stiffness, loads, most_iterations=2)


def test_runs_are_the_same_whatever_the_random_state():
    heart, torso = chest(6)
    np.random.seed(1)  # noqa: NPY002 - the state that must not matter
    first = lead_fields(heart, torso, Conduction())
    np.random.seed(2)  # noqa: NPY002
    assert (lead_fields(heart, torso, Conduction()) == first).all()
