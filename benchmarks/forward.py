"""A forward simulation, root times to ECG: fascicle against the published way of doing it.

    python -m benchmarks.forward --data CRTDEMO_FOLDER --baseline-python BASELINE/bin/python
    python -m benchmarks.forward --data CRTDEMO_FOLDER --make-baseline BASELINE

The second form makes the baseline's environment first (`baseline_requirements.txt`). Both codes get
the same arrays, each in a fresh process with one thread on one and the same core, one after the
other, each timed as the median after a warm-up. What is timed and what is not stands in
`baseline.py`; run from the root of the repository.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from fascicle.heart.heart import Heart

Array = npt.NDArray[np.float64]
Case = dict[str, npt.NDArray[Any]]
Report = dict[str, Any]

HERE = Path(__file__).resolve().parent
REQUIREMENTS = HERE / "baseline_requirements.txt"
ONE_THREAD = {
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "VTK_SMP_MAX_THREADS": "1",
}

ELECTRODES = ("RA", "LA", "LL", "V1", "V2", "V3", "V4", "V5", "V6")
ALPHA = 0.05  # cm·ms⁻¹·(mS/cm)^-½
INTRACELLULAR = (3.0, 0.3)  # mS/cm along and across the fibres
EXTRACELLULAR = (3.0, 1.2)  # mS/cm along and across the fibres
CM2_TO_MM2 = 100.0
TORSO_CONDUCTIVITY = 2.0  # mS/cm, scales the ECG only
SOURCES_PER_VENTRICLE = 100  # of the eikonal-alone comparison, about as many as junctions

# Root and direction nodes of the published code; the rest lies inside the paper's ranges and is
# chosen so that both trees grow without leaving the endocardium.
PARAMETERS: dict[str, Any] = {
    "lv_seed": (388, 412),
    "rv_seed": (198, 186),
    "lv_initial_length": 50.0,
    "rv_initial_length": 60.0,
    "lv_fascicle_lengths": (15.0, 20.0),
    "rv_fascicle_lengths": (20.0, 15.0),
    "lv_fascicle_angles": (0.5, -0.3),
    "rv_fascicle_angles": (0.5, -0.3),
    "branch_length": 8.0,
    "segment_length": 1.0,
    "repulsion": 0.1,
    "branch_angle": 0.15,
    "generations": 20,
    "root_time": -20.0,
    "cv": 2.5,
}

STAGES = (
    ("grow", "grow both trees"),
    ("couple", "couple trees and myocardium"),
    ("ecg", "one ECG"),
    ("forward", "whole forward simulation"),
    ("same_trees", "whole, only speed and root time new"),
    ("eikonal_alone", "eikonal alone, given sources"),
)

# Kinder to the baseline than the published way: fascicle's key, the baseline's, label.
BASELINE_VARIANTS = (
    ("forward", "forward_assembled", "whole, baseline ECG assembled"),
    ("eikonal_alone", "eikonal_alone_float64", "eikonal alone, baseline in float64"),
)


def build_case(folder: Path) -> Case:
    """Arrays of the crtdemo heart that both sides start from, as `baseline.py` documents them."""
    import pyvista

    mesh = pyvista.read(folder / "crtdemo_mesh_oriented.vtk")
    vertices = np.asarray(mesh.points, dtype=np.float64)
    tetrahedra = mesh.cells_dict[pyvista.CellType.TETRA].astype(np.int64)
    fibres = _fibres_by_position(pyvista.read(folder / "crtdemo_f0_oriented.vtk"), vertices)
    fibre = _element_fibres(fibres, tetrahedra)
    intracellular = _transversely_isotropic(INTRACELLULAR, fibre)
    extracellular = _transversely_isotropic(EXTRACELLULAR, fibre)
    bulk = intracellular @ np.linalg.inv(intracellular + extracellular) @ extracellular
    case: Case = {
        "vertices": vertices,
        "tetrahedra": tetrahedra,
        "fibre": fibre,
        "velocity_metric": CM2_TO_MM2 * ALPHA**2 * 0.5 * (bulk + np.swapaxes(bulk, 1, 2)),
        "intracellular": intracellular,
    }
    case["electrodes"] = _electrodes(folder / "electrodes_mm.csv")
    case["lead_fields"] = _lead_fields(case["electrodes"], vertices)
    for side in ("lv", "rv"):
        points, triangles = _read_obj(folder / f"crtdemo_{side.upper()}endo_heart_cut.obj")
        case[f"{side}_vertices"] = points
        case[f"{side}_triangles"] = triangles
    case |= {name: np.asarray(value) for name, value in PARAMETERS.items()}
    case["source_vertices"], case["source_times"] = _sources(case)
    return case


def measure_fascicle(case: Case, repeats: int) -> Report:
    """Time fascicle on the case, in this process, as `baseline.measure` times the baseline.

    Build what depends on the heart alone first (charts, precomputed local solvers, lead-field
    weights), untimed; then take each time as the median of `repeats` runs after one warm-up.

    Parameters
    ----------
    case : dict of arrays
        As documented in `baseline.py`. Angles there turn as purkinje-uv's disk does, which may be
        the mirror image of fascicle's.
    repeats : int
        Timed runs after the warm-up.

    Returns
    -------
    dict
        ``grow``, ``couple``, ``ecg``, ``forward``, ``same_trees``, ``eikonal_alone`` : seconds, for
        growing both trees and finding where they meet the tissue, the coupled activation, one ECG,
        all together, the same where the trees are remembered, and the eikonal equation from
        ``source_vertices`` at ``source_times``. ``eikonal_residual`` : ms, by
        `benchmarks.eikonal_residual.eikonal_residual` on that last activation. ``iterations`` :
        coupled solutions needed. Optional: ``nodes``, ``junctions`` of the two trees together;
        ``versions``, a dict; ``cpu_share``,
        CPU time over wall time while measuring (well below 1: a busy machine, measure again).
    """
    from benchmarks.eikonal_residual import eikonal_residual
    from benchmarks.references import solve_from_vertices
    from fascicle.core.parameters import Infeasible
    from fascicle.forward.eikonal.activation import solve
    from fascicle.forward.eikonal.myocardium import attach
    from fascicle.forward.model import ForwardModel

    model = ForwardModel(_heart(case))
    parameters = _named_parameters(case)
    trees = model.grow(parameters)
    if isinstance(trees, Infeasible):
        raise RuntimeError(f"the benchmark's parameters give no tree: {trees.reason}")
    roots = (max(0.0, -parameters["root_time"]), max(0.0, parameters["root_time"]))
    anew = itertools.count(1)

    def other_angle() -> dict[str, float]:
        """Parameters that were never seen, since lately grown trees are remembered."""
        name = "lv_fascicle_angle_1"
        return parameters | {name: parameters[name] + 1e-12 * next(anew)}

    def couple() -> Array:
        coupling = attach(model.myocardium, trees)
        return solve(coupling, roots, parameters["cv"]).myocardium

    def eikonal_alone() -> Array:
        times = np.full(len(case["vertices"]), np.inf)
        times[case["source_vertices"]] = case["source_times"]
        return solve_from_vertices(model.myocardium, times)

    activation = couple()
    stages: dict[str, Callable[[], object]] = {
        "grow": lambda: model.grow(other_angle()),
        "couple": couple,
        "ecg": lambda: model.electrocardiograph.leads(activation),
        "forward": lambda: model.simulate(other_angle()),
        "same_trees": lambda: model.simulate(parameters),
        "eikonal_alone": eikonal_alone,
    }
    wall, cpu = time.perf_counter(), time.process_time()
    report: Report = {name: _median_seconds(stage, repeats) for name, stage in stages.items()}
    share = (time.process_time() - cpu) / (time.perf_counter() - wall)
    residual = eikonal_residual(
        case["vertices"], case["tetrahedra"], case["velocity_metric"], eikonal_alone()
    )
    return report | {
        "eikonal_residual": residual,
        "iterations": 1,
        "nodes": sum(len(tree.nodes) for tree in trees),
        "junctions": sum(len(tree.junctions) for tree in trees),
        "cpu_share": share,
        "versions": {name: version(name) for name in ("fascicle-ecg", "numba", "numpy")},
    }


def _median_seconds(stage: Callable[[], object], repeats: int) -> float:
    """Median duration of a stage after one warm-up."""
    stage()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        stage()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def _heart(case: Case) -> Heart:
    """Hold the case's arrays as fascicle holds a heart."""
    from fascicle.heart.endocardium import Endocardium, oriented_into_cavity
    from fascicle.heart.heart import Heart

    endocardia = []
    for side in ("lv", "rv"):
        points, triangles = case[f"{side}_vertices"], case[f"{side}_triangles"]
        root, direction = (int(seed) for seed in case[f"{side}_seed"])
        facing = oriented_into_cavity(points, triangles, side)
        endocardia.append(Endocardium(side, points, facing, root, direction))
    lv, rv = endocardia
    return Heart(case["vertices"], case["tetrahedra"], case["fibre"], lv, rv, case["electrodes"])


