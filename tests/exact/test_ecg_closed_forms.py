"""The ECG of fronts whose potential is known in closed form, or by a quadrature in one dimension.

In an unbounded conductor a front S, across which Vm rises by ΔU, is a dipole layer of strength
Gᵢn·ΔU per area, n pointing to where it goes. With Gᵢn = σᵢn an electrode sees

    V = (σᵢ/σ)·ΔU·Ω/4π,

Ω the solid angle of S, positive where the front comes towards the electrode (Plonsey and Barr,
Bioelectricity, on double layers). A lost 1/(4πσ), a cm for a mm or a wrong sign all show.
"""

import numpy as np
import pytest
from builders import box
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.references import Upstroke, unbounded
from fascicle.core.leads import FRANK_ELECTRODES, lead_matrix
from fascicle.forward.electrocardiogram import (
    Electrocardiograph,
    build_electrocardiograph,
    channel_weights,
    unbounded_gradients,
)
from fascicle.mesh.measures import barycentric_gradients, signed_volumes

RISE = 20.0 - -85.2  # mV
TORSO = 2.0  # mS/cm
STRENGTH = RISE / (4 * np.pi * TORSO)  # mV per sr and mS/cm


def potentials(vertices, corners, intracellular, electrodes, activation):
    """Potentials (mV) at up to eight electrodes; Gᵢ (mS/cm) one tensor or one per element."""
    electrodes = np.asarray(electrodes, float)
    gi = np.broadcast_to(intracellular, (len(corners), 3, 3))
    weights = channel_weights(
        barycentric_gradients(vertices, corners),
        np.abs(signed_volumes(vertices, corners)),
        gi,
        unbounded_gradients(vertices, corners, electrodes, TORSO),
    )
    heart = Electrocardiograph(corners, weights, Upstroke())
    return heart.channels(activation)[: len(electrodes)]


def square(distance, a=20.0):
    """Solid angle (sr) of a square seen from `distance` over its centre."""
    return 4 * np.arctan(a * a / (2 * distance * np.sqrt(4 * distance**2 + 2 * a**2)))


def disc(distance, radius=12.0):
    """Solid angle (sr) of a disc seen from `distance` over its centre."""
    return 2 * np.pi * (1 - distance / np.hypot(distance, radius))


def crossing(times, begin, end, solid_angle):
    """∫ Ω(s)·U′(t − s)/ΔU ds over the time of the front in the tissue, in steps, Ω amid each."""
    s = np.linspace(begin, end, 1001)
    rise = -np.diff(Upstroke()(times[:, None] - s), axis=1) / RISE
    return (rise * solid_angle((s[1:] + s[:-1]) / 2)).sum(axis=1)


SLAB = box((30.0, 20.0, 20.0), (30, 10, 10))
PAIR = np.array([[150.0, 10.0, 10.0], [-130.0, 10.0, 10.0]])  # mm


@given(st.floats(-30.0, 30.0), st.sampled_from([(3.0, 0.6), (0.3, 0.25)]))
@settings(max_examples=12, deadline=None)
def test_plane_wave_through_a_slab_seen_by_a_far_pair(onset, tissue):
    """The whole curve, entering and leaving included, whenever the wave starts.

    The quadrature takes the same times, so a constant added to the activation must move the curve
    by just that and change nothing else, bins or no bins. In bins of 1/2 ms the sudden start and
    end of a front over a whole face are blurred by 1 %.
    """
    conductivity, speed = tissue
    activation = onset + SLAB.vertices[:, 0] / speed
    gi = np.diag([conductivity, 1.0, 1.0])
    found = potentials(SLAB.vertices, SLAB.tetrahedra, gi, PAIR, activation)
    times = np.floor(min(onset, 0.0)) + np.arange(found.shape[1])

    def of_pair(s):
        x = (s - onset) * speed
        return square(150.0 - x) + square(x + 130.0)

    end = onset + 30.0 / speed
    expected = conductivity * STRENGTH * crossing(times, onset, end, of_pair)
    error = np.abs(found[0] - found[1] - expected) / expected.max()
    assert error.max() < 1e-2
    assert error[(times > onset + 4.0) & (times < end - 4.0)].max() < 1e-3


def cylinder(radius, length, cells):
    """Box mapped to a cylinder along x, square to disc by (u√(1 − v²/2), v√(1 − u²/2))."""
    block = box((length, 2.0, 2.0), cells)
    x, u, v = block.vertices.T - [[0.0], [1.0], [1.0]]
    y, z = radius * u * np.sqrt(1 - v**2 / 2), radius * v * np.sqrt(1 - u**2 / 2)
    return np.column_stack([x, y, z]), block.tetrahedra


SLAB_MESH, CYLINDER = (SLAB.vertices, SLAB.tetrahedra), cylinder(12.0, 12.0, (24, 20, 20))


