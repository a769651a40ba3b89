"""Recordings of a study, and their comparison with simulated networks: loss and likelihood."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Booleans, Floats
from fascicle.core.errors import InputError
from fascicle.core.files import as_path, write_text
from fascicle.core.leads import independent_rows
from fascicle.core.parameters import Infeasible
from fascicle.core.quantities import SIDES
from fascicle.core.ranges import short_repr
from fascicle.forward.beat import Beat, Signals
from fascicle.forward.likelihood import Likelihood
from fascicle.forward.loss import Alignment, align, mismatch, placed
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import find_scenario, read_scenario, scenario_text
from fascicle.inference.evaluation import Evaluation
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import BeatMemory, PointSimulator
from fascicle.recording.target import Target, repeated
from fascicle.recording.target_files import as_target, read_target, write_target

# Target, or target with its scenario, as the user passes it
Given = Target | Path | str | tuple[Target | Path | str, Scenario | Path | str]


# Target, and the scenario in which it was recorded: None for the intrinsic beat
Recorded = tuple[Target, Scenario | None]


def digests(recorded: Recorded) -> tuple[str, str]:
    """SHA-256 of target and scenario, as far as a fit uses them; the latter empty without one."""
    target, scenario = recorded
    text = hashlib.sha256(scenario_text(scenario).encode()).hexdigest() if scenario else ""
    return target_digest(target), text


def given_recordings(recordings: Given | list[Given]) -> list[Recorded]:
    """Read targets and scenarios that are files or names; a list holds several recordings."""
    targets = list(recordings) if isinstance(recordings, list) else [recordings]
    if not targets:
        raise InputError("no target is given; make one with 'fascicle target'")
    return [_recording(target) for target in targets]


def _recording(target_and_scenario: Given) -> Recorded:
    pair: Any = target_and_scenario
    if not isinstance(pair, tuple):
        pair = pair, None
    if len(pair) != 2:
        raise InputError(f"target is a tuple of {len(pair)}; give (target, scenario), or a list")
    target, scenario = as_target(pair[0]), pair[1]
    if scenario is not None and not isinstance(scenario, Scenario):
        named = as_path(scenario, "scenario of a target", "a scenario, its name, or its file")
        path = find_scenario(str(named))
        scenario, regions = read_scenario(path)
        if regions:
            raise InputError(
                f"{path}: has regions of the myocardium, which are the heart's in every "
                "recording; say them in its heart.toml"
            )
    return target, scenario


def write_recordings(folder: Path, recordings: Sequence[Recorded]) -> None:
    """Write recordings to a study's folder, unless they are there already, undamaged."""
    for number, recorded in enumerate(recordings, 1):
        target, scenario = recording_paths(folder, number)
        with suppress(InputError):  # it is missing or damaged
            if digests(_read(target, scenario)) == digests(recorded):
                continue
        write_target(recorded[0], target)
        if recorded[1] is not None:
            write_text(scenario, scenario_text(recorded[1]))
        else:
            scenario.unlink(missing_ok=True)


def _read(target: Path, scenario: Path) -> Recorded:
    recorded_scenario = read_scenario(scenario)[0] if scenario.exists() else None
    return read_target(target), recorded_scenario


def read_recordings(folder: Path, count: int) -> list[Recorded]:
    """Read the recordings that `write_recordings` has written."""
    return [_read(*recording_paths(folder, number)) for number in range(1, count + 1)]


def recording_paths(folder: Path, number: int) -> tuple[Path, Path]:
    """Files of a recording; their names have numbers from the second recording on."""
    end = f"-{number}" if number > 1 else ""
    return folder / f"target{end}.nc", folder / f"scenario{end}.toml"


