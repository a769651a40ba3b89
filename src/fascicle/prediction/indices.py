"""Indices of an activation and its ECG: durations, synchrony, peaks, QRS area.

Definitions and sources stand in docs/predictions.md, which a test holds to the names of
`fascicle.prediction.index_names`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from fascicle.core import above
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS
from fascicle.core.ranges import check_kind
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import SAMPLE_STEP
from fascicle.heart.fibres import Wall
from fascicle.heart.heart import Heart
from fascicle.heart.sites import APEX, RIGHT, Places, places
from fascicle.mesh.measures import signed_volumes
from fascicle.prediction.index_names import INDICES


@dataclass(frozen=True)
class Territories:
    """Volumes (mm³) of a heart's m elements, and their places in the ventricles."""

    tetrahedra: Integers
    volumes: Floats
    segment: Integers  # (m,), of the left ventricle, 1 to 17; 0 in the free wall of the right one
    left_free_wall: Booleans  # (m,), the left ventricle without the septum
    left: Integers  # vertices of the left ventricle with the septum
    right: Integers  # vertices of the free wall of the right one

    @classmethod
    def of(cls, heart: Heart, places: Places) -> Territories:
        """Territories of a heart."""
        right = places.segment == RIGHT
        vertices = (np.unique(heart.tetrahedra[chosen]) for chosen in (~right, right))
        free = places.wall == Wall.LV
        return cls(heart.tetrahedra, heart.volumes, places.segment, free, *vertices)

    def of_network(self, heart: Heart, parameters: Mapping[str, float]) -> Territories:
        """Territories in the heart of a network, which on an atlas has its own volumes."""
        if heart.atlas is None or "atlas_heart" not in parameters:
            return self
        vertices = heart.atlas.vertices(int(parameters["atlas_heart"]))
        return replace(self, volumes=signed_volumes(vertices, self.tetrahedra))

    def times(self, activation: Floats) -> Floats:
        """Mean activation time of each element (ms); inf where a corner is never activated."""
        return np.asarray(activation[self.tetrahedra].mean(axis=1))

    def segment_means(self, times: Floats) -> Floats:
        """Mean over the volume of each segment that is activated (ms), shape (18,); else NaN.

        The first is that of the right ventricle's free wall.
        """
        volumes = np.where(np.isfinite(times), self.volumes, 0.0)
        total = np.bincount(self.segment, volumes * np.where(volumes > 0, times, 0.0), APEX + 1)
        active = np.bincount(self.segment, volumes, APEX + 1)
        means = np.full(APEX + 1, np.nan)
        return np.asarray(np.divide(total, active, out=means, where=active > 0))


def indices(
    simulation: Beat, territories: Territories, stimulus: float | None = None
) -> dict[str, float]:
    """Compute all indices of a simulation whose first stimulus is at a time (ms).

    Indices counted from the stimulus are NaN without one; those of a missing wave are NaN.
    """
    return {**_of_activation(simulation.activation, territories), **_of_ecg(simulation, stimulus)}


def index_table(simulation: Beat, heart: Heart, stimulus: float | None) -> pd.DataFrame:
    """Indices of a simulation on its heart, as `Beat.index_table` says."""
    check_kind(heart, Heart, "heart", "the heart that was simulated")
    values = indices(simulation, Territories.of(heart, places(heart)), stimulus)
    name = above("reporting.names").index_name
    rows = [(key, value, INDICES[key], name(key)) for key, value in values.items()]
    return pd.DataFrame(rows, columns=["index", "value", "unit", "name"]).set_index("index")


def vectorcardiogram(leads: Floats) -> Floats:
    """Vectorcardiogram (mV), shape (3, n), of twelve leads (12, n), by regression.

    X (to the left), Y (down) and Z (to the back) of J. A. Kors et al., Eur Heart J 11 (1990).
    """
    regression = np.array(
        [  # on I, II, V1 … V6
            [0.38, -0.07, -0.13, 0.05, -0.01, 0.14, 0.06, 0.54],
            [-0.07, 0.93, 0.06, -0.02, -0.05, 0.06, -0.17, 0.13],
            [0.11, -0.23, -0.43, -0.06, -0.14, -0.20, -0.11, 0.31],
        ]
    )
    return np.asarray(regression @ leads[list(INDEPENDENT_ROWS)])


def _of_activation(activation: Floats, territories: Territories) -> dict[str, float]:
    times = territories.times(activation)
    right, *segments = territories.segment_means(times)
    begin, end = _ends(activation)
    reached = np.flatnonzero(np.isfinite(times))
    order = reached[np.argsort(times[reached])]
    done = np.cumsum(territories.volumes[order])  # of the volume that is reached at all
    late = times[order][np.searchsorted(done, done[-1] * np.array((0.9, 0.95)))]
    free = territories.left_free_wall & np.isfinite(times)
    left_free = np.average(times[free], weights=territories.volumes[free]) if free.any() else np.nan
    return {
        "total_activation_time": end - begin,
        "lv_activation_time": _ends(activation[territories.left])[1] - begin,
        "rv_activation_time": _ends(activation[territories.right])[1] - begin,
        "activation_time_90": float(late[0]) - begin,
        "activation_time_95": float(late[1]) - begin,
        "lv_rv_delay": float(left_free - right),
        "lv_dyssynchrony": float(np.nanstd(segments)),
        "latest_segment": float(1 + np.nanargmax(segments)),
    }


def _ends(times: Floats) -> tuple[float, float]:
    """First and last of the finite times (ms); NaN if there are none."""
    reached = times[np.isfinite(times)]
    return (float(reached.min()), float(reached.max())) if reached.size else (np.nan, np.nan)


def _of_ecg(simulation: Beat, stimulus: float | None) -> dict[str, float]:
    leads = simulation.leads
    onset, offset = simulation.qrs_window
    loop = vectorcardiogram(leads[:, onset : offset + 1])
    v6, v1 = (_r_peak(leads[LEADS.index(name), onset : offset + 1]) for name in ("V6", "V1"))
    since = np.nan if stimulus is None else simulation.onset + onset * SAMPLE_STEP - stimulus
    return {
        "qrs_duration": (offset - onset) * SAMPLE_STEP,
        "qrs_from_stimulus": since + (offset - onset) * SAMPLE_STEP,
        "v6_r_wave_peak_time": since + v6,
        "v6_v1_interpeak_interval": v1 - v6,
        "qrs_area": float(np.linalg.norm(loop.sum(axis=1)) * SAMPLE_STEP),  # 1 mV ms is 1 µVs
    }


def _r_peak(potential: Floats) -> float:
    """Time of the largest potential of a lead (ms), from its first sample; NaN without R wave."""
    peak = int(np.argmax(potential))
    # a lead whose largest potential is less than 0.05 mV has no R wave
    return peak * SAMPLE_STEP if potential[peak] >= 0.05 else np.nan
