"""A posterior: two independent runs of tempered sampling on an emulator, and real networks of it.

The emulator is fast and not exact: it says where the networks are, and the forward model what they
do. All that is reported of a posterior comes from networks that were simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress
from fascicle.core.threads import one_thread
from fascicle.inference.evaluation import Evaluation, best_of
from fascicle.inference.tempered_sampling import SamplingRun, State, agreement, pooled, temper
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import Posterior
from fascicle.study.settings import FitSettings
from fascicle.study.space import AveragedOver

RUNS = 2
PARTICLES = 600  # of a batch
MOST_BATCHES = 16  # that a run is pooled of, where runs do not agree

Emulated = Callable[[Floats], Floats]  # log-likelihoods (n,) of points (n, d), of one recording


@dataclass(frozen=True)
class PosteriorFit:
    """One pass through the runs of the sampler.

    Of several recordings the posterior of the first alone is sampled, too: what the others add is
    seen.
    """

    settings: FitSettings
    space: ParameterSpace
    averaged: AveragedOver
    journal: Journal
    emulated: Sequence[Emulated]  # of each recording
    progress: Progress | None = None
    share: float = 1.0  # of the whole; where it is less, runs need not agree as closely

    def run(self) -> Posterior:
        """Do all that is left, and give the result."""
        if len(self.emulated) == 1:
            return self._posterior(1)
        alone = self._sample(1)
        joint = self._posterior(len(self.emulated))
        if not self._agree(alone):
            return joint
        points = np.concatenate([run.points for run in alone])[:, : len(self.space)]
        return replace(joint, first_alone=self.space.columns(points))

    def _posterior(self, recordings: int) -> Posterior:
        """Sample, and simulate draws of both runs."""
        runs = self._sample(recordings)
        each = -(-self.settings.effective // RUNS)
        draws = [
            found
            for number, run in enumerate(runs)
            for found in self._simulated(run, each, number, recordings)
        ]
        return Posterior.of(
            self.space,
            self.averaged,
            draws,
            best_of(self.journal.evaluations),
            runs,
            agreement(*runs).means,
            self._agree(runs),
        )

    def _simulated(
        self, run: SamplingRun, count: int, number: int, recordings: int
    ) -> list[Evaluation]:
        """Networks of a run, in random order; points that give none are passed over."""
        left = [*self._rng(RUNS + number, recordings).permutation(run.points)]
        found: list[Evaluation] = []
        total = RUNS * count

        def report(done: int) -> None:
            if self.progress is not None:
                self.progress("networks", number * count + len(found) + done, total, "")

        while len(found) < count and left:
            asked, left = left[: count - len(found)], left[count - len(found) :]
            new = self.journal.evaluate(Stage.SAMPLING, asked, 50, report)
            found += [each for each in new if each.feasible]
        if len(found) < count:
            raise InputError(
                f"only {len(found)} of {len(run.points)} draws give a network of this heart; make "
                "more prior simulations (prior_simulations), or narrow the ranges of the lengths"
            )
        return found

    def _rng(self, number: int, recordings: int) -> np.random.Generator:
        """Random numbers of a run, or of draws from one."""
        return self.journal.rng(Stage.SAMPLING, number + 2 * RUNS * (recordings > 1))

    def _agree(self, runs: Sequence[SamplingRun], share: float = 1.0) -> bool:
        """Whether runs agree, and are worth as many independent draws as are wanted."""
        enough = all(run.effective * RUNS >= self.settings.effective for run in runs)
        return enough and agreement(*runs).within(share)

    def _sample(self, recordings: int) -> list[SamplingRun]:
        """Make the runs, of more and more batches of particles until they agree."""
        sample = one_thread(self._batches)  # about both: each would give the other's threads back
        batches: list[list[SamplingRun]] = []
        while True:
            batches.append(sample(recordings, len(batches)))
            runs = [pooled(each) for each in zip(*batches, strict=True)]
            if self._agree(runs, self.share) or len(batches) >= MOST_BATCHES:
                return runs

    def _batches(self, recordings: int, number: int) -> list[SamplingRun]:
        """A batch of each run."""
        # twice as many particles as are drawn from a run, since some give no network
        count = max(PARTICLES, self.settings.effective)
        # the first numbers are those of the first batches, and of draws
        first = 0 if number == 0 else 4 * RUNS * number
        said = f"{RUNS} runs of {count * (number + 1)}"
        if len(self.emulated) > 1:
            said += ", first recording alone" if recordings == 1 else ", all recordings"
        return sampled(
            self.emulated[:recordings],
            len(self.space) + len(self.averaged),
            [self._rng(first + run, recordings) for run in range(RUNS)],
            count,
            said,
            self.progress,
        )


def of_all(emulated: Sequence[Emulated], points: Floats) -> Floats:
    """Log-likelihoods (n,) of points (n, d) by all recordings."""
    return np.asarray(np.sum([each(points) for each in emulated], axis=0))


def sampled(
    emulated: Sequence[Emulated],
    dimension: int,
    rngs: Sequence[np.random.Generator],
    count: int,
    said: str,
    progress: Progress | None,
) -> list[SamplingRun]:
    """Sample the posterior of recordings by runs of so many particles, one of each generator."""
    states: dict[int, State] = {}

    def one(run: int, rng: np.random.Generator) -> SamplingRun:
        def reported(state: State) -> None:
            states[run] = state
            _report(states, len(rngs), said, progress)

        try:
            found: SamplingRun = temper(partial(of_all, emulated), dimension, rng, count, reported)
        except ValueError as error:  # hardly any point has a likelihood, by one's own rule
            raise InputError(f"{error}, and the likelihood") from None
        return found

    with ThreadPoolExecutor(len(rngs)) as pool:
        return list(pool.map(one, range(len(rngs)), rngs))


def _report(states: Mapping[int, State], runs: int, said: str, progress: Progress | None) -> None:
    if progress is None or len(states) < runs:
        return
    evidences = " and ".join(f"{states[k].log_evidence:.1f}" for k in range(runs))
    # steps of the temperature take alike long on a logarithmic scale
    coldest = min(state.temperature for state in states.values())
    done = round(100 * (1 + np.log10(max(coldest, 1e-3)) / 3))
    progress("sampling", max(1, done), 100, f"{said}, log evidence {evidences}")
