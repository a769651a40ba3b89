"""Potentials of known fronts: magnitude in mV, polarity, and the integral by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from builders import box, solve_without_trees

from fascicle.ecg.action_potential import Upstroke
from fascicle.ecg.electrocardiogram import BINS_PER_MS, build_electrocardiograph
from fascicle.ecg.lead_field import unbounded
from fascicle.eikonal.tissue import build_tissue
from fascicle.geometry.conduction import Conduction

RISE = 20.0 - -85.2  # mV
CONDUCTION = Conduction()
SIZE = (30.0, 20.0, 20.0)  # mm


def electrocardiograph(block, electrodes, width=1.0):
    tissue = build_tissue(block, CONDUCTION)
    return build_electrocardiograph(
        tissue,
        block.volumes,
        CONDUCTION.intracellular(block.fibres),
        unbounded(block.vertices, np.asarray(electrodes, float), CONDUCTION.torso),
        Upstroke(width=width),
    )


def solid_angle(distance, a, b):
    """Of a rectangle a × b seen from `distance` over its centre (sr)."""
    return 4 * np.arctan(a * b / (2 * distance * np.sqrt(4 * distance**2 + a**2 + b**2)))


@pytest.mark.parametrize(
    ("fibre", "conductivity"), [((1, 0, 0), 3.0), ((0, 1, 0), 0.3)], ids=["along", "across"]
)
def test_planar_front_gives_the_solid_angle_law_in_millivolts(fibre, conductivity):
    """V = (σᵢₙ/σ)·ΔU·Ω/4π: a lost 1/(4πσ), a cm for a mm or a wrong sign all show.

    A front at x moves towards +x; Gᵢn = σᵢₙ·n, and ∫ n·∇(1/(4πσr)) dA is Ω/(4πσ).
    """
    block = box(SIZE, (30, 20, 20), fibre=fibre)
    speed = CONDUCTION.speeds[0 if fibre[0] else 1]
    ahead, behind = [55.0, 10.0, 10.0], [-20.0, 10.0, 10.0]
    heart = electrocardiograph(block, [ahead, behind])
    potential = heart.potentials(block.vertices[:, 0] / speed)
    for x in (8.0, 15.0, 22.0):
        times = np.arange(potential.shape[1])
        strength = conductivity / CONDUCTION.torso * RISE / (4 * np.pi)
        for electrode, distance, sign in ((0, 55.0 - x, 1), (1, x + 20.0, -1)):
            expected = sign * strength * solid_angle(distance, 20.0, 20.0)
            found = np.interp(x / speed, times, potential[electrode])
            assert found == pytest.approx(expected, rel=0.01)


def test_a_front_towards_the_electrode_is_positive_and_away_negative():
    block = box(SIZE, (15, 10, 10))
    heart = electrocardiograph(block, [[60.0, 10.0, 10.0], [-30.0, 10.0, 10.0]])
    towards, away = heart.potentials(block.vertices[:, 0] / 0.6)
    assert towards.max() > 1.0  # mV
    assert towards.min() > -1e-6
    assert away.min() < -1.0
    assert away.max() < 1e-6


def direct_quadrature(block, electrodes, time, instants, levels=5):
    """−∫ Gᵢ∇Vm·∇Z by the midpoint rule on a fine subdivision, Vm differentiated in space.

    Each element is cut into 8^levels parts through midpoints; ∇Vm of each part follows from Vm at
    its corners, so that neither τ's histogram nor U′ is used.
    """
    gi = CONDUCTION.intracellular(block.fibres)
    z = unbounded(block.vertices, np.asarray(electrodes, float), CONDUCTION.torso)
    u = Upstroke()
    parts = np.eye(4)[None]  # barycentric coordinates of the corners of each part
    for _ in range(levels):
        m = {(i, j): (parts[:, i] + parts[:, j]) / 2 for i in range(4) for j in range(i + 1, 4)}
        c = [parts[:, i] for i in range(4)]
        pieces = [
            (c[0], m[0, 1], m[0, 2], m[0, 3]), (m[0, 1], c[1], m[1, 2], m[1, 3]),
            (m[0, 2], m[1, 2], c[2], m[2, 3]), (m[0, 3], m[1, 3], m[2, 3], c[3]),
            (m[0, 1], m[0, 2], m[0, 3], m[2, 3]), (m[0, 1], m[0, 2], m[1, 2], m[2, 3]),
            (m[0, 1], m[0, 3], m[1, 3], m[2, 3]), (m[0, 1], m[1, 2], m[1, 3], m[2, 3]),
        ]  # fmt: skip
        parts = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    total = np.zeros((len(electrodes), len(instants)))
    for e, corners in enumerate(block.tetrahedra):
        inverse = np.linalg.inv(block.vertices[corners[1:]] - block.vertices[corners[0]])
        grad_z = (z[:, corners[1:]] - z[:, [corners[0]]]) @ inverse.T
        part_vertices = parts @ block.vertices[corners]
        part_inverse = np.linalg.inv(part_vertices[:, 1:] - part_vertices[:, :1])
        tau = parts @ time[corners]
        volume = block.volumes[e] / len(parts)
        for k, now in enumerate(instants):
            vm = u(now - tau)
            grad_vm = np.einsum("pij,pj->pi", part_inverse, vm[:, 1:] - vm[:, :1])
            current = gi[e] @ grad_vm.sum(axis=0) * volume / 10.0  # mS/cm·mm → mS
            total[:, k] -= grad_z @ current
    return total


def test_potentials_equal_direct_quadrature():
    """Times at random, so that every element has four different knots and its own direction."""
    block = box(10.0, 1, fibre=(1.0, 0.4, 0.2))
    rng = np.random.default_rng(2)
    time = rng.uniform(2.0, 30.0, len(block.vertices))
    electrodes = [[40.0, 5.0, 8.0], [-10.0, 30.0, 0.0]]
    potential = electrocardiograph(block, electrodes).potentials(time)
    instants = np.arange(0, potential.shape[1], 3)
    expected = direct_quadrature(block, electrodes, time, instants)
    error = np.abs(potential[:, instants] - expected).max() / np.abs(expected).max()
    assert error < 5e-3


def test_all_is_quiet_before_the_first_and_after_the_last_front():
    """A net current that does not return to zero would be a histogram that ends too soon."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.0))
    heart = electrocardiograph(block, [[60.0, 10.0, 10.0]])
    time = 12.0 + solve_without_trees(build_tissue(block, CONDUCTION), {0: 0.0})
    (potential,) = heart.potentials(time)
    assert np.abs(potential[:9]).max() < 1e-6
    assert np.abs(potential[-1]) < 1e-3 * np.abs(potential).max()


