"""A forward simulation the published way: purkinje-uv trees, fim-python eikonal, ECG in a loop.

Run by an environment of its own (`baseline_requirements.txt`), which has no fascicle:

    python benchmarks/baseline.py CASE.npz [--repeats 3]

prints one JSON line on standard output; whatever the libraries print goes to standard error.

The recipe follows github.com/fsahli/purkinje-learning (`bo_purkinje_demo.py`,
`PurkinjeECG/Endocardium_demo.py`): grow both trees; then, at most 8 times, activate the trees
(root and junctions as sources), set the vertices of each junction's tetrahedron to its time plus
the exact anisotropic distance, solve the eikonal equation in the myocardium, read the myocardium
back at the junctions, keep the earlier time, compute the ECG, and stop when it changes by less
than 1 %. Wherever the published code repeats work that depends on the heart alone (harmonic maps,
the eikonal solver's connectivity, element gradients) or on the tree alone (locating junctions),
this one does it once, and once-per-heart work is not timed: the comparison leans towards the
baseline. `PurkinjeTree.activate_fim` sets D = cv·I, so the tree conducts at √cv; that is kept as
the library has it, and does not change the cost.

Arrays in CASE.npz
------------------
vertices (n, 3) mm; tetrahedra (m, 4) int
velocity_metric (m, 3, 3) mm²/ms²; intracellular (m, 3, 3) mS/cm
lead_fields (9, n) : 1/(4πσr) of each electrode, 1/(mS/cm · mm)
{lv,rv}_vertices (p, 3) mm; {lv,rv}_triangles (q, 3) int : the endocardia
{lv,rv}_seed (2,) int : root and direction nodes, indices into the endocardium
{lv,rv}_initial_length mm; {lv,rv}_fascicle_lengths (k,) mm; {lv,rv}_fascicle_angles (k,) rad
branch_length, segment_length mm; repulsion; branch_angle rad; generations int
root_time ms (t_RV − t_LV); cv mm/ms
source_vertices (s,) int; source_times (s,) ms : sources of the eikonal-alone comparison

Keys of the JSON line
---------------------
grow, couple, ecg, forward, eikonal_alone : seconds, each the median over the repeats after one
    warm-up. `couple` is all tree and myocardium activations of one forward simulation; `ecg` is
    *one* ECG; `forward` is the wall time of the whole, so about grow + couple + iterations · ecg.
ecg_assembled, forward_assembled : the same with the ECG from an assembled stiffness matrix, as in
    a later version of the published code.
eikonal_residual : ms by which one sweep of exact local updates still lowers a vertex.
eikonal_alone_float64, eikonal_residual_float64 : the same in double precision, which fim-python
    has as an option; its default, and so the published way, is single precision.
iterations : tree–myocardium iterations until the ECG settles.
nodes, junctions : size of the two trees together. versions : of the two libraries.
cpu_share : CPU time over wall time while measuring; well below 1 the machine was busy.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
import vtk
from eikonal_residual import eikonal_residual

# Importing these prints that CuPy is missing; standard output is for the JSON line alone.
with contextlib.redirect_stdout(sys.stderr):
    import purkinje_uv
    import pyvista
    from fimpy.solver import create_fim_solver
    from purkinje_uv import FractalTree, FractalTreeParameters, PurkinjeTree

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Case = dict[str, npt.NDArray[Any]]
EcgFunction = Callable[[Array], Array]

MAX_ITERATIONS = 8
ECG_TOLERANCE = 1e-2
REST, PLATEAU, UPSTROKE_WIDTH = -80.0, 20.0, 1.0  # mV, mV, ms
ECG_TIMES = np.linspace(-5.0, 200.0, 206)  # ms after the earliest activation
SIDES = ("lv", "rv")


@dataclass(frozen=True)
class Network:
    """The two activated-by-FIM trees and where their junctions lie."""

    trees: tuple[PurkinjeTree, PurkinjeTree]
    root_times: tuple[float, float]
    positions: Array
    """Junction positions, both trees, mm."""

    @property
    def split(self) -> int:
        """Number of left junctions, which come first."""
        return len(self.trees[0].pmj)


class TreeBuilder:
    """Grows the two trees with purkinje-uv; harmonic maps are made once."""

    def __init__(self, case: Case) -> None:
        self.case = case
        with tempfile.TemporaryDirectory() as folder:
            self.growers = [self._grower(side, Path(folder)) for side in SIDES]

    def _grower(self, side: str, folder: Path) -> FractalTree:
        case = self.case
        meshfile = folder / f"{side}.obj"
        _write_obj(meshfile, case[f"{side}_vertices"], case[f"{side}_triangles"])
        root, direction = (int(node) for node in case[f"{side}_seed"])
        return FractalTree(
            FractalTreeParameters(
                meshfile=str(meshfile),
                init_node_id=root,
                second_node_id=direction,
                init_length=float(case[f"{side}_initial_length"]),
                fascicles_length=[float(length) for length in case[f"{side}_fascicle_lengths"]],
                fascicles_angles=[float(angle) for angle in case[f"{side}_fascicle_angles"]],
                length=float(case["branch_length"]),
                l_segment=float(case["segment_length"]),
                w=float(case["repulsion"]),
                branch_angle=float(case["branch_angle"]),
                N_it=int(case["generations"]),
            )
        )

    def grow(self) -> Network:
        """Grow both trees and set their conduction and root times."""
        trees = []
        for grower in self.growers:
            grower.grow_tree()
            tree = PurkinjeTree(
                nodes=np.asarray(grower.nodes_xyz),
                connectivity=np.asarray(grower.connectivity),
                end_nodes=np.asarray(grower.end_nodes),
            )
            tree.cv = float(self.case["cv"])
            trees.append(tree)
        root_time = float(self.case["root_time"])
        return Network(
            trees=(trees[0], trees[1]),
            root_times=(-min(0.0, root_time), max(0.0, root_time)),
            positions=np.concatenate([tree.xyz[tree.pmj] for tree in trees]),
        )


class Myocardium:
    """The tetrahedral mesh with its eikonal solver and a locator for the junctions."""

    def __init__(self, case: Case, precision: type[np.floating] = np.float32) -> None:
        self.vertices: Array = case["vertices"].astype(np.float64)
        self.tetrahedra: IntArray = case["tetrahedra"].astype(np.int64)
        self.slowness_metric: Array = np.linalg.inv(case["velocity_metric"])
        self.velocity_metric: Array = case["velocity_metric"]
        self.solver = create_fim_solver(
            self.vertices, self.tetrahedra, self.velocity_metric, precision, device="cpu"
        )
        cells = np.insert(self.tetrahedra, 0, 4, axis=1)
        kinds = np.full(len(cells), vtk.VTK_TETRA, dtype=np.uint8)
        self.grid = pyvista.UnstructuredGrid(cells.ravel(), kinds, self.vertices)
        self.locator = vtk.vtkCellLocator()
        self.locator.SetDataSet(self.grid)
        self.locator.BuildLocator()

    def solve(self, sources: IntArray, times: Array) -> Array:
        """Activation of every vertex, ms, by fim-python's active-list solver."""
        return self.solver.comp_fim(sources, times).astype(np.float64)

    def residual(self, activation: Array) -> float:
        """Largest amount, ms, by which exact local updates still lower the activation."""
        return eikonal_residual(self.vertices, self.tetrahedra, self.velocity_metric, activation)

    def locate(self, points: Array) -> tuple[IntArray, Array]:
        """Vertices (k, 4) of the tetrahedron nearest each point, and interpolation weights."""
        owner = np.empty(len(points), dtype=np.int64)
        projected = np.empty_like(points)
        cell, sub_cell, squared = vtk.reference(0), vtk.reference(0), vtk.reference(0.0)
        for index, point in enumerate(points):
            self.locator.FindClosestPoint(point, projected[index], cell, sub_cell, squared)
            owner[index] = int(cell)
        corners = self.vertices[self.tetrahedra[owner]]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        offset = projected - corners[:, 0]
        weights = np.linalg.solve(edges, offset[:, :, None])[:, :, 0]
        return owner, np.column_stack([1.0 - weights.sum(axis=1), weights])

    def distances(self, points: Array, owner: IntArray) -> Array:
        """Exact travel time (k, 4), ms, from each point to the vertices of its tetrahedron."""
        offset = self.vertices[self.tetrahedra[owner]] - points[:, None, :]
        metric = self.slowness_metric[owner]
        return np.sqrt(np.einsum("kia,kab,kib->ki", offset, metric, offset))


