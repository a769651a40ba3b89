"""Families of scenarios: a delay, the place of a stimulus, or what it captures, varied."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from fascicle.core.errors import InputError
from fascicle.forward.scenario import Scenario, Stimulus
from fascicle.heart.segments import SEGMENTS
from fascicle.heart.sites import LAYERS

MOST = 200  # scenarios of a sweep
SEGMENT = "segment"
DELAY = "delay of the last stimulus after the first (ms)"
RADIUS = "capture radius (mm)"


class Sweep(NamedTuple):
    """A family of scenarios.

    Attributes
    ----------
    varied : str
        What differs, and its unit: `SEGMENT`, `DELAY` or `RADIUS`.
    scenarios : dict of segment (1 to 17), delay or radius to Scenario
    """

    varied: str
    scenarios: dict[float, Scenario]


def delays(scenario: Scenario, given: str) -> Sweep:
    """The scenario with its last stimulus so long after its first; negative, before it.

    Parameters
    ----------
    scenario : Scenario
        With two stimuli at least, the last of which moves.
    given : str
        ``"first:last:step"`` (ms), both ends included.

    Raises
    ------
    InputError
        If the scenario has fewer stimuli, or the delays are not three numbers that go up.
    """
    if len(scenario.stimuli) < 2:
        raise InputError(
            f"{scenario.source}: {len(scenario.stimuli)} stimuli; a delay needs two of them"
        )
    *others, last = scenario.stimuli
    begin = min(stimulus.time for stimulus in others)
    moved = {
        delay: replace(scenario, stimuli=(*others, replace(last, time=begin + delay)))
        for delay in _numbers(given)
    }
    return Sweep(DELAY, moved)


def segments(scenario: Scenario, layer: str) -> Sweep:
    """The scenario with its last stimulus of the tissue in each segment of the left ventricle.

    Parameters
    ----------
    scenario : Scenario
        With a stimulus of the tissue.
    layer : str
        One of `LAYERS`.

    Raises
    ------
    InputError
        If there is no such stimulus or layer.
    """
    if layer not in LAYERS:
        raise InputError(f"there is no layer '{layer}'; choose {' or '.join(LAYERS)}")
    of_tissue = [k for k, stimulus in enumerate(scenario.stimuli) if stimulus.tree is None]
    if not of_tissue:
        raise InputError(f"{scenario.source}: no stimulus of the tissue that could be moved")
    moved = of_tissue[-1]

    def at(number: int) -> tuple[Stimulus, ...]:
        here = replace(scenario.stimuli[moved], position=None, site=f"segment {number} {layer}")
        return (*scenario.stimuli[:moved], here, *scenario.stimuli[moved + 1 :])

    numbers = range(1, len(SEGMENTS) + 1)
    return Sweep(SEGMENT, {float(k): replace(scenario, stimuli=at(k)) for k in numbers})


def radii(scenario: Scenario, given: str) -> Sweep:
    """The scenario with other capture radii of its stimuli of the tissue.

    Parameters
    ----------
    scenario : Scenario
        With a stimulus of the tissue.
    given : str
        ``"first:last:step"`` (mm), both ends included.

    Raises
    ------
    InputError
        If there is no such stimulus, or the radii are not three numbers that go up.
    """
    if all(stimulus.tree is not None for stimulus in scenario.stimuli):
        raise InputError(f"{scenario.source}: no stimulus of the tissue that has a radius")

    def captured(radius: float) -> tuple[Stimulus, ...]:
        return tuple(s if s.tree else replace(s, radius=radius) for s in scenario.stimuli)

    return Sweep(RADIUS, {r: replace(scenario, stimuli=captured(r)) for r in _numbers(given)})


def _numbers(given: str) -> list[float]:
    try:
        first, last, step = map(float, given.split(":"))
        count = int((last - first) / step + 1e-9) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(f"'{given}' is no sweep; give first:last:step, as -60:60:10") from None
    if step <= 0 or not 2 <= count <= MOST:
        raise InputError(f"'{given}' has {count} steps; give 2 to {MOST} that go up, as -60:60:10")
    return [first + k * step for k in range(count)]
