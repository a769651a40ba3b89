"""The loss: mismatch between a simulated and a recorded QRS, at the best alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal

from fascicle.core.arrays import Floats

# With a free gain the window must hold this share of the most energy it can hold: otherwise a
# faint tail of the simulation, blown up, could pass for the QRS.
LEAST_SHARE = 0.5


@dataclass(frozen=True)
class Alignment:
    """The best fit of a simulated ECG to a recorded QRS.

    Attributes
    ----------
    loss : float
        `mismatch` of the recorded QRS and the aligned simulation (mV²).
    shift : int
        Sample of the simulation at which the recorded QRS begins; may be negative.
    gain : float
        g, 1 unless it was free.
    """

    loss: float
    shift: int
    gain: float


def mismatch(recorded: Floats, simulated: Floats) -> Floats:
    """The loss y = (1/T) ∫₀ᵀ Σ_leads (V̂ − V)² dt of the paper (eq. "loss"), in mV².

    Parameters
    ----------
    recorded : (..., n_leads, n_qrs) array
        V̂, the recorded QRS (mV): of one beat or of several.
    simulated : (n_leads, n_qrs) array
        V, the simulated ECG as it lies under it (mV); see `placed`.

    Returns
    -------
    (...) array
        One value (mV²) a beat.
    """
    difference = recorded - simulated
    return np.asarray((difference**2).sum(axis=(-2, -1)) / recorded.shape[-1])


def align(simulated: Floats, recorded: Floats, *, free_gain: bool = False) -> Alignment:
    """Find the time shift, and if asked the one gain for all leads, with the least mismatch.

    Every shift at which the two overlap is covered: with ‖V̂ − gV‖² = ‖V̂‖² − 2g⟨V̂, V⟩ + g²‖V‖²,
    ⟨V̂, V⟩ for all of them is one cross-correlation by FFT and ‖V‖² a running sum. Before its first
    and after its last sample the simulation is zero, as it is when no front is under way.

    Parameters
    ----------
    simulated : (n_leads, n) array
        Simulated ECG (mV).
    recorded : (n_leads, n_qrs) array
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
    best = int(np.argmin((recorded**2).sum() - 2 * gain * product + gain**2 * energy))
    shift, g = best - (length - 1), float(gain[best])
    # from the difference itself, free of the cancellation in the expanded square
    return Alignment(float(mismatch(recorded, placed(simulated, shift, g, length))), shift, g)


def placed(simulated: Floats, shift: int, gain: float, length: int) -> Floats:
    """Cut out the simulated ECG that lies under a recording.

    Parameters
    ----------
    simulated : (n_leads, n) array
        Simulated ECG (mV); zero before its first and after its last sample.
    shift : int
        Sample of the simulation at which the recording begins; may be negative.
    gain : float
        Factor on the simulation.
    length : int
        Samples of the recording.

    Returns
    -------
    (n_leads, length) array
        In mV.
    """
    result = np.zeros((len(simulated), length))
    first, last = max(shift, 0), min(shift + length, simulated.shape[1])
    if first < last:
        result[:, first - shift : last - shift] = gain * simulated[:, first:last]
    return result
