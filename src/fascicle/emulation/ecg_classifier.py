"""Classifier of recordings: small neural networks that learn the kind of an ECG from simulations.

From as many simulations of each kind, recordings are made as they may look: in another torso, with
another gain, noise and QRS onset, and with a discrepancy like that of the likelihood. Neural
networks trained to tell the kinds apart then give the posterior probability of each kind under
equal prior probabilities; no likelihood is computed, and parameters, torso and discrepancy are
averaged over (S. T. Radev et al., "Amortized Bayesian model comparison with evidential deep
learning", IEEE Trans. Neural Netw. Learn. Syst. 34, 2023).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import INDEPENDENT_LEADS, LEADS, independent_rows
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.threads import one_thread
from fascicle.emulation.ecg_emulator import all_leads, torso_modes_of
from fascicle.forward.likelihood import (
    HALF_PERIOD,
    QrsLikelihood,
    discrepancy_in_time,
    lead_pattern,
    separable,
)
from fascicle.inference.emulator import (
    NeuralNetwork,
    Singles,
    networks_from,
    softmax,
    train,
    train_together,
    weight_arrays,
)
from fascicle.networks.prior_simulations import BEFORE, Examples
from fascicle.networks.settings import FitSettings
from fascicle.recording.target import Target

LENGTH = 300  # samples (ms) of an ECG, of which `BEFORE` are before the first activation
COSINES = round(LENGTH / HALF_PERIOD)  # cosines of each lead, as in the likelihood


@dataclass(frozen=True)
class Recorder:
    """Makes recordings of simulated ECGs, in cosines.

    Attributes
    ----------
    torso_modes : (k, 8, 8) array
        Torso modes: matrices that a torso adds to the independent leads, each times a standard
        normal factor.
    residuals : (h, 8, COSINES) array
        Residuals of the torso modes in simulated ECGs in random torsos, over the norms of the ECGs.
    discrepancy : (8 · COSINES, 8 · COSINES) array
        Square root of the discrepancy's covariance, of unit size.
    """

    torso_modes: Floats
    residuals: Floats
    discrepancy: Floats
    chunk: ClassVar[int] = 4_000  # recordings that are made at once
    gain_sd: ClassVar[float] = FitSettings.model_fields["gain_sd"].default

    @classmethod
    def of(cls, examples: Examples) -> Recorder:
        """Make a recorder from a heart's examples in random torsos, and their differences."""
        count = len(INDEPENDENT_LEADS)
        held_out = examples.held_out[examples.feasible]
        plain = in_cosines(examples.ecgs[held_out, :count])
        in_torsos = in_cosines(examples.in_torsos[:, :count])
        torso_modes, factors = torso_modes_of(plain, in_torsos, examples.torsos)
        mixing = np.einsum("hk,kab->hab", factors[examples.torsos], torso_modes) + np.eye(count)
        residuals = (in_torsos - mixing @ plain) / _norms(plain)[:, None, None]
        first_half, second_half = np.array_split(
            examples.ecgs[: cls.chunk, :count].astype(float), 2
        )
        pattern = lead_pattern(first_half[: len(second_half)] - second_half)
        modes = idct(np.eye(LENGTH)[:, :COSINES], axis=0, norm="ortho")
        values, vectors = np.linalg.eigh(separable(pattern, discrepancy_in_time(LENGTH), modes))
        return cls(torso_modes, residuals, vectors * np.sqrt(np.maximum(values, 0)))

    def recordings(
        self, ecgs: NDArray[Any], rows: Integers, count: int, rng: np.random.Generator
    ) -> tuple[Singles, Integers]:
        """Make recordings (count, r, COSINES) in the leads `rows`, with the index of their ECGs.

        ECGs (n, 8, LENGTH) are used equally often.
        """
        leads = in_leads(rows)
        chosen = np.resize(rng.permutation(len(ecgs)), count)
        parts = np.array_split(chosen, -(-count // self.chunk))
        return np.concatenate([leads @ self.recorded(ecgs[k], rng) for k in parts]), chosen

    def recorded(
        self, ecgs: NDArray[Any], rng: np.random.Generator, *, in_torsos: bool = False
    ) -> Singles:
        """Make recordings (n, 8, COSINES) of ECGs (n, 8, LENGTH), perhaps in torsos already."""
        count, norms = len(ecgs), _norms(ecgs)
        recordings = in_cosines(_shifted(ecgs, rng))
        if not in_torsos:
            factors = rng.standard_normal((count, len(self.torso_modes)))
            recordings = (
                np.tensordot(factors, self.torso_modes, 1) + np.eye(ecgs.shape[1])
            ) @ recordings
            recordings += (
                norms[:, None, None] * self.residuals[rng.integers(len(self.residuals), size=count)]
            )
        # samples from the first to the last one above a hundredth of the largest
        height = np.abs(ecgs).max(axis=1)
        high = height > 0.01 * height.max(axis=1, keepdims=True)
        durations = LENGTH - high[:, ::-1].argmax(axis=1) - high.argmax(axis=1)
        size = rng.choice(QrsLikelihood.shares, count) * norms / np.sqrt(ecgs.shape[1] * durations)
        drawn = rng.standard_normal((count, len(self.discrepancy))) @ self.discrepancy.T
        recordings += size[:, None, None] * drawn.reshape(recordings.shape)
        recordings *= rng.normal(1, self.gain_sd, count)[:, None, None]
        noise = 0.01 * rng.standard_normal(recordings.shape)  # mV
        return np.asarray(recordings + noise, dtype=np.float32)


@dataclass(frozen=True)
class EcgClassifier:
    """Classifier that gives the probability of each kind, given a recording.

    Attributes
    ----------
    rows : (r,) array
        Leads that the classifier uses, as rows of `fascicle.core.leads.LEADS`.
    mean, components, scale : arrays
        Mean of the cosines, their principal components, and the scales that divide these.
    networks : tuple of NeuralNetwork
        Neural networks, whose probabilities are averaged.
    accuracy : float
        Share of held-out recordings whose most probable kind is the true one.
    most_unexplained : float, optional
        Share of energy outside the components that 98 % of held-out recordings do not exceed; None
        if it was not stored.
    """

    rows: Integers
    mean: Floats
    components: Floats
    scale: Floats
    networks: tuple[NeuralNetwork, ...]
    accuracy: float
    most_unexplained: float | None = None

    def probabilities(self, target: Target) -> Floats:
        """Probability (c,) of each kind, given a recording."""
        return np.asarray(self.of_cosines(self.cosines(target))[0])

    def cosines(self, target: Target) -> Floats:
        """Cosines (1, r, COSINES) of a recording."""
        samples = np.zeros((1, len(self.rows), LENGTH))
        recorded = target.qrs[self.rows, : LENGTH - BEFORE]
        samples[0, :, BEFORE : BEFORE + recorded.shape[1]] = recorded
        return in_cosines(samples)

    def of_cosines(self, recordings: NDArray[Any]) -> Floats:
        """Probabilities (n, c) of kinds, given recordings (n, r, COSINES)."""
        inputs = _inputs(recordings, self.mean, self.components, self.scale)
        by_network = [softmax(network(inputs)) for network in self.networks]
        return np.asarray(np.mean(by_network, axis=0), dtype=float)

    def tempered(self, temperature: float) -> EcgClassifier:
        """Classifier whose networks give probabilities to the power 1 / `temperature`."""
        networks = [
            NeuralNetwork((*hidden, weights / temperature, offset / temperature))
            for *hidden, weights, offset in (network.weights for network in self.networks)
        ]
        return replace(self, networks=tuple(networks))

    def unexplained(self, recordings: NDArray[Any]) -> Floats:
        """Share (n,) of the energy of recordings (n, r, COSINES) outside the components."""
        flat = recordings.reshape(len(recordings), -1).astype(float)
        inside = ((flat @ self.components.T) ** 2).sum(axis=1)
        return np.asarray(1 - inside / (flat**2).sum(axis=1))

    def distance(self, recordings: NDArray[Any]) -> Floats:
        """Squared Mahalanobis distance (n,) of recordings (n, r, COSINES) from the training set.

        Recordings are scaled to the root mean square size of the training set. Outside the
        components its variance is taken to be that of the last one.
        """
        variances = (self.scale**2 / self.scale.max()) ** 2  # scale: root of the SD, see `learn`
        flat = recordings.reshape(len(recordings), -1).astype(float)
        size = np.sqrt(variances.sum() + (self.mean**2).sum())
        flat = flat * (size / np.linalg.norm(flat, axis=1, keepdims=True)) - self.mean
        along = (flat @ self.components.T) ** 2
        outside = (flat**2).sum(axis=1) - along.sum(axis=1)
        return np.asarray((along / variances).sum(axis=1) + outside / variances[-1])

    def arrays(self) -> dict[str, Any]:
        """Arrays of all attributes, for a file; weights of networks in half precision."""
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)[:4]}
        arrays["right"] = np.asarray(self.accuracy)
        arrays["components"] = arrays["components"].astype(np.float32)
        if self.most_unexplained is not None:
            arrays["most_outside"] = np.asarray(self.most_unexplained)
        return arrays | weight_arrays("networks", self.networks)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> EcgClassifier:
        """Make a classifier from its `arrays`."""
        parts = ("rows", "mean", "components", "scale")
        rows, mean, components, scale = (np.asarray(arrays[name]) for name in parts)
        most_unexplained = float(arrays["most_outside"]) if "most_outside" in arrays else None
        networks = networks_from("networks", arrays)
        return cls(
            rows, mean, components, scale, networks, float(arrays["right"]), most_unexplained
        )


