"""Verdict, caution and warnings of a result, and statements on its parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import Enum, StrEnum
from functools import cached_property
from itertools import combinations
from typing import Any, Protocol

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.conduction_states import CONDUCTION_STATES, FASCICULAR_BLOCKS, NORMAL
from fascicle.core.parameters import Parameter
from fascicle.core.quantities import SHOWN_UNITS, parameter_name, region_labels
from fascicle.emulation.predictive import Checks
from fascicle.inference.evaluation import Evaluation
from fascicle.inference.tempered_sampling import EVIDENCE_APART, MEANS_APART
from fascicle.networks.agreement import pearson
from fascicle.networks.prior import state_label
from fascicle.networks.settings import FitSettings
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network, TargetComparison
from fascicle.purkinje.tree import FEW_JUNCTIONS
from fascicle.study.population import Population, Posterior

INTERVAL = (5, 95)  # percentiles of a 90 % credible interval
# Measures of the hearts of an atlas that are reported, and their units
HEART_MEASURES = {
    "lv_volume": ("left ventricular cavity", "ml"),
    "lv_mass": ("left ventricular mass", "g"),
    "lv_wall": ("left free wall", "mm"),
    "rv_volume": ("right ventricular cavity", "ml"),
    "elevation": ("long axis below the horizontal", "°"),
    "azimuth": ("long axis to the left of straight ahead", "°"),
}


class Result(Protocol):
    """Input of `Statements`: a `fascicle.study.fitted.FittedStudy`."""

    @property
    def settings(self) -> FitSettings: ...  # noqa: D102
    @property
    def population(self) -> Population: ...  # noqa: D102
    @property
    def checks(self) -> Checks | None: ...  # noqa: D102
    @property
    def simulator(self) -> PointSimulator: ...  # noqa: D102
    @property
    def recordings(self) -> tuple[TargetComparison, ...]: ...  # noqa: D102
    @property
    def best_network(self) -> Network: ...  # noqa: D102
    @property
    def candidates(self) -> list[Evaluation]: ...  # noqa: D102
    @property
    def explained(self) -> float: ...  # noqa: D102
    def best_in(self, recording: int) -> Network: ...  # noqa: D102


class Caution(Enum):
    """Reason why numbers cannot be relied on: for sentences, and for tables and figures."""

    NOT_CONVERGED = "not to be relied on", "not to be relied on: the fit has not converged"
    POOR_FIT = "poor fit", "intervals are those of a model that does not fit the ECG"
    UNMAPPED = (
        "not a mapped sequence of activation",
        "the networks activate the ventricles as no mapped heart with this QRS is activated",
    )
    EMULATOR = (
        "emulator not exact enough",
        "the emulator is not exact enough for these networks: do not rely on the intervals",
    )

    def __init__(self, brief: str, text: str) -> None:
        self.brief = brief  # beginning of a sentence
        self.text = text  # above tables and figures, and in files


class Kind(StrEnum):
    """Subject of a warning."""

    POOR_FIT = "poor fit"
    NOT_CONVERGED = "not converged"
    PACED = "paced"
    CONDUCTION = "conduction"
    LEADS = "leads"
    GAIN = "gain"
    FEW_NETWORKS = "few networks"
    FEW_BEATS = "few beats"
    NOT_THE_MINIMUM = "not the minimum"
    NO_TORSO = "no torso"
    REGIONS = "regions"
    END_OF_RANGE = "end of range"
    FEW_JUNCTIONS = "few junctions"
    OUTSIDE_QRS = "outside the QRS"
    OUTSIDE_NETWORKS = "outside the networks"
    EMULATOR = "emulator"


@dataclass(frozen=True)
class ResultWarning:
    """Warning that a reader of a result must know first."""

    kind: Kind
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class ParameterStatement:
    """Posterior of a parameter: median, credible interval, and contraction from the prior.

    `lower` and `upper` bound the posterior's 90 % credible interval; `contraction` is 1 − posterior
    variance / prior variance, in quantiles of the prior, 0 to 1; `first_alone` is half of the 90 %
    interval given the first of several recordings alone; `along_fibre` is, for α, the conduction
    velocity along the fibre (m/s): median and bounds of the 90 % credible interval;
    `prior_interval` bounds 90 % of the hearts of an atlas. `caution` is the reason why the
    posterior cannot be relied on, in which no parameter is constrained.
    """

    name: str
    unit: str
    median: float
    lower: float
    upper: float
    contraction: float
    first_alone: float | None = None
    along_fibre: tuple[float, float, float] | None = None
    caution: str = ""
    prior_interval: tuple[float, float] | None = None

    @property
    def constrained(self) -> bool:
        """True if the ECG constrains the parameter: removes at least half of its prior variance."""
        return self.contraction >= 0.5 and not self.caution

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {SHOWN_UNITS.get(self.unit, self.unit)}"
        alone = ""
        if self.first_alone is not None:
            alone = f"; first recording alone ±{self.first_alone:.2g}{unit}"
        speed = ""
        if self.along_fibre is not None:
            speed = "{:.2f} m/s ({:.2f}–{:.2f}) along the fibre, ".format(*self.along_fibre)
        how = "constrained by the ECG" if self.constrained else "not identifiable from the ECG"
        # decimals of two digits of the interval's width; with other draws further digits change
        width = max(self.upper - self.lower, 0.01 * abs(self.median), 1e-9)
        decimals = max(0, 1 - math.floor(math.log10(width)))

        def span(low: float, high: float) -> str:
            return f"{low:z.{decimals}f}{' to ' if low < 0 else '–'}{high:z.{decimals}f}"

        median, interval = f"{self.median:z.{decimals}f}{unit}", span(self.lower, self.upper)
        if self.prior_interval is not None:
            before = f"before the ECG {span(*self.prior_interval)}"
            return f"{median} (90 % CrI {interval}; {before})" + f", {self.caution}" * bool(
                self.caution
            )
        return f"{median} (90 % CrI {interval}{alone}), {speed}{self.caution or how}"


@dataclass(frozen=True)
class Correlated:
    """Two parameters that are strongly correlated in the posterior, with their rank correlation."""

    first: str
    second: str
    rank_correlation: float

    def __str__(self) -> str:
        return (
            f"{parameter_name(self.first)} and {parameter_name(self.second)} are strongly "
            f"correlated in the posterior (rank correlation {self.rank_correlation:.2f})"
        )


class Statements:
    """All statements about a result."""

    def __init__(self, result: Result) -> None:
        self._result = result

    @property
    def verdict(self) -> str:
        """Summary of the networks, and whether to trust them, in one line."""
        population, checks = self._result.population, self._result.checks
        if isinstance(population, Posterior) and checks is not None:
            fit = f"fit acceptable: {checks.explained_in_words}"
            if not checks.acceptable:
                ends = ", ".join(map(parameter_name, _crowded(self._result)))
                failures = checks.failures + ([f"at the end of its range: {ends}"] if ends else [])
                fit = f"poor fit: {'; '.join(failures)}"
            parts = [self.no_image, self.unmapped, self.diagnosis, _convergence(population), fit]
            parts.append(checks.emulator_off)
            return "; ".join(part for part in parts if part)
        return self.networks_called

    @property
    def no_image(self) -> str:
        """Statement that the hearts are not from an image of the person; empty if they may be."""
        numbers = getattr(self._result.population, "averaged", {}).get("atlas_heart")
        no_image = self._result.simulator.model.heart.no_image
        if not no_image or numbers is None:
            return no_image
        return f"{no_image} ({len(np.unique(numbers))} in the networks)"

    @cached_property
    def hearts(self) -> tuple[ParameterStatement, ...]:
        """Statements on size and pose of the heart, averaged over an atlas; else empty."""
        population, atlas = self._result.population, self._result.simulator.model.heart.atlas
        if atlas is None or not (isinstance(population, Posterior) and population.converged):
            return ()
        numbers = population.averaged["atlas_heart"].astype(int)
        statements = []
        for name, (title, unit) in HEART_MEASURES.items():
            values = atlas.measures[name]
            mean = np.average(values, weights=atlas.weights)
            prior_variance = np.average((values - mean) ** 2, weights=atlas.weights)
            contraction = 1 - min(float(values[numbers].var() / prior_variance), 1.0)
            interval = _median_and_interval(values[numbers])
            before = np.percentile(values, INTERVAL, weights=atlas.weights, method="inverted_cdf")
            statement = ParameterStatement(
                title, unit, *interval, contraction, caution=self._caution_brief,
                prior_interval=(float(before[0]), float(before[1])),
            )  # fmt: skip
            statements.append(statement)
        return tuple(statements)

    @property
    def diagnosis(self) -> str:
        """Statement on conduction states (`states`), or the reason why none is named."""
        population, prior = self._result.population, self._result.simulator.prior
        if prior.mapped or "conduction" in prior.fixed:
            number = int(prior.fixed.get("conduction", 0))
            return f"conduction fixed at {[*CONDUCTION_STATES][number]}"
        if getattr(population, "states", {}):
            unnamed = getattr(population, "unnamed", "")
            reason = unnamed if self._caution_of_states is None else self._caution_of_states.brief
            if reason:
                return f"no conduction state is named ({reason})"
        return self.states

    @property
    def _caution_of_states(self) -> Caution | None:
        """Caution for the states' probabilities; None if they are calibrated on people."""
        states = getattr(self._result.population, "states", {})
        return None if {*FASCICULAR_BLOCKS} & {*states} else self.caution

    @property
    def states(self) -> str:
        """Probability of each conduction state, the most probable first.

        Empty if the state is not learnt, or the result is not to be relied on; probabilities that
        are calibrated on people do not depend on the fit.
        """
        states = getattr(self._result.population, "states", {})
        unnamed = getattr(self._result.population, "unnamed", "")
        if not states or self._caution_of_states is not None or unnamed:
            return ""
        least = 0.02  # probability of a conduction state that is named
        named = {name: p for name, p in states.items() if p >= least}
        ranked = sorted(named, key=lambda name: -named[name])
        less_probable = [f"others below {least}"] if len(named) < len(states) else []
        alike = [
            f" (block and delay of the {side} bundle branch give much the same ECG)"
            for side in ("left", "right")
            if {f"{side} bundle branch block", f"{side} bundle branch delay"} <= {*named}
        ]
        probabilities = (f"{state_label(name, states)}: {named[name]:.2f}" for name in ranked)
        ranking = ", ".join([*probabilities, *less_probable])
        return ranking + "".join(alike)

    @property
    def networks_called(self) -> str:
        """Number and kind of the networks."""
        count = f"{len(self._result.population)} networks"
        if self._result.settings.method == "paper":
            return f"{count}, a population and not a posterior"
        from_user = not isinstance(self._result.population, Posterior)
        return f"{count} of your own, which were not compared with the ECG" if from_user else count

    @property
    def converged(self) -> bool | None:
        """True if both runs of a posterior ended, and agree; None without a posterior."""
        population = self._result.population
        return population.converged if isinstance(population, Posterior) else None

    @property
    def acceptable(self) -> bool | None:
        """True if the recordings look like what the networks predict; None without checks."""
        return None if self._result.checks is None else self._result.checks.acceptable

    @property
    def caution(self) -> Caution | None:
        """Caution to state with every number; None if the posterior can be relied on.

        Also None for the paper's population, whose verdict says that it is not a posterior.
        """
        if self.converged is None:
            return None
        if not self.converged:
            return Caution.NOT_CONVERGED
        if self.acceptable is False:
            return Caution.POOR_FIT
        if self.unmapped:
            return Caution.UNMAPPED
        checks = self._result.checks
        return Caution.EMULATOR if checks is not None and checks.emulator_off else None

    @cached_property
    def _caution_brief(self) -> str:
        return "" if self.caution is None else self.caution.brief

    @property
    def unmapped(self) -> str:
        """Difference of the intrinsic beat from mapped hearts that no block explains.

        Empty if there is no difference, or no posterior.
        """
        checks, states = self._result.checks, getattr(self._result.population, "states", {})
        blocked = bool(states) and max(states, key=lambda name: states[name]) != NORMAL
        return "" if checks is None or blocked else checks.unmapped

    @property
    def sequence(self) -> list[str]:
        """Lines that compare the networks' activation sequence with that of mapped hearts."""
        checks = self._result.checks
        return [] if checks is None or checks.sequence is None else checks.sequence.lines

    @property
    def caution_text(self) -> str | None:
        """`Caution.text`, or None."""
        return None if self.caution is None else self.caution.text

    @cached_property
    def parameters(self) -> tuple[ParameterStatement, ...]:
        """Statement on every parameter; empty if the runs do not agree."""
        posterior = self._result.population
        if not (isinstance(posterior, Posterior) and posterior.converged):
            return ()
        parameters = self._result.simulator.prior.learnt.parameters
        return tuple(self._statement(parameter, posterior) for parameter in parameters)

    def _statement(self, parameter: Parameter, posterior: Posterior) -> ParameterStatement:
        name, alone, along_fibre = parameter.name, posterior.first_alone or {}, None
        values = posterior.values[name]
        # variance of the quantiles of the prior, over 1/12, that of a uniform distribution
        remaining = float(np.var(parameter.to_unit(values)) * 12)
        if name == "alpha":  # the conduction velocity along the fibre is proportional to it
            conduction = self._result.simulator.model.conduction
            along_fibre = _median_and_interval(values * conduction.speeds[0] / conduction.alpha)
        return ParameterStatement(
            name,
            parameter.unit,
            *_median_and_interval(values),
            1 - min(remaining, 1),
            _half_width(alone[name]) if name in alone else None,
            along_fibre,
            self._caution_brief,
        )

    @cached_property
    def correlated(self) -> tuple[Correlated, ...]:
        """Pairs of parameters with rank correlation of 0.7 or more; empty if not converged."""
        return correlated(self._result.population) if self.converged else ()

    @cached_property
    def warnings(self) -> tuple[ResultWarning, ...]:
        """Warnings that a reader of the result must know first."""
        return tuple(ResultWarning(kind, text) for kind, text in _warnings(self._result) if text)

    def content(self) -> dict[str, Any]:
        """All statements, for JSON."""
        return {
            "verdict": self.verdict,
            "caution": self.caution_text,
            "converged": self.converged,
            "fit_acceptable": self.acceptable,
            "sequence": self.sequence,
            "warnings": [asdict(warning) for warning in self.warnings],
            "parameters": [
                asdict(statement) | {"constrained": statement.constrained}
                for statement in self.parameters
            ],
            **({"heart": [asdict(statement) for statement in self.hearts]} if self.hearts else {}),
            "strongly_correlated": [asdict(pair) for pair in self.correlated],
        }


