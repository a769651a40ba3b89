"""Comparison of scenarios: two by the reduction of an index, or a family that varies one number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.stats import rankdata

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.progress import Progress
from fascicle.core.ranges import check_kind, short_repr, within
from fascicle.forward.primitives import Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import name_in_library
from fascicle.heart.sites import LAYERS, SEGMENTS
from fascicle.prediction.index_names import INDICES, check_index
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC, check_population, simulate_scenarios
from fascicle.recording.window import OFFSET_ERROR, ONSET_ERROR
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import evenly_spread

SIGNED = ("lv_rv_delay",)
# Further measurements, with their standard deviations: an ECG during right ventricular pacing, with
# the uncertainty of its QRS window; electrograms of the intrinsic beat, with some 5 ms for the
# activation time within them.
MEASURABLE = {
    ("rv-apical-pacing", "qrs_duration"): float(np.hypot(ONSET_ERROR, OFFSET_ERROR)),
    ("rv-apical-pacing", "qrs_area"): 5.0,
    (INTRINSIC, "lv_rv_delay"): 5.0,
    (INTRINSIC, "lv_activation_time"): 5.0,
}


def missing_blocks(name: str, predicted: Mapping[str, Predicted], against: str) -> str:
    """Warn that a pacing scenario lacks a block of the scenario it is compared with; else empty.

    His bundle pacing, which may capture below a block, lacks none.
    """
    pacing, other = predicted[name].scenario, predicted[against].scenario
    missing = sorted(other.blocks - pacing.blocks)
    if not missing or not pacing.of(Stimulus):
        return ""
    return (
        f"{against} blocks {' and '.join(missing)}, and {name} does not: what it shortens is also "
        "due to the missing block; give the pacing the block, too ('fascicle docs predictions')"
    )


@dataclass(frozen=True)
class Comparison:
    """Two scenarios in each of n networks, by one index.

    Attributes
    ----------
    index, unit : str
        One of `COMPARED`, and its unit.
    reductions : (n,) array
        Second scenario's index less the first's.
    effective : float
        Effective number of independent networks, at most n.
    """

    index: str
    unit: str
    reductions: Floats
    effective: float
    fewest: ClassVar[int] = 20  # independent networks below which no correlation is reported

    __repr__ = short_repr

    def probability(self, threshold: float = 0.0) -> float:
        """Probability that the reduction exceeds a threshold; a tie counts half."""
        threshold = within("threshold", threshold, "threshold")
        more, ties = self.reductions > threshold, self.reductions == threshold
        return float(more.mean() + ties.mean() / 2)

    def standard_error(self, threshold: float = 0.0) -> float:
        """Standard error of that probability for the effective number of networks."""
        count = self.effective
        share = (count * self.probability(threshold) + 0.5) / (count + 1)  # not 0 where all agree
        return float(np.sqrt(share * (1 - share) / count))

    @property
    def median(self) -> float:
        """Median reduction."""
        return float(np.median(self.reductions))

    @property
    def interval(self) -> tuple[float, float]:
        """5th and 95th percentile of the reduction."""
        low, high = np.percentile(self.reductions, (5, 95))
        return float(low), float(high)

    def __str__(self) -> str:
        """Median reduction with its interval, such as ``6 ms (90 % CrI -11 to 22)``."""
        numbers = np.round([self.median, *self.interval]) + 0.0  # no minus before a 0
        middle, low, high = (f"{number:.0f}" for number in numbers)
        return f"{middle} {self.unit} (90 % CrI {low} to {high})"

    @property
    def change(self) -> str:
        """Reduction of a duration in words: ``shortened by …``, or ``prolonged by …``."""
        if self.median >= 0:
            return f"shortened by {self}"
        return f"prolonged by {replace(self, reductions=-self.reductions)}"

    def variance_explained_by(self, parameters: Mapping[str, Floats]) -> list[tuple[str, float]]:
        """Share of the reduction's variance, in ranks, that each parameter alone explains.

        Squared rank correlations, adjusted for the effective number of networks, the largest first;
        empty below `fewest`. Strongly correlated parameters each have the shared part;
        joint effects of several are in none. `parameters` has the values (n,) in the networks.
        """
        if self.effective < self.fewest:
            return []
        shares = {name: self._explained_by(values) for name, values in parameters.items()}
        return sorted(shares.items(), key=lambda item: -item[1])

    def value_of_measurement(
        self, predicted: Mapping[str, Predicted]
    ) -> list[tuple[str, str, float]]:
        """Share of the reduction's variance, in ranks, that a further measurement would remove.

        The squared rank correlation of the measured index with the reduction, times the
        measurement's reliability: scenario, index and share, the most useful first, of those of
        `MEASURABLE` that are among the scenarios, by name, in the same networks.
        """
        measurements = []
        for (scenario, index), error in MEASURABLE.items():
            if scenario in predicted and self.effective >= self.fewest:
                values = predicted[scenario].indices[index]
                reliability = float(np.var(values) / (np.var(values) + error**2))
                measurements.append((scenario, index, reliability * self._explained_by(values)))
        return sorted(measurements, key=lambda item: -item[2])

    def _explained_by(self, values: Floats) -> float:
        """Squared rank correlation with the reduction, adjusted for chance correlation."""
        ranks = np.array([rankdata(values), rankdata(self.reductions)])
        constant = (np.ptp(ranks, axis=1) == 0).any()  # correlates with nothing
        unexplained = 1 - (0.0 if constant else float(np.corrcoef(ranks)[0, 1])) ** 2
        return max(0.0, 1 - unexplained * (self.effective - 1) / (self.effective - 2))


def compare(first: Predicted, second: Predicted, index: str) -> Comparison:
    """Compare two scenarios in the same networks.

    Parameters
    ----------
    first, second : Predicted
        Of the same networks.
    index : str
        One of `COMPARED`.

    Raises
    ------
    InputError
        If the index is not one of them, or the networks differ.
    """
    for scenario in (first, second):
        check_kind(scenario, Predicted, "scenario", "one of what fascicle.predict returned")
    check_index(index)
    first_values, second_values = first.indices[index], second.indices[index]
    if len(first_values) != len(second_values) or not _of_the_same_networks(first, second):
        counts = f"{len(first_values)} networks cannot be compared with {len(second_values)}"
        counts += " others" * (len(first_values) == len(second_values))
        raise InputError(f"{counts}; predict both scenarios with the same ones")
    if index in SIGNED:
        first_values, second_values = np.abs(first_values), np.abs(second_values)
    effective = min(len(first_values), first.effective, second.effective)
    return Comparison(index, INDICES[index], second_values - first_values, effective)


def _of_the_same_networks(first: Predicted, second: Predicted) -> bool:
    """True if the intrinsic Purkinje networks, which no scenario changes, are the same."""
    return all(
        np.array_equal(tree.nodes, other.nodes)
        for a, b in zip(first.beats, second.beats, strict=True)
        for tree, other in zip(a.trees[:2], b.trees[:2], strict=True)
    )


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