@dataclass(frozen=True)
class RecordingSet:
    """Training or held-out set: recordings (n, r, COSINES), and probabilities of kinds (n, c)."""

    recordings: Singles
    kinds: Singles


@one_thread
def learn(
    training_set: RecordingSet,
    held_out: RecordingSet,
    rows: Integers,
    rng: np.random.Generator,
    progress: Progress | None = None,
    steps: int = 8000,
) -> EcgClassifier:
    """Train a classifier of recordings in the leads `rows` (`fascicle.core.leads.LEADS`)."""
    training = training_set.recordings.reshape(len(training_set.kinds), -1)
    mean = training.mean(axis=0, dtype=float)
    sample = (
        training[rng.integers(len(training), size=6000)] - mean
    )  # an SVD of all would take long
    components = np.linalg.svd(sample, full_matrices=False)[2][:80]
    # scaled by the root of the SD: small components matter, too, but are noisier
    sds = (sample @ components.T).std(axis=0)
    scale = np.sqrt(sds * sds.max())
    inputs = _inputs(training, mean, components, scale)
    of_kinds = partial(train, inputs, training_set.kinds, width=128, steps=steps, link=softmax)
    report, trainings = stage_progress(progress, "training"), [of_kinds] * 2
    total = len(trainings) * steps
    networks = train_together(trainings, rng, lambda done: report(done, total))
    classifier = EcgClassifier(rows, mean, components, scale, tuple(networks), 0.0)
    guessed = classifier.of_cosines(held_out.recordings).argmax(axis=1)
    # 98 % of held-out recordings count as like the training set
    most_unexplained = np.quantile(classifier.unexplained(held_out.recordings), 0.98)
    classifier = replace(
        classifier,
        accuracy=float((guessed == held_out.kinds.argmax(axis=1)).mean()),
        most_unexplained=float(most_unexplained),
    )
    if progress is not None:
        progress("classifier", 1, 1, f"{classifier.accuracy:.0%} of held-out recordings told right")
    return classifier


