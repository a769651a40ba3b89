"""A fitted study: its population, simulated, and what to know before it is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.quantities import region_labels
from fascicle.core.ranges import check_count, short_repr
from fascicle.inference.evaluation import Evaluation, best_of
from fascicle.purkinje.tree import FEW_JUNCTIONS
from fascicle.study.agreement import pearson
from fascicle.study.evaluations import Stage
from fascicle.study.population import Population, Posterior
from fascicle.study.predictive import Checks
from fascicle.study.simulator import PointSimulator
from fascicle.study.study import Study
from fascicle.study.target_comparison import Network, TargetComparison, networks, null_loss
from fascicle.study.verdict import explained, how_to_go_on, verdict

FEWEST_BEATS = 30  # below which a kernel density of their errors says little
LEAST_OF_THE_PAPER = 0.5  # share of the QRS; less is not the patient's network, by its method
AT_END = 0.01  # share of a prior; nearer to its end a value was stopped, not found
CROWDED = 0.4  # share of the networks in an outer tenth of a prior, where the prior has 0.1
LEAST_CORRELATION = 0.7  # of a lead's QRS; below, less than half of it (0.7²) is explained
USUAL_GAIN = (0.5, 2.0)  # hearts, bodies and contacts differ by less
LEAST_UNDER_QRS = 0.9  # of the energy of a simulated ECG; more lies there in every good fit
HEALTHY = 0  # label of ordinary tissue


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
        What was recorded.
    population : Population
        The networks that explain the target, and the best one.
    checks : Checks, optional
        Of a posterior against its recording.
    gains : (n,) array, optional
        By which the ECG of each network of a posterior is scaled: drawn from what the first
        recording says of it.
    """

    study: Study
    simulator: PointSimulator
    recordings: tuple[TargetComparison, ...]
    population: Population
    checks: Checks | None = None
    gains: Floats | None = None

    __repr__ = short_repr

    @property
    def folder(self) -> Path:
        """Where it is."""
        return self.study.folder

    @property
    def verdict(self) -> str:
        """What the networks are, and whether to trust them, in one line."""
        if isinstance(self.population, Posterior) and self.checks is not None:
            return verdict(self.population, self.checks)
        return self.networks_called

    @property
    def networks_called(self) -> str:
        """How many networks there are, and what they are."""
        count = f"{len(self.population)} networks"
        return f"{count}, a population and not a posterior" if self.of_the_paper else count

    @property
    def of_the_paper(self) -> bool:
        """Whether the networks were found by the paper's method."""
        return self.study.config.method == "paper"

    @property
    def candidates(self) -> list[Evaluation]:
        """What was tried for the population."""
        return [r.evaluation for r in self.study.records() if r.stage is Stage.REJECTION]

    @property
    def best_initial_loss(self) -> float:
        """Least mismatch among the points of the Latin hypercube (mV²)."""
        return best_of(r.evaluation for r in self.study.records() if r.stage is Stage.INITIAL).loss

    @property
    def explained(self) -> float:
        """Share of the energy of the recorded QRS that the best network explains, 0 to 1.

        Below 0 it is worse than a flat line.
        """
        return 1 - self.population.best_loss / self.null_loss

    @property
    def null_loss(self) -> float:
        """Loss of an ECG that is zero everywhere (mV²)."""
        return null_loss(self.recordings)

    @property
    def warnings(self) -> list[str]:
        """What a reader of the results must know first, a line each."""
        found = (
            _unexplained(self),
            _to_go_on(self),
            _unexplained_leads(self),
            _unusual_gain(self),
            _short(self),
            _few_beats(self),
            _not_the_minimum(self),
            _unbounded(self),
            _regions_taken_as_healthy(self),
            _at_end_of_range(self),
            _few_junctions(self),
            _outside_qrs(self),
        )
        return [warning for warning in found if warning]

    @cached_property
    def best_network(self) -> Network:
        """The network with the least mismatch, simulated."""
        return next(networks(self.simulator, self.recordings[0], [self.population.best]))

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
            In whose scenario, counted from 0.
        chosen : sequence of int, optional
            Which networks; all.
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
        found: list[Network] = []
        for network in networks(self.simulator, self.recordings[recording], learnt):
            if self.gains is not None and recording == 0:
                network = replace(network, drawn_gain=float(self.gains[chosen[len(found)]]))
            found.append(network)
            report(len(found), len(chosen))
        return found


