"""Scenarios over a population: what each of its networks does in each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers, Singles
from fascicle.core.brief import brief
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.ranges import check_items, check_kind, check_text
from fascicle.forward.ecg.electrocardiogram import STEP
from fascicle.forward.loss import placed
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import read_scenarios
from fascicle.forward.simulation import Simulation
from fascicle.prediction.indices import INDICES, Territories, indices
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.recording.window import qrs_window
from fascicle.study.activation_maps import activation_maps
from fascicle.study.bank import prior_points
from fascicle.study.fit import GivenStudy, as_study
from fascicle.study.problem import Network, Problem
from fascicle.study.results import FittedStudy

OWN_BEAT = "intrinsic"  # the scenario that others are compared with
LEAD_IN, LEAD_OUT = 10, 20  # samples before the QRS onset, and after the last QRS's end
RINGING = 40  # samples on either side, for what the recorder's filters add; at least `LEAD_IN`
PRIOR_NETWORKS = 60


@dataclass(frozen=True)
class PredictedBeat:
    """What is kept of one simulation, in single precision: of a fine heart there are hundreds.

    Attributes
    ----------
    leads : (12, n_time) array
        ECG (mV) every 1 ms, with the gain that matches the recording best, or that was drawn.
    filtered : (12, n_time + 2 * `RINGING`) array
        The same as the recorder would have it, from `RINGING` samples before to as many after. A
        steep filter rings about the QRS, so that indices are not read off it.
    activation : (n,) array
        Activation time of each vertex of the heart (ms); inf where no front arrives.
    trees : tuple of (PurkinjeTree, (n_nodes,) array)
        The trees, left first, and when each of their nodes is reached (ms).
    captured : (n_stimuli,) bool array
        Which of the scenario's stimuli of the tissue came before any front was there.
    """

    leads: Floats
    filtered: Floats
    activation: Singles
    trees: tuple[tuple[PurkinjeTree, Singles], ...]
    captured: Booleans

    __repr__ = brief

    @classmethod
    def of(
        cls, simulation: Simulation, leads: Floats, filtered: Floats, captured: Booleans
    ) -> PredictedBeat:
        """What is kept of a simulation; `leads`, `filtered` and `captured` as above."""
        times = (each.astype(np.float32) for each in simulation.coupled.trees)
        trees = tuple(zip(simulation.trees, times, strict=True))
        return cls(leads, filtered, simulation.activation.astype(np.float32), trees, captured)


@dataclass(frozen=True)
class Predicted:
    """What one scenario does in n networks.

    Attributes
    ----------
    scenario : Scenario
        What was predicted.
    beats : sequence of PredictedBeat
        Of each network.
    indices : mapping of name to (n,) array
        `INDICES` of each.
    effective : float
        How many independent networks they are worth; n, if nothing less is known.
    """

    scenario: Scenario
    beats: Sequence[PredictedBeat]
    indices: Mapping[str, Floats]
    effective: float = np.inf

    __repr__ = brief

    def extremes(self) -> dict[str, int]:
        """Networks with the least, the median and the largest total activation time."""
        order = np.argsort(self.indices["total_activation_time"], kind="stable")
        return {
            "minimum": int(order[0]),
            "median": int(order[(len(order) - 1) // 2]),
            "maximum": int(order[-1]),
        }

    @property
    def captured(self) -> Floats:
        """Share of the networks that each stimulus of the tissue captures, shape (n_stimuli,)."""
        return np.asarray(np.mean([beat.captured for beat in self.beats], axis=0))

    @cached_property
    def maps(self) -> dict[str, Floats]:
        """`activation_maps` of the networks."""
        return activation_maps(np.array([beat.activation for beat in self.beats]))


def with_own_beat(scenarios: Mapping[str, Scenario]) -> dict[str, Scenario]:
    """The heart's own beat, which others are compared with, and then the scenarios.

    Raises
    ------
    InputError
        If another scenario has its name.
    """
    if scenarios.get(OWN_BEAT, Scenario()) != Scenario():
        raise InputError(
            f"{scenarios[OWN_BEAT].source or 'a scenario'}: '{OWN_BEAT}' is the heart's own beat, "
            "which all others are compared with; give this one another name"
        )
    return {OWN_BEAT: Scenario(description="the heart's own beat"), **scenarios}


def predict(
    fitted: GivenStudy,
    scenarios: Mapping[str, Scenario] | Sequence[str | Path] | str | Path,
    progress: Progress | None = None,
    networks: Sequence[Network] | None = None,
) -> dict[str, Predicted]:
    """Simulate the own beat and scenarios in every network of a study.

    The trees stay as they were learnt, and all else of a network that a scenario does not change.

    Parameters
    ----------
    fitted : FittedStudy or path
        The study, or its folder.
    scenarios : mapping of name to Scenario, or one or several of str or Path
        What to predict; names of the library (``"his-pacing"``) and files are read.
    progress : Progress, optional
        Called after each network that is simulated.
    networks : sequence of Network, optional
        Those to take instead of all of the study.

    Returns
    -------
    dict of name to Predicted
        The own beat first, then the scenarios in their order.

    Raises
    ------
    InputError
        If the study has no network, there is no such scenario, or it does not fit the heart.
    """
    fitted = as_study(fitted, progress)
    check_population(fitted)
    scenarios = as_scenarios(scenarios)
    if networks is None:
        networks = fitted.networks(progress)
    check_items(networks, Network, "networks", "those that the study's 'networks()' gives")
    if not networks:
        raise InputError("there is no network to predict with; give one or more")
    found = simulate_scenarios(fitted.problem, networks, with_own_beat(scenarios), progress)
    effective = fitted.population.effective_size
    return {name: replace(each, effective=effective) for name, each in found.items()}


def as_scenarios(
    given: Mapping[str, Scenario] | Sequence[str | Path] | str | Path,
) -> Mapping[str, Scenario]:
    """Scenarios by name, read if they are names or files."""
    if not isinstance(given, Mapping):
        return read_scenarios(given)
    for name, scenario in given.items():
        check_text(name, "name of a scenario")
        check_kind(scenario, Scenario, f"scenario '{name}'", "a fascicle.Scenario")
    return given


def check_population(fitted: FittedStudy) -> None:
    """Refuse a study without networks."""
    if not len(fitted.population):
        raise InputError(
            f"{fitted.folder}: no network was found, so there is nothing to draw or to predict "
            "with; fit with more steps or more initial points"
        )


def simulate_scenarios(
    problem: Problem,
    networks: Sequence[Network],
    scenarios: Mapping[str, Scenario],
    progress: Progress | None = None,
    of: str = "",
) -> dict[str, Predicted]:
    """Simulate scenarios in networks.

    Parameters
    ----------
    problem : Problem
        Of the study: heart, target, and where to simulate.
    networks : sequence of Network
        The n networks, simulated.
    scenarios : mapping of name to Scenario
        What to simulate.
    progress : Progress, optional
        Called as networks are done, a stage for each scenario.
    of : str
        What the stages are called beside the scenario's name.
    """
    sites = problem.model.sites
    territories = Territories.of(problem.model.heart, sites.places)
    predicted = {}
    for name, scenario in scenarios.items():
        report, beats, found = stage_progress(progress, name + of), [], []
        try:
            owners = scenario.located(sites).owners
            each_network = partial(_simulate, territories, scenario, owners)
            for beat, values in problem.pool.map(each_network, problem, networks):
                beats.append(beat)
                found.append(values)
                report(len(beats), len(networks))
        except InputError as error:
            raise InputError(f"{scenario.source or name}: {error}") from None
        each = {index: np.array([values[index] for values in found]) for index in INDICES}
        predicted[name] = Predicted(scenario, beats, each)
    return predicted


def _simulate(
    territories: Territories,
    scenario: Scenario,
    owners: Integers,
    problem: Problem,
    network: Network,
) -> tuple[PredictedBeat, dict[str, float]]:
    simulation = problem.model.activate(
        network.simulation.trees, scenario=scenario, **network.parameters
    )
    gain = network.gain if network.drawn_gain is None else network.drawn_gain
    leads = gain * simulation.leads
    length, response = leads.shape[1] + 2 * RINGING, problem.target.response
    values = indices(replace(simulation, leads=leads), territories, scenario.first_stimulus)
    filtered = placed(leads, -RINGING, length, response)
    captured = np.bincount(owners, simulation.coupled.captured) > 0
    return PredictedBeat.of(simulation, leads, filtered, captured), values


def prior_networks(problem: Problem, progress: Progress | None = None) -> list[Network]:
    """Networks of the prior, which know nothing of the recording.

    Parameters
    ----------
    problem : Problem
        Its space is the prior.
    progress : Progress, optional
        Called as networks are simulated.
    """
    points = prior_points(len(problem.space), PRIOR_NETWORKS)
    report, networks = stage_progress(progress, "networks of the prior"), []
    for done, point in enumerate(points, 1):
        (found,) = problem.simulate([point])
        if isinstance(found, Simulation):
            values = {**problem.fixed, **problem.space.from_unit(point)}
            networks.append(Network(values, found, found.leads, 1.0, 1.0))
        report(done, len(points))
    return networks


def qrs_aligned(predicted: Predicted) -> tuple[Floats, Floats]:
    """ECGs as the recorder would have them, from the QRS onsets on.

    Parameters
    ----------
    predicted : Predicted
        Of n networks.

    Returns
    -------
    time : (t,) array
        Time from QRS onset (ms).
    ecgs : (n, 12, t) array
        Potentials (mV), of all until the longest QRS has ended.
    """
    windows = [qrs_window(beat.leads, STEP) for beat in predicted.beats]
    length = LEAD_IN + max(offset - onset for onset, offset in windows) + LEAD_OUT
    ecgs = np.zeros((len(windows), len(LEADS), length))
    for ecg, beat, (onset, _) in zip(ecgs, predicted.beats, windows, strict=True):
        begin = RINGING + onset - LEAD_IN
        ecg[:] = np.pad(beat.filtered, ((0, 0), (0, length)))[:, begin : begin + length]
    return np.asarray((np.arange(length) - LEAD_IN) * STEP, dtype=np.float64), ecgs
