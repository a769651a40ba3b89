"""Times and kinds of the beats in each rhythm, for synthetic recordings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

MARGIN = 1.0  # s before and after the recording in which beats begin that reach into it
SHORTEST_COUPLING = 0.3  # s between two beats, except at rates above 180 per minute

Beats = tuple[list[float], list[str]]


def _series(rng: np.random.Generator, pulse: float, stop: float, kind: str, spread: float) -> Beats:
    """Beats of one kind with a relative standard deviation of their intervals."""
    steps = pulse * (1 + spread * rng.standard_normal(int((stop + MARGIN) / pulse * 2) + 4))
    times = -MARGIN - pulse * rng.random() + np.cumsum(np.maximum(steps, 0.6 * pulse))
    kept = times[times < stop]
    return list(kept), [kind] * len(kept)


def _fibrillation(rng: np.random.Generator, pulse: float, stop: float) -> Beats:
    """Irregular; a beat that comes early after a long interval may be aberrant (Ashman)."""
    shortest = min(SHORTEST_COUPLING, 0.9 * pulse)
    times, kinds, before = [-MARGIN], ["normal"], pulse
    while times[-1] < stop:
        step = shortest + rng.gamma(2.5, (pulse - shortest) / 2.5)
        early = step < 0.8 * pulse and before > 1.1 * pulse
        times.append(times[-1] + step)
        kinds.append("aberrant" if early and rng.random() < 0.5 else "normal")
        before = step
    return times, kinds


def _ectopics(rng: np.random.Generator, pulse: float, stop: float, share: float = 0.15) -> Beats:
    """Normal beats, some followed by an early ectopic one and a compensatory pause."""
    coupling = max(rng.uniform(0.55, 0.75) * pulse, min(SHORTEST_COUPLING, 0.9 * pulse))
    times, kinds = [-MARGIN - pulse * rng.random()], ["normal"]
    while times[-1] < stop:
        last, early = times[-1], rng.random() < share
        if early:
            times.append(last + coupling)
            kinds.append("ectopic")
        times.append(last + (1 + early) * pulse * (1 + 0.01 * rng.standard_normal()))
        kinds.append("normal")
    return times, kinds


def _pauses(rng: np.random.Generator, pulse: float, stop: float) -> Beats:
    """Normal beats with pauses of 3 to 4 s, about one in 10 s."""
    times, kinds = _series(rng, pulse, stop, "normal", 0.03)
    longer = rng.uniform(3, 4, len(times)) - pulse
    return list(times + np.cumsum(longer * (rng.random(len(times)) < pulse / 10))), kinds


RHYTHMS: dict[str, Callable[[np.random.Generator, float, float], Beats]] = {
    "sinus": lambda rng, pulse, stop: _series(rng, pulse, stop, "normal", 0.03),
    "fibrillation": _fibrillation,
    "bigeminy": lambda rng, pulse, stop: _ectopics(rng, pulse, stop, share=1.0),
    "ectopics": _ectopics,
    "pauses": _pauses,
    "paced": lambda rng, pulse, stop: _series(rng, pulse, stop, "paced", 0.002),
    "blocked": lambda rng, pulse, stop: _series(rng, pulse, stop, "blocked", 0.03),
}
