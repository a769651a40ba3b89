"""Predictions of scenarios in the networks of a population, and their cache in a study's folder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fascicle.core import above, html_card
from fascicle.core.arrays import Floats
from fascicle.core.files import ArrayCache, as_path, write_text
from fascicle.core.parameters import Infeasible, complete
from fascicle.core.ranges import short_repr
from fascicle.forward.activation_sequence import activation_maps
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.loss import Response, placed
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.prediction.index_names import INDICES
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.study.fitted import FittedStudy

RINGING = 40  # samples (ms) on either side of an ECG, for the ringing of the recorder's filters

Arrays = Mapping[str, NDArray[Any]]
Trees = Sequence[tuple[PurkinjeTree, ...]]  # of each network


@dataclass(frozen=True)
class Predicted:
    """A scenario predicted in n networks.

    Attributes
    ----------
    scenario : Scenario
        Predicted scenario.
    beats : sequence of Beat
        Beat of each network, its ECG scaled by the best gain or by the gain drawn with the network,
        in single precision (`Beat.in_single_precision`).
    indices : mapping of name to (n,) array
        `INDICES` of each network.
    effective : float
        Effective number of independent networks; inf if unknown, which counts as n.
    response : Response, optional
        Filters of the recorder, as a function of frequency.
    """

    scenario: Scenario
    beats: Sequence[Beat]
    indices: Mapping[str, Floats]
    effective: float = np.inf
    response: Response | None = None

    __repr__ = short_repr
    _repr_html_ = html_card

    def plot(self) -> list[Any]:
        """Draw the ECG by `fascicle.plot.prediction`; returns Matplotlib axes."""
        return list(above("plot").prediction(self))

    def save(self, path: Path | str) -> None:
        """Write `index_table` as CSV; `fascicle.predict` keeps the beats in the study's folder."""
        write_text(as_path(path, "path"), self.index_table().to_csv(lineterminator="\n"))

    def index_table(self) -> pd.DataFrame:
        """`indices` as a table: one row per network, one column per index, named with its unit."""
        columns = {i: f"{i}_{unit}" for i, unit in INDICES.items() if unit != "1"}
        return pd.DataFrame(dict(self.indices)).rename(columns=columns).rename_axis("network")

    def percentile_networks(self) -> dict[str, int]:
        """Networks at the 5th, 50th and 95th percentile of the total activation time."""
        order = np.argsort(self.indices["total_activation_time"], kind="stable")
        shares = {"5th percentile": 0.05, "median": 0.5, "95th percentile": 0.95}
        return {name: int(order[round(q * (len(order) - 1))]) for name, q in shares.items()}

    def filtered(self, k: int) -> Floats:
        """ECG (12 + k, t + 2 `RINGING`) of network `k` after the recorder's filters (mV).

        Indices are not measured on it, because steep filters ring about the QRS.
        """
        leads = self.beats[k].leads
        return placed(leads, -RINGING, leads.shape[1] + 2 * RINGING, self.response)

    @property
    def captured(self) -> Floats:
        """Share of the networks that each myocardial stimulus captures, shape (n_stimuli,)."""
        return np.asarray(np.mean([beat.captured for beat in self.beats], axis=0))

    @cached_property
    def maps(self) -> dict[str, Floats]:
        """`activation_maps` of the networks."""
        return activation_maps([beat.activation for beat in self.beats])


@dataclass(frozen=True)
class PredictionCache:
    """Cached predictions of one population in a study's folder, one file per scenario."""

    fitted: FittedStudy
    fields: ClassVar = ("leads", "onset", "activation", "captured")  # of a beat, as they are stored

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
            name: self._cache.read(repr(scenario))
            for name, scenario in scenarios.items()
            if not (scenario.trees or scenario.has_own_primitives)
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
            leads, onset, activation, captured = (arrays[f"{name} {k}"] for name in self.fields)
            times = tuple(arrays[f"times {k} {number}"] for number in range(len(network)))
            coupled = Activation(activation, times, captured=captured)
            groups = np.arange(len(captured))
            beats.append(Beat(leads, float(onset), network, coupled, groups, lead_names=names))
        indices = dict(zip(INDICES, arrays["indices"], strict=True))
        return Predicted(scenario, beats, indices, response=target.response)

    def write(self, predicted: Mapping[str, Predicted]) -> None:
        """Cache predictions of the package's own primitives, if the folder is writable."""
        folder = self._cache.folder
        if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
            return  # predictions of a read-only study are simulated each time
        for file in folder.glob("*.npz"):
            if not file.name.startswith(self._cache.kind):  # from before the study went on
                file.unlink()
        for prediction in predicted.values():
            scenario = prediction.scenario
            if not (scenario.trees or scenario.has_own_primitives):
                self._cache.write(repr(scenario), self._arrays(prediction))

    def _arrays(self, predicted: Predicted) -> Arrays:
        """Arrays to store: the indices, and the arrays of each network by its number."""
        arrays = {"indices": np.array([predicted.indices[name] for name in INDICES])}
        for k, beat in enumerate(predicted.beats):
            arrays |= {f"{name} {k}": getattr(beat, name) for name in self.fields}
            arrays |= {f"times {k} {tree}": times for tree, times in enumerate(beat.coupled.trees)}
        return arrays

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
