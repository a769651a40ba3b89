"""The one place that binds the forward model and the loss to the inference."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from fascicle.core.arrays import Booleans, Floats
from fascicle.core.leads import independent_rows
from fascicle.core.parameters import ParameterSpace
from fascicle.core.quantities import SIDES, body_values
from fascicle.core.ranges import short_repr
from fascicle.forward.likelihood import QrsLikelihood
from fascicle.forward.loss import Alignment, align, mismatch, placed
from fascicle.forward.model import Backend, ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Signals, Simulation
from fascicle.inference.evaluation import Evaluation
from fascicle.purkinje.tree import InvalidTree
from fascicle.recording.synthetic import repeated
from fascicle.recording.target import Target
from fascicle.study.pool import Pool, Threads
from fascicle.study.prior_simulations import PriorSimulations
from fascicle.torso.variation.conductor import InvalidBody


@dataclass(frozen=True)
class Network:
    """One network of a population: its parameters and what it does.

    Attributes
    ----------
    parameters : mapping of name to float
        In their units.
    simulation : Simulation
        What the forward model makes of them.
    predicted : (12, n_time) array
        Its ECG under the recorded mean beat (mV).
    under_qrs : float
        Share of the energy of its ECG that lies under the recorded QRS, 0 to 1.
    gain : float
        By which its simulated ECG was scaled to give `predicted`; 1 unless the gain is free.
    drawn_gain : float, optional
        Of a posterior, the gain that was drawn with it, in place of the best one.
    """

    parameters: Mapping[str, float]
    simulation: Simulation
    predicted: Floats
    under_qrs: float
    gain: float
    drawn_gain: float | None = None

    __repr__ = short_repr


@dataclass(frozen=True)
class Problem:
    """The question which networks of a parameter space explain recordings of a heart.

    Calling it evaluates points of the unit cube, which is all the inference ever sees.

    Attributes
    ----------
    model : ForwardModel
        The forward model of the heart.
    target : Target
        What is to be explained; of several recordings the first.
    space : ParameterSpace
        What is learnt.
    free_gain : bool
        Whether each simulation is scaled by its best global gain first.
    pool : Pool
        Where simulations run.
    backend : Backend, optional
        What simulates intrinsic beats in place of the pool.
    fixed : mapping of name to float
        Quantities that are held at other values than their defaults.
    independent_leads : bool
        Whether at most eight leads are compared: of the limb leads two, which say the rest.
    fewest_junctions : int
        A network with a tree of fewer is infeasible.
    likelihood : QrsLikelihood, optional
        Of the target (`fascicle.study.likelihood`), if evaluations are to have one.
    bank : PriorSimulations, optional
        Networks that need not be simulated again.
    scenario : Scenario, optional
        In which the target was recorded, such as paced from a known site.
    others : tuple of Problem
        Further recordings, each with its own target, scenario and likelihood.
    """

    model: ForwardModel
    target: Target
    space: ParameterSpace
    free_gain: bool = False
    pool: Pool = field(default=Threads(1), compare=False)
    backend: Backend | None = field(default=None, compare=False)
    fixed: Mapping[str, float] = field(default_factory=dict)
    independent_leads: bool = False
    fewest_junctions: int = 0
    likelihood: QrsLikelihood | None = None
    bank: PriorSimulations | None = None
    scenario: Scenario | None = None
    others: tuple[Problem, ...] = ()

    __repr__ = short_repr

    @property
    def recordings(self) -> tuple[Problem, ...]:
        """The first and the others, each by itself."""
        return (replace(self, others=()), *self.others)

    @property
    def bodies(self) -> list[str]:
        """Quantities of the body that are learnt or fixed."""
        return [*body_values(dict.fromkeys((*self.space.names, *self.fixed), 0.0))]

    def portable(self) -> Problem:
        """All but the model and the bank, to be sent to workers."""
        others = tuple(other.portable() for other in self.others)
        nowhere = cast(ForwardModel, None)  # until `of` puts one in its place
        return replace(self, model=nowhere, bank=None, pool=Threads(1), backend=None, others=others)

    def of(self, model: ForwardModel) -> Problem:
        """The same with a model, as a worker has it."""
        return replace(self, model=model, others=tuple(other.of(model) for other in self.others))

    def __call__(self, points: Sequence[Floats]) -> Iterator[Evaluation]:
        """Evaluate points of the unit cube; outcomes come in order, as soon as they are there."""
        if self.backend is not None:
            return self._by_backend(self.backend, points)
        if isinstance(self.pool, Threads):
            return self.pool.map(Problem.evaluate, self, points)
        return self._elsewhere(points)

    def _by_backend(self, backend: Backend, points: Sequence[Floats]) -> Iterator[Evaluation]:
        """What the bank does not have comes from the backend; the pool compares, and the rest."""
        for start in range(0, len(points), backend.batch):
            part = points[start : start + backend.batch]
            stored = [self._stored_signals(point) for point in part]
            missing = [
                self._parameters(point)
                for point, there in zip(part, stored, strict=True)
                if there is None
            ]
            new = backend.signals(self.model, missing)
            given = [
                (point, there if there is not None else next(new))
                for point, there in zip(part, stored, strict=True)
            ]
            yield from self.pool.map(Problem._evaluate_given, self, given)

    def _elsewhere(self, points: Sequence[Floats]) -> Iterator[Evaluation]:
        """What the bank has all of is compared here, where the bank is; the rest elsewhere."""
        stored = [self._stored(point) for point in points]
        left = [point for point, there in zip(points, stored, strict=True) if not there]
        outcomes = self.pool.map(Problem.evaluate, self, left) if left else iter(())
        for point, there in zip(points, stored, strict=True):
            yield self.evaluate(point) if there else next(outcomes)

    def _stored(self, point: Floats) -> bool:
        """Whether the bank has all that a network gives: it knows the intrinsic beat alone."""
        intrinsic = all(each.scenario is None for each in (self, *self.others))
        return intrinsic and self.bank is not None and point in self.bank

    def simulate(self, points: Sequence[Floats]) -> list[Simulation | InvalidTree | InvalidBody]:
        """Run the forward model at points of the unit cube, and compare with nothing."""
        return list(self.pool.map(Problem._simulate, self, points))

    def _simulate(self, point: Floats) -> Simulation | InvalidTree | InvalidBody:
        return self.model.simulate(self._parameters(point), self.scenario)

    def _parameters(self, point: Floats) -> dict[str, float]:
        return {**self.fixed, **self.space.from_unit(point)}

    def evaluate(self, point: Floats) -> Evaluation:
        """Run the forward model at one point and compare it with the mean and with every beat."""
        return self._evaluated(point, self._signals(point))

    def _evaluate_given(
        self, item: tuple[Floats, Signals | InvalidTree | str | None]
    ) -> Evaluation:
        """The same where a backend, or the bank, has given what it has."""
        point, given = item
        if given is None:
            return self.evaluate(point)
        return self._evaluated(point, given.reason if isinstance(given, InvalidTree) else given)

    def _evaluated(self, point: Floats, signals: Signals | str) -> Evaluation:
        own = self._compare(point, signals)
        if not own.feasible or not self.others:
            return own
        every = [own] + [
            other._compare(
                point, signals if other.scenario is self.scenario else other._signals(point)
            )
            for other in self.others
        ]
        return replace(
            own,
            loss=sum(each.loss for each in every),
            log_likelihoods=np.concatenate([each.log_likelihoods for each in every]),
        )

    def _compare(self, point: Floats, signals: Signals | str) -> Evaluation:
        """Compare what a network gives with this recording alone."""
        if isinstance(signals, str):
            return Evaluation.infeasible(point, signals)
        for side, junctions in zip(SIDES, signals.junctions, strict=True):
            if junctions < self.fewest_junctions:
                reason = f"{side.upper()} tree has {junctions} junctions only"
                return Evaluation.infeasible(point, reason)
        alignment = self._align(signals.leads)
        # the beats are aligned with one another, so one alignment with their mean serves all
        errors = mismatch(self._recorded_beats, alignment)
        if self.likelihood is None:
            return Evaluation(point, alignment.loss, errors)
        likelihood = self.likelihood.fit(
            signals.leads[independent_rows(self.target.used)], signals.first_activation
        ).log_likelihood
        return Evaluation(point, alignment.loss, errors, log_likelihoods=np.array([likelihood]))

    def _signals(self, point: Floats) -> Signals | str:
        """What a network gives, from the bank if it is there, or why it is none."""
        stored = self._stored_signals(point)
        if stored is not None:
            return stored
        outcome = self._simulate(point)
        if isinstance(outcome, (InvalidTree, InvalidBody)):
            return outcome.reason
        return Signals.of(outcome)

    def _stored_signals(self, point: Floats) -> Signals | str | None:
        """What the bank has of a network."""
        if self.bank is None or self.scenario is not None:
            return None
        return self.bank.get(point)

    def networks(self, parameters: Iterable[Mapping[str, float]]) -> Iterator[Network]:
        """Simulate parameters that are known to give trees, as those of a population are."""
        return self.pool.map(Problem._network, self, list(parameters))

    @cached_property
    def compared(self) -> Booleans:
        """Which of the twelve leads are compared, shape (12,)."""
        used = self.target.used
        if not self.independent_leads:
            return used
        return np.isin(np.arange(len(used)), independent_rows(used))

    @property
    def flat(self) -> float:
        """Mismatch of a flat line (mV²), of several recordings their sum."""
        recorded = self.target.qrs[self.compared]
        own = float((recorded**2).sum() / recorded.shape[1])
        return own + sum(other.flat for other in self.others)

    def align(self, simulation: Simulation) -> Alignment:
        """Best alignment of a simulation with the mean recorded QRS, over the compared leads."""
        return self._align(simulation.leads)

    def _align(self, leads: Floats) -> Alignment:
        used = self.compared
        return align(
            leads[used],
            self.target.qrs[used],
            free_gain=self.free_gain,
            response=self.target.response,
        )

    def predicted(self, simulation: Simulation, alignment: Alignment) -> Floats:
        """The simulated ECG under the whole recorded beat, shape (12, n_time) (mV)."""
        shift = alignment.shift - self.target.qrs_samples.start
        length, response = len(self.target.time), self.target.response
        return alignment.gain * placed(simulation.leads, shift, length, response)

    def _network(self, learnt: Mapping[str, float]) -> Network:
        parameters = {**self.fixed, **learnt}
        simulation = self.model.simulate(parameters, self.scenario)
        if isinstance(simulation, (InvalidTree, InvalidBody)):
            raise RuntimeError(f"a network of the population is impossible: {simulation.reason}")
        alignment = self.align(simulation)
        predicted = self.predicted(simulation, alignment)
        return Network(parameters, simulation, predicted, alignment.under_qrs, alignment.gain)

    @cached_property
    def _recorded_beats(self) -> Floats:
        """QRS of every beat in the target's leads; a single one is repeated with its noise."""
        target = self.target
        if target.noise is not None:
            # one seed for all time: every evaluation, and a resumed study, sees the same beats
            target = repeated(target, np.random.default_rng(0))
        return np.asarray(target.qrs_beats[:, self.compared])
