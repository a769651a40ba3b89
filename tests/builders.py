"""Small meshes, surfaces and trees with known answers, and slow reference solutions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from benchmarks.references import solve_from_vertices
from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import Myocardium, attach
from fascicle.forward.primitives import InactiveRoot, JunctionDelays
from fascicle.forward.scenario import Scenario
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium, oriented_into_cavity
from fascicle.heart.heart import Heart
from fascicle.kernels.ray_travel_times import ray_time
from fascicle.mesh.measures import signed_volumes
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.recording.target import Target, smooth_noise

# Kuhn's six tetrahedra of a cube, corners numbered x + 2y + 4z
KUHN = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)
OBLIQUE = np.array([2.0, 1.0, 0.7]) / np.linalg.norm([2.0, 1.0, 0.7])


def box(size, cells, *, jitter=0.0, fibre=(1.0, 0.0, 0.0), seed=0) -> Heart:
    """Box of Kuhn tetrahedra from the origin to `size` mm with straight fibres.

    Inner vertices are moved by up to `jitter` of a cell (0.3 turns elements inside out). `fibre`
    is a direction, or a function that gives one for each of (m, 3) centroids. Its "endocardia"
    are placeholders.
    """
    size, cells = np.broadcast_to(size, 3).astype(float), np.broadcast_to(cells, 3).astype(int)
    nx, ny, nz = cells + 1
    z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    vertices = grid * (size / cells)
    inner = ((grid > 0) & (grid < cells)).all(axis=1)
    shake = np.random.default_rng(seed).uniform(-jitter, jitter, (inner.sum(), 3))
    vertices[inner] += shake * (size / cells)
    lowest = grid[(grid < cells).all(axis=1)] @ [1, nx, nx * ny]
    corner = np.array([i + nx * j + nx * ny * k for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    tetrahedra = (lowest[:, None] + corner)[:, KUHN].reshape(-1, 4)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    if callable(fibre):
        fibres = fibre(vertices[tetrahedra].mean(axis=1))
    else:
        fibres = np.tile(np.asarray(fibre) / np.linalg.norm(fibre), (len(tetrahedra), 1))
    face = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    return Heart(vertices, tetrahedra.astype(np.int64), fibres, face, face, np.zeros((9, 3)))


def block_of_random_tissue(size, rng) -> Heart:
    """A block with random fibres, sheets and regions, an endocardium on its left and right face."""
    block = box(size, 4, jitter=0.1)
    axes = np.linalg.qr(rng.standard_normal((len(block.tetrahedra), 3, 3)))[0]
    return replace(
        block,
        fibres=axes[:, :, 0],
        sheets=axes[:, :, 1],
        regions=rng.integers(-1, 4, len(block.tetrahedra)),
        lv=face_of(block, 0, 0.0),
        rv=replace(face_of(block, 0, size), side="rv"),
    )


def face_of(heart, axis, level) -> Endocardium:
    """The boundary triangles of a box that lie in a plane, as if they were an endocardium."""
    triangles, _ = heart.boundary
    there = (np.abs(heart.vertices[triangles][:, :, axis] - level) < 1e-9).all(axis=1)
    used, corners = np.unique(triangles[there], return_inverse=True)
    return Endocardium("lv", heart.vertices[used], corners.reshape(-1, 3), 0, 1)


def conduction_for(along, across) -> Conduction:
    """Conductivities for speeds in mm/ms: intra- and extracellular alike, α from the first."""
    alpha = along / np.sqrt(100.0 * 3.0 / 2)  # mm² per cm², and 3 mS/cm twice in series
    transverse = 2 * across**2 / (100.0 * alpha**2)
    return Conduction(3.0, transverse, 3.0, transverse, alpha)


def box_tissue(size, cells, *, conduction=None, **options) -> Myocardium:
    conduction = conduction if conduction is not None else Conduction()
    return build_myocardium(box(size, cells, **options), conduction)


def straight_times(myocardium: Myocardium, points, times, at=None) -> np.ndarray:
    """Exact times (ms) in a convex block with straight fibres: least t + √(dᵀD⁻¹d).

    At the points `at`, or else at the heart's vertices.
    """
    at = heart_vertices(myocardium) if at is None else np.reshape(at, (-1, 3))
    offset = at[:, None] - np.reshape(points, (-1, 3))
    metric = myocardium.mesh.metric[0]
    travel = np.sqrt(np.einsum("npi,ij,npj->np", offset, metric, offset))
    return (travel + np.asarray(times)).min(axis=1)


def ray_times(myocardium: Myocardium, start, element, goals, *, longest=np.inf) -> np.ndarray:
    """Time (ms) along the straight line from a point in an element to each goal, traced."""
    mesh = myocardium.mesh
    medium = mesh.cells, mesh.neighbours, mesh.slowness
    times = [ray_time(tuple(start), element, tuple(goal), longest, *medium) for goal in goals]
    return np.array(times)


def vertex_at(vertices, point) -> int:
    """The vertex that lies at `point`."""
    distance = np.linalg.norm(vertices - point, axis=1)
    assert distance.min() < 1e-9, f"no vertex at {point}"
    return int(distance.argmin())


def half_ellipsoid(
    rings=24, sectors=40, radius=24.0, depth=60.0, *, jitter=0.0, seed=0
) -> Endocardium:
    """Open half-ellipsoid, base at z = 0, apex at z = −depth; root on the +x side."""
    rng = np.random.default_rng(seed)
    polar = np.linspace(0, np.pi / 2, rings + 1)[1:]
    rows = [np.array([[0.0, 0.0, -depth]])]
    for k, theta in enumerate(polar):
        phi = np.arange(sectors) * 2 * np.pi / sectors
        if k < rings - 1:
            theta = theta + jitter * rng.uniform(-1, 1, sectors) * (polar[1] - polar[0])
            phi = phi + jitter * rng.uniform(-1, 1, sectors) * 2 * np.pi / sectors
        flat = radius * np.sin(theta)
        z = np.broadcast_to(-depth * np.cos(theta), sectors)
        rows.append(np.column_stack([flat * np.cos(phi), flat * np.sin(phi), z]))
    triangles = [[0, 1 + k, 1 + (k + 1) % sectors] for k in range(sectors)]
    for r in range(rings - 1):
        a, b = 1 + r * sectors, 1 + (r + 1) * sectors
        for k in range(sectors):
            k1 = (k + 1) % sectors
            triangles += [[a + k, b + k, b + k1], [a + k, b + k1, a + k1]]
    vertices = np.concatenate(rows)
    faces = oriented_into_cavity(vertices, np.array(triangles, np.int64), "half-ellipsoid")
    root = 1 + (rings - 4) * sectors
    return Endocardium("lv", vertices, faces, root, 1 + (rings // 3) * sectors)


def line_tree(points, *, root=0, side="lv") -> PurkinjeTree:
    """Tree along a polyline, entered at node `root`; both other ends are leaves."""
    points = np.asarray(points, float)
    index = np.arange(len(points))
    parents = np.where(index > root, index - 1, np.where(index < root, index + 1, -1))
    lengths = np.linalg.norm(points - points[parents], axis=1)
    lengths[root] = 0.0
    return PurkinjeTree(side, points, parents.astype(np.int64), lengths)


def star_tree(seed, leaves=6) -> PurkinjeTree:
    """Star of random leaves on the top of a block of 30 x 20 x 6 mm, between vertices."""
    tips = np.random.default_rng(seed).uniform(0, (30.0, 20.0, 6.0), (leaves, 3))
    tips[:, 2] = 6.0
    nodes = np.vstack([[15.0, 10.0, 8.0], tips])
    parents = np.concatenate([[-1], np.zeros(leaves, int)])
    return PurkinjeTree("lv", nodes, parents, np.linalg.norm(nodes - nodes[0], axis=1))


def activate(myocardium: Myocardium, trees, root_times, cv, *, stimuli=(), times=(), **options):
    """Attach trees and stimuli (positions in mm) and solve."""
    coupling = attach(myocardium, trees, np.reshape(stimuli, (-1, 3)))
    return solve(coupling, root_times, cv, stimuli=times, **options)


def solve_without_trees(myocardium: Myocardium, vertex_times) -> np.ndarray:
    """Myocardium alone, from a mapping of the heart's vertices to their times (ms)."""
    times = np.full(len(myocardium.order), np.inf)
    times[list(vertex_times)] = list(vertex_times.values())
    return solve_from_vertices(myocardium, times)


