"""The prior of a study: quantities learnt, fixed or averaged over, and its conduction states."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, get_args

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.conduction_states import (
    CONDUCTION_STATES,
    FASCICULAR_BLOCKS,
    NORMAL,
    ConductionState,
    told_apart,
)
from fascicle.core.errors import InputError
from fascicle.core.files import check_file, read_toml
from fascicle.core.parameters import (
    FREE,
    HUMAN_SPACE,
    Distribution,
    MixedParameter,
    Parameter,
    ParameterSpace,
    free,
    human_space,
    network_space,
    ordered_fascicles,
)
from fascicle.core.quantities import (
    GROUPS,
    SIDES,
    SPEED,
    check,
    check_not_twice,
    checked,
    default_of,
    fascicles,
    quantity,
    region_labels,
    stand_ins,
)
from fascicle.core.ranges import number, shown
from fascicle.forward.activation_sequence import LATE_QRS, MAPPED, VentricularSurfaces
from fascicle.forward.beat import Beat
from fascicle.heart.conduction import Conduction, Region
from fascicle.heart.heart import Heart
from fascicle.networks.settings import FitSettings, Method
from fascicle.purkinje.growth import GrowthRules


def study_space(
    method: Method, changes: Mapping[str, Any], heart: Heart
) -> tuple[ParameterSpace, dict[str, float]]:
    """Parameter space that a study learns, and fixed quantities that differ from their defaults.

    The method ``"paper"`` learns the paper's parameters of bundles and fascicles, root time and
    Purkinje conduction velocity; ``"posterior"`` has priors of human anatomy, the interventricular
    delay, and the conduction velocity of the myocardium along the fibre, where the heart does not
    give it. A quantity that stands for another one (`stand_ins`) replaces it. `changes` holds the
    user's choices, as `parameters` of `fascicle.fit`; a group of `GROUPS` that is ``"free"`` frees
    all of its quantities but those that are given separately.
    """
    human, changes = method == "posterior", without_groups(changes)
    default_counts: dict[str, Parameter | float] = {
        f"{side}_fascicles": default_of(f"{side}_fascicles") for side in SIDES
    }
    fascicle_counts = default_counts | ({"lv_fascicles": 3.0} if human else {})
    fascicle_counts |= {n: _chosen(n, changes[n], {}) for n in default_counts if n in changes}
    counts = {n[:2]: int(k) for n, k in fascicle_counts.items() if not isinstance(k, Parameter)}
    parameters = list((human_space if human else network_space)(**counts).parameters)
    chosen = {
        name: _chosen(name, value, {p.name: p for p in parameters})
        for name, value in changes.items()
        if name not in default_counts
    }
    check_not_twice(chosen)
    replaced = {other for name in (*chosen, *heart.values) for other in stand_ins(name)}
    replaced |= {*heart.values} & {*SPEED}
    parameters = [p for p in parameters if p.name in chosen or p.name not in replaced]
    for label, name in region_labels(chosen).items():
        Region(1.0, label, source=name).elements(heart)
    learnt = {p.name: p for p in parameters if not isinstance(chosen.get(p.name), float)}
    learnt |= {name: value for name, value in chosen.items() if isinstance(value, Parameter)}
    fixed = {name: value for name, value in chosen.items() if isinstance(value, float)}
    _check_fascicles(learnt.keys() | fixed.keys(), counts)
    if not learnt:
        raise InputError("every parameter is fixed, so nothing is left to learn; free one")
    space = ParameterSpace(tuple(learnt.values()))
    return ordered_fascicles(space) if method == "posterior" else space, fixed


# Quantities unknown in a patient, which are averaged over unless a study learns or fixes them;
# docs/quantities.md gives the sources of the priors.
NOT_KNOWN = (
    free("branch_length", prior="normal", median=8.0, sd=1.0),
    free("branch_angle", prior="normal", median=0.15, sd=0.03),
    free("repulsion", prior="normal", median=0.1, sd=0.03),
    free("anterograde_delay", lower=0.0, upper=3.0),
    free("rv_source", prior="log-normal", median=0.35, sd=0.4),
    free("axial_source", lower=0.0, upper=0.5),
)
# The plain tissue and variations of it, no more than a model keeps (`ForwardModel.tissues_kept`)
TISSUES: tuple[dict[str, float], ...] = (
    {},
    {"anisotropy_ratio": 2.0},
    {"anisotropy_ratio": 3.1},
    {"anisotropy_ratio": 2.1, "endocardial_layer": 2.0, "endocardial_speed": 1.6},
    {"anisotropy_ratio": 3.0, "endocardial_layer": 2.0, "endocardial_speed": 1.6},
)


@dataclass(frozen=True)
class AveragedOver:
    """Unknown quantities that vary in all simulations of a posterior, but are not reported.

    Attributes
    ----------
    space : ParameterSpace
        Quantities with their priors.
    tissues : tuple of mappings
        Quantities of the tissues; or, of an atlas, the hearts.
    weights : tuple of float
        Prior probabilities of the tissues; empty if they are equally probable.
    """

    space: ParameterSpace = field(default_factory=partial(ParameterSpace, ()))
    tissues: tuple[Mapping[str, float], ...] = ({},)
    weights: tuple[float, ...] = field(default=(), repr=False)  # simulations do not depend on it

    @classmethod
    def of(cls, space: ParameterSpace, fixed: Mapping[str, float], heart: Heart) -> AveragedOver:
        """Quantities to average over: neither learnt, nor fixed, nor given by the heart."""
        settled = {*space.names, *fixed, *heart.values}
        unsettled = tuple(p for p in NOT_KNOWN if p.name not in settled)
        if heart.atlas is not None and "atlas_heart" not in settled:
            hearts = tuple({"atlas_heart": float(k)} for k in range(len(heart.atlas)))
            return cls(ParameterSpace(unsettled), hearts, tuple(map(float, heart.atlas.weights)))
        varied = {name for tissue in TISSUES for name in tissue}
        return cls(ParameterSpace(unsettled), ({},) if settled & varied else TISSUES)

    def __len__(self) -> int:
        """Number of coordinates of a point."""
        return len(self.space) + (len(self.tissues) > 1)

    def tissue(self, points: Floats) -> Integers:
        """Index (n,) of the tissue at points (n, d) of the unit cube."""
        if len(self.tissues) == 1:
            return np.zeros(len(points), np.intp)
        return np.asarray(np.searchsorted(self.edges[1:-1], points[:, -1], side="right"))

    @property
    def edges(self) -> Floats:
        """Ends (n + 1,) of the intervals of the last coordinate that stand for tissues."""
        weights = self.weights or np.ones(len(self.tissues))
        return np.concatenate([[0.0], np.cumsum(weights) / np.sum(weights)])

    def columns(self, points: Floats) -> dict[str, Floats]:
        """Quantities (n,) at points (n, d) of the unit cube, without those of the tissues."""
        return self.space.columns(points[:, : len(self.space)])

    def values(self, point: Floats) -> dict[str, float]:
        """All quantities at a point (d,) of the unit cube."""
        (number,) = self.tissue(point[None])
        return {**self.space.from_unit(point[: len(self.space)]), **self.tissues[number]}


# Probability of keeping a network in the prior of mapped hearts although its activation sequence
# differs from theirs
UNMAPPED = 0.03


@dataclass(frozen=True)
class Prior:
    """Prior of the quantities of a heart, before its ECG is seen.

    The coordinates of a point of the unit cube are those of the learnt quantities, then those of
    the quantities averaged over; uniform random points are draws from the prior. If `mapped`,
    points whose intrinsic beats do not activate the ventricles in the sequence of mapped hearts are
    rejected (`keeps`).

    Attributes
    ----------
    space : ParameterSpace
        Quantities that are learnt, of any conduction state.
    fixed : mapping of str to float
        Quantities that are held at other values than their defaults.
    averaged : AveragedOver
        Quantities that are neither learnt nor reported.
    states : mapping of str to float
        Conduction states of which the prior is a mixture, and their probabilities; empty if the
        conduction state is not learnt.
    mapped : bool
        Whether intrinsic beats are activated in the sequence of mapped human hearts.
    """

    space: ParameterSpace
    fixed: Mapping[str, float] = field(default_factory=dict)
    averaged: AveragedOver = field(default_factory=AveragedOver)
    states: Mapping[str, float] = field(default_factory=dict)
    mapped: bool = False

    @classmethod
    def of(cls, method: Method, parameters: Mapping[str, Any], heart: Heart) -> Prior:
        """Prior of a study, before it is narrowed to conduction states.

        Parameters
        ----------
        method : str
            ``"paper"`` learns the paper's parameters; ``"posterior"`` has the priors of human
            anatomy, and averages over the quantities `NOT_KNOWN`.
        parameters : mapping of str to value
            Differences from these, as `parameters` of `fascicle.fit`.

        Raises
        ------
        InputError
            If there is no such quantity, a value or a prior cannot be used, or nothing is learnt.
        """
        space, fixed = study_space(method, parameters, heart)
        if method == "paper":
            return cls(space, fixed)
        return cls(space, fixed, AveragedOver.of(space, fixed, heart))

    @cached_property
    def learnt(self) -> ParameterSpace:
        """Quantities that are learnt, with the priors of all conduction states together."""
        return united(self.space, self.fixed, self.states) if self.states else self.space

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities that are learnt."""
        return self.space.names

    @property
    def dimension(self) -> int:
        """Number of coordinates of a point."""
        return len(self.space) + len(self.averaged)

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw points (count, d) of the unit cube, before any is rejected."""
        return rng.random((count, self.dimension))

    def from_unit(self, point: Floats) -> dict[str, float]:
        """All quantities at a point (d,) that are not at their defaults."""
        learnt, averaged = point[: len(self.space)], point[len(self.space) :]
        return {**self.fixed, **self.learnt.from_unit(learnt), **self.averaged.values(averaged)}

    def learnt_columns(self, points: Floats) -> dict[str, Floats]:
        """Learnt quantities (n,) at points (n, d)."""
        return self.learnt.columns(points[:, : len(self.space)])

    def columns(self, points: Floats) -> dict[str, Floats]:
        """All quantities (n,) at points (n, d), but for those of the tissues (`tissue`)."""
        columns = {name: np.full(len(points), value) for name, value in self.fixed.items()}
        averaged = self.averaged.columns(points[:, len(self.space) :])
        return columns | self.learnt_columns(points) | averaged

    def tissue(self, points: Floats) -> Integers:
        """Index (n,) of the tissue at points (n, d), among those averaged over."""
        return self.averaged.tissue(points[:, len(self.space) :])

    def keeps(self, point: Floats, surfaces: VentricularSurfaces, beat: Beat) -> bool:
        """Whether the intrinsic beat at a point (d,) belongs to the prior.

        A few points (`UNMAPPED`) with another activation sequence than mapped hearts belong to it,
        too. A hash of the coordinates decides which, so that a point is always kept or never.
        """
        if not self.mapped:
            return True
        sequence, latest = surfaces.sequence(beat.activation), MAPPED["total"].upper
        if self.averaged.weights and sequence.total < LATE_QRS:
            # in an atlas the last activation may be as late as normal QRS of people end
            sequence = replace(sequence, total=min(sequence.total, latest))
        return sequence.is_mapped or _chance(point) < UNMAPPED

    def narrowed(self, state: ConductionState) -> Prior:
        """Prior of one conduction state, which must be possible."""
        space = narrowed(state, self.space, self.fixed)
        assert space is not None
        fixed = {**self.fixed, **state.blocks}
        mapped = state.is_mapped({*space.names, *fixed})
        return Prior(space, fixed, self.averaged, mapped=mapped)

    def possible_states(self, conduction: Any, heart: Heart) -> tuple[ConductionState, ...]:
        """Conduction states that a user chose, as far as quantities and the heart allow them.

        Raises
        ------
        InputError
            If there is no such state, a prior probability is not positive, or no state is left.
        """
        settled = {**heart.values, **self.fixed}
        states = asked_states(conduction)
        states = tuple(
            state for state in states if narrowed(state, self.space, settled) is not None
        )
        if not states:
            raise InputError(
                "parameter 'conduction': what is fixed, the heart's values or the ranges exclude "
                "what was asked for; fix less, or leave it out"
            )
        return states

    def covers(self, other: Prior) -> bool:
        """True if simulations of this prior serve for another one, which is narrower.

        They do not if the other one learns fewer than half as many quantities: new simulations, in
        which these alone vary, teach an emulator more.
        """
        if 2 * len(other.space) < len(self.space) or other.mapped != self.mapped:
            return False
        covered, ranges = self._ranges(), other._ranges()
        changed = {n: v for n, v in other.fixed.items() if self.fixed.get(n) != v}
        ranges |= {name: (value, value) for name, value in changed.items()}
        ranges.pop("gain", None)  # a factor on the ECG
        if ranges.keys() != covered.keys() or other.averaged.tissues != self.averaged.tissues:
            return False
        return all(
            low <= ranges[name][0] and ranges[name][1] <= high
            for name, (low, high) in covered.items()
        )

    def _ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges of quantities; within 2 SD of the median where a normal prior is averaged over."""
        averaged = self.averaged.space.parameters
        ranges = {p.name: (p.lower, p.upper) for p in (*self.space.parameters, *averaged)}
        for p in averaged:
            if p.median is not None and p.sd is not None:
                low, high = p.median - 2 * p.sd, p.median + 2 * p.sd
                ranges[p.name] = max(p.lower, low), min(p.upper, high)
        return ranges