def _convergence(posterior: Posterior) -> str:
    if posterior.converged:
        return "converged"
    first, second = posterior.log_evidences
    name, apart = max(posterior.means_apart.items(), key=lambda item: item[1])
    reasons = [f"{posterior.effective.sum():.0f} effective draws"]
    if abs(first - second) > EVIDENCE_APART:
        reasons.append(f"log evidence {first:.1f} and {second:.1f} of two runs")
    if apart > MEANS_APART:
        reasons.append(f"means of {parameter_name(name)} {apart:.1f} SD apart")
    return f"NOT CONVERGED ({', '.join(reasons)})"


def _median_and_interval(values: Floats) -> tuple[float, float, float]:
    median, lower, upper = np.percentile(values, (50, *INTERVAL))
    return float(median), float(lower), float(upper)


def _half_width(values: Floats) -> float:
    """Half of the 90 % interval of draws (n,)."""
    return float(np.diff(np.percentile(values, INTERVAL))[0]) / 2


def correlated(posterior: Population) -> tuple[Correlated, ...]:
    """Pairs of parameters whose rank correlation is 0.7 or more."""
    from scipy.stats import spearmanr

    names: Sequence[str] = list(posterior.values)
    pairs = (
        Correlated(a, b, float(spearmanr(posterior.values[a], posterior.values[b]).statistic))
        for a, b in combinations(names, 2)
    )
    return tuple(pair for pair in pairs if abs(pair.rank_correlation) >= 0.7)


