"""Ends of the QRS against true ones in synthetic recordings of every width and kind.

    python -m benchmarks.qrs_marks [--held-out] [--count 200]

Each case is a 10 s recording of one kind of QRS, 70 to 200 ms wide. Half of them are simulated on
the packaged heart: random networks, some with a bundle branch or fascicle blocked, paced from the
right ventricle or ectopic, stretched in time as by slow conduction. The others are sums of humps
that begin and end with a power of time: normal, blocked, ectopic, pre-excited (a delta wave, the P
wave running into it), infarcted (low amplitudes). They have P and Ta waves, ST segments and T
waves; noise (white, muscle, power-line interference, drift, f-waves); pacing spikes with a tail; a
low-pass, a sampling rate of 250 to 1000 Hz and digits of 1 to 5 uV.

Truth is the first and the last instant at which the QRS alone, as the recorder passes it, is
`VISIBLE` (mV) from zero in any lead, or the standard deviation of the noise where that is more, and
not before a pacing spike. The constants of `fascicle.recording.window` were tuned on seeds from
`TUNING` on; `--held-out` takes those from `HELD_OUT` on, which took no part in it.

Printed are the mean and standard deviation of found less true (ms); errors of the duration of over
20 ms, missed and false durations of 120 ms or more, all three among 200; and for how many the truth
is within two of the standard deviations that the target states. The baseline is the plain threshold
of `benchmarks.qrs_window` on the same mean beats.
"""

from __future__ import annotations

import argparse
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import fascicle
from benchmarks.qrs_window import plain
from benchmarks.synthetic_recordings.artefacts import NOISES, SIGHT, f_waves, pulses
from benchmarks.synthetic_recordings.rhythms import hump
from fascicle.core.errors import InputError
from fascicle.core.leads import lead_matrix
from fascicle.forward.beat import Beat
from fascicle.forward.scenario_files import find_scenario, read_scenario
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.recording import Recording

Array = NDArray[np.float64]

VISIBLE = 0.02  # mV
TUNING, HELD_OUT = (0, 100_000, 200_000), (400_000,)  # first seeds
RATE = 1000  # Hz, at which recordings are made
SECONDS = 10
BEFORE, AFTER = 60, 340  # ms about the begin of a QRS in which it is
PACED = ("rv-apical-pacing", "rv-outflow-pacing")
SIMULATED = (
    *4 * ("intrinsic",), *2 * ("left-anterior-fascicular-block",), "left-bundle-branch-block",
    "right-bundle-branch-block", "pvc-rv-outflow", *PACED,
)  # fmt: skip
SHAPED = (
    *5 * ("normal",), *2 * ("infarct",), "left block", "right block", "ectopic", "delta", "paced",
)  # fmt: skip
# Directions (left, down, forward) of the humps of a QRS, one after the other
DIRECTIONS = {
    "normal": ((-0.3, -0.1, 0.4), (1.0, 0.8, -0.3), (0.1, 0.1, -0.7), (-0.2, -0.3, -0.2)),
    "left block": ((0.2, 0.1, 0.2), (0.7, 0.4, -0.6), (0.9, 0.3, -0.6), (0.6, 0.1, -0.4)),
    "right block": ((-0.3, -0.1, 0.4), (1.0, 0.8, -0.3), (-0.2, 0.1, 0.2), (-0.6, -0.1, 0.6)),
    "infarct": ((-0.3, -0.5, -0.4), (0.6, 0.3, 0.1), (0.2, 0.3, -0.4), (0.1, 0.2, 0.2)),
}


@dataclass(frozen=True)
class Case:
    """A recording, and where its QRS complexes truly are."""

    recording: Recording
    kind: str
    begins: Array  # (n_beats,) ms from the start; the QRS template begins there
    onset: float  # ms, truth less `begins`
    offset: float


@functools.cache
def _model() -> fascicle.ForwardModel:
    return fascicle.ForwardModel(fascicle.load_heart("default"))


def _simulated(rng: np.random.Generator, kind: str) -> tuple[Array, float]:
    """QRS leads (12, n) mV of a random network, every ms, and their time scale."""
    scenario = read_scenario(find_scenario(kind))[0]
    while True:
        parameters = {
            name: value * (1 + 0.08 * rng.standard_normal()) if "length" in name else value
            for name, value in fascicle.EXAMPLE_PARAMETERS.items()
        }
        parameters |= {"root_time": rng.uniform(-40, 30), "cv": rng.uniform(2, 4)}
        outcome = _model().simulate(parameters, scenario)
        if isinstance(outcome, Beat):
            first = max(int(outcome.activation.min() - outcome.onset) - 5, 0)
            return outcome.leads[:, first:], rng.uniform(0.7, 1.3)


