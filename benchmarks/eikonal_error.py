"""Error of computed activation times against exact or finer ones.

    python -m benchmarks.eikonal_error [--data CRTDEMO_FOLDER]

Computed minus exact (or finer) time at the vertices of the mesh in question, in ms: negative is
early. Measured are

- a point source in a cube of 40 mm with straight oblique fibres, where the straight line is the
  geodesic and every time is known; with rays, and first-order updates alone, from exact
  times at the corners of the source's element;
- twelve sources at unequal times in the same cube, where fronts collide;
- a point source in a slab of 24 x 24 x 12 mm whose fibres turn by 120° from bottom to top, against
  the same slab in cells of 0.5 mm, each element with the fibre of its own depth;
- a bundle above a slab of 48 x 12 x 4 mm, in which one leaf is fired by the myocardium, the front
  runs back through the bundle and out at the other end: closed form;
- a heart and a network in sinus rhythm and with a silent left root, against the same heart with
  every tetrahedron cut into 8 and into 64 (fibres inherited), at the vertices of the heart.

Speeds are 0.6 and 0.25 mm/ms but in the heart and its network, which have their own. Without
--data the heart is left out. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.references import solve_from_vertices
from fascicle.build.refinement import refined
from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import Myocardium, attach
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import signed_volumes
from fascicle.purkinje.tree import PurkinjeTree

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Fibres = Callable[[Array], Array]

ALONG, ACROSS = 0.6, 0.25  # mm/ms
CELLS = (4.0, 2.0, 1.0)  # mm
FINEST = 0.5  # mm, cells of the solution that stands in for the exact one
JITTER = 0.2  # of a cell, by which inner vertices are moved
CUBE = np.array([40.0, 40.0, 40.0])  # mm
SLAB = np.array([24.0, 24.0, 12.0])  # mm; 331,776 tetrahedra at 0.5 mm
TURN = np.deg2rad(120.0)  # of the fibres, from the slab's bottom to its top
BAR = np.array([48.0, 12.0, 4.0])  # mm
CV = 3.0  # mm/ms
SOURCES = 12
LATEST = 30.0  # ms, when the last of them may fire

# Kuhn's six tetrahedra of a cube, corners numbered x + 2y + 4z
KUHN = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)


def conduction() -> Conduction:
    """Conductivities for the speeds `ALONG` and `ACROSS`."""
    along = 3.0  # mS/cm inside and outside, so half of it in series
    alpha = ALONG / np.sqrt(100 * along / 2)
    across = 2 * ACROSS**2 / (100 * alpha**2)
    return Conduction(along, across, along, across, alpha)


def straight(centroids: Array) -> Array:
    """Parallel oblique fibres."""
    return np.tile(np.array([2.0, 1.0, 0.7]) / np.linalg.norm([2.0, 1.0, 0.7]), (len(centroids), 1))


def lengthwise(centroids: Array) -> Array:
    """Fibres along x."""
    return np.tile([1.0, 0.0, 0.0], (len(centroids), 1))


def turning(centroids: Array) -> Array:
    """Horizontal fibres that turn evenly with height."""
    angle = TURN * centroids[:, 2] / SLAB[2]
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])


def block(size: Array, cell: float, fibres: Fibres, jitter: float = JITTER) -> Heart:
    """Box of Kuhn tetrahedra from the origin, its inner vertices moved; endocardia are dummies."""
    cells = np.round(size / cell).astype(int)
    nx, ny, _ = cells + 1
    z, y, x = np.meshgrid(*(np.arange(n + 1) for n in cells[::-1]), indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    vertices = grid * (size / cells)
    inner = ((grid > 0) & (grid < cells)).all(axis=1)
    shake = np.random.default_rng(0).uniform(-jitter, jitter, (int(inner.sum()), 3))
    vertices[inner] += shake * (size / cells)
    lowest = grid[(grid < cells).all(axis=1)] @ [1, nx, nx * ny]
    corner = np.array([i + nx * j + nx * ny * k for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    tetrahedra = (lowest[:, None] + corner)[:, KUHN].reshape(-1, 4).astype(np.int64)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    dummy = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    directions = fibres(vertices[tetrahedra].mean(axis=1))
    return Heart(vertices, tetrahedra, directions, dummy, dummy, np.zeros((9, 3)))


def fired(myocardium: Myocardium, points: Array, times: npt.ArrayLike) -> Array:
    """Times (ms) at the vertices after stimuli in the myocardium."""
    return solve(
        attach(myocardium, (), points), (), CV, stimuli=np.asarray(times, float).tolist()
    ).myocardium


def first_order(myocardium: Myocardium, point: Array) -> Array:
    """Times (ms) at the vertices after a source at 0, from those at its element's corners."""
    element = myocardium.inside(point[None]).elements[0]
    corners = myocardium.mesh.corners[element]
    offset = myocardium.mesh.vertices[corners] - point
    times = np.full(len(myocardium.order), np.inf)
    times[myocardium.order[corners]] = np.sqrt(
        np.einsum("ci,ij,cj->c", offset, myocardium.mesh.metric[element], offset)
    )
    return solve_from_vertices(myocardium, times)


def straight_times(vertices: Array, points: Array, times: npt.ArrayLike, fibre: Array) -> Array:
    """Exact times (ms) where fibres are straight and the tissue convex: √(dᵀD⁻¹d)."""
    offset = vertices[:, None] - points
    along = offset @ fibre
    square = (along / ALONG) ** 2 + ((offset**2).sum(axis=2) - along**2) / ACROSS**2
    return np.asarray((np.sqrt(square) + np.asarray(times)).min(axis=1))


