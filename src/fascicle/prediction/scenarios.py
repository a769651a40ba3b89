"""Simulations of scenarios in every network of a population."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.progress import Lines, Progress, shown_progress, stage_progress
from fascicle.core.ranges import check_items, check_kind, check_text
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import SAMPLE_STEP
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import read_scenarios
from fascicle.networks.prior import states_of
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network, TargetComparison
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.indices import Territories, indices
from fascicle.prediction.predicted import RINGING, Predicted, PredictionCache
from fascicle.study.fitted import FittedStudy, StudyLike, as_study

INTRINSIC = "intrinsic"  # the scenario that others are compared with
LEAD_IN = 10  # samples of aligned ECGs before the QRS onset, `RINGING` at most


def with_intrinsic_beat(scenarios: Mapping[str, Scenario]) -> dict[str, Scenario]:
    """Put the intrinsic beat before the scenarios, none of which may have its name."""
    if scenarios.get(INTRINSIC, Scenario()) != Scenario():
        raise InputError(
            f"{scenarios[INTRINSIC].source or 'a scenario'}: '{INTRINSIC}' is the intrinsic beat, "
            "which all others are compared with; give this one another name"
        )
    return {INTRINSIC: Scenario(description="the intrinsic beat"), **scenarios}


def predict(
    fitted: StudyLike,
    scenarios: Mapping[str, Scenario] | Sequence[str | Path] | str | Path,
    progress: Progress | Lines | None = "lines",
    networks: Sequence[Network] | None = None,
) -> dict[str, Predicted]:
    """Simulate the intrinsic beat and scenarios in every network of a study.

    The Purkinje networks are as learnt, except for the changes that the scenario names.

    Parameters
    ----------
    fitted : FittedStudy or path
        The study, or its folder.
    scenarios : mapping of name to Scenario, or one or several of str or Path
        Scenarios to predict; names of the library (``"his-pacing"``) and files are read.
    progress : Progress, "lines" or None
        Called with the number of simulated networks; by default lines on standard error show it.
    networks : sequence of Network, optional
        All networks of the study, if they are simulated already.

    Returns
    -------
    dict of name to Predicted
        The intrinsic beat first, then the scenarios in their order.

    Raises
    ------
    InputError
        If the study has no network, or a scenario does not exist or does not fit the heart.
    """
    with shown_progress(progress) as shown:
        fitted = as_study(fitted, shown)
    check_population(fitted)
    requested = with_intrinsic_beat(as_scenarios(scenarios))
    if networks is not None:
        check_items(networks, Network, "networks", "those that the study's 'networks()' gives")
        if len(networks) != len(fitted.population):
            raise InputError(
                f"{len(networks)} networks, where the study has {len(fitted.population)}; give all "
                "that its 'networks()' gives"
            )
    cache = PredictionCache(fitted)
    predicted = cache.read(requested)
    missing = {name: scenario for name, scenario in requested.items() if name not in predicted}
    if missing:
        with shown_progress(progress) as shown:
            networks = fitted.networks(shown) if networks is None else networks
            simulated = simulate_scenarios(
                fitted.simulator, fitted.recordings[0], networks, missing, shown
            )
        cache.write(simulated)
        predicted |= simulated
    effective = fitted.population.effective_size
    return {name: replace(predicted[name], effective=effective) for name in requested}


def as_scenarios(
    scenarios: Mapping[str, Scenario] | Sequence[str | Path] | str | Path,
) -> Mapping[str, Scenario]:
    """Scenarios by name, read if they are names or files."""
    if not isinstance(scenarios, Mapping):
        return read_scenarios(scenarios)
    for name, scenario in scenarios.items():
        check_text(name, "name of a scenario")
        check_kind(scenario, Scenario, f"scenario '{name}'", "a fascicle.Scenario")
    return scenarios


def check_population(fitted: FittedStudy) -> None:
    """Refuse a study without networks."""
    if not len(fitted.population):
        raise InputError(
            f"{fitted.folder}: no network was found, so there is nothing to draw or to predict "
            "with; fit with more steps or more initial points"
        )


def simulate_scenarios(
    simulator: PointSimulator,
    recording: TargetComparison,
    networks: Sequence[Network],
    scenarios: Mapping[str, Scenario],
    progress: Progress | None = None,
    of: str = "",
) -> dict[str, Predicted]:
    """Simulate scenarios in networks that were simulated in the scenario of a recording.

    The ECGs pass the recording's filters. Each scenario is a stage of the progress, named after it
    and the text `of`.
    """
    model = simulator.model
    territories = Territories.of(model.heart, model.sites.places)
    predicted = {}
    for name, scenario in scenarios.items():
        report, beats, index_values = stage_progress(progress, name + of), [], []
        try:
            # the recording's scenario is simulated already
            new = None if scenario == (recording.scenario or Scenario()) else scenario
            each_network = partial(_simulate, territories, scenario, new)
            for beat, values in simulator.pool.map(each_network, networks, model):
                beats.append(beat)
                index_values.append(values)
                report(len(beats), len(networks))
        except InputError as error:
            raise InputError(f"{scenario.source or name}: {error}") from None
        by_index = {
            index: np.array([values[index] for values in index_values]) for index in INDICES
        }
        predicted[name] = Predicted(scenario, beats, by_index, response=recording.target.response)
    return predicted


def _simulate(
    territories: Territories,
    scenario: Scenario,
    new: Scenario | None,
    network: Network,
    model: ForwardModel,
) -> tuple[Beat, dict[str, float]]:
    beat = network.beat
    if new is not None:
        beat = model.activate(beat.trees, scenario=new, **network.parameters)
    gain = network.gain if network.drawn_gain is None else network.drawn_gain
    beat = replace(beat, leads=gain * beat.leads)
    territories = territories.of_network(model.heart, network.parameters)
    return beat.in_single_precision(), indices(beat, territories, scenario.first_stimulus)


def prior_networks(
    fitted: FittedStudy, progress: Progress | None = None, count: int = 60
) -> list[Network]:
    """Networks drawn from the prior of a study, and of its conduction states.

    Of 30 points drawn for each of `count` networks, the first that belongs to the prior is used.
    The seed is fixed, so that the networks are always the same.
    """
    simulator, config, rng = fitted.simulator, fitted.study.config, np.random.default_rng(0)
    simulators = [
        replace(simulator, prior=config.prior.narrowed(state)) for state in states_of(config.states)
    ] or [simulator]
    numbers = rng.choice(len(simulators), count, p=[*config.states.values()] or None)
    report, networks = stage_progress(progress, "networks of the prior"), []
    for done, number in enumerate(numbers, 1):
        for point in simulator.prior.sample(rng, 30):
            (beat,), prior = simulators[number].simulate([point]), simulators[number].prior
            if isinstance(beat, Beat) and prior.keeps(point, simulator.model.surfaces, beat):
                networks.append(Network(prior.from_unit(point), beat, beat.leads, 1.0, 1.0))
                break
        report(done, len(numbers))
    return networks


def qrs_aligned(*predicted: Predicted) -> tuple[Floats, list[Floats]]:
    """ECGs of scenarios as the recorder would show them, aligned at the QRS onset.

    Returns times (t,) from the onset (ms), and potentials (n, 12 + k, t), mV, of each scenario, up
    to the end of the longest QRS.
    """
    windows = [[beat.qrs_window for beat in one.beats] for one in predicted]
    longest = max(
        offset - onset for scenario_windows in windows for onset, offset in scenario_windows
    )
    length = LEAD_IN + longest + 20  # isoelectric samples after the longest
    rows = len(predicted[0].beats[0].leads)
    ecgs = [np.zeros((len(prediction.beats), rows, length)) for prediction in predicted]
    for scenario_ecgs, prediction, scenario_windows in zip(ecgs, predicted, windows, strict=True):
        for k, (ecg, (onset, _)) in enumerate(zip(scenario_ecgs, scenario_windows, strict=True)):
            begin = RINGING + onset - LEAD_IN
            padded = np.pad(prediction.filtered(k), ((0, 0), (0, length)))
            ecg[:] = padded[:, begin : begin + length]
    return np.asarray((np.arange(length) - LEAD_IN) * SAMPLE_STEP, dtype=np.float64), ecgs