@pytest.mark.parametrize(
    ("mesh", "solid_angle", "gi", "axis", "ends", "places"),
    [
        (SLAB_MESH, square, (3.0, 1.0, 1.0), 10.0, (55.0, -20.0), (8.0, 15.0, 22.0)),
        (CYLINDER, disc, (1.7, 1.7, 1.7), 0.0, (40.0, -15.0), (4.0, 6.0, 8.0)),
    ],
    ids=["square", "disc"],
)
def test_a_plane_front_gives_its_solid_angle_in_millivolts(
    mesh, solid_angle, gi, axis, ends, places
):
    """Within 1 % of the law at three places of the front, ahead positive and behind negative."""
    speed, (front, back) = 0.5, ends
    electrodes = [[x, axis, axis] for x in ends]
    found = potentials(*mesh, np.diag(gi), electrodes, mesh[0][:, 0] / speed)
    for x in places:
        ahead, behind = found[:, round(x / speed)] / (gi[0] * STRENGTH)
        assert ahead == pytest.approx(solid_angle(front - x), rel=0.01)
        assert behind == pytest.approx(-solid_angle(x - back), rel=0.01)


def test_additional_leads_of_a_plane_front_are_those_of_its_solid_angles():
    """A unipolar lead and Frank's, of electrodes on the axis of a slab, within 1 %."""
    speed, sigma, names = 0.5, 3.0, ("V7", *FRANK_ELECTRODES)
    at = np.array(
        [-30.0, -40.0, -25.0, *[45.0] * 6, 55.0, 60.0, -45.0, 70.0, 65.0, -22.0, -60.0, 50.0]
    )
    places = np.array([[x, 10.0, 10.0] for x in at])
    vertices, corners = SLAB_MESH
    heart = build_electrocardiograph(
        corners,
        barycentric_gradients(vertices, corners),
        np.abs(signed_volumes(vertices, corners)),
        np.broadcast_to(np.diag([sigma, 1.0, 1.0]), (len(corners), 3, 3)),
        unbounded_gradients(vertices, corners, places, TORSO),
        Upstroke(),
        names,
    )
    found = heart.leads(vertices[:, 0] / speed)[12:]
    for x in (8.0, 15.0, 22.0):
        potentials = sigma * STRENGTH * np.sign(at - x) * square(np.abs(at - x))
        expected = (lead_matrix(names) @ potentials)[12:]
        np.testing.assert_allclose(found[:, round(x / speed)], expected, rtol=0.01, atol=0.05)
        assert np.abs(expected).min() > 1.0  # mV


def test_a_curved_front_counts_by_its_rim_alone():
    """A half sphere growing from a face is seen as the disc that closes it, whatever its shape."""
    block = box((24.0, 48.0, 48.0), (24, 48, 48))
    speed, centre = 0.5, np.array([0.0, 24.0, 24.0])
    activation = np.linalg.norm(block.vertices - centre, axis=1) / speed
    gi = 2.0 * np.eye(3)
    ahead = [[60.0, 24.0, 24.0]]
    (found,) = potentials(block.vertices, block.tetrahedra, gi, ahead, activation)
    for time in (20, 30, 40):
        expected = 2.0 * STRENGTH * disc(60.0, speed * time)
        assert found[time] == pytest.approx(expected, rel=0.02)


def test_a_closed_front_is_silent():
    """A sphere growing inside isotropic tissue is a closed double layer: no potential outside."""
    block = box(48.0, 32)
    speed = 0.5
    activation = np.linalg.norm(block.vertices - 24.0, axis=1) / speed
    gi = 2.0 * np.eye(3)
    outside = [[70.0, 24.0, 24.0], [60.0, 60.0, 30.0]]
    found = potentials(block.vertices, block.tetrahedra, gi, outside, activation)
    closed = found[:, 8:44]  # radius 4 to 22 mm
    open_disc = 2.0 * STRENGTH * disc(46.0, 22.0)
    assert np.abs(closed).max() < 0.01 * open_disc
    assert np.abs(found[:, 52:]).max() > 0.05 * open_disc  # and heard once it breaks through


@given(st.integers(0, 2**31))
@settings(max_examples=50, deadline=None)
def test_reciprocity(seed):
    """Lead field of a pair at a dipole = potential difference that the dipole makes at the pair.

    One small tetrahedron, activated linearly: over time its dipole moment adds up to
    P = ΔU·|e|·Gᵢ∇τ, and ∫V dt at the pair is that of a source and a sink at the ends of P.
    """
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-10, 10, 3)
    shape = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    vertices = centre + 0.1 * (shape + rng.uniform(-0.3, 0.3, (4, 3)))
    corners = np.array([[0, 1, 2, 3]])
    root = rng.normal(size=(3, 3))
    gi = root @ root.T  # mS/cm
    slowness = rng.normal(size=3)
    slowness *= 300 / np.linalg.norm(slowness)  # ms/mm
    pair = rng.choice([-1, 1], (2, 3)) * rng.uniform(20, 60, (2, 3))
    activation = 120.0 + (vertices - centre) @ slowness
    found = potentials(vertices, corners, gi, pair, activation).sum(axis=1)

    volume = np.abs(signed_volumes(vertices, corners))[0]  # mm³
    centre = vertices.mean(axis=0)
    moment = RISE * volume * gi @ slowness / 100  # mV·mm³·(mS/cm)·(ms/mm) → µA·cm·ms
    half = 0.01 * moment / np.linalg.norm(moment)  # mm
    current = np.linalg.norm(moment) / 0.002  # µA·ms, ends 0.02 mm = 0.002 cm apart
    source, sink = unbounded(pair, np.stack([centre + half, centre - half]), TORSO)
    assert found[0] - found[1] == pytest.approx(
        current * (source - sink)[0] - current * (source - sink)[1],
        rel=2e-3,
        abs=2e-3 * current * np.abs(source - sink).max(),
    )
