"""Conduction states of a study: those that a user chose, and the parameter spaces of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fascicle.core.conduction_states import CONDUCTION_STATES, NORMAL, ConductionState, told_apart
from fascicle.core.errors import InputError
from fascicle.core.parameters import FREE, HUMAN_SPACE, MixedParameter, ParameterSpace, free
from fascicle.core.quantities import check, fascicles, quantity
from fascicle.core.ranges import number


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


def state_label(name: str) -> str:
    """Name of a state for people, who must know that fascicular blocks are not told apart."""
    return "normal or fascicular block" if name == NORMAL else name


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
