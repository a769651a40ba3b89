"""Probability of each conduction state, by a classifier of a heart's simulated recordings.

Each state has prior simulations of its own. The classifier is made once for each heart, and kept
with it; the packaged hearts share one, trained on simulated recordings of all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Integers
from fascicle.core.conduction_states import ConductionState, told_apart
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS
from fascicle.core.parameters import FREE
from fascicle.core.progress import Lines, Progress, part_of_stage, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.emulation.ecg_classifier import (
    LENGTH,
    EcgClassifier,
    Recorder,
    RecordingSet,
    classified_rows,
    in_leads,
    learn,
)
from fascicle.emulation.heart_emulator import (
    for_simulations,
    learnt_or_made,
    made_emulator,
    simulations_of,
    usual_prior,
)
from fascicle.emulation.recalibration import (
    Recalibration,
    features_of,
    recalibration_of,
    simulated_state,
)
from fascicle.forward.model import ForwardModel
from fascicle.forward.preparation import compile_kernels
from fascicle.heart.heart import Heart
from fascicle.inference.emulator import Singles
from fascicle.networks.prior import Prior, state_label
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.pools.pool import Pool
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target


@dataclass(frozen=True)
class StateSimulations:
    """Prior simulations of a conduction state, and how many of them are used."""

    state: ConductionState
    simulations: PriorSimulations
    # to learn its emulator from: a study's number for a mapped prior, to which many do not belong;
    # else half
    count: int
    fewest: ClassVar[int] = 100  # least number of simulations of a state to learn from

    @classmethod
    def of(
        cls, state: ConductionState, model: ForwardModel, prior: Prior, folder: Path, count: int
    ) -> StateSimulations:
        """Prior simulations of one state of a prior that holds all states."""
        narrowed = prior.narrowed(state)
        half = max(count // 2, 100)  # 100: the least that a fit accepts
        simulations = simulations_of(model, narrowed, folder)
        return cls(state, simulations, count if narrowed.mapped else half)

    @property
    def few(self) -> int:
        """Number to tell the state from others by: half, unless many do not belong to the prior.

        More than 500 networks of each state hardly tell them apart better.
        """
        return self.count if self.simulations.prior.mapped else max(self.count // 2, self.fewest)

    @property
    def content(self) -> str:
        """Text that identifies all that the simulations depend on."""
        return f"{self.state.name} {self.simulations.content}"

    def ecgs(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Training ECGs of the state, and held-out ECGs in random torsos."""
        examples = self.simulations.examples(self.count, LENGTH).of_the_prior
        independent = slice(len(INDEPENDENT_LEADS))
        training_ecgs = examples.ecgs[~examples.held_out[examples.feasible], independent]
        held_out_ecgs = examples.in_torsos[:, independent]
        if len(training_ecgs) < self.fewest or not len(held_out_ecgs):
            raise InputError(
                f"only {len(training_ecgs)} networks of the prior of '{self.state.name}' fit this "
                "heart; give more prior_simulations, or a prior of the other states"
            )
        return training_ecgs, held_out_ecgs


def probabilities(
    classifier: EcgClassifier,
    states: Iterable[str],
    priors: Mapping[str, float],
    target: Target,
    recalibration: Recalibration | None = None,
) -> dict[str, float]:
    """Posterior probabilities of states by a classifier that was trained on `states`.

    A recalibration, which has learnt how common states are, names fascicular blocks, too. It is
    weighted by the priors over the default ones; that of a fascicular block is that of normal.
    """
    likely = dict(zip(states, classifier.probabilities(target), strict=True))
    if recalibration is not None:
        features = features_of(target, likely)
        likely = {name: p[0] for name, p in recalibration.probabilities(features).items()}
        default = {state.name: state.probability for state in told_apart()}
        priors = {name: p / default[name] for name, p in priors.items()}
    products = {
        name: p * priors[simulated_state(name)]
        for name, p in likely.items()
        if simulated_state(name) in priors
    }
    total = sum(products.values())
    return {name: float(p / total) for name, p in products.items()}


@dataclass(frozen=True)
class NoStateNamed:
    """Outcome for a recording of which no conduction state is named, with the reason.

    Attributes
    ----------
    reason : str
        Reason in a line.
    unreliable : mapping of str to float
        Probabilities by the classifier, whose reliability for such a recording is unknown.
    """

    reason: str
    unreliable: Mapping[str, float]

    def __str__(self) -> str:
        return f"no conduction state is named: {self.reason}"


