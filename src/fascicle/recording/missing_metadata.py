"""What a file does not say and its user must say, asked for with a guess."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError


class MissingMetadataError(InputError):
    """A file does not say something that is needed: its `name` as a Python argument, and a `guess`.

    The guess is None where nothing suggests it.
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
    """Ask for the unit of leads, each of shape (n,), and guess it: they usually span 1.5 mV."""
    spans = [float(np.ptp(lead[np.isfinite(lead)])) for lead in leads if np.isfinite(lead).any()]
    span = float(np.median(spans)) if spans else 0.0
    units = {"nV": 1e-6, "uV": 1e-3, "mV": 1.0, "V": 1e3}  # mV
    possible = {unit: span * mv for unit, mv in units.items() if 0.2 <= span * mv <= 15.0}
    if not possible:
        return MissingMetadataError(message, "unit")
    unit = min(possible, key=lambda each: abs(math.log(possible[each] / 1.5)))
    why = f"leads then span {possible[unit]:.2g} mV (median)"
    return MissingMetadataError(message, "unit", unit, why)


def missing_rate(message: str, samples: int) -> MissingMetadataError:
    """Ask for the sampling rate of so many samples, and guess it from the usual 10 s."""
    common = (500.0, 1000.0, 250.0, 400.0, 300.0, 2000.0)  # Hz
    usual = 500.0 if samples > 2000 else 1000.0
    rate = next((rate for rate in common if samples / rate == 10.0), usual)
    why = f"its {samples} samples then last {samples / rate:.3g} s"
    return MissingMetadataError(message, "sampling_rate", rate, why)


def missing_time_unit(message: str, step: float) -> MissingMetadataError:
    """Ask for the sampling rate where times step by so much in an unknown unit, s or ms."""
    if not 0 < step < math.inf:
        return MissingMetadataError(message, "sampling_rate")
    rate, unit = (1 / step, "s") if step < 0.1 else (1000 / step, "ms")
    why = f"times then step by {step:g} {unit}"
    return MissingMetadataError(message, "sampling_rate", rate, why)
