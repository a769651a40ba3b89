"""Balls of tetrahedra, and the exact lead fields of spheres."""

from __future__ import annotations

from itertools import permutations

import igl
import numpy as np

from fascicle.forward.electrocardiogram import nodal_gradients
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart, Torso
from fascicle.mesh.measures import barycentric_gradients, signed_volumes

GOLDEN = (1 + np.sqrt(5)) / 2
_flat = [(0.0, a, b * GOLDEN) for a in (1, -1) for b in (1, -1)]
ICOSAHEDRON = np.array([np.roll(v, k) for k in range(3) for v in _flat]) / np.hypot(1, GOLDEN)
_triples = np.array([(i, j, k) for i in range(12) for j in range(i) for k in range(j)])
_cosines = np.einsum("tik,tjk->tij", ICOSAHEDRON[_triples], ICOSAHEDRON[_triples])
FACES = _triples[(_cosines > 0.4).all(axis=(1, 2))]  # neighbours are at acos(1/√5)


def ball(layers: int, radii, at=(1.0,)):
    """A ball whose layers of vertices lie on spheres, and the shell of each tetrahedron.

    Shell k lies between the spheres `radii[k - 1]` and `radii[k]` (mm) and has the layers up to the
    fraction `at[k]` of all. Each of an icosahedron's 20 tetrahedra is cut into Freudenthal's
    pattern, whose sheets become the spheres.
    """
    y, cells = _freudenthal(layers)
    steps = np.column_stack([y[:, 0] - y[:, 1], y[:, 1] - y[:, 2], y[:, 2]])
    corners = ICOSAHEDRON[FACES]
    points = np.einsum("vk,fki->fvi", steps, corners).reshape(-1, 3)
    layer = np.tile(y[:, 0], len(FACES))
    tetrahedra = (cells + len(y) * np.arange(len(FACES))[:, None, None]).reshape(-1, 4)
    _, first, merged = np.unique(
        np.round(points * 1e6).astype(int), axis=0, return_index=True, return_inverse=True
    )
    points, layer, tetrahedra = points[first], layer[first], merged.ravel()[tetrahedra]
    knots = np.round(np.concatenate([[0.0], np.asarray(at) * layers]))
    radius = np.interp(layer, knots, np.concatenate([[0.0], radii]))
    length = np.linalg.norm(points, axis=1)
    vertices = points * (radius / np.where(length > 0, length, 1.0))[:, None]
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    shell = np.searchsorted(knots[1:], layer[tetrahedra].max(axis=1))
    return vertices, tetrahedra.astype(np.int64), shell


def _freudenthal(layers: int):
    """Lattice points layers ≥ y₁ ≥ y₂ ≥ y₃ ≥ 0 and Kuhn's tetrahedra among them."""
    grid = np.indices((layers + 1,) * 3).reshape(3, -1).T
    points = grid[(grid[:, 0] >= grid[:, 1]) & (grid[:, 1] >= grid[:, 2])]
    number = np.full((layers + 2,) * 3, -1)
    number[tuple(points.T)] = np.arange(len(points))
    cells = []
    for order in permutations(np.eye(3, dtype=int)):
        path = np.cumsum([np.zeros(3, dtype=int), *order], axis=0)
        cells.append(number[tuple((points[:, None] + path).transpose(2, 0, 1))])
    found = np.concatenate(cells)
    return points, found[(found >= 0).all(axis=1)]


def isotropic(values) -> np.ndarray:
    return np.asarray(values, float)[:, None, None] * np.eye(3)


