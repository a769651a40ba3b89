"""The N-version slab of Niederer et al. (2011): eikonal against monodomain activation times.

    python -m benchmarks.niederer --data NIEDERER2011_FOLDER [--spacing 0.25]

A slab of 20 x 7 x 3 mm, fibres along its longest side, is stimulated in a cube of 1.5 mm at one
corner. The benchmark asks for the activation times of its eight corners, its centre and the
diagonal between. Here the eikonal solution is compared with two monodomain ones:

- nine points by fenicsx-beat at the finest grid in the file (0.1 mm, 0.005 ms);
- every node of a 0.5 mm grid by Chaste (0.01 ms), and so the diagonal too.

Both are single codes on tetrahedra whose diagonals all point from P1 to P8, and on such grids a
front is faster along the diagonals than along the axes until the grid resolves it. On Chaste's
0.5 mm grid P8 fires before P3, P4 and P7, all nearer to the stimulus; in the other file P8 fires
before P4 at 0.5 and 0.2 mm, and 0.1 ms after it at 0.1 mm. No eikonal solution can follow that:
read the first table as the comparison, whose reference still changed by 1.1 ms in the mean from 0.2
to 0.1 mm, and the second as what a coarse grid does.

Two numbers are fitted, front speed along and across the fibre, by least squares of the times at P2
to P9, which weigh the same. The stimulus is every mesh vertex in the cube, fired together at the
time the monodomain solution gives for P1: the cube depolarises as one, so that time is not fitted.
The fit uses the closed form of `exact_times`; what is then compared comes from fascicle's solver.
Run from the root of the repository.

Reference
---------
S. A. Niederer et al., Verification of cardiac tissue electrophysiology simulators using an
N-version benchmark, Phil. Trans. R. Soc. A 369 (2011) 4331-4351.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares

from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import attach
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart

Array = npt.NDArray[np.float64]

SIZE = np.array([20.0, 7.0, 3.0])  # mm
CUBE = 1.5  # mm, side of the stimulated cube at P1
POINTS = np.array(
    [[0, 0, 0], [0, 7, 0], [20, 0, 0], [20, 7, 0], [0, 0, 3], [0, 7, 3], [20, 0, 3], [20, 7, 3],
     [10, 3.5, 1.5]]
)  # fmt: skip  # mm, P1 to P9
INTRACELLULAR = (0.17, 0.019)  # S/m along and across the fibre
EXTRACELLULAR = (0.62, 0.24)  # S/m along and across the fibre

POINTS_FILE = "fenicsx_beat_points.csv"
FIELD_FILE = "activation_time_h0.05_dt0.01.dat"  # its name gives the spacing in cm
FIELD_SPACING = 0.5  # mm
DIAGONAL_SAMPLES = 41
TOLERANCE = 1e-9  # mm, a vertex on the face of the cube is in it
FIRST_GUESS = (0.6, 0.2)  # mm/ms


@dataclass(frozen=True)
class Comparison:
    """Eikonal and monodomain times of one reference solution.

    Attributes
    ----------
    along, across : float
        Fitted speeds (mm/ms).
    monodomain, eikonal : (9,) array
        Times at P1 to P9 (ms).
    diagonal : (2, s) array, optional
        Monodomain and eikonal times (ms) at evenly spaced points from P1 to P8, both interpolated
        linearly; None where the reference has only the nine points.
    solver_error : float
        Largest deviation of the solver from the exact eikonal solution, over all vertices (ms).
    """

    along: float
    across: float
    monodomain: Array
    eikonal: Array
    diagonal: Array | None
    solver_error: float

    @property
    def difference(self) -> Array:
        """Eikonal minus monodomain at P1 to P9 (ms)."""
        return self.eikonal - self.monodomain

    @property
    def misfit(self) -> float:
        """Root mean square of the difference over P2 to P9 (ms)."""
        return float(np.sqrt(np.mean(self.difference[1:] ** 2)))


def read_points(folder: Path) -> Array:
    """Monodomain times (ms) at P1 to P9 by grid, finest first, each with its shortest time step."""
    rows = np.loadtxt(folder / POINTS_FILE, delimiter=",", skiprows=1)
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    first_of_grid = np.unique(rows[:, 0], return_index=True)[1]
    return np.asarray(rows[first_of_grid, 2:], dtype=float)


def read_field(folder: Path) -> Array:
    """Monodomain times (ms) at the nodes of the 0.5 mm grid; axes x (fibre), y, z."""
    shape = _cells(FIELD_SPACING) + 1
    times = np.loadtxt(folder / FIELD_FILE)
    if times.size != shape.prod():
        raise ValueError(
            f"{FIELD_FILE}: {times.size} values found, {shape.prod()} needed, one for each node of "
            f"a grid of {FIELD_SPACING} mm; use the original file"
        )
    return np.asarray(times.reshape(shape, order="F"), dtype=float)


def speed_ratio() -> float:
    """Planar speed along over across the fibre: √(D_l/D_t), whatever the cell model.

    D is the monodomain diffusivity σᵢσₑ/(σᵢ+σₑ)/(χC): scaling length by √D gives the same front.
    """
    along, across = (i * e / (i + e) for i, e in zip(INTRACELLULAR, EXTRACELLULAR, strict=True))
    return float(np.sqrt(along / across))


def exact_times(points: Array, along: float, across: float, start: float) -> Array:
    """Exact eikonal times of the slab (ms), at `points` of shape (n, 3).

    T = start + √((dx/along)² + (dy² + dz²)/across²), with (dx, dy, dz) from the nearest point of
    the cube: the straight line is the fastest path, as slab and cube are convex.
    """
    beyond = np.maximum(points - CUBE, 0.0)
    return np.asarray(start + np.linalg.norm(beyond / [along, across, across], axis=1))


def fit_speeds(monodomain: Array) -> tuple[float, float]:
    """Speeds along and across the fibre (mm/ms): least squares of the times at P2 to P9."""

    def residual(speeds: Array) -> Array:
        return (exact_times(POINTS, speeds[0], speeds[1], monodomain[0]) - monodomain)[1:]

    along, across = least_squares(residual, FIRST_GUESS).x
    return float(along), float(across)


def eikonal_times(spacing: float, along: float, across: float, start: float) -> Array:
    """Times by fascicle's solver (ms) at the nodes of a grid; axes x (fibre), y, z."""
    heart = slab(spacing)
    myocardium = build_myocardium(heart, conduction(along, across))
    stimuli = heart.vertices[(heart.vertices <= CUBE + TOLERANCE).all(axis=1)]
    coupling = attach(myocardium, (), points=stimuli)
    activation = solve(coupling, (), 1.0, stimuli=np.full(len(stimuli), start).tolist())
    return activation.myocardium.reshape(_cells(spacing) + 1)


