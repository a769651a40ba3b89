"""Prediction cache of a study, so that no command simulates the same twice."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.array_cache import ArrayCache
from fascicle.core.leads import LEADS
from fascicle.core.parameters import complete
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import scenario_text
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import RINGING, Predicted, PredictedBeat
from fascicle.purkinje.tree import InvalidTree, PurkinjeTree
from fascicle.study.fitted import FittedStudy

# Arrays of a file
NAMES = {"leads", "filtered", "lengths", "activation", "captured", "tree_times", "indices"}

Arrays = Mapping[str, NDArray[Any]]
Trees = Sequence[tuple[PurkinjeTree, ...]]  # of each network


@dataclass(frozen=True)
class PredictionCache:
    """Cached predictions of one population in a study's folder, one file per scenario.

    `population` is the SHA-256 of the study's configuration, networks and gains.
    """

    fitted: FittedStudy
    population: str

    @classmethod
    def of(cls, fitted: FittedStudy) -> PredictionCache:
        """Cache of a study."""
        digest = hashlib.sha256(fitted.study.config.model_dump_json().encode())
        gains = fitted.gains if fitted.gains is not None else np.empty(0)
        for values in (*fitted.population.values.values(), gains):
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        return cls(fitted, digest.hexdigest())

    @property
    def _cache(self) -> ArrayCache:
        return ArrayCache(self.fitted.folder / "predictions", self.population[:12])

    def read(self, scenarios: Mapping[str, Scenario]) -> dict[str, Predicted]:
        """Read the cached predictions of scenarios; damaged files are ignored."""
        files = {
            name: arrays
            for name, scenario in scenarios.items()
            if not scenario.trees
            and (arrays := self._cache.read(scenario_text(scenario))) is not None
        }
        trees = self._trees() if files else []
        return {
            name: _predicted(scenarios[name], arrays, trees)
            for name, arrays in files.items()
            if _whole(arrays, trees)
        }

    def write(self, predicted: Mapping[str, Predicted]) -> None:
        """Cache predictions if the folder is writable, except those with custom networks."""
        folder = self._cache.folder
        if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
            return  # a study that may only be read is simulated again each time
        for file in folder.glob("*.npz"):
            if not file.name.startswith(self._cache.kind):  # of the study before it went on
                file.unlink()
        for found in predicted.values():
            if not found.scenario.trees:
                self._cache.write(scenario_text(found.scenario), _arrays(found))

    def _trees(self) -> Trees:
        """Grow the intrinsic Purkinje networks again, which takes a few ms each."""
        population, simulator = self.fitted.population, self.fitted.simulator
        every = [population.parameters(k) for k in range(len(population))]
        parameters = [{**simulator.fixed, **each} for each in every]
        return list(simulator.pool.map(_grown, parameters, simulator.model))


def _grown(parameters: Mapping[str, float], model: ForwardModel) -> tuple[PurkinjeTree, ...]:
    trees = model.grow(complete(parameters))
    if isinstance(trees, InvalidTree):
        raise RuntimeError(f"a network of the population is impossible: {trees.reason}")
    return trees


def _arrays(found: Predicted) -> dict[str, NDArray[Any]]:
    """Arrays to store for n networks; those of unequal lengths are concatenated."""
    times = [[times for _, times in beat.trees] for beat in found.beats]
    return {
        "leads": np.concatenate([beat.leads for beat in found.beats], axis=1),
        "filtered": np.concatenate([beat.filtered for beat in found.beats], axis=1),
        "lengths": np.array([beat.leads.shape[1] for beat in found.beats]),
        "activation": np.array([beat.activation for beat in found.beats]),
        "captured": np.array([beat.captured for beat in found.beats]),
        "tree_times": np.concatenate([each for of_beat in times for each in of_beat]),
        "indices": np.array([found.indices[name] for name in INDICES]),
    }


def _whole(arrays: Arrays, trees: Trees) -> bool:
    """Whether all arrays exist and their sizes agree."""
    if {*arrays} != NAMES or arrays["lengths"].ndim != 1:
        return False
    count, samples = len(trees), int(arrays["lengths"].sum())
    leads = arrays["leads"].shape[0]
    return (
        arrays["lengths"].shape == (count,)
        and leads >= len(LEADS)
        and arrays["leads"].shape == (leads, samples)
        and arrays["filtered"].shape == (leads, samples + 2 * RINGING * count)
        and arrays["activation"].shape[:1] == arrays["captured"].shape[:1] == (count,)
        and arrays["tree_times"].shape == (sum(_sizes(trees)),)
        and arrays["indices"].shape == (len(INDICES), count)
    )


def _predicted(scenario: Scenario, arrays: Arrays, trees: Trees) -> Predicted:
    """Inverse of `_arrays`."""
    lengths = arrays["lengths"]
    leads = np.split(arrays["leads"], np.cumsum(lengths)[:-1], axis=1)
    filtered = np.split(arrays["filtered"], np.cumsum(lengths + 2 * RINGING)[:-1], axis=1)
    times = iter(np.split(arrays["tree_times"], np.cumsum(_sizes(trees))[:-1]))
    beats = [
        PredictedBeat(
            leads[k],
            filtered[k],
            arrays["activation"][k],
            tuple((tree, next(times)) for tree in own),
            arrays["captured"][k],
        )
        for k, own in enumerate(trees)
    ]
    return Predicted(scenario, beats, dict(zip(INDICES, arrays["indices"], strict=True)))


def _sizes(trees: Trees) -> list[int]:
    """How many nodes each tree of each network has."""
    return [len(tree.nodes) for own in trees for tree in own]