def prediction_statement(values: Floats, prior: Floats) -> str:
    """Statement on whether the ECG constrains a prediction (ms) of networks (n,); prior (m,)."""
    constrained = np.var(values) <= 0.5 * np.var(prior)
    how = "constrained by" if constrained else "not identifiable from"
    return (
        f"90 % CrI ±{_half_width(values):.0f} ms (prior ±{_half_width(prior):.0f} ms), "
        f"{how} the ECG"
    )


def has_few_junctions(network: Network) -> bool:
    """True if a tree of a network has fewer junctions than a usable tree."""
    return any(len(tree.junctions) < FEW_JUNCTIONS for tree in network.beat.trees)


def _warnings(result: Result) -> Iterator[tuple[Kind, str]]:
    poor = _poor_fit(result)
    yield Kind.POOR_FIT, poor
    # a longer fit would not mend a poor one
    if isinstance(result.population, Posterior) and not poor:
        yield Kind.NOT_CONVERGED, how_to_go_on(result.population, result.settings)
    checks = result.checks
    if checks is not None and checks.acceptable and checks.outside:
        yield (
            Kind.OUTSIDE_NETWORKS,
            f"{checks.outside}: beyond nine tenths of the networks, though not beyond the "
            "errors that the model allows",
        )
    if checks is not None and checks.emulator_off:
        yield (
            Kind.EMULATOR,
            f"{checks.emulator_off}: the posterior is the emulator's; --prior-simulations "
            f"{2 * result.settings.prior_simulations}, in a new study, makes it better",
        )
    if any(r.target.earliest_onset is not None and r.scenario is None for r in result.recordings):
        yield (
            Kind.PACED,
            "the recorded beats are paced, and the networks are of an intrinsic beat: give the "
            "scenario (target.nc:rv-apical-pacing), or see where they begin ('fascicle locate')",
        )
    yield Kind.CONDUCTION, _block_left_out(result)
    yield Kind.LEADS, _poor_leads(result)
    yield Kind.GAIN, _unusual_gain(result)
    if result.settings.method == "paper":
        yield from _of_the_paper(result)
    heart = result.simulator.model.heart
    if not heart.has_torso:
        yield (
            Kind.NO_TORSO,
            "the heart has no torso, and in the unbounded conductor the ratios of the leads are "
            "wrong (each 0.1 to 0.8 of what a torso makes of it); 'fascicle heart build' and "
            "'heart import --torso idealised' make one",
        )
    yield Kind.REGIONS, _regions_taken_as_healthy(result)
    yield Kind.END_OF_RANGE, _at_end_of_range(result)
    best = result.best_network
    if has_few_junctions(best):
        trees = best.beat.trees
        counts = ", ".join(f"{len(tree.junctions)} ({tree.side.upper()})" for tree in trees)
        yield (
            Kind.FEW_JUNCTIONS,
            f"the best network has {counts} junctions, where {FEW_JUNCTIONS} to hundreds a side "
            f"are usual; --fewest-junctions {FEW_JUNCTIONS} leaves such networks out",
        )
    if best.under_qrs < 0.9:  # of the energy of a simulated ECG; more lies there in good fits
        yield (
            Kind.OUTSIDE_QRS,
            f"only {best.under_qrs:.0%} of the best network's ECG lies under the recorded QRS; is "
            "the QRS window right?",
        )


