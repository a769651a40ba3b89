"""A bank of simulations: networks of the prior, for any recording of a heart to compare with.

Every posterior begins with the same networks (`prior_points`); to simulate them takes most of the
time of a fit, and depends on the heart alone. A bank keeps their ECGs with the heart, in parts that
are written whole or not at all, so that making one may be interrupted at any time.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, atomic_path
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
from fascicle.study.pool import Pool, Threads, check_pool
from fascicle.study.settings import FitSettings
from fascicle.study.space import growth_and_conduction, study_space

FORMAT = 1
PART = 500  # networks in a file
SEED = 20240  # the networks of the prior are the same in every study
SAME = 1e-4  # mV; stored leads have single precision


def prior_points(dimension: int, count: int) -> Floats:
    """The first `count` networks of the prior, (count, dimension), in the unit cube."""
    parts = range(-(-count // PART))
    return np.concatenate([_part(dimension, number) for number in parts])[:count]


def _part(dimension: int, number: int) -> Floats:
    return np.random.default_rng([SEED, number]).random((PART, dimension))


class PriorSimulations:
    """The stored simulations of one forward model and prior.

    Attributes
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def beside(
        cls, heart: Heart, space: ParameterSpace, fixed: Mapping[str, float]
    ) -> PriorSimulations | None:
        """Name the bank of a heart; None for a heart without a folder of its own.

        Parameters
        ----------
        heart : Heart
            Its content, not its place, says which simulations are meant.
        space, fixed : ParameterSpace, mapping
            What is learnt and what is fixed.
        """
        if heart.folder is None:
            return None
        held = sorted(growth_and_conduction(heart).items())
        text = f"{FORMAT} {heart.digest} {space.parameters} {sorted(fixed.items())} {held}"
        key = hashlib.sha256(text.encode()).hexdigest()[:16]
        return cls(heart.folder / DISPOSABLE / f"bank-{key}")

    def file(self, number: int) -> Path:
        """The file of a part."""
        return self.folder / f"networks-{number:04d}.npz"

    def __len__(self) -> int:
        """Networks that are there."""
        number = 0
        while self.file(number).is_file():
            number += 1
        return number * PART

    def add(self, number: int, outcomes: list[Signals | str]) -> None:
        """Store the outcomes of a part's networks: what each gives, or why it is none."""
        found = [o if isinstance(o, Signals) else None for o in outcomes]
        signals = [s.leads if s else np.empty((len(LEADS), 0)) for s in found]
        reasons = ["" if isinstance(o, Signals) else o for o in outcomes]
        self.folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(self.file(number)) as temporary:
            np.savez_compressed(
                temporary,
                allow_pickle=False,
                leads=np.concatenate(signals, axis=1).astype(np.float32),
                ends=np.cumsum([signal.shape[1] for signal in signals]),
                first=np.array([s.first_activation if s else np.nan for s in found]),
                junctions=np.array([s.junctions if s else (0, 0) for s in found]),
                reasons=np.array(reasons),
            )

    def __contains__(self, point: Floats) -> bool:
        return point.tobytes() in self._places(len(point))

    def get(self, point: Floats) -> Signals | str | None:
        """What a network gives, or why it is none; None if it is not here.

        Parameters
        ----------
        point : (d,) array
            In the unit cube.
        """
        place = self._places(len(point)).get(point.tobytes())
        if place is None:
            return None
        number, k = place
        part = self._parts[number]
        if part["reasons"][k]:
            return str(part["reasons"][k])
        start = int(part["ends"][k - 1]) if k else 0
        leads = part["leads"][:, start : part["ends"][k]].astype(float)
        junctions = tuple(int(n) for n in part["junctions"][k])
        return Signals(leads, float(part["first"][k]), junctions)

    def _places(self, dimension: int) -> dict[bytes, tuple[int, int]]:
        if not self._known:
            for number in range(len(self._parts)):
                for k, point in enumerate(_part(dimension, number)):
                    self._known[point.tobytes()] = number, k
        return self._known

    @cached_property
    def _known(self) -> dict[bytes, tuple[int, int]]:
        return {}

    @cached_property
    def _parts(self) -> list[dict[str, Any]]:
        return [self._read(number) for number in range(len(self) // PART)]

    def _read(self, number: int) -> dict[str, Any]:
        try:
            with (
                self.file(number).open("rb") as stream,
                np.load(stream, allow_pickle=False) as file,
            ):
                return {name: file[name] for name in file.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(
                f"{self.file(number)}: not a part of a bank ({error}); delete it, and "
                "'fascicle heart bank' makes it again"
            ) from error

    def check(self, model: ForwardModel, space: ParameterSpace, fixed: Mapping[str, float]) -> None:
        """Simulate its first network again.

        Raises
        ------
        InputError
            If it is not that of the forward model.
        """
        for point in _part(len(space), 0):
            stored = self.get(point)
            if isinstance(stored, Signals):
                outcome = model.simulate({**fixed, **space.from_unit(point)})
                if not (isinstance(outcome, Simulation) and _same(stored, outcome)):
                    raise InputError(
                        f"{self.folder}: a bank of another forward model; delete it, and 'fascicle "
                        "heart bank' makes it again"
                    )
                return


def _same(stored: Signals, simulation: Simulation) -> bool:
    leads = simulation.leads
    return stored.leads.shape == leads.shape and bool(np.allclose(stored.leads, leads, atol=SAME))


def signals_of(
    item: tuple[Mapping[str, float], Scenario | None], model: ForwardModel
) -> Signals | str:
    """What of parameters in a scenario is compared with recordings, or why they give no network."""
    outcome = model.simulate(*item)
    return Signals.of(outcome) if isinstance(outcome, Simulation) else outcome.reason


def make_bank(
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
        How many; by default as many as a fit begins with (`fascicle.FitSettings.bank`).
    workers : int, optional
        Simulations that run at the same time; by default one a core.
    progress : Progress, "lines" or None
        Called with how many networks are simulated; by default lines on standard error say so.
    pool : Pool, optional
        Where they are simulated, as in `fascicle.fit`; by default on `workers` threads.

    Returns
    -------
    Path
        Folder of the bank.

    Raises
    ------
    InputError
        If the heart cannot be used, or its folder cannot be written to.
    """
    check_pool(pool)
    heart = as_heart(heart)
    count = FitSettings.model_fields["bank"].default if networks is None else networks
    check_count(count, "networks")
    if workers is not None:
        check_count(workers, "workers")
    space, fixed = study_space("posterior", {}, heart)
    bank = PriorSimulations.beside(heart, space, fixed)
    if bank is None or not os.access(str(heart.folder), os.W_OK):
        raise InputError(f"{heart.folder or heart.name}: cannot be written to; copy the heart")
    with shown_progress(progress) as shown:
        if shown is not None:
            compile_kernels(shown)
        model = ForwardModel(heart, progress=shown)
        bank.check(model, space, fixed)
        report = stage_progress(shown, "bank")
        pool = pool or Threads(workers or os.cpu_count() or 1)
        for number in range(len(bank) // PART, -(-count // PART)):
            outcomes: list[Signals | str] = []
            points = _part(len(space), number)
            networks_of_part = [({**fixed, **space.from_unit(point)}, None) for point in points]
            for outcome in pool.map(signals_of, networks_of_part, model):
                outcomes.append(outcome)
                report(number * PART + len(outcomes), -(-count // PART) * PART)
            bank.add(number, outcomes)
    return bank.folder
