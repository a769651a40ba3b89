"""An emulator of a heart's ECG: small networks that learn it from the prior simulations.

ECGs are aligned at the first activation and described by their principal components. Networks give
the components from the parameters; another one gives the probability that parameters give a
network of the heart at all. What held-out ECGs in random bodies have beside the emulated ones is
all that the emulator does not say: its own error, the fine structure that growth leaves to chance,
and the body. That is the discrepancy of the likelihood (J. Kaipio and E. Somersalo, "Statistical
inverse problems: discretization, model reduction and inverse crimes", J. Comput. Appl. Math. 198,
2007).

A heart whose speeds are all c times as high, with root times and delays c times as short, has the
same ECG on a clock that is c times as fast. Every simulation therefore serves at several speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS, LEADS, limb_leads_from
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.quantities import DELAY
from fascicle.core.threads import one_thread
from fascicle.inference.emulator import (
    BATCH,
    RATE,
    Network,
    Singles,
    logistic,
    networks_from,
    train,
    train_together,
    weight_arrays,
)
from fascicle.study.prior_simulations import BEFORE, BODIES, PART, Examples
from fascicle.study.space import AveragedOver

NETWORKS = 2  # that are averaged
COMPONENTS = 60  # principal ones; they leave a thousandth of the variance
HIGHEST = 0.04  # cycles per ms; the likelihood looks at less
MODES = 4  # of the body
FEWEST = 50  # networks to learn from
COPIES = 4  # of an example at other speeds
EPOCHS = 12  # times that every example is seen
EPOCHS_ON = 20  # and one of a posterior
FOLDS = 4  # of the examples of a posterior: each is held out once
FASTER = ("alpha", "fibre_speed", "cv")  # c times as high
SMALL = ("mean", "components", "bodies", "left", "left_by_bodies")  # in single precision
SOONER = (*DELAY, "anterograde_delay", "retrograde_delay", "his_time")  # c times as short


@dataclass(frozen=True)
class EcgEmulator:
    """What networks learnt of a heart's ECG.

    Attributes
    ----------
    names : tuple of str
        Quantities that it depends on.
    centre, scale : arrays
        Of its inputs: the quantities, those of `FASTER` by their logarithms, and the tissue.
    networks, validity : sequence of Network, and Network
        Components, in `unit`; log odds that there is a network.
    mean, components : (8 + k, f) and (q, 8 + k, f) arrays
        Mean ECG (mV) and principal components, in cosines.
    unit : float
        Root mean square of the components (mV).
    length : int
        Samples (1 ms) of an ECG, which begins `BEFORE` the first activation.
    bodies : (k, 8 + a, 8 + a) array
        What another body adds to the independent leads: matrices, each with a factor that is
        standard normal over random bodies.
    left : (q, q) array
        What emulator and these do not say of held-out ECGs in random bodies, each over the norm of
        its emulated ECG: components, whose outer products add up to the mean one.
    left_by_bodies : (q, q) array
        The same of what `bodies` do not say of simulated ECGs.
    report : mapping of str to float
        Of held-out networks: share of the variance that it gives, root mean square error over that
        of the ECGs, in the plain body, by lead and in random bodies; how often it is right about
        whether there is a network.
    """

    names: tuple[str, ...]
    centre: Floats
    scale: Floats
    networks: tuple[Network, ...]
    validity: Network
    mean: Floats
    components: Floats
    unit: float
    length: int
    bodies: Floats
    left: Floats
    left_by_bodies: Floats
    report: Mapping[str, float]

    @property
    def said(self) -> str:
        """How good it is for held-out networks."""
        report = self.report
        leads = sorted((error, name) for name, error in report.items() if "error_V" in name)
        (least, best), (most, worst) = leads[0], leads[-1]
        return (
            f"held-out ECGs: R² {report['r_squared']:.2f}, {report['error']:.0%} off ({least:.0%} "
            f"{best[6:]} to {most:.0%} {worst[6:]}; {report['error_in_bodies']:.0%} in bodies)"
        )

    @property
    def expected_error(self) -> float:
        """Root mean square error that a posterior's networks should have, over that of the ECGs."""
        return self.report.get("error_of_posterior", self.report["error"])

    def scores(self, inputs: Singles) -> Singles:
        """Components (n, q) in `unit` of inputs (n, p) that `inputs` has made."""
        return np.asarray(np.mean([network(inputs) for network in self.networks], axis=0))

    def log_validity(self, inputs: Singles) -> Floats:
        """Logarithm of the probability that there is a network, (n,)."""
        odds = self.validity(inputs)[:, 0].astype(float)
        return np.asarray(-np.logaddexp(0.0, -odds))

    def inputs(self, values: Mapping[str, Floats], tissues: Floats) -> Singles:
        """Inputs (n, p) of quantities (n,) by name, and of tissues (n, t) (`tissue_inputs`)."""
        raw = _raw(self.names, values, tissues)
        return np.asarray((raw - self.centre) / self.scale, dtype=np.float32)

    def cosines(self, scores: NDArray[Any]) -> Floats:
        """ECGs (n, 8 + k, f) in cosines, of scores (n, q)."""
        return np.asarray(self.mean + np.tensordot(self.unit * scores, self.components, 1))

    def root_of(self, errors: Floats, emulated: Floats) -> Floats:
        """Components (q, q) of errors over the norms of emulated ECGs, as `left` has them."""
        flat = self.components.reshape(len(self.components), -1)
        norms = np.sqrt((emulated**2).sum(axis=(1, 2)))
        rows = errors.reshape(len(errors), -1) @ flat.T / norms[:, None]
        return _root(rows / np.sqrt(len(rows)))

    @cached_property
    def series(self) -> Floats:
        """Components as leads (q, 12 + k, length), as one unit of scores gives them (mV)."""
        return np.asarray(self.unit * _in_time(self.components, self.length))

    @cached_property
    def mean_leads(self) -> Floats:
        """Mean ECG in all leads (12 + k, length) (mV)."""
        return np.asarray(_in_time(self.mean[None], self.length)[0])

    @cached_property
    def bodies_of_all_leads(self) -> Floats:
        """`bodies` of all leads, (k, 12 + a, 12 + a)."""
        whole = all_leads(np.eye(self.bodies.shape[1]))
        rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(whole))]
        found = np.zeros((len(self.bodies), len(whole), len(whole)))
        found[:, :, rows] = whole @ self.bodies
        return found

    @cached_property
    def left_leads(self) -> Floats:
        """What the emulator does not say, (q, 12 + k, length), of ECGs of unit norm."""
        return _in_time(np.einsum("hq,qlf->hlf", self.left, self.components), self.length)

    def arrays(self) -> dict[str, Any]:
        """All of it for a file; the weights in half precision."""
        found: dict[str, Any] = {}
        for each in fields(self):
            value = getattr(self, each.name)
            if each.name in ("networks", "validity"):
                group = value if each.name == "networks" else (value,)
                found |= weight_arrays(each.name, group)
            elif each.name == "report":
                found |= {f"report {name}": number for name, number in value.items()}
            elif each.name in SMALL:
                found[each.name] = value.astype(np.float32)
            else:
                found[each.name] = value
        return found

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> EcgEmulator:
        """The inverse of `arrays`."""
        parts = {n: np.asarray(arrays[n]) for n in ("centre", "scale")}
        parts |= {name: np.asarray(arrays[name], float) for name in SMALL}
        (validity,) = networks_from("validity", arrays)
        return cls(
            names=tuple(map(str, arrays["names"])),
            unit=float(arrays["unit"]),
            length=int(arrays["length"]),
            networks=networks_from("networks", arrays),
            validity=validity,
            report={
                name.removeprefix("report "): float(arrays[name])
                for name in arrays
                if name.startswith("report ")
            },
            **parts,
        )