def couple(myocardium: Myocardium, network: Network, ecg: EcgFunction) -> tuple[int, float]:
    """Iterate trees and myocardium until the ECG settles.

    Returns
    -------
    tuple of int and float
        Iterations made, and seconds spent in them outside the ECG.
    """
    start = time.perf_counter()
    seconds_in_ecg = 0.0
    owner, weights = myocardium.locate(network.positions)
    corners = myocardium.tetrahedra[owner]
    distances = myocardium.distances(network.positions, owner)
    junction_times = np.full(len(owner), np.inf)
    previous: Array | None = None
    iteration, settled = 0, False
    while not settled and iteration < MAX_ITERATIONS:
        iteration += 1
        junction_times = _activate_trees(network, junction_times)
        vertex_times = np.full(len(myocardium.vertices), np.inf)
        np.minimum.at(vertex_times, corners, junction_times[:, None] + distances)
        sources = np.flatnonzero(np.isfinite(vertex_times))
        activation = myocardium.solve(sources, vertex_times[sources])
        junction_times = np.minimum(junction_times, (activation[corners] * weights).sum(axis=1))
        ecg_start = time.perf_counter()
        potentials = ecg(activation)
        seconds_in_ecg += time.perf_counter() - ecg_start
        if previous is not None:
            change = np.linalg.norm(potentials - previous) / np.linalg.norm(previous)
            settled = bool(change < ECG_TOLERANCE)
        previous = potentials
    return iteration, time.perf_counter() - start - seconds_in_ecg


