"""What a file does not say and its user must say, asked for with a guess."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError


class MissingMetadataError(InputError):
    """A file does not say something that is needed.

    Attributes
    ----------
    name : str
        What, as a Python argument.
    guess : str or float, optional
        What it probably is; None where nothing suggests it.
    """

    def __init__(
        self, message: str, name: str, guess: str | float | None = None, why: str = ""
    ) -> None:
        self.name, self.guess = name, guess
        written = guess if isinstance(guess, str) or guess is None else f"{guess:g}"
        option = "--" + name.replace("_", "-")
        hint = f"; {option} {written} is a guess: {why}" if guess is not None else ""
        super().__init__(message + hint)


def missing_unit(message: str, leads: Sequence[Floats]) -> MissingMetadataError:
    """Ask for the unit of leads, each of shape (n,), and guess it from how far they span."""
    known = [lead[np.isfinite(lead)] for lead in leads]
    spans = [float(np.ptp(lead)) for lead in known if lead.size]
    span = float(np.median(spans)) if spans else 0.0
    in_millivolts = {unit: span * mv for unit, mv in (("nV", 1e-6), ("uV", 1e-3), ("mV", 1.0))}
    in_millivolts["V"] = span * 1e3
    possible = {unit: height for unit, height in in_millivolts.items() if 0.2 <= height <= 15.0}
    if not possible:
        return MissingMetadataError(message, "unit")
    # a lead usually spans some 1.5 mV
    unit = min(possible, key=lambda each: abs(math.log(possible[each] / 1.5)))
    return MissingMetadataError(
        message, "unit", unit, f"leads then span {possible[unit]:.2g} mV (median)"
    )


def missing_rate(message: str, samples: int) -> MissingMetadataError:
    """Ask for the sampling rate of so many samples, and guess it from the usual 10 s."""
    common = (500.0, 1000.0, 250.0, 400.0, 300.0, 2000.0)  # Hz
    rates = [rate for rate in common if samples / rate == 10.0]
    rate = rates[0] if rates else 500.0 if samples > 2000 else 1000.0
    why = f"its {samples} samples then last {samples / rate:.3g} s"
    return MissingMetadataError(message, "sampling_rate", rate, why)


def missing_time_unit(message: str, step: float) -> MissingMetadataError:
    """Ask for the sampling rate where times step by so much in an unknown unit, s or ms."""
    if not 0 < step < math.inf:
        return MissingMetadataError(message, "sampling_rate")
    rate, unit = (1 / step, "s") if step < 0.1 else (1000 / step, "ms")
    return MissingMetadataError(
        message, "sampling_rate", rate, f"times then step by {step:g} {unit}"
    )


def missing_noise(message: str) -> MissingMetadataError:
    """Ask for the noise of a single beat."""
    return MissingMetadataError(
        message, "noise", 0.03, "beats at rest differ by about as much (mV)"
    )
