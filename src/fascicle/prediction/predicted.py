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
from fascicle.core.arrays import Floats
from fascicle.core.files import as_path, write_text
from fascicle.core.ranges import short_repr
from fascicle.forward.beat import Beat
from fascicle.forward.loss import Response, placed
from fascicle.forward.scenario import Scenario
from fascicle.networks.activation_maps import activation_maps
from fascicle.prediction.index_names import INDICES

RINGING = 40  # samples on either side, for the ringing of the recorder's filters


@dataclass(frozen=True)
class Predicted:
    """A scenario predicted in n networks.

    Attributes
    ----------
    scenario : Scenario
        Predicted scenario.
    beats : sequence of Beat
        Beat of each network, its ECG with the best gain or the one that was drawn, in single
        precision (`Beat.in_single_precision`).
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
        return activation_maps(np.array([beat.activation for beat in self.beats]))
