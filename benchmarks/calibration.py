"""Calibration: how often the intervals of the networks hold the truth.

    python -m benchmarks.calibration --heart HEART --out FOLDER [--truths 100] [--processes 2]
                                     [--physics same|other] [--method posterior|paper]
                                     [--noise TARGET] [--wrong [--other-heart HEART]]

Truths are networks of the prior that no emulator has seen, with all that is unknown drawn as in
the prior simulations, each in a random torso. Each gives a recording: the simulated ECG
times a gain, ten beats with noise of 0.03 mV, and QRS marks that are off. A whole fit with default
settings follows, but with `--prior-simulations` networks. Where the truth lies among the draws is
kept (`truth-0007.json`), so that the same command goes on where it stopped, or adds truths. With
`--tuning` truths are others, to choose constants by.

With `--physics other` the truth is of another model than the one that is fitted: it is activated
on tetrahedra of half the edge length, with one more left fascicle in every second truth, fibres
turned by some 10 degrees in the wall, other anisotropy, a fast endocardial layer, and delays at the
junctions; its ECG is that of another torso, with the heart and the electrodes elsewhere and other
conductivities (`docs/quantities.md`; in an unbounded conductor, with electrodes off by some 10 mm
and 8 degrees). With `--noise` the beats differ
from their mean as those of a recorded target do.

With `--method paper` the truths have its parameters (α is fixed), no gain, and 300
beats that vary as recorded ones do (`examples.recover_known_network`): what the method takes for
granted.

All truths of a posterior are of the prior of the normal state, which is that of mapped hearts.

With `--wrong` each truth is fitted again with wrong inputs (`wrong_inputs`): gain 3, a chest lead
inverted, two electrodes exchanged, the speed along fibres beyond its range by half of that end,
half of the beats ectopic, and a truth of `--other-heart`, another person's; each with the one batch
of particles that a fit begins with, whether it converges or not. How many of each are called a poor
fit is printed, and how many of the right ones, which are false alarms.

Of the parameters and of four predictions: the total activation time; that with both roots fired
together, which no ECG of the fit has shown; where along the heart's longest axis the activation
ends; and the ECG's QRS duration. Of the activation map, the share of vertices whose time, from the
first activation on, lies within the interval at that vertex.

Printed are: coverage of the 50, 80 and 90 % intervals; for each quantity the largest distance of
the ranks' distribution from a uniform one, and what 95 % of calibrated methods stay below for all
quantities together; TARP (P. Lemos et al., "Sampling-based accuracy testing of posterior estimators
for general inference", ICML 2023); how many fits converged, and how often which alarm rang. The
figure (`calibration.png`) shows the ranks with the simultaneous band (T. Säilynoja et al.,
"Graphical test for discrete uniformity", Stat. Comput. 32, 2022). The prior of the heart is
simulated first
if there is none.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import textwrap
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

import fascicle
from examples.recover_known_network import synthetic_target
from fascicle.build.refinement import refined
from fascicle.cli.output import TerminalProgress
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.files import write_text
from fascicle.core.leads import (
    ELECTRODES,
    INDEPENDENT_LEADS,
    INDEPENDENT_ROWS,
    LIMB_LEADS,
    lead_matrix,
    limb_leads_from,
)
from fascicle.core.parameters import Infeasible, ParameterSpace
from fascicle.core.progress import Progress
from fascicle.core.quantities import parameter_name, stand_ins, torso_values
from fascicle.emulation.ecg_emulator import EcgEmulator
from fascicle.emulation.heart_emulator import (
    emulator_of,
    refined_emulators,
    simulations_for,
    usual_prior,
)
from fascicle.emulation.likelihood import EmulatedLikelihood, checked, likelihood_of
from fascicle.emulation.predictive import AXIS, DURATION, Checks, predict_recording
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.electrocardiogram import first_sample
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import read_scenarios
from fascicle.heart.heart import Heart
from fascicle.networks.prior import NOT_KNOWN, Prior, study_space
from fascicle.networks.prior_simulations import PriorSimulations, random_bodies
from fascicle.networks.settings import FitSettings, Method
from fascicle.networks.simulator import BeatMemory, PointSimulator
from fascicle.networks.target_comparison import Network, TargetComparison, evaluate
from fascicle.networks.target_comparison import networks as simulated
from fascicle.pools.pool import Threads
from fascicle.recording.target import Target, smooth_noise
from fascicle.recording.target_files import read_target
from fascicle.reporting.style import new_figure, save
from fascicle.study.evaluations import Database, Journal
from fascicle.study.methods import PaperFit, PosteriorFit
from fascicle.study.population import Population, Posterior
from fascicle.torso.conductor import torso_of

LEVELS = (0.5, 0.8, 0.9)
TUNING, HELD_OUT = 2, 3  # seeds of truths: for choosing constants, and for the documentation
BEATS, NOISE = 10, 0.03  # mV
BEATS_OF_THE_PAPER = 300  # five minutes
TURNED, OFF_ANGLE, OFF = 10.0, 8.0, 10.0  # degrees, degrees, mm; standard deviations
ONSET_SD, OFFSET_SD = 4.0, 5.0  # ms
FIRST_ACTIVATION_SD = 3.0  # ms; as in the likelihood
PAD = 100  # samples before and after the simulated ECG
COLUMNS, PANEL = 6, 1.6  # of the figure; inch
MAPPED = 60  # draws whose activation is simulated
NORMAL = CONDUCTION_STATES["normal"]  # whose networks are those of mapped hearts
SOURCES = ParameterSpace(tuple(p for p in NOT_KNOWN if p.name.endswith("_source")))
TORSO_GROUPS = ("pose", "electrodes", "conductivities")
PREDICTED = ("activation time", "with both roots together", "end along the axis", "QRS duration")
TITLES = {
    "activation time": "total activation time",
    "with both roots together": "total activation time, His pacing",
    "end along the axis": "site of the last activation",
    "TARP": "all parameters (TARP)",
}


def truth_of(model: ForwardModel, prior: Prior, rng: np.random.Generator) -> Any:
    """Parameters from the prior that give a network, and their simulation."""
    while True:
        point = rng.random(len(prior.space))
        outcome = model.simulate({**prior.fixed, **prior.space.from_unit(point)})
        if isinstance(outcome, Beat) and prior.keeps(point, model.surfaces, outcome):
            return point, outcome


def fired_together(values: Mapping[str, float]) -> dict[str, float]:
    """Parameters of a network whose roots fire at the same time."""
    replaced = {*stand_ins("root_time")}
    return {n: v for n, v in values.items() if n not in replaced} | {"root_time": 0.0}


@lru_cache(1)
def finer(heart: str) -> Heart:
    """The heart with tetrahedra of half the edge length; the coarse vertices come first."""
    coarse = fascicle.load_heart(heart)
    fine = refined(coarse)
    if not np.allclose(fine.vertices[: len(coarse.vertices)], coarse.vertices):
        raise ValueError("the vertices of the coarser mesh are not the first of the finer one")
    return fine


def turned(heart: Heart, degrees: float) -> Heart:
    """The heart with its fibres turned about the normal of the wall."""
    places, normals = [], []
    for endocardium in heart.endocardia:
        corners = endocardium.vertices[endocardium.triangles]
        normals.append(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        places.append(corners.mean(axis=1))
    centres = heart.vertices[heart.tetrahedra].mean(axis=1)
    nearest = cKDTree(np.concatenate(places)).query(centres)[1]
    axes = np.concatenate(normals)[nearest]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    fibres = Rotation.from_rotvec(np.radians(degrees) * axes).apply(heart.fibres)
    return replace(heart, fibres=fibres, folder=None)


def other_physics(
    heart: str,
    rng: np.random.Generator,
    mesh: Callable[[str], Heart] = finer,
    method: Method = "posterior",
) -> tuple[ForwardModel, Prior]:
    """A model of the heart other than the one that is fitted, and its prior."""
    fine = turned(mesh(heart), rng.normal(0, TURNED))
    if fine.lead_fields is not None:  # the ECG will be that of `another_torso`
        fine = replace(fine, lead_fields=None, torso=None)
    else:
        turn = Rotation.from_rotvec(np.radians(rng.normal(0, OFF_ANGLE / np.sqrt(3), 3)))
        centre = fine.vertices.mean(axis=0)
        moved = turn.apply(fine.electrodes - centre) + centre + rng.normal(0, OFF / np.sqrt(3), 3)
        fine = replace(fine, electrodes=moved)
    choices = {
        "anisotropy_ratio": rng.uniform(1.8, 3.5),
        "endocardial_layer": rng.uniform(1.0, 3.0),
        "endocardial_speed": rng.uniform(1.0, 2.0),
        "anterograde_delay": rng.uniform(0.0, 3.0),
        "lv_fascicles": (3 if method == "posterior" else 2) + int(rng.integers(2)),
        **SOURCES.from_unit(rng.random(len(SOURCES))),
    }
    return ForwardModel(fine), Prior(*study_space(method, choices, fine))


def another_torso(
    model: ForwardModel,
    simulation: Beat,
    count: int,
    rng: np.random.Generator,
    values: Mapping[str, float],
) -> Beat:
    """A simulation on a finer mesh, of which `count` vertices are the model's, in another torso.

    The sources of the ECG are those of its `values`.
    """
    sources = {name: values[name] for name in SOURCES.names if name in values}
    space, _ = study_space("posterior", dict.fromkeys(TORSO_GROUPS, "free"), model.heart)
    times = simulation.activation[:count]
    while True:
        torso = torso_values(space.from_unit(rng.random(len(space))))
        ecg = model.electrocardiograph_in_torso(torso | sources)
        if not isinstance(ecg, Infeasible):
            return replace(simulation, leads=ecg.leads(times), onset=first_sample(times))


def truth_of_prior(simulations: PriorSimulations, number: int, rng: np.random.Generator) -> Any:
    """Quantities of a network that no emulator has seen, and its simulation in a random torso."""
    model = simulations.model
    points, networks = simulations.points(number), simulations.parameters(number)
    for point, values in zip(points, networks, strict=True):
        outcome = model.simulate(values)
        if not isinstance(outcome, Beat):
            continue
        if simulations.prior.keeps(point, model.surfaces, outcome):
            (body,) = random_bodies(with_torso(model), rng, 1)
            body = model.with_sources(body, values)
            return values, replace(outcome, leads=body.leads(outcome.activation))
    raise ValueError("no network of the prior fits the heart")


@lru_cache(maxsize=1)
def with_torso(model: ForwardModel) -> ForwardModel:
    """Model of a heart whose torso is meshed once, not for each truth."""
    heart = model.heart
    if heart.lead_fields is None:
        return model
    return ForwardModel(replace(heart, torso=torso_of(heart)), prepared=model.prepared)


def recorded(
    simulation: Beat, gain_sd: float, rng: np.random.Generator, noise: np.ndarray | None = None
) -> Target:
    """A recording of a simulation.

    `noise` (n_leads, n) is that of another recording, of which each beat takes a part.
    """
    clean = rng.normal(1, gain_sd) * np.pad(
        simulation.leads[INDEPENDENT_ROWS], ((0, 0), (PAD, PAD))
    )
    times = np.arange(clean.shape[1]) - PAD + simulation.onset
    activated = simulation.activation[np.isfinite(simulation.activation)]
    first, last = float(activated.min()), float(activated.max())
    if noise is None:
        noises = smooth_noise(rng, (BEATS, *clean.shape), NOISE)
    else:
        starts = rng.integers(0, noise.shape[1] - clean.shape[1], BEATS)
        noises = np.stack([noise[:, start : start + clean.shape[1]] for start in starts])
    potentials = clean + noises
    onset = first + rng.normal(0, np.hypot(ONSET_SD, FIRST_ACTIVATION_SD))
    end = max(last + rng.normal(0, OFFSET_SD), onset + 40)
    twelve = np.concatenate([_limb(potentials[:, :2]), potentials[:, 2:]], axis=1)
    return Target(twelve, times, onset, end, 60.0, {}, ONSET_SD, OFFSET_SD)


def _limb(first_two: np.ndarray) -> np.ndarray:
    padded = np.zeros((len(first_two), len(LIMB_LEADS), first_two.shape[2]))
    padded[:, :2] = first_two
    return np.asarray(limb_leads_from(INDEPENDENT_LEADS) @ padded)


def residuals(target: Target) -> np.ndarray:
    """Deviations (8, n) of the beats of a recorded target from their mean, one after the other."""
    apart = (target.beats - target.mean)[:, INDEPENDENT_ROWS]
    return np.concatenate(list(np.concatenate([apart, apart[:, :, ::-1]])), axis=1)


def on_mesh(simulation: Beat, count: int) -> Beat:
    """Beat with the activation of the first vertices only, those of the coarser mesh."""
    return replace(simulation, coupled=Activation(simulation.activation[:count]))


def predictions(simulation: Beat, together: Beat, axis: np.ndarray) -> np.ndarray:
    """The scalars of `PREDICTED`."""
    time = simulation.activation - simulation.activation.min()
    late = together.activation
    strength = np.sqrt((simulation.leads**2).sum(axis=0))
    above = np.flatnonzero(strength > 0.05 * strength.max())
    return np.array(
        [time.max(), late.max() - late.min(), axis[np.argmax(time)], above[-1] - above[0]]
    )


def predicted_and_map(
    simulation: Beat, paced: Beat, axis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The scalars of `PREDICTED` of a truth, and its activation map on the heart's own mesh."""
    expected = predictions(on_mesh(simulation, len(axis)), on_mesh(paced, len(axis)), axis)
    return expected, simulation.activation[: len(axis)] - simulation.activation.min()


