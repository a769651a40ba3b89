"""Beats sorted by shape, so that ectopic, paced and aberrant ones do not mix with the rest."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.recording.alignment import HALF_WIDTH, REACH, best_shifts, cut, detrended, shifted

ALIKE = 0.2  # of a beat's energy; two beats of one class, correlation 0.9 or more, differ by less
MOST_CANDIDATES = 40  # beats among which the centre of a class is looked for
ROUNDS = 3
FAINTEST = 1e-3  # of a template's energy; what is left of it without noise is taken as no less
QUIET = 0.1  # quantile of the energy of all stretches that is taken as noise alone


def sort_by_shape(signal: Floats, peaks: Integers, noise: float) -> tuple[Integers, Integers]:
    """Sort beats into classes of one shape and align each with its class.

    The beat that most others resemble founds the first class; every beat that differs from their
    median by less than a fifth of its energy, beyond what noise explains, belongs to it. The
    rest is sorted in the same way, until no two are alike.

    Parameters
    ----------
    signal : (n_leads, n) array
        Recorded leads (mV) every `fascicle.recording.target.SAMPLING_STEP`.
    peaks : (n_beats,) array
        R peaks, at least one.
    noise : float
        Energy of noise alone, see `noise_energy`.

    Returns
    -------
    classes : (n_beats,) array
        Number of the class of each beat, from 0, in the order in which they were founded.
    aligned : (n_beats,) array
        The peaks, moved to where each beat correlates best with its class, all leads together.
    """
    wide = cut(signal, peaks, REACH, REACH)
    classes = np.full(len(peaks), -1, dtype=np.int64)
    shifts = np.zeros(len(peaks), dtype=np.int64)
    while (left := np.flatnonzero(classes < 0)).size:
        members, shift = _class_of_most(wide[left], noise)
        classes[left[members]] = classes.max() + 1
        shifts[left[members]] = shift[members]
        if len(members) == 1:  # no two are alike
            rest = np.setdiff1d(left, left[members])
            classes[rest] = classes.max() + 1 + np.arange(len(rest))
            break
    return classes, np.asarray(peaks + shifts)


def noise_energy(signal: Floats) -> float:
    """Energy (mV² samples) that noise alone has in a window as long as those compared."""
    length = 2 * HALF_WIDTH + 1
    starts = np.arange(0, signal.shape[1] - length + 1, HALF_WIDTH // 2)
    if not len(starts):
        return 0.0
    starts = starts[:: max(len(starts) // 2000, 1)]  # enough of a long recording for a quantile
    stretches = detrended(np.stack([signal[:, s : s + length] for s in starts]))
    return float(np.quantile((stretches**2).sum(axis=(1, 2)), QUIET))


def _class_of_most(wide: Floats, noise: float) -> tuple[Integers, Integers]:
    """Members of the largest class among the beats, and the shift of every beat."""
    still = shifted(wide, np.zeros(len(wide), dtype=np.int64))
    template = still[_central(wide, still, noise)]
    members = np.arange(len(wide))
    founders = 1
    for _ in range(ROUNDS):
        shift = best_shifts(wide, template)
        moved = shifted(wide, shift)
        difference = _difference(moved, template, noise * (1 + 1 / founders), noise)
        members = np.flatnonzero(difference < ALIKE)
        if not members.size:  # the template is a beat, so this is a beat of noise alone
            members = np.array([int(np.argmin(difference))])
        template = np.median(moved[members], axis=0)
        founders = len(members)
    return members, shift


def _central(wide: Floats, still: Floats, noise: float) -> int:
    """Find the beat that resembles most others."""
    candidates = np.unique(np.linspace(0, len(wide) - 1, MOST_CANDIDATES).round().astype(int))
    alike = np.zeros(len(candidates))
    for k, candidate in enumerate(candidates):
        moved = shifted(wide[candidates], best_shifts(wide[candidates], still[candidate]))
        difference = _difference(moved, still[candidate], 2 * noise, noise)
        # as many as possible, and of equally many the most alike
        alike[k] = (difference < ALIKE).sum() - np.clip(difference, 0, ALIKE).mean()
    return int(candidates[np.argmax(alike)])


def _difference(beats: Floats, template: Floats, expected: float, noise: float) -> Floats:
    """Energy of beats less a template over that of the larger, both without noise."""
    energy = np.maximum((beats**2).sum(axis=(1, 2)), (template**2).sum()) - noise
    left = ((beats - template) ** 2).sum(axis=(1, 2)) - expected
    least = FAINTEST * (template**2).sum() + np.finfo(float).tiny
    return np.asarray(left / np.maximum(energy, least))
