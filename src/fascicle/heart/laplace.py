"""Laplace's equation on tetrahedra, with quadratic elements.

A ventricular wall may be one tetrahedron thick. A linear element there has all its corners on the
boundary, and is blind to the wall's curvature; a quadratic one has nodes inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.measures import HAMMER_STROUD_POINTS, signed_volumes
from fascicle.mesh.topology import TETRAHEDRON_EDGES, TETRAHEDRON_FACES, unique_edges

if TYPE_CHECKING:
    from pyamg.multilevel import MultilevelSolver


@dataclass(frozen=True)
class QuadraticSpace:
    """Continuous functions that are quadratic in each tetrahedron.

    Vertices (n, 3) (mm) all belong to one of the tetrahedra (m, 4); node i < n is vertex i. Edges
    (e, 2) have the smaller vertex first and are sorted; node n + j is the middle of edge j. Nodes
    (m, 10) of each tetrahedron are its corners, then the middles of its `TETRAHEDRON_EDGES`.
    """

    vertices: Floats
    tetrahedra: Integers
    edges: Integers
    nodes: Integers

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.vertices) + len(self.edges)

    @cached_property
    def gradients(self) -> Floats:
        """Gradients of the barycentric coordinates (1/mm), shape (m, 4, 3)."""
        x = self.vertices[self.tetrahedra]
        a, b, c = (x[:, TETRAHEDRON_FACES[:, k]] for k in range(3))
        height = 3 * signed_volumes(self.vertices, self.tetrahedra)[:, None, None]
        return np.asarray(-np.cross(b - a, c - a) / 2 / height)

    @cached_property
    def stiffness(self) -> sparse.csr_matrix:
        """∫∇φᵢ·∇φⱼ (mm) over the mesh, for the basis functions φ of the nodes."""
        upper = np.triu_indices(10)
        entries = np.empty((len(self.tetrahedra), len(upper[0])))
        weights = np.abs(signed_volumes(self.vertices, self.tetrahedra)) / len(HAMMER_STROUD_POINTS)
        shapes = [_basis_gradients(point) for point in HAMMER_STROUD_POINTS]
        for first in range(0, len(entries), 100_000):  # in chunks, to bound the memory
            chunk = slice(first, first + 100_000)
            full = np.zeros((len(entries[chunk]), 10, 10))
            for shape in shapes:
                gradients = shape @ self.gradients[chunk]
                full += gradients @ gradients.transpose(0, 2, 1)
            entries[chunk] = weights[chunk, None] * full[:, *upper]
        row, column = (self.nodes[:, k].astype(np.int32).ravel() for k in upper)
        # half of a symmetric matrix, its diagonal halved so that adding the transpose completes it
        entries[:, upper[0] == upper[1]] /= 2
        half = sparse.csr_matrix((entries.ravel(), (row, column)), shape=(self.size, self.size))
        return (half + half.T).tocsr()

    def on(self, triangles: Integers) -> Integers:
        """Nodes of some triangles of the mesh: their corners, then the middles of their edges."""
        keys = _keys(unique_edges(triangles)[0], len(self.vertices))
        middles = np.searchsorted(_keys(self.edges, len(self.vertices)), keys)
        return np.concatenate([np.unique(triangles), len(self.vertices) + middles])

    def at_centroids(self, values: Floats) -> tuple[Floats, Floats]:
        """Value (m,) and gradient (1/mm) (m, 3) of a function in the middle of each tetrahedron."""
        centre = np.full(4, 1 / 4)
        i, j = TETRAHEDRON_EDGES.T
        basis = np.concatenate([centre * (2 * centre - 1), 4 * centre[i] * centre[j]])
        local = values[self.nodes]
        slopes = local @ _basis_gradients(centre)
        return local @ basis, np.asarray(np.einsum("mi,mix->mx", slopes, self.gradients))


def quadratic_space(vertices: Floats, tetrahedra: Integers) -> QuadraticSpace:
    """Number the nodes of a mesh of tetrahedra (m, 4) (mm)."""
    count = len(vertices)
    ends = np.sort(tetrahedra[:, TETRAHEDRON_EDGES], axis=2)
    keys, which = np.unique(_keys(ends, count), return_inverse=True)
    edges = np.stack([keys // count, keys % count], axis=1)
    nodes = np.hstack([tetrahedra, count + which.reshape(-1, len(TETRAHEDRON_EDGES))])
    return QuadraticSpace(vertices, tetrahedra, edges, nodes)


def solve_laplace(space: QuadraticSpace, fixed: Integers, values: Floats) -> Floats:
    """Solve ∇²u = 0 for u (p, size), given at some nodes (k,), no flux through the other boundary.

    Conjugate gradients, preconditioned by multigrid: quadratic functions, then linear ones on the
    same mesh, then algebraic (smoothed aggregation). `values` (p, k) are u at those nodes in each
    problem.
    """
    free = np.setdiff1d(np.arange(space.size), fixed)
    rows = space.stiffness[free]
    inner, coupling = rows[:, free].tocsr(), rows[:, fixed]
    fine, coarse = _multigrid(space, inner, free)
    prolong, preconditioner = fine.levels[0].P, fine.aspreconditioner()
    solutions = np.empty((len(values), space.size))
    for solution, boundary in zip(solutions, values, strict=True):
        solution[fixed] = boundary
        load = -(coupling @ boundary)
        linear = coarse.solve(prolong.T @ load, tol=1e-2, accel="cg")
        # fibres are then converged to some 0.05 degrees, in some 20 steps
        solution[free], failed = cg(
            inner, load, x0=prolong @ linear, rtol=1e-6, maxiter=500, M=preconditioner
        )
        if failed:
            raise RuntimeError(f"conjugate gradients: not converged after {failed} steps")
    return solutions


def _multigrid(
    space: QuadraticSpace, inner: sparse.csr_matrix, free: Integers
) -> tuple[MultilevelSolver, MultilevelSolver]:
    """Solvers on the free nodes, symmetric: of all levels, and of those below the quadratic."""
    from pyamg.multilevel import MultilevelSolver
    from pyamg.relaxation.smoothing import change_smoothers

    vertices, edges = len(space.vertices), len(space.edges)
    middles = sparse.csr_matrix(
        (np.full(2 * edges, 0.5), space.edges.ravel(), np.arange(0, 2 * edges + 1, 2)),
        shape=(edges, vertices),
    )
    from_linear = sparse.vstack([sparse.identity(vertices), middles]).tocsr()
    quadratic = MultilevelSolver.Level()
    quadratic.A = inner
    quadratic.P = from_linear[free][:, free[free < vertices]].tocsr()
    quadratic.R = quadratic.P.T.tocsr()
    coarse = smoothed_aggregation((quadratic.R @ inner @ quadratic.P).tocsr())
    fine = MultilevelSolver([quadratic, *coarse.levels], coarse_solver="pinv")
    forth, back = (("gauss_seidel", {"sweep": order}) for order in ("forward", "backward"))
    change_smoothers(fine, presmoother=forth, postsmoother=back)
    return fine, coarse


def smoothed_aggregation(matrix: sparse.csr_matrix) -> MultilevelSolver:
    """Multigrid for a symmetric matrix, the same in every run."""
    from pyamg import smoothed_aggregation_solver

    # bounds the spectrum by row sums; the default draws on NumPy's global random state
    return smoothed_aggregation_solver(matrix, smooth=("jacobi", {"weighting": "local"}))


def _basis_gradients(point: Floats) -> Floats:
    """Derivatives of the basis, λ(2λ−1), then 4λᵢλⱼ, by each λ at a point λ, shape (10, 4)."""
    i, j = TETRAHEDRON_EDGES.T
    derivatives = np.zeros((10, 4))
    derivatives[range(4), range(4)] = 4 * point - 1
    derivatives[range(4, 10), i] = 4 * point[j]
    derivatives[range(4, 10), j] = 4 * point[i]
    return derivatives


def _keys(edges: Integers, count: int) -> Integers:
    """Whole numbers that identify edges (..., 2), in the order of the edges."""
    return np.asarray(edges[..., 0].astype(np.int64) * count + edges[..., 1], dtype=np.int64)
