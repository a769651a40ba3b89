"""Make the emulator of the packaged heart, which comes with the package.

    python tools/make_default_emulator.py

Its prior simulations are kept in the user's cache, as those of any fit of this heart, and made if
they are missing, which takes some ten minutes. To be run again whenever they change: the heart, the
forward model, the priors of what is learnt or averaged over, or the version of the package.
"""

from __future__ import annotations

from pathlib import Path

import fascicle
from fascicle.cli.output import TerminalProgress
from fascicle.core.array_cache import ArrayCache
from fascicle.forward.model import ForwardModel
from fascicle.study.heart_emulator import EMULATOR, made_emulator, usual_prior
from fascicle.study.pool import Threads
from fascicle.study.settings import FitSettings

FOLDER = Path(fascicle.__file__).parent / "data" / "emulators"


def main() -> None:
    heart = fascicle.load_heart("default")
    assert heart.folder is not None
    prior = usual_prior(ForwardModel(heart), heart.folder)
    count = FitSettings.model_fields["prior_simulations"].default
    with TerminalProgress() as progress:
        emulator = made_emulator(prior, count, Threads(2), progress)
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.npz"):
        old.unlink()
    ArrayCache(FOLDER, EMULATOR).write(prior.content, emulator.arrays(), compress=True)
    print(*(f"{name} {value:.4g}" for name, value in emulator.report.items()), sep="\n")


if __name__ == "__main__":
    main()
