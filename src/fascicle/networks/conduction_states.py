"""Conduction states that a study tells apart, with their priors."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from fascicle.core.errors import InputError
from fascicle.core.parameters import FREE, HUMAN_SPACE, MixedParameter, ParameterSpace, free
from fascicle.core.quantities import CONDUCTION, check, fascicles, quantity
from fascicle.core.ranges import number
from fascicle.forward.blocks import ANTERIOR, BLOCKED, POSTERIOR

Ranges = Mapping[str, tuple[float, float]]

# Ranges (ms) of the interventricular delay in mapped hearts, and where the left or right bundle
# branch conducts late; and of the root time, which a study may learn in its place
TOGETHER: Ranges = {"interventricular_delay": (3.0, 12.0), "root_time": (-20.0, 20.0)}
LEFT_LATE: Ranges = {"interventricular_delay": (-40.0, -5.0), "root_time": (-75.0, -20.0)}
RIGHT_LATE: Ranges = {"interventricular_delay": (15.0, 40.0), "root_time": (20.0, 50.0)}
SLOW: Ranges = {**TOGETHER, "alpha": (0.02, 0.04), "fibre_speed": (0.2, 0.4), "cv": (1.0, 2.5)}
USUAL = {p.name: p for p in HUMAN_SPACE.parameters}


@dataclass(frozen=True)
class ConductionState:
    """Conduction state, with its prior probability and the ranges of its quantities.

    Attributes
    ----------
    name : str
        One of `CONDUCTION`, which settles what is blocked.
    probability : float
        Prior probability, in proportion to those of the other states.
    ranges : mapping of name to (float, float)
        Ranges of quantities, in place of their usual ones.
    """

    name: str
    probability: float
    ranges: Ranges

    def is_mapped(self, names: Collection[str]) -> bool:
        """Whether its networks must activate the ventricles as mapped human hearts are.

        `names` are those of learnt and fixed quantities. A root time in place of the
        interventricular delay does not constrain the activation sequence.
        """
        return self.name == CONDUCTION[0] and "interventricular_delay" in names

    @property
    def number(self) -> float:
        """Value of the quantity `conduction`."""
        return float(CONDUCTION.index(self.name))

    @property
    def blocks(self) -> dict[str, float]:
        """The quantity `conduction`, if the state blocks a bundle or fascicle; else empty."""
        return {"conduction": self.number} if self.name in BLOCKED else {}

    def narrowed(self, space: ParameterSpace, fixed: Mapping[str, float]) -> ParameterSpace | None:
        """Parameter space of a study of this state; None if `space` or `fixed` excludes it."""
        one_fascicle = fascicles("lv", [*space.names, *fixed]) < 2
        if one_fascicle and {ANTERIOR, POSTERIOR} & {*BLOCKED.get(self.name, ())}:
            return None
        for name, value in fixed.items():
            low, high = self.ranges.get(name, (value, value))
            if not low <= value <= high:
                return None
        learnt = {p.name: p for p in space.parameters}
        for name, (low, high) in self.ranges.items():
            if name not in learnt:
                continue
            parameter = learnt[name]
            if parameter not in (free(name), USUAL.get(name)):
                low, high = max(low, parameter.lower), min(high, parameter.upper)
            if low >= high or not (parameter.median is None or low <= parameter.median <= high):
                return None
            learnt[name] = replace(parameter, lower=low, upper=high)
        return ParameterSpace(tuple(learnt.values()))


# Prior probabilities of the states that are told apart, in adults who are referred for an ECG
# (docs/diagnosis.md); fascicular blocks count as normal
PREVALENCE = {
    "normal": 0.855,
    "left bundle branch block": 0.025,
    "left bundle branch delay": 0.01,
    "right bundle branch block": 0.03,
    "right bundle branch delay": 0.05,
    "intraventricular delay": 0.03,
}
KNOWN_STATES = tuple(
    ConductionState(name, PREVALENCE.get(name, 1.0), ranges)
    for name, ranges in {
        **dict.fromkeys(CONDUCTION, TOGETHER),
        "left bundle branch delay": LEFT_LATE,
        "right bundle branch delay": RIGHT_LATE,
        "intraventricular delay": SLOW,
    }.items()
)
# A fascicular block changes the ECG of a network less than the discrepancy of the model does
STATES = tuple(state for state in KNOWN_STATES if state.name in PREVALENCE)


def state_label(name: str) -> str:
    """Name of a state for people, who must know that fascicular blocks are not told apart."""
    return "normal or fascicular block" if name == CONDUCTION[0] else name


def states_of(priors: Mapping[str, float]) -> tuple[ConductionState, ...]:
    """Conduction states by name, with these prior probabilities."""
    named = {state.name: state for state in KNOWN_STATES}
    return tuple(replace(named[name], probability=prior) for name, prior in priors.items())


def asked_states(asked: Any) -> tuple[ConductionState, ...]:
    """Conduction states that the user chose: one, all, or a mapping of states to priors.

    Raises
    ------
    InputError
        If there is no such state, or a prior is not a positive number.
    """
    priors = {state.name: state.probability for state in STATES}
    if isinstance(asked, Mapping):
        chosen = {name: number(p, f"parameter 'conduction': '{name}'") for name, p in asked.items()}
        wrong = [name for name, p in chosen.items() if not (name in priors and 0 < p < math.inf)]
        if wrong or not chosen:
            raise InputError(
                f"parameter 'conduction': {wrong or 'nothing'}; give a prior above 0 for each of "
                f"some of {', '.join(priors)}"
            )
        return states_of(chosen)
    if isinstance(asked, str) and asked == FREE:
        return STATES
    value = check(quantity("conduction"), asked)
    return states_of({CONDUCTION[int(value)]: 1.0})


def united(
    space: ParameterSpace, fixed: Mapping[str, float], probable: Mapping[str, float]
) -> ParameterSpace:
    """Parameter space of several states, with mixtures of their priors by their probabilities."""
    spaces = [(state.probability, state.narrowed(space, fixed)) for state in states_of(probable)]
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
