"""Everything that was found on the way from a recording to its target."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from fascicle.core.arrays import Floats
from fascicle.core.ranges import short_repr
from fascicle.recording.quality.check_result import CheckResult
from fascicle.recording.recording import Recording
from fascicle.recording.target import Target


class Unused(Enum):
    """Why a beat is not one of the target's."""

    CUT_OFF_START = "cut off by the start of the recording"
    CUT_OFF_END = "cut off by the end of the recording"
    EXCLUDED = "excluded"
    NOT_CHOSEN = "not chosen"
    OTHER_CLASS = "of another class"
    DRIFTING = "baseline drifts"
    SURPLUS = "the other groups of leads have no more beats"


class Drift(NamedTuple):
    """How far (mV) a beat is off the median beat right after the QRS, and in which lead most."""

    lead: str
    potential: float


@dataclass(frozen=True)
class Beat:
    """One heart beat of a recording."""

    number: int  # from 1, in the order of time
    time: float  # of its R peak (s from the start of the recording)
    label: str  # its class: A is the one with the most beats, then B and so on
    interval: float  # time since the beat before (ms); NaN for the first
    unused: Unused | None = None  # why it is not one of the target's beats
    drift: Drift | None = None  # of its baseline, where that is why

    @property
    def used(self) -> bool:
        """Whether it is one of the target's beats."""
        return self.unused is None

    @property
    def cut_off(self) -> bool:
        """Whether a part of the beat was not recorded."""
        return self.unused in (Unused.CUT_OFF_START, Unused.CUT_OFF_END)

    @property
    def why_unused(self) -> str:
        """The reason in words; empty where the beat is used."""
        if self.unused is Unused.OTHER_CLASS:
            return f"class {self.label}"
        if self.drift is not None:
            return f"baseline drifts by {abs(self.drift.potential):.2f} mV in {self.drift.lead}"
        return "" if self.unused is None else self.unused.value


@dataclass(frozen=True)
class BeatClass:
    """Beats of one shape: label (A, B, ...), number, and what is notable, such as ``early``."""

    label: str
    count: int
    description: str


@dataclass(frozen=True)
class Analysis:
    """A recording, what was found in it, and the target made of it.

    Attributes
    ----------
    recording : Recording
        With the user's corrections.
    signal : (12, n) array
        Potential (mV) as recorded, every `fascicle.recording.filters.SAMPLING_STEP`; NaN where a
        lead was not recorded.
    beats : tuple of Beat
        Every beat that was found.
    classes : tuple of BeatClass
        Their shapes, the most frequent first.
    spikes : (k,) array
        Times of pacing spikes (s).
    findings : tuple of CheckResult
        Every check with its figure.
    target : Target
        What the inference gets.
    chosen : str
        Label of the class of the target's beats.
    """

    recording: Recording
    signal: Floats
    beats: tuple[Beat, ...]
    classes: tuple[BeatClass, ...]
    spikes: Floats
    findings: tuple[CheckResult, ...]
    target: Target
    chosen: str

    __repr__ = short_repr

    @property
    def read_with(self) -> tuple[str, ...]:
        """What the user has said of the file, in words: it was taken as said."""
        said = {
            "shared_gain": "one gain for all leads, {}, in place of the file's "
            "(amplitudes rest on it)",
            "choice_unit": "unit {}",
            "choice_sampling_rate_hz": "sampling rate {} Hz",
            "inverted": "upside down: {}",
            "swapped": "exchanged: {}",
        }
        notes = self.recording.provenance
        return tuple(text.format(notes[key]) for key, text in said.items() if key in notes)