def state_probabilities(
    heart: Heart | Path | str,
    target: Target | Path | str,
    priors: Any = FREE,
    *,
    parameters: Mapping[str, Any] | None = None,
    prior_simulations: int | None = None,
    workers: int | None = None,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
) -> Mapping[str, float] | NoStateNamed:
    """Estimate the probability of each conduction state, without a fit.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    target : Target or path
        A recording of the intrinsic beat.
    priors : mapping of str to float, optional
        Prior probabilities of the states; by default their prevalence in adults who are referred
        for an ECG (`fascicle.core.conduction_states`). Of the heart ``"atlas"`` states are named as
        cardiologists do, fascicular blocks among them (`fascicle.emulation.recalibration`), and the
        prior of normal is that of these, too.
    parameters : mapping of name to value, optional
        Quantities with other priors, or fixed, as in `fascicle.fit`; its ``"conduction"`` replaces
        `priors`. Prior simulations of these are made once for each heart.
    prior_simulations, workers, progress, pool
        As in `fascicle.locate`: a heart of your own is simulated once.

    Returns
    -------
    mapping of str to float, or NoStateNamed
        Probabilities, which add up to 1; or the reason why no state is named.

    Raises
    ------
    InputError
        If the heart, the target, a parameter or the priors of states cannot be used.

    Examples
    --------
    >>> import fascicle
    >>> fascicle.state_probabilities("HEART", "target.nc")  # doctest: +SKIP
    """
    heart, folder, count, pool = for_simulations(
        heart, prior_simulations, "prior_simulations", workers, pool
    )
    target = as_target(target)
    check_kind(parameters, (Mapping, NoneType), "parameters", "a dict of names to values")
    choices = {"conduction": priors, **(parameters or {})}
    conduction = choices.pop("conduction")
    prior = Prior.of("posterior", choices, heart)
    states = prior.possible_states(conduction, heart)
    state_priors = {state.name: state.probability for state in states}
    if untold := {*state_priors} - {state.name for state in told_apart()}:
        raise InputError(
            f"priors: '{min(untold)}' is not told apart from normal; give others, or leave them out"
        )
    with shown_progress(progress) as shown:
        compile_kernels(shown)
        model = ForwardModel(heart, progress=shown)
        simulations = simulations_of_states(model, prior, folder, count)
        rows = classified_rows(target)
        classifier = classifier_of(simulations, rows, folder, count, pool, shown)
    recalibration = recalibration_of(heart, target, simulations)
    probable = probabilities(classifier, simulations, state_priors, target, recalibration)
    if reason := unlike(classifier, target, recalibration):
        return NoStateNamed(reason, probable)
    return {state_label(name, probable): p for name, p in probable.items()}


def unlike(
    classifier: EcgClassifier, target: Target, recalibration: Recalibration | None = None
) -> str:
    """Reason why a recording is unlike the training set of a classifier; empty if it is not.

    A recalibration says how far people's recordings are; without one, the share of energy outside
    the components must not be more than in simulated recordings.
    """
    if recalibration is not None:
        (distance,) = classifier.distance(classifier.cosines(target))
        if distance <= recalibration.farthest:
            return ""
        return (
            f"the recording is unlike all simulated ones (squared distance {distance:.0f}, in 99% "
            f"of people {recalibration.farthest:.0f} at most)"
        )
    assert classifier.most_unexplained is not None
    (unexplained,) = classifier.unexplained(classifier.cosines(target))
    if unexplained <= classifier.most_unexplained:
        return ""
    return (
        f"the recording is unlike all simulated ones of this heart ({unexplained:.0%} of its QRS, "
        f"{classifier.most_unexplained:.0%} at most expected)"
    )


def simulations_of_states(
    model: ForwardModel, prior: Prior, folder: Path, count: int
) -> dict[str, StateSimulations]:
    """Prior simulations of all states that the learnt and fixed quantities do not exclude.

    Simulations of the heart's default priors, of all states, are used if they cover those
    quantities in every state.
    """
    usual_states = _of_possible_states(model, usual_prior(model.heart), folder, count)
    states = _of_possible_states(model, prior, folder, count)
    if all(
        name in usual_states
        and usual_states[name].simulations.prior.covers(state.simulations.prior)
        for name, state in states.items()
    ):
        return usual_states
    return states


