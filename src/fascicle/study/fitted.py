"""Fitted study: networks, their simulation, verdict and warnings; read from its folder."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from fascicle.core import VERSION, above, html_card
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, ValueRefusedError
from fascicle.core.files import as_path, atomic_folder, check_folder, write_text
from fascicle.core.progress import Lines, Progress, shown_progress, stage_progress
from fascicle.core.quantities import checked, quantity
from fascicle.core.ranges import check_count, short_repr, shown
from fascicle.emulation.predictive import Checks
from fascicle.forward.activation_sequence import nearest_to_median
from fascicle.forward.beat import Beat
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart
from fascicle.heart.heart import Heart
from fascicle.inference.evaluation import Evaluation, best_of
from fascicle.networks.prior import growth_and_conduction
from fascicle.networks.settings import FitSettings
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network, TargetComparison, networks, read_recordings
from fascicle.pools.pool import Pool, check_pool
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.evaluations import Stage
from fascicle.study.export import Format, write_networks
from fascicle.study.inputs import Inputs, InverseProblem, checked_rules, recording_digests
from fascicle.study.population import (
    RESULT,
    Population,
    Posterior,
    evenly_spread,
    read_checks,
    read_population,
)
from fascicle.study.statements import Statements
from fascicle.study.study import Study, StudyFile, check_same


@dataclass(frozen=True)
class FittedStudy:
    """A finished study.

    Attributes
    ----------
    study : Study
        Folder, configuration and evaluations.
    simulator : PointSimulator
        Forward model, and the parameters that are learnt.
    recordings : tuple of TargetComparison
        Recordings, with which simulations are compared.
    population : Population
        The networks that explain the target, and the best one.
    checks : Checks, optional
        Checks of a posterior's predictions against its recordings.
    gains : (n,) array, optional
        Factor on the ECG of each network of a posterior, drawn given the first recording.
    torsos : (n, 12 + k, 12 + k) array, optional
        Matrix from each network's leads in the plain torso to those in the torso that was drawn
        with it, without the gain.
    ecgs : tuple of (n, 12 + k, n_time) arrays
        ECGs (mV) of a posterior's networks for each recording, with shift, gain and torso drawn
        given the recording.
    """

    study: Study
    simulator: PointSimulator
    recordings: tuple[TargetComparison, ...]
    population: Population
    checks: Checks | None = None
    gains: Floats | None = None
    torsos: Floats | None = None
    ecgs: tuple[Floats, ...] = ()

    __repr__ = short_repr
    _repr_html_ = html_card

    def plot(self, recording: int = 0, *, caption: bool = False) -> list[Any]:
        """Draw recorded and simulated QRS by `fascicle.plot.ecg`; returns Matplotlib axes."""
        return list(above("plot").ecg(self, recording, caption=caption))

    def save(self, folder: Path | str) -> None:
        """Copy the study's folder, whole or not at all; `fascicle.load_study` reads it."""
        if type(self.population) is Population:  # made by `with_draws`
            raise InputError(f"{self.folder} does not hold draws of your own; save these yourself")
        with atomic_folder(as_path(folder, "folder")) as temporary:
            ignored = shutil.ignore_patterns(StudyFile.LOCK)
            shutil.copytree(self.folder, temporary, ignore=ignored, dirs_exist_ok=True)

    @property
    def folder(self) -> Path:
        """Folder of the study."""
        return self.study.folder

    @property
    def settings(self) -> FitSettings:
        """Settings of the fit."""
        return self.study.config

    @cached_property
    def statements(self) -> Statements:
        """Verdict, caution, warnings, and statements on the parameters."""
        return Statements(self)

    @property
    def verdict(self) -> str:
        """Summary of the networks, and whether to trust them, in one line."""
        return self.statements.verdict

    @property
    def warnings(self) -> list[str]:
        """Warnings that a reader of the results must know first, in a line each."""
        return [warning.text for warning in self.statements.warnings]

    @property
    def of_the_paper(self) -> bool:
        """True if the networks were selected by the paper's method."""
        return self.settings.method == "paper"

    @property
    def candidates(self) -> list[Evaluation]:
        """Candidates from which the paper's method selected the population."""
        return [r.evaluation for r in self.study.records() if r.stage is Stage.REJECTION]

    @property
    def best_initial_loss(self) -> float:
        """Least mismatch among the points of the Latin hypercube (mV²)."""
        return best_of(r.evaluation for r in self.study.records() if r.stage is Stage.INITIAL).loss

    @property
    def explained(self) -> float:
        """Share of the variance of the recorded QRS that the best network explains, 0 to 1.

        Below 0, the network is worse than an ECG that is zero everywhere.
        """
        return 1 - self.population.best_loss / self.null_loss

    @property
    def emulator_reports(self) -> list[dict[str, float]]:
        """Quality of a posterior's emulator for each recording (`EcgEmulator.report`)."""
        path = self.folder / "summary.json"
        written = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return list(written.get("emulators", ()))

    @property
    def prior_simulations(self) -> int:
        """Number of simulations that the emulators learnt from; packaged ones may have more."""
        learnt = [round(report["networks"]) for report in self.emulator_reports]
        return min(learnt, default=self.study.config.prior_simulations)

    @property
    def null_loss(self) -> float:
        """Loss of an ECG that is zero everywhere (mV²), of several recordings their sum."""
        return sum(recording.null_loss for recording in self.recordings)

    @cached_property
    def best_network(self) -> Network:
        """Network with the least mismatch, simulated for the first recording."""
        return next(networks(self.simulator, self.recordings[0], [self.population.best]))

    def heart_of(self, k: int) -> Heart:
        """Heart of network `k`: that of the study, or of an atlas the network's own."""
        parameters = {**self.simulator.prior.fixed, **self.population.parameters(k)}
        return self.simulator.model.of_heart(parameters).heart

    @property
    def best_model(self) -> ForwardModel:
        """Forward model of the heart of the best network."""
        return self.simulator.model.of_heart(self.best_network.parameters)

    def best_in(self, recording: int) -> Network:
        """Best network in the scenario of a recording, counted from 0."""
        if recording == 0:
            return self.best_network
        return next(networks(self.simulator, self.recordings[recording], [self.population.best]))

    def networks(
        self,
        progress: Progress | None = None,
        recording: int = 0,
        chosen: Sequence[int] | None = None,
    ) -> list[Network]:
        """Simulate the population; the best network alone where none was accepted.

        Parameters
        ----------
        progress : Progress, optional
            Called after every network.
        recording : int
            Recording whose scenario is simulated, counted from 0.
        chosen : sequence of int, optional
            Indices of the networks; by default all.
        """
        if not len(self.population):
            return [self.best_network]
        check_count(recording, "recording", 0)
        if recording >= len(self.recordings):
            raise InputError(
                f"{self.folder}: there is no recording {recording}; the study has "
                f"{len(self.recordings)}, counted from 0"
            )
        chosen = range(len(self.population)) if chosen is None else chosen
        report = stage_progress(progress, "networks")
        learnt = [self.population.parameters(k) for k in chosen]
        simulated: list[Network] = []
        for network in networks(self.simulator, self.recordings[recording], learnt):
            k = chosen[len(simulated)]
            if self.gains is not None and recording == 0:
                network = replace(network, drawn_gain=float(self.gains[k]))
            if self.torsos is not None and recording == 0:
                network = replace(network, torso=self.torsos[k])
            if self.ecgs:
                network = replace(network, predicted=self.ecgs[recording][k])
            simulated.append(network)
            report(len(simulated), len(chosen))
        return simulated

    def with_draws(self, draws: Any) -> FittedStudy:
        """Copy of the study with networks of your own, as from another sampler.

        Parameters
        ----------
        draws : mapping, table or InferenceData
            Values (n,) of every parameter that the study learns, and perhaps of other quantities,
            by name, in their units: a dict, a pandas table, or ArviZ's InferenceData (`posterior`).

        Returns
        -------
        FittedStudy
            Study for `fascicle.predict`, `fascicle.report` and other functions that take one,
            without a verdict on the fit.

        Raises
        ------
        InputError
            If a parameter is missing or impossible, or a draw gives no network.
        """
        table = getattr(draws, "posterior", draws)
        values = {str(name): np.asarray(table[name], dtype=float).ravel() for name in table}
        if missing := [name for name in self.simulator.prior.names if name not in values]:
            raise InputError(f"draws: there is no '{missing[0]}', which the study learns; add it")
        counts = sorted({len(column) for column in values.values()})
        if len(counts) > 1 or not counts[0]:
            raise InputError(
                f"draws: {' or '.join(map(str, counts))} values; give equally many of each, and one"
            )
        rows = [
            checked({name: column[k] for name, column in values.items()}) for k in range(counts[0])
        ]
        recording, losses = self.recordings[0], []
        outcomes = self.simulator.of_parameters(rows, recording.scenario)
        for number, outcome in enumerate(outcomes):
            if not isinstance(outcome, Beat):
                raise InputError(f"draws: number {number} gives no network ({outcome.reason})")
            losses.append(recording.align(outcome.leads).loss)
        best = int(np.argmin(losses))
        population = Population(values, np.array(losses), rows[best], losses[best])
        return replace(self, population=population, checks=None, gains=None, torsos=None, ecgs=())

    def export(
        self,
        folder: Path | str,
        kind: Format = "opencarp",
        networks: int | None = None,
        progress: Progress | None = None,
    ) -> dict[str, Any]:
        """Write networks and the activation of the heart for other software, whole or not at all.

        The activation is that of the first recording: an intrinsic beat, unless it has a scenario.

        Parameters
        ----------
        folder : path
            Folder to write. `summary.json` describes the networks; each has a folder of its own,
            named by its number in the population, or ``best`` where none was accepted.
        kind : str
            ``"opencarp"``: mesh, fibres, trees, stimuli and parameter files (µm, ms, S/m);
            ``"vtu"``: the heart, trees and junctions for ParaView (mm, ms); ``"csv"``: tables,
            with units in the names of their columns. 'fascicle docs exchange' lists the files.
        networks : int, optional
            Number of networks, evenly spread over the population; by default one, whose activation
            map is nearest to the median map.
        progress : Progress, optional
            Progress callback, called after every network that is simulated.

        Returns
        -------
        dict
            The content of `summary.json`.

        Raises
        ------
        InputError
            If the format is unknown, or the folder cannot be written, or holds other files.
        """
        if kind not in (kinds := get_args(Format)):
            raise ValueRefusedError(f"kind is {shown(kind)}; give one of {', '.join(kinds)}")
        if networks is not None:
            check_count(networks, "networks")
        folder = as_path(folder, "folder")
        check_folder(folder)
        heart, population_size = self.simulator.model.heart, len(self.population)
        numbers = evenly_spread(population_size, population_size if networks is None else networks)
        simulated = self.networks(progress, chosen=numbers)
        named = {f"{k:03d}": network for k, network in zip(numbers, simulated, strict=False)}
        description = "evenly spread over the population"
        if not population_size:
            named, description = {"best": simulated[0]}, "the best network; none was accepted"
        elif networks is None:
            k = nearest_to_median(np.stack([network.beat.activation for network in simulated]))
            named, description = {f"{k:03d}": simulated[k]}, "nearest to the median activation map"
        content = {
            "verdict": self.verdict,
            "caution": self.statements.caution_text,
            "heart": heart.name,
            "heart_sha256": heart.digest,
            "population": population_size,
            "chosen": description,
            "networks": {name: dict(network.parameters) for name, network in named.items()},
        }
        with atomic_folder(folder) as temporary:
            write_networks(temporary, self.simulator.model, named, kind)
            write_text(temporary / "summary.json", json.dumps(content, indent=2) + "\n")
        return content


