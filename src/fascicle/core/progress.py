"""How long tasks say how far they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Progress(Protocol):
    """Told how far a stage is.

    The stages of a study are "initial", "optimisation", "refinement", "posterior" (accepted
    samples), within it "prior" (uniform draws of a round), and, where that falls short, "walk"
    (steps of the random walks); before them come "compilation" and "preparation" of a large heart.
    """

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """`done` of `total` in `stage`; `message` says more, for people."""


def stage_of(
    progress: Progress | None, stage: str, message: str = ""
) -> Callable[[int, int], None] | None:
    """What tells `progress` how far one stage is, for code that knows of no others."""
    if progress is None:
        return None

    def told(done: int, total: int) -> None:
        progress(stage, done, total, message)

    return told