def longest_axis(heart: Heart) -> np.ndarray:
    """Coordinates (mm) of the vertices along the heart's longest axis."""
    centred = heart.vertices - heart.vertices.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred[::50], full_matrices=False)[2][0])


@lru_cache(1)
def prepared(heart_path: str, method: Method, count: int) -> tuple[Any, ...]:
    """Simulator, prior and emulator of a heart, and its longest axis, once a process."""
    threadpool_limits(1)
    heart = fascicle.load_heart(heart_path)
    model, axis = ForwardModel(heart), longest_axis(heart)
    if method == "paper":
        return PointSimulator(model, Prior.of(method, {}, heart)), None, None, axis
    simulator = normal_state(model)
    simulations = simulations_for(model, simulator.prior, heart.folder)
    return simulator, simulations, emulator_of(simulations, count, simulator.pool), axis


def normal_state(model: ForwardModel, processes: int = 1) -> PointSimulator:
    """Simulator of the networks of the normal state of a heart."""
    return PointSimulator(model, usual_prior(model.heart, NORMAL), Threads(processes))


def fitted(
    simulator: PointSimulator,
    recording: TargetComparison,
    settings: FitSettings,
    number: int,
    emulator: EcgEmulator | None,
) -> Population:
    """Fit a recording, in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        database = Database(Path(folder) / "evaluations.sqlite")
        database.prepare()
        objective = partial(evaluate, simulator, [recording])
        journal = Journal(database, objective, simulator.prior.dimension, number, 1)
        if emulator is None:
            return PaperFit(settings, simulator.prior.learnt, journal).run()
        emulated = [EmulatedLikelihood(simulator, emulator, recording.likelihood)]
        return PosteriorFit(settings, simulator.prior, journal, emulated).run()


def wrong_inputs(
    target: Target, rng: np.random.Generator, wrong: dict[str, Target]
) -> dict[str, Target]:
    """Recordings that no network of the heart gives, made of a right one and of `others`."""

    def of(beats: np.ndarray, **more: Any) -> Target:
        return replace(target, beats=beats, **more)

    inverted = np.ones((12, 1))
    inverted[rng.integers(6, 12)] = -1
    ectopic, half = wrong.pop("half ectopic"), len(target.beats) // 2
    time = target.time + ectopic.qrs_onset - target.qrs_onset
    moved = [[np.interp(time, ectopic.time, lead) for lead in beat] for beat in ectopic.beats]
    end = target.qrs_onset + max(target.qrs_duration, ectopic.qrs_duration)
    return {
        "gain 3": of(3 * target.beats),
        "lead inverted": of(inverted * target.beats),
        "electrodes exchanged": of(exchanged(rng) @ target.beats),
        "half ectopic": of(
            np.concatenate([target.beats[:half], moved[half:]]),
            qrs_offset=min(end, target.time[-1]),
        ),
        **wrong,
    }


def exchanged(rng: np.random.Generator) -> np.ndarray:
    """Matrix (12, 12) that changes leads as the exchange of two electrodes does."""
    matrix, order = lead_matrix(), np.arange(len(ELECTRODES))
    first, second = rng.choice(len(ELECTRODES), 2, replace=False)
    order[[first, second]] = second, first
    return np.asarray(matrix[:, order] @ np.linalg.pinv(matrix))


def one_truth(heart: str, number: int, options: argparse.Namespace) -> dict[str, Any]:
    """Make a truth, fit its recording, and rank the truth among the draws."""
    settings = FitSettings(prior_simulations=options.prior_simulations, method=options.method)
    of_paper = settings.method == "paper"
    gain_sd = 0.0 if of_paper else settings.gain_sd
    simulator, simulations, emulator, axis = prepared(
        heart, settings.method, options.prior_simulations
    )
    model, space = simulator.model, simulator.prior.learnt
    seed = TUNING if options.tuning else HELD_OUT
    rng, true = np.random.default_rng([seed, number]), model
    if options.physics == "other":
        true, prior = other_physics(heart, rng, method=settings.method)
        prior = prior if of_paper else prior.narrowed(NORMAL)
        point, simulation = truth_of(true, prior, rng)
        values = prior.from_unit(point)
        if model.heart.lead_fields is not None:
            simulation = another_torso(model, simulation, len(axis), rng, values)
    elif of_paper:
        point, simulation = truth_of(model, simulator.prior, rng)
        values = simulator.prior.from_unit(point)
    else:
        values, simulation = truth_of_prior(simulations, seed * 100_000 + number, rng)
    truth = {name: values[name] for name in space.names}

    def record(simulation: Beat) -> Target:
        noise = None if options.noise is None else residuals(read_target(options.noise))
        return recorded(simulation, gain_sd, rng, noise)

    begun = time.perf_counter()
    if of_paper:
        target = synthetic_target(simulation.leads, rng, BEATS_OF_THE_PAPER)
        comparison, trained = TargetComparison(target), emulator
    else:
        target = record(simulation)
        comparison, trained = compared(target, simulator, emulator, gain_sd, number)
    population, networks, checks = fit(simulator, comparison, settings, number, rng, trained)
    seconds = time.perf_counter() - begun
    result: dict[str, Any] = {"networks": len(population)}
    if networks:
        paced = true.simulate(fired_together(values))
        some = [networks[k] for k in rng.permutation(len(networks))[:MAPPED]]
        of_map = predicted_and_map(simulation, paced, axis)
        result |= places(simulator, population, some, (truth, *of_map), axis, rng)
    if isinstance(population, Posterior):
        result |= judged(checks) | {
            "converged": population.converged,
            "emulator": checks.emulator,
            "evaluations": population.evaluations.tolist(),
            "effective": population.effective.tolist(),
        }
    if options.wrong and not of_paper:
        speed = space.parameters[space.names.index("fibre_speed")]
        far = rng.choice([speed.lower / 1.5, speed.upper * 1.5])
        alternatives = {
            "fibre speed out of range": record(
                true.simulate({**values, "fibre_speed": float(far)})
            ),
            "half ectopic": record(true.simulate(values, ectopic())),
        }
        if options.other_heart is not None:
            other = other_person(options.other_heart)
            alternatives["another heart"] = record(truth_of(*other, rng)[1])
        result["wrong"] = {}
        most, PosteriorFit.most_batches = PosteriorFit.most_batches, 1
        for name, wrong in wrong_inputs(target, rng, alternatives).items():
            comparison, trained = compared(wrong, simulator, emulator, gain_sd, number)
            wrong_checks = fit(simulator, comparison, settings, number, rng, trained)[2]
            result["wrong"][name] = judged(wrong_checks)
        PosteriorFit.most_batches = most
    return result | {"seconds": seconds}


def judged(checks: Checks) -> dict[str, Any]:
    """Results of the checks of a fit."""
    return {
        "acceptable": checks.acceptable,
        "failures": checks.failures,
        "explained": checks.explained,
        "probabilities": dict(checks.probabilities),
    }


@lru_cache(1)
def other_person(heart: str) -> tuple[ForwardModel, Prior]:
    """Model and prior of another heart."""
    loaded = fascicle.load_heart(heart)
    return ForwardModel(loaded), Prior(*study_space("posterior", {}, loaded)).narrowed(NORMAL)


@lru_cache(1)
def ectopic() -> Scenario:
    (scenario,) = read_scenarios("pvc-rv-outflow").values()
    return scenario


def compared(
    target: Target, simulator: PointSimulator, emulator: EcgEmulator, gain_sd: float, number: int
) -> tuple[TargetComparison, EcgEmulator]:
    """A recording and its likelihood, and the emulator that is refined for it."""

    def likelihoods(emulators: Sequence[EcgEmulator]) -> list[EmulatedLikelihood]:
        (emulator,) = emulators
        likelihood = likelihood_of(target, emulator, gain_sd)
        return [EmulatedLikelihood(simulator, emulator, likelihood)]

    rng, count = np.random.default_rng([number, 3]), int(emulator.report["networks"])
    with tempfile.TemporaryDirectory() as folder:
        emulators = refined_emulators([emulator], likelihoods, [None], count, Path(folder), rng)
    likelihood = likelihoods(emulators)[0].likelihood
    return TargetComparison(target, likelihood=likelihood, free_gain=True), emulators[0]


def fit(
    simulator: PointSimulator,
    recording: TargetComparison,
    settings: FitSettings,
    number: int,
    rng: np.random.Generator,
    emulator: EcgEmulator | None,
) -> tuple[Population, list[Network], Checks | None]:
    """Population, its networks, and the checks of a posterior against the recording."""
    simulator = replace(simulator, memory=BeatMemory(kept=True))
    population = fitted(simulator, recording, settings, number, emulator)
    learnt = [population.parameters(k) for k in range(len(population))]
    networks, likelihood = list(simulated(simulator, recording, learnt)), recording.likelihood
    if likelihood is None:
        return population, networks, None
    likelihoods = [likelihood] * len(networks)
    checks = predict_recording(recording.target, likelihoods, networks, rng).checks
    emulated = [EmulatedLikelihood(simulator, emulator, likelihood)] * len(networks)
    return population, networks, checked(checks, emulated, networks)


def places(
    simulator: PointSimulator,
    population: Population,
    networks: list[Network],
    true: tuple[Any, np.ndarray, np.ndarray],
    axis: np.ndarray,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Ranks and scores of the truth (parameters, predictions, activation map) among networks."""
    truth, expected, true_map = true
    space = simulator.prior.learnt

    def together(values: Any) -> Beat:
        return simulator.model.simulate(fired_together({**simulator.prior.fixed, **values}))

    predicted = np.array([predictions(n.beat, together(n.parameters), axis) for n in networks])
    maps = np.array([n.beat.activation - n.beat.activation.min() for n in networks])
    draws = {name: population.values[name] for name in space.names}
    units = {p.name: p.to_unit(draws[p.name]) for p in space.parameters}
    at = {p.name: float(p.to_unit(np.array(truth[p.name]))) for p in space.parameters}
    return {
        "ranks": {
            **{name: _rank(draws[name], truth[name], rng) for name in space.names},
            **{name: _rank(predicted[:, k], expected[k], rng) for k, name in enumerate(PREDICTED)},
        },
        "map": [float(_within(maps, true_map, level)) for level in LEVELS],
        "tarp": _tarp(np.column_stack([*units.values()]), np.array([*at.values()]), rng),
        "crps": {name: _crps(units[name], at[name]) for name in units}
        | {name: _crps(predicted[:, k], expected[k]) for k, name in enumerate(PREDICTED)},
        "contraction": {n: float(1 - 12 * np.var(u)) for n, u in units.items()},
    }


