"""Inputs of a fit, and the inverse problem that they pose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.conduction_states import ConductionState
from fascicle.core.errors import InputError
from fascicle.core.parameters import FREE
from fascicle.core.progress import Progress
from fascicle.core.quantities import DELAY, torso_values
from fascicle.core.ranges import check_kind
from fascicle.emulation.ecg_emulator import TORSO_MODES, EcgEmulator
from fascicle.emulation.heart_emulator import MOST_ROUNDS, REFINING_NETWORKS
from fascicle.emulation.likelihood import ATLAS_DISCREPANCY, EmulatedLikelihood, likelihood_of
from fascicle.emulation.recalibration import as_simulated
from fascicle.forward.beat import Beat
from fascicle.forward.likelihood import Likelihood, QrsLikelihood
from fascicle.forward.model import Backend, ForwardModel, usable
from fascicle.forward.preparation import compile_kernels
from fascicle.forward.scenario import Scenario
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart
from fascicle.inference.evaluation import Evaluation
from fascicle.networks.prior import Prior, growth_and_conduction
from fascicle.networks.settings import FitSettings
from fascicle.networks.simulator import BeatMemory, PointSimulator
from fascicle.networks.target_comparison import (
    Given,
    Recorded,
    TargetComparison,
    digests,
    evaluate,
    given_recordings,
)
from fascicle.pools.pool import Pool, Threads
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.study import StudyConfig


@dataclass(frozen=True)
class Inputs:
    """Inputs of a study: heart, recordings, configuration, growth rules and likelihoods."""

    heart: Heart
    recordings: Sequence[Recorded]
    config: StudyConfig  # all that decides the outcome, with digests of the other inputs
    rules: GrowthRules
    likelihoods: Sequence[Likelihood] | None = None  # the user's, or None for the package's


@dataclass(frozen=True)
class InverseProblem:
    """Networks of a prior, and the recordings that they are to explain.

    Attributes
    ----------
    inputs : Inputs
        Inputs of the study.
    simulator : PointSimulator
        Simulator of the networks of the study's prior.
    recordings : tuple of TargetComparison
        Recordings, in the leads of the heart.
    """

    inputs: Inputs
    simulator: PointSimulator
    recordings: tuple[TargetComparison, ...]

    @classmethod
    def of(
        cls,
        inputs: Inputs,
        pool: Pool | None = None,
        progress: Progress | None = None,
        backend: Backend | None = None,
    ) -> InverseProblem:
        """Prepare the forward model, which takes long on a new machine or with a new heart."""
        compile_kernels(progress)
        config, heart, prior = inputs.config, inputs.heart, inputs.config.prior
        model = ForwardModel(heart, rules=inputs.rules, progress=progress)
        names, scenario = [*prior.names, *prior.fixed], inputs.recordings[0][1]
        backend = usable(backend, model, [*names, *prior.averaged.space.names], scenario)
        if torso := torso_values(dict.fromkeys(names, 0.0)):
            model.torso([*torso])  # built here, not by every worker
        recordings = tuple(
            TargetComparison(
                target.in_leads(heart.leads),
                scenario,
                free_gain=config.free_gain if config.method == "paper" else _gain_sd(config) > 0,
                independent_leads=config.leads == "8",
                fewest_junctions=config.fewest_junctions,
            )
            for target, scenario in inputs.recordings
        )
        pool = pool or Threads(config.batch)
        return cls(inputs, PointSimulator(model, prior, pool, backend), recordings)

    @property
    def config(self) -> StudyConfig:
        """Configuration of the study."""
        return self.inputs.config

    @property
    def scenarios(self) -> list[Scenario | None]:
        """Scenario of each recording; None for an intrinsic beat."""
        return [recording.scenario for recording in self.recordings]

    def narrowed(self, state: ConductionState, **numbers: float) -> InverseProblem:
        """Problem of one conduction state; `numbers` replace fields of the configuration."""
        prior = self.config.prior.narrowed(state)
        changes = {
            "space": prior.space.parameters,
            "fixed": prior.fixed,
            "states": prior.states,
            "mapped": prior.mapped,
        }
        config = self.config.model_copy(update=changes | numbers)
        return replace(
            self,
            inputs=replace(self.inputs, config=config),
            simulator=replace(self.simulator, prior=config.prior),
        )

    def with_states(self, probable: Mapping[str, float]) -> InverseProblem:
        """Problem whose prior mixes the conduction states by their posterior probabilities."""
        prior = replace(self.simulator.prior, states=as_simulated(probable))
        return replace(self, simulator=replace(self.simulator, prior=prior))

    def with_memory(self) -> InverseProblem:
        """Problem that keeps its beats in memory, unless it does already."""
        if self.simulator.memory.kept:
            return self
        return replace(self, simulator=replace(self.simulator, memory=BeatMemory(kept=True)))

    def check_scenarios(self) -> None:
        """Refuse a scenario that does not fit the heart, by simulating a network of the prior."""
        for recording in self.recordings:
            if recording.scenario is None:
                continue
            # several points, since some give no network; of a fixed seed
            for point in self.simulator.prior.sample(np.random.default_rng(0), 10):
                if isinstance(next(self.simulator.simulate([point], recording.scenario)), Beat):
                    break

    def likelihoods(self, emulators: Sequence[EcgEmulator]) -> list[EmulatedLikelihood]:
        """Likelihoods of the recordings by their emulators: the user's, or the package's."""
        likelihoods, gain_sd = self.inputs.likelihoods, _gain_sd(self.config)
        if likelihoods is None:
            pairs = zip(self.recordings, emulators, strict=True)
            likelihoods = [likelihood_of(r.target, emulator, gain_sd) for r, emulator in pairs]
        return [
            EmulatedLikelihood(self.simulator, emulator, likelihood)
            for emulator, likelihood in zip(emulators, likelihoods, strict=True)
        ]

    def with_likelihoods(self, emulated: Sequence[EmulatedLikelihood]) -> InverseProblem:
        """Problem whose evaluations have log-likelihoods."""
        recordings = tuple(
            replace(recording, likelihood=likelihood.likelihood)
            for recording, likelihood in zip(self.recordings, emulated, strict=True)
        )
        return replace(self, recordings=recordings)

    def evaluate(self, points: Sequence[Floats]) -> Iterator[Evaluation]:
        """Evaluate points (d,) of the unit cube, in order."""
        return evaluate(self.simulator, self.recordings, points)


def _gain_sd(config: StudyConfig) -> float:
    """Prior SD of the gain about 1; 0 if the gain is itself a parameter."""
    is_parameter = "gain" in {*config.prior.names, *config.fixed}
    return 0.0 if is_parameter else config.gain_sd


def read_inputs(
    heart: Heart | Path | str,
    target: Given | list[Given],
    parameters: Mapping[str, Any],
    settings: FitSettings,
    rules: GrowthRules | None = None,
    likelihoods: Sequence[Likelihood] | None = None,
) -> Inputs:
    """Read the arguments of `fit`, and settle which quantities are learnt and which are fixed."""
    rules = checked_rules(rules)
    heart = as_heart(heart)
    recordings = given_recordings(target)
    if settings.method == "paper" and heart.atlas is not None:
        raise InputError(
            f"the method 'paper' fits one heart, and {heart.name} is many; use the method "
            "'posterior', or a heart of your own"
        )
    if settings.method == "paper" and (len(recordings) > 1 or recordings[0][1] is not None):
        raise InputError(
            "the method 'paper' fits one recording of an intrinsic beat; give one without a "
            "scenario, or use the method 'posterior'"
        )
    choices, one_intrinsic_beat = {**parameters}, len(recordings) == 1 and recordings[0][1] is None
    if heart.atlas is not None and not one_intrinsic_beat:
        raise InputError(
            f"{heart.name} comes with simulations of intrinsic beats alone; give one recording, "
            "without a scenario, or a heart of your own"
        )
    # the conduction state is learnt by default, unless the RV-LV delay is given, which it changes
    learnt = settings.method == "posterior" and one_intrinsic_beat and likelihoods is None
    learnt &= recordings[0][0].earliest_onset is None  # a paced beat shows no conduction state
    conduction = choices.pop("conduction", FREE if learnt and not {*DELAY} & {*choices} else None)
    if heart.atlas is not None and conduction is None:
        raise InputError(
            f"{heart.name} comes with simulations of intrinsic beats in a conduction state, and "
            "this one is paced or has no state; if it is intrinsic, fix one: conduction=normal"
        )
    prior = Prior.of(settings.method, choices, heart)
    if conduction is not None:
        prior = _with_states(prior, conduction, heart, settings, one_intrinsic_beat)
    if settings.free_gain and "gain" in {*prior.names, *prior.fixed}:
        raise InputError("the gain is a parameter already; leave --free-gain out")
    constants: dict[str, float | str] = {}
    if settings.method == "posterior":
        constants_of_emulator: dict[str, float | str] = {
            "body_modes": TORSO_MODES,
            "refining_networks": REFINING_NETWORKS,
            "refining_rounds": MOST_ROUNDS,
        }
        if heart.atlas is not None:
            constants_of_emulator["discrepancy_factor"] = ATLAS_DISCREPANCY
        names = ", ".join(type(likelihood).__qualname__ for likelihood in likelihoods or ())
        constants = {"name": names} if names else QrsLikelihood.constants() | constants_of_emulator
    config = StudyConfig(
        heart=heart.digest,
        **recording_digests(recordings),
        space=prior.space.parameters,
        fixed=prior.fixed,
        states=prior.states,
        mapped=prior.mapped,
        averaged=prior.averaged.space.parameters,
        tissues=prior.averaged.tissues,
        tissue_weights=prior.averaged.weights,
        likelihood=constants,
        **growth_and_conduction(heart, rules),
        **settings.model_dump(),
    )
    return Inputs(heart, recordings, config, rules, likelihoods)


def _with_states(
    prior: Prior, conduction: Any, heart: Heart, settings: FitSettings, one_intrinsic_beat: bool
) -> Prior:
    """Prior of the conduction states that the user chose and that other quantities allow."""
    if settings.method == "paper":
        raise InputError(
            "parameter 'conduction': the method 'paper' knows no conduction states; leave it "
            "out, or use the method 'posterior'"
        )
    states = prior.possible_states(conduction, heart)
    if len(states) == 1:
        return prior.narrowed(states[0])
    if not one_intrinsic_beat:
        raise InputError(
            "parameter 'conduction': it is learnt from one recording of an intrinsic beat; give "
            "one without a scenario, or fix the state"
        )
    total = sum(state.probability for state in states)
    # probabilities that add up to 1 but for rounding are not changed in the last digit
    total = 1.0 if math.isclose(total, 1.0) else total
    return replace(prior, states={state.name: state.probability / total for state in states})


def checked_rules(rules: GrowthRules | None) -> GrowthRules:
    """Check the argument `rules`; without one, return the default growth rules."""
    check_kind(rules, (GrowthRules, NoneType), "rules", "fascicle.GrowthRules")
    return rules or GrowthRules()


def checked_likelihoods(
    likelihood: Likelihood | Sequence[Likelihood], count: int, method: str
) -> Sequence[Likelihood]:
    """Check and list a user's likelihoods, which must be as many as the recordings."""
    likelihoods: list[Any] = (
        [*likelihood] if isinstance(likelihood, (list, tuple)) else [likelihood]
    )
    for candidate in likelihoods:
        check_kind(
            candidate, Likelihood, "likelihood", "an object that has the methods of Likelihood"
        )
    if method == "paper" or len(likelihoods) != count:
        raise InputError(
            f"{len(likelihoods)} likelihood(s) for {count} recording(s) by the method '{method}'; "
            "give one for each, to the method 'posterior'"
        )
    return likelihoods


def recording_digests(recordings: Sequence[Recorded]) -> dict[str, Any]:
    """Digests of the recordings, by field of `StudyConfig`."""
    targets, scenarios = zip(*map(digests, recordings), strict=True)
    return {"target": targets[0], "other_targets": targets[1:], "scenarios": scenarios}
