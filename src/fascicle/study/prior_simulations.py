"""Prior simulations: networks of the prior, for any recording of a heart to be compared with.

Every posterior begins with the same networks (`prior_points`); to simulate them takes most of the
time of a fit, and depends on the heart alone. Their ECGs are kept with the heart, in parts that are
written whole or not at all, so that the simulation may be interrupted at any time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.array_cache import ArrayCache
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE
from fascicle.core.leads import LEADS
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Lines, Progress, shown_progress, stage_progress
from fascicle.core.ranges import check_count
from fascicle.forward.compile_kernels import compile_kernels
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Signals, Simulation
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.pool import Pool, Threads, check_pool
from fascicle.study.settings import FitSettings
from fascicle.study.space import growth_and_conduction, study_space

PART = 500  # networks in a file
Arrays = dict[str, NDArray[Any]]


def prior_points(dimension: int, count: int) -> Floats:
    """The first `count` networks of the prior, (count, dimension), in the unit cube."""
    return np.concatenate([_part(dimension, k) for k in range(-(-count // PART))])[:count]


def _part(dimension: int, number: int) -> Floats:
    # the networks of the prior are the same in every study
    return np.random.default_rng([20240, number]).random((PART, dimension))


def signals_of(
    item: tuple[Mapping[str, float], Scenario | None], model: ForwardModel
) -> Signals | str:
    """What of parameters in a scenario is compared with recordings, or why they give no network."""
    outcome = model.simulate(*item)
    return Signals.of(outcome) if isinstance(outcome, Simulation) else outcome.reason


@dataclass(frozen=True)
class PriorSimulations:
    """The stored simulations of one forward model and prior."""

    cache: ArrayCache  # in the heart's folder
    content: str  # what they depend on

    @classmethod
    def of(
        cls, heart: Heart, space: ParameterSpace, fixed: Mapping[str, float]
    ) -> PriorSimulations | None:
        """Those of a heart, what is learnt and what is fixed; None for a heart without a folder."""
        if heart.folder is None:
            return None
        known = growth_and_conduction(heart, GrowthRules())
        held = [(name, known[name]) for name in ("conduction", "growth")]
        content = f"{heart.digest} {space.parameters} {sorted(fixed.items())} {held}"
        return cls(ArrayCache(heart.folder / DISPOSABLE, "prior"), content)

    def file(self, number: int) -> Path:
        """The file of a part."""
        return self.cache.file(f"{self.content} {number}")

    def __len__(self) -> int:
        """Networks that are there."""
        number = 0
        while self.file(number).is_file():
            number += 1
        return number * PART

    def add(self, number: int, outcomes: list[Signals | str]) -> None:
        """Store the outcomes of a part's networks: what each gives, or why it is none."""
        found = [o if isinstance(o, Signals) else None for o in outcomes]
        rows = next((len(s.leads) for s in found if s), len(LEADS))
        signals = [s.leads if s else np.empty((rows, 0)) for s in found]
        arrays = {
            "leads": np.concatenate(signals, axis=1).astype(np.float32),
            "ends": np.cumsum([signal.shape[1] for signal in signals]),
            "first": np.array([s.first_activation if s else np.nan for s in found]),
            "junctions": np.array([s.junctions if s else (0, 0) for s in found]),
            "reasons": np.array(["" if isinstance(o, Signals) else o for o in outcomes]),
        }
        self.cache.write(f"{self.content} {number}", arrays, compress=True)

    def get(self, point: Floats) -> Signals | str | None:
        """What a point (d,) gives, or why it gives no network; None if it is not here."""
        part, k = self._places(len(point)).get(point.tobytes(), (None, 0))
        if part is None:
            return None
        if part["reasons"][k]:
            return str(part["reasons"][k])
        start = int(part["ends"][k - 1]) if k else 0
        leads = part["leads"][:, start : part["ends"][k]].astype(float)
        junctions = tuple(int(n) for n in part["junctions"][k])
        return Signals(leads, float(part["first"][k]), junctions)

    def _places(self, dimension: int) -> dict[bytes, tuple[Arrays, int]]:
        """Part, and place in it, of every point."""
        if not self._known:
            for number in range(len(self) // PART):
                part = self.cache.read(f"{self.content} {number}")
                if part is None:
                    raise InputError(
                        f"{self.file(number)}: damaged; delete it, and 'fascicle heart "
                        "simulate-prior' makes it again"
                    )
                for k, point in enumerate(_part(dimension, number)):
                    self._known[point.tobytes()] = part, k
        return self._known

    @cached_property
    def _known(self) -> dict[bytes, tuple[Arrays, int]]:
        return {}

    def check(self, model: ForwardModel, space: ParameterSpace, fixed: Mapping[str, float]) -> None:
        """Simulate its first network again."""
        for point in _part(len(space), 0):
            stored = self.get(point)
            if isinstance(stored, Signals):
                now = signals_of(({**fixed, **space.from_unit(point)}, None), model)
                # mV; stored leads have single precision
                if (
                    isinstance(now, str)
                    or now.leads.shape != stored.leads.shape
                    or not np.allclose(stored.leads, now.leads, atol=1e-4)
                ):
                    raise InputError(
                        f"{self.cache.folder}: prior simulations of another forward model; delete "
                        "it, and 'fascicle heart simulate-prior' makes them again"
                    )
                return


def simulate_prior(
    heart: Heart | Path | str,
    networks: int | None = None,
    *,
    workers: int | None = None,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
) -> Path:
    """Simulate networks of the prior of a heart once, so that its fits need not.

    What is there already is kept, so it goes on where it was interrupted.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    networks : int, optional
        How many; by default as many as a fit begins with.
    workers : int, optional
        Simulations that run at the same time; by default one a core.
    progress : Progress, "lines" or None
        Called with how many networks are simulated; by default lines on standard error say so.
    pool : Pool, optional
        Where they are simulated, as in `fascicle.fit`; by default on `workers` threads.

    Returns
    -------
    Path
        Folder that holds them.

    Raises
    ------
    InputError
        If the heart cannot be used, or its folder cannot be written to.
    """
    check_pool(pool)
    heart = as_heart(heart)
    default = FitSettings.model_fields["prior_simulations"].default
    count = default if networks is None else networks
    check_count(count, "networks")
    if workers is not None:
        check_count(workers, "workers")
    space, fixed = study_space("posterior", {}, heart)
    stored = PriorSimulations.of(heart, space, fixed)
    if stored is None or not os.access(str(heart.folder), os.W_OK):
        raise InputError(f"{heart.folder or heart.name}: cannot be written to; copy the heart")
    with shown_progress(progress) as shown:
        if shown is not None:
            compile_kernels(shown)
        model = ForwardModel(heart, progress=shown)
        stored.check(model, space, fixed)
        report = stage_progress(shown, "prior simulations")
        pool = pool or Threads(workers or os.cpu_count() or 1)
        for number in range(len(stored) // PART, -(-count // PART)):
            points = _part(len(space), number)
            items = [({**fixed, **space.from_unit(point)}, None) for point in points]
            outcomes: list[Signals | str] = []
            for outcome in pool.map(signals_of, items, model):
                outcomes.append(outcome)
                report(number * PART + len(outcomes), -(-count // PART) * PART)
            stored.add(number, outcomes)
    return stored.cache.folder