def _activate_trees(network: Network, junction_times: Array) -> Array:
    """Activation of all junctions, roots and earlier junction times being the sources."""
    by_side = np.split(junction_times, [network.split])
    activated = []
    for tree, root_time, times in zip(network.trees, network.root_times, by_side, strict=True):
        sources = np.concatenate([[0], tree.pmj])
        activated.append(tree.activate_fim(sources, np.concatenate([[root_time], times])))
    return np.concatenate(activated).astype(np.float64)


class ElementLoopEcg:
    """V(t) = −Σₑ |e| (Gᵢ∇Z · ∇Vm)ₑ, the gradient of Vm formed again at each of 206 time steps."""

    def __init__(self, case: Case) -> None:
        self.tetrahedra: IntArray = case["tetrahedra"].astype(np.int64)
        self.gradients, volumes = _element_gradients(case["vertices"], self.tetrahedra)
        lead_gradients = np.einsum(
            "mai,lmi->lma", self.gradients, case["lead_fields"][:, self.tetrahedra]
        )
        flux = np.einsum("m,mab,lmb->lma", volumes, case["intracellular"], lead_gradients)
        self.weights: Array = np.ascontiguousarray(flux.reshape(len(flux), -1))

    def __call__(self, activation: Array) -> Array:
        """Potential (9, 206) at the electrodes, mV."""
        potentials = np.empty((len(self.weights), len(ECG_TIMES)))
        for step, vm in enumerate(_membrane_potentials(activation)):
            gradient = np.einsum("mai,mi->ma", self.gradients, vm[self.tetrahedra])
            potentials[:, step] = -self.weights @ gradient.ravel()
        return potentials


class AssembledEcg:
    """V(t) = −Zᵀ K Vm(t) with the stiffness matrix K of Gᵢ assembled once."""

    def __init__(self, case: Case) -> None:
        tetrahedra: IntArray = case["tetrahedra"].astype(np.int64)
        gradients, volumes = _element_gradients(case["vertices"], tetrahedra)
        local = np.einsum(
            "m,mai,mab,mbj->mij", volumes, gradients, case["intracellular"], gradients
        )
        rows = np.repeat(tetrahedra, 4, axis=1).ravel()
        columns = np.tile(tetrahedra, 4).ravel()
        size = len(case["vertices"])
        shape = (size, size)
        self.stiffness = scipy.sparse.coo_matrix((local.ravel(), (rows, columns)), shape).tocsr()
        self.lead_fields: Array = case["lead_fields"]

    def __call__(self, activation: Array) -> Array:
        """Potential (9, 206) at the electrodes, mV."""
        potentials = np.empty((len(self.lead_fields), len(ECG_TIMES)))
        for step, vm in enumerate(_membrane_potentials(activation)):
            potentials[:, step] = -self.lead_fields @ (self.stiffness @ vm)
        return potentials


