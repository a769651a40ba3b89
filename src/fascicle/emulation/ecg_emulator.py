"""Emulator of a heart's ECG: small neural networks that learn it from the prior simulations.

ECGs are aligned at the first activation and described by the scores of their principal components.
Neural networks give the scores from the parameters; another one gives the probability that
parameters give a feasible Purkinje network of the heart. The difference between held-out ECGs in
random torsos and the emulated ones is the residual of the emulator: its own error, the fine
structure that growth leaves to chance, and the torso. Its covariance enters the likelihood
(J. Kaipio and E. Somersalo, "Statistical inverse problems: discretization, model reduction and
inverse crimes", J. Comput. Appl. Math. 198, 2007).

Time scaling: a heart whose conduction velocities are all c times as high, with root times and
delays c times as short, has the same ECG, c times as fast. Every simulation is therefore added to
the training set at several velocities, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS, LEADS, limb_leads_from
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.quantities import DELAY
from fascicle.core.threads import one_thread
from fascicle.inference.emulator import (
    BATCH_EXAMPLES,
    RATE,
    NeuralNetwork,
    Singles,
    logistic,
    networks_from,
    train,
    train_together,
    weight_arrays,
)
from fascicle.networks.prior import AveragedOver, Prior
from fascicle.networks.prior_simulations import BEFORE, Examples, PriorSimulations

HIGHEST = 0.04  # highest frequency (cycles per ms); the likelihood uses lower ones alone
TORSO_MODES = 4  # number of torso modes
FASTER = ("alpha", "fibre_speed", "cv")  # multiplied by c in time scaling
SOONER = (*DELAY, "anterograde_delay", "retrograde_delay", "his_time")  # divided by c


@dataclass(frozen=True)
class EcgEmulator:
    """Emulator of a heart's ECG by neural networks.

    Attributes
    ----------
    names : tuple of str
        Quantities that the emulator depends on.
    centre, scale : arrays
        Mean and standard deviation that standardise the inputs: the quantities, with the
        logarithms of those of `FASTER`, and the tissue.
    networks, validity : sequence of NeuralNetwork, and NeuralNetwork
        Neural networks that give the scores, in `unit`; and one that gives the log odds that the
        parameters are feasible.
    mean, components : (8 + k, f) and (q, 8 + k, f) arrays
        Mean ECG (mV) and principal components, as coefficients of cosines (DCT-II).
    unit : float
        Root mean square of the scores (mV).
    length : int
        Samples (1 ms) of an ECG, which begins `BEFORE` the first activation.
    torso_modes : (k, 8 + a, 8 + a) array
        Torso modes: matrices that a torso adds to the independent leads, each times a factor that
        is standard normal over random torsos.
    residual_factor : (q, q) array
        Residual covariance factor: rows, in components, whose outer products add up to the mean
        outer product of the residuals of held-out ECGs in random torsos. A residual is what
        emulator and torso modes leave unexplained, over the norm of the emulated ECG.
    torso_residual_factor : (q, q) array
        Residual covariance factor of the torso modes alone, applied to simulated ECGs.
    hearts : (k, p) array
        Inputs that stand for each heart of an atlas; empty for a single heart.
    report : mapping of str to float
        Quality for held-out networks: explained share of the variance; root mean square error over
        that of the ECGs, in the plain torso, by lead, and in random torsos; share of points whose
        feasibility is predicted rightly.
    """

    names: tuple[str, ...]
    centre: Floats
    scale: Floats
    networks: tuple[NeuralNetwork, ...]
    validity: NeuralNetwork
    mean: Floats
    components: Floats
    unit: float
    length: int
    torso_modes: Floats
    residual_factor: Floats
    torso_residual_factor: Floats
    report: Mapping[str, float]
    hearts: Floats = field(default_factory=partial(np.empty, (0, 0)))
    # names in files of the attributes that are stored in single precision
    stored: ClassVar[Mapping[str, str]] = {
        "mean": "mean",
        "components": "components",
        "torso_modes": "bodies",
        "residual_factor": "left",
        "torso_residual_factor": "left_by_bodies",
    }

    @property
    def summary(self) -> str:
        """Quality for held-out networks, in a line."""
        report = self.report
        leads = sorted((error, name) for name, error in report.items() if "error_V" in name)
        (least, best), (most, worst) = leads[0], leads[-1]
        return (
            f"held-out ECGs: R² {report['r_squared']:.2f}, {report['error']:.0%} off ({least:.0%} "
            f"{best[6:]} to {most:.0%} {worst[6:]}; {report['error_in_bodies']:.0%} in torsos)"
        )

    @property
    def expected_error(self) -> float:
        """Root mean square error expected of networks of a posterior, over that of the ECGs."""
        return self.report.get("error_of_posterior", self.report["error"])

    def scores(self, inputs: Singles) -> Singles:
        """Scores (n, q) of the components, in `unit`, at standardised inputs (n, p)."""
        return np.asarray(np.mean([network(inputs) for network in self.networks], axis=0))

    def log_validity(self, inputs: Singles) -> Floats:
        """Log probability (n,) that the parameters of standardised inputs are feasible."""
        odds = self.validity(inputs)[:, 0].astype(float)
        return np.asarray(-np.logaddexp(0.0, -odds))

    def inputs(self, values: Mapping[str, Floats], tissues: Floats) -> Singles:
        """Standardised inputs (n, p) of quantities (n,) by name, and tissues (`tissue_inputs`)."""
        raw = _raw_inputs(self.names, values, tissues)
        return np.asarray((raw - self.centre) / self.scale, dtype=np.float32)

    def with_fixed_inputs(self, places: Integers, values: Floats) -> EcgEmulator:
        """Emulator without the inputs at some places, which have these values before scaling."""
        kept = np.setdiff1d(np.arange(len(self.centre)), places)
        standardised = ((values - self.centre[places]) / self.scale[places]).astype(np.float32)

        def fixed(network: NeuralNetwork) -> NeuralNetwork:
            first, offset, *others = network.weights
            return NeuralNetwork((first[kept], offset + standardised @ first[places], *others))

        return replace(
            self,
            centre=self.centre[kept],
            scale=self.scale[kept],
            networks=tuple(map(fixed, self.networks)),
            validity=fixed(self.validity),
        )

    def of_heart(self, number: int, names: Sequence[str], tissues: int) -> EcgEmulator:
        """Emulator of one heart of an atlas, from which the training of another heart's begins.

        Its inputs are the quantities `names`, others being at their means, and as many of the
        tissue as are given.
        """
        count, heart = len(self.names), self.hearts[number]
        places = [k for k, name in enumerate(self.names) if name not in names]
        fixed = heart[: len(heart) - tissues]
        emulator = self.with_fixed_inputs(
            np.array([*places, *(count + np.arange(len(fixed)))]),
            np.concatenate([self.centre[places], fixed]),
        )
        kept = tuple(name for name in self.names if name in names)
        return replace(emulator, names=kept, hearts=np.empty((0, 0)))

    def lasting(self, length: int) -> EcgEmulator:
        """Emulator of ECGs of more samples, which are zero after those that it has learnt."""

        def lengthened(cosines: Floats) -> Floats:
            samples = idct(cosines, n=self.length, axis=-1, norm="ortho")
            more = [(0, 0)] * (samples.ndim - 1) + [(0, length - self.length)]
            return cosines_of(np.pad(samples, more), cosine_count(length))

        mean, components = lengthened(self.mean), lengthened(self.components)
        return replace(self, length=length, mean=mean, components=components)

    def with_components_of(self, ecgs: Floats, count: int = 30) -> EcgEmulator:
        """Emulator with further components, of what ECGs (n, 8 + k, f), in cosines, have besides.

        Its networks give scores of 0 for them.
        """
        flat = self.components.reshape(len(self.components), -1)
        deviations = (ecgs - self.mean).reshape(len(ecgs), -1)
        more = np.linalg.svd(deviations - deviations @ flat.T @ flat, full_matrices=False)[2]
        more = more[:count].reshape(-1, *self.mean.shape)
        wider = [
            NeuralNetwork(
                (*others, np.pad(last, ((0, 0), (0, len(more)))), np.pad(offset, (0, len(more))))
            )
            for *others, last, offset in (network.weights for network in self.networks)
        ]
        components = np.concatenate([self.components, more])
        return replace(self, components=components, networks=tuple(wider))

    def cosines(self, scores: NDArray[Any]) -> Floats:
        """ECGs (n, 8 + k, f), in cosines, that have scores (n, q)."""
        return np.asarray(self.mean + np.tensordot(self.unit * scores, self.components, 1))

    def residual_factor_of(self, errors: Floats, emulated: Floats) -> Floats:
        """Residual covariance factor (q, q) of errors, each over the norm of its emulated ECG."""
        flat = self.components.reshape(len(self.components), -1)
        norms = np.sqrt((emulated**2).sum(axis=(1, 2)))
        rows = errors.reshape(len(errors), -1) @ flat.T / norms[:, None]
        return _factor(rows / np.sqrt(len(rows)))

    @cached_property
    def series(self) -> Floats:
        """Change of the leads (q, 12 + k, length) (mV) by one unit of each score."""
        return np.asarray(self.unit * _in_time(self.components, self.length))

    @cached_property
    def mean_leads(self) -> Floats:
        """Mean ECG in all leads (12 + k, length) (mV)."""
        return np.asarray(_in_time(self.mean[None], self.length)[0])

    @cached_property
    def torso_modes_of_all_leads(self) -> Floats:
        """Torso modes (k, 12 + a, 12 + a) of all leads."""
        all_from_independent = all_leads(np.eye(self.torso_modes.shape[1]))
        rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(all_from_independent))]
        modes = np.zeros(
            (len(self.torso_modes), len(all_from_independent), len(all_from_independent))
        )
        modes[:, :, rows] = all_from_independent @ self.torso_modes
        return modes

    @cached_property
    def residual_leads(self) -> Floats:
        """Residual covariance factor (q, 12 + k, length) in all leads, for ECGs of unit norm."""
        return _in_time(
            np.einsum("hq,qlf->hlf", self.residual_factor, self.components), self.length
        )

    def arrays(self) -> dict[str, Any]:
        """Arrays of all attributes, for a file; weights of networks in half precision."""
        arrays: dict[str, Any] = {}
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            if attribute.name in ("networks", "validity"):
                group = value if attribute.name == "networks" else (value,)
                arrays |= weight_arrays(attribute.name, group)
            elif attribute.name == "report":
                arrays |= {f"report {name}": number for name, number in value.items()}
            elif attribute.name == "hearts":
                arrays |= {"hearts": value.astype(np.float32)} if len(value) else {}
            elif attribute.name in self.stored:
                arrays[self.stored[attribute.name]] = value.astype(np.float32)
            else:
                arrays[attribute.name] = value
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> EcgEmulator:
        """Make an emulator from its `arrays`."""
        parts = {n: np.asarray(arrays[n]) for n in ("centre", "scale")}
        parts |= {name: np.asarray(arrays[key], float) for name, key in cls.stored.items()}
        (validity,) = networks_from("validity", arrays)
        return cls(
            names=tuple(map(str, arrays["names"])),
            unit=float(arrays["unit"]),
            length=int(arrays["length"]),
            networks=networks_from("networks", arrays),
            validity=validity,
            hearts=np.asarray(arrays.get("hearts", np.empty((0, 0))), float),
            report={
                name.removeprefix("report "): float(arrays[name])
                for name in arrays
                if name.startswith("report ")
            },
            **parts,
        )


def tissue_inputs(averaged: AveragedOver, plain_ratio: float) -> Floats:
    """Inputs of an emulator for each tissue: log anisotropy, and speed-up by an endocardial layer.

    Shape (n_tissues, 2), or (1, 0) for a single tissue.
    """
    if len(averaged.tissues) == 1:
        return np.empty((1, 0))
    ratios = [tissue.get("anisotropy_ratio", plain_ratio) for tissue in averaged.tissues]
    speed_ups = [
        tissue.get("endocardial_layer", 0.0) * (tissue.get("endocardial_speed", 1.0) ** 2 - 1)
        for tissue in averaged.tissues
    ]
    return np.column_stack([np.log(ratios), speed_ups])


def _raw_inputs(names: tuple[str, ...], values: Mapping[str, Floats], tissues: Floats) -> Floats:
    """Inputs (n, p) before they are standardised."""
    columns = [np.log(values[n]) if n in FASTER else values[n] for n in names]
    return np.column_stack([*columns, tissues])


def _in_time(cosines: Floats, length: int) -> Floats:
    """All leads in time (n, 12 + k, length) from independent leads in cosines (n, 8 + k, f)."""
    padded = np.pad(cosines, ((0, 0), (0, 0), (0, length - cosines.shape[2])))
    ecg = idct(padded, axis=2, norm="ortho")
    return np.asarray([all_leads(independent) for independent in ecg])


def all_leads(independent: Floats) -> Floats:
    """All leads (12 + a, n) from the independent ones (8 + a, n)."""
    limb = limb_leads_from(INDEPENDENT_LEADS)
    assert limb is not None
    return np.concatenate([limb[:, :2] @ independent[:2], independent[2:]])


@one_thread
def learn(
    examples: Examples,
    prior: Prior,
    plain_ratio: float,
    rng: np.random.Generator,
    *,
    time_scaling: bool = True,
    progress: Progress | None = None,
    epochs: int = 12,
    fewest: int = 50,
    atlas: EcgEmulator | None = None,
) -> EcgEmulator:
    """Train an emulator on the examples that are not held out.

    Parameters
    ----------
    plain_ratio : float
        Conduction velocity along over across the fibre in the plain tissue.
    time_scaling : bool
        Whether time scaling holds; it does not where a scenario has times.
    epochs : int
        Number of times that every example is used in training.
    fewest : int
        Least number of Purkinje networks to learn from.
    atlas : EcgEmulator, optional
        Emulator of hearts of the population, which is trained further for this heart, if it has
        its inputs and leads: as good as one that learns from eight times as many networks.
    """
    tissues = tissue_inputs(prior.averaged, plain_ratio)[prior.tissue(examples.points)]
    values = emulated_quantities(prior, examples.points)
    _check_examples(examples, tuple(values), _raw_inputs(tuple(values), values, tissues), fewest)
    begin = None
    if atlas is not None:
        examples = examples.lasting(max(atlas.length, examples.ecgs.shape[2]))
        begin = most_similar(atlas, examples, values, tissues)
    emulator: EcgEmulator = learn_quantities(
        examples, values, tissues, ranges_of(prior), rng,
        time_scaling=time_scaling, progress=progress, epochs=epochs, begin=begin,
    )  # fmt: skip
    return emulator


def most_similar(
    atlas: EcgEmulator, examples: Examples, values: Mapping[str, Floats], tissues: Floats
) -> EcgEmulator | None:
    """Emulator of the atlas's heart whose ECGs are most similar to the examples.

    None if the examples have other leads, or depend on a quantity that is no input of the atlas's.
    """
    names, of_tissue = tuple(values), tissues.shape[1]
    if not {*names} <= {*atlas.names} or examples.ecgs.shape[1] != len(atlas.mean):
        return None
    atlas, some = atlas.lasting(examples.ecgs.shape[2]), np.flatnonzero(examples.feasible)[:1000]
    true = cosines_of(examples.ecgs[: len(some)], atlas.mean.shape[1])
    some_values = {name: value[some] for name, value in values.items()}

    def error(heart: EcgEmulator) -> float:
        scores = heart.scores(heart.inputs(some_values, tissues[some]))
        return float(((heart.cosines(scores) - true) ** 2).sum())

    return min((atlas.of_heart(k, names, of_tissue) for k in range(len(atlas.hearts))), key=error)


def emulated_quantities(prior: Prior, points: Floats) -> dict[str, Floats]:
    """Quantities (n,) at points (n, d), by name, on which an ECG of the prior depends."""
    values = {n: column for n, column in prior.columns(points).items() if n not in prior.fixed}
    values.pop("gain", None)  # a factor on the ECG
    return values


def ranges_of(prior: Prior) -> dict[str, tuple[float, float]]:
    """Ranges of the quantities that are learnt or averaged over."""
    parameters = (*prior.learnt.parameters, *prior.averaged.space.parameters)
    return {p.name: (p.lower, p.upper) for p in parameters}


@one_thread
def learn_quantities(
    examples: Examples,
    values: Mapping[str, Floats],
    tissues: Floats,
    ranges: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
    *,
    time_scaling: bool = True,
    progress: Progress | None = None,
    epochs: int = 12,
    begin: EcgEmulator | None = None,
) -> EcgEmulator:
    """Train an emulator, as `learn` does, on quantities instead of points of a prior.

    Parameters
    ----------
    values : mapping of str to (n,) array
        Quantities of each example (`emulated_quantities`).
    tissues : (n, p) array
        Further inputs: tissue (`tissue_inputs`), or heart of an atlas.
    ranges : mapping of str to (float, float)
        Ranges of the quantities, beyond which no copy is scaled in time.
    begin : EcgEmulator, optional
        Emulator that is trained further; by default the weights are drawn at random.
    """
    names = tuple(values)
    feasible, length = examples.feasible, examples.ecgs.shape[2]
    count = cosine_count(length)
    training = np.flatnonzero(~examples.held_out[feasible])
    cosines = cosines_of(examples.ecgs, count)
    if begin is None:
        begin = _untrained(names, _raw_inputs(names, values, tissues), cosines[training], length)
        weights: list[dict[str, Any]] = [{}, {}, {}]
    else:
        begin = begin.with_components_of(cosines[training])
        weights = [{"begin": n, "rate": RATE / 2} for n in (*begin.networks, begin.validity)]
    emulator, components = begin, begin.components.reshape(len(begin.components), -1)

    def example(values: Mapping[str, Floats], ecgs: Floats) -> tuple[Singles, Floats]:
        centred = (ecgs - emulator.mean).reshape(len(ecgs), -1)
        scores = centred @ components.T / emulator.unit
        return emulator.inputs(values, tissues[feasible][training]), scores

    plain_values = {name: value[feasible][training] for name, value in values.items()}
    pairs = [example(plain_values, cosines[training])]
    scalable = "cv" in names and {*DELAY} & {*names} and {*FASTER[:2]} & {*names}
    for _ in range(4 if time_scaling and scalable else 0):  # copies of all examples
        scaled_values, scaled_ecgs = _scaled_in_time(
            plain_values, ranges, examples.ecgs[training], rng
        )
        pairs.append(example(scaled_values, cosines_of(scaled_ecgs, count)))
    inputs, outputs = (
        np.concatenate(arrays).astype(np.float32) for arrays in zip(*pairs, strict=True)
    )
    all_inputs, free = emulator.inputs(values, tissues), ~examples.held_out
    validity_outputs = examples.kept[free][:, None].astype(np.float32)
    # two networks give the scores, which are averaged; the third gives the log odds of feasibility
    steps = max(200, epochs * len(inputs) // BATCH_EXAMPLES)
    *of_scores, of_validity = weights
    trainings = [partial(train, inputs, outputs, steps=steps, **begun) for begun in of_scores]
    of_validity |= {"width": 64, "link": logistic}
    trainings.append(partial(train, all_inputs[free], validity_outputs, steps=steps, **of_validity))
    report = stage_progress(progress, "training")
    *networks, validity = train_together(
        trainings, rng, lambda done: report(done, steps * len(trainings))
    )
    emulator = replace(emulator, networks=tuple(networks), validity=validity)
    return with_residuals(emulator, examples.of_the_prior, all_inputs)


def _untrained(names: tuple[str, ...], raw: Floats, ecgs: Floats, length: int) -> EcgEmulator:
    """Emulator without networks: scales of inputs (n, p), and components of ECGs, in cosines."""
    mean = ecgs.mean(axis=0)
    deviations = (ecgs - mean).reshape(len(ecgs), -1)
    # 6000 examples at most, since an SVD of all would take long
    components = np.linalg.svd(deviations[:6000], full_matrices=False)[2]
    components = components[:60]  # they leave a thousandth of the variance unexplained
    unit = float((deviations @ components.T).std())
    return EcgEmulator(
        names, raw.mean(axis=0), raw.std(axis=0) + 1e-9, (), NeuralNetwork(()), mean,
        components.reshape(-1, *mean.shape), unit, length, np.empty(0), np.empty(0), np.empty(0),
        {},
    )  # fmt: skip


def _check_examples(examples: Examples, names: tuple[str, ...], raw: Floats, fewest: int) -> None:
    """Refuse too few examples, and those in which a learnt quantity does not vary."""
    feasible, held_out = examples.feasible, examples.held_out[examples.feasible]
    if (~held_out).sum() < fewest or not held_out.any():
        raise InputError(
            f"only {feasible.sum()} of {len(feasible)} networks of the prior fit this heart; check "
            "the heart, narrow the ranges of the lengths, or give more prior_simulations"
        )
    if constant := [name for name, column in zip(names, raw.T, strict=False) if not np.ptp(column)]:
        part = PriorSimulations.part_size
        raise InputError(
            f"'{constant[0]}' is learnt, and has one value in every {part} prior simulations; give "
            f"prior_simulations of {10 * part} or more, or fix it"
        )


def cosine_count(length: int) -> int:
    """Number of cosines, up to `HIGHEST`, of an ECG of so many samples."""
    return max(2, round(2 * HIGHEST * length))


def cosines_of(ecgs: NDArray[Any], count: int) -> Floats:
    """Lowest cosines (..., count) of ECGs (..., length)."""
    return np.asarray(dct(ecgs, axis=-1, norm="ortho")[..., :count], dtype=float)


def _scaled_in_time(
    values: Mapping[str, Floats],
    ranges: Mapping[str, tuple[float, float]],
    ecgs: NDArray[np.float32],
    rng: np.random.Generator,
) -> tuple[dict[str, Floats], NDArray[np.float32]]:
    """Quantities and ECGs of hearts scaled in time by random factors c, within the ranges."""
    slowest, fastest = np.full(len(ecgs), 0.2), np.full(len(ecgs), 5.0)  # limits
    for name, value in values.items():
        low, high = ranges[name]
        if name in FASTER:
            slowest, fastest = np.maximum(slowest, low / value), np.minimum(fastest, high / value)
        elif name in SOONER:
            limit = np.where(value > 0, high, low)
            slowest = np.maximum(slowest, np.where(value == 0, 0, value / limit))
    scaling = np.exp(rng.uniform(np.log(slowest), np.log(np.maximum(fastest, slowest))))
    scaled = {
        n: v * scaling if n in FASTER else v / scaling if n in SOONER else v
        for n, v in values.items()
    }
    length = ecgs.shape[2]
    # samples between which the scaled ECG is interpolated
    position = np.clip(BEFORE + scaling[:, None] * (np.arange(length) - BEFORE), 0, length - 1)
    before = np.minimum(position.astype(int), length - 2)
    fraction = (position - before)[:, None].astype(np.float32)
    early, late = (np.take_along_axis(ecgs, k[:, None], axis=2) for k in (before, before + 1))
    return scaled, early * (1 - fraction) + late * fraction


def with_residuals(emulator: EcgEmulator, examples: Examples, inputs: Singles) -> EcgEmulator:
    """Add torso modes, residual covariance factors and report, by the held-out ECGs.

    Parameters
    ----------
    examples : Examples
        Examples of the prior.
    inputs : (n, p) array
        Standardised inputs of all examples.
    """
    held_out, count = examples.held_out, emulator.mean.shape[1]
    emulated = emulator.cosines(emulator.scores(inputs[held_out & examples.feasible]))
    in_torsos = cosines_of(examples.in_torsos, count)
    true = cosines_of(examples.ecgs[held_out[examples.feasible]], count)
    modes, factors = torso_modes_of(true, in_torsos, examples.torsos)
    mixing = np.einsum("hk,kab->hab", factors[examples.torsos], modes) + np.eye(true.shape[1])
    errors_in_torsos = in_torsos - mixing @ emulated
    factor, torso_factor = (
        emulator.residual_factor_of(errors, emulated)
        for errors in (errors_in_torsos, in_torsos - mixing @ true)
    )
    errors, squares = ((true - emulated) ** 2).sum(), (true**2).sum()
    spread = ((true - true.mean(axis=0)) ** 2).sum()
    log_odds, feasible = emulator.validity(inputs[held_out])[:, 0], examples.feasible[held_out]
    report = {
        "networks": float(len(examples.points)),
        "r_squared": 1 - float(errors / max(spread, 1e-12)),
        "error_in_bodies": float(np.sqrt((errors_in_torsos**2).sum() / squares)),
        "validity": float(((log_odds > 0) == feasible).mean()),
        **_relative_errors("error", true, emulated),
    }
    return replace(
        emulator,
        torso_modes=modes,
        residual_factor=factor,
        torso_residual_factor=torso_factor,
        report=report,
    )


@one_thread
def refined(
    emulator: EcgEmulator,
    inputs: Singles,
    ecgs: NDArray[np.float32],
    usual: Singles,
    rng: np.random.Generator,
    latest: int,
    progress: Progress | None = None,
    folds: int = 4,
) -> EcgEmulator:
    """Train the networks further on networks of a posterior, and replace the residuals by theirs.

    Parameters
    ----------
    inputs, ecgs : (n, p) and (n, 8 + k, length) arrays
        Standardised inputs and ECGs of networks of the posterior.
    usual : (n, p) array
        Standardised inputs throughout the prior, for which the outputs are to remain as before.
    latest : int
        Number of networks of the last round, at the end. They serve for cross-validation: each is
        held out once.
    folds : int
        Folds of the cross-validation.
    """
    if latest < folds:
        return emulator
    true = cosines_of(ecgs, emulator.mean.shape[1])
    flat = emulator.components.reshape(len(emulator.components), -1)
    scores = (true - emulator.mean).reshape(len(true), -1) @ flat.T / emulator.unit

    def tuned(network: NeuralNetwork, chosen: Booleans, rng: np.random.Generator) -> NeuralNetwork:
        all_inputs = np.concatenate([inputs[chosen], usual])
        outputs = np.concatenate([scores[chosen].astype(np.float32), network(usual)])
        steps = 20 * len(all_inputs) // BATCH_EXAMPLES  # every example is seen 20 times
        return train(all_inputs, outputs, rng, steps=steps, begin=network, rate=RATE / 2)

    fold = np.arange(len(inputs)) % folds
    fold[:-latest] = folds  # never held out
    trainings = [(network, fold != k) for k in range(folds + 1) for network in emulator.networks]
    networks, report = [], stage_progress(progress, "training", "on networks of the posterior")
    report(0, len(trainings))
    with ThreadPoolExecutor(2) as pool:
        for network in pool.map(tuned, *zip(*trainings, strict=True), rng.spawn(len(trainings))):
            networks.append(network)
            report(len(networks), len(trainings))
    count, emulated = len(emulator.networks), np.empty_like(true)
    for k in range(folds):
        without_fold = replace(emulator, networks=tuple(networks[k * count : (k + 1) * count]))
        emulated[fold == k] = without_fold.cosines(without_fold.scores(inputs[fold == k]))
    true, emulated = true[-latest:], emulated[-latest:]
    posterior_factor = emulator.residual_factor_of(true - emulated, emulated)
    return replace(
        emulator,
        networks=tuple(networks[-count:]),
        residual_factor=_factor(np.concatenate([posterior_factor, emulator.torso_residual_factor])),
        report={**emulator.report, **_relative_errors("error_of_posterior", true, emulated)},
    )


def _relative_errors(name: str, true: Floats, emulated: Floats) -> dict[str, float]:
    """Root mean square errors over that of the ECGs, of all leads together and by lead."""
    errors, squares = ((difference**2).sum(axis=(0, 2)) for difference in (true - emulated, true))
    leads = [*INDEPENDENT_LEADS, *map(str, range(len(errors) - len(INDEPENDENT_LEADS)))]
    errors_by_lead = {name: float(np.sqrt(errors.sum() / squares.sum()))}
    lead_errors = zip(leads, np.sqrt(errors / squares), strict=True)
    return errors_by_lead | {f"{name}_{lead}": float(error) for lead, error in lead_errors}


def _factor(rows: Floats) -> Floats:
    """Factor F (q, q) of the sum of the outer products of rows r (m, q): FᵀF = Σ rᵀr."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    return np.asarray(np.sqrt(np.maximum(values, 0))[:, None] * vectors.T)