def _named_parameters(case: Case) -> dict[str, float]:
    """Give the case's parameters fascicle's names."""
    named = {name: float(case[name]) for name in ("root_time", "cv")}
    for side in ("lv", "rv"):
        named[f"{side}_initial_length"] = float(case[f"{side}_initial_length"])
        for kind in ("length", "angle"):
            for k, value in enumerate(case[f"{side}_fascicle_{kind}s"], 1):
                named[f"{side}_fascicle_{kind}_{k}"] = float(value)
    return named


def make_baseline(folder: Path) -> Path:
    """Make the baseline's virtual environment and return its Python."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    subprocess.run([python, "-m", "pip", "install", "--quiet", "-r", REQUIREMENTS], check=True)
    return python


def run_child(command: Sequence[str | Path]) -> Report:
    """Run one side with one thread and return the JSON line it prints last."""
    finished = subprocess.run(
        command, check=True, env=os.environ | ONE_THREAD, stdout=subprocess.PIPE, text=True
    )
    report: Report = json.loads(finished.stdout.splitlines()[-1])
    return report


def pin_to_one_core() -> None:
    """Keep this process and its children on one core, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def print_table(fascicle: Report | None, baseline: Report | None) -> None:
    """Print times in ms and how many times faster fascicle is."""
    print(f"{'':<42}{'fascicle':>12}{'baseline':>12}{'ratio':>9}")
    for key, label in STAGES:
        _print_row(f"{label}, ms", _scaled(fascicle, key), _scaled(baseline, key))
    for key, variant, label in BASELINE_VARIANTS:
        _print_row(f"{label}, ms", _scaled(fascicle, key), _scaled(baseline, variant))
    for key, label in (
        ("eikonal_residual", "eikonal residual, ms"),
        ("eikonal_residual_float64", "eikonal residual, baseline in float64, ms"),
        ("iterations", "coupling iterations"),
        ("nodes", "tree nodes"),
        ("junctions", "junctions"),
        ("cpu_share", "share of the core had"),
    ):
        values = [report.get(key) if report else None for report in (fascicle, baseline)]
        print(f"{label:<42}" + "".join(f"{_shown(value):>12}" for value in values))
    for report in (fascicle, baseline):
        if report and "versions" in report:
            print("; ".join(f"{name} {number}" for name, number in report["versions"].items()))


