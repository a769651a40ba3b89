"""Mismatch between a simulated and a recorded QRS, at the best alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal
from numpy.typing import NDArray

# With a free gain the window must hold this share of the most energy it can hold: otherwise a
# faint tail of the simulation, blown up, could pass for the QRS.
LEAST_SHARE = 0.5


@dataclass(frozen=True)
class Alignment:
    """The best fit of a simulated ECG to a recorded QRS.

    Attributes
    ----------
    loss : float
        (1/T)∫₀ᵀ Σ_leads (V̂ − g·V)² dt (mV²).
    shift : int
        Sample of the simulation at which the recorded QRS begins; may be negative.
    gain : float
        g, 1 unless it was free.
    """

    loss: float
    shift: int
    gain: float


def align(
    simulated: NDArray[np.float64], recorded: NDArray[np.float64], *, free_gain: bool = False
) -> Alignment:
    """Find the time shift, and if asked the one gain for all leads, with the least mismatch.

    Every shift at which the two overlap is covered: with ‖V̂ − gV‖² = ‖V̂‖² − 2g⟨V̂, V⟩ + g²‖V‖²,
    ⟨V̂, V⟩ for all of them is one cross-correlation by FFT and ‖V‖² a running sum. Before its first
    and after its last sample the simulation is zero, as it is when no front is under way.

    Parameters
    ----------
    simulated : (12, n) array
        Simulated ECG (mV).
    recorded : (12, n_qrs) array
        Recorded QRS (mV), at the same sampling.
    free_gain : bool
        Whether to scale the simulation by the best g ≥ 0; then only shifts at which the window
        holds at least half of the energy it can hold are considered.
    """
    length = recorded.shape[1]
    padded = np.pad(simulated, ((0, 0), (length - 1, length - 1)))
    product = sum(
        scipy.signal.correlate(p, r, mode="valid", method="fft")
        for p, r in zip(padded, recorded, strict=True)
    )
    running = np.concatenate([[0.0], np.cumsum((padded**2).sum(axis=0))])
    energy = running[length:] - running[:-length]
    if free_gain:
        allowed = (energy > 0) & (energy >= LEAST_SHARE * energy.max())
        gain = np.where(allowed, np.maximum(product, 0) / np.where(allowed, energy, 1.0), 0.0)
    else:
        gain = np.ones_like(energy)
    mismatch = (recorded**2).sum() - 2 * gain * product + gain**2 * energy
    best = int(np.argmin(mismatch))
    found = Alignment(0.0, best - (length - 1), float(gain[best]))
    # the difference itself, free of the cancellation in the expanded square
    difference = recorded - placed(simulated, found, length)
    return Alignment(float((difference**2).sum() / length), found.shift, found.gain)


def placed(
    simulated: NDArray[np.float64], alignment: Alignment, length: int
) -> NDArray[np.float64]:
    """The simulated ECG as it lies under the recorded QRS, shape (12, length) (mV)."""
    result = np.zeros((len(simulated), length))
    start, stop = alignment.shift, alignment.shift + length
    first, last = max(start, 0), min(stop, simulated.shape[1])
    if first < last:
        result[:, first - start : last - start] = alignment.gain * simulated[:, first:last]
    return result