def cube_errors(cell: float) -> Iterator[tuple[str, Array]]:
    """Errors of a source with rays and without, then of many sources, against exact times."""
    heart = block(CUBE, cell, straight)
    myocardium, fibre = build_myocardium(heart, conduction()), straight(np.zeros((1, 3)))[0]
    rng = np.random.default_rng(1)
    many, moments = rng.uniform(0, CUBE, (SOURCES, 3)), rng.uniform(0, LATEST, SOURCES)
    source = CUBE * [0.43, 0.55, 0.48]
    exact = straight_times(heart.vertices, source[None], [0.0], fibre)
    yield f"cube, point source, {cell:g} mm", fired(myocardium, source, [0.0]) - exact
    yield f"cube, point source, first order, {cell:g} mm", first_order(myocardium, source) - exact
    exact = straight_times(heart.vertices, many, moments, fibre)
    yield f"cube, {SOURCES} sources, {cell:g} mm", fired(myocardium, many, moments) - exact


def turning_errors() -> Iterator[tuple[str, Array]]:
    """A source in turning fibres, with rays and without, against the finest mesh.

    Vertices stand on the grid, so that those of a coarse mesh are vertices of the finest as well.
    """
    source = SLAB * [0.43, 0.55, 0.48]
    tissues = {
        cell: build_myocardium(block(SLAB, cell, turning, jitter=0.0), conduction())
        for cell in (*CELLS, FINEST)
    }
    finest = fired(tissues[FINEST], source, [0.0])
    finest = finest.reshape(np.round(SLAB[::-1] / FINEST).astype(int) + 1)
    for label, first in (("", False), (", first order", True)):
        for cell in CELLS:
            myocardium, step = tissues[cell], round(cell / FINEST)
            solved = first_order(myocardium, source) if first else fired(myocardium, source, [0.0])
            reference = finest[::step, ::step, ::step].ravel()
            yield f"turning slab{label}, {cell:g} mm", solved - reference


def coupling_errors(cell: float) -> tuple[str, Array]:
    """Myocardium fires one leaf, the bundle the other end: against the closed form."""
    heart = block(BAR, cell, lengthwise, jitter=0.0)
    myocardium = build_myocardium(heart, conduction())
    x = np.arange(0.0, BAR[0] + 1, 2.0)
    nodes = np.column_stack([x, np.full_like(x, BAR[1] / 2), np.full_like(x, BAR[2])])
    middle = len(x) // 2
    index = np.arange(len(x))
    parents = np.where(index > middle, index - 1, np.where(index < middle, index + 1, -1))
    lengths = np.where(parents >= 0, 2.0, 0.0)
    tree = PurkinjeTree("lv", nodes, parents.astype(np.int64), lengths)
    source = np.array([[3.3, 5.2, 1.1]])
    coupling = attach(myocardium, [tree], source)
    activation = solve(coupling, [np.inf], CV, stimuli=[0.0])
    fibre = np.array([1.0, 0.0, 0.0])
    entered = straight_times(nodes[:1], source, [0.0], fibre)[0]
    points = np.concatenate([source, nodes[-1:]])
    exact = straight_times(heart.vertices, points, [0.0, entered + BAR[0] / CV], fibre)
    in_tree = entered + x / CV
    error = np.concatenate([activation.myocardium - exact, activation.trees[0] - in_tree])
    return f"bundle on a slab, {cell:g} mm", error


def heart_errors(folder: Path) -> Iterator[tuple[str, Array]]:
    """The crtdemo heart against itself refined once and twice."""
    from benchmarks.forward import PARAMETERS, _heart, _named_parameters, build_case
    from fascicle.core.parameters import Infeasible
    from fascicle.forward.model import ForwardModel

    case = build_case(folder)
    model = ForwardModel(_heart(case))
    trees = model.grow(_named_parameters(case))
    if isinstance(trees, Infeasible):
        raise RuntimeError(f"the benchmark's parameters give no tree: {trees.reason}")
    hearts = [model.heart, refined(model.heart)]
    hearts.append(refined(hearts[1]))
    late = -PARAMETERS["root_time"]
    rhythms = {"sinus rhythm": (max(0.0, late), max(0.0, -late)), "left block": (np.inf, 0.0)}
    count, solved = len(model.heart.vertices), []
    for heart in hearts:
        myocardium = build_myocardium(heart, model.conduction)
        coupling = attach(myocardium, trees)
        solved.append(
            {
                rhythm: solve(coupling, roots, PARAMETERS["cv"]).myocardium[:count]
                for rhythm, roots in rhythms.items()
            }
        )
    for rhythm in rhythms:
        times = [activations[rhythm] for activations in solved]
        for (k, coarse), (_, fine) in pairwise(enumerate(times)):
            yield f"crtdemo, {rhythm}, x{8**k} to x{8 ** (k + 1)}", coarse - fine
        yield f"crtdemo, {rhythm}, x1 to x64", times[0] - times[-1]


def print_row(label: str, error: Array) -> None:
    size = np.abs(error)
    print(
        f"{label:<42}{error.mean():>9.3f}{size.mean():>9.3f}{np.percentile(size, 99):>9.3f}"
        f"{size.max():>9.3f}{error.min():>9.3f}",
        flush=True,
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    arguments = parser.parse_args(argv)
    begin = time.perf_counter()
    print(f"{'error, ms':<42}{'mean':>9}{'|mean|':>9}{'|99 %|':>9}{'|max|':>9}{'earliest':>9}")
    for cell in CELLS:
        for label, error in cube_errors(cell):
            print_row(label, error)
    for label, error in turning_errors():
        print_row(label, error)
    for cell in CELLS:
        print_row(*coupling_errors(cell))
    if arguments.data is not None:
        for label, error in heart_errors(arguments.data):
            print_row(label, error)
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
