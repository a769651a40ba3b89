"""How probable each conduction state is, by a classifier of a heart's simulated recordings.

Each state has prior simulations of its own. The classifier is made once a heart, and kept with it;
the packaged hearts share one, which has learnt from recordings of all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS
from fascicle.core.parameters import FREE
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.forward.compile_kernels import compile_kernels
from fascicle.forward.model import ForwardModel
from fascicle.heart.heart import Heart
from fascicle.inference.emulator import Singles
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target
from fascicle.study.conduction_states import STATES, ConductionState, possible_states, state_label
from fascicle.study.ecg_classifier import (
    LENGTH,
    EcgClassifier,
    Lessons,
    Recorder,
    classified_rows,
    in_leads,
    learn,
)
from fascicle.study.heart_emulator import for_simulations, learnt_or_made, made_emulator, prior_of
from fascicle.study.pool import Pool
from fascicle.study.prior_simulations import SEED, PriorSimulations
from fascicle.study.simulator import PointSimulator
from fascicle.study.space import AveragedOver, study_space

CLASSIFIER = "classifier"  # kind of file
RECORDINGS = 40_000  # of each state to learn from
FEWEST = 100  # simulations of a state to learn from


@dataclass(frozen=True)
class StateSimulations:
    """Prior simulations that hold those of a state."""

    state: ConductionState
    prior: PriorSimulations
    count: int  # half of what was asked for, but of mapped hearts, of which many are left out

    @classmethod
    def of(
        cls, state: ConductionState, simulator: PointSimulator, folder: Path, count: int
    ) -> StateSimulations:
        """Those of a simulator that learns all states."""
        space = state.narrowed(simulator.space, simulator.fixed)
        assert space is not None
        fixed, heart = simulator.fixed | state.blocks, simulator.model.heart
        averaged = AveragedOver.of(space, fixed, heart)
        mapped = state.is_mapped({*space.names, *fixed})
        own = replace(simulator, space=space, fixed=fixed, averaged=averaged, mapped=mapped)
        half = max(count // 2, 100)  # the fewest that a fit takes
        return cls(state, prior_of(own, folder), count if mapped else half)

    @property
    def content(self) -> str:
        """What they depend on."""
        return f"{self.state.name} {self.prior.content}"

    def ecgs(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """ECGs of the state to learn from, and held-out ones in random bodies."""
        examples = self.prior.examples(self.count, LENGTH).of_the_prior
        independent = slice(len(INDEPENDENT_LEADS))
        seen = examples.ecgs[~examples.held_out[examples.feasible], independent]
        tried = examples.in_bodies[:, independent]
        if len(seen) < FEWEST or not len(tried):
            raise InputError(
                f"only {len(seen)} networks of the prior of '{self.state.name}' fit this heart; "
                "give more prior_simulations, or a prior of the other states"
            )
        return seen, tried


def probabilities(
    classifier: EcgClassifier, known: Iterable[str], priors: Mapping[str, float], target: Target
) -> dict[str, float]:
    """How probable states with priors are given a recording, by a classifier of the known ones."""
    each = zip(known, classifier.probabilities(target), strict=True)
    found = {name: p * priors[name] for name, p in each if name in priors}
    total = sum(found.values())
    return {name: float(p / total) for name, p in found.items()}


@dataclass(frozen=True)
class NoStateNamed:
    """Why no conduction state of a recording is named.

    Attributes
    ----------
    reason : str
        In a line.
    unreliable : mapping of str to float
        What the classifier says all the same; nobody knows how often it is right.
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
    """Say how probable each conduction state is, without a fit.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    target : Target or path
        A recording of the intrinsic beat.
    priors : mapping of str to float, optional
        Of the states before the ECG is seen; by default as common as they are in adults who are
        referred for an ECG (`fascicle.study.conduction_states.PREVALENCE`).
    parameters : mapping of name to value, optional
        Quantities with other priors than those of people, or fixed, as in `fascicle.fit`, so that
        its ``"conduction"`` stands for `priors`. Networks of these are simulated once a heart.
    prior_simulations, workers, progress, pool
        As in `fascicle.locate`: a heart of your own is simulated once.

    Returns
    -------
    mapping of str to float, or NoStateNamed
        Probabilities, which add up to 1; or why none is named.

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
    wanted = {"conduction": priors, **(parameters or {})}
    asked_of = wanted.pop("conduction")
    space, fixed = study_space("posterior", wanted, heart)
    states = possible_states(asked_of, space, {**heart.values, **fixed})
    asked = {state.name: state.probability for state in states}
    if others := {*asked} - {state.name for state in STATES}:
        raise InputError(
            f"priors: '{min(others)}' is not told apart from normal; give others, or leave them out"
        )
    with shown_progress(progress) as shown:
        if shown is not None:
            compile_kernels(shown)
        simulator = PointSimulator(ForwardModel(heart, progress=shown), space, fixed)
        known = simulations_of_states(simulator, folder, count)
        rows = classified_rows(target)
        classifier = classifier_of(known, rows, folder, count, pool, shown)
    probable = probabilities(classifier, known, asked, target)
    if reason := unlike(classifier, target):
        return NoStateNamed(reason, probable)
    return {state_label(name): p for name, p in probable.items()}


def unlike(classifier: EcgClassifier, target: Target) -> str:
    """Why a recording is not one of those that a classifier has learnt from; empty if it is."""
    assert classifier.most_outside is not None
    (outside,) = classifier.outside(classifier.cosines(target))
    if outside <= classifier.most_outside:
        return ""
    return (
        f"the recording is unlike all simulated ones of this heart ({outside:.0%} of its QRS, "
        f"{classifier.most_outside:.0%} at most expected)"
    )


def simulations_of_states(
    simulator: PointSimulator, folder: Path, count: int
) -> dict[str, StateSimulations]:
    """Prior simulations of all states that what is learnt and fixed leaves.

    Those of the heart's usual priors, of all states, wherever they are of what is learnt and fixed.
    """
    usual = PointSimulator(simulator.model, *study_space("posterior", {}, simulator.model.heart))
    found = _of_each(usual, folder, count)
    asked = _of_each(simulator, folder, count)
    if all(
        name in found
        and found[name].prior.covers(
            each.prior.space, each.prior.averaged, each.prior.fixed, each.prior.mapped
        )
        for name, each in asked.items()
    ):
        return found
    return asked


def _of_each(simulator: PointSimulator, folder: Path, count: int) -> dict[str, StateSimulations]:
    known = {**simulator.model.heart.values, **simulator.fixed}
    left = [state for state in STATES if state.narrowed(simulator.space, known) is not None]
    return {state.name: StateSimulations.of(state, simulator, folder, count) for state in left}


def classifier_of(
    known: Mapping[str, StateSimulations],
    rows: Integers,
    folder: Path,
    count: int,
    pool: Pool,
    progress: Progress | None = None,
) -> EcgClassifier:
    """The classifier of states that looks at leads, from the package, a heart's folder or made."""

    def make() -> Mapping[str, Any]:
        for number, each in enumerate(known.values(), 1):
            said = f"{each.state.name} ({number} of {len(known)} states)"
            each.prior.simulate(each.count, pool, progress, said)
        rng = np.random.default_rng(SEED)
        found: Mapping[str, Any] = learn(*lessons(known, rows, rng), rows, rng, progress).arrays()
        return found

    stored = learnt_or_made(CLASSIFIER, classifier_key(known, rows), count, folder, make)
    return EcgClassifier.from_arrays(stored)


