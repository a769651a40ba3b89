"""Decisions of a user about the target that is made of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import ClassVar

from fascicle.core.errors import InputError
from fascicle.core.ranges import check_items, check_text, number, within
from fascicle.recording.filters import MAINS


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
