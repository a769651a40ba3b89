"""Choices of a user: corrections of a recording, and decisions about its target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import ClassVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES, LEADS, LIMB_LEADS, lead_matrix
from fascicle.core.ranges import check_items, check_text, number, within
from fascicle.recording.filters import MAINS
from fascicle.recording.recording import Recording, derive_limb_leads


@dataclass(frozen=True)
class TargetOptions:
    """Decisions of the user; those that are None or empty are left to the program.

    Attributes
    ----------
    onset, offset : float, optional
        QRS window (ms from the R peak, onset negative).
    beat_class : str, optional
        Label of the class whose beats make the target; by default the one with the most beats.
    beats : tuple of int, optional
        Numbers of the beats to use, of whatever class.
    exclude : tuple of int
        Numbers of beats to leave out.
    noise : float, optional
        Standard deviation of a single beat (mV), which does not show how beats vary.
    lowpass : float, optional
        Cutoff of a zero-phase low-pass (Hz).
    notch : float, optional
        Frequency of the power line (Hz), to remove its interference.
    recorder_lowpass : float, optional
        Cut-off (Hz, -3 dB) of the recorder's own low-pass, where the file does not name it.

    Raises
    ------
    InputError
        When a number is impossible for any recording.
    """

    onset: float | None = None
    offset: float | None = None
    beat_class: str | None = None
    beats: tuple[int, ...] | None = None
    exclude: tuple[int, ...] = ()
    noise: float | None = None
    lowpass: float | None = None
    notch: float | None = None
    recorder_lowpass: float | None = None

    few_alike: ClassVar[float] = 0.7  # share of the beats that should be of the chosen class

    def __post_init__(self) -> None:
        for kind, value, label in (
            ("QRS end", self.onset, "QRS window: onset, from the R peak,"),
            ("QRS end", self.offset, "QRS window: offset, from the R peak,"),
            ("noise", self.noise, "noise"),
            ("low-pass", self.lowpass, "low-pass"),
            ("recorder's low-pass", self.recorder_lowpass, "recorder's low-pass"),
        ):
            if value is not None:
                within(kind, value, label)
        if self.onset is not None and self.offset is not None:
            check_window(self.onset, self.offset, "--onset and --offset")
        named = self.beats if self.beats is not None else ()
        check_items(named, Integral, "beats", "numbers of beats")
        check_items(self.exclude, Integral, "exclude", "numbers of beats")
        if self.beat_class is not None:
            check_text(self.beat_class, "beat_class")
            if self.beats is not None:
                raise InputError(
                    "--beats names beats of whatever class; give it or --class, not both"
                )
        if self.notch is not None and number(self.notch, "notch filter") not in MAINS:
            raise InputError(f"notch filter at {self.notch:.4g} Hz; power lines have 50 or 60 Hz")

    def described(self) -> dict[str, str]:
        """Text of every decision that the user made, for the provenance."""
        named = {
            "class": self.beat_class,
            "beats": ", ".join(map(str, self.beats or ())),
            "exclude": ", ".join(map(str, self.exclude)),
        }
        numbers = {
            "noise_mV": self.noise,
            "lowpass_hz": self.lowpass,
            "notch_hz": self.notch,
            "recorder_lowpass_hz": self.recorder_lowpass,
        }
        texts = named | {name: f"{x:g}" for name, x in numbers.items() if x is not None}
        return {f"choice_{name}": text for name, text in texts.items() if text}


def check_window(onset: float, offset: float, source: str) -> None:
    """Refuse a QRS window (ms from the R peak) of less than 20 ms."""
    if offset - onset < 20.0:
        raise InputError(
            f"{source}: QRS window {onset:g} to {offset:g} ms; the offset must be at least "
            "20 ms after the onset (both in ms from the R peak)"
        )


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