def classifier_key(known: Mapping[str, StateSimulations], rows: Integers) -> str:
    """What the classifier of states that looks at leads depends on."""
    return "; ".join([str(rows), *(each.content for each in known.values())])


def lessons(
    known: Mapping[str, StateSimulations], rows: Integers, rng: np.random.Generator
) -> tuple[Lessons, Lessons]:
    """Recordings of a heart to learn from, as many of each state, and held-out ones."""
    first, *_ = known.values()
    recorder = Recorder.of(first.prior.examples(first.count, LENGTH).of_the_prior)
    seen: list[Singles] = []
    held_out: list[Singles] = []
    for each in known.values():
        ecgs, in_bodies = each.ecgs()
        seen.append(recorder.recordings(ecgs, rows, RECORDINGS, rng)[0])
        held_out.append(in_leads(rows) @ recorder.recorded(in_bodies, rng, in_bodies=True))
    both = []
    for recordings in (seen, held_out):
        one_each = np.eye(len(recordings), dtype=np.float32)
        kinds = np.repeat(one_each, [len(each) for each in recordings], axis=0)
        both.append(Lessons(np.concatenate(recordings), kinds))
    return both[0], both[1]


def simulate_prior(
    heart: Heart | Path | str,
    networks: int | None = None,
    *,
    workers: int | None = None,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
) -> Path:
    """Simulate networks of the prior of a heart once, and train its emulators, for all its fits.

    Those of every conduction state, and the classifier that tells the states apart.

    What is there already is kept, so it goes on where it was interrupted.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    networks : int, optional
        How many; by default as many as a fit wants.
    workers : int, optional
        Simulations that run at the same time; by default one a core.
    progress : Progress, "lines" or None
        Called with how many networks are simulated; by default lines on standard error say so.
    pool : Pool, optional
        Where they are simulated, as in `fascicle.fit`; by default on `workers` threads.

    Returns
    -------
    Path
        Folder that holds them.

    Raises
    ------
    InputError
        If the heart cannot be used, or its folder cannot be written to.
    """
    heart, folder, count, pool = for_simulations(heart, networks, "networks", workers, pool)
    with shown_progress(progress) as shown:
        if shown is not None:
            compile_kernels(shown)
        model = ForwardModel(heart, progress=shown)
        simulator = PointSimulator(model, *study_space("posterior", {}, heart))
        known = simulations_of_states(simulator, folder, count)
        classifier_of(known, np.array(INDEPENDENT_ROWS), folder, count, pool, shown)
        for each in {each.prior.content: each for each in known.values()}.values():
            made_emulator(each.prior, each.count, pool, shown)
    return folder / DISPOSABLE
