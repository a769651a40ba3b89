"""Twelve leads as they were recorded, checked once, at construction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.leads import LEADS

LOWEST_RATE = 250.0  # Hz; below it the QRS is not resolved
SHORTEST = 1.5  # s; two beats cannot be found in less
FLAT = 1e-3  # mV; standard deviation below which a lead carries no heart beat


@dataclass(frozen=True)
class Recording:
    """Twelve leads of one recording.

    Attributes
    ----------
    signal : (12, n) array
        Potential (mV), leads in the order of `fascicle.leads.LEADS`.
    sampling_rate : float
        Samples per second (Hz).
    source : str
        Where it came from, usually the file name; error messages start with it.
    provenance : dict
        Text about the file: its format, its hash.

    Raises
    ------
    InputError
        When the array is not twelve leads, a lead is flat or not finite, or the recording is too
        short or too coarse in time.
    """

    signal: NDArray[np.float64]
    sampling_rate: float
    source: str
    provenance: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        signal = np.asarray(self.signal, dtype=np.float64)
        object.__setattr__(self, "signal", signal)
        if signal.ndim != 2 or signal.shape[0] != len(LEADS):
            raise InputError(
                f"{self.source}: signal has shape {signal.shape}; it must be (12, samples), with "
                f"leads in the order {', '.join(LEADS)}"
            )
        _check_rate(self.sampling_rate, self.source)
        _check_length(signal.shape[1] / self.sampling_rate, self.source)
        _check_finite(signal, self.source)
        _check_not_flat(signal, self.source)

    @property
    def duration(self) -> float:
        """Length of the recording (s)."""
        return float(self.signal.shape[1] / self.sampling_rate)


def _check_rate(rate: float, source: str) -> None:
    if not math.isfinite(rate) or rate < LOWEST_RATE:
        raise InputError(
            f"{source}: sampling rate is {rate:g} Hz; at least {LOWEST_RATE:g} Hz is needed to see "
            "the QRS, export the recording at its full rate"
        )


def _check_length(seconds: float, source: str) -> None:
    if seconds < SHORTEST:
        raise InputError(
            f"{source}: recording is {seconds:.2f} s long; at least two beats are needed, give 10 s"
        )


def _check_finite(signal: NDArray[np.float64], source: str) -> None:
    bad = ~np.isfinite(signal)
    if bad.any():
        lead = int(np.argmax(bad.any(axis=1)))
        first = int(np.argmax(bad[lead]))
        raise InputError(
            f"{source}: {int(bad.sum())} samples are missing or not finite (first: lead "
            f"{LEADS[lead]}, sample {first}); cut the recording to a part without gaps"
        )


def _check_not_flat(signal: NDArray[np.float64], source: str) -> None:
    flat = [name for name, lead in zip(LEADS, signal, strict=True) if lead.std() < FLAT]
    if flat:
        plural = "s" * (len(flat) > 1)
        raise InputError(
            f"{source}: lead{plural} {', '.join(flat)} {'are' if plural else 'is'} flat (varies by "
            f"less than {FLAT * 1000:g} uV); use a recording with every electrode attached"
        )
