"""How well networks explain real ECGs, with the speed constant α learnt and fixed.

    python -m benchmarks.fits --data DATA_FOLDER
                              [--only demo|ludb24|dti004|dti004-body|dti004-standard|
                                      dti004-unbounded]
                              [--seeds 1] [--steps 300] [--refine 200] [--alpha free|fixed]

Fits without a population. Printed for each heart and ECG are the lowest loss (mV²) after the 250
points of the Latin hypercube, after the steps of the optimisation and after the refinement, the
mismatch of a flat line, the share of the best network's ECG that lies under the recorded QRS, and
what it has learnt of α.

- demo: the packaged heart and the ECG that comes with pydicom;
- ludb24: the packaged heart and LUDB's left bundle branch block;
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
from pathlib import Path
from typing import Any, NamedTuple

import fascicle
from fascicle.build.anatomy import Source
from fascicle.build.body import Body
from fascicle.build.build_heart import build_heart
from fascicle.cli.demo import demo_recording
from fascicle.cli.terminal_progress import TerminalProgress
from fascicle.heart.folder import write_heart
from fascicle.heart.heart import Heart
from fascicle.recording.choices import Choices
from fascicle.recording.corrections import DIGITS_PER_MILLIVOLT, share_gain
from fascicle.recording.pipeline import analyse
from fascicle.recording.readers.read import read_recording
from fascicle.recording.target import Target
from fascicle.study.evaluations import Stage
from fascicle.study.results import FittedStudy

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
        surrounding = Body(electrodes=files / "electrodes.csv")
        if name == "dti004-standard":
            surrounding = Body(pose="lps")
        if name == "dti004-unbounded":
            surrounding = Body("none", electrodes=files / "electrodes.csv")
        source = Source(file=files / "mesh.vtu", parts={})
        with TerminalProgress() as progress:
            built = build_heart(source, body=surrounding, name=name, progress=progress)
        write_heart(built.heart, folder)
    return fascicle.load_heart(folder)


def demo_target(data: Path) -> Target:
    return analyse(read_recording(demo_recording())).target


def ludb24_target(data: Path) -> Target:
    recording = read_recording(data / "ecg" / "ludb" / "24.hea")
    return analyse(share_gain(recording, DIGITS_PER_MILLIVOLT)).target


def dti004_target(data: Path) -> Target:
    file = data / "hearts" / "dti004" / "ecg_beat.csv"
    return analyse(read_recording(file, unit="uV"), Choices(noise=DTI_NOISE)).target


CASES = {
    "demo": Case(packaged, demo_target, {}),
    "ludb24": Case(packaged, ludb24_target, {}),
    "dti004": Case(dti004, dti004_target, {}),
    "dti004-body": Case(dti004, dti004_target, {}, {"pose": "free", "electrodes": "free"}),
    "dti004-standard": Case(partial(dti004, name="dti004-standard"), dti004_target, {}),
    "dti004-unbounded": Case(
        partial(dti004, name="dti004-unbounded"), dti004_target, {"free_gain": True}
    ),
}


def row(name: str, alpha: str, seed: int, fitted: FittedStudy, seconds: float) -> str:
    """One line of the table."""
    records = fitted.study.records()

    def lowest(*stages: Stage) -> float:
        return min(
            r.evaluation.loss for r in records if r.stage in stages and r.evaluation.feasible
        )

    first = lowest(Stage.INITIAL)
    then = lowest(Stage.INITIAL, Stage.OPTIMISATION)
    best = fitted.best_network
    learnt = best.parameters.get("alpha", fitted.problem.model.conduction.alpha)
    return (
        f"{name:<17} {alpha:<6} {seed:4d} {fitted.problem.flat:6.2f} {first:8.3f} {then:8.3f} "
        f"{fitted.population.best_loss:8.3f} {best.under_qrs:9.2f} {learnt:7.3f} {seconds:6.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("fits"))
    parser.add_argument("--only", choices=list(CASES), action="append")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--refine", type=int, default=200)
    parser.add_argument("--alpha", choices=["free", "fixed"], action="append")
    given = parser.parse_args()
    print(
        f"{'':<17} {'alpha':<6} {'seed':>4} {'flat':>6} {'250':>8} {f'+{given.steps}':>8} "
        f"{'refined':>8} {'under QRS':>9} {'alpha':>7} {'s':>6}"
    )
    for name in given.only or CASES:
        case = CASES[name]
        heart, target = case.heart(given.data, given.out), case.target(given.data)
        for alpha in given.alpha or ("fixed", "free"):
            parameters = {
                "alpha": "free" if alpha == "free" else fascicle.Conduction().alpha,
                **case.parameters,
            }
            for seed in range(given.seeds):
                begin = time.perf_counter()
                fitted = fascicle.fit(
                    heart, target, given.out / f"{name}-{alpha}-{seed}", parameters=parameters,
                    steps=given.steps, refine=given.refine, seed=seed, samples=1, draws=1000,
                    rounds=1, **case.settings,
                )  # fmt: skip
                seconds = time.perf_counter() - begin
                print(row(name, alpha, seed, fitted, seconds), flush=True)


if __name__ == "__main__":
    main()