def heart_vertices(myocardium: Myocardium) -> np.ndarray:
    """Positions (mm) in the heart's own order, which is that of activation times."""
    vertices = np.empty_like(myocardium.mesh.vertices)
    vertices[myocardium.order] = myocardium.mesh.vertices
    return vertices


GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


@njit(cache=True)
def _way(gram, t, p, q):
    """Σλτ + √(λᵀAλ) at λ = (p, q, 1 − p − q)."""
    r = 1.0 - p - q
    square = (
        gram[0, 0] * p * p + gram[1, 1] * q * q + gram[2, 2] * r * r
        + 2.0 * (gram[0, 1] * p * q + gram[0, 2] * p * r + gram[1, 2] * q * r)
    )  # fmt: skip
    return p * t[0] + q * t[1] + r * t[2] + np.sqrt(max(square, 0.0))


@njit(cache=True)
def _best_on_row(gram, t, p, halvings):
    low, high = 0.0, 1.0 - p
    best = min(_way(gram, t, p, low), _way(gram, t, p, high))
    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    fa, fb = _way(gram, t, p, a), _way(gram, t, p, b)
    for _ in range(halvings):
        if fa < fb:
            high, b, fb = b, a, fa
            a = high - GOLDEN * (high - low)
            fa = _way(gram, t, p, a)
        else:
            low, a, fa = a, b, fb
            b = low + GOLDEN * (high - low)
            fb = _way(gram, t, p, b)
    return min(best, fa, fb)