def _rotated(rng: np.random.Generator, vectors: Array, spread: float) -> Array:
    """Vectors (k, 3) after a random rotation, of roughly `spread` rad."""
    turn, _ = np.linalg.qr(np.eye(3) + spread * rng.standard_normal((3, 3)))
    return np.asarray(vectors @ (turn * np.sign(np.diag(turn))))


def _shaped(rng: np.random.Generator, kind: str) -> Array:
    """QRS leads (12, n) mV of humps, every ms; a delta wave, where there is one, is the first."""
    wide = kind in ("left block", "right block", "ectopic", "paced")
    length = rng.uniform(115, 200) if wide else rng.uniform(70, 120)
    base = DIRECTIONS.get(kind, DIRECTIONS["left block" if wide else "normal"])
    vectors = np.array(base) * rng.lognormal(0, 0.35, (len(base), 1))
    vectors = _rotated(rng, vectors, 1.5 if kind == "ectopic" else 0.3)
    potentials = vectors @ SIGHT.T + 0.12 * rng.standard_normal((len(base), len(SIGHT)))
    begin = np.array([0, *np.sort(rng.uniform(0.05, 0.5, len(base) - 1))])
    end = np.array([*np.sort(rng.uniform(0.45, 0.95, len(base) - 1)), 1])
    powers = rng.uniform(1.1, 3.5, (2, len(base)))  # how gently humps begin and end
    t = np.arange(-BEFORE, AFTER, dtype=float)
    leads = lead_matrix() @ sum(
        potential[:, None] * hump(t / length, *ends)
        for potential, *ends in zip(potentials, begin, end, *powers, strict=True)
    )
    if kind == "delta":
        early, size = rng.uniform(15, 50), rng.uniform(0.1, 0.4) * np.abs(leads).max()
        wave = hump(t, -early, rng.uniform(40, 90), rng.uniform(1.1, 1.8), 2.0)
        direction = SIGHT @ _rotated(rng, np.array([[0.7, 0.5, 0.3]]), 0.8)[0]
        leads += size * (lead_matrix() @ direction)[:, None] / np.abs(direction).max() * wave
    return np.asarray(leads)


def _qrs(rng: np.random.Generator, kind: str) -> Array:
    """QRS leads (12, BEFORE + AFTER) of a random height, which begin at `BEFORE` ms or before."""
    if kind in SIMULATED:
        leads, scale = _simulated(rng, kind)
        at = np.arange(-BEFORE, AFTER) / scale
        samples = np.arange(leads.shape[1])
        qrs = np.array([np.interp(at, samples, lead, left=0, right=0) for lead in leads])
    else:
        qrs = _shaped(rng, kind)
    low = kind == "infarct"
    return np.asarray(qrs * rng.uniform(*((0.4, 1.2) if low else (0.8, 3))) / np.abs(qrs).max())


def _slow_waves(
    rng: np.random.Generator, qrs: Array, ends: tuple[float, float], cycle: float
) -> Array:
    """P, Ta, ST and T waves (12, n) about a QRS that begins at the sample 400 of n, 1 ms each."""
    t = np.arange(-400.0, 700.0)
    onset, offset = ends
    size = 0.1 * rng.lognormal(0, 0.4)
    p_wave = (lead_matrix() @ SIGHT @ _rotated(rng, np.array([[0.5, 0.8, 0.2]]), 0.3)[0])[:, None]
    length, pr = (
        rng.uniform(80, 120),
        rng.uniform(*rng.choice([(85, 120), (120, 200)], p=(0.2, 0.8))),
    )
    start = onset - max(pr, length)
    waves = size * p_wave * hump(t, start, start + length, 2, 2)
    waves -= rng.uniform(0.05, 0.15) * size * p_wave * hump(t, start + 60, start + 360, 2, 2)
    # wide QRS complexes have T waves against them, and ST segments that lead there
    area = qrs.sum(axis=1) / np.abs(qrs.sum(axis=1)).max()
    discordant = np.clip((offset - onset - 90) / 50, 0, 1)
    side = (1 - 2 * discordant) * area[:, None]
    other = lead_matrix() @ SIGHT @ rng.normal(0, 0.3, 3)
    height = rng.uniform(0.1, 0.35) * np.abs(qrs).max()
    t_wave = height * (side + other[:, None])
    late = offset + rng.uniform(-20, 30)
    end = late + max(rng.uniform(0.42, 0.55) * np.sqrt(cycle / 1000) * 1000 - 120, 170)
    waves += t_wave * hump(t, late, end, rng.uniform(2, 3.5), rng.uniform(1.8, 2.5))
    rise = np.clip((t - onset) / (offset - onset), 0, 1) ** 2
    fall = np.clip((end - t) / 150, 0, 1)
    st = rng.choice([0.0, 0.03, 0.1]) * (side + lead_matrix() @ SIGHT @ rng.normal(0, 0.3, (3, 1)))
    return waves + st * rise**2 * (3 - 2 * rise) * np.minimum(fall, 1) ** 2


