"""Beats cut out, aligned and clustered by morphology, so that ectopic beats do not mix in."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers

HALF_WIDTH = 100  # samples each side of R that are compared
LARGEST_SHIFT = 60  # samples; an R' may be as tall as the R, and that far away
ALIKE = 0.2  # share of a beat's energy by which beats of one class differ: correlation 0.9 or more


def cut(signal: Floats, peaks: Integers, before: int, after: int) -> Floats:
    """Windows (n_beats, n_leads, before + after + 1) of a signal (n_leads, n) around its peaks.

    Beyond its ends the signal stays as it is there.
    """
    within = np.clip(peaks[:, None] + np.arange(-before, after + 1), 0, signal.shape[1] - 1)
    return np.stack([signal[:, samples] for samples in within])


def detrended(beats: Floats) -> Floats:
    """Beats (..., n_time) less the straight line that fits each lead of each beat best."""
    t = np.linspace(-1.0, 1.0, beats.shape[-1])
    slope = beats @ t / (t @ t)
    return np.asarray(beats - beats.mean(axis=-1, keepdims=True) - slope[..., None] * t)


def cluster_morphology(signal: Floats, peaks: Integers, noise: float) -> tuple[Integers, Integers]:
    """Sort beats of a signal (n_leads, n) into classes of one shape; align each with its class.

    The beat that most others resemble founds the first class; every beat that differs from their
    median by less than a fifth of its energy, beyond that of `noise`, belongs to it. The rest is
    sorted in the same way, until no two are alike. Returns the number of each beat's class
    (n_beats,), from 0, and its R peak, moved to where it correlates best with the class.
    """
    wide = cut(signal, peaks, HALF_WIDTH + LARGEST_SHIFT, HALF_WIDTH + LARGEST_SHIFT)
    classes = np.full(len(peaks), -1, dtype=np.int64)
    shifts = np.zeros(len(peaks), dtype=np.int64)
    while (left := np.flatnonzero(classes < 0)).size:
        members, shift = _largest_class(wide[left], noise)
        classes[left[members]] = classes.max() + 1
        shifts[left[members]] = shift[members]
        if len(members) == 1:  # no two are alike
            rest = np.setdiff1d(left, left[members])
            classes[rest] = classes.max() + 1 + np.arange(len(rest))
            break
    return classes, np.asarray(peaks + shifts)


def noise_energy(signal: Floats) -> float:
    """Energy (mV² samples) of a window as long as those compared, of the quietest tenth."""
    length = 2 * HALF_WIDTH + 1
    starts = np.arange(0, signal.shape[1] - length + 1, HALF_WIDTH // 2)
    if not len(starts):
        return 0.0
    starts = starts[:: max(len(starts) // 2000, 1)]  # enough of a long recording for a quantile
    stretches = detrended(np.stack([signal[:, s : s + length] for s in starts]))
    return float(np.quantile((stretches**2).sum(axis=(1, 2)), 0.1))


def _largest_class(wide: Floats, noise: float) -> tuple[Integers, Integers]:
    """Members of the largest class among the beats, and the shift of every beat."""
    unshifted = _shifted(wide, np.zeros(len(wide), dtype=np.int64))
    template = unshifted[_central(wide, unshifted, noise)]
    members = np.arange(len(wide))
    founders = 1
    for _ in range(3):
        shift = _best_shifts(wide, template)
        moved = _shifted(wide, shift)
        difference = _difference(moved, template, noise * (1 + 1 / founders), noise)
        members = np.flatnonzero(difference < ALIKE)
        if not members.size:  # the template is a beat, so this is a beat of noise alone
            members = np.array([int(np.argmin(difference))])
        template = np.median(moved[members], axis=0)
        founders = len(members)
    return members, shift


def _central(wide: Floats, unshifted: Floats, noise: float) -> int:
    """Find the beat, of 40 at most, that resembles most others."""
    candidates = np.unique(np.linspace(0, len(wide) - 1, 40).round().astype(int))
    alike = np.zeros(len(candidates))
    for k, candidate in enumerate(candidates):
        template = unshifted[candidate]
        moved = _shifted(wide[candidates], _best_shifts(wide[candidates], template))
        difference = _difference(moved, template, 2 * noise, noise)
        # as many as possible, and of equally many the most alike
        alike[k] = (difference < ALIKE).sum() - np.clip(difference, 0, ALIKE).mean()
    return int(candidates[np.argmax(alike)])


def _difference(beats: Floats, template: Floats, expected: float, noise: float) -> Floats:
    """Energy of beats less a template over that of the larger, both without noise."""
    energy = np.maximum((beats**2).sum(axis=(1, 2)), (template**2).sum()) - noise
    left = ((beats - template) ** 2).sum(axis=(1, 2)) - expected
    least = 1e-3 * (template**2).sum() + np.finfo(float).tiny
    return np.asarray(left / np.maximum(energy, least))


def _best_shifts(wide: Floats, template: Floats) -> Integers:
    """Samples, up to `LARGEST_SHIFT`, by which each beat correlates best with the template."""
    shifts = []
    for start in range(0, len(wide), 64):  # beats at a time, which bounds the memory
        tries = np.lib.stride_tricks.sliding_window_view(
            wide[start : start + 64], 2 * HALF_WIDTH + 1, axis=-1
        )
        # The template has neither level nor slope, so those of the beats do not matter
        score = np.einsum("bcst,ct->bs", tries, template)
        shifts.append(np.argmax(score, axis=1) - LARGEST_SHIFT)
    return np.concatenate(shifts)


def _shifted(wide: Floats, shifts: Integers) -> Floats:
    """Detrended beats (n_beats, n_leads, 2·HALF_WIDTH + 1) at the given shifts of `wide` ones."""
    first = LARGEST_SHIFT + shifts
    return detrended(
        np.stack([w[:, f : f + 2 * HALF_WIDTH + 1] for w, f in zip(wide, first, strict=True)])
    )