def tissue_inputs(averaged: AveragedOver, plain_ratio: float) -> Floats:
    """What an emulator is told of each tissue: anisotropy, and how much a layer hastens.

    Shape (n_tissues, 2), or (1, 0) where there is but one.
    """
    if len(averaged.tissues) == 1:
        return np.empty((1, 0))
    ratios = [tissue.get("anisotropy_ratio", plain_ratio) for tissue in averaged.tissues]
    hastened = [
        tissue.get("endocardial_layer", 0.0) * (tissue.get("endocardial_speed", 1.0) ** 2 - 1)
        for tissue in averaged.tissues
    ]
    return np.column_stack([np.log(ratios), hastened])


def _raw(names: tuple[str, ...], values: Mapping[str, Floats], tissues: Floats) -> Floats:
    columns = [np.log(values[n]) if n in FASTER else values[n] for n in names]
    return np.column_stack([*columns, tissues])


def _in_time(cosines: Floats, length: int) -> Floats:
    """Independent leads in cosines (n, 8 + k, f) as all leads in time (n, 12 + k, length)."""
    padded = np.pad(cosines, ((0, 0), (0, 0), (0, length - cosines.shape[2])))
    ecg = idct(padded, axis=2, norm="ortho")
    return np.asarray([all_leads(each) for each in ecg])


