"""Potentials of fronts: polarity, the integral by brute force, what counts and what does not."""

import numpy as np
import pytest
from builders import box, solve_without_trees

from benchmarks.references import Upstroke, unbounded
from fascicle.core.leads import lead_matrix
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.electrocardiogram import (
    Electrocardiograph,
    build_electrocardiograph,
    channel_weights,
    electrocardiographs_of,
    first_sample,
    nodal_gradients,
    unbounded_gradients,
)
from fascicle.heart.conduction import Conduction
from fascicle.mesh.measures import barycentric_gradients

RISE = 20.0 - -85.2  # mV
CONDUCTION = Conduction()
SIZE = (30.0, 20.0, 20.0)  # mm
AROUND = np.array(
    [
        [-80, 60, 90], [90, 50, 80], [60, -10, -90], [40, 30, 70],
        [60, 20, 60], [70, 0, 40], [80, 0, 20], [70, 0, 0], [60, 10, -20],
    ],
    dtype=float,
)  # fmt: skip


class Potentials:
    """Potentials at up to eight electrodes of a block's fronts."""

    def __init__(self, block, electrodes, conducting=None):
        electrodes = np.asarray(electrodes, float)
        gi = CONDUCTION.intracellular(block.fibres)
        if conducting is not None:
            gi[~conducting] = 0.0
        corners = block.tetrahedra
        gradients = unbounded_gradients(block.vertices, corners, electrodes, CONDUCTION.torso)
        barycentric = barycentric_gradients(block.vertices, corners)
        self.weights = channel_weights(barycentric, block.volumes, gi, gradients)
        self.heart = Electrocardiograph(corners, self.weights, Upstroke())
        self.count = len(electrodes)

    def __call__(self, activation):
        return self.heart.channels(activation)[: self.count]


def twelve_leads(block, gi=None, additional=()):
    """The heart with the nine electrodes, and more, pairs of name and place."""
    gi = CONDUCTION.intracellular(block.fibres) if gi is None else gi
    barycentric = barycentric_gradients(block.vertices, block.tetrahedra)
    places = np.array([*AROUND, *(place for _, place in additional)])
    gradients = unbounded_gradients(block.vertices, block.tetrahedra, places, CONDUCTION.torso)
    names = [name for name, _ in additional]
    return build_electrocardiograph(
        block.tetrahedra, barycentric, block.volumes, gi, gradients, Upstroke(), names
    )


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
    electrodes = np.array([[40.0, 5.0, 8.0], [-10.0, 30.0, 0.0]])
    barycentric = barycentric_gradients(block.vertices, block.tetrahedra)
    lead_fields = unbounded(block.vertices, electrodes, CONDUCTION.torso)
    gradients = nodal_gradients(lead_fields, block.tetrahedra, barycentric)
    gi = CONDUCTION.intracellular(block.fibres)
    weights = channel_weights(barycentric, block.volumes, gi, gradients)
    potential = Electrocardiograph(block.tetrahedra, weights, Upstroke()).channels(time)
    instants = np.arange(0, potential.shape[1], 3)
    expected = direct_quadrature(block, electrodes, time, instants)
    error = np.abs(potential[:2, instants] - expected).max() / np.abs(expected).max()
    assert error < 5e-3
    assert not potential[2:].any()


def test_torsos_share_weights():
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.0))
    places = np.array([*AROUND, [0, 0, 90], [20, 0, -70]])
    fields = np.array([unbounded(block.vertices, places * k, 2.0) for k in (1.0, 1.1)])
    barycentric = barycentric_gradients(block.vertices, block.tetrahedra)
    parts = block.tetrahedra, barycentric, block.volumes, CONDUCTION.intracellular(block.fibres)
    sources = np.linspace(0.5, 2.0, len(block.tetrahedra), dtype=np.float32), 0.3
    sources += (barycentric[:, 1:, 0].astype(np.float32),) * 2
    in_torsos = electrocardiographs_of(*parts, fields, Upstroke(), ["A", "B"])
    for shared, torso in zip(in_torsos, fields, strict=True):
        gradients = nodal_gradients(torso, block.tetrahedra, barycentric)
        kept = build_electrocardiograph(*parts, gradients, Upstroke(), ["A", "B"])
        found, expected = (
            ecg.with_sources(*sources).leads(excited(block, 5.0)) for ecg in (shared, kept)
        )
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def excited(block, onset, seed=0):
    """Times from one corner on (ms)."""
    return onset + solve_without_trees(build_myocardium(block, CONDUCTION), {seed: 0.0})


def test_all_is_quiet_before_the_first_and_after_the_last_front():
    """A net current that does not return to zero would be a histogram that ends too soon."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.0))
    (potential,) = Potentials(block, [[60.0, 10.0, 10.0]])(excited(block, 12.0))
    assert np.abs(potential[:9]).max() < 1e-6
    assert np.abs(potential[-1]) < 1e-3 * np.abs(potential).max()


def test_time_integral_is_that_of_the_gradient():
    """∫V dt = ΔU·Σ|e|Gᵢ∇τ·∇Z, exact whatever the template's shape."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.0))
    potentials = Potentials(block, [[60.0, 10.0, 10.0], [5.0, -20.0, 0.0]])
    time = excited(block, 10.0)
    differences = time[block.tetrahedra[:, 1:]] - time[block.tetrahedra[:, :1]]
    total = np.einsum("mkc,mk->c", potentials.weights, differences)[:2]
    np.testing.assert_allclose(potentials(time).sum(axis=1), RISE * total, rtol=1e-3)


