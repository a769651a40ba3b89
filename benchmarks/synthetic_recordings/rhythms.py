"""Synthetic recordings in every rhythm; beats, QRS ends and pacing spikes are known exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic_recordings.artefacts import NOISES, SIGHT, f_waves, pulses, samples
from benchmarks.synthetic_recordings.schedules import MARGIN, RHYTHMS
from fascicle.core.leads import ELECTRODES, INDEPENDENT_ROWS, lead_matrix
from fascicle.recording.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """Contents of a synthetic recording, known exactly.

    Attributes
    ----------
    r_times : (n_beats,) array
        Times (s) at which the root mean square of the eight independent leads of each QRS is
        largest.
    onsets, offsets : (n_beats,) array
        First and last instant (s) of each QRS, exact: beyond them the QRS is zero in all leads.
    kinds : tuple of str
        ``normal``, ``ectopic``, ``paced``, ``blocked`` or ``aberrant`` for each beat.
    spikes : (k,) array
        Times (s) at which pacing pulses begin.
    clean : (12, n) array
        The recording without its noise (mV): QRS, P, T, f-waves, spikes, respiration.
    """

    r_times: Array
    onsets: Array
    offsets: Array
    kinds: tuple[str, ...]
    spikes: Array
    clean: Array


def hump(t: Array, start: float, end: float, rise: float, fall: float) -> Array:
    r"""Hump :math:`u^a (1-u)^b` of height 1 between `start` and `end`, zero outside.

    The powers `rise` a and `fall` b are above 1; the higher, the more gently it begins or ends.
    """
    u = np.clip((t - start) / (end - start), 0, 1)
    top = rise / (rise + fall)
    return np.asarray((u / top) ** rise * ((1 - u) / (1 - top)) ** fall)


@dataclass(frozen=True)
class _Shape:
    """Shape of a kind of beat: humps of its QRS (in shares of its length), its T and its P wave."""

    length: float  # s
    humps: tuple[tuple[float, float, float, float], ...]
    potentials: Array  # (humps, 9), mV
    t_wave: Array  # (9,), mV
    p_wave: Array  # (9,), mV
    p_gap: float  # s between the P wave and the QRS

    def qrs(self, share: Array) -> Array:
        """Electrode potentials (9, m), mV; zero where `share` is outside 0 to 1."""
        humps = np.array([hump(share, *ends) for ends in self.humps])
        return np.asarray(self.potentials.T @ humps)

    def top(self) -> float:
        """Share of the QRS at which the root mean square of the leads is largest."""
        share = np.linspace(0, 1, 1001)
        power = np.sum((_independent() @ self.qrs(share)) ** 2, axis=0)
        return float(share[np.argmax(power)])


@dataclass(frozen=True)
class Synthesis:
    """Choices by which a synthetic recording is made.

    Attributes
    ----------
    rhythm : str
        One of `RHYTHMS`.
    rate : float
        Samples per second (Hz).
    seconds : float
        Length (s).
    noise_db : float, optional
        Signal-to-noise ratio (dB): mean square of the clean QRS complexes over the mean square of
        the noise of the whole recording, both averaged over the eight independent leads. None is
        no noise.
    noise : sequence of str
        Kinds of noise, of `NOISES`, with equal power each. Noise arises at the electrodes, so that
        it obeys Einthoven's law.
    heart_rate : float, optional
        Beats per minute; by default random between 50 and 110.
    height : float, optional
        Largest deflection of the usual beats' QRS in any lead (mV); by default random from 0.8 to
        3.
    tall_t : float
        Factor of the T waves; 3 makes them about as tall as the QRS.
    spike_size : float, optional
        Largest deflection of the pacing spikes in any lead (mV), as recorded; by default random:
        0.5 to 3 as from bipolar leads, or 5 to 40 as from unipolar ones.
    beat_spread : float
        Relative standard deviation of the beats' size; their width varies half as much.
    respiration : float
        Amplitude (mV) of the drift by respiration; the beats' size follows it by 5 % at 0.1.
    """

    rhythm: str = "sinus"
    rate: float = 500.0
    seconds: float = 10.0
    noise_db: float | None = None
    noise: Sequence[str] = ("white",)
    heart_rate: float | None = None
    height: float | None = None
    tall_t: float = 1.0
    spike_size: float | None = None
    beat_spread: float = 0.03
    respiration: float = 0.1


def synthetic_recording(
    rng: np.random.Generator, made_of: Synthesis | None = None
) -> tuple[Recording, Truth]:
    """Twelve leads of a random heart in a given rhythm.

    Each kind of beat has one random shape, the same in every beat but for its size and width. No
    QRS is cut by the ends of the recording.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of everything that is random.
    made_of : Synthesis, optional
        Rhythm, length, noise and the like; by default 10 s of sinus rhythm without noise.

    Returns
    -------
    recording, truth
        The recording and what it consists of.

    Raises
    ------
    ValueError
        When noise is wanted and no beat falls into the recording.
    """
    options = made_of if made_of is not None else Synthesis()
    pulse = 60 / (options.heart_rate if options.heart_rate is not None else rng.uniform(50, 110))
    times, kinds = RHYTHMS[options.rhythm](rng, pulse, options.seconds + MARGIN)
    goal = options.height if options.height is not None else rng.uniform(0.8, 3)
    shapes = {kind: _shape(rng, kind, goal, options.tall_t) for kind in sorted(set(kinds))}
    if options.rhythm == "fibrillation":
        shapes = {kind: replace(shape, p_wave=np.zeros(9)) for kind, shape in shapes.items()}
    t = np.arange(round(options.seconds * options.rate)) / options.rate
    breath = np.sin(2 * np.pi * (rng.uniform(0.15, 0.4) * t + rng.random()))
    swing = 1 + options.respiration / 2 * breath
    qrs, waves, marks = _beats(rng, t, times, kinds, shapes, options.beat_spread)
    potentials = swing * (qrs + waves) + options.respiration * rng.uniform(-1, 1, (9, 1)) * breath
    if options.rhythm == "fibrillation":
        potentials += f_waves(rng, t)
    spikes = _spike_times(rng, marks[1]) if options.rhythm == "paced" else np.empty(0)
    spikes = spikes[(spikes >= 0) & (spikes < t[-1])]
    potentials += pulses(rng, t, spikes, options.spike_size)
    truth = Truth(*marks, spikes, lead_matrix() @ potentials)
    if options.noise_db is not None:
        total = np.sum([_unit(NOISES[kind](rng, t)) for kind in options.noise], axis=0)
        inside = (qrs != 0).any(axis=0)
        if not inside.any():
            raise ValueError(
                f"no beat in {options.seconds:g} s: noise has nothing to be compared with"
            )
        ratio = _power((swing * qrs)[:, inside]) / 10 ** (options.noise_db / 10)
        potentials += np.sqrt(ratio) * _unit(total)
    return Recording(
        lead_matrix() @ potentials, options.rate, f"synthetic ({options.rhythm})"
    ), truth


def _independent() -> Array:
    """Matrix (8, 9) from electrodes to the independent leads."""
    return lead_matrix()[INDEPENDENT_ROWS]


def _power(potentials: Array) -> float:
    """Mean square of the independent leads of electrode potentials (mV²)."""
    return float(np.mean((_independent() @ potentials) ** 2))


def _unit(potentials: Array) -> Array:
    return np.asarray(potentials / np.sqrt(_power(potentials)))


# Shapes: the heart vector turns through a few directions (left, down, forward).

QT, NARROW = 0.4, 0.09  # s; of a narrow beat at 60 per minute, and of its QRS
SHORTEST_T, P_LENGTH = 0.15, 0.09  # s

_NARROW = ((-0.3, -0.1, 0.4), (1.0, 0.8, -0.3), (0.1, 0.1, -0.7), (-0.3, -0.4, -0.2))
_LEFT_BLOCK = ((0.2, 0.1, 0.2), (0.7, 0.4, -0.6), (0.9, 0.3, -0.6), (0.6, 0.1, -0.4))
_RIGHT_BLOCK = ((-0.3, -0.1, 0.4), (1.0, 0.8, -0.3), (-0.2, 0.1, 0.2), (-0.6, -0.1, 0.6))
_SPANS = ((0.0, 0.45), (0.12, 0.7), (0.3, 0.88), (0.5, 1.0))  # of the QRS, for each direction


def _shape(rng: np.random.Generator, kind: str, height: float, tall_t: float) -> _Shape:
    """Random shape of one kind of beat; ectopic ones are up to 1.8 times as tall as `height`."""
    if kind == "normal":
        directions, length = _NARROW, rng.uniform(0.075, 0.11)
    elif kind in ("ectopic", "paced"):
        directions, length = _LEFT_BLOCK, rng.uniform(0.13, 0.19)
        height *= rng.uniform(1, 1.8) if kind == "ectopic" else 1
    else:
        directions = _LEFT_BLOCK if kind == "blocked" and rng.random() < 0.5 else _RIGHT_BLOCK
        length = rng.uniform(0.12, 0.17)
    turn = _rotation(rng, np.pi if kind == "ectopic" else np.pi / 5)
    vectors = np.array(directions) * rng.lognormal(0, 0.25, (len(directions), 1)) @ turn
    non_dipolar = 0.15 * rng.standard_normal(
        (len(vectors), len(ELECTRODES))
    )  # what no dipole explains
    potentials = vectors @ SIGHT.T + non_dipolar
    inner = 0.04 * rng.uniform(-1, 1, (2, len(directions)))
    inner[0, 0] = inner[1, -1] = 0  # the ends stay
    first, last = np.array(_SPANS).T + inner
    # The first and the last hump decide how gently the QRS begins and ends.
    rise = np.array([rng.uniform(1.3, 3.5), *rng.uniform(2, 3, len(directions) - 1)])
    fall = np.array([*rng.uniform(2, 3, len(directions) - 1), rng.uniform(1.5, 3.5)])
    humps = tuple(zip(first, last, rise, fall, strict=True))
    plain = _Shape(length, humps, potentials, np.zeros(9), np.zeros(9), 0.0)
    potentials *= height / np.abs(lead_matrix() @ plain.qrs(np.linspace(0, 1, 201))).max()
    sense = potentials[1] if kind == "normal" else -potentials.mean(axis=0)
    t_wave = rng.uniform(0.15, 0.35) * tall_t * sense
    p_size = 0.0 if kind in ("ectopic", "aberrant") else rng.uniform(0.05, 0.15) * min(height, 1)
    p_wave = p_size * SIGHT @ _rotation(rng, np.pi / 6) @ [0.6, 0.9, 0.1]
    return _Shape(length, humps, potentials, t_wave, p_wave, rng.uniform(0.03, 0.09))


def _rotation(rng: np.random.Generator, largest: float) -> Array:
    """Rotation (3, 3) about a random axis by up to an angle (Rodrigues' formula)."""
    axis = rng.standard_normal(3)
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = rng.uniform(0, largest)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def _beats(
    rng: np.random.Generator,
    t: Array,
    times: Sequence[float],
    kinds: Sequence[str],
    shapes: dict[str, _Shape],
    spread: float,
) -> tuple[Array, Array, tuple[Array, Array, Array, tuple[str, ...]]]:
    """Potentials (9, n) of all QRS and of all P and T waves; R times, onsets, offsets, kinds."""
    qrs, waves = np.zeros((2, len(ELECTRODES), len(t)))
    bazett = QT * np.sqrt(np.median(np.diff(times)))
    marks: list[tuple[float, float, float]] = []
    kept: list[str] = []
    for time, kind in zip(times, kinds, strict=True):
        shape = shapes[kind]
        size = 1 + spread * rng.standard_normal()
        length = shape.length * (1 + spread / 2 * rng.standard_normal())
        onset = time - shape.top() * length
        offset = onset + length
        if onset < 0 <= offset or onset <= t[-1] < offset:
            continue
        if onset >= 0 and offset <= t[-1]:
            marks.append((time, onset, offset))
            kept.append(kind)
        at = samples(t, onset, offset)
        qrs[:, at] += size * shape.qrs((t[at] - onset) / length)
        end = offset + max(bazett - NARROW, SHORTEST_T)
        at = samples(t, offset, end)
        waves[:, at] += shape.t_wave[:, None] * hump(t[at], offset, end, 3, 2)
        end = onset - shape.p_gap
        at = samples(t, end - P_LENGTH, end)
        waves[:, at] += shape.p_wave[:, None] * hump(t[at], end - P_LENGTH, end, 2, 2)
    r_times, onsets, offsets = np.array(marks).reshape(-1, 3).T
    return qrs, waves, (r_times, onsets, offsets, tuple(kept))


def _spike_times(rng: np.random.Generator, onsets: Array) -> Array:
    """Times (s) of ventricular pulses, just before each QRS, and of atrial ones in some hearts."""
    ventricular = onsets - rng.uniform(0.003, 0.03)
    if rng.random() < 0.5:
        return ventricular
    return np.sort(np.concatenate([ventricular, ventricular - rng.uniform(0.12, 0.2)]))