def has_few_junctions(network: Network) -> bool:
    """Whether a tree of a network has so few junctions that it hardly is one."""
    return any(len(tree.junctions) < FEW_JUNCTIONS for tree in network.simulation.trees)


def _to_go_on(fitted: FittedStudy) -> str:
    """Say how a fit that has not converged goes on; nothing where that would not help."""
    config = fitted.study.config
    if not isinstance(fitted.population, Posterior) or _unexplained(fitted):
        return ""
    return how_to_go_on(fitted.population, config.effective, config.evaluations)


def _unexplained(fitted: FittedStudy) -> str:
    """Warn of networks that are not the patient's; empty if they may be."""
    if fitted.of_the_paper and fitted.explained < LEAST_OF_THE_PAPER:
        return (
            f"the best network explains {max(fitted.explained, 0):.0%} of the recorded QRS: "
            "heart, body or ECG do not fit together; look at its size (--free-gain) and speed "
            "(--free alpha) before you believe anything below"
        )
    if fitted.checks is None or explained(fitted.checks):
        return ""
    return (
        "no network of this heart and body gives this recording, however long the fit goes on: "
        "check that they are of one person, the electrodes, and the leads; docs/posterior.md, "
        "'When a fit fails', says what to try"
    )


def _unexplained_leads(fitted: FittedStudy) -> str:
    """Warn of compared leads whose shape the best network does not have."""
    found: dict[str, float] = {}
    for number, each in enumerate(fitted.recordings, 1):
        network = fitted.best_network
        if number > 1:
            network = next(networks(fitted.simulator, each, [fitted.population.best]))
        recorded, predicted = each.target.qrs, network.predicted[:, each.target.qrs_samples]
        of = f" of recording {number}" if len(fitted.recordings) > 1 else ""
        found |= {
            f"{name}{of}": pearson(recorded[lead], predicted[lead])
            for lead, name in enumerate(LEADS)
            if each.compared[lead]
        }
    poor = [f"{name} ({value:.2f})" for name, value in found.items() if value < LEAST_CORRELATION]
    if not poor:
        return ""
    return (
        f"the best network does not explain {', '.join(poor)}: the correlation of its QRS with the "
        f"recorded one is below {LEAST_CORRELATION}; check these electrodes and the heart's pose"
    )


def _unusual_gain(fitted: FittedStudy) -> str:
    """Warn of a gain, free or learnt, that the volume conductor does not explain."""
    gain = fitted.best_network.gain * fitted.best_network.parameters.get("gain", 1.0)
    if USUAL_GAIN[0] <= gain <= USUAL_GAIN[1]:
        return ""
    return (
        f"the best network's ECG had to be scaled by {gain:.2g}, where {USUAL_GAIN[0]} to "
        f"{USUAL_GAIN[1]} is usual; check the body, the conductivities and the units of the ECG"
    )


def _short(fitted: FittedStudy) -> str:
    """Warn of a population that is smaller than wanted."""
    count, wanted = len(fitted.population), fitted.study.config.samples
    if count >= wanted or not fitted.of_the_paper:
        return ""
    return (
        f"{count} of {wanted} networks were accepted of {len(fitted.candidates)} candidates, and "
        "the method ends there: too few to show how different they can be; the beats vary too "
        "little for its rule (--tolerance), or the search was too short (--steps, --rounds)"
    )


def _few_beats(fitted: FittedStudy) -> str:
    """Warn of a rule of acceptance that rests on too few beats."""
    count = len(fitted.recordings[0].target.beats)
    if count >= FEWEST_BEATS or not fitted.of_the_paper:
        return ""
    return (
        f"the recording has {count} beat{'s' * (count > 1)}: the rule of acceptance, total "
        f"variation between densities of the beats' errors, rests on too few below {FEWEST_BEATS}"
    )