def _noise(rng: np.random.Generator, t: Array) -> tuple[Array, Array]:
    """Noise (12, n) (mV): the fast part, and drift with f-waves."""
    sizes = {
        "white": 0.002 * rng.lognormal(0, 0.7),
        "muscle": 0.005 * rng.lognormal(0, 1) * (rng.random() < 0.6),
        "mains": 0.004 * rng.lognormal(0, 1) * (rng.random() < 0.4),
    }
    made = {kind: NOISES[kind](rng, t) for kind in sizes}
    fast = sum(size * made[kind] / made[kind].std() for kind, size in sizes.items())
    slow = rng.uniform(0.02, 0.2) * NOISES["wander"](rng, t) / 2
    if rng.random() < 0.1:
        slow = slow + f_waves(rng, t)
    return lead_matrix() @ fast, lead_matrix() @ slow


def _recorder(rng: np.random.Generator) -> tuple[float, float, float | None]:
    """Sampling rate (Hz), digit (mV) and low-pass (Hz)."""
    rate = float(rng.choice([250.0, 500.0, 1000.0], p=(0.2, 0.5, 0.3)))
    cutoff = rng.choice([40.0, 100.0, 150.0, 0.0], p=(0.15, 0.2, 0.35, 0.3))
    return rate, float(rng.choice([0.001, 0.0025, 0.00488])), min(cutoff, 0.4 * rate) or None


def _passed(signal: Array, cutoff: float | None) -> Array:
    """Signal after a low-pass of second order (forward and backward)."""
    if cutoff is None:
        return signal
    return Filter(FilterKind.LOW_PASS, cutoff, FilterOrigin.STATED, 1, RATE).apply(signal)


def _marked(qrs: Array, noise: Array) -> tuple[float, float]:
    """Outermost ends (ms from `BEFORE`) of a QRS (12, n) that is seen in noise (12,) mV."""
    seen = np.abs(qrs) > np.maximum(VISIBLE, noise)[:, None]
    seen = seen[seen.any(axis=1)]
    ends = np.array([seen.argmax(axis=1), seen.shape[1] - 1 - seen[:, ::-1].argmax(axis=1)])
    return float(ends[0].min() - BEFORE), float(ends[1].max() - BEFORE)


