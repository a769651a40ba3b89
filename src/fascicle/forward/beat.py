"""Beat: output of the forward model for the quantities of a network and a scenario."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from fascicle.core import above, html_card
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.files import as_path
from fascicle.core.leads import LEADS
from fascicle.core.ranges import check_kind, short_repr
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.electrocardiogram import SAMPLE_STEP
from fascicle.heart.heart import Heart
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.recording.criteria import Criterion, conventional_criteria, frontal_axis
from fascicle.recording.window import qrs_window


@dataclass(frozen=True)
class Beat:
    """Beat of a network in a scenario: trees, activation, and the ECG that it causes.

    Attributes
    ----------
    leads : (12 + k, n_time) array
        The twelve leads of `fascicle.core.leads.LEADS`, then additional ones (mV), every 1 ms.
    onset : float
        Time of the first sample of `leads` (ms); not the QRS onset.
    trees : tuple of PurkinjeTree
        Purkinje trees, the left one first.
    coupled : Activation
        Activation times of myocardium and trees, how each junction fired, and the site that fired
        each vertex. A beat simulated on a graphics card has the times of the myocardium alone.
    capture_groups : (n_points,) int array
        Number of the scenario's myocardial stimulus to which each point of `Activation.stimuli`
        belongs: first the stimuli in their order, then the vertices that they capture.
    lead_names : tuple of str
        Names of the leads.
    """

    leads: Floats
    onset: float
    trees: tuple[PurkinjeTree, ...]
    coupled: Activation
    capture_groups: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    lead_names: tuple[str, ...] = field(default=LEADS, kw_only=True)

    __repr__ = short_repr
    _repr_html_ = html_card

    @property
    def activation(self) -> Floats:
        """Activation time of each vertex of the heart (ms), (n,); inf where no front arrives."""
        return self.coupled.myocardium

    @property
    def signals(self) -> Signals:
        """ECG of the beat, to be compared with a recording."""
        junctions = tuple(len(tree.junctions) for tree in self.trees)
        return Signals(self.leads, self.first_activation, junctions)

    def in_single_precision(self) -> Beat:
        """Smaller copy to store many beats: times in single precision, without the firing sites."""
        times: Any = [times.astype(np.float32) for times in (self.activation, *self.coupled.trees)]
        coupled = Activation(times[0], tuple(times[1:]), captured=self.captured)
        return replace(self, coupled=coupled, capture_groups=np.arange(len(self.captured)))

    @cached_property
    def ecg(self) -> xr.DataArray:
        """All leads (mV) with their names: dimensions ``lead`` and ``time`` (ms)."""
        time = self.onset + np.arange(self.leads.shape[1]) * SAMPLE_STEP
        coords = {"lead": list(self.lead_names), "time": time}
        ecg = xr.DataArray(
            self.leads, coords=coords, dims=("lead", "time"), name="ecg", attrs={"units": "mV"}
        )
        ecg["time"].attrs["units"] = "ms"
        return ecg

    @property
    def first_activation(self) -> float:
        """Sample of `leads` at which the first vertex activates; may lie between samples."""
        return float((self.activation.min() - self.onset) / SAMPLE_STEP)

    @property
    def total_activation_time(self) -> float:
        """Time from the first to the last activation of the reached myocardium (ms)."""
        reached = self.activation[np.isfinite(self.activation)]
        return float(reached.max() - reached.min())

    @property
    def unreached(self) -> Booleans:
        """Vertices that no front reaches: scar, or isolated tissue; shape (n,).

        They are infinitely late in `activation` and contribute nothing to the ECG.
        """
        return np.asarray(np.isinf(self.activation))

    @property
    def qrs_duration(self) -> float:
        """QRS duration (ms), measured as in recordings."""
        onset, offset = self.qrs_window
        return (offset - onset) * SAMPLE_STEP

    @property
    def frontal_axis(self) -> float:
        """Frontal QRS axis (degrees), measured as in recordings."""
        onset, offset = self.qrs_window
        return frontal_axis(self.leads[:, onset : offset + 1])

    @property
    def conventional_criteria(self) -> tuple[Criterion, ...]:
        """Conventional ECG criteria of conduction disturbances, evaluated as for a recording."""
        return conventional_criteria(self.leads, *self.qrs_window, names=self.lead_names)

    @cached_property
    def qrs_window(self) -> tuple[int, int]:
        """First and last sample of the QRS, measured as in recordings."""
        return qrs_window(self.leads)

    @property
    def captured(self) -> Booleans:
        """Whether each myocardial stimulus captured, before any front arrived, (n_stimuli,)."""
        return np.asarray(np.bincount(self.capture_groups, self.coupled.captured) > 0)

    def plot(self, heart: Heart | Path | str | None = None) -> list[Any]:
        """Draw the ECG, or on a heart the activation, by `fascicle.plot.beat`."""
        return list(above("plot").beat(self, heart))

    def to_pyvista(self, heart: Heart | None = None) -> Any:
        """`pyvista.MultiBlock` (mm) of trees, junctions, and the heart if it is given."""
        return above("forward.simulation_files").beat_blocks(self, heart)

    def save(self, folder: Path | str, heart: Heart) -> None:
        """Write the folder that ``fascicle simulate`` writes, whole or not at all.

        `fascicle.read_tree` reads its trees, `fascicle.read_recording` its ECG.
        """
        check_kind(heart, Heart, "heart", "the heart that was simulated")
        path = as_path(folder, "folder")
        above("forward.simulation_files").write_simulation(heart, self, path, {})

    def index_table(self, heart: Heart, stimulus: float | None = None) -> pd.DataFrame:
        """Indices of activation and ECG, one per row: ``value``, ``unit`` and ``name``.

        Indices that count from the first `stimulus` (ms) are NaN without one.
        """
        return pd.DataFrame(above("prediction.indices").index_table(self, heart, stimulus))


@dataclass(frozen=True)
class Signals:
    """ECG of a beat, to be compared with a recording, and the beginning of its activation."""

    leads: Floats  # (12 + k, n), mV, in the leads of the heart
    first_activation: float  # sample of `leads`; may lie between samples
    junctions: tuple[int, ...]  # number of each tree


def check_activation(times: Floats, longest: float = 100_000.0) -> None:
    """Refuse activation times (ms) that give no ECG: none is finite, or they lie too far apart.

    More than `longest` (ms) from first to last is a mistake, and takes much memory.
    """
    reached = times[np.isfinite(times)]
    if not len(reached):
        raise InputError(
            "nothing activates the myocardium; let a root fire, unblock a bundle, or add a stimulus"
        )
    if np.ptp(reached) > longest:
        raise InputError(
            f"activation takes {np.ptp(reached):.3g} ms from first to last, more than "
            f"{longest:g}; check speeds, delays and times of stimuli"
        )
