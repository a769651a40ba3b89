"""The conduction states that a study tells apart, with their priors."""

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

# Ranges (ms) in mapped hearts, and of ventricles whose bundle branch is late; root times that are
# learnt in place of interventricular delays
TOGETHER: Ranges = {"interventricular_delay": (3.0, 12.0), "root_time": (-20.0, 20.0)}
LEFT_LATE: Ranges = {"interventricular_delay": (-40.0, -5.0), "root_time": (-75.0, -20.0)}
RIGHT_LATE: Ranges = {"interventricular_delay": (15.0, 40.0), "root_time": (20.0, 50.0)}
SLOW: Ranges = {**TOGETHER, "alpha": (0.02, 0.04), "fibre_speed": (0.2, 0.4), "cv": (1.0, 2.5)}
USUAL = {p.name: p for p in HUMAN_SPACE.parameters}


@dataclass(frozen=True)
class ConductionState:
    """A state, how probable it is before the ECG is seen, and what its networks are like.

    Attributes
    ----------
    name : str
        One of `CONDUCTION`, which says what is blocked.
    probability : float
        Prior, in proportion to those of the others.
    ranges : mapping of name to (float, float)
        Of quantities, in place of their usual ones.
    """

    name: str
    probability: float
    ranges: Ranges

    def is_mapped(self, names: Collection[str]) -> bool:
        """Whether its networks activate the ventricles in the sequence of mapped human hearts.

        `names` are of what is learnt or fixed: by root times that sequence is not constrained.
        """
        return self.name == CONDUCTION[0] and "interventricular_delay" in names

    @property
    def number(self) -> float:
        """Value of the quantity `conduction`."""
        return float(CONDUCTION.index(self.name))

    @property
    def blocks(self) -> dict[str, float]:
        """The quantity, where it is more than a name for the values of others."""
        return {"conduction": self.number} if self.name in BLOCKED else {}

    def narrowed(self, space: ParameterSpace, fixed: Mapping[str, float]) -> ParameterSpace | None:
        """What a study of this state learns; None if what is asked for excludes it."""
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
            asked = learnt[name]
            if asked not in (free(name), USUAL.get(name)):
                low, high = max(low, asked.lower), min(high, asked.upper)
            if low >= high or not (asked.median is None or low <= asked.median <= high):
                return None
            learnt[name] = replace(asked, lower=low, upper=high)
        return ParameterSpace(tuple(learnt.values()))


# How probable the states are, that are told apart, in adults who are referred for an ECG
# (docs/diagnosis.md); fascicular blocks belong to the first
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
    """What a state is called where fascicular blocks are not told apart from it."""
    return "normal or fascicular block" if name == CONDUCTION[0] else name


def states_of(priors: Mapping[str, float]) -> tuple[ConductionState, ...]:
    """The states of these names, with these priors."""
    named = {state.name: state for state in KNOWN_STATES}
    return tuple(replace(named[name], probability=prior) for name, prior in priors.items())


def asked_states(asked: Any) -> tuple[ConductionState, ...]:
    """The states that were asked for: one, all, or those with a prior of their own.

    Raises
    ------
    InputError
        If there is no such state, or a prior is none.
    """
    priors = {state.name: state.probability for state in STATES}
    if isinstance(asked, Mapping):
        given = {name: number(p, f"parameter 'conduction': '{name}'") for name, p in asked.items()}
        wrong = [name for name, p in given.items() if not (name in priors and 0 < p < math.inf)]
        if wrong or not given:
            raise InputError(
                f"parameter 'conduction': {wrong or 'nothing'}; give a prior above 0 for each of "
                f"some of {', '.join(priors)}"
            )
        return states_of(given)
    if isinstance(asked, str) and asked == FREE:
        return STATES
    value = check(quantity("conduction"), asked)
    return states_of({CONDUCTION[int(value)]: 1.0})


def possible_states(
    asked: Any, space: ParameterSpace, known: Mapping[str, float]
) -> tuple[ConductionState, ...]:
    """The states that were asked for and that are possible with what is learnt and known.

    Raises
    ------
    InputError
        If there is no such state, a prior is none, or no state is left.
    """
    states = asked_states(asked)
    states = tuple(state for state in states if state.narrowed(space, known) is not None)
    if not states:
        raise InputError(
            "parameter 'conduction': what is fixed, the heart's values or the ranges exclude "
            "what was asked for; fix less, or leave it out"
        )
    return states


def united(
    space: ParameterSpace, fixed: Mapping[str, float], probable: Mapping[str, float]
) -> ParameterSpace:
    """What is learnt in states, each with the prior of all of them, as probable as they are."""
    spaces = [(state.probability, state.narrowed(space, fixed)) for state in states_of(probable)]
    total = sum(weight for weight, _ in spaces)
    each = [(weight / total, own.parameters) for weight, own in spaces if own is not None]
    found = []
    for k, usual in enumerate(space.parameters):
        parts = tuple((weight, parameters[k]) for weight, parameters in each)
        if any(part != usual for _, part in parts):
            lower, upper = min(p.lower for _, p in parts), max(p.upper for _, p in parts)
            usual = MixedParameter(usual.name, usual.unit, lower, upper, parts=parts)
        found.append(usual)
    return ParameterSpace(tuple(found))
