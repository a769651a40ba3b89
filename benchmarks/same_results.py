"""Whether two versions give the same results, to the last bit.

    python -m benchmarks.same_results CHECKOUT [--data FOLDER]

Runs the same commands with the source of this checkout and with that of another: a simulation on
the packaged heart, targets of recordings, a heart built from a surface, a short fit by both
methods, an origin, and predictions. Every array in the netCDF, VTK and CSV files that they write is
compared; JSON (paths and times stand in it), pictures and databases are not. Exit status 1 if any
differs, or if a command fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pandas as pd
import pyvista as pv

HERE = Path(__file__).parents[1]
RECORDINGS = ("ludb/24", "ludb/119", "ptb-s0010/s0010_re", "dicom/*.dcm", "aecg/*.xml")
FIT = ("--seed", "1", "--workers", "1")


def commands(data: Path) -> Iterator[list[str]]:
    """Commands in their order; each may read what those before it have written."""
    yield ["simulate", "default", "--out", "simulation"]
    yield ["simulate", "default", "--scenario", "his-pacing", "--out", "his"]
    for number, pattern in enumerate(RECORDINGS):
        suffix = "" if "*" in pattern else ".hea"
        for file in sorted((data / "ecg").glob(pattern + suffix)):
            # the gains per lead of LUDB are wrong
            gain = ["--shared-gain"] if file.parent.name == "ludb" else []
            yield ["target", str(file), *gain, "--out", f"target{number}.nc"]
    surface = data / "hearts" / "cobiveco-geo1" / "heart.vtp"
    yield ["heart", "build", str(surface), "--edge-length", "2", "--out", "heart"]
    target = "target0.nc"
    posterior = ["--prior-simulations", "200"]
    yield ["fit", "default", target, *FIT, *posterior, "--out", "posterior"]
    paper = ["--method", "paper", "--initial", "30", "--steps", "10", "--samples", "3"]
    yield ["fit", "default", target, *FIT, *paper, "--draws", "20000", "--out", "paper"]
    yield ["locate", "default", target, "--out", "origin"]
    yield ["predict", "posterior", "--scenario", "his-pacing-nonselective", "--out", "prediction"]


def run(checkout: Path, folder: Path, data: Path) -> None:
    """Run all commands in a folder, with the source of a checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
    for command in commands(data):
        call = [sys.executable, "-m", "fascicle.cli", *command]
        done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True)
        if done.returncode:
            sys.exit(
                f"{checkout}: fascicle {' '.join(command)} failed: {done.stderr.strip()[-400:]}"
            )
        print(f"{checkout.name}: {' '.join(command[:2])}", flush=True)


def arrays(file: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values of the arrays of a file."""
    if file.suffix == ".nc":
        with h5py.File(file) as content:
            names: list[str] = []
            content.visit(names.append)
            for name in names:
                if isinstance(content[name], h5py.Dataset):
                    yield name, content[name][()]
    elif file.suffix in {".vtu", ".vtp"}:
        mesh = pv.read(file)
        yield "points", np.asarray(mesh.points)
        for name in mesh.array_names:
            yield name, np.asarray(mesh[name])
    elif file.suffix == ".csv":
        for name, column in pd.read_csv(file, comment="#").items():
            yield str(name), column.to_numpy()


def same(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two arrays hold the same, NaN where NaN is; texts of floats are exact."""
    texts = [[str(value) for value in np.ravel(array)] for array in (first, second)]
    return np.shape(first) == np.shape(second) and texts[0] == texts[1]


def differences(first: Path, second: Path) -> Iterator[str]:
    """Files and arrays in which two folders differ."""
    files = {p.relative_to(f) for f in (first, second) for p in f.rglob("*") if p.is_file()}
    compared = 0
    for file in sorted(files):
        if file.suffix not in {".nc", ".vtu", ".vtp", ".csv"}:
            continue
        if not (first / file).exists() or not (second / file).exists():
            yield f"{file}: written by one alone"
            continue
        ours, theirs = dict(arrays(first / file)), dict(arrays(second / file))
        for name in sorted({*ours, *theirs}):
            compared += 1
            if name not in ours or name not in theirs:
                yield f"{file}: {name}: written by one alone"
            elif not same(ours[name], theirs[name]):
                yield f"{file}: {name}: other values"
    print(f"{compared} arrays in {len(files)} files compared")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkout", type=Path, help="the other version")
    default = os.environ.get("FASCICLE_TEST_DATA", str(HERE / "../shared/data"))
    parser.add_argument("--data", type=Path, default=Path(default), help="recordings and hearts")
    arguments = parser.parse_args()
    if not (arguments.checkout / "src" / "fascicle").is_dir():
        parser.error(f"{arguments.checkout}: has no src/fascicle; give a checkout")
    with TemporaryDirectory() as name:
        folders = [Path(name, "this"), Path(name, "other")]
        for folder, checkout in zip(folders, (HERE, arguments.checkout), strict=True):
            folder.mkdir()
            run(checkout.resolve(), folder, arguments.data.resolve())
        differing = [*differences(*folders)]
    print("\n".join(differing) or "no difference")
    sys.exit(bool(differing))


if __name__ == "__main__":
    main()
