"""Leads that were recorded and not fitted: Frank's, predicted by networks fitted to the twelve.

    python -m benchmarks.frank_leads RECORDING OUT [--heart HEART] [--effective 300]

RECORDING holds the twelve leads and Frank's X, Y and Z, as those of the PTB database do. The heart,
by default the packaged one in its idealised torso, is given Frank's electrodes at their standard
places. Networks are fitted to the twelve leads alone; then their mean ECG is compared with the
recorded mean beat in every lead, within the QRS window. The baseline for Frank's leads is Kors'
regression (`fascicle.prediction.indices.vectorcardiogram`) of the recorded twelve, which knows
the patient's electrodes but no heart. Printed are correlation and variance explained.

Heart, prior simulations and study are kept in OUT, so an interrupted run goes on where it stopped.
Run from the root of the repository; it takes some ten minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import fascicle
from fascicle.build.build_heart import add_electrodes
from fascicle.core.leads import FRANK, LEADS
from fascicle.heart.folder import write_heart
from fascicle.networks.agreement import agreement, pearson
from fascicle.prediction.indices import vectorcardiogram
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import read_recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--heart", default="default")
    parser.add_argument("--effective", type=int, default=300)
    arguments = parser.parse_args()
    folder = arguments.out / "heart"
    if not (folder / "heart.toml").exists():
        write_heart(add_electrodes(arguments.heart, [*FRANK]), folder)
    heart = fascicle.load_heart(folder)
    whole = make_target(read_recording(arguments.recording)).in_leads(heart.leads)
    twelve = make_target(read_recording(arguments.recording, leads=LEADS))
    fitted = fascicle.fit(
        heart, twelve, arguments.out / "study", effective=arguments.effective,
        parameters={"conduction": "normal"},
    )  # fmt: skip
    agreed = agreement(whole, fitted.networks())
    print(fitted.verdict)
    regressed = vectorcardiogram(whole.qrs[: len(LEADS)])
    print(f"{'lead':<6}{'':<11}{'r':>7}{'explained':>11}{'Kors, r':>10}{'explained':>11}")
    for row, lead in enumerate(agreed.leads):
        kind = "predicted" if lead in FRANK else "fitted"
        line = f"{lead:<6}{kind:<11}{agreed.correlation[row]:7.2f}{agreed.explained[row]:11.0%}"
        if lead in FRANK:
            recorded, other = whole.qrs[row], regressed[[*FRANK].index(lead)]
            explained = 1 - ((recorded - other) ** 2).sum() / (recorded**2).sum()
            line += f"{pearson(recorded, other):10.2f}{explained:11.0%}"
        print(line)
    missed = [1 - np.mean(part) for part in np.split(agreed.explained, [len(LEADS)])]
    print(f"variance unexplained, Frank's leads over the twelve: {missed[1] / missed[0]:.2f}")


if __name__ == "__main__":
    main()
