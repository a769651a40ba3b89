"""Lead fields that a heart brings along, or that are solved for because it does not."""

from __future__ import annotations

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart, digest_of
from fascicle.heart.torso import LeadFields, Torso
from fascicle.torso.lead_fields import lead_fields

CONDUCTIVITIES = (
    "intracellular_l", "intracellular_t", "extracellular_l", "extracellular_t",
    "body", "lung", "blood",
)  # fmt: skip


def resolve_lead_fields(
    heart: Heart, conduction: Conduction, progress: StageProgress = no_progress
) -> LeadFields | None:
    """Lead fields of a heart: its own where they are up to date, else those of its torso.

    Parameters
    ----------
    heart : Heart
        The heart.
    conduction : Conduction
        Conductivities of all tissues.
    progress : callable, optional
        Called with how many of how many electrodes are done.

    Returns
    -------
    LeadFields or None
        None where the volume conductor is unbounded.

    Raises
    ------
    InputError
        If the lead fields are not those of this heart, and there is no torso to compute others in.
    """
    found, torso = heart.lead_fields, heart.torso
    if found is None and torso is None:
        return None
    key, body = key_of(heart, conduction), torso_key(torso)
    if found is not None and found.key == key and (torso is None or found.torso == body):
        return found
    if torso is None:
        raise InputError(
            f"{heart.name}: its lead fields are for other electrodes, fibres or conductivities, "
            "and there is no torso to compute new ones in; build the heart again with a torso"
        )
    return LeadFields(lead_fields(heart, torso, conduction, progress), key, body)


def is_up_to_date(heart: Heart, conduction: Conduction) -> bool:
    """Whether a heart's own lead fields are those of its electrodes, fibres, torso and tissues."""
    found = heart.lead_fields
    return (
        found is not None
        and found.key == key_of(heart, conduction)
        and (heart.torso is None or found.torso == torso_key(heart.torso))
    )


def torso_key(torso: Torso | None) -> str:
    """SHA-256 of a torso; empty for a heart that carries its lead fields without one."""
    return "" if torso is None else digest_of(torso.vertices, torso.tetrahedra, torso.tissues)


def key_of(heart: Heart, conduction: Conduction) -> str:
    """SHA-256 of what the lead fields depend on within a torso: heart, electrodes, conductivities.

    The torso itself is left out, so that a heart can carry its lead fields without it.
    """
    return digest_of(
        heart.vertices,
        heart.tetrahedra,
        heart.fibres,
        heart.electrodes,
        np.array([getattr(conduction, name) for name in CONDUCTIVITIES]),
    )