def _poor_fit(result: Result) -> str:
    """Warning that the networks do not fit the recording; else empty."""
    if result.settings.method == "paper":
        if result.explained >= 0.5:  # of the QRS; less is not the patient's network
            return ""
        return (
            f"the best network explains {max(result.explained, 0):.0%} of the recorded QRS: "
            "heart, torso or ECG do not fit together; look at its size (--free-gain) and speed "
            "(--free alpha) before you believe anything below"
        )
    if result.checks is None or result.checks.acceptable:
        return ""
    return (
        "none of the sampled networks reproduces the recorded QRS, and a longer fit would not: "
        "check that they are of one person, the electrodes, and the leads; 'fascicle docs "
        "posterior', 'When a fit fails', says what to try"
    )


def how_to_go_on(posterior: Posterior, settings: FitSettings) -> str:
    """Advice on settings with which the runs of a fit may agree; empty if they do."""
    if posterior.converged:
        return ""
    return (
        f"the two runs do not agree, or one is worth fewer than {settings.effective / 2:.0f} "
        f"independent draws: --prior-simulations {2 * settings.prior_simulations}, in a new study, "
        "makes the emulator, and so the likelihood, smoother"
    )


def _block_left_out(result: Result) -> str:
    """Warning of a block by conventional criteria where conduction is fixed at normal; or empty."""
    if not result.simulator.prior.mapped:
        return ""
    intrinsic = (r.target for r in result.recordings if r.scenario is None)
    met = {c.name: c.source for target in intrinsic for c in target.conventional_criteria if c.met}
    if not met:
        return ""
    named = ", ".join(f"{name} ({source})" for name, source in met.items())
    return (
        f"conduction is fixed at normal, but the recording meets the criteria of {named}: fit "
        "without --fix conduction, in a new study"
    )