@njit(cache=True)
def brute_force(gram, t, halvings):
    """Minimum over the simplex by nested golden section: no formula shared with the kernel."""
    low, high = 0.0, 1.0
    best = min(_best_on_row(gram, t, 0.0, halvings), _way(gram, t, 1.0, 0.0))
    a, b = 1.0 - GOLDEN, GOLDEN
    fa, fb = _best_on_row(gram, t, a, halvings), _best_on_row(gram, t, b, halvings)
    for _ in range(halvings):
        if fa < fb:
            high, b, fb = b, a, fa
            a = high - GOLDEN * (high - low)
            fa = _best_on_row(gram, t, a, halvings)
        else:
            low, a, fa = a, b, fb
            b = low + GOLDEN * (high - low)
            fb = _best_on_row(gram, t, b, halvings)
    return min(best, fa, fb)


def offers(myocardium: Myocardium, time, halvings=26) -> np.ndarray:
    """The earliest time that any tetrahedron offers each of the heart's vertices (ms).

    26 golden sections leave 4e-6 of a side, so 1e-10 ms in a smooth minimum.
    """
    mesh, offered = myocardium.mesh, np.empty(len(time))
    metric = np.ascontiguousarray(myocardium.mesh.metric)
    offered[myocardium.order] = lowest_offers(
        mesh.vertices, mesh.corners, metric, time[myocardium.order], halvings
    )
    return offered


@njit(cache=True)
def lowest_offers(vertices, corners, metric, time, halvings):
    """The earliest time that any tetrahedron offers each vertex (ms), by brute force.

    Faces that are entirely later than the vertex cannot lower it and are left out.
    """
    offers = np.full(len(vertices), np.inf)
    edges, gram, t = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for e in range(len(corners)):
        for at in range(4):
            vertex = corners[e, at]
            k = 0
            for c in range(4):
                if c != at:
                    edges[k] = vertices[corners[e, c]] - vertices[vertex]
                    t[k] = time[corners[e, c]]
                    k += 1
            if t.min() >= time[vertex]:
                continue
            gram[:] = edges @ metric[e] @ edges.T
            offers[vertex] = min(offers[vertex], brute_force(gram, t, halvings))
    return offers


def recorded(simulation, seed=0) -> Target:
    """A recording of a simulated beat: ten beats with noise of 0.02 mV."""
    clean = np.pad(simulation.leads, ((0, 0), (80, 80)))
    time = np.arange(clean.shape[1]) - 80 + simulation.onset
    beats = clean + smooth_noise(np.random.default_rng(seed), (10, *clean.shape), 0.02)
    first = simulation.onset + simulation.first_activation
    last = np.nanmax(simulation.activation)
    return Target(beats, time, float(first), float(last), 60.0, {"source": "made"}, 4.0, 5.0)


def case(stimuli=(), slow=(), *, inactive=(), his=None, delays=None, **options) -> Scenario:
    """A scenario of primitives by kind."""
    others = [*map(InactiveRoot, inactive)]
    if delays is not None:
        others.append(JunctionDelays(**delays))
    if his is not None:
        others.append(his)
    return Scenario((*stimuli, *slow, *others), **options)