def all_leads(independent: Floats) -> Floats:
    """All leads (12 + a, n) from the independent ones (8 + a, n)."""
    limb = limb_leads_from(INDEPENDENT_LEADS)
    assert limb is not None
    return np.concatenate([limb[:, :2] @ independent[:2], independent[2:]])


@one_thread
def learn(
    examples: Examples,
    space: ParameterSpace,
    averaged: AveragedOver,
    plain_ratio: float,
    rng: np.random.Generator,
    *,
    same_on_any_clock: bool = True,
    progress: Progress | None = None,
) -> EcgEmulator:
    """Train an emulator on the examples that are not held out.

    Parameters
    ----------
    plain_ratio : float
        Speed along over across the fibre in the plain tissue.
    same_on_any_clock : bool
        Whether faster hearts are the same on another clock: not where a scenario has times.
    """
    learnt, rest = np.split(examples.points, [len(space)], axis=1)
    values = space.columns(learnt) | averaged.columns(rest)
    values.pop("gain", None)  # a factor on the ECG
    tissues, names = tissue_inputs(averaged, plain_ratio)[averaged.tissue(rest)], tuple(values)
    raw = _raw(names, values, tissues)
    _refuse(examples, names, raw)
    made, count = examples.feasible, max(2, round(2 * HIGHEST * examples.ecgs.shape[2]))
    begin = np.flatnonzero(~examples.held_out[made])
    cosines = cosines_of(examples.ecgs, count)
    mean = cosines[begin].mean(axis=0)
    flat = (cosines[begin] - mean).reshape(len(begin), -1)
    components = np.linalg.svd(flat[:6000], full_matrices=False)[2][:COMPONENTS]
    unit = float((flat @ components.T).std())
    emulator = EcgEmulator(
        names, raw.mean(axis=0), raw.std(axis=0) + 1e-9, (), Network(()), mean,
        components.reshape(-1, *mean.shape), unit, examples.ecgs.shape[2], np.empty(0),
        np.empty(0), np.empty(0), {},
    )  # fmt: skip

    def lesson(values: Mapping[str, Floats], ecgs: Floats) -> tuple[Singles, Floats]:
        apart = (ecgs - mean).reshape(len(ecgs), -1)
        return emulator.inputs(values, tissues[made][begin]), apart @ components.T / unit

    here = {name: value[made][begin] for name, value in values.items()}
    ends = {p.name: (p.lower, p.upper) for p in (*space.parameters, *averaged.space.parameters)}
    lessons = [lesson(here, cosines[begin])]
    clocks = "cv" in names and {*DELAY} & {*names} and {*FASTER[:2]} & {*names}
    for _ in range(COPIES if same_on_any_clock and clocks else 0):
        others, ecgs = _on_another_clock(here, ends, examples.ecgs[begin], rng)
        lessons.append(lesson(others, cosines_of(ecgs, count)))
    seen, wanted = (np.concatenate(each).astype(np.float32) for each in zip(*lessons, strict=True))
    every, free = emulator.inputs(values, tissues), ~examples.held_out
    known = examples.kept[free][:, None].astype(np.float32)
    *networks, validity = _trained(seen, wanted, every[free], known, rng, progress)
    emulator = replace(emulator, networks=tuple(networks), validity=validity)
    return _with_what_is_left(emulator, examples.of_the_prior, count, every)


def _refuse(examples: Examples, names: tuple[str, ...], raw: Floats) -> None:
    """Refuse examples from which nothing can be learnt, or not of every quantity."""
    made, held_out = examples.feasible, examples.held_out[examples.feasible]
    if (~held_out).sum() < FEWEST or not held_out.any():
        raise InputError(
            f"only {made.sum()} of {len(made)} networks of the prior fit this heart; check the "
            "heart, narrow the ranges of the lengths, or give more prior_simulations"
        )
    if constant := [name for name, column in zip(names, raw.T, strict=False) if not np.ptp(column)]:
        raise InputError(
            f"'{constant[0]}' is learnt, and has one value in every {PART} prior simulations; give "
            f"prior_simulations of {10 * PART} or more, or fix it"
        )