def torso_modes_of(plain: Floats, in_torsos: Floats, numbers: Integers) -> tuple[Floats, Floats]:
    """Torso modes: matrices (k, 8 + a, 8 + a) on the leads, and factors (torsos, k) of each torso.

    Leads that see the same activation front from slightly different places are nearly linear
    combinations of one another, constant in time. Such combinations make up nine tenths of the
    energy that a torso adds.
    """
    rows = plain.shape[1]
    all_ecgs = plain.transpose(1, 0, 2).reshape(rows, -1)
    power = all_ecgs @ all_ecgs.T / all_ecgs.shape[1]
    power += 1e-3 * np.trace(power) / rows * np.eye(rows)  # ridge, as leads may be dependent
    torsos = max(PriorSimulations.torsos, int(numbers.max(initial=0)) + 1)
    root = np.linalg.cholesky(power)
    differences = np.zeros((torsos, rows, rows))
    for number in np.unique(numbers):
        plain_ecgs = plain[numbers == number].transpose(1, 0, 2).reshape(rows, -1)
        torso_ecgs = in_torsos[numbers == number].transpose(1, 0, 2).reshape(rows, -1)
        ridge = plain_ecgs @ plain_ecgs.T + 1e-3 * plain_ecgs.shape[1] * power
        differences[number] = np.linalg.solve(ridge, plain_ecgs @ (torso_ecgs - plain_ecgs).T).T
    # in uncorrelated leads of unit power, so that the largest modes add the most energy
    flat = (differences @ root).reshape(torsos, -1)
    factors, sizes, modes = np.linalg.svd(flat, full_matrices=False)
    sds = sizes[:TORSO_MODES] / np.sqrt(torsos)
    matrices = (
        sds[:, None, None] * modes[:TORSO_MODES].reshape(-1, rows, rows) @ np.linalg.inv(root)
    )
    return matrices, factors[:, :TORSO_MODES] * np.sqrt(torsos)