def _print_row(label: str, fascicle: float | None, baseline: float | None) -> None:
    both = fascicle is not None and baseline is not None
    ratio = f"{baseline / fascicle:.1f}" if both else "-"
    print(f"{label:<42}{_shown(fascicle):>12}{_shown(baseline):>12}{ratio:>9}")


def _scaled(report: Report | None, key: str) -> float | None:
    """Milliseconds from a report in seconds."""
    return 1e3 * report[key] if report and key in report else None


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _fibres_by_position(fibre_mesh: Any, vertices: Array) -> Array:
    """Fibre at each vertex, from a mesh whose points are the same in another order."""
    from scipy.spatial import KDTree

    distance, match = KDTree(fibre_mesh.points).query(vertices)
    if distance.max() > 1e-3 or len(np.unique(match)) != len(vertices):
        raise ValueError(
            f"crtdemo_f0_oriented.vtk: its points are not those of the mesh (furthest "
            f"{distance.max():.3g} mm, allowed 0.001 mm); use the two files of one heart"
        )
    return np.asarray(fibre_mesh.point_data["fiber"], dtype=np.float64)[match]


def _element_fibres(fibres: Array, tetrahedra: npt.NDArray[np.int64]) -> Array:
    """Mean of the fibres at the corners of each tetrahedron, turned towards the first; unit."""
    corners = fibres[tetrahedra]
    towards = np.sign(np.einsum("mia,ma->mi", corners, corners[:, 0]))
    mean = np.einsum("mi,mia->ma", towards, corners)
    return mean / np.linalg.norm(mean, axis=1, keepdims=True)


