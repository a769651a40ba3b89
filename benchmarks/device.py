"""Networks on an NVIDIA card against all cores of the machine, in one run.

    python -m benchmarks.device [--heart HEART] [--device cuda] [--networks 4096] [--workers N]

The same networks of the prior, which neither has seen: first with `ForwardModel.simulate_many` on
one thread a core, then on the card, each after a warm-up. Prints networks a second of both, their
ratio, and how far activation and ECG of some are apart.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.forward.beat import Beat
from fascicle.forward.device.backend import GpuBackend
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart

COMPARED = 64  # networks, of which activation and ECG are compared
WARM_UP = 64  # networks


def drawn(count: int, seed: int) -> list[dict[str, float]]:
    """Networks of the prior."""
    points = np.random.default_rng(seed).uniform(size=(count, len(NETWORK_SPACE)))
    return [NETWORK_SPACE.from_unit(point) for point in points]


def rate(run: Callable[[Sequence[dict[str, float]]], object], count: int) -> float:
    """Networks a second, after a warm-up."""
    run(drawn(WARM_UP, 0))
    networks = drawn(count, 1)
    begin = time.perf_counter()
    run(networks)
    return count / (time.perf_counter() - begin)


def differences(model: ForwardModel, backend: GpuBackend) -> tuple[float, float]:
    """Largest differences of activation (ms) and leads (mV) between the card and the cores."""
    ms = mv = 0.0
    networks = drawn(COMPARED, 2)
    beats = model.simulate_many(networks, backend=backend)
    for network, beat in zip(networks, beats, strict=True):
        here = model.simulate(network)
        if isinstance(here, Beat) and isinstance(beat, Beat):
            ms = max(ms, float(np.abs(beat.activation - here.activation).max()))
            mv = max(mv, float(np.abs(beat.leads - here.leads).max()))
        elif isinstance(here, Beat) or isinstance(beat, Beat):
            raise RuntimeError(f"one of the two finds no network: {network}")
    return ms, mv


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--heart", default="default")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--networks", type=int, default=4096)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    try:
        model = ForwardModel(load_heart(arguments.heart))
        backend = GpuBackend(arguments.device)
    except InputError as error:
        parser.error(str(error))
    print(f"{model}, {arguments.networks} networks")
    ms, mv = differences(model, backend)
    print(f"largest differences of {COMPARED}: {ms:.2g} ms, {mv:.2g} mV")
    with ThreadPoolExecutor(arguments.workers) as executor:
        cores = rate(lambda networks: model.simulate_many(networks, executor), arguments.networks)
    card = rate(lambda networks: list(backend.signals(model, networks)), arguments.networks)
    print(f"{arguments.workers} cores: {cores:.1f} networks a second")
    print(f"{arguments.device}: {card:.1f} networks a second, {card / cores:.2f} times as many")


if __name__ == "__main__":
    main()