def _not_the_minimum(fitted: FittedStudy) -> str:
    """Warn of a reference that is not the best network."""
    better = sum(e.feasible and e.loss < fitted.population.best_loss for e in fitted.candidates)
    if not better or not fitted.of_the_paper:
        return ""
    return (
        f"{better} of {len(fitted.candidates)} candidates match better than the network that all "
        "were compared with: the optimisation has not found the minimum (--steps)"
    )


def _unbounded(fitted: FittedStudy) -> str:
    """Warn of a heart without a body."""
    heart = fitted.simulator.model.heart
    if heart.torso is not None or heart.lead_fields is not None:
        return ""
    return (
        "the heart has no torso, and in the unbounded conductor the ratios of the leads are wrong "
        "(each 0.1 to 0.8 of what a torso makes of it); 'fascicle heart build' and 'heart import "
        "--torso idealised' make one"
    )


def _regions_taken_as_healthy(fitted: FittedStudy) -> str:
    """Warn of labelled regions of which nothing is said."""
    model = fitted.simulator.model
    if model.heart.regions is None:
        return ""
    own = {region.label for region in model.conduction.regions}
    learnt = region_labels((*fitted.simulator.space.names, *fitted.simulator.fixed))
    there = {int(label) for label in np.unique(model.heart.regions)}
    healthy = sorted(there - own - learnt.keys() - {HEALTHY})
    if not healthy:
        return ""
    return (
        f"regions {', '.join(map(str, healthy))} of the heart count as healthy; say "
        f"otherwise in its heart.toml, or by --fix region_{healthy[0]}_conductivity=0"
    )


def _at_end_of_range(fitted: FittedStudy) -> str:
    """Warn of parameters that were stopped by their ranges, not found."""
    crowded = _crowded_ends(fitted)
    names = [n for n in _stopped(fitted) if n not in crowded]
    found = [f"the best network lies at the end of the range of {', '.join(names)}"] * bool(names)
    if crowded:
        ends = ", ".join(
            f"{name} ({share:.0%} in the {end} tenth)" for name, (end, share) in crowded.items()
        )
        found.append(f"networks crowd at an end of the range of {ends}")
    if not found:
        return ""
    return (
        f"{'; '.join(found)}: what they say of that is the range's, or makes up for another fault "
        "of heart and body"
    )


def _stopped(fitted: FittedStudy) -> list[str]:
    """Parameters of which the best network is at an end of the prior."""
    space = fitted.simulator.space
    best = space.to_unit(fitted.population.best)
    at_end = np.minimum(best, 1 - best) < AT_END
    return [name for name, there in zip(space.names, at_end, strict=True) if there]


def _crowded_ends(fitted: FittedStudy) -> dict[str, tuple[str, float]]:
    """Parameters of which many networks are in the outer tenth of the prior, and at which end."""
    crowded = {}
    for parameter in fitted.simulator.space.parameters:
        values = fitted.population.values.get(parameter.name, np.empty(0))
        if not len(values):
            continue
        shares = parameter.to_unit(values)
        ends = {"lowest": float((shares < 0.1).mean()), "highest": float((shares > 0.9).mean())}
        end = max(ends, key=lambda name: ends[name])
        if ends[end] >= CROWDED:
            crowded[parameter.name] = end, ends[end]
    return crowded


def _few_junctions(fitted: FittedStudy) -> str:
    """Warn of trees that have hardly branched."""
    if not has_few_junctions(fitted.best_network):
        return ""
    counts = ", ".join(
        f"{len(tree.junctions)} ({tree.side.upper()})"
        for tree in fitted.best_network.simulation.trees
    )
    return (
        f"the best network has {counts} junctions, where {FEW_JUNCTIONS} to hundreds a side are "
        f"usual; --fewest-junctions {FEW_JUNCTIONS} leaves such networks out"
    )


def _outside_qrs(fitted: FittedStudy) -> str:
    """Warn of activity where the recording has none."""
    under = fitted.best_network.under_qrs
    if under >= LEAST_UNDER_QRS:
        return ""
    return (
        f"only {under:.0%} of the best network's ECG lies under the "
        "recorded QRS; is the QRS window right?"
    )
