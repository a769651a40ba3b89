"""Conduction states: blocked parts, ranges of quantities and prior probability of each.

Sources of the ranges and probabilities are in docs/diagnosis.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

Ranges = Mapping[str, tuple[float, float]]

NORMAL = "normal"
FASCICULAR_BLOCKS = "left anterior fascicular block", "left posterior fascicular block"
# Parts of the conduction system that a state may block
BLOCKABLE = (
    "left bundle branch",
    "right bundle branch",
    "left anterior fascicle",
    "left posterior fascicle",
)
# Ranges (ms) of the interventricular delay in mapped hearts, and of the root time, which a study
# may learn in its place
TOGETHER: Ranges = {"interventricular_delay": (3.0, 12.0), "root_time": (-20.0, 20.0)}


@dataclass(frozen=True)
class ConductionState:
    """Conduction state of the bundle branches and fascicles.

    Attributes
    ----------
    name : str
        Name, a value of the quantity ``conduction``.
    probability : float
        Prior probability, in proportion to those of the other states: prevalence in adults who are
        referred for an ECG; 0 for a state that is not told apart from normal.
    ranges : mapping of name to (float, float)
        Ranges of quantities, in place of their usual ones.
    blocked : tuple of str
        What is blocked, of `BLOCKABLE`.
    """

    name: str
    probability: float = 0.0
    ranges: Ranges = field(default_factory=lambda: TOGETHER)
    blocked: tuple[str, ...] = ()

    def is_mapped(self, names: Collection[str]) -> bool:
        """True if its networks must activate the ventricles as mapped human hearts are.

        `names` are those of learnt and fixed quantities. A root time in place of the
        interventricular delay does not constrain the activation sequence.
        """
        return self.name == NORMAL and "interventricular_delay" in names

    @property
    def number(self) -> float:
        """Value of the quantity ``conduction``."""
        return float([*CONDUCTION_STATES].index(self.name))

    @property
    def blocks(self) -> dict[str, float]:
        """The quantity ``conduction``, if the state blocks anything; else empty."""
        return {"conduction": self.number} if self.blocked else {}


CONDUCTION_STATES = {
    state.name: state
    for state in (
        ConductionState(NORMAL, 0.855),
        ConductionState("left bundle branch block", 0.025, blocked=("left bundle branch",)),
        ConductionState(
            "left bundle branch delay",
            0.01,
            {"interventricular_delay": (-40.0, -5.0), "root_time": (-75.0, -20.0)},
        ),
        # a fascicular block changes the ECG of a network less than the model's discrepancy does
        ConductionState("left anterior fascicular block", blocked=("left anterior fascicle",)),
        ConductionState("left posterior fascicular block", blocked=("left posterior fascicle",)),
        ConductionState("right bundle branch block", 0.03, blocked=("right bundle branch",)),
        ConductionState(
            "right bundle branch delay",
            0.05,
            {"interventricular_delay": (15.0, 40.0), "root_time": (20.0, 50.0)},
        ),
        ConductionState(
            "right bundle branch and left anterior fascicular block",
            blocked=("right bundle branch", "left anterior fascicle"),
        ),
        ConductionState(
            "intraventricular delay",
            0.03,
            {**TOGETHER, "alpha": (0.02, 0.04), "fibre_speed": (0.2, 0.4), "cv": (1.0, 2.5)},
        ),
    )
}


def told_apart() -> tuple[ConductionState, ...]:
    """States that are told apart, with their prior probabilities."""
    return tuple(state for state in CONDUCTION_STATES.values() if state.probability)
