"""Errors of the detected ends of the QRS, and whether they are foreseen.

    python -m benchmarks.qrs_window [--hearts 60]

Truth is the first and the last activation in ECGs simulated on the packaged heart with random
networks, some slowed to wide QRS complexes. P and T waves and an ST segment are added: smooth
dipoles, the P wave up to the QRS (PR from 80 ms), the T wave from about the J point on. The beats
differ by noise (white, muscle, or falling with frequency), by 3 % in size and by ±1 ms. The
signal-to-noise ratio is that of one beat: mean square of the QRS over that of the noise.

Printed are the median and the standard deviation of found minus true (ms; an early onset is
negative), the same for the baseline, a plain threshold on the spatial velocity (2 % and 5 % of its
maximum, or twice its lower quartile), and the ratio of the two standard deviations; then for how
many beats the truth is within two of the standard deviations that `window_uncertainty` gives. The
lines with a rhythm do the same with recordings of `synthetic_recording`, whose QRS begins and ends
with a power of time. The figure, docs/figures/qrs_window_error.png, shows errors against noise. Run
from the root of the repository.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

import fascicle
from benchmarks.synthetic_recordings.rhythms import Synthesis, synthetic_recording
from fascicle.core.leads import INDEPENDENT_ROWS, lead_matrix
from fascicle.forward.beat import Beat
from fascicle.recording.filters import resample
from fascicle.recording.window import qrs_window, spatial_velocity, window_uncertainty

Array = NDArray[np.float64]

FIGURE = Path("docs/figures/qrs_window_error.png")
RATIOS = (5, 10, 15, 20, 25, 30)  # dB
COUNTS = (1, 10, 40)  # beats
BEFORE, LENGTH = 280, 760  # ms
LARGEST_DRAWN = 40  # ms
SLOWED = (1.0, 1.0, 1.3, 1.5)  # how much longer the QRS may be made
# Rough directions (left, up, front) from which the nine electrodes look at the heart.
SIGHT = np.array(
    [
        [-1, 1, 0.1, -0.25, 0.15, 0.45, 0.75, 1, 1.1],
        [0.9, 0.9, -1.2, 0.2, 0.2, 0, -0.2, -0.2, -0.2],
        [-0.1, -0.1, 0, 1, 1.05, 1, 0.85, 0.5, 0],
    ]
).T


@dataclass(frozen=True)
class Case:
    """Beats (n_beats, 12, n) mV every ms, and where the QRS truly is (samples)."""

    beats: Array
    onset: float
    offset: float


def simulations(rng: np.random.Generator, count: int) -> list[Beat]:
    """QRS complexes of random networks; those that do not fit are drawn again."""
    model = fascicle.ForwardModel(fascicle.load_heart("default"))
    complexes: list[Beat] = []
    while len(complexes) < count:
        parameters = {
            name: value * (1 + 0.08 * rng.standard_normal()) if "length" in name else value
            for name, value in fascicle.EXAMPLE_PARAMETERS.items()
        }
        parameters |= {"root_time": rng.uniform(-70, 50), "cv": rng.uniform(2, 4)}
        outcome = model.simulate(parameters)
        if isinstance(outcome, Beat):
            complexes.append(outcome)
    return complexes


def dipole(vector: Array) -> Array:
    """Leads (12, 1), mV, of a heart vector (left, up, front)."""
    return np.asarray(lead_matrix() @ SIGHT @ vector)[:, None]


def whole_beat(rng: np.random.Generator, qrs: Beat) -> tuple[Array, float]:
    """Beat (12, LENGTH) with P, ST and T whose QRS begins at `BEFORE`, and its duration (ms)."""
    reached = qrs.activation[np.isfinite(qrs.activation)]
    slowed = rng.choice(SLOWED)
    t = np.arange(LENGTH) - float(BEFORE)
    at = reached.min() - qrs.onset + t / slowed
    samples = np.arange(qrs.leads.shape[1])
    beat = np.array([np.interp(at, samples, lead, left=0) for lead in qrs.leads])
    duration = float(np.ptp(reached) * slowed)
    pr = rng.choice([80.0, rng.uniform(110, 200)], p=[0.2, 0.8])
    p_length = min(rng.uniform(80, 110), pr)
    p_phase = np.clip((t + pr) / p_length, 0, 1)
    beat += dipole(rng.normal([0.05, -0.08, 0.01], 0.02)) * np.sin(np.pi * p_phase) ** 2
    rise, fall = rng.uniform(130, 220), rng.uniform(80, 120)
    top = duration + rise - rng.uniform(-10, 30)
    down = np.cos(np.pi / 2 * np.clip((t - top) / fall, 0, 1)) ** 2
    up = np.cos(np.pi / 2 * np.clip((top - t) / rise, 0, 1)) ** 2.5
    beat += dipole(rng.normal([0.1, -0.1, -0.1], 0.1)) * up * down
    st = np.clip(t / duration, 0, 1) ** 2 * (3 - 2 * np.clip(t / duration, 0, 1))
    beat += dipole(rng.normal(0, rng.choice([0, 0.03, 0.1]), 3)) * st * down
    return beat, duration


def noise(rng: np.random.Generator, count: int) -> Array:
    """Noise (count, 12, LENGTH) of the electrodes, root mean square 1 in the independent leads."""
    frequency = np.fft.rfftfreq(LENGTH, 1e-3)
    muscle = ((frequency > 20) & (frequency < 150)).astype(float)
    pink = 1 / np.sqrt(np.maximum(frequency, 1))
    shape = (np.ones_like(frequency), muscle, pink)[rng.integers(3)]
    spectrum = np.fft.rfft(rng.standard_normal((count, 9, LENGTH))) * shape
    leads = lead_matrix() @ np.fft.irfft(spectrum, LENGTH)
    return np.asarray(leads / leads[:, INDEPENDENT_ROWS].std())


def simulated(rng: np.random.Generator, qrs: Beat, ratio: float, count: int) -> Case:
    beat, duration = whole_beat(rng, qrs)
    inside = beat[INDEPENDENT_ROWS, BEFORE : BEFORE + round(duration)]
    level = np.sqrt(np.mean(inside**2)) * 10 ** (-ratio / 20)
    sizes = 1 + 0.03 * rng.standard_normal((count, 1, 1))
    moved = [np.roll(beat, rng.integers(-1, 2), axis=1) for _ in range(count)]
    beats = sizes * np.stack(moved) + level * noise(rng, count)
    return Case(beats, BEFORE, BEFORE + duration)


def synthetic(rng: np.random.Generator, rhythm: str, ratio: float) -> Case | None:
    """Beats of a synthetic recording, laid on each other at their true R peaks; None if too few."""
    kind = "blocked" if rhythm == "blocked" else "normal"
    recording, truth = synthetic_recording(
        rng, Synthesis(rhythm=rhythm, noise_db=ratio, noise=("white", "muscle"))
    )
    signal = resample(recording.signal, recording.sampling_rate)
    r = np.round(1000 * truth.r_times).astype(int)
    whole = (r >= BEFORE) & (r + LENGTH - BEFORE <= signal.shape[1])
    kept = np.flatnonzero(whole & (np.array(truth.kinds) == kind))
    if len(kept) < 2:
        return None
    beats = np.stack([signal[:, p - BEFORE : p - BEFORE + LENGTH] for p in r[kept]])
    ends = (1000 * np.stack([truth.onsets, truth.offsets]) - r + BEFORE)[:, kept]
    return Case(beats, *ends.mean(axis=1))


def plain(signal: Array) -> tuple[int, int]:
    """Baseline: outward from the fastest instant until the leads are slow for 10 ms."""
    speed = spatial_velocity(signal)
    floor = 2 * float(np.quantile(speed, 0.25))
    top, quiet = int(np.argmax(speed)), 10
    ends = []
    for outward, level in ((speed[top::-1], 0.02), (speed[top:], 0.05)):
        padded = np.append(outward, np.zeros(quiet)) > max(level * speed[top], floor)
        moving = np.lib.stride_tricks.sliding_window_view(padded, quiet).any(axis=1)
        ends.append(min(int(np.argmin(moving)), len(outward) - 1))
    return top - ends[0], top + ends[1]


def errors(cases: Sequence[Case], windows: Sequence[tuple[int, int]]) -> Array:
    """Detected minus true ends (ms), shape (n, 2)."""
    return np.array(windows) - [(case.onset, case.offset) for case in cases]


def within(cases: Sequence[Case], off: Array) -> Array:
    """Share of the cases whose error is at most two of the foreseen standard deviations."""
    foreseen = np.array([window_uncertainty(case.beats) for case in cases])
    return np.asarray((np.abs(off) <= 2 * foreseen).mean(axis=0))


def report(label: str, cases: Sequence[Case], foresee: bool) -> Array:
    """Print one line; give the errors (ms)."""
    means = [case.beats.mean(axis=0) for case in cases]
    off = errors(cases, [qrs_window(mean) for mean in means])
    old = errors(cases, [plain(mean) for mean in means])
    print(f"{label:<20}", end="")
    for end in (0, 1):
        sd, plain_sd = off[:, end].std(), old[:, end].std()
        print(
            f"{np.median(off[:, end]):6.1f} ±{sd:5.1f} "
            f"({np.median(old[:, end]):6.1f} ±{plain_sd:5.1f}, {sd / plain_sd:4.2f})",
            end="  ",
        )
    shares = within(cases, off) if foresee else None
    print("" if shares is None else f"{shares[0]:7.0%}{shares[1]:6.0%}", flush=True)
    return off


def draw(by_count: dict[int, list[Array]]) -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
    for end, (axis, name, true) in enumerate(
        zip(axes, ("onset", "offset"), ("first", "last"), strict=True)
    ):
        for count, off in by_count.items():
            low, middle, high = np.array([np.percentile(e[:, end], (5, 50, 95)) for e in off]).T
            (line,) = axis.plot(RATIOS, middle, "o-", label=f"{count} beat{'s' * (count > 1)}")
            axis.fill_between(RATIOS, low, high, color=line.get_color(), alpha=0.15)
        axis.axhline(0, color="black", linewidth=0.8)
        axis.set_xlabel("signal-to-noise ratio of one beat (dB)")
        axis.set_ylabel(f"found {name} minus {true} activation (ms)")
        axis.set_title(f"QRS {name}: median, 5 % to 95 %")
        axis.tick_params(labelleft=True)
        axis.grid(alpha=0.3)
    axes[0].set_ylim(-LARGEST_DRAWN, LARGEST_DRAWN)
    axes[0].legend(frameon=False)
    figure.savefig(FIGURE, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hearts", type=int, default=60, help="random networks (default 60)")
    count = parser.parse_args().hearts
    rng = np.random.default_rng(0)
    complexes = simulations(rng, count)
    print(f"{'':<20}{'onset, ms (plain, ratio)':<36}{'offset, ms (plain, ratio)':<36}within 2 SD")
    by_count: dict[int, list[Array]] = {beats: [] for beats in COUNTS}
    for beats in COUNTS:
        for ratio in RATIOS:
            cases = [simulated(rng, qrs, ratio, beats) for qrs in complexes]
            off = report(f"{ratio} dB, {beats} beats", cases, foresee=beats == 10)
            by_count[beats].append(off)
    for rhythm in ("sinus", "blocked"):
        for ratio in RATIOS[1::2]:
            drawn = [synthetic(rng, rhythm, ratio) for _ in range(count)]
            cases = [case for case in drawn if case is not None]
            report(f"{rhythm}, {ratio} dB", cases, foresee=True)
    draw(by_count)


if __name__ == "__main__":
    main()