def _trained(
    seen: Singles,
    wanted: Singles,
    every: Singles,
    known: Singles,
    rng: np.random.Generator,
    progress: Progress | None,
) -> list[Network]:
    """Networks of the components, and last that of whether there is a network."""
    steps = max(200, EPOCHS * len(seen) // BATCH)
    of_components = partial(train, seen, wanted, steps=steps)
    of_validity = partial(train, every, known, width=64, steps=steps, link=logistic)
    trainings, report = (
        [of_components] * NETWORKS + [of_validity],
        stage_progress(progress, "training"),
    )
    return train_together(trainings, rng, lambda done: report(done, steps * len(trainings)))


def cosines_of(ecgs: NDArray[Any], count: int) -> Floats:
    """The lowest cosines (..., count) of ECGs (..., length)."""
    return np.asarray(dct(ecgs, axis=-1, norm="ortho")[..., :count], dtype=float)


def _on_another_clock(
    values: Mapping[str, Floats],
    ends: Mapping[str, tuple[float, float]],
    ecgs: NDArray[np.float32],
    rng: np.random.Generator,
) -> tuple[dict[str, Floats], NDArray[np.float32]]:
    """The same hearts, each at other speeds within the ranges, and their ECGs."""
    slowest, fastest = np.full(len(ecgs), 0.2), np.full(len(ecgs), 5.0)
    for name, value in values.items():
        low, high = ends[name]
        if name in FASTER:
            slowest, fastest = np.maximum(slowest, low / value), np.minimum(fastest, high / value)
        elif name in SOONER:
            end = np.where(value > 0, high, low)
            slowest = np.maximum(slowest, np.where(value == 0, 0, value / end))
    clock = np.exp(rng.uniform(np.log(slowest), np.log(np.maximum(fastest, slowest))))
    changed = {
        n: v * clock if n in FASTER else v / clock if n in SOONER else v for n, v in values.items()
    }
    length = ecgs.shape[2]
    place = np.clip(BEFORE + clock[:, None] * (np.arange(length) - BEFORE), 0, length - 1)
    before = np.minimum(place.astype(int), length - 2)
    share = (place - before)[:, None].astype(np.float32)
    early, late = (np.take_along_axis(ecgs, k[:, None], axis=2) for k in (before, before + 1))
    return changed, early * (1 - share) + late * share


def _with_what_is_left(
    emulator: EcgEmulator, examples: Examples, count: int, inputs: Singles
) -> EcgEmulator:
    """The same with what held-out ECGs have beside the emulated ones, and a report."""
    held_out = examples.held_out
    emulated = emulator.cosines(emulator.scores(inputs[held_out & examples.feasible]))
    in_bodies = cosines_of(examples.in_bodies, count)
    true = cosines_of(examples.ecgs[held_out[examples.feasible]], count)
    bodies, factors = body_modes(true, in_bodies, examples.bodies)
    mixed = np.einsum("hk,kab->hab", factors[examples.bodies], bodies) + np.eye(true.shape[1])
    errors_in_bodies = in_bodies - mixed @ emulated
    left, left_by_bodies = (
        emulator.root_of(errors, emulated)
        for errors in (errors_in_bodies, in_bodies - mixed @ true)
    )
    errors, squares = ((true - emulated) ** 2).sum(), (true**2).sum()
    spread = ((true - true.mean(axis=0)) ** 2).sum()
    odds, there = emulator.validity(inputs[held_out])[:, 0], examples.feasible[held_out]
    report = {
        "networks": float(len(examples.points)),
        "r_squared": 1 - float(errors / max(spread, 1e-12)),
        "error_in_bodies": float(np.sqrt((errors_in_bodies**2).sum() / squares)),
        "validity": float(((odds > 0) == there).mean()),
        **_errors("error", true, emulated),
    }
    return replace(emulator, bodies=bodies, left=left, left_by_bodies=left_by_bodies, report=report)


@one_thread
def trained_on(
    emulator: EcgEmulator,
    inputs: Singles,
    ecgs: NDArray[np.float32],
    usual: Singles,
    rng: np.random.Generator,
    latest: int,
) -> EcgEmulator:
    """Train the networks on, where a posterior lies; what is left is then what is left there.

    Parameters
    ----------
    inputs, ecgs : (n, p) and (n, 8 + k, length) arrays
        Of networks of the posterior.
    latest : int
        The last ones, each of which is held out once.
    usual : (n, p) array
        Inputs all over the prior, where the outputs are to stay as they are.
    """
    if latest < FOLDS:
        return emulator
    true = cosines_of(ecgs, emulator.mean.shape[1])
    flat = emulator.components.reshape(len(emulator.components), -1)
    scores = (true - emulator.mean).reshape(len(true), -1) @ flat.T / emulator.unit

    def on(network: Network, chosen: Booleans, rng: np.random.Generator) -> Network:
        seen = np.concatenate([inputs[chosen], usual])
        wanted = np.concatenate([scores[chosen].astype(np.float32), network(usual)])
        steps = EPOCHS_ON * len(seen) // BATCH
        return train(seen, wanted, rng, steps=steps, begin=network, rate=RATE / 2)

    fold = np.arange(len(inputs)) % FOLDS
    fold[:-latest] = FOLDS  # always seen
    asked = [(network, fold != k) for k in range(FOLDS + 1) for network in emulator.networks]
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(on, *zip(*asked, strict=True), rng.spawn(len(asked))))
    count, emulated = len(emulator.networks), np.empty_like(true)
    for k in range(FOLDS):
        others = replace(emulator, networks=tuple(found[k * count : (k + 1) * count]))
        emulated[fold == k] = others.cosines(others.scores(inputs[fold == k]))
    true, emulated = true[-latest:], emulated[-latest:]
    local = emulator.root_of(true - emulated, emulated)
    return replace(
        emulator,
        networks=tuple(found[-count:]),
        left=_root(np.concatenate([local, emulator.left_by_bodies])),
        report={**emulator.report, **_errors("error_of_posterior", true, emulated)},
    )