def _chance(point: Floats) -> float:
    """Number of 0 to 1 that depends on a point (d,) alone, like a random one."""
    digest = hashlib.sha256(np.ascontiguousarray(point, dtype=float).tobytes()).digest()
    return int.from_bytes(digest[:8]) / 2**64


def without_groups(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Replace each group of quantities that is free by its quantities."""
    quantities: dict[str, Any] = {}
    for name, value in changes.items():
        if name in GROUPS:
            if not (isinstance(value, str) and value == FREE):
                raise InputError(
                    f"parameter '{name}' is {shown(value)}: a group of quantities can only be "
                    f"'free'; give its quantities one by one: {', '.join(GROUPS[name][:2])}, ..."
                )
            quantities |= dict.fromkeys(GROUPS[name], FREE)
    return quantities | {name: value for name, value in changes.items() if name not in GROUPS}


def _chosen(name: str, value: Any, default: Mapping[str, Parameter]) -> Parameter | float:
    """Read the user's choice for a quantity: a parameter to learn, or a value to fix it at."""
    if isinstance(value, str) and value == FREE:
        return default.get(name) or free(name)
    if not isinstance(value, Mapping):
        return checked({name: value})[name]
    keys = ("prior", "lower", "upper", "median", "sd")
    if unknown := [key for key in value if key not in keys]:
        raise InputError(
            f"parameter '{name}': unknown key '{unknown[0]}'; known: {', '.join(keys)}"
        )
    priors = get_args(Distribution)
    prior = value.get("prior", "uniform")
    if not isinstance(prior, str) or prior not in priors:
        raise InputError(f"parameter '{name}': prior is {shown(prior)}; known: {', '.join(priors)}")
    numbers = {
        key: number(value[key], f"parameter '{name}': '{key}'") for key in value if key != "prior"
    }
    return free(name, **{**value, **numbers})


def _check_fascicles(names: set[str], counts: Mapping[str, int]) -> None:
    """Refuse parameters of fascicles beyond the number of fascicles."""
    for side, count in counts.items():
        for name in sorted(names):
            number = name.rpartition("_")[2]
            if name.startswith(f"{side}_fascicle_") and number.isdigit() and int(number) > count:
                raise InputError(
                    f"parameter '{name}': there are {count} {side.upper()} fascicles; fix "
                    f"{side}_fascicles at {number}"
                )


def read_settings(path: Path | str) -> dict[str, Any]:
    """Read a settings file: settings of the fit, and a table ``[parameters]``."""
    path = Path(path)
    check_file(path, (".toml",), "settings")
    values = read_toml(path, "write lines like 'steps = 100'")
    parameters = values.get("parameters", {})
    if not isinstance(parameters, dict):
        raise InputError(f"{path}: 'parameters' is not a table; write [parameters] above them")
    try:
        FitSettings(**{name: value for name, value in values.items() if name != "parameters"})
        for name, value in without_groups(parameters).items():
            if name == "conduction":
                asked_states(value)
            else:
                _chosen(name, value, {})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return values


def growth_and_conduction(heart: Heart, rules: GrowthRules) -> dict[str, Any]:
    """Constants of a heart's forward model, by field of a study's configuration."""
    conduction = Conduction.of(heart)
    numbers = asdict(conduction)
    del numbers["regions"]
    regions = {f"of {region.name}": region.conductivity for region in conduction.regions}
    return {
        "growth": rules.numbers,
        "growth_term": rules.term.function.__name__,
        "conduction": numbers | regions,
    }


def narrowed(
    state: ConductionState, space: ParameterSpace, fixed: Mapping[str, float]
) -> ParameterSpace | None:
    """Parameter space of a study of a state; None if `space` or `fixed` excludes the state."""
    usual = {p.name: p for p in HUMAN_SPACE.parameters}
    one_fascicle = fascicles("lv", [*space.names, *fixed]) < 2
    if one_fascicle and any(part.endswith("fascicle") for part in state.blocked):
        return None
    for name, value in fixed.items():
        low, high = state.ranges.get(name, (value, value))
        if not low <= value <= high:
            return None
    learnt = {p.name: p for p in space.parameters}
    for name, (low, high) in state.ranges.items():
        if name not in learnt:
            continue
        parameter = learnt[name]
        if parameter not in (free(name), usual.get(name)):
            low, high = max(low, parameter.lower), min(high, parameter.upper)
        if low >= high or not (parameter.median is None or low <= parameter.median <= high):
            return None
        learnt[name] = replace(parameter, lower=low, upper=high)
    return ParameterSpace(tuple(learnt.values()))


def state_label(name: str, names: Collection[str]) -> str:
    """Name of one of the states `names` for people, who must know if fascicular blocks are none."""
    untold = name == NORMAL and not {*FASCICULAR_BLOCKS} & {*names}
    return "normal or fascicular block" if untold else name


def states_of(priors: Mapping[str, float]) -> tuple[ConductionState, ...]:
    """Conduction states by name, with these prior probabilities."""
    return tuple(replace(CONDUCTION_STATES[name], probability=p) for name, p in priors.items())


def asked_states(conduction: Any) -> tuple[ConductionState, ...]:
    """Conduction states that the user chose: one, all, or a mapping of states to priors.

    Raises
    ------
    InputError
        If there is no such state, or a prior is not a positive number.
    """
    priors = {state.name: state.probability for state in told_apart()}
    if isinstance(conduction, Mapping):
        chosen = {
            name: number(p, f"parameter 'conduction': '{name}'") for name, p in conduction.items()
        }
        wrong = [name for name, p in chosen.items() if not (name in priors and 0 < p < math.inf)]
        if wrong or not chosen:
            raise InputError(
                f"parameter 'conduction': {wrong or 'nothing'}; give a prior above 0 for each of "
                f"some of {', '.join(priors)}"
            )
        return states_of(chosen)
    if isinstance(conduction, str) and conduction == FREE:
        return told_apart()
    value = check(quantity("conduction"), conduction)
    return states_of({[*CONDUCTION_STATES][int(value)]: 1.0})


def united(
    space: ParameterSpace, fixed: Mapping[str, float], probable: Mapping[str, float]
) -> ParameterSpace:
    """Parameter space of several states, with mixtures of their priors by their probabilities."""
    states = states_of(probable)
    spaces = [(state.probability, narrowed(state, space, fixed)) for state in states]
    total = sum(weight for weight, _ in spaces)
    weighted = [
        (weight / total, state_space.parameters)
        for weight, state_space in spaces
        if state_space is not None
    ]
    mixed = []
    for k, parameter in enumerate(space.parameters):
        parts = tuple((weight, parameters[k]) for weight, parameters in weighted)
        if any(part != parameter for _, part in parts):
            lower, upper = min(p.lower for _, p in parts), max(p.upper for _, p in parts)
            parameter = MixedParameter(parameter.name, parameter.unit, lower, upper, parts=parts)
        mixed.append(parameter)
    return ParameterSpace(tuple(mixed))
