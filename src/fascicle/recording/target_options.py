"""What a user may decide about the target that is made of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

from fascicle.core.errors import InputError
from fascicle.core.ranges import check_items, check_text, number, within
from fascicle.recording.resampling import MAINS

SHORTEST_WINDOW = 20.0  # ms


@dataclass(frozen=True)
class TargetOptions:
    """Decisions of the user; what is None or empty is decided by the program.

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
        Standard deviation of a single beat (mV), which does not show it itself.
    lowpass : float, optional
        Cutoff of a zero-phase low-pass (Hz).
    notch : float, optional
        Mains frequency to remove (Hz).
    recorder_lowpass : float, optional
        Cut-off (Hz, -3 dB) of the recorder's own low-pass, where the file does not name it.

    Raises
    ------
    InputError
        When a number is impossible whatever the recording.
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

    def __post_init__(self) -> None:
        for name, value in (("onset", self.onset), ("offset", self.offset)):
            if value is not None:
                within("QRS end", value, f"QRS window: {name}, from the R peak,")
        if self.onset is not None and self.offset is not None:
            check_window(self.onset, self.offset, "--onset and --offset")
        if self.beats is not None:
            check_items(self.beats, Integral, "beats", "numbers of beats")
        check_items(self.exclude, Integral, "exclude", "numbers of beats")
        if self.beat_class is not None:
            check_text(self.beat_class, "beat_class")
        if self.beats is not None and self.beat_class is not None:
            raise InputError("--beats names beats of whatever class; give it or --class, not both")
        for name, value in (
            ("noise", self.noise),
            ("low-pass", self.lowpass),
            ("recorder's low-pass", self.recorder_lowpass),
        ):
            if value is not None:
                within(name, value, name)
        if self.notch is not None and number(self.notch, "notch filter") not in MAINS:
            raise InputError(f"notch filter at {self.notch:.4g} Hz; mains have 50 or 60 Hz")

    def described(self) -> dict[str, str]:
        """Text of every decision that was taken, for the provenance."""
        texts = {
            "class": self.beat_class,
            "beats": None if self.beats is None else ", ".join(map(str, self.beats)),
            "exclude": ", ".join(map(str, self.exclude)) or None,
            "noise_mV": None if self.noise is None else f"{self.noise:g}",
            "lowpass_hz": None if self.lowpass is None else f"{self.lowpass:g}",
            "notch_hz": None if self.notch is None else f"{self.notch:g}",
            "recorder_lowpass_hz": (
                None if self.recorder_lowpass is None else f"{self.recorder_lowpass:g}"
            ),
        }
        return {f"choice_{name}": text for name, text in texts.items() if text is not None}


def check_window(onset: float, offset: float, source: str) -> None:
    """Refuse a QRS window that ends before it has lasted.

    Parameters
    ----------
    onset, offset : float
        Its ends (ms from the R peak).
    source : str
        What the message begins with.
    """
    if offset - onset < SHORTEST_WINDOW:
        raise InputError(
            f"{source}: QRS window {onset:g} to {offset:g} ms; the offset must be at least "
            f"{SHORTEST_WINDOW:g} ms after the onset (both in ms from the R peak)"
        )
