"""A classifier of recordings: small networks that learn from simulations which kind an ECG is of.

Of simulations of each kind, in equal numbers, recordings are made as they may look: in another
body, with another gain, noise and marks, and with a discrepancy like that of the likelihood. What
networks give that tell their kinds apart is then how probable each kind is given a recording, if
each is as probable before; no likelihood is computed, and parameters, body and discrepancy are
averaged over (S. T. Radev et al., "Amortized Bayesian model comparison with evidential deep
learning", IEEE Trans. Neural Netw. Learn. Syst. 34, 2023).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import INDEPENDENT_LEADS, LEADS, independent_rows
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.threads import one_thread
from fascicle.forward.likelihood import (
    HALF_PERIOD,
    SHARES,
    discrepancy_in_time,
    lead_pattern,
    separable,
)
from fascicle.inference.emulator import (
    Network,
    Singles,
    networks_from,
    softmax,
    train,
    train_together,
    weight_arrays,
)
from fascicle.recording.target import Target
from fascicle.study.ecg_emulator import all_leads, body_modes
from fascicle.study.prior_simulations import BEFORE, Examples
from fascicle.study.settings import FitSettings

LENGTH = 300  # samples (ms) of an ECG, of which `BEFORE` are before the first activation
MODES = round(LENGTH / HALF_PERIOD)  # cosines of each lead, as of the likelihood
CHUNK = 4_000  # recordings that are made at once
COMPONENTS = 80  # principal ones
NETWORKS, WIDTH, STEPS = 2, 128, 8000
ONSET_SD = 6.0  # ms; of the first activation about the recorded onset
NOISE = 0.01  # mV; of each coefficient
FAMILIAR = 0.98  # share of held-out recordings that are called like simulated ones
GAIN_SD = float(FitSettings.model_fields["gain_sd"].default)


@dataclass(frozen=True)
class Recorder:
    """Makes recordings of simulated ECGs, in cosines.

    Attributes
    ----------
    bodies : (k, 8, 8) array
        What another body adds to the independent leads: matrices with standard normal factors.
    left : (h, 8, MODES) array
        What these do not say of simulated ECGs in random bodies, over the norms of the ECGs.
    discrepancy : (8 · MODES, 8 · MODES) array
        Root of its covariance, of unit size.
    """

    bodies: Floats
    left: Floats
    discrepancy: Floats

    @classmethod
    def of(cls, examples: Examples) -> Recorder:
        """What the examples of a heart show of bodies, and of differences between networks."""
        count = len(INDEPENDENT_LEADS)
        held_out = examples.held_out[examples.feasible]
        plain = in_cosines(examples.ecgs[held_out, :count])
        in_bodies = in_cosines(examples.in_bodies[:, :count])
        bodies, factors = body_modes(plain, in_bodies, examples.bodies)
        mixed = np.einsum("hk,kab->hab", factors[examples.bodies], bodies) + np.eye(count)
        left = (in_bodies - mixed @ plain) / _norms(plain)[:, None, None]
        one, other = np.array_split(examples.ecgs[:CHUNK, :count].astype(float), 2)
        pattern = lead_pattern(one[: len(other)] - other)
        modes = idct(np.eye(LENGTH)[:, :MODES], axis=0, norm="ortho")
        values, vectors = np.linalg.eigh(separable(pattern, discrepancy_in_time(LENGTH), modes))
        return cls(bodies, left, vectors * np.sqrt(np.maximum(values, 0)))

    def recordings(
        self, ecgs: NDArray[Any], rows: Integers, count: int, rng: np.random.Generator
    ) -> tuple[Singles, Integers]:
        """So many recordings (count, r, MODES) in the leads `rows`, and of which ECG each is.

        ECGs (n, 8, LENGTH) are taken as often as one another.
        """
        leads = in_leads(rows)
        chosen = np.resize(rng.permutation(len(ecgs)), count)
        parts = np.array_split(chosen, -(-count // CHUNK))
        return np.concatenate([leads @ self.recorded(ecgs[k], rng) for k in parts]), chosen

    def recorded(
        self, ecgs: NDArray[Any], rng: np.random.Generator, *, in_bodies: bool = False
    ) -> Singles:
        """Recordings (n, 8, MODES) of ECGs (n, 8, LENGTH), perhaps in bodies already."""
        count, norms = len(ecgs), _norms(ecgs)
        found = in_cosines(_shifted(ecgs, rng))
        if not in_bodies:
            factors = rng.standard_normal((count, len(self.bodies)))
            found = (np.tensordot(factors, self.bodies, 1) + np.eye(ecgs.shape[1])) @ found
            found += norms[:, None, None] * self.left[rng.integers(len(self.left), size=count)]
        size = rng.choice(SHARES, count) * norms / np.sqrt(ecgs.shape[1] * _durations(ecgs))
        drawn = rng.standard_normal((count, len(self.discrepancy))) @ self.discrepancy.T
        found += size[:, None, None] * drawn.reshape(found.shape)
        found *= rng.normal(1, GAIN_SD, count)[:, None, None]
        return np.asarray(found + NOISE * rng.standard_normal(found.shape), dtype=np.float32)


@dataclass(frozen=True)
class EcgClassifier:
    """How probable kinds are, given a recording.

    Attributes
    ----------
    rows : (r,) array
        Leads that it looks at, in `fascicle.core.leads.LEADS`.
    mean, components, scale : arrays
        Of its inputs: principal components of the cosines, over their scales.
    networks : tuple of Network
        Whose probabilities are averaged.
    right : float
        Share of held-out recordings whose most probable kind is the true one.
    most_outside : float, optional
        Share of its energy that 98 % of held-out recordings have outside the components, at most;
        None if it was not kept.
    """

    rows: Integers
    mean: Floats
    components: Floats
    scale: Floats
    networks: tuple[Network, ...]
    right: float
    most_outside: float | None = None

    def probabilities(self, target: Target) -> Floats:
        """How probable each kind is given a recording, (c,)."""
        return np.asarray(self.of_cosines(self.cosines(target))[0])

    def cosines(self, target: Target) -> Floats:
        """A recording as the networks see it, (1, r, MODES)."""
        samples = np.zeros((1, len(self.rows), LENGTH))
        recorded = target.qrs[self.rows, : LENGTH - BEFORE]
        samples[0, :, BEFORE : BEFORE + recorded.shape[1]] = recorded
        return in_cosines(samples)

    def of_cosines(self, recordings: NDArray[Any]) -> Floats:
        """How probable each kind is given recordings (n, r, MODES), (n, c)."""
        inputs = _inputs(recordings, self.mean, self.components, self.scale)
        each = [softmax(network(inputs)) for network in self.networks]
        return np.asarray(np.mean(each, axis=0), dtype=float)

    def outside(self, recordings: NDArray[Any]) -> Floats:
        """Share of the energy of recordings (n, r, MODES) outside the components, (n,)."""
        flat = recordings.reshape(len(recordings), -1).astype(float)
        inside = ((flat @ self.components.T) ** 2).sum(axis=1)
        return np.asarray(1 - inside / (flat**2).sum(axis=1))

    def arrays(self) -> dict[str, Any]:
        """All of it for a file; the weights in half precision."""
        found = {each.name: np.asarray(getattr(self, each.name)) for each in fields(self)[:4]}
        found["right"] = np.asarray(self.right)
        found["components"] = found["components"].astype(np.float32)
        if self.most_outside is not None:
            found["most_outside"] = np.asarray(self.most_outside)
        return found | weight_arrays("networks", self.networks)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> EcgClassifier:
        """The inverse of `arrays`."""
        parts = ("rows", "mean", "components", "scale")
        rows, mean, components, scale = (np.asarray(arrays[name]) for name in parts)
        most_outside = float(arrays["most_outside"]) if "most_outside" in arrays else None
        networks = networks_from("networks", arrays)
        return cls(rows, mean, components, scale, networks, float(arrays["right"]), most_outside)


@dataclass(frozen=True)
class Lessons:
    """Recordings in cosines (n, r, MODES), and how probable each kind is to be of each, (n, c)."""

    recordings: Singles
    kinds: Singles


@one_thread
def learn(
    seen: Lessons,
    held_out: Lessons,
    rows: Integers,
    rng: np.random.Generator,
    progress: Progress | None = None,
    steps: int = STEPS,
) -> EcgClassifier:
    """Train a classifier of recordings in the leads `rows` (`fascicle.core.leads.LEADS`)."""
    every = seen.recordings.reshape(len(seen.kinds), -1)
    mean = every.mean(axis=0, dtype=float)
    some = every[rng.integers(len(every), size=6000)] - mean
    components = np.linalg.svd(some, full_matrices=False)[2][:COMPONENTS]
    # partly made alike: small components matter, and are noisier
    sds = (some @ components.T).std(axis=0)
    scale = np.sqrt(sds * sds.max())
    inputs = _inputs(every, mean, components, scale)
    of_kinds = partial(train, inputs, seen.kinds, width=WIDTH, steps=steps, link=softmax)
    report = stage_progress(progress, "training")
    total = NETWORKS * steps
    networks = train_together([of_kinds] * NETWORKS, rng, lambda done: report(done, total))
    found = EcgClassifier(rows, mean, components, scale, tuple(networks), 0.0)
    guessed = found.of_cosines(held_out.recordings).argmax(axis=1)
    found = replace(
        found,
        right=float((guessed == held_out.kinds.argmax(axis=1)).mean()),
        most_outside=float(np.quantile(found.outside(held_out.recordings), FAMILIAR)),
    )
    if progress is not None:
        progress("classifier", 1, 1, f"{found.right:.0%} of held-out recordings told right")
    return found


def most_alike(recordings: NDArray[Any], reference: NDArray[Any]) -> Floats:
    """Share of the energy of recordings (n, r, MODES) that the best of a reference explains.

    Each of the reference (m, r, MODES) is scaled as it suits.
    """
    one, other = (each.reshape(len(each), -1).astype(float) for each in (recordings, reference))
    other = other / np.linalg.norm(other, axis=1, keepdims=True)
    along = np.maximum(one @ other.T, 0)
    return np.asarray((along**2).max(axis=1) / (one**2).sum(axis=1))


def in_leads(rows: Integers) -> Singles:
    """Matrix (r, 8) that makes the leads `rows` of the independent ones."""
    return all_leads(np.eye(len(INDEPENDENT_LEADS)))[rows].astype(np.float32)


def classified_rows(target: Target) -> Integers:
    """Independent leads of a recording, of the standard ones."""
    return independent_rows(target.used[: len(LEADS)])


def in_cosines(ecgs: NDArray[Any]) -> Floats:
    """ECGs (n, r, LENGTH) as cosines (n, r, MODES)."""
    return np.asarray(dct(ecgs, axis=2, norm="ortho")[:, :, :MODES], dtype=float)


def _inputs(recordings: NDArray[Any], mean: Floats, components: Floats, scale: Floats) -> Singles:
    flat = recordings.reshape(len(recordings), -1)
    return np.asarray((flat - mean) @ components.T / scale, dtype=np.float32)


def _shifted(ecgs: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """ECGs whose first activation is off, silent before and after."""
    shifts = np.clip(np.rint(rng.normal(0, ONSET_SD, len(ecgs))), -BEFORE, BEFORE).astype(int)
    padded = np.pad(ecgs, ((0, 0), (0, 0), (BEFORE, BEFORE)))
    place = np.arange(LENGTH) + BEFORE - shifts[:, None]
    return np.asarray(np.take_along_axis(padded, place[:, None], axis=2))


def _norms(ecgs: NDArray[Any]) -> Floats:
    return np.asarray(np.sqrt((np.asarray(ecgs, float) ** 2).sum(axis=(1, 2))))


def _durations(ecgs: NDArray[Any]) -> Integers:
    """Samples from the first to the last above a hundredth of the highest, (n,)."""
    high = np.abs(ecgs).max(axis=1)
    there = high > 0.01 * high.max(axis=1, keepdims=True)
    return np.asarray(LENGTH - there[:, ::-1].argmax(axis=1) - there.argmax(axis=1))