def case(seed: int) -> Case:
    """Recording number `seed`: the same in every run."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(SIMULATED if seed % 2 else SHAPED))
    qrs = _qrs(rng, kind)
    rate, digit, cutoff = _recorder(rng)
    t = np.arange(SECONDS * RATE) / RATE
    fast, slow = (_passed(noise, cutoff) for noise in _noise(rng, t))
    cycle = rng.uniform(600, 1150)
    ends = _marked(_passed(qrs, cutoff), fast.std(axis=1))
    waves = _slow_waves(rng, qrs, ends, cycle)
    if kind in PACED or kind in ("paced", "ectopic", "pvc-rv-outflow"):
        waves[:, :400] = 0  # no P wave
    steps = cycle * (1 + 0.02 * rng.standard_normal(20))
    begins = np.round(np.cumsum(steps) - rng.uniform(0, 500))
    begins = begins[(begins > 450) & (begins < SECONDS * RATE - 750)]
    signal = np.zeros((12, len(t)))
    for begin in begins.astype(int):
        size = 1 + 0.03 * rng.standard_normal()
        signal[:, begin - 400 : begin + 700] += size * waves
        signal[:, begin - BEFORE : begin + AFTER] += size * qrs
    if kind in (*PACED, "paced"):
        latency = rng.uniform(4, 40)
        signal += _spikes(rng, t, (begins + ends[0] - latency) / RATE)
    signal = _passed(signal, cutoff) + fast + slow
    signal = np.round(signal[:, :: round(RATE / rate)] / digit) * digit
    return Case(Recording(signal, rate, f"synthetic {seed} ({kind})"), kind, begins, *ends)


def _spikes(rng: np.random.Generator, t: Array, times: Array) -> Array:
    """Spikes (12, n) mV at `times` (s), with a tail that decays exponentially."""
    spikes = lead_matrix() @ pulses(rng, t, times, rng.uniform(0.5, 5))
    share, decay = rng.choice([0.0, 0.03, 0.1]), rng.uniform(0.003, 0.03)
    kernel = np.exp(-np.arange(0, 0.2, 1 / RATE) / decay)
    peaks = spikes[:, np.round((times + 0.001) * RATE).astype(int)]
    tail = np.zeros_like(spikes)
    for time, peak in zip(np.round((times + 0.003) * RATE).astype(int), peaks.T, strict=True):
        tail[:, time : time + len(kernel)] += share * peak[:, None] * kernel
    return np.asarray(spikes + tail)


def marks(synthetic: Case) -> tuple[Array, Array, Array, Array]:
    """Detected, true and baseline ends (ms from R), and their stated SDs, each of shape (2,)."""
    analysis = fascicle.analyse(synthetic.recording)
    target = analysis.target
    used = 1000 * np.array([beat.time for beat in analysis.beats if beat.used])
    nearest = synthetic.begins[np.argmin(np.abs(used[:, None] - synthetic.begins - 60), axis=1)]
    begin = float(np.median(nearest - used))
    truth = begin + np.array([synthetic.onset, synthetic.offset])
    baseline = target.time[list(plain(target.mean))]
    return (
        np.array([target.qrs_onset, target.qrs_offset]), truth, baseline,
        np.array([target.onset_sd, target.offset_sd]),
    )  # fmt: skip


def report(label: str, detected: Array, truth: Array, stated: Array) -> None:
    """Print one line of (n, 2) arrays, ms."""
    off = detected - truth
    wide, called_wide = np.ptp(truth, axis=1) >= 120, np.ptp(detected, axis=1) >= 120
    off = np.column_stack([off, off[:, 1] - off[:, 0]])
    cells = "".join(f"{column.mean():7.1f} ±{column.std():5.1f}" for column in off.T)
    share = np.mean(np.abs(off[:, :2]) <= 2 * stated, axis=0)
    per = 200 / len(off)
    print(
        f"{label:<26}{len(off):>4}{cells}{np.mean(np.abs(off[:, 2]) > 20) * 200:6.0f}"
        f"{(wide & ~called_wide).sum() * per:7.0f}{(~wide & called_wide).sum() * per:6.0f}"
        f"{share[0]:7.0%}{share[1]:6.0%}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--held-out", action="store_true", help="seeds that tuned nothing")
    parser.add_argument("--count", type=int, default=200, help="from each first seed (200)")
    arguments = parser.parse_args()
    firsts = HELD_OUT if arguments.held_out else TUNING
    rows, kinds, refused = [], [], []
    for seed in (first + k for first in firsts for k in range(arguments.count)):
        synthetic = case(seed)
        try:
            rows.append(marks(synthetic))
            kinds.append(synthetic.kind)
        except InputError as error:
            refused.append(str(error))
    results = np.array(rows).transpose(1, 0, 2)
    print(
        f"{'':<30}{'onset, ms':>14}{'offset, ms':>14}{'duration, ms':>14}"
        "   >20 missed false  within 2 SD"
    )
    detected, truth, baseline, stated = results
    for kind in sorted(set(kinds)):
        of_kind = np.array(kinds) == kind
        report(kind, detected[of_kind], truth[of_kind], stated[of_kind])
    report("all", detected, truth, stated)
    report("baseline", baseline, truth, stated)
    print(f"refused: {len(refused)}", *refused, sep="\n  ")


if __name__ == "__main__":
    main()
