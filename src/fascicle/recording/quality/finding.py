"""The outcome of one check of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Severity(Enum):
    """What follows from a check."""

    FINE = "ok"
    WARNING = "warning"  # the target is made, and says so
    FATAL = "refused"  # no target until the user has decided


@dataclass(frozen=True)
class Finding:
    """One check with its figure.

    Attributes
    ----------
    check : str
        What was checked, such as ``Einthoven I + III - II``.
    value : float
        The figure found.
    unit : str
        Its unit; empty for counts and shares.
    limit : float
        The figure from which on it is no longer fine.
    severity : Severity
        What follows.
    message : str
        One line that says what was found and what to do; empty where all is fine.
    """

    check: str
    value: float
    unit: str
    limit: float
    severity: Severity
    message: str = ""


def warning_if(message: str, check: str, value: float, unit: str, limit: float) -> Finding:
    """Outcome of a check: a warning where there is a message, fine where it is empty."""
    severity = Severity.WARNING if message else Severity.FINE
    return Finding(check, value, unit, limit, severity, message)
