"""The loss: mismatch between a simulated and a recorded QRS, at the best alignment.

The loss of Álvarez-Barrientos et al. is y = (1/T) ∫ Σ_leads (V̂ − gV)² dt, where T is the length of
the QRS window. Here the integral is over all time, and the recording V̂ is 0 outside its QRS window:
the simulation is of ventricular activation alone, so it must lie in the window, too. (If the
integral were over the window alone, every network could be shifted out of it, and would be as good
as a flat line.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from fascicle.core.arrays import Complexes, Floats

FILTER_PADDING = 200  # samples before and after a simulation for what filters spread

# Gain of filters at frequencies of shape (k,), in cycles per sample
Response = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Alignment:
    """Best alignment of a simulated ECG with a recorded QRS.

    Attributes
    ----------
    loss : float
        Mismatch with the recorded QRS (mV²).
    shift : float
        Sample of the simulation at which the recorded QRS begins; may be negative, or lie between
        samples.
    gain : float
        g, 1 unless it was free.
    under : (n_leads, n_qrs) array
        The simulation, filtered and scaled, as it lies under the recorded QRS (mV).
    outside : float
        Its energy before and after the QRS window, over the length of that (mV²): part of the loss.
    """

    loss: float
    shift: float
    gain: float
    under: Floats
    outside: float

    @property
    def under_qrs(self) -> float:
        """Share of the simulation's energy that lies under the recorded QRS, 0 to 1."""
        under = float(_mean_square(self.under))
        total = under + self.outside
        return under / total if total > 0 else 0.0


def mismatch(recorded: Floats, alignment: Alignment) -> Floats:
    """Loss y (mV²) of recorded QRS (..., n_leads, n_qrs), at an alignment found before."""
    return _mean_square(recorded - alignment.under) + alignment.outside


def align(
    simulated: Floats,
    recorded: Floats,
    *,
    free_gain: bool = False,
    response: Response | None = None,
) -> Alignment:
    """Find the time shift, and on request one gain for all leads, with the least mismatch.

    With ‖V̂ − gV‖² = ‖V̂‖² − 2g⟨V̂, V⟩ + g²‖V‖² that shift is where ⟨V̂, V⟩, one cross-correlation by
    FFT, is largest. Between samples the simulation is interpolated by its spectrum; before its
    first and after its last sample it is zero, as without a front.

    Parameters
    ----------
    simulated : (n_leads, n) array
        V, the simulated ECG (mV).
    recorded : (n_leads, n_qrs) array
        V̂, the recorded QRS (mV), at the same sampling.
    free_gain : bool
        Whether to scale the simulation by the best g ≥ 0.
    response : callable, optional
        Gain of the filters that the recording has passed; the simulation passes them here.
    """
    length = recorded.shape[1]
    spectrum = _spectrum(simulated, length, response)
    size = 2 * (spectrum.shape[1] - 1)
    product = (np.conj(rfft(recorded, size)) * spectrum).sum(axis=0)
    shift = _highest(product)
    if shift > simulated.shape[1] + FILTER_PADDING:  # stands for the time before the simulation
        shift -= size
    shifted = _shifted(spectrum, shift)
    gain = 1.0
    if free_gain:
        overlap = float((recorded * shifted[:, :length]).sum())
        gain = max(overlap, 0.0) / max(float((shifted**2).sum()), np.finfo(float).tiny)
    under = gain * shifted[:, :length]
    outside = float(_mean_square(gain * shifted[:, length:])) * (size - length) / length
    # computed from the difference, as the expanded square suffers from cancellation
    loss = float(_mean_square(recorded - under)) + outside
    return Alignment(loss, shift, gain, under, outside)


def placed(
    simulated: Floats, shift: float, length: int, response: Response | None = None
) -> Floats:
    """Cut out the simulated ECG (n_leads, n) (mV) that lies under a recording, (n_leads, length).

    The recording begins at the simulation's sample `shift`; before its first and after its last
    sample the simulation is zero. `response` is the gain of the filters that the recording has
    passed.
    """
    return _shifted(_spectrum(simulated, length, response), shift)[:, :length]


def _mean_square(leads: Floats) -> Floats:
    """Sum over leads (..., n_leads, n), mean over time."""
    return np.asarray((leads**2).sum(axis=(-2, -1)) / leads.shape[-1])


def _spectrum(simulated: Floats, length: int, response: Response | None) -> Complexes:
    """Filtered spectrum, padded so that no shift wraps the simulation onto `length` samples."""
    size = 2 * next_fast_len((simulated.shape[1] + length) // 2 + FILTER_PADDING)
    spectrum = rfft(simulated, size)
    if response is not None:
        spectrum *= response(_frequencies(spectrum))
    return np.asarray(spectrum)


def _frequencies(spectrum: Complexes) -> Floats:
    """Frequencies (cycles per sample) of a spectrum (..., k) of `rfft`."""
    return np.linspace(0.0, 0.5, spectrum.shape[-1])


def _shifted(spectrum: Complexes, shift: float) -> Floats:
    """Samples from `shift` on, (..., n); earlier samples wrap to the end."""
    turned = spectrum * np.exp(2j * np.pi * shift * _frequencies(spectrum))
    return np.asarray(irfft(turned, 2 * (spectrum.shape[-1] - 1)))


def _highest(product: Complexes) -> float:
    """Shift (samples, 0 to n) at which a correlation of spectrum (n/2 + 1,) is highest."""
    size, upsampling = 2 * (len(product) - 1), 4
    fine = irfft(product, upsampling * size)
    shift = int(np.argmax(fine)) / upsampling
    omega = 2 * np.pi * _frequencies(product)
    for _ in range(4):  # Newton steps; three reach rounding error
        rotated = product * np.exp(1j * omega * shift)
        slope, curvature = -(omega * rotated.imag).sum(), -(omega**2 * rotated.real).sum()
        if curvature >= 0:  # flat: no correlation at all
            break
        shift -= float(np.clip(slope / curvature, -1 / upsampling, 1 / upsampling))
    return shift