def _poor_leads(result: Result) -> str:
    """Warning of compared leads whose shape the best network does not reproduce; or empty."""
    least = 0.7  # correlation; below, less than half of a lead (0.7²) is explained
    poor = []
    for number, recording in enumerate(result.recordings):
        predicted = result.best_in(number).predicted[:, recording.target.qrs_samples]
        of = f" of recording {number + 1}" if len(result.recordings) > 1 else ""
        for lead in np.flatnonzero(recording.compared):
            value = pearson(recording.target.qrs[lead], predicted[lead])
            if value < least:
                poor.append(f"{recording.target.leads[lead]}{of} ({value:.2f})")
    if not poor:
        return ""
    pose = "" if result.simulator.model.heart.no_image else " and the heart's pose"
    return (
        f"the best network does not explain {', '.join(poor)}: the correlation of its QRS with the "
        f"recorded one is below {least}; check these electrodes{pose}"
    )


def _unusual_gain(result: Result) -> str:
    """Warning of a gain, free or learnt, that the volume conductor does not explain; or empty."""
    best = result.best_network
    gain = best.gain * best.parameters.get("gain", 1.0)
    if 0.5 <= gain <= 2.0:  # hearts, torsos and contacts differ by less
        return ""
    return (
        f"the best network's ECG had to be scaled by {gain:.2g}, where 0.5 to 2.0 is usual; check "
        "the torso, the conductivities and the units of the ECG"
    )