def test_time_integral_is_that_of_the_gradient():
    """∫V dt = ΔU·Σ|e|Gᵢ∇τ·∇Z: exact whatever the template's shape; checks histogram and kernel."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.0))
    time = 10.0 + solve_without_trees(build_tissue(block, CONDUCTION), {0: 0.0})
    heart = electrocardiograph(block, [[60.0, 10.0, 10.0], [5.0, -20.0, 0.0]])
    total = np.einsum("mek,mk->e", heart.weights, time[heart.corners])
    np.testing.assert_allclose(heart.potentials(time).sum(axis=1), RISE * total, rtol=2e-3)


@pytest.mark.parametrize("shift", [1.0, 7.0, 20.0])
def test_later_by_whole_milliseconds_is_the_same_shifted(shift):
    block = box(SIZE, (6, 4, 4))
    heart = electrocardiograph(block, [[60.0, 10.0, 10.0]])
    time = 5.0 + solve_without_trees(build_tissue(block, CONDUCTION), {0: 0.0})
    before, after = heart.potentials(time), heart.potentials(time + shift)
    n = int(shift)
    np.testing.assert_allclose(after[:, n : n + before.shape[1]], before, atol=1e-9)


def test_later_by_part_of_a_bin_moves_the_curve_by_just_that():
    """The histogram must not hold times to its bins: 0.1 ms is less than the bin of 0.25 ms."""
    block = box(SIZE, (12, 8, 8))
    heart = electrocardiograph(block, [[60.0, 10.0, 10.0]])
    time = 5.0 + solve_without_trees(build_tissue(block, CONDUCTION), {0: 0.0})
    (before,), (after,) = heart.potentials(time), heart.potentials(time + 0.4 / BINS_PER_MS)
    n = min(len(before), len(after))
    slope = np.gradient(before)[:n]
    moved = -(slope @ (after[:n] - before[:n])) / (slope @ slope)  # ms
    assert moved == pytest.approx(0.1, abs=0.02)


def test_result_hardly_depends_on_the_mesh():
    """No mesh ripple: a quarter of the elements' size changes 2.3 % of the peak."""
    curves = []
    for cells in ((6, 4, 4), (24, 16, 16)):
        block = box(SIZE, cells)
        heart = electrocardiograph(block, [[60.0, 12.0, 8.0]])
        curves.append(heart.potentials(block.vertices @ [1.5, 0.4, 0.7])[0])
    assert np.abs(curves[0] - curves[1]).max() < 0.03 * np.abs(curves[1]).max()
