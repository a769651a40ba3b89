"""Time and memory to solve the lead fields of nine electrodes on 300,000 vertices.

    python -m benchmarks.lead_fields [--cells 66]

A box of (cells + 1)³ vertices, shaken, with a ball of myocardium whose fibres wind around it, blood
inside and lungs beside it. The requirement is 90 s on two cores. The baseline solves one of the
nine, in the same process, by conjugate gradients with the diagonal as preconditioner.
"""

from __future__ import annotations

import argparse
import resource
import time
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import diags
from scipy.sparse.linalg import cg

from fascicle.heart.conduction import Conduction
from fascicle.torso.lead_fields import assemble_stiffness, place_electrodes, solve_neumann

REQUIRED = 90.0  # s
SIZE = 300.0  # mm
SHAKE = 0.2  # of a cell
BLOOD, HEART = 25.0, 45.0  # mm, radii
LUNGS = np.array([[80.0, 0.0, 0.0], [-80.0, 0.0, 0.0]])  # mm, centres
LUNG = 45.0  # mm, radius


def chest(
    cells: int, conduction: Conduction
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Vertices, tetrahedra and their conductivities."""
    grid = np.indices((cells + 1,) * 3).reshape(3, -1).T
    inner = ((grid > 0) & (grid < cells)).all(axis=1)
    shake = np.random.default_rng(0).uniform(-SHAKE, SHAKE, (inner.sum(), 3))
    vertices = grid.astype(float)
    vertices[inner] += shake
    vertices = (vertices / cells - 0.5) * SIZE
    strides = np.array([(cells + 1) ** 2, cells + 1, 1])
    lowest = grid[(grid < cells).all(axis=1)] @ strides
    tetrahedra = np.concatenate(
        [
            lowest[:, None] + np.cumsum([0, *strides[list(order)]])
            for order in permutations(range(3))
        ]
    )
    return vertices, tetrahedra, conductivities(vertices[tetrahedra].mean(axis=1), conduction)


def conductivities(centres: NDArray[np.float64], conduction: Conduction) -> NDArray[np.float64]:
    """σ at some points (mS/cm), shape (m, 3, 3)."""
    radius = np.linalg.norm(centres, axis=1)
    scalar = np.full(len(centres), conduction.body)
    for lung in LUNGS:
        scalar[np.linalg.norm(centres - lung, axis=1) < LUNG] = conduction.lung
    scalar[radius < BLOOD] = conduction.blood
    sigma = scalar[:, None, None] * np.eye(3)
    heart = (radius >= BLOOD) & (radius < HEART)
    fibres = np.cross(centres[heart], [0.0, 0.0, 1.0])
    fibres[:, 2] = HEART / 3
    fibres /= np.linalg.norm(fibres, axis=1, keepdims=True)
    sigma[heart] = conduction.bulk(fibres)
    return sigma


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=66)
    vertices, tetrahedra, sigma = chest(parser.parse_args().cells, Conduction())
    print(f"{len(vertices)} vertices, {len(tetrahedra)} tetrahedra")
    directions = np.random.default_rng(1).normal(size=(9, 3))
    electrodes = SIZE * directions / np.linalg.norm(directions, axis=1, keepdims=True)

    start = time.perf_counter()
    contacts = place_electrodes(vertices, tetrahedra, electrodes)
    stiffness = assemble_stiffness(vertices, tetrahedra, sigma)
    assembled = time.perf_counter() - start
    currents = contacts.currents(len(vertices))
    solve_neumann(stiffness, currents)
    elapsed = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"assembly {assembled:.1f} s, nine lead fields {elapsed - assembled:.1f} s")
    print(f"together {elapsed:.1f} s, required {REQUIRED:.0f} s: ratio {elapsed / REQUIRED:.2f}")
    print(f"peak memory {peak:.1f} GiB, mesh included")

    start = time.perf_counter()
    inverse = diags(1 / stiffness.diagonal())
    _, failed = cg(stiffness, currents[0], rtol=1e-9, maxiter=5000, M=inverse)
    baseline = time.perf_counter() - start
    single = (elapsed - assembled) / len(currents)
    print(
        f"one lead field {single:.1f} s, diagonal {baseline:.1f} s: ratio {single / baseline:.2f}"
    )
    print("the diagonal did not converge" if failed else "both to the same residual")


if __name__ == "__main__":
    main()
