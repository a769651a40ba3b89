"""What the user says about a recording's file, held against what the file says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from fascicle.core.errors import InputError

_ROUNDING = 1e-6  # relative, by which two spellings of one sampling rate may differ


@dataclass(frozen=True)
class ReadOptions:
    """What the user says about a file that does not say it itself.

    Attributes
    ----------
    sampling_rate : float, optional
        Samples per second (Hz).
    unit : str, optional
        Unit of the leads: nV, uV, mV or V.
    """

    sampling_rate: float | None = None
    unit: str | None = None

    def agreed_rate(self, path: Path, declared: float | None) -> float:
        """Sampling rate (Hz) of the file or the user, who must not contradict each other."""
        rate = self.sampling_rate if declared is None else declared
        if rate is None:
            raise InputError(
                f"{path}: no sampling rate in the file; give it in Hz with --sampling-rate"
            )
        if self.sampling_rate is not None and not math.isclose(
            rate, self.sampling_rate, rel_tol=_ROUNDING
        ):
            raise InputError(
                f"{path}: its sampling rate is {rate:g} Hz, --sampling-rate says "
                f"{self.sampling_rate:g} Hz; leave the option out or correct the file"
            )
        return float(rate)