def target_digest(target: Target) -> str:
    """SHA-256 of a target, as far as a fit uses it."""
    digest = hashlib.sha256()
    numbers = [target.qrs_onset, target.qrs_offset, target.onset_sd, target.offset_sd]
    if target.noise is not None:
        numbers.append(target.noise)
    for array in (target.beats, target.time, np.array(numbers)):
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    for filter_ in target.filters:  # without the source of this knowledge
        text = (
            f"{filter_.kind.value} {filter_.frequency!r} {filter_.shape!r} "
            f"{filter_.sampling_rate!r}"
        )
        digest.update(text.encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class Network:
    """Simulated network of a population, with its parameters and its ECG.

    Attributes
    ----------
    parameters : mapping of name to float
        Parameters, in their units.
    beat : Beat
        Output of the forward model for the parameters.
    predicted : (12 + k, n_time) array
        ECG of the network, aligned with the recorded mean beat (mV).
    under_qrs : float
        Share of the energy of the ECG that lies under the recorded QRS, 0 to 1.
    gain : float
        Factor on the simulated ECG in `predicted`; 1 unless the gain is free.
    drawn_gain : float, optional
        Gain that was drawn with a network of a posterior, in place of the best gain.
    torso : (12 + k, 12 + k) array, optional
        Matrix from the leads in the plain torso to those in the torso that was drawn with the
        network, without the gain.
    """

    parameters: Mapping[str, float]
    beat: Beat
    predicted: Floats
    under_qrs: float
    gain: float
    drawn_gain: float | None = None
    torso: Floats | None = None

    __repr__ = short_repr


@dataclass(frozen=True)
class TargetComparison:
    """Recording, in the leads of the heart, with which simulations are compared."""

    target: Target
    scenario: Scenario | None = None  # of the recording; None for the intrinsic beat
    likelihood: Likelihood | None = None  # None: evaluations have no log-likelihood
    free_gain: bool = False  # whether each simulation is scaled by its best global gain first
    independent_leads: bool = False  # at most two limb leads, which determine the others
    fewest_junctions: int = 0  # a network whose tree has fewer is infeasible

    __repr__ = short_repr

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the fields alone: derived arrays would change memory layout, and so rounding."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __call__(self, point: Floats, signals: Signals | str) -> Evaluation:
        """Compare the ECG of a point (d,), or the reason why it has none, with the recording."""
        if isinstance(signals, str):
            return Evaluation.infeasible(point, signals)
        for side, junctions in zip(SIDES, signals.junctions, strict=True):
            if junctions < self.fewest_junctions:
                reason = f"{side.upper()} tree has {junctions} junctions only"
                return Evaluation.infeasible(point, reason)
        alignment = self.align(signals.leads)
        # of every beat: beats are aligned with one another, so the alignment with their mean serves
        errors = mismatch(self._recorded_beats, alignment)
        logs = [] if self.likelihood is None else [self.likelihood.log_likelihood(signals)]
        return Evaluation(point, alignment.loss, errors, log_likelihoods=np.array(logs, float))

    @cached_property
    def compared(self) -> Booleans:
        """Whether a lead (12 + k,) is compared."""
        used = self.target.used
        if not self.independent_leads:
            return used
        return np.isin(np.arange(len(used)), independent_rows(used))

    @property
    def null_loss(self) -> float:
        """Loss of an ECG that is zero everywhere (mV²)."""
        recorded = self.target.qrs[self.compared]
        return float((recorded**2).sum() / recorded.shape[1])

    def align(self, leads: Floats) -> Alignment:
        """Best alignment of simulated leads (12 + k, n) with the mean QRS, by the compared ones."""
        return align(
            leads[self.compared],
            self.target.qrs[self.compared],
            free_gain=self.free_gain,
            response=self.target.response,
        )

    def predicted(self, leads: Floats, alignment: Alignment) -> Floats:
        """Simulated leads (12 + k, n) aligned with the recorded beat, (12 + k, n_time) (mV)."""
        shift = alignment.shift - self.target.qrs_samples.start
        length, response = len(self.target.time), self.target.response
        return alignment.gain * placed(leads, shift, length, response)

    @cached_property
    def _recorded_beats(self) -> Floats:
        """QRS of every beat in the compared leads; a single beat is repeated with its noise."""
        target = self.target
        if target.noise is not None:
            # a fixed seed: every evaluation, and a resumed study, sees the same beats
            target = repeated(target, np.random.default_rng(0))
        return np.asarray(target.qrs_beats[:, self.compared])


def evaluate(
    simulator: PointSimulator, recordings: Sequence[TargetComparison], points: Sequence[Floats]
) -> Iterator[Evaluation]:
    """Evaluate points (d,) of the unit cube, in order, for the inference.

    Losses of several recordings add up; the errors of single beats are those of the first.
    """
    size = simulator.backend.batch if simulator.backend is not None else max(1, len(points))
    any_intrinsic = any(recording.scenario is None for recording in recordings)
    shared = simulator.model, simulator.prior, recordings, simulator.memory
    for start in range(0, len(points), size):
        part = points[start : start + size]
        signals = simulator.from_backend(part) if any_intrinsic else [None] * len(part)
        yield from simulator.pool.map(_evaluate, [*zip(part, signals, strict=True)], *shared)


def _evaluate(
    item: tuple[Floats, Signals | str | None],
    model: ForwardModel,
    prior: Prior,
    recordings: Sequence[TargetComparison],
    memory: BeatMemory,
) -> Evaluation:
    """Simulate a point in the scenario of each recording, and compare it with all of them.

    `item` is a point, and the signals of its intrinsic beat if a backend simulated it, or the
    reason why that is infeasible; else None.
    """
    point, from_backend = item
    parameters = prior.from_unit(point)
    simulated: list[Signals | str] = []
    evaluations: list[Evaluation] = []
    for recording in recordings:
        pairs = zip(recordings, simulated, strict=False)
        simulated_before = [
            signals for other, signals in pairs if other.scenario == recording.scenario
        ]
        if simulated_before:
            signals = simulated_before[0]
        elif recording.scenario is None and from_backend is not None:
            signals = from_backend
        else:
            beat = memory.simulate(model, parameters, recording.scenario)
            if isinstance(beat, Infeasible):
                signals = beat.reason
            elif recording.scenario is None and not prior.keeps(point, model.surfaces, beat):
                signals = "not activated in the sequence of mapped human hearts"
            else:
                signals = beat.signals
        simulated.append(signals)
        evaluations.append(recording(point, signals))
        if not evaluations[-1].feasible:
            return evaluations[-1]
    logs = np.concatenate([evaluation.log_likelihoods for evaluation in evaluations])
    return replace(
        evaluations[0],
        loss=sum(evaluation.loss for evaluation in evaluations),
        log_likelihoods=logs,
    )


def networks(
    simulator: PointSimulator, recording: TargetComparison, learnt: Iterable[Mapping[str, float]]
) -> Iterator[Network]:
    """Simulate networks whose parameters are feasible, as those of a population are."""
    parameters = [{**simulator.prior.fixed, **values} for values in learnt]
    return simulator.pool.map(_network, parameters, simulator.model, recording, simulator.memory)


def _network(
    parameters: Mapping[str, float],
    model: ForwardModel,
    recording: TargetComparison,
    memory: BeatMemory,
) -> Network:
    beat = memory.simulate(model, parameters, recording.scenario)
    if isinstance(beat, Infeasible):
        raise RuntimeError(f"a network of the population is impossible: {beat.reason}")
    alignment = recording.align(beat.leads)
    predicted = recording.predicted(beat.leads, alignment)
    return Network(parameters, beat, predicted, alignment.under_qrs, alignment.gain)
