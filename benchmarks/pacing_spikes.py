"""Pacing spikes found and missed in synthetic recordings, and found where there are none.

    python -m benchmarks.pacing_spikes [--recordings 540] [--seed 40000]

So many unpaced recordings and as many paced ones, each with one of the `DISTURBANCES`, of a quarter
of the size where it is paced. Printed are the unpaced recordings with a spike, and for each
disturbance the spikes found, missed and false. The limits of the method were chosen on other seeds.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfilt

from benchmarks.synthetic_recordings.artefacts import SIGHT
from benchmarks.synthetic_recordings.rhythms import Synthesis, synthetic_recording
from benchmarks.synthetic_recordings.schedules import RHYTHMS
from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import lead_matrix
from fascicle.recording.spikes import find_spikes

DISTURBANCES = ("clean", "digits", "hum", "hum digits", "muscle", "muscle digits", "edge")
UNPACED = sorted(set(RHYTHMS) - {"paced"})
# largest potential (mV) of the pulses, and ms from each ventricular one to the others of its beat
PACING: dict[str, tuple[float, tuple[float, ...]]] = {
    "small bipolar": (0.2, (0.0,)),
    "unipolar with a tail": (5.0, (0.0,)),
    "biventricular": (0.4, (-35.0, 0.0)),
    "atrial": (0.4, (-160.0,)),
    "atrial and biventricular": (1.0, (-190.0, -30.0, 0.0)),
}


def counts(spikes: Integers, times: Floats, rate: float) -> Integers:
    """Spikes found, missed, and marks that are none."""
    free = np.ones(len(spikes), dtype=bool)
    for time in times:
        begins, ends = spikes.T / rate
        here = np.flatnonzero(free & (begins <= time + 0.005) & (ends >= time))
        free[here[:1]] = False
    return np.array([(~free).sum(), len(times) - (~free).sum(), free.sum()])


def disturbed(
    rng: np.random.Generator, signal: Floats, rate: float, disturbance: str, size: float = 1.0
) -> Floats:
    """A signal (mV) with power-line interference, coarse digits, muscle noise, or a torn end."""
    t = np.arange(signal.shape[1]) / rate
    electrodes = np.zeros((9, len(t)))
    if "hum" in disturbance:
        turns = 2 * np.pi * rng.choice([49.9, 50.0, 60.0]) * t
        for harmonic in range(1, int(rng.integers(2, 7))):
            phase = rng.uniform(0, 2 * np.pi) + rng.uniform(-0.3, 0.3, (9, 1))
            electrodes += rng.uniform(0.1, 1, (9, 1)) / harmonic * np.sin(harmonic * turns + phase)
        electrodes *= size * rng.uniform(0.02, 0.5) / np.abs(electrodes).max()
    if "muscle" in disturbance:
        band = butter(2, (20, min(200, 0.45 * rate)), "bandpass", fs=rate, output="sos")
        noise = sosfilt(band, rng.standard_normal(electrodes.shape), axis=-1)
        electrodes += size * rng.uniform(0.01, 0.1) * noise / noise.std()
    signal = signal + lead_matrix() @ electrodes
    if disturbance == "edge":
        last = int(rng.integers(1, int(2 + 0.012 * rate)))
        torn = rng.uniform(-3, 3, (12, 1)) * rng.choice([np.linspace(0, 1, last), np.ones(last)])
        signal[:, -last:] += torn
        signal[:, :last] += torn[:, ::-1]
    digit = rng.choice([0.005, 0.01, 0.02]) if "digits" in disturbance else 0.001  # mV
    return np.asarray(digit * np.round(signal / digit))


def paced(seed: int, pacing: str, rate: float) -> tuple[np.random.Generator, Floats, Floats]:
    """A paced rhythm, its pulses added here behind a low-pass of 150 Hz, and their times (s)."""
    rng = np.random.default_rng(seed)
    synthesis = Synthesis(rhythm="paced", rate=rate, spike_size=1e-9)
    recording, truth = synthetic_recording(rng, synthesis)
    size, delays = PACING[pacing]
    signal, times = recording.signal.copy(), []
    fine = np.arange(-0.1, 0.1, 1e-5)
    for delay in delays:
        lead = lead_matrix() @ SIGHT @ rng.standard_normal(3)
        pulse = ((fine >= 0) & (fine < 0.001)).astype(float)
        if "tail" in pacing:
            pulse += rng.choice([-0.1, 0.1]) * (fine >= 0.001) * np.exp(-(fine - 0.001) / 0.01)
        pulse = gaussian_filter1d(pulse, np.sqrt(np.log(2)) / (2 * np.pi * 150.0) / 1e-5)
        for time in truth.onsets - rng.uniform(0.005, 0.02) + delay / 1000:
            if 0.05 < time < recording.duration - 0.05:
                at = np.interp(np.arange(signal.shape[1]) / rate - time, fine, pulse, 0, 0)
                signal += (size / np.abs(lead).max() * lead)[:, None] * at / np.abs(at).max()
                times.append(time)
    return rng, signal, np.sort(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=540)
    parser.add_argument("--seed", type=int, default=40_000)
    arguments = parser.parse_args()
    rates, invented = (250.0, 500.0, 800.0, 1000.0), 0
    totals = {disturbance: np.zeros(3, dtype=np.int64) for disturbance in DISTURBANCES}
    for k in range(arguments.recordings):
        seed, rate = arguments.seed + k, rates[k % len(rates)]
        disturbance = DISTURBANCES[k % len(DISTURBANCES)]
        rng = np.random.default_rng([seed, int(rate)])
        synthesis = Synthesis(rhythm=UNPACED[k % len(UNPACED)], rate=rate)
        recording, _ = synthetic_recording(rng, synthesis)
        invented += len(find_spikes(disturbed(rng, recording.signal, rate, disturbance), rate)) > 0
        rng, signal, times = paced(seed, [*PACING][k % len(PACING)], rate)
        signal = disturbed(rng, signal, rate, disturbance, size=0.25)
        totals[disturbance] += counts(find_spikes(signal, rate), times, rate)
    print(f"unpaced: {invented} of {arguments.recordings} recordings with a spike")
    for disturbance, count in [*totals.items(), ("all", np.sum([*totals.values()], axis=0))]:
        print(f"paced, {disturbance:<16} {count[0]} found, {count[1]} missed, {count[2]} false")


if __name__ == "__main__":
    main()
