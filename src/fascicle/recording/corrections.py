"""Corrections of a recording that a user may ask for: gains, polarity, lead reversal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES, LEADS, LIMB_LEADS, lead_matrix
from fascicle.core.ranges import within
from fascicle.recording.recording import Recording, derive_limb_leads


def share_gain(recording: Recording, digits_per_millivolt: float = 1000.0) -> Recording:
    """Give all leads one gain (digits per mV), where the file states one per lead.

    InputError where the file does not state the gain of every lead, or all have that one already.
    """
    within("gain of the file", digits_per_millivolt, "the gain that leads share")
    gains, kept = recording.digits_per_millivolt, recording.measured_leads
    rows = [LEADS.index(lead) for lead in kept]
    if gains is None or not np.isfinite(gains[rows]).all():
        raise InputError(
            f"{recording.source}: the file does not state the gain of each lead, so they cannot "
            "share one; leave out --shared-gain"
        )
    if (gains[rows] == digits_per_millivolt).all():
        raise InputError(
            f"{recording.source}: all its leads have one gain already ({gains[rows[0]]:g} per mV); "
            "leave out --shared-gain, or give another gain by --digits-per-mv"
        )
    if recording.additional:
        raise InputError(
            f"{recording.source}: the leads {', '.join(recording.additional)} keep their gains; "
            f"leave out --shared-gain, or use the others alone: --leads {','.join(kept)}"
        )
    signal = recording.signal * (gains / digits_per_millivolt)[:, None]
    changed = replace(recording, digits_per_millivolt=np.full(len(LEADS), digits_per_millivolt))
    return _changed(changed, signal, kept, "shared_gain", f"{digits_per_millivolt:g} per mV")


def invert(recording: Recording, lead: str) -> Recording:
    """Turn a recorded lead upside down."""
    kept = recording.measured_leads
    if lead in recording.additional:
        turned = recording.additional | {lead: -recording.additional[lead]}
        changed = replace(recording, additional=turned)
        return _changed(changed, recording.signal, kept, "inverted", lead)
    if lead not in kept:
        raise InputError(
            f"{recording.source}: lead {lead} cannot be inverted, it was not recorded (recorded: "
            f"{', '.join(kept)})"
        )
    signal = recording.signal.copy()
    signal[LEADS.index(lead)] *= -1
    return _changed(recording, signal, kept, "inverted", lead)


def swap(recording: Recording, first: str, second: str) -> Recording:
    """Undo the reversal of two limb electrodes (RA, LA, LL), or of two leads, by their names.

    Chest leads are measured against the mean of the limb electrodes, which no reversal alters.
    InputError where the two are not of one kind.
    """
    names, kept = f"{first}-{second}", list(recording.measured_leads)
    if {first, second} <= set(ELECTRODES[:3]) and first != second:
        limb, signal = lead_matrix()[: len(LIMB_LEADS)], recording.signal.copy()
        kept = [lead for lead in kept if lead not in LIMB_LEADS]
        # each limb lead is taken from the one that was recorded in its place
        for row, reversed_lead in enumerate(limb[:, _order(ELECTRODES, first, second)]):
            product = limb @ reversed_lead
            product = product / np.linalg.norm(limb, axis=1) / np.linalg.norm(reversed_lead)
            # the lead recorded there; its factor is +1, or -1 if inverted
            source = int(np.argmax(np.abs(product)))
            signal[row] = np.sign(product[source]) * recording.signal[source]
            if LIMB_LEADS[source] in recording.measured_leads:
                kept.append(LIMB_LEADS[row])
    elif {first, second} <= set(kept) and first != second:
        signal = recording.signal[_order(LEADS, first, second)]
    else:
        raise InputError(
            f"{recording.source}: cannot swap {names}; give two of the electrodes RA, LA, LL, or "
            f"two recorded leads ({', '.join(recording.measured_leads)})"
        )
    gainless = replace(recording, digits_per_millivolt=None)  # the gains were exchanged, too
    return _changed(gainless, signal, kept, "swapped", names)


def _order(names: Sequence[str], first: str, second: str) -> list[int]:
    """Positions of names, with two of them swapped."""
    return [names.index({first: second, second: first}.get(name, name)) for name in names]


def _changed(
    recording: Recording, signal: Floats, kept: Sequence[str], correction: str, note: str
) -> Recording:
    """Recording with a new signal, its computed leads computed again, and a note."""
    signal, derived = derive_limb_leads(signal, kept)
    before = recording.provenance.get(correction)
    notes = recording.provenance | {correction: note if before is None else f"{before}, {note}"}
    return replace(recording, signal=signal, derived=derived, provenance=notes)
