"""Effect of the mesh on a tree: growth on endocardia refined fourfold and again.

    python -m benchmarks.growth_refinement --data CRTDEMO_FOLDER

Every triangle becomes four by midpoints on the flat faces, so the surface stays the same and only
the chart changes (a harmonic map, linear on each triangle). The same parameters, drawn from the
paper's ranges, then grow on the mesh as it is (x1), refined once (x4) and twice (x16). Compared are

- the chart: how far apart a point of the disk lies on the surface by the two charts (mm);
- the ends of the fascicles, before any branching (mm);
- the junctions: how many, how far to the nearest of the other tree (both ways, mm), and how many
  have none within 1 mm.

What stops one branch can decide about a whole subtree, so junctions answer to any small change. The
row "nudged" shows how much: the same mesh, every bundle and fascicle 0.01 mm longer. Only what the
other rows show beyond that is the mesh's.

Without --data only the packaged heart is measured. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import igl
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from fascicle.core.parameters import NETWORK_SPACE, Infeasible
from fascicle.heart.endocardium import Endocardium
from fascicle.purkinje.chart import Chart, build_chart
from fascicle.purkinje.growth import GrowthRules, Seed, find_seed, grow_from_parameters

Array = npt.NDArray[np.float64]

RULES = GrowthRules()
UNBRANCHED = GrowthRules(generations=0)
NEAR = 1.0  # mm; a junction with none of the other tree within this has no counterpart
NUDGE = 0.01  # mm, about as much as refinement moves the ends of fascicles
CHART_POINTS = 20000  # sampled uniformly on the surface


@dataclass(frozen=True)
class Ground:
    """A surface with what a tree needs to grow on it."""

    endocardium: Endocardium
    chart: Chart
    seed: Seed


@dataclass(frozen=True)
class Difference:
    """Two trees of the same parameters on two meshes.

    Attributes
    ----------
    junctions : tuple of int
        How many junctions each tree has.
    nearest : (n,) array
        From each junction of either tree to the nearest of the other (mm).
    ends : (f,) array
        Between the ends of the fascicles (mm).
    """

    junctions: tuple[int, int]
    nearest: Array
    ends: Array


def refined(endocardium: Endocardium) -> Endocardium:
    """Endocardium with triangles cut into four at edge midpoints; vertices keep their numbers."""
    triangles = endocardium.triangles
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = len(endocardium.vertices) + inverse.reshape(-1, 3).T
    a, b, c = triangles.T
    cut = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    midpoints = endocardium.vertices[unique].mean(axis=1)
    vertices = np.concatenate([endocardium.vertices, midpoints])
    return replace(endocardium, vertices=vertices, triangles=np.ascontiguousarray(cut))


def grounds(endocardium: Endocardium) -> list[Ground]:
    """The surface as it is, refined once and refined twice."""
    surfaces = [endocardium, refined(endocardium), refined(refined(endocardium))]
    charts = [build_chart(surface) for surface in surfaces]
    return [
        Ground(surface, chart, find_seed(surface, chart))
        for surface, chart in zip(surfaces, charts, strict=True)
    ]


def chart_shift(chart: Chart, other: Chart, rng: np.random.Generator) -> Array:
    """Distance (mm) between where two charts put the same point of the disk, for many points.

    The points lie uniformly on the surface of `chart`.
    """
    corners = chart.vertices[chart.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(area), CHART_POINTS, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), CHART_POINTS)
    disk = np.einsum("nk,nkd->nd", weights, chart.points[chart.triangles[chosen]])
    here = np.einsum("nk,nkd->nd", weights, corners[chosen])
    return np.asarray(np.linalg.norm(_positions(other, disk) - here, axis=1))


def _positions(chart: Chart, disk: Array) -> Array:
    """Points of the disk to points of the endocardium (mm)."""
    flat = np.column_stack([chart.points, np.zeros(len(chart.points))])
    points = np.column_stack([disk, np.zeros(len(disk))])
    _, triangle, foot = igl.point_mesh_squared_distance(points, flat, chart.triangles)
    corners = chart.points[chart.triangles[triangle]]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    last_two = np.linalg.solve(edges, (np.asarray(foot)[:, :2] - corners[:, 0])[:, :, None])
    weights = np.concatenate([1 - last_two.sum(axis=1), last_two[:, :, 0]], axis=1)
    return np.asarray(np.einsum("nk,nkd->nd", weights, chart.vertices[chart.triangles[triangle]]))


def junctions(ground: Ground, parameters: Mapping[str, float], rules: GrowthRules) -> Array | None:
    """Positions (mm) of the junctions of a tree, or None where it does not fit."""
    side = ground.endocardium.side
    tree = grow_from_parameters(side, ground.chart, ground.seed, parameters, rules)
    return None if isinstance(tree, Infeasible) else tree.nodes[tree.junctions]


def difference(
    ground: Ground, other: Ground, parameters: Mapping[str, float], nudge: float
) -> Difference | None:
    """Compare two trees, the second's lengths `nudge` mm longer; None where one does not fit."""
    nudged = {name: x + nudge if "_length" in name else x for name, x in parameters.items()}
    first, second = junctions(ground, parameters, RULES), junctions(other, nudged, RULES)
    if first is None or second is None:
        return None
    nearest = np.concatenate([KDTree(second).query(first)[0], KDTree(first).query(second)[0]])
    # a fascicle's end is a junction of the tree without branches, which fits where the full does
    ends = junctions(ground, parameters, UNBRANCHED), junctions(other, nudged, UNBRANCHED)
    apart = np.linalg.norm(np.subtract(*map(np.asarray, ends)), axis=1)
    return Difference((len(first), len(second)), nearest, apart)


