"""Change of a target by an interpolated gap, where it is longest and does most.

    python -m benchmarks.interpolated_gaps [--recordings 40] [--seed 50000]

In one lead of each synthetic recording the samples of 10 ms are lost, about the steepest place of a
QRS. Printed are the largest changes of the mean beat and of the QRS window, and how beats vary.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.synthetic_recordings.rhythms import Synthesis, synthetic_recording
from fascicle.core.leads import LEADS
from fascicle.recording.pipeline import make_target
from fascicle.recording.recording import bridge_gaps


def changes(seed: int) -> tuple[float, float, float]:
    """Largest change of the mean (mV) and of the window's ends (ms), and the SD of beats (mV)."""
    rng = np.random.default_rng(seed)
    recording, _ = synthetic_recording(rng, Synthesis(noise_db=25.0))
    before = make_target(recording)
    signal, row = recording.signal.copy(), int(rng.integers(6, 12))
    gap = 10.0  # ms; the longest that is interpolated
    margin, lost = 500, round(gap / 1000 * recording.sampling_rate)  # samples; no beat cut off
    steepest = margin + int(np.argmax(np.abs(np.diff(signal[row, margin:-margin]))))
    signal[row, steepest - lost // 2 :][:lost] = np.nan
    bridged, remarks = bridge_gaps(signal, recording.sampling_rate, LEADS, longest=gap)
    assert len(remarks) == 1
    after = make_target(replace(recording, signal=bridged))
    ends = (after.qrs_onset - before.qrs_onset, after.qrs_offset - before.qrs_offset)
    spread = before.standard_deviation[row, before.qrs_samples].max()
    return float(np.abs(after.mean - before.mean).max()), float(np.abs(ends).max()), float(spread)


def main() -> None:
    """Print the largest and the usual changes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--seed", type=int, default=50_000)
    options = parser.parse_args()
    rows = [changes(options.seed + k) for k in range(options.recordings)]
    for name, values in zip(("mean (mV)", "window (ms)", "SD (mV)"), np.array(rows).T, strict=True):
        print(f"{name:12} median {np.median(values):.3f}, largest {np.max(values):.3f}")


if __name__ == "__main__":
    main()
