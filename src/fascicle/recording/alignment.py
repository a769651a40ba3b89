"""Beats cut out of a recording and laid on top of each other."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers

HALF_WIDTH = 100  # samples each side of R that are compared
LARGEST_SHIFT = 60  # samples; an R' may be as tall as the R, and that far away
REACH = HALF_WIDTH + LARGEST_SHIFT
BLOCK = 64  # beats that are shifted at a time, which bounds the memory


def cut(signal: Floats, peaks: Integers, before: int, after: int) -> Floats:
    """Windows around peaks; beyond its ends the signal stays as it is there.

    Parameters
    ----------
    signal : (n_leads, n) array
        Potential (mV).
    peaks : (n_beats,) array
        R peaks (samples).
    before, after : int
        Samples before and after each peak.

    Returns
    -------
    (n_beats, n_leads, before + after + 1) array
        Potential (mV).
    """
    within = np.clip(peaks[:, None] + np.arange(-before, after + 1), 0, signal.shape[1] - 1)
    return np.stack([signal[:, samples] for samples in within])


def detrended(beats: Floats) -> Floats:
    """Beats (..., n_time) less the straight line that fits each lead of each beat best.

    Neither level nor drift then enters a comparison of two beats.
    """
    t = np.linspace(-1.0, 1.0, beats.shape[-1])
    slope = beats @ t / (t @ t)
    return np.asarray(beats - beats.mean(axis=-1, keepdims=True) - slope[..., None] * t)


def best_shifts(wide: Floats, template: Floats) -> Integers:
    """Shift of each beat at which it correlates best with a template, all leads together.

    Parameters
    ----------
    wide : (n_beats, n_leads, 2·REACH + 1) array
        Beats (mV) with room to shift.
    template : (n_leads, 2·HALF_WIDTH + 1) array
        Detrended beat (mV).

    Returns
    -------
    (n_beats,) array
        Samples by which R lies later than assumed, at most `LARGEST_SHIFT` either way.
    """
    shifts = []
    for start in range(0, len(wide), BLOCK):
        tries = np.lib.stride_tricks.sliding_window_view(
            wide[start : start + BLOCK], 2 * HALF_WIDTH + 1, axis=-1
        )
        # The template has neither level nor slope, so those of the beats do not matter
        score = np.einsum("bcst,ct->bs", tries, template)
        shifts.append(np.argmax(score, axis=1) - LARGEST_SHIFT)
    return np.concatenate(shifts)


def shifted(wide: Floats, shifts: Integers) -> Floats:
    """Detrended beats (n_beats, n_leads, 2·HALF_WIDTH + 1) at the given shifts of `wide` ones."""
    first = LARGEST_SHIFT + shifts
    return detrended(
        np.stack([w[:, f : f + 2 * HALF_WIDTH + 1] for w, f in zip(wide, first, strict=True)])
    )