def compare(ground: Ground, other: Ground, trees: int, nudge: float = 0.0) -> list[Difference]:
    """Compare `trees` pairs of trees that fit on both meshes; always the same parameters."""
    rng = np.random.default_rng(0)
    pairs: list[Difference] = []
    while len(pairs) < trees:
        parameters = NETWORK_SPACE.from_unit(rng.random(len(NETWORK_SPACE)))
        pair = difference(ground, other, parameters, nudge)
        if pair is not None:
            pairs.append(pair)
    return pairs


def hearts(data: Path | None) -> Iterator[tuple[str, Endocardium]]:
    """Endocardia to measure, with the name of their heart."""
    import fascicle

    for endocardium in fascicle.load_heart("default").endocardia:
        yield "default", endocardium
    if data is not None:
        from benchmarks.forward import _heart, build_case

        for endocardium in _heart(build_case(data)).endocardia:
            yield "crtdemo", endocardium


def print_row(label: str, pairs: Sequence[Difference], shift: Array) -> None:
    counts = np.array([pair.junctions for pair in pairs])
    nearest = np.concatenate([pair.nearest for pair in pairs])
    ends = np.concatenate([pair.ends for pair in pairs])
    change = np.abs(counts[:, 1] - counts[:, 0])
    print(
        f"{label:<22}{shift.mean():>8.2f}{shift.max():>8.2f}{ends.mean():>8.2f}{ends.max():>8.2f}"
        f"{counts[:, 0].mean():>9.1f}{counts[:, 1].mean():>8.1f}{change.mean():>8.1f}"
        f"{nearest.mean():>9.2f}{nearest.max():>8.2f}{(nearest > NEAR).mean():>10.0%}"
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    parser.add_argument("--trees", type=int, default=30, help="pairs of trees a surface")
    arguments = parser.parse_args(argv)
    print(
        f"{'':<22}{'chart, mm':>16}{'ends, mm':>16}{'junctions':>25}{'nearest, mm':>17}{'over':>10}"
    )
    print(f"{'':<22}" + f"{'mean':>8}{'max':>8}" * 2 + f"{'first':>9}{'second':>8}{'|diff|':>8}"
          f"{'mean':>9}{'max':>8}{NEAR:>7.0f} mm")  # fmt: skip
    for name, endocardium in hearts(arguments.data):
        meshes = grounds(endocardium)
        label = f"{name} {endocardium.side}, "
        for first, second in ((0, 1), (1, 2)):
            ground, other = meshes[first], meshes[second]
            shift = chart_shift(ground.chart, other.chart, np.random.default_rng(0))
            row = f"{label}x{4**first} to x{4**second}"
            print_row(row, compare(ground, other, arguments.trees), shift)
        nudged = compare(meshes[0], meshes[0], arguments.trees, NUDGE)
        print_row(f"{label}x1 nudged", nudged, np.zeros(1))


if __name__ == "__main__":
    main()