def _errors(name: str, true: Floats, emulated: Floats) -> dict[str, float]:
    """Root mean square errors over that of the ECGs, of all leads and of each."""
    errors, squares = ((each**2).sum(axis=(0, 2)) for each in (true - emulated, true))
    leads = [*INDEPENDENT_LEADS, *map(str, range(len(errors) - len(INDEPENDENT_LEADS)))]
    found = {name: float(np.sqrt(errors.sum() / squares.sum()))}
    each = zip(leads, np.sqrt(errors / squares), strict=True)
    return found | {f"{name}_{lead}": float(error) for lead, error in each}


def _root(rows: Floats) -> Floats:
    """Rows, as many as columns, whose outer products add up to the same."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    return np.asarray(np.sqrt(np.maximum(values, 0))[:, None] * vectors.T)


def body_modes(plain: Floats, in_bodies: Floats, numbers: Integers) -> tuple[Floats, Floats]:
    """What bodies add to the leads: matrices (k, 8 + a, 8 + a), and factors (bodies, k) of each.

    Leads that see the same front from slightly elsewhere are nearly sums of one another, at all
    times the same: of the energy that a body adds that is nine tenths.
    """
    rows = plain.shape[1]
    every = plain.transpose(1, 0, 2).reshape(rows, -1)
    power = every @ every.T / every.shape[1]
    power += 1e-3 * np.trace(power) / rows * np.eye(rows)
    root, found = np.linalg.cholesky(power), np.zeros((BODIES, rows, rows))
    for number in np.unique(numbers):
        here = plain[numbers == number].transpose(1, 0, 2).reshape(rows, -1)
        there = in_bodies[numbers == number].transpose(1, 0, 2).reshape(rows, -1)
        ridge = here @ here.T + 1e-3 * here.shape[1] * power
        found[number] = np.linalg.solve(ridge, here @ (there - here).T).T
    # in leads of unit power that are not correlated, so that the largest modes add the most
    flat = (found @ root).reshape(BODIES, -1)
    factors, sizes, modes = np.linalg.svd(flat, full_matrices=False)
    sds = sizes[:MODES] / np.sqrt(BODIES)
    bodies = sds[:, None, None] * modes[:MODES].reshape(-1, rows, rows) @ np.linalg.inv(root)
    return bodies, factors[:, :MODES] * np.sqrt(BODIES)