def conduction(along: float, across: float) -> Conduction:
    """Conductivities for the given speeds (mm/ms); only their products with α² matter."""
    longitudinal = 3.0  # mS/cm, intra- and extracellular, so half of it in series
    alpha = along / np.sqrt(100 * longitudinal / 2)
    transverse = longitudinal * (across / along) ** 2
    return Conduction(longitudinal, transverse, longitudinal, transverse, alpha)


def slab(spacing: float) -> Heart:
    """The slab as a grid of cubes of six tetrahedra each; vertices in C order of x, y, z.

    Each tetrahedron of a cube goes from its lowest corner to its highest by one order of axes. The
    endocardia are placeholders: nothing here asks for them.
    """
    cells = _cells(spacing)
    nodes = np.stack(np.meshgrid(*(np.arange(n + 1) for n in cells), indexing="ij"), axis=-1)
    strides = np.array([(cells[1] + 1) * (cells[2] + 1), cells[2] + 1, 1])
    lowest = nodes[:-1, :-1, :-1].reshape(-1, 3) @ strides
    rays = []
    for first, second, third in permutations(range(3)):
        steps = [0, *np.cumsum(strides[[first, second, third]])]
        even = (second - first) % 3 == 1  # an odd order of axes is turned inside out
        rays.append(steps if even else [steps[k] for k in (1, 0, 2, 3)])
    tetrahedra = (lowest[:, None, None] + np.array(rays)).reshape(-1, 4).astype(np.int64)
    vertices = nodes.reshape(-1, 3) * (SIZE / cells)
    fibres = np.tile([1.0, 0.0, 0.0], (len(tetrahedra), 1))
    face = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    return Heart(vertices, tetrahedra, fibres, face, face, np.zeros((9, 3)), name="slab")


