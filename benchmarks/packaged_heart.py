"""Difference of the packaged subject's heart from the finer one that was published.

    python -m benchmarks.packaged_heart --data DATA_FOLDER --out FOLDER

Of networks of the prior on both hearts: difference of the ECGs in the norm over all leads and
times, relative to the finer heart's, beside that of two networks; difference of the total
activation times; time of a run.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import fascicle
from benchmarks.device import drawn
from benchmarks.fits import dti004
from fascicle.core.arrays import Floats
from fascicle.forward.beat import Beat

NETWORKS = 24
WINDOW = np.arange(-20.0, 220.0)  # ms


def on_window(beat: Beat) -> Floats:
    """ECG (12, t) at the same times for all (mV)."""
    return np.asarray(beat.ecg.interp(time=WINDOW, kwargs={"fill_value": 0.0}))


def apart(reference: Floats, other: Floats) -> float:
    return float(np.linalg.norm(reference - other) / np.linalg.norm(reference))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="where the finer heart is built")
    arguments = parser.parse_args()
    fine = fascicle.ForwardModel(dti004(arguments.data, arguments.out))
    coarse = fascicle.ForwardModel("camps-dti004")
    networks = drawn(NETWORKS, 3)
    pairs = [(fine.simulate(network), coarse.simulate(network)) for network in networks]
    beats = [
        (fine_beat, coarse_beat)
        for fine_beat, coarse_beat in pairs
        if isinstance(fine_beat, Beat) and isinstance(coarse_beat, Beat)
    ]
    ecgs = [(on_window(fine_beat), on_window(coarse_beat)) for fine_beat, coarse_beat in beats]
    between = [apart(a[0], b[0]) for k, a in enumerate(ecgs) for b in ecgs[:k]]
    print(f"{len(ecgs)} networks: ECGs differ by {np.median([apart(*pair) for pair in ecgs]):.0%}")
    print(f"ECGs of two networks differ by {np.median(between):.0%} (medians)")
    totals = [
        coarse_beat.total_activation_time - fine_beat.total_activation_time
        for fine_beat, coarse_beat in beats
    ]
    print(f"total activation time: {np.mean(totals):.1f} ± {np.std(totals):.1f} ms")
    begin = time.perf_counter()
    for network in networks:
        coarse.simulate({**network, "lv_initial_length": network["lv_initial_length"] + 0.01})
    print(f"a run takes {1e3 * (time.perf_counter() - begin) / len(networks):.1f} ms")


if __name__ == "__main__":
    main()
