"""Prediction cache of a study, so that no command repeats a simulation."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.array_cache import ArrayCache
from fascicle.core.parameters import Infeasible, complete
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import scenario_text
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.study.fitted import FittedStudy

FIELDS = ("leads", "onset", "activation", "captured")  # of a beat, as they are stored

Arrays = Mapping[str, NDArray[Any]]
Trees = Sequence[tuple[PurkinjeTree, ...]]  # of each network


@dataclass(frozen=True)
class PredictionCache:
    """Cached predictions of one population in a study's folder, one file per scenario."""

    fitted: FittedStudy

    @cached_property
    def _cache(self) -> ArrayCache:
        """Cache of this study's configuration, networks and gains."""
        fitted = self.fitted
        digest = hashlib.sha256(fitted.study.config.model_dump_json().encode())
        gains = fitted.gains if fitted.gains is not None else np.empty(0)
        for values in (*fitted.population.values.values(), gains):
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        return ArrayCache(fitted.folder / "predictions", digest.hexdigest()[:12])

    def read(self, scenarios: Mapping[str, Scenario]) -> dict[str, Predicted]:
        """Read the cached predictions of scenarios; damaged files are ignored."""
        files = {
            name: self._cache.read(scenario_text(scenario))
            for name, scenario in scenarios.items()
            if not scenario.trees
        }
        trees = self._trees() if any(files.values()) else []
        predictions = {}
        for name, arrays in files.items():
            with suppress(KeyError, ValueError):  # an array is missing, or of another size
                if arrays is not None:
                    predictions[name] = self._predicted(scenarios[name], arrays, trees)
        return predictions

    def _predicted(self, scenario: Scenario, arrays: Arrays, trees: Trees) -> Predicted:
        """Prediction of a scenario from stored arrays, the inverse of `_arrays`."""
        names, target = self.fitted.simulator.model.heart.leads, self.fitted.recordings[0].target
        beats = []
        for k, network in enumerate(trees):
            leads, onset, activation, captured = (arrays[f"{name} {k}"] for name in FIELDS)
            times = tuple(arrays[f"times {k} {number}"] for number in range(len(network)))
            coupled = Activation(activation, times, captured=captured)
            groups = np.arange(len(captured))
            beats.append(Beat(leads, float(onset), network, coupled, groups, lead_names=names))
        indices = dict(zip(INDICES, arrays["indices"], strict=True))
        return Predicted(scenario, beats, indices, response=target.response)

    def write(self, predicted: Mapping[str, Predicted]) -> None:
        """Cache predictions if the folder is writable, except those with custom networks."""
        folder = self._cache.folder
        if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
            return  # predictions of a read-only study are simulated each time
        for file in folder.glob("*.npz"):
            if not file.name.startswith(self._cache.kind):  # of the study before it was continued
                file.unlink()
        for prediction in predicted.values():
            if not prediction.scenario.trees:
                self._cache.write(scenario_text(prediction.scenario), _arrays(prediction))

    def _trees(self) -> Trees:
        """Grow the intrinsic Purkinje networks again, which takes a few ms each."""
        population, simulator = self.fitted.population, self.fitted.simulator
        learnt = [population.parameters(k) for k in range(len(population))]
        parameters = [{**simulator.prior.fixed, **values} for values in learnt]
        return list(simulator.pool.map(_grown, parameters, simulator.model))


def _grown(parameters: Mapping[str, float], model: ForwardModel) -> tuple[PurkinjeTree, ...]:
    trees = model.grow(complete(parameters))
    if isinstance(trees, Infeasible):
        raise RuntimeError(f"a network of the population is impossible: {trees.reason}")
    return trees


def _arrays(predicted: Predicted) -> Arrays:
    """Arrays to store: the indices, and the arrays of each network by its number."""
    arrays = {"indices": np.array([predicted.indices[name] for name in INDICES])}
    for k, beat in enumerate(predicted.beats):
        arrays |= {f"{name} {k}": getattr(beat, name) for name in FIELDS}
        arrays |= {f"times {k} {tree}": times for tree, times in enumerate(beat.coupled.trees)}
    return arrays
