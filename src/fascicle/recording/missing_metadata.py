"""What a file may leave unsaid and its user must say, asked for at once and with guesses."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError

Found = TypeVar("Found")

UNITS = {"nV": 1e-6, "uV": 1e-3, "mV": 1.0, "V": 1e3}  # in mV
USUAL_SPAN = 1.5  # mV, of a lead in the median
SPANS = (0.2, 15.0)  # mV, of a unit that may be right
RATES = (500.0, 1000.0, 250.0, 400.0, 300.0, 2000.0)  # Hz, the commonest first
LARGEST_STEP = 0.1  # in s; times that step by more are in ms
USUAL_LENGTH = 10.0  # s, of a recording
USUAL_NOISE = 0.03  # mV


class MissingMetadataError(InputError):
    """A file does not say something that is needed.

    Attributes
    ----------
    name, option : str
        What, as a Python argument and as an option of the command line.
    guess : str or float, optional
        What it probably is; None where nothing suggests it.
    why : str
        What would follow from the guess, so that a reader can judge it.
    """

    def __init__(
        self, message: str, name: str, guess: str | float | None = None, why: str = ""
    ) -> None:
        self.name, self.option = name, "--" + name.replace("_", "-")
        self.guess, self.why = guess, why
        hint = f"; {self.option} {_written(guess)} is a guess: {why}" if guess is not None else ""
        super().__init__(message + hint)


def missing_unit(message: str, leads: Sequence[Floats]) -> MissingMetadataError:
    """Ask for the unit of leads, each of shape (n,), and guess it from how far they span."""
    known = [lead[np.isfinite(lead)] for lead in leads]
    spans = [float(np.ptp(lead)) for lead in known if lead.size]
    span = float(np.median(spans)) if spans else 0.0
    possible = {u: span * size for u, size in UNITS.items() if SPANS[0] <= span * size <= SPANS[1]}
    if not possible:
        return MissingMetadataError(message, "unit")
    unit = min(possible, key=lambda each: abs(math.log(possible[each] / USUAL_SPAN)))
    return MissingMetadataError(
        message, "unit", unit, f"leads then span {possible[unit]:.2g} mV (median)"
    )


def missing_rate(message: str, samples: int) -> MissingMetadataError:
    """Ask for the sampling rate of so many samples, and guess it from how long they usually are."""
    rates = [rate for rate in RATES if samples / rate == USUAL_LENGTH]
    rate = rates[0] if rates else RATES[0] if samples > 2 * RATES[1] else RATES[1]
    why = f"its {samples} samples then last {samples / rate:.3g} s"
    return MissingMetadataError(message, "sampling_rate", rate, why)


def missing_time_unit(message: str, step: float) -> MissingMetadataError:
    """Ask for the sampling rate where times step by so much in an unknown unit, s or ms."""
    if not 0 < step < math.inf:
        return MissingMetadataError(message, "sampling_rate")
    in_seconds = step < LARGEST_STEP
    rate, unit = (1 / step, "s") if in_seconds else (1000 / step, "ms")
    return MissingMetadataError(
        message, "sampling_rate", rate, f"times then step by {step:g} {unit}"
    )


def missing_noise(message: str) -> MissingMetadataError:
    """Ask for the noise of a single beat."""
    why = "beats at rest differ by about as much (mV)"
    return MissingMetadataError(message, "noise", USUAL_NOISE, why)


def collect_missing(make: Callable[..., Found], source: str, **said: Any) -> Found:
    """Call ``make(**said)``; where more than one thing is unsaid, ask for all of them in one line.

    Parameters
    ----------
    make : callable
        Reads or analyses; raises `MissingMetadataError`, whose `name` is one of its arguments.
    source : str
        What the message begins with.
    **said
        What the user has said; None where nothing.

    Raises
    ------
    InputError
        As `make` raises it, or for all that is unsaid.
    """
    try:
        return make(**said)
    except MissingMetadataError as error:
        unsaid = [error, *_others(make, said, error)]
        if len(unsaid) == 1:
            raise
    names = ", ".join(each.name.replace("_", " ") for each in unsaid)
    options = " ".join(f"{each.option} {_written(each.guess)}" for each in unsaid)
    reasons = "; ".join(f"{each.option}: {each.why}" for each in unsaid if each.why)
    raise InputError(
        f"{source}: it does not say {names}; give them, such as {options} if these guesses are "
        f"right ({reasons})"
    )


def _others(
    make: Callable[..., object], said: dict[str, Any], first: MissingMetadataError
) -> list[MissingMetadataError]:
    """What else is unsaid, found by going on with guesses."""
    found: list[MissingMetadataError] = []
    last: MissingMetadataError | None = first
    while last is not None and last.guess is not None:
        said = said | {last.name: last.guess}
        last = None
        try:
            make(**said)
        except MissingMetadataError as error:
            found.append(error)
            last = error
        except InputError:  # which is said when the guesses have been confirmed
            pass
    return found


def _written(guess: str | float | None) -> str:
    if guess is None:
        return "…"
    return guess if isinstance(guess, str) else f"{guess:g}"