def _of_the_paper(result: Result) -> Iterator[tuple[Kind, str]]:
    """Warnings about the paper's rule of acceptance."""
    count, samples, candidates = len(result.population), result.settings.samples, result.candidates
    if count < samples:
        yield (
            Kind.FEW_NETWORKS,
            f"{count} of {samples} networks were accepted of {len(candidates)} candidates, and the "
            "method ends there: too few to show how different they can be; the beats vary too "
            "little for its rule (--tolerance), or the search was too short (--steps, --rounds)",
        )
    beats = len(result.recordings[0].target.beats)
    if beats < 30:
        yield (
            Kind.FEW_BEATS,
            f"the recording has {beats} beat{'s' * (beats > 1)}: the rule of acceptance, total "
            "variation between densities of the beats' errors, rests on too few below 30",
        )
    better = sum(e.feasible and e.loss < result.population.best_loss for e in candidates)
    if better:
        yield (
            Kind.NOT_THE_MINIMUM,
            f"{better} of {len(candidates)} candidates match better than the network that all were "
            "compared with: the optimisation has not found the minimum (--steps)",
        )


def _regions_taken_as_healthy(result: Result) -> str:
    """Warning of labelled regions without conduction properties; or empty."""
    model, simulator = result.simulator.model, result.simulator
    if model.heart.regions is None:
        return ""
    described = {region.label for region in model.conduction.regions}
    learnt = region_labels((*simulator.prior.names, *simulator.prior.fixed))
    labels = {int(label) for label in np.unique(model.heart.regions)}
    healthy = sorted(labels - described - learnt.keys() - {0})  # 0 is ordinary tissue
    if not healthy:
        return ""
    return (
        f"regions {', '.join(map(str, healthy))} of the heart count as healthy; say "
        f"otherwise in its heart.toml, or by --fix region_{healthy[0]}_conductivity=0"
    )


def _crowded(result: Result) -> dict[str, str]:
    """Parameters of which the prior's lowest or highest tenth holds 40 % of the networks."""
    crowded = {}
    for parameter in result.simulator.prior.learnt.parameters:
        shares = parameter.to_unit(result.population.values.get(parameter.name, np.empty(0)))
        for end, inside in (("lowest", shares < 0.1), ("highest", shares > 0.9)):
            if len(shares) and inside.mean() >= 0.4:
                crowded[parameter.name] = f"{inside.mean():.0%} in the {end} tenth"
    return crowded


def _at_end_of_range(result: Result) -> str:
    """Warning of parameters that are limited by their ranges, not by the ECG; or empty."""
    space, population, crowded = result.simulator.prior.learnt, result.population, _crowded(result)
    best = {p.name: float(p.to_unit(np.array(population.best[p.name]))) for p in space.parameters}
    at_end = [
        name for name, share in best.items() if min(share, 1 - share) < 0.01 and name not in crowded
    ]
    reasons = []
    if at_end:
        ends = ", ".join(map(parameter_name, at_end))
        reasons.append(f"the best network lies at the end of the range of {ends}")
    if crowded:
        ends = ", ".join(f"{parameter_name(name)} ({where})" for name, where in crowded.items())
        reasons.append(f"many networks lie at an end of the range of {ends}")
    if not reasons:
        return ""
    return (
        f"{'; '.join(reasons)}: that end, or an error of heart or torso, may have decided these "
        "values"
    )