def rim_points(count: int, radius: float) -> np.ndarray:
    """Points spread evenly over a sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (3 - np.sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    return radius * np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def homogeneous(points, electrode, radius, conductivity):
    """Z (kΩ) and ∇Z (kΩ/mm) in a ball, for an electrode on its surface, up to a constant.

    The Neumann function of the ball at its surface, 4πσZ = 2/d + ln(2R/(R − s + d))/R, s the way
    along the electrode's axis and d the distance from it; its gradient gives the potential of a
    dipole in a sphere (Frank, J. Appl. Phys. 23, 1952, 1225-1228; Brody, Terry and Ideker, IEEE
    Trans. Biomed. Eng. 20, 1973, 141-143).
    """
    axis = electrode / np.linalg.norm(electrode)
    away = points - radius * axis
    d = np.linalg.norm(away, axis=1)
    below = radius - points @ axis + d
    scale = 10.0 / (4 * np.pi * conductivity)  # 10 mm per cm
    potential = 2 / d + np.log(2 * radius / below) / radius
    slope = -2 * away / d[:, None] ** 3 - (away / d[:, None] - axis) / (radius * below[:, None])
    return scale * potential, scale * slope


def concentric(points, electrode, radii, conductivities, terms=150):
    """Z (kΩ) in concentric spheres, for an electrode on the outer one, up to a constant.

    Z = Σ (2n+1)/(4πR²) fₙ(r)Pₙ(cos γ), where fₙ = A(r/R)ⁿ + B(R/r)ⁿ⁺¹ in each shell, fₙ and σfₙ'
    are continuous, B = 0 in the innermost and σfₙ'(R) = 1: the series of Rush and Driscoll (IEEE
    Trans. Biomed. Eng. 16, 1969, 15-22) and de Munck (J. Appl. Phys. 64, 1988, 464-470), read as a
    lead field.
    """
    outer = radii[-1]
    r = np.linalg.norm(points, axis=1)
    cosine = points @ (electrode / np.linalg.norm(electrode)) / np.where(r > 0, r, 1.0)
    shell = np.minimum(np.searchsorted(radii, r), len(radii) - 1)
    t, before, legendre = r / outer, np.ones_like(r), cosine.copy()
    total = np.zeros_like(r)
    for n in range(1, terms + 1):
        a, b = _coefficients(n, np.asarray(radii) / outer, conductivities)
        with np.errstate(divide="ignore"):
            total_n = a[shell] * t**n + np.where(b[shell] != 0, b[shell] * t ** -(n + 1.0), 0.0)
        total += (2 * n + 1) * total_n * legendre
        before, legendre = legendre, ((2 * n + 1) * cosine * legendre - n * before) / (n + 1)
    return total * 10.0 / (4 * np.pi * outer)  # radius in cm: R fₙ' is what `_coefficients` sets


def _coefficients(n, t, conductivities):
    """A and B of each shell with σ·dfₙ/dt = 1 at t = 1."""
    a, b = [1.0], [0.0]
    for k in range(len(t) - 1):
        up, down = t[k] ** n, t[k] ** -(n + 1.0)
        value = a[k] * up + b[k] * down
        flux = conductivities[k] * (n * a[k] * up - (n + 1) * b[k] * down)
        flux /= conductivities[k + 1]
        a.append(((n + 1) * value + flux) / ((2 * n + 1) * up))
        b.append((n * value - flux) / ((2 * n + 1) * down))
    flux = conductivities[-1] * (n * a[-1] - (n + 1) * b[-1])
    return np.array(a) / flux, np.array(b) / flux


def boundary_area_vectors(vertices, tetrahedra):
    """Boundary triangles and their outward area vectors (mm²), computed without the solver."""
    triangles, owner, _ = igl.boundary_facets(tetrahedra)
    corners = vertices[triangles]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = vertices[tetrahedra[owner]].mean(axis=1) - corners.mean(axis=1)
    area[np.einsum("ij,ij->i", area, inward) > 0] *= -1
    return triangles, owner, area


def heart_in_torso(layers, radii, at, tissues, electrodes, fibre=(0.0, 0.0, 1.0)):
    """A ball as heart and torso: `tissues` says what each shell is, None the myocardium."""
    vertices, tetrahedra, shell = ball(layers, radii, at)
    myocardium = np.array([tissue is None for tissue in tissues])[shell]
    inside = np.unique(tetrahedra[myocardium])
    order = np.concatenate([inside, np.setdiff1d(np.arange(len(vertices)), inside)])
    tetrahedra = np.argsort(order)[tetrahedra]
    vertices, own = vertices[order], tetrahedra[myocardium]
    face = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    fibres = np.tile(np.asarray(fibre, float), (len(own), 1))
    heart = Heart(vertices[: len(inside)], own, fibres, face, face, electrodes)
    tissue = np.array([tissue if tissue is not None else 0 for tissue in tissues])[shell]
    return heart, Torso(vertices, tetrahedra[~myocardium], tissue[~myocardium])


def gradients_around(vertices, tetrahedra, fields, points, radius):
    """∇Z averaged over balls around some points, shape (e, p, 3).

    ∇Z is harmonic in an isotropic shell, so its mean over a ball is its value in the middle: a
    dipole spread over the ball looks the same from outside. In one linear element it is of first
    order only.
    """
    centres, means = vertices[tetrahedra].mean(axis=1), []
    for point in points:
        around = tetrahedra[np.linalg.norm(centres - point, axis=1) < radius]
        slopes = nodal_gradients(fields, around, barycentric_gradients(vertices, around))
        means.append(np.average(slopes, axis=1, weights=signed_volumes(vertices, around)))
    return np.stack(means, axis=1)


def at_eccentricity(vertices, distance, count):
    """Some of the vertices at this distance (mm) from the centre, spread over all of them."""
    there = np.flatnonzero(np.abs(np.linalg.norm(vertices, axis=1) - distance) < 1e-6)
    assert len(there) >= count, f"no vertices at {distance} mm"
    return there[np.linspace(0, len(there) - 1, count).astype(int)]


def radial_and_tangential(points):
    """Unit vectors along and across the radius, each of shape (p, 3)."""
    along = points / np.linalg.norm(points, axis=1, keepdims=True)
    across = np.cross(along, [0.3, 0.4, 0.8])
    return along, across / np.linalg.norm(across, axis=1, keepdims=True)
