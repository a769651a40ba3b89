"""Emulators that are trained on with simulations where the posterior of the recordings lies.

An emulator of the prior is as exact there as on average, and what it does not say is that of
networks of all kinds. Networks of a first posterior, simulated, make it more exact where it
matters, and show what it does not say there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.core.array_cache import ArrayCache
from fascicle.core.files import DISPOSABLE
from fascicle.core.progress import Progress
from fascicle.core.quantities import Changes, quantity
from fascicle.core.threads import one_thread
from fascicle.forward.scenario import Scenario
from fascicle.inference.emulator import Singles
from fascicle.study.ecg_emulator import EcgEmulator, trained_on
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.posterior import PARTICLES, RUNS, sampled
from fascicle.study.prior_simulations import PriorSimulations

MOST, SHARE = 1000, 1 / 16  # networks that are simulated: at most, and of the prior's
ROUNDS = 2  # in which they are, since the posterior moves with the emulator


def refined_emulators(
    emulators: Sequence[EcgEmulator],
    emulated_by: Callable[[Sequence[EcgEmulator]], Sequence[EmulatedLikelihood]],
    scenarios: Sequence[tuple[Scenario, str] | None],
    count: int,
    folder: Path,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> list[EcgEmulator]:
    """Train emulators on where the posterior lies that they give together, in some rounds.

    Where a quantity of the tissue is learnt they stay as they are: each network has a tissue of its
    own, which takes seconds.

    Parameters
    ----------
    emulators, scenarios : sequences
        Of each recording: the emulator, and the scenario with its digest.
    emulated_by : callable
        Gives the likelihoods of the recordings by emulators.
    count : int
        Networks of the prior that the emulators have learnt from.
    folder : Path
        Of a study, in which the simulations are kept.

    Returns
    -------
    list of EcgEmulator
        Of each recording; one of the same scenario is the same.
    """
    emulated = emulated_by(emulators)
    simulator, each_round = emulated[0].simulator, round(min(MOST, SHARE * count) / ROUNDS)
    if any(quantity(name).changes is Changes.TISSUE for name in simulator.space.names):
        return [*emulators]
    sample = one_thread(sampled)  # about both: each would give the other's threads back
    cache = ArrayCache(folder / DISPOSABLE, "posterior")
    seen: dict[str, list[tuple[Singles, NDArray[np.float32]]]] = {}
    for number in range(ROUNDS):
        said = f"{RUNS} runs of {PARTICLES}, to refine the emulator ({number + 1}/{ROUNDS})"
        runs = sample(emulated, simulator.dimension, rng.spawn(RUNS), PARTICLES, said, progress)
        drawn = rng.permutation(np.concatenate([run.points for run in runs]))[:each_round]
        usual, found = rng.random(((number + 1) * len(drawn), drawn.shape[1])), {}
        for first, given, scenario in zip(emulators, emulated, scenarios, strict=True):
            digest = "" if scenario is None else scenario[1]
            if digest in found:
                continue
            simulations = PriorSimulations(
                simulator.model, simulator.space, simulator.averaged, simulator.fixed, cache,
                scenario, drawn,
            )  # fmt: skip
            simulations.simulate(len(drawn), simulator.pool, progress)
            new = simulations.examples(len(drawn), first.length)
            inputs, others = (given.inputs(p)[0] for p in (drawn[new.feasible], usual))
            seen.setdefault(digest, []).append((inputs, new.ecgs))
            both = [np.concatenate(each) for each in zip(*seen[digest], strict=True)]
            found[digest] = trained_on(first, both[0], both[1], others, rng, len(inputs))
        refined = [found["" if scenario is None else scenario[1]] for scenario in scenarios]
        emulated = emulated_by(refined)
    return refined
