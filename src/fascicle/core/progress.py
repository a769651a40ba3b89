"""Progress callbacks: how a long computation reports how far it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from fascicle.core.errors import InputError
from fascicle.core.ranges import shown

StageProgress = Callable[[int, int], None]  # progress callback of one stage: done, total


class Progress(Protocol):
    """Progress callback of a run with several stages.

    The stages of a posterior are "prior" (networks of the prior), "stored" (evaluations of an
    earlier run that are gone through again) and "sampling", whose total is a maximum; that of a
    bank is "bank"; those of the paper's method "initial", "optimisation", "rejection" (networks
    accepted), and within it "draws" (uniform draws of a round). Before them come "compilation" and
    "preparation" of a large heart, after them "networks"; "workers" while a cluster has none
    or does not answer.
    """

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """`done` of `total` in `stage`; `message` says more, for people."""


def check_progress(progress: object) -> None:
    """Refuse what is neither None nor a progress callback."""
    if progress is not None and not callable(progress):
        raise InputError(f"progress is {shown(progress)}; give a function, 'lines' or None")


def no_progress(done: int, total: int) -> None:
    """Stand in for the progress callback of a stage that is not watched."""


def stage_progress(progress: Progress | None, stage: str, message: str = "") -> StageProgress:
    """Make the callback of one stage, for code that knows of no others.

    Parameters
    ----------
    progress : Progress, optional
        The callback of the whole run.
    stage, message : str
        What it is called with; see `Progress`.
    """
    if progress is None:
        return no_progress
    return lambda done, total: progress(stage, done, total, message)
