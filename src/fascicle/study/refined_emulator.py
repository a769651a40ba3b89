"""Emulators that are trained on with simulations where the posterior of the recordings lies.

An emulator of the prior is as exact there as on average, and what it does not say is that of
networks of all kinds. Networks of a first posterior, simulated, make it more exact where it
matters, and show what it does not say there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fascicle.core.array_cache import ArrayCache
from fascicle.core.files import DISPOSABLE
from fascicle.core.progress import Progress
from fascicle.core.quantities import Changes, quantity
from fascicle.core.threads import one_thread
from fascicle.forward.scenario import Scenario
from fascicle.study.ecg_emulator import EcgEmulator, trained_on
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.posterior import RUNS, sampled
from fascicle.study.prior_simulations import PriorSimulations

MOST, SHARE = 500, 1 / 32  # networks that are simulated: at most, and of the prior's
PARTICLES = 300  # of each run of the first posterior; enough to simulate some of


def refined_emulators(
    likelihoods: Sequence[EmulatedLikelihood],
    scenarios: Sequence[tuple[Scenario, str] | None],
    count: int,
    folder: Path,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> list[EcgEmulator]:
    """Train emulators on where the posterior lies that they give together.

    Where a quantity of the tissue is learnt they stay as they are: each network has a tissue of its
    own, which takes seconds.

    Parameters
    ----------
    likelihoods, scenarios : sequences
        Of each recording: its likelihood by the emulator, and the scenario with its digest.
    count : int
        Networks of the prior that the emulators have learnt from.
    folder : Path
        Of a study, in which the simulations are kept.

    Returns
    -------
    list of EcgEmulator
        Of each recording; one of the same scenario is the same.
    """
    simulator, drawn = likelihoods[0].simulator, round(min(MOST, SHARE * count))
    if any(quantity(name).changes is Changes.TISSUE for name in simulator.space.names):
        return [each.emulator for each in likelihoods]
    said = f"{RUNS} runs of {PARTICLES}, to refine the emulator"
    sample = one_thread(sampled)  # about both: each would give the other's threads back
    runs = sample(likelihoods, simulator.dimension, rng.spawn(RUNS), PARTICLES, said, progress)
    points = rng.permutation(np.concatenate([run.points for run in runs]))[:drawn]
    cache = ArrayCache(folder / DISPOSABLE, "posterior")
    usual, found = rng.random(points.shape), dict[str, EcgEmulator]()
    digests = ["" if scenario is None else scenario[1] for scenario in scenarios]
    for emulated, scenario, digest in zip(likelihoods, scenarios, digests, strict=True):
        if digest in found:
            continue
        simulations = PriorSimulations(
            simulator.model, simulator.space, simulator.averaged, simulator.fixed, cache,
            scenario, points,
        )  # fmt: skip
        simulations.simulate(len(points), simulator.pool, progress)
        new = simulations.examples(len(points), emulated.emulator.length)
        inputs, others = (emulated.inputs(p)[0] for p in (points[new.feasible], usual))
        found[digest] = trained_on(emulated.emulator, inputs, new.ecgs, others, rng)
    return [found[digest] for digest in digests]
