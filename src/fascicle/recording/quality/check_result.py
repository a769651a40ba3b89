"""The outcome of one check of a recording, and how its message names leads."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum

from fascicle.core.leads import CHEST_LEADS, LEADS, LIMB_LEADS
from fascicle.recording.recording import Recording


class Severity(Enum):
    """Consequence of a check."""

    FINE = "ok"
    WARNING = "warning"  # the target is made, and says so
    FATAL = "refused"  # no target until the user has decided


@dataclass(frozen=True)
class Check:
    """A check: its name, the unit of its figure (or none), and the limit of what is fine."""

    name: str
    unit: str
    limit: float

    def found(
        self, value: float, message: str = "", severity: Severity = Severity.WARNING
    ) -> CheckResult:
        """Outcome of the check: all is fine where the message is empty."""
        return CheckResult(self, value, severity if message else Severity.FINE, message)


@dataclass(frozen=True)
class CheckResult:
    """Outcome of a check, with its figure."""

    check: Check
    value: float  # NaN where the recording does not allow the check
    severity: Severity
    message: str = ""  # one line: what was found and what to do; empty where all is fine


def listed(leads: Collection[str]) -> str:
    """Names in the usual order: ``lead V2``, ``leads I and V1``, ``leads V1 to V6``."""
    names = sorted(leads, key=lambda lead: LEADS.index(lead) if lead in LEADS else len(LEADS))
    if len(names) == 1:
        return f"lead {names[0]}"
    for group in (LIMB_LEADS, CHEST_LEADS, LEADS):
        if names == list(group):
            return f"leads {group[0]} to {group[-1]}"
    return f"leads {', '.join(names[:-1])} and {names[-1]}"


def leave_out(recording: Recording, leads: Collection[str]) -> str:
    """Option that uses every recorded lead but these."""
    recorded = (*recording.measured_leads, *recording.additional)
    kept = [lead for lead in recorded if lead not in leads]
    return f"--leads {','.join(kept)}"
