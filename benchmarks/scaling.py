"""Time and memory of runs by size of the mesh, and by cores.

    python -m benchmarks.scaling --data CRTDEMO_FOLDER [--million]

The crtdemo heart as published and refined (each tetrahedron into eight) once and twice, and a mesh
of 300,000 vertices (with --million also one of a million, which takes minutes and many GB to
prepare), refined twice and then in part, by scikit-fem (``pip install scikit-fem``). Each in a
fresh process, pinned to one core, that reads what was prepared for the
heart before and simulates networks it has not seen: median wall time of the whole forward run, peak
memory of the process.

Then, on that heart and on the packaged one, the same number of networks one after the other and
with `ForwardModel.simulate_many` on two threads and two processes: efficiency is the time of one
worker over twice the time of two.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.forward import _heart, _named_parameters, build_case, pin_to_one_core
from fascicle.build.refinement import refined as in_eight

if TYPE_CHECKING:
    from fascicle.forward.model import ForwardModel
    from fascicle.heart.heart import Heart

WANTED = 300_000  # vertices
LARGER = 1_000_000  # with --million
NETWORKS = 480  # of the batch
WARM_UP = 32  # networks before it, that all workers may be up and have the heart
REPEATS = 5


def refined(heart: Heart, times: int) -> Heart:
    """Heart with each tetrahedron cut in eight, `times` times."""
    for _ in range(times):
        heart = in_eight(heart)
    return heart


def partly_refined(heart: Heart, count: int) -> Heart:
    """Bisect as many elements, from one side on, as bring the mesh to `count` vertices."""
    mesh = _mesh(heart)
    while mesh.p.shape[1] < count:
        order = np.argsort(mesh.p[0, mesh.t].mean(axis=0))
        missing = count / mesh.p.shape[1] - 1
        for share in np.minimum(np.linspace(0.5, 3.0, 6) * missing, 1.0):
            finer = mesh.refined(order[: int(share * len(order))])
            if finer.p.shape[1] >= count:
                break
        mesh = finer
    return _as_heart(heart, mesh)


def _mesh(heart: Heart) -> Any:
    from skfem import MeshTet

    vertices, tetrahedra = heart.vertices.T.copy(), heart.tetrahedra.T.copy()
    return MeshTet(vertices, tetrahedra)


def _as_heart(heart: Heart, mesh: Any) -> Heart:
    """The heart on a finer mesh; each element takes the fibre of the nearest coarse one."""
    from scipy.spatial import KDTree

    vertices, tetrahedra = mesh.p.T.copy(), mesh.t.T.astype(np.int64)
    coarse = heart.vertices[heart.tetrahedra].mean(axis=1)
    _, parent = KDTree(coarse).query(vertices[tetrahedra].mean(axis=1))
    edges = vertices[tetrahedra[:, 1:]] - vertices[tetrahedra[:, :1]]
    flip = np.linalg.det(edges) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    return replace(heart, vertices=vertices, tetrahedra=tetrahedra, fibres=heart.fibres[parent])


def networks(parameters: dict[str, float]) -> Iterator[dict[str, float]]:
    """Networks that differ too little to matter, but enough to be grown again."""
    number = 0
    while True:
        number += 1
        angle = parameters["lv_fascicle_angle_1"] + 1e-9 * number
        yield parameters | {"lv_fascicle_angle_1": angle}


def measure(path: Path, parameters: dict[str, float]) -> dict[str, float]:
    """Time and memory of the forward run on a prepared heart; for a process of its own."""
    from fascicle.forward.model import ForwardModel
    from fascicle.forward.preparation import from_arrays
    from fascicle.forward.template import default_template

    with np.load(path) as arrays:
        heart, prepared = from_arrays(arrays, default_template())
    model = ForwardModel(heart, prepared=prepared)
    new = networks(parameters)
    model.simulate(next(new))
    seconds = [_seconds(lambda: model.simulate(next(new))) for _ in range(REPEATS)]
    return {
        "vertices": len(heart.vertices),
        "tetrahedra": len(heart.tetrahedra),
        "seconds": float(np.median(seconds)),
        "gigabytes": _peak_gigabytes(),
    }


def _peak_gigabytes() -> float:
    """Peak memory of this process (Linux); `getrusage` would count what its parent had too."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return float(line.split()[1]) / 1e6
    return float("nan")


def _seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def sizes(heart: Heart, parameters: dict[str, float], million: bool) -> None:
    """Print a row a mesh."""
    from fascicle.forward.model import ForwardModel
    from fascicle.forward.preparation import as_arrays

    print(
        f"{'vertices':>10}{'tetrahedra':>12}{'prepare, s':>12}{'forward, s':>12}"
        f"{'a vertex, us':>14}{'memory, GB':>12}"
    )
    hearts: list[Callable[[], Heart]] = [
        lambda: heart,
        lambda: refined(heart, 1),
        lambda: refined(heart, 2),
        lambda: partly_refined(refined(heart, 2), WANTED),
    ]
    if million:
        hearts.append(lambda: partly_refined(refined(heart, 2), LARGER))
    for make in hearts:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.npz"
            mesh = make()
            begin = time.perf_counter()
            model = ForwardModel(mesh)
            took = time.perf_counter() - begin
            np.savez(path, **as_arrays(model.prepared, mesh))
            del model
            command = [sys.executable, "-m", "benchmarks.scaling", "--measure", str(path)]
            done = subprocess.run(
                [*command, json.dumps(parameters)], check=True, stdout=subprocess.PIPE, text=True
            )
        row = json.loads(done.stdout.splitlines()[-1])
        print(
            f"{row['vertices']:>10}{row['tetrahedra']:>12}{took:>12.1f}{row['seconds']:>12.4f}"
            f"{1e6 * row['seconds'] / row['vertices']:>14.2f}{row['gigabytes']:>12.2f}"
        )


def batches(model: ForwardModel, parameters: dict[str, float], name: str) -> None:
    """Print how well two workers are used on a heart called so."""
    new = networks(parameters)

    def run(executor: Executor) -> float:
        batch = [next(new) for _ in range(NETWORKS)]
        model.simulate_many(batch[:WARM_UP], executor)
        return _seconds(lambda: model.simulate_many(batch, executor))

    print(f"\n{f'{NETWORKS} networks, {name}':<32}{'one, s':>10}{'two, s':>10}{'efficiency':>12}")
    for how, pool in (("threads", ThreadPoolExecutor), ("processes", ProcessPoolExecutor)):
        with pool(1) as single:
            alone = run(single)
        with pool(2) as pair:
            together = run(pair)
        print(f"  {how:<30}{alone:>10.2f}{together:>10.2f}{alone / (2 * together):>12.1%}")


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    parser.add_argument("--million", action="store_true", help="a million vertices too")
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.measure is not None:
        path, parameters = arguments.measure
        pin_to_one_core()
        print(json.dumps(measure(Path(path), json.loads(parameters))))
        return
    if arguments.data is None:
        parser.error("--data is needed: the folder with crtdemo_mesh_oriented.vtk")
    from fascicle import EXAMPLE_PARAMETERS, ForwardModel, load_heart

    case = build_case(arguments.data)
    heart, named = _heart(case), _named_parameters(case)
    sizes(heart, named, arguments.million)
    batches(ForwardModel(heart), named, "crtdemo")
    batches(ForwardModel(load_heart("default")), EXAMPLE_PARAMETERS, "packaged heart")


if __name__ == "__main__":
    main()