def _rank(draws: np.ndarray, truth: float, rng: np.random.Generator) -> float:
    """Share of draws below the truth, with half an even chance for one more draw and for ties."""
    below, equal = (draws < truth).sum(), (draws == truth).sum()
    return float((below + rng.random() * (equal + 1)) / (len(draws) + 1))


def _crps(draws: np.ndarray, truth: float) -> float:
    """Continuous ranked probability score, in the unit of the draws."""
    apart = np.abs(np.subtract.outer(draws, draws)).mean() / 2
    return float(np.abs(draws - truth).mean() - apart)


def _within(maps: np.ndarray, truth: np.ndarray, level: float) -> float:
    lower, upper = np.quantile(maps, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return float(((truth >= lower) & (truth <= upper)).mean())


def _tarp(draws: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> float:
    """Share of draws that are nearer to a random reference point than the truth."""
    reference = rng.random(len(truth))
    apart = np.linalg.norm(draws - reference, axis=1)
    return _rank(apart, float(np.linalg.norm(truth - reference)), rng)


def coverage(ranks: np.ndarray, level: float) -> float:
    """Share of ranks within the central interval of a level."""
    return float((np.abs(ranks - 0.5) <= level / 2).mean())


def distance(ranks: np.ndarray) -> float:
    """Largest distance of the distribution of ranks from the uniform one (Kolmogorov)."""
    ordered, n = np.sort(ranks), len(ranks)
    return float(np.maximum(np.arange(1, n + 1) / n - ordered, ordered - np.arange(n) / n).max())


def simultaneous(count: int, quantities: int, rng: np.random.Generator) -> float:
    """Distance that 95 % of calibrated methods stay below in so many quantities at once."""
    drawn = [max(distance(rng.random(count)) for _ in range(quantities)) for _ in range(1000)]
    return float(np.quantile(drawn, 0.95))


def summarise(results: list[dict[str, Any]], folder: Path) -> None:
    """Print the tables and draw the figure."""
    none = sum(not r["networks"] for r in results)
    if none:
        print(f"{none} of {len(results)} truths: no network at all; they are left out below")
        results = [r for r in results if r["networks"]]
    names = list(results[0]["ranks"])
    ranks = {name: np.array([r["ranks"][name] for r in results]) for name in names}
    ranks["TARP"] = np.array([r["tarp"] for r in results])
    band = simultaneous(len(results), len(ranks), np.random.default_rng(0))
    print(f"{len(results)} truths; distance below {band:.3f} in all of {len(ranks)} quantities")
    print(
        f"{'':<26} {'50 %':>6} {'80 %':>6} {'90 %':>6} {'distance':>9} {'contraction':>12} "
        f"{'CRPS':>7}"
    )
    for name, values in ranks.items():
        shares = " ".join(f"{coverage(values, level):6.0%}" for level in LEVELS)
        narrowed = [r["contraction"][name] for r in results if name in r["contraction"]]
        mean = f"{np.mean(narrowed):12.2f}" if narrowed else f"{'':>12}"
        scores = [r["crps"][name] for r in results if name in r["crps"]]
        score = f"{np.mean(scores):7.3f}" if scores else ""
        print(f"{name:<26} {shares} {distance(values):9.3f} {mean} {score}")
    scores_of_truths = [np.mean([r["crps"][n] for n in r["contraction"]]) for r in results]
    error = np.std(scores_of_truths) / np.sqrt(len(scores_of_truths))
    narrowed = np.mean([[*r["contraction"].values()] for r in results])
    print(
        f"CRPS of parameters {np.mean(scores_of_truths):.4f} +- {error:.4f} of the prior, "
        f"contraction {narrowed:.2f}"
    )
    parameters = np.concatenate([ranks[name] for name in results[0]["contraction"]])
    predicted = np.concatenate([ranks[name] for name in PREDICTED])
    for name, values in (("all parameters", parameters), ("all predictions", predicted)):
        print(f"{name:<26} " + " ".join(f"{coverage(values, level):6.0%}" for level in LEVELS))
    maps = np.mean([r["map"] for r in results], axis=0)
    print(f"{'activation map, vertices':<26} " + " ".join(f"{share:6.0%}" for share in maps))
    if "acceptable" in results[0]:
        print(f"converged: {np.mean([r['converged'] for r in results]):.0%}")
        best = np.quantile([r["explained"] for r in results], (0.05, 0.5))
        print(
            "explained by the best networks: {:.0%} (a 20th below), {:.0%} (median)".format(*best)
        )
        off = np.quantile([np.divide(*r["emulator"]) for r in results], (0.5, 0.95))
        print(
            "emulator off, of what is expected: {:.2f} (median), {:.2f} (a 20th above)".format(*off)
        )
        for name in results[0]["probabilities"]:
            least = np.sort([r["probabilities"][name] for r in results])[:3]
            print(f"  {name}: least probable {', '.join(f'{p:.3g}' for p in least)}")
        called_poor("right inputs", results)
        for name in results[0].get("wrong", ()):
            called_poor(name, [r["wrong"][name] for r in results])
    for figure in ("evaluations", "effective"):
        if figure in results[0]:
            print(f"{figure}: {np.median([sum(r[figure]) for r in results]):.0f} (median)")
    print(
        f"networks: {np.median([r['networks'] for r in results]):.0f} (median), "
        f"{np.median([r['seconds'] for r in results]):.0f} s on one core"
    )
    _draw(ranks, band, folder / "calibration.png")


def called_poor(name: str, judged: list[dict[str, Any]]) -> None:
    """Print how many fits are called poor, and how often which failure comes first."""
    poor = [judgement["failures"][0] for judgement in judged if not judgement["acceptable"]]
    words = {DURATION: DURATION, AXIS: AXIS, "reproduced": "leads", "%": "share", "scaled": "gain"}
    first = Counter(next(kind for word, kind in words.items() if word in text) for text in poor)
    kinds = ", ".join(f"{kind} {count}" for kind, count in first.most_common())
    print(f"called poor, {name}: {len(poor)} of {len(judged)} ({kinds or 'none'})")


def _draw(ranks: dict[str, np.ndarray], band: float, path: Path) -> None:
    """Distribution of the ranks less the uniform one, one panel a quantity."""
    rows = -(-len(ranks) // COLUMNS)
    figure = new_figure(COLUMNS * PANEL, rows * PANEL)
    axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True)
    grid = np.linspace(0, 1, 101)
    for (name, values), panel in zip(ranks.items(), axes.flat, strict=False):
        panel.axhspan(-band, band, color="0.9")
        apart = np.searchsorted(np.sort(values), grid, side="right") / len(values) - grid
        panel.plot(grid, apart)
        panel.set_title(textwrap.fill(TITLES.get(name, parameter_name(name)), 24), fontsize=7)
        panel.set_ylim(-0.35, 0.35)
    for panel in list(axes.flat)[len(ranks) :]:
        panel.set_axis_off()
    figure.supxlabel("rank of the truth among the draws, share")
    figure.supylabel("share of truths below, less the share expected")
    save(figure, path)


def identify(options: argparse.Namespace, path: Path) -> None:
    """Keep the options that truths are made with, or refuse to mix them with others."""
    names = (
        "heart",
        "prior_simulations",
        "physics",
        "method",
        "noise",
        "wrong",
        "other_heart",
        "tuning",
    )
    made_with = {name: str(getattr(options, name)) for name in names}
    if not path.exists():
        write_text(path, json.dumps(made_with, indent=1) + "\n")
    elif json.loads(path.read_text()) != made_with:
        raise SystemExit(f"{path}: its truths were made with other options; choose another --out")


def _run(arguments: tuple[int, Path, argparse.Namespace]) -> int:
    number, path, options = arguments
    write_text(path, json.dumps(one_truth(options.heart, number, options), indent=1) + "\n")
    return number


def in_processes(
    work: Callable[[Any], Any],
    items: Sequence[Any],
    processes: int,
    progress: Progress,
    stage: str,
    before: int = 0,
) -> None:
    """Work on items in processes; `work` keeps its result. `before` items are done already."""
    with ProcessPoolExecutor(processes) as pool:
        for done, _ in enumerate(pool.map(work, items), before + 1):
            progress(stage, done, before + len(items), "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--truths", type=int, default=100)
    parser.add_argument(
        "--prior-simulations",
        type=int,
        default=FitSettings.model_fields["prior_simulations"].default,
    )
    parser.add_argument("--physics", choices=("same", "other"), default="same")
    parser.add_argument("--method", choices=("posterior", "paper"), default="posterior")
    parser.add_argument("--noise", type=Path, help="target whose beats differ as recorded ones do")
    parser.add_argument("--wrong", action="store_true", help="fit wrong inputs, too")
    parser.add_argument("--tuning", action="store_true", help="truths to choose constants by")
    parser.add_argument("--other-heart", help="heart of another person, for --wrong")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    identify(options, options.out / "settings.json")
    with TerminalProgress() as progress:
        if options.method == "posterior":
            heart = fascicle.load_heart(options.heart)
            simulator = normal_state(ForwardModel(heart, progress=progress), options.processes)
            simulations = simulations_for(simulator.model, simulator.prior, heart.folder)
            emulator_of(simulations, options.prior_simulations, simulator.pool, progress)
        if options.physics == "other" and fascicle.load_heart(options.heart).torso is not None:
            model = ForwardModel(fascicle.load_heart(options.heart), progress=progress)
            model.torso(TORSO_GROUPS)  # kept on disk, where each process finds it
        paths = [options.out / f"truth-{number:04d}.json" for number in range(options.truths)]
        left = [(number, path, options) for number, path in enumerate(paths) if not path.exists()]
        in_processes(_run, left, options.processes, progress, "truths", len(paths) - len(left))
    summarise([json.loads(path.read_text()) for path in paths], options.out)


if __name__ == "__main__":
    main()
