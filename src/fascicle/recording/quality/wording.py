"""How findings name leads and the options that leave some out."""

from __future__ import annotations

from collections.abc import Collection

from fascicle.core.leads import CHEST_LEADS, LEADS, LIMB_LEADS
from fascicle.recording.recording import Recording


def listed(leads: Collection[str]) -> str:
    """Names in the usual order: ``lead V2``, ``leads I and V1``, ``leads V1 to V6``."""
    names = [lead for lead in LEADS if lead in leads]
    if len(names) == 1:
        return f"lead {names[0]}"
    for group in (LIMB_LEADS, CHEST_LEADS, LEADS):
        if names == list(group):
            return f"leads {group[0]} to {group[-1]}"
    return f"leads {', '.join(names[:-1])} and {names[-1]}"


def leave_out(recording: Recording, leads: Collection[str]) -> str:
    """Option that uses every recorded lead but these."""
    kept = [lead for lead in recording.measured_leads if lead not in leads]
    return f"--leads {','.join(kept)}"
