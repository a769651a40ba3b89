"""Make the emulator and the classifier of the packaged heart, which come with the package.

    python tools/make_default_emulator.py

Its prior simulations are kept in the user's cache, as those of any fit of this heart, and made if
they are missing, which takes half an hour. To be run again whenever they change: the heart, the
forward model, the priors of what is learnt or averaged over, or the version of the package.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import fascicle
from fascicle.cli.output import TerminalProgress
from fascicle.core.array_cache import ArrayCache
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.forward.model import ForwardModel
from fascicle.study.heart_emulator import EMULATOR, made_emulator, usual_prior
from fascicle.study.pool import Threads
from fascicle.study.settings import FitSettings
from fascicle.study.simulator import PointSimulator
from fascicle.study.state_classifier import (
    CLASSIFIER,
    classifier_key,
    classifier_of,
    simulations_of_states,
)

FOLDER = Path(fascicle.__file__).parent / "data" / "emulators"


def main() -> None:
    heart = fascicle.load_heart("default")
    assert heart.folder is not None
    model, pool = ForwardModel(heart), Threads(2)
    prior = usual_prior(model, heart.folder)
    count = FitSettings.model_fields["prior_simulations"].default
    simulator = PointSimulator(model, prior.space, {**prior.fixed})
    known = simulations_of_states(simulator, heart.folder, count)
    rows = np.array(INDEPENDENT_ROWS)
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.npz"):  # else they are taken for what is asked for
        old.unlink()
    with TerminalProgress() as progress:
        emulator = made_emulator(prior, count, pool, progress)
        classifier = classifier_of(known, rows, heart.folder, count, pool, progress)
    ArrayCache(FOLDER, EMULATOR).write(prior.content, emulator.arrays(), compress=True)
    arrays = classifier.arrays() | {"networks": np.array(count)}
    ArrayCache(FOLDER, CLASSIFIER).write(classifier_key(known, rows), arrays, compress=True)
    print(*(f"{name} {value:.4g}" for name, value in emulator.report.items()), sep="\n")
    print(f"classifier right {classifier.right:.3g}")


if __name__ == "__main__":
    main()
