"""Make the emulators and classifiers of the packaged hearts, which come with the package.

    python tools/make_packaged_emulators.py

Their prior simulations are kept in the user's cache, as those of any fit of this heart, and made if
they are missing, which takes half an hour. To be run again whenever they change: the heart,
the forward model, the priors of what is learnt or averaged over, or the version of the package.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fascicle
from fascicle.core.array_cache import ArrayCache
from fascicle.core.files import DISPOSABLE, PACKAGED
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.forward.model import ForwardModel
from fascicle.heart.heart import Heart
from fascicle.study import origin
from fascicle.study.heart_emulator import EMULATOR
from fascicle.study.pool import Threads
from fascicle.study.settings import FitSettings
from fascicle.study.state_classifier import (
    CLASSIFIER,
    classifier_key,
    simulations_of_states,
    usual_simulator,
)

FOLDER = Path(fascicle.__file__).parent / "data" / "emulators"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.npz"):  # else they are taken for what is asked for
        old.unlink()
    for name in PACKAGED:
        make_those_of(fascicle.load_heart(name))


def make_those_of(heart: Heart) -> None:
    assert heart.folder is not None
    count = int(FitSettings.model_fields["prior_simulations"].default)
    fascicle.simulate_prior(heart)
    simulator = usual_simulator(ForwardModel(heart), heart.folder)
    known = simulations_of_states(simulator, heart.folder, count)
    for content, its in {each.prior.content: each.count for each in known.values()}.items():
        take(heart.folder, EMULATOR, its, content)
    rows = np.array(INDEPENDENT_ROWS)
    take(heart.folder, CLASSIFIER, count, classifier_key(known, rows))
    beats = origin.ectopic_beats(simulator.model, heart.folder)
    origin.classifier_of(beats, rows, count, Threads(2))
    take(heart.folder, origin.CLASSIFIER, count, origin.classifier_key(beats, rows))


def take(heart: Path, kind: str, count: int, key: str) -> None:
    """Copy a file of the heart's folder into the package, its weights rounded."""
    arrays = ArrayCache(heart / DISPOSABLE, kind).read(f"{count} of {key}")
    assert arrays is not None
    smaller = {name: rounded(each) for name, each in arrays.items()}
    ArrayCache(FOLDER, kind).write(key, smaller, compress=True)


def rounded(array: NDArray[Any]) -> NDArray[Any]:
    """Half-precision numbers to five binary digits, which zlib makes a third smaller.

    What an emulator gives changes by 0.6 % of its size then; its error is 20 %.
    """
    if array.dtype != np.float16:
        return array
    bits = array.view(np.uint16).astype(np.uint32)
    return ((bits + 16) // 32 * 32).astype(np.uint16).view(np.float16)


if __name__ == "__main__":
    main()
