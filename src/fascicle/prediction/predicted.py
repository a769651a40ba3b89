"""Predictions of scenarios in the networks of a population, and the data stored for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fascicle.core import above, html_card
from fascicle.core.arrays import Booleans, Floats, Singles
from fascicle.core.files import as_path, write_text
from fascicle.core.ranges import short_repr
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Simulation
from fascicle.prediction.index_names import INDICES
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.study.activation_maps import activation_maps

RINGING = 40  # samples on either side, for the ringing of the recorder's filters


@dataclass(frozen=True)
class PredictedBeat:
    """Data stored for one simulation; times are in single precision to save memory.

    Indices are not measured on the filtered ECG, because steep filters ring about the QRS.
    """

    leads: Floats  # (12 + k, t) mV, every 1 ms, with the best gain or the one that was drawn
    filtered: Floats  # (12 + k, t + 2 * `RINGING`), the ECG after the recorder's filters
    activation: Singles  # (n,) ms, of each vertex of the heart; inf if not activated
    trees: tuple[tuple[PurkinjeTree, Singles], ...]  # left first; times of the nodes (ms)
    captured: Booleans  # (n_stimuli,), which of the scenario's myocardial stimuli captured

    __repr__ = short_repr

    @classmethod
    def of(cls, simulation: Simulation, leads: Floats, filtered: Floats) -> PredictedBeat:
        """Store a simulation; `leads` and `filtered` as above."""
        times = (node_times.astype(np.float32) for node_times in simulation.coupled.trees)
        trees = tuple(zip(simulation.trees, times, strict=True))
        activation = simulation.activation.astype(np.float32)
        return cls(leads, filtered, activation, trees, simulation.captured)


@dataclass(frozen=True)
class Predicted:
    """A scenario predicted in n networks.

    Attributes
    ----------
    scenario : Scenario
        Predicted scenario.
    beats : sequence of PredictedBeat
        Beat of each network.
    indices : mapping of name to (n,) array
        `INDICES` of each network.
    effective : float
        Effective number of independent networks; inf if unknown, which counts as n.
    """

    scenario: Scenario
    beats: Sequence[PredictedBeat]
    indices: Mapping[str, Floats]
    effective: float = np.inf

    __repr__ = short_repr
    _repr_html_ = html_card

    def plot(self) -> list[Any]:
        """Draw the ECG by `fascicle.plot.prediction`; returns Matplotlib axes."""
        return list(above("plot").prediction(self))

    def save(self, path: Path | str) -> None:
        """Write `index_table` as CSV; `fascicle.predict` keeps the rest in the study's folder."""
        write_text(as_path(path, "path"), self.index_table().to_csv(lineterminator="\n"))

    def index_table(self) -> pd.DataFrame:
        """`indices` as a table: a row a network, a column an index, with its unit in the name."""
        columns = {i: f"{i}_{unit}" for i, unit in INDICES.items() if unit != "1"}
        return pd.DataFrame(dict(self.indices)).rename(columns=columns).rename_axis("network")

    def extremes(self) -> dict[str, int]:
        """Networks with the least, the median and the largest total activation time."""
        order = np.argsort(self.indices["total_activation_time"], kind="stable")
        return {
            "minimum": int(order[0]),
            "median": int(order[(len(order) - 1) // 2]),
            "maximum": int(order[-1]),
        }

    def matches_first(self, other: Predicted) -> bool:
        """Whether the first network has the same ECG, activation and indices in both."""
        beat, other_beat = self.beats[0], other.beats[0]
        return (
            np.array_equal(beat.leads, other_beat.leads)
            and np.array_equal(beat.activation, other_beat.activation)
            and all(
                np.array_equal(self.indices[n][:1], v[:1], equal_nan=True)
                for n, v in other.indices.items()
            )
        )

    @property
    def captured(self) -> Floats:
        """Share of the networks that each myocardial stimulus captures, shape (n_stimuli,)."""
        return np.asarray(np.mean([beat.captured for beat in self.beats], axis=0))

    @cached_property
    def maps(self) -> dict[str, Floats]:
        """`activation_maps` of the networks."""
        return activation_maps(np.array([beat.activation for beat in self.beats]))