def _transversely_isotropic(along_and_across: tuple[float, float], fibre: Array) -> Array:
    """G = σ_t I + (σ_l − σ_t) f⊗f per element, mS/cm."""
    along, across = along_and_across
    return across * np.eye(3) + (along - across) * fibre[:, :, None] * fibre[:, None, :]


def _electrodes(path: Path) -> Array:
    """Positions (mm), in the order of `ELECTRODES`."""
    positions = {}
    for line in path.read_text().splitlines()[1:]:
        name, *xyz = line.split(",")
        positions[name] = [float(value) for value in xyz]
    return np.array([positions[name] for name in ELECTRODES])


def _lead_fields(electrodes: Array, vertices: Array) -> Array:
    """Z = 1/(4πσr) of each electrode in an unbounded homogeneous conductor."""
    offset = vertices - electrodes[:, None, :]
    return 1.0 / (4.0 * np.pi * TORSO_CONDUCTIVITY * np.linalg.norm(offset, axis=2))


def _read_obj(path: Path) -> tuple[Array, npt.NDArray[np.int64]]:
    """Vertices and triangles of a Wavefront OBJ in file order, which the seeds refer to."""
    rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    vertices = np.array([row[1:4] for row in rows if row[0] == "v"], dtype=np.float64)
    faces = [[int(corner.split("/")[0]) for corner in row[1:4]] for row in rows if row[0] == "f"]
    return vertices, np.array(faces, dtype=np.int64) - 1


def _sources(case: Case) -> tuple[npt.NDArray[np.int64], Array]:
    """Vertices under the endocardia, fired at the straight-line time from each root."""
    from scipy.spatial import KDTree

    mesh = KDTree(case["vertices"])
    earliest: dict[int, float] = {}
    for side in ("lv", "rv"):
        endocardium = case[f"{side}_vertices"]
        chosen = np.linspace(0, len(endocardium) - 1, SOURCES_PER_VENTRICLE).astype(np.int64)
        root = endocardium[case[f"{side}_seed"][0]]
        times = np.linalg.norm(endocardium[chosen] - root, axis=1) / float(case["cv"])
        for vertex, moment in zip(mesh.query(endocardium[chosen])[1], times, strict=True):
            earliest[int(vertex)] = min(float(moment), earliest.get(int(vertex), np.inf))
    return np.array(list(earliest), dtype=np.int64), np.array(list(earliest.values()))


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    parser.add_argument("--baseline-python", type=Path, help="Python of the baseline environment")
    parser.add_argument("--make-baseline", type=Path, metavar="DIR", help="make that environment")
    parser.add_argument("--only", choices=("fascicle", "baseline"), help="measure one side only")
    parser.add_argument("--repeats", type=int, default=3, help="timed runs after the warm-up")
    parser.add_argument("--measure-fascicle", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.measure_fascicle is None and arguments.data is None:
        parser.error("--data is needed: the folder with crtdemo_mesh_oriented.vtk")
    wants_baseline = arguments.measure_fascicle is None and arguments.only != "fascicle"
    if wants_baseline and not (arguments.baseline_python or arguments.make_baseline):
        parser.error("the baseline needs --baseline-python or --make-baseline")
    return arguments


def main(argv: Sequence[str] | None = None) -> None:
    """Measure both sides and print the table; with the hidden option, be the fascicle child."""
    arguments = _parse(argv)
    if arguments.measure_fascicle is not None:
        with np.load(arguments.measure_fascicle, allow_pickle=False) as archive:
            print(json.dumps(measure_fascicle(dict(archive), arguments.repeats)))
        return
    python = arguments.baseline_python
    if arguments.make_baseline is not None:
        python = make_baseline(arguments.make_baseline)
    pin_to_one_core()
    fascicle: Report | None = None
    baseline: Report | None = None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.npz"
        np.savez(path, **build_case(arguments.data))
        repeats = ("--repeats", str(arguments.repeats))
        if arguments.only != "fascicle":
            baseline = run_child([python, HERE / "baseline.py", path, *repeats])
        if arguments.only != "baseline":
            module = [sys.executable, "-m", "benchmarks.forward"]
            fascicle = run_child([*module, "--measure-fascicle", path, *repeats])
    print_table(fascicle, baseline)


if __name__ == "__main__":
    main()
