"""What the user says about a recording's file."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Given:
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
