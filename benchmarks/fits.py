"""Fits to real ECGs by both methods.

    python -m benchmarks.fits --data DATA_FOLDER
                              [--only demo|ludb23|ludb24|ludb119|ptb|dti004|dti004-body|
                                      dti004-standard|dti004-unbounded]
                              [--method posterior|paper] [--seeds 1] [--out fits]

Printed for each heart and ECG are the mismatch of a flat line and the lowest loss (mV²), the mean
correlation of the compared leads of that network with the recording, the QRS duration recorded and
of that network (ms), evaluations, effective sample (of the paper's method the networks accepted),
seconds, and the first line of the result. A fit that is there already is read, not made again.

- ludb23, ludb24, ludb119, ptb: the packaged heart and three recordings of LUDB (a wide QRS, a left
  bundle branch block, a normal QRS) and PTB's s0010;
- demo: the packaged heart and the ECG that comes with pydicom;
- dti004: one subject's heart in an idealised torso fitted to that subject's electrodes, and that
  subject's own ECG;
- dti004-body: the same with the heart's pose and the electrodes' places learnt, too;
- dti004-standard: with standard electrodes on the standard adult's torso;
- dti004-unbounded: with the subject's electrodes in an unbounded conductor, its gain free.

Hearts are built in the folder of --out, and found there again. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydicom.data import get_testdata_file

import fascicle
from fascicle.build.build_heart import TorsoOptions, build_heart
from fascicle.build.read_anatomy import Source
from fascicle.cli.output import TerminalProgress
from fascicle.heart.folder import write_heart
from fascicle.heart.heart import Heart
from fascicle.recording.choices import TargetOptions, share_gain
from fascicle.recording.pipeline import analyse
from fascicle.recording.readers.read import read_recording
from fascicle.recording.target import Target
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Posterior

DTI_NOISE = 0.03  # mV, of its one averaged beat


class Case(NamedTuple):
    """A heart and an ECG."""

    heart: Callable[[Path, Path], Heart]
    target: Callable[[Path], Target]
    settings: dict[str, Any]
    parameters: dict[str, Any] = {}  # noqa: RUF012 - never changed


def packaged(data: Path, out: Path) -> Heart:
    return fascicle.load_heart("default")


def dti004(data: Path, out: Path, name: str = "dti004") -> Heart:
    """Built once, and read back from `out` afterwards."""
    folder = out / name
    if not folder.exists():
        files = data / "hearts" / "dti004"
        surrounding = TorsoOptions(electrodes=files / "electrodes.csv")
        if name == "dti004-standard":
            surrounding = TorsoOptions(pose="lps")
        if name == "dti004-unbounded":
            surrounding = TorsoOptions("none", electrodes=files / "electrodes.csv")
        source = Source(file=files / "mesh.vtu", parts={})
        with TerminalProgress() as progress:
            built = build_heart(source, torso=surrounding, name=name, progress=progress)
        write_heart(built.heart, folder)
    return fascicle.load_heart(folder)


def demo_recording() -> Path:
    """The 10 s, 1000 Hz, 12-lead DICOM ECG that comes inside the pydicom package."""
    return Path(str(get_testdata_file("waveform_ecg.dcm", download=False)))


def demo_target(data: Path) -> Target:
    return analyse(read_recording(demo_recording())).target


def ptb_target(data: Path) -> Target:
    return analyse(read_recording(data / "ecg" / "ptb-s0010" / "s0010_re.hea")).target


def ludb_target(data: Path, record: int) -> Target:
    recording = read_recording(data / "ecg" / "ludb" / f"{record}.hea")
    return analyse(share_gain(recording)).target


def dti004_target(data: Path) -> Target:
    file = data / "hearts" / "dti004" / "ecg_beat.csv"
    return analyse(read_recording(file, unit="uV"), TargetOptions(noise=DTI_NOISE)).target


CASES = {
    "demo": Case(packaged, demo_target, {}),
    "ludb23": Case(packaged, partial(ludb_target, record=23), {}),
    "ludb24": Case(packaged, partial(ludb_target, record=24), {}),
    "ludb119": Case(packaged, partial(ludb_target, record=119), {}),
    "ptb": Case(packaged, ptb_target, {}),
    "dti004": Case(dti004, dti004_target, {}),
    "dti004-body": Case(dti004, dti004_target, {}, {"pose": "free", "electrodes": "free"}),
    "dti004-standard": Case(partial(dti004, name="dti004-standard"), dti004_target, {}),
    "dti004-unbounded": Case(
        partial(dti004, name="dti004-unbounded"), dti004_target, {"free_gain": True}
    ),
}


def row(name: str, fitted: FittedStudy, seconds: float) -> str:
    """Row of the table."""
    recording, best = fitted.recordings[0], fitted.best_network
    target, used = recording.target, recording.compared
    leads = zip(target.qrs[used], best.predicted[used][:, target.qrs_samples], strict=True)
    correlation = np.mean([np.corrcoef(recorded, simulated)[0, 1] for recorded, simulated in leads])
    population = fitted.population
    effective = population.effective.sum() if isinstance(population, Posterior) else len(population)
    return (
        f"{name:<17} {fitted.study.config.method:<9} {fitted.null_loss:6.2f} "
        f"{population.best_loss:6.3f} {correlation:5.2f} {target.qrs_duration:4.0f} "
        f"{best.beat.qrs_duration:4.0f} {len(fitted.study.records()):6d} {effective:5.0f} "
        f"{seconds:6.0f} {fitted.verdict}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("fits"))
    parser.add_argument("--only", choices=list(CASES), action="append")
    parser.add_argument("--method", choices=["posterior", "paper"], action="append")
    parser.add_argument("--seeds", type=int, default=1)
    arguments = parser.parse_args()
    print(
        f"{'':<17} {'method':<9} {'flat':>6} {'best':>6} {'corr':>5} {'QRS':>4} {'best':>4} "
        f"{'evals':>6} {'eff':>5} {'s':>6}"
    )
    for name in arguments.only or CASES:
        case = CASES[name]
        heart, target = case.heart(arguments.data, arguments.out), case.target(arguments.data)
        for method, seed in product(
            arguments.method or ("posterior", "paper"), range(arguments.seeds)
        ):
            begin = time.perf_counter()
            settings: dict[str, Any] = {"parameters": case.parameters}
            if method == "paper":
                settings |= case.settings
            else:
                settings["parameters"] = {"conduction": "normal", **case.parameters}
            with TerminalProgress() as progress:
                fitted = fascicle.fit(
                    heart, target, arguments.out / f"{name}-{method}-{seed}", method=method,
                    seed=seed, progress=progress, **settings,
                )  # fmt: skip
            print(row(name, fitted, time.perf_counter() - begin), flush=True)


if __name__ == "__main__":
    main()
