"""Families of scenarios that vary a delay, the site of a stimulus or its capture radius."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

from fascicle.core.errors import InputError
from fascicle.core.progress import Progress
from fascicle.forward.primitives import Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import name_in_library
from fascicle.heart.sites import LAYERS, SEGMENTS
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import check_population, simulate_scenarios
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import evenly_spread


class Varied(StrEnum):
    """Quantity in which the scenarios of a sweep differ."""

    SEGMENT = "segment"
    DELAY = "delay of the last stimulus after the first (ms)"
    RADIUS = "capture radius (mm)"


class Sweep(NamedTuple):
    """Scenarios by segment (1 to 17), delay (ms) or radius (mm)."""

    varied: Varied
    scenarios: dict[float, Scenario]


@dataclass(frozen=True)
class Swept:
    """A `Sweep` simulated in n networks, and why some scenarios are impossible."""

    varied: Varied
    predicted: dict[float, Predicted]
    impossible: dict[float, str]

    def called(self, key: float) -> str:
        """Name of a scenario of the family, such as ``"20 ms"``."""
        unit = self.varied.partition("(")[2].strip(")")
        return f"{key:g} {unit}" if unit else f"segment {key:g}"


def simulate_sweep(
    fitted: FittedStudy, sweep: Sweep, networks: int, progress: Progress | None = None
) -> Swept:
    """Simulate a family of scenarios in some networks, evenly spread over a study's population.

    Scenarios that cannot be simulated, such as of a segment without excitable tissue, are skipped.
    InputError means that the study has no network, or that no scenario can be simulated.
    """
    check_population(fitted)
    sample = fitted.networks(progress, chosen=evenly_spread(len(fitted.population), networks))
    swept = Swept(sweep.varied, {}, {})
    for key, scenario in sweep.scenarios.items():
        name = swept.called(key)
        try:
            simulated = simulate_scenarios(
                fitted.simulator, fitted.recordings[0], sample, {name: scenario}, progress
            )
        except InputError as error:
            swept.impossible[key] = str(error)
        else:
            swept.predicted[key] = simulated[name]
    if not swept.predicted:
        raise InputError(next(iter(swept.impossible.values())))
    return swept


def delays(scenario: Scenario, delays: str) -> Sweep:
    """Sweep of the delay (ms) of a scenario's last stimulus after its first.

    `delays` is ``"first:last:step"`` in ascending order, both ends included; a negative delay is
    before the first stimulus.
    """
    stimuli = scenario.of(Stimulus)
    if len(stimuli) < 2:
        raise InputError(f"{_called(scenario)}: {len(stimuli)} stimuli; a delay needs two of them")
    begin = min(stimulus.time for stimulus in stimuli[:-1])
    last = stimuli[-1:]
    return Sweep(
        Varied.DELAY, {d: _changed(scenario, last, time=begin + d) for d in _numbers(delays)}
    )


def segments(scenario: Scenario, layer: str) -> Sweep:
    """Sweep of a scenario's last myocardial stimulus over all segments, in one of `LAYERS`."""
    if layer not in LAYERS:
        raise InputError(f"there is no layer '{layer}'; choose {' or '.join(LAYERS)}")
    moved = _of_the_myocardium(scenario)[-1:]
    sites = {float(k): f"segment {k} {layer}" for k in range(1, len(SEGMENTS) + 1)}
    return Sweep(
        Varied.SEGMENT,
        {k: _changed(scenario, moved, position=None, site=s) for k, s in sites.items()},
    )


def radii(scenario: Scenario, radii: str) -> Sweep:
    """Sweep of the capture radius (mm) of a scenario's myocardial stimuli, as in `delays`."""
    changed = _of_the_myocardium(scenario)
    return Sweep(Varied.RADIUS, {r: _changed(scenario, changed, radius=r) for r in _numbers(radii)})


def _of_the_myocardium(scenario: Scenario) -> list[Stimulus]:
    stimuli = [stimulus for stimulus in scenario.of(Stimulus) if stimulus.tree is None]
    if not stimuli:
        raise InputError(
            f"{_called(scenario)}: no stimulus of the myocardium, which the sweep could change"
        )
    return stimuli


def _changed(scenario: Scenario, stimuli: Sequence[Stimulus], **changes: Any) -> Scenario:
    """Scenario with some of its stimuli changed."""
    chosen = {id(stimulus) for stimulus in stimuli}
    return scenario.mapped(lambda p: replace(p, **changes) if id(p) in chosen else p)


def _called(scenario: Scenario) -> str:
    """Name of a scenario of the library, or the file of another one."""
    return name_in_library(scenario) or scenario.source or "the scenario"


def _numbers(text: str) -> list[float]:
    try:
        first, last, step = map(float, text.split(":"))
        count = int((last - first) / step + 1e-9) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(f"'{text}' is no sweep; give first:last:step, as -60:60:10") from None
    if step <= 0 or not 2 <= count <= 200:
        raise InputError(f"'{text}' has {count} steps; give 2 to 200 that go up, as -60:60:10")
    return [first + k * step for k in range(count)]