def _membrane_potentials(activation: Array) -> Any:
    """Vm at the vertices, mV, one time step after the other."""
    since_first = activation - activation.min()
    for moment in ECG_TIMES:
        upstroke = 1.0 + np.tanh((moment - since_first) / UPSTROKE_WIDTH)
        yield REST + 0.5 * (PLATEAU - REST) * upstroke


def _element_gradients(vertices: Array, tetrahedra: IntArray) -> tuple[Array, Array]:
    """Gradients (m, 3, 4) of the linear shape functions, 1/mm, and volumes (m,), mm³."""
    corners = vertices[tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    inverse = np.linalg.inv(edges)
    first = -inverse.sum(axis=2, keepdims=True)
    return np.concatenate([first, inverse], axis=2), np.abs(np.linalg.det(edges)) / 6.0


def _write_obj(path: Path, vertices: Array, triangles: IntArray) -> None:
    """Write a surface as Wavefront OBJ, the only way into purkinje-uv."""
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in vertices]
    lines += [f"f {i} {j} {k}" for i, j, k in triangles + 1]
    path.write_text("\n".join(lines) + "\n")


def _timed(function: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median wall time in seconds after one warm-up, and the last result."""
    result = function()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


def measure(case: Case, repeats: int) -> dict[str, Any]:
    """Time every stage of the baseline; the module's docstring lists the keys."""
    builder, myocardium = TreeBuilder(case), Myocardium(case)
    element_loop, assembled = ElementLoopEcg(case), AssembledEcg(case)

    def forward(ecg: EcgFunction) -> tuple[int, float]:
        return couple(myocardium, builder.grow(), ecg)

    wall_start, cpu_start = time.perf_counter(), time.process_time()
    grow_seconds, network = _timed(builder.grow, repeats)
    coupling = [couple(myocardium, network, element_loop) for _ in range(repeats + 1)][1:]
    forward_seconds, (iterations, _) = _timed(lambda: forward(element_loop), repeats)
    forward_assembled, _ = _timed(lambda: forward(assembled), repeats)
    sources = case["source_vertices"].astype(np.int64)
    eikonal_seconds, activation = _timed(
        lambda: myocardium.solve(sources, case["source_times"]), repeats
    )
    in_double = Myocardium(case, np.float64)
    double_seconds, double_activation = _timed(
        lambda: in_double.solve(sources, case["source_times"]), repeats
    )
    ecg_seconds, potentials = _timed(lambda: element_loop(activation), repeats)
    ecg_assembled, same_potentials = _timed(lambda: assembled(activation), repeats)
    cpu_share = (time.process_time() - cpu_start) / (time.perf_counter() - wall_start)
    np.testing.assert_allclose(same_potentials, potentials, atol=1e-9 * np.ptp(potentials))
    return {
        "grow": grow_seconds,
        "couple": statistics.median(seconds for _, seconds in coupling),
        "ecg": ecg_seconds,
        "forward": forward_seconds,
        "eikonal_alone": eikonal_seconds,
        "eikonal_residual": myocardium.residual(activation),
        "eikonal_alone_float64": double_seconds,
        "eikonal_residual_float64": in_double.residual(double_activation),
        "iterations": iterations,
        "ecg_assembled": ecg_assembled,
        "forward_assembled": forward_assembled,
        "nodes": sum(len(tree.xyz) for tree in network.trees),
        "junctions": len(network.positions),
        "cpu_share": cpu_share,
        "versions": {name: version(name) for name in ("purkinje-uv", "fim-python")},
    }


def main() -> None:
    """Read the case, measure, print one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", type=Path, help="the .npz described in this file's docstring")
    parser.add_argument("--repeats", type=int, default=3, help="timed runs after the warm-up")
    arguments = parser.parse_args()
    with np.load(arguments.case, allow_pickle=False) as archive:
        case = dict(archive)
    with contextlib.redirect_stdout(sys.stderr):
        purkinje_uv.configure("cpu")
        report = measure(case, arguments.repeats)
    print(json.dumps(report))


if __name__ == "__main__":
    main()