StudyLike = FittedStudy | Path | str  # a study, or the path of its folder


def as_study(study: StudyLike, progress: Progress | Lines | None = None) -> FittedStudy:
    """Return a fitted study as it is, or read it from its folder by `load_study`."""
    if isinstance(study, FittedStudy):
        return study
    folder = as_path(study, "study", "a fitted study, or the path of its folder")
    return load_study(folder, progress)


def load_study(
    folder: Path | str,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
    rules: GrowthRules | None = None,
) -> FittedStudy:
    """Read a finished study.

    Parameters
    ----------
    folder : path
        Folder of the study.
    progress : Progress, "lines" or None
        Progress callback, called while a large heart is prepared; by default lines on standard
        error.
    pool : Pool, optional
        Where networks are simulated; by default on as many threads as the fit used.
    rules : GrowthRules, optional
        Growth rules that `fit` was given, if any.

    Raises
    ------
    InputError
        If the folder is not a study, the study is not finished, or it was made with another
        version of the forward model.
    """
    check_pool(pool)
    folder, own_code = as_path(folder, "study"), rules is not None
    rules, study = checked_rules(rules), Study.open(folder)
    result = folder / RESULT[study.config.method]
    population = read_population(result)
    heart = load_heart(folder / StudyFile.HEART)
    recordings = read_recordings(folder, len(study.config.scenarios))
    digests = recording_digests(recordings)
    targets_unchanged = all(getattr(study.config, name) == value for name, value in digests.items())
    for name, unchanged in (
        (StudyFile.HEART, heart.digest == study.config.heart),
        ("target.nc", targets_unchanged),
    ):
        if not unchanged:
            raise InputError(
                f"{folder / name}: not the one that was fitted; put the original back, or fit again"
            )
    if not {*study.config.prior.names} <= {*population.best}:
        raise InputError(
            f"{result}: its parameters are not those of the study; run 'fascicle fit' "
            "again to rewrite it"
        )
    current_config = study.config.model_copy(update=growth_and_conduction(heart, rules))
    check_same(folder, study.config, current_config)
    inputs = Inputs(heart, recordings, study.config, rules)
    with shown_progress(progress) as shown:
        problem = InverseProblem.of(inputs, pool, shown)
    names = (*study.config.prior.names, *study.config.fixed)
    own_code |= any(quantity(name).apply is not None for name in names)
    own_code |= any(scenario.has_own_primitives for _, scenario in recordings if scenario)
    # a version has one forward model, but for rules, quantities and primitives of the user's own
    if own_code or population.version != VERSION:
        study.check_objective(problem.evaluate)
    if isinstance(population, Posterior):  # whose prior mixes its states
        problem = problem.with_states(population.states)
    return FittedStudy(
        study, problem.simulator, problem.recordings, population, *read_checks(result)
    )