def _of_possible_states(
    model: ForwardModel, prior: Prior, folder: Path, count: int
) -> dict[str, StateSimulations]:
    """Prior simulations of the states that a prior allows, by name."""
    possible = prior.possible_states(FREE, model.heart)
    return {
        state.name: StateSimulations.of(state, model, prior, folder, count) for state in possible
    }


def classifier_of(
    states: Mapping[str, StateSimulations],
    rows: Integers,
    folder: Path,
    count: int,
    pool: Pool,
    progress: Progress | None = None,
) -> EcgClassifier:
    """Classifier of states by the leads `rows`: packaged, kept with the heart, or trained."""

    def make() -> Mapping[str, Any]:
        simulated = {name: replace(state, count=state.few) for name, state in states.items()}
        total, before = sum(state.count for state in simulated.values()), 0
        # more steps do not help with few networks
        steps = int(np.clip(total // 2, 2000, 8000))
        for number, (name, state) in enumerate([*simulated.items()], 1):
            message = f"{name} ({number} of {len(states)} states)"
            others = total - state.count
            watched = part_of_stage(progress, "prior simulations", before, others)
            count = state.simulations.simulate_enough(state.count, pool, watched, message)
            simulated[name] = replace(state, count=count)
            total, before = others + count, before + count
        rng = np.random.default_rng(PriorSimulations.seed)
        sets = training_and_held_out(simulated, rows, rng, 5 * steps)
        arrays: Mapping[str, Any] = learn(*sets, rows, rng, progress, steps).arrays()
        return arrays

    stored = learnt_or_made("classifier", classifier_key(states, rows), count, folder, make)
    return EcgClassifier.from_arrays(stored)


def classifier_key(states: Mapping[str, StateSimulations], rows: Integers) -> str:
    """Text that identifies all that the classifier of states by the leads `rows` depends on."""
    return "; ".join([str(rows), *(of_state.content for of_state in states.values())])


def training_and_held_out(
    states: Mapping[str, StateSimulations],
    rows: Integers,
    rng: np.random.Generator,
    count: int = 40_000,
) -> tuple[RecordingSet, RecordingSet]:
    """Training set of a heart's recordings, `count` of each state, and a held-out set."""
    first, *_ = states.values()
    recorder = Recorder.of(first.simulations.examples(first.count, LENGTH).of_the_prior)
    training: list[Singles] = []
    held_out: list[Singles] = []
    for state in states.values():
        ecgs, in_torsos = state.ecgs()
        training.append(recorder.recordings(ecgs, rows, count, rng)[0])
        held_out.append(in_leads(rows) @ recorder.recorded(in_torsos, rng, in_torsos=True))
    sets = []
    for recordings in (training, held_out):
        one_hot = np.eye(len(recordings), dtype=np.float32)
        kinds = np.repeat(one_hot, [len(ecgs) for ecgs in recordings], axis=0)
        sets.append(RecordingSet(np.concatenate(recordings), kinds))
    return sets[0], sets[1]


def simulate_prior(
    heart: Heart | Path | str,
    networks: int | None = None,
    *,
    workers: int | None = None,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
) -> Path:
    """Simulate networks of the prior of a heart once, and train its emulators, for all its fits.

    Every conduction state has simulations and an emulator; the classifier that tells the
    states apart is trained, too. Existing files are kept, so an interrupted run is resumed.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    networks : int, optional
        Number of networks; by default that of `fascicle.fit`.
    workers : int, optional
        Simulations that run at the same time; by default one per core.
    progress : Progress, "lines" or None
        Progress callback, called with the number of networks simulated; by default lines on
        standard error.
    pool : Pool, optional
        Where networks are simulated, as in `fascicle.fit`; by default on `workers` threads.

    Returns
    -------
    Path
        Folder that holds simulations, emulators and classifier.

    Raises
    ------
    InputError
        If the heart cannot be used, or its folder cannot be written to.
    """
    heart, folder, count, pool = for_simulations(heart, networks, "networks", workers, pool)
    with shown_progress(progress) as shown:
        compile_kernels(shown)
        model = ForwardModel(heart, progress=shown)
        states = simulations_of_states(model, usual_prior(heart), folder, count)
        classifier_of(states, np.array(INDEPENDENT_ROWS), folder, count, pool, shown)
        distinct = {state.simulations.content: state for state in states.values()}
        for state in distinct.values():
            made_emulator(state.simulations, state.count, pool, shown)
    return folder / DISPOSABLE