@pytest.mark.parametrize("shift", [-40.0, -8.0, 1.0, 20.0])
def test_later_or_earlier_by_whole_milliseconds_is_the_same_shifted(shift):
    """Potentials depend on differences of times only; extra stimuli come before 0, too."""
    block = box(SIZE, (6, 4, 4))
    potentials = Potentials(block, [[60.0, 10.0, 10.0]])
    time = excited(block, 5.0)
    start = first_sample(time + shift)
    assert first_sample(time) == 0.0
    assert start == min(0.0, 5.0 + shift)
    before, after = potentials(time)[0], potentials(time + shift)[0]
    n = int(start - shift)  # sample of `before` at which `after` begins
    expected = np.concatenate([np.zeros(max(0, -n)), before[max(0, n) :]])
    assert len(after) == len(expected)
    np.testing.assert_allclose(after, expected, atol=1e-8)


def test_the_first_sample_is_at_0_or_the_whole_millisecond_before_the_earliest():
    for earliest, start in ((3.7, 0.0), (0.0, 0.0), (-0.2, -1.0), (-7.0, -7.0), (-7.3, -8.0)):
        assert first_sample(np.array([np.inf, 20.0, earliest])) == start


def test_tissue_that_does_not_conduct_contributes_nothing():
    """Gᵢ = 0 in a scar: its own times do not matter, and the rest is the rest of the integral."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.0))
    centre = block.vertices[block.tetrahedra].mean(axis=1)
    scar = np.linalg.norm(centre - [15, 10, 10], axis=1) < 7.0
    gi = CONDUCTION.intracellular(block.fibres)
    of_scar = gi.copy()
    of_scar[~scar] = 0.0
    time = excited(block, 5.0)
    healthy = twelve_leads(block)
    whole, rest = healthy.leads(time), healthy.scaled(np.where(scar, 0.0, 1.0))
    assert len(rest.corners) == len(gi) - scar.sum()
    np.testing.assert_allclose(
        whole, rest.leads(time) + twelve_leads(block, of_scar).leads(time), atol=1e-10
    )
    assert np.abs(whole - rest.leads(time)).max() > 0.01  # mV: the scar was not nothing
    inside = np.setdiff1d(block.tetrahedra[scar], block.tetrahedra[~scar])
    assert len(inside) > 0
    other = time.copy()
    other[inside] = 3.0
    np.testing.assert_array_equal(rest.leads(other), rest.leads(time))
    other[inside] = np.inf
    np.testing.assert_array_equal(rest.leads(other), rest.leads(time))


@pytest.mark.parametrize(
    ("value", "complaint"),
    [(np.nan, "numbers"), (-np.inf, "numbers"), (np.inf, "never activated|ever activated")],
)
def test_activation_without_an_ecg_is_refused(value, complaint):
    block = box(SIZE, (2, 1, 1))
    potentials = Potentials(block, [[60.0, 10.0, 10.0]])
    time = block.vertices[:, 0] / 0.6
    if value == np.inf:
        time[:] = np.inf
    else:
        time[3] = value
    with pytest.raises(ValueError, match=complaint):
        potentials(time)


def test_the_eight_channels_make_the_twelve_leads_of_the_electrodes():
    """Leads from eight channels equal the lead matrix times all nine electrodes' potentials."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.3))
    time = excited(block, 5.0)
    potentials = np.concatenate(
        [Potentials(block, AROUND[:5])(time), Potentials(block, AROUND[5:])(time)]
    )
    leads = twelve_leads(block).leads(time)
    assert np.abs(leads).max() > 0.1  # mV
    np.testing.assert_allclose(leads, lead_matrix() @ potentials, atol=1e-9)


@pytest.mark.parametrize("count", [1, 8, 67])
def test_additional_leads_are_those_of_their_electrodes(count):
    """However many groups of eight; the twelve stay the same to the last bit, scaled or not."""
    block = box(SIZE, (6, 4, 4), fibre=(1.0, 1.0, 0.3))
    time, factors = excited(block, 5.0), np.linspace(0.0, 2.0, len(block.tetrahedra))
    places = np.random.default_rng(count).normal(size=(count, 3)) * 10.0 + [100.0, 0.0, 0.0]
    heart = twelve_leads(block, additional=[(f"E{k}", p) for k, p in enumerate(places)])
    leads = heart.leads(time)
    assert len(leads) == 12 + count
    np.testing.assert_array_equal(leads[:12], twelve_leads(block).leads(time))
    scaled = heart.scaled(factors).leads(time)
    np.testing.assert_array_equal(scaled[:12], twelve_leads(block).scaled(factors).leads(time))
    wilson = Potentials(block, AROUND[:3])(time).mean(axis=0)
    for k in (0, count - 1):
        expected = Potentials(block, places[k : k + 1])(time)[0] - wilson
        # stored in single precision
        np.testing.assert_allclose(leads[12 + k], expected, atol=1e-5 * np.abs(expected).max())
        assert np.abs(scaled[12 + k] - leads[12 + k]).max() > 0.1 * np.abs(expected).max()