def most_alike(recordings: NDArray[Any], reference: NDArray[Any]) -> Floats:
    """Share (n,) of the energy of recordings (n, r, COSINES) that the best reference ECG explains.

    Reference ECGs (m, r, COSINES) are scaled by the best factor that is not negative.
    """
    flat, unit = (ecgs.reshape(len(ecgs), -1).astype(float) for ecgs in (recordings, reference))
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    along = np.maximum(flat @ unit.T, 0)
    return np.asarray((along**2).max(axis=1) / (flat**2).sum(axis=1))


def in_leads(rows: Integers) -> Singles:
    """Matrix (r, 8) that makes the leads `rows` from the independent leads."""
    return all_leads(np.eye(len(INDEPENDENT_LEADS)))[rows].astype(np.float32)


def classified_rows(target: Target) -> Integers:
    """Independent leads of a recording, among the twelve standard leads."""
    return independent_rows(target.used[: len(LEADS)])


def in_cosines(ecgs: NDArray[Any]) -> Floats:
    """ECGs (n, r, LENGTH) as cosines (n, r, COSINES)."""
    return np.asarray(dct(ecgs, axis=2, norm="ortho")[:, :, :COSINES], dtype=float)


def _inputs(recordings: NDArray[Any], mean: Floats, components: Floats, scale: Floats) -> Singles:
    flat = recordings.reshape(len(recordings), -1)
    return np.asarray((flat - mean) @ components.T / scale, dtype=np.float32)


def _shifted(ecgs: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """ECGs shifted by a random error of the QRS onset (SD 6 ms), zero before and after."""
    shifts = np.clip(np.rint(rng.normal(0, 6.0, len(ecgs))), -BEFORE, BEFORE).astype(int)
    padded = np.pad(ecgs, ((0, 0), (0, 0), (BEFORE, BEFORE)))
    place = np.arange(LENGTH) + BEFORE - shifts[:, None]
    return np.asarray(np.take_along_axis(padded, place[:, None], axis=2))


def _norms(ecgs: NDArray[Any]) -> Floats:
    return np.asarray(np.sqrt((np.asarray(ecgs, float) ** 2).sum(axis=(1, 2))))
