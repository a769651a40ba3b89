"""Processes that are killed while they work on a study."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from pathlib import Path

import numpy as np

FORK = multiprocessing.get_context("fork")  # starts at once, with all that is imported and compiled


def killed_at_random(
    work: Callable[[Path], object], parent: Path, kills: int, longest: float, seed: int
) -> list[Path]:
    """Folders, in `parent`, of studies that were killed again and again, and then finished.

    ``kill -9`` ends the `work` on a folder after `longest` seconds at most, in half of the cases
    after a tenth of them at most.
    """
    rng = np.random.default_rng(seed)
    folders = [parent / "0"]
    killed = 0
    while killed < kills:
        process = FORK.Process(target=work, args=(folders[-1],))
        process.start()
        process.join(rng.uniform(0, longest * rng.choice([0.1, 1.0])))
        if process.exitcode is None:
            process.kill()
            process.join()
            killed += 1
        else:
            assert process.exitcode == 0
            folders.append(parent / f"{len(folders)}")
    work(folders[-1])
    return folders