def compare_points(folder: Path, spacing: float) -> Comparison:
    """Compare at the nine points with the finest monodomain solution."""
    return _compare(read_points(folder)[0], None, spacing)


def compare_field(folder: Path, spacing: float) -> Comparison:
    """Compare at the nine points and along the diagonal with the coarse monodomain field."""
    field = read_field(folder)
    return _compare(_sampled(field, POINTS), field, spacing)


def _compare(monodomain: Array, field: Array | None, spacing: float) -> Comparison:
    start = float(monodomain[0])
    along, across = fit_speeds(monodomain)
    grid = eikonal_times(spacing, along, across, start)
    exact = exact_times(slab(spacing).vertices, along, across, start)
    diagonal = None
    if field is not None:
        line = np.linspace(0.0, 1.0, DIAGONAL_SAMPLES)[:, None] * SIZE
        diagonal = np.stack([_sampled(field, line), _sampled(grid, line)])
    return Comparison(
        along,
        across,
        monodomain,
        _sampled(grid, POINTS),
        diagonal,
        float(np.abs(grid.ravel() - exact).max()),
    )


def _cells(spacing: float) -> npt.NDArray[np.int64]:
    """Cubes along each side; the sides and the stimulus must be whole numbers of them."""
    cells = np.array([*SIZE, CUBE]) / spacing
    if not np.allclose(cells, np.round(cells)):
        raise ValueError(
            f"spacing {spacing} mm does not divide the sides of 20, 7, 3 mm and the stimulus of "
            f"{CUBE} mm; use 0.5 mm or 0.25 mm"
        )
    return np.round(cells[:3]).astype(np.int64)


def _sampled(grid: Array, points: Array) -> Array:
    """Values of nodal times at `points`, interpolated linearly along each axis."""
    axes = tuple(np.linspace(0.0, side, n) for side, n in zip(SIZE, grid.shape, strict=True))
    return np.asarray(RegularGridInterpolator(axes, grid)(points), dtype=float)


def print_comparison(title: str, comparison: Comparison) -> None:
    """Print the fit, the nine points and, where there is one, the diagonal."""
    print(title)
    print(
        f"  fitted: {comparison.along:.4f} mm/ms along, {comparison.across:.4f} mm/ms across, "
        f"ratio {comparison.along / comparison.across:.3f} (conductivities: {speed_ratio():.3f})"
    )
    print(f"  {'point':<7}{'monodomain, ms':>16}{'eikonal, ms':>14}{'difference, ms':>17}")
    rows = zip(comparison.monodomain, comparison.eikonal, comparison.difference, strict=True)
    for number, (monodomain, eikonal, difference) in enumerate(rows, 1):
        print(f"  P{number:<6}{monodomain:>16.2f}{eikonal:>14.2f}{difference:>+17.2f}")
    largest = np.abs(comparison.difference).max()
    print(f"  P2 to P9: root mean square {comparison.misfit:.2f} ms, largest {largest:.2f} ms")
    if comparison.diagonal is not None:
        gap = np.abs(comparison.diagonal[1] - comparison.diagonal[0])
        print(f"  diagonal P1 to P8: mean {gap.mean():.2f} ms, largest {gap.max():.2f} ms")
    print(f"  solver against exact eikonal solution: {comparison.solver_error:.1e} ms")


def main(argv: Sequence[str] | None = None) -> None:
    """Compare with both references and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help=f"folder with {POINTS_FILE}")
    parser.add_argument("--spacing", type=float, default=0.5, help="grid of the eikonal (mm)")
    arguments = parser.parse_args(argv)
    print_comparison(
        "fenicsx-beat, 0.1 mm, 0.005 ms", compare_points(arguments.data, arguments.spacing)
    )
    finest, coarser = read_points(arguments.data)[:2]
    change = np.abs(finest - coarser)
    print(
        f"  monodomain solution, from the next coarser grid: mean change {change.mean():.2f} ms, "
        f"largest {change.max():.2f} ms (P{change.argmax() + 1})"
    )
    print_comparison("Chaste, 0.5 mm, 0.01 ms", compare_field(arguments.data, arguments.spacing))


if __name__ == "__main__":
    main()
