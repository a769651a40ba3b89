"""Make the emulators and classifiers of the packaged hearts, which come with the package.

    python tools/make_packaged_emulators.py

The classifier of conduction states is one for all packaged hearts, and learns from recordings of
all of them: a patient has another heart, and a classifier that knows a single one is too sure.

Those of the atlas go as well, and `tools/make_atlas.py learn` makes them again.

Their prior simulations are kept in the user's cache, as those of any fit of this heart, and made if
they are missing, which takes an hour. To be run again whenever they change: the heart,
the forward model, the priors of what is learnt or averaged over, or the version of the package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fascicle
from fascicle.core.files import DISPOSABLE, PACKAGED, ArrayCache
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.emulation import origin
from fascicle.emulation.ecg_classifier import RecordingSet, learn
from fascicle.emulation.heart_emulator import made_emulator, usual_prior
from fascicle.emulation.state_classifier import (
    StateSimulations,
    classifier_key,
    simulations_of_states,
    training_and_held_out,
)
from fascicle.forward.model import ForwardModel
from fascicle.heart.heart import Heart
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.pools.pool import Threads

FOLDER = Path(fascicle.__file__).parent / "data" / "emulators"
COUNT = 16_000
# Of the state in which the demonstration fits the subject's heart: with as many networks the error
# of its emulator is a sixth less than with the usual number
MORE = {("camps-dti004", "normal"): 40_000}
ROWS = np.array(INDEPENDENT_ROWS)


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.npz"):  # else an old file could be taken for a new one
        old.unlink()
    single = [name for name in PACKAGED if name != "atlas"]
    make_classifier([make_those_of(fascicle.load_heart(name)) for name in single])


def make_those_of(heart: Heart) -> dict[str, StateSimulations]:
    """Emulators and the classifier of origins; gives the prior simulations of the states."""
    assert heart.folder is not None
    fascicle.simulate_prior(heart)
    model = ForwardModel(heart)
    states = simulations_of_states(model, usual_prior(heart), heart.folder, COUNT)
    for name, of_state in states.items():
        count = MORE.get((heart.name, name), of_state.count)
        made_emulator(of_state.simulations, count, Threads(2))
        take(heart.folder, "emulator", count, of_state.simulations.content)
    beats = origin.ectopic_beats(model, heart.folder)
    origin.classifier_of(beats, ROWS, COUNT, Threads(2))
    take(heart.folder, "origin", COUNT, origin.classifier_key(beats, ROWS))
    return states


def make_classifier(hearts: Sequence[dict[str, StateSimulations]]) -> None:
    """Make the classifier of conduction states, and keep it as that of each heart."""
    rng = np.random.default_rng(PriorSimulations.seed)
    sets = (training_and_held_out(states, ROWS, rng) for states in hearts)
    training, held_out = zip(*sets, strict=True)
    steps = 8000 * len(hearts)  # 8000: of one heart
    arrays = learn(joined(training), joined(held_out), ROWS, rng, steps=steps).arrays()
    for states in hearts:
        put("classifier", classifier_key(states, ROWS), {**arrays, "networks": np.array(COUNT)})


def joined(parts: Sequence[RecordingSet]) -> RecordingSet:
    recordings, kinds = zip(*((part.recordings, part.kinds) for part in parts), strict=True)
    return RecordingSet(np.concatenate(recordings), np.concatenate(kinds))


def take(heart: Path, kind: str, count: int, key: str) -> None:
    """Copy a file of the heart's folder into the package."""
    arrays = ArrayCache(heart / DISPOSABLE, kind).read(f"{count} of {key}")
    assert arrays is not None
    put(kind, key, arrays)


def put(kind: str, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a file of the package with rounded weights."""
    smaller = {name: rounded(array) for name, array in arrays.items()}
    ArrayCache(FOLDER, kind).write(key, smaller, compress=True)


def rounded(array: NDArray[Any]) -> NDArray[Any]:
    """Half-precision numbers to five binary digits, which zlib makes a third smaller.

    The ECG of an emulator then changes by 0.6 % of its size; its error is 20 %.
    """
    if array.dtype != np.float16:
        return array
    bits = array.view(np.uint16).astype(np.uint32)
    return ((bits + 16) // 32 * 32).astype(np.uint16).view(np.float16)


if __name__ == "__main__":
    main()
