"""Emulators that are trained on with simulations where the posterior of the recordings lies.

An emulator of the prior is as exact there as on average, and what it does not say is that of
networks of all kinds. Networks of a first posterior, simulated, make it more exact where it
matters, and show what it does not say there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fascicle.core.array_cache import ArrayCache
from fascicle.core.files import DISPOSABLE
from fascicle.core.progress import Progress
from fascicle.core.quantities import Changes, quantity
from fascicle.core.threads import one_thread
from fascicle.forward.scenario import Scenario
from fascicle.inference.emulator import Singles
from fascicle.inference.tempered_sampling import effective_size
from fascicle.study.ecg_emulator import EcgEmulator, trained_on
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.posterior import RUNS, of_all, sampled
from fascicle.study.prior_simulations import PriorSimulations

MOST, SHARE = 500, 1 / 32  # networks that are simulated in a round: at most, and of the prior's
PARTICLES = 300  # of each run of a round; enough to simulate some of
MOST_ROUNDS = 3
MOVED = 0.02  # of a round's draws are worth something to the next posterior; fewer, and it is afar


def refined_emulators(
    emulators: Sequence[EcgEmulator],
    emulated_by: Callable[[Sequence[EcgEmulator]], Sequence[EmulatedLikelihood]],
    scenarios: Sequence[tuple[Scenario, str] | None],
    count: int,
    folder: Path,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> list[EcgEmulator]:
    """Train emulators on where the posterior lies that they give together.

    One round does, unless the posterior moves away from the networks that were simulated.

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
    now = emulated_by(emulators)
    simulator, drawn = now[0].simulator, round(min(MOST, SHARE * count))
    if any(quantity(name).changes is Changes.TISSUE for name in simulator.space.names):
        return [*emulators]
    sample = one_thread(sampled)  # about both: each would give the other's threads back
    cache = ArrayCache(folder / DISPOSABLE, "posterior")
    digests = ["" if scenario is None else scenario[1] for scenario in scenarios]
    seen: dict[str, list[tuple[Singles, Singles]]] = {digest: [] for digest in digests}
    for number in range(1, MOST_ROUNDS + 1):
        said = f"{RUNS} runs of {PARTICLES}, to refine the emulator"
        said += f", round {number}" if number > 1 else ""
        runs = sample(now, simulator.dimension, rng.spawn(RUNS), PARTICLES, said, progress)
        every = np.concatenate([run.points for run in runs])
        points = rng.permutation(every)[:drawn]
        usual, found = rng.random((number * len(points), simulator.dimension)), {}
        for given, emulated, scenario, digest in zip(
            emulators, now, scenarios, digests, strict=True
        ):
            if digest in found:
                continue
            simulations = PriorSimulations(
                simulator.model, simulator.space, simulator.averaged, simulator.fixed, cache,
                scenario, points,
            )  # fmt: skip
            simulations.simulate(len(points), simulator.pool, progress)
            new = simulations.examples(len(points), given.length)
            inputs, others = (emulated.inputs(p)[0] for p in (points[new.feasible], usual))
            seen[digest].append((inputs, new.ecgs))
            examples = map(np.concatenate, zip(*seen[digest], strict=True))
            found[digest] = trained_on(given, *examples, others, rng, latest=len(inputs))
        before, now = now, emulated_by([found[digest] for digest in digests])
        log_weights = of_all(now, every) - of_all(before, every)
        if effective_size(log_weights - log_weights.max()) > MOVED * len(every):
            break
    return [each.emulator for each in now]
