"""The sequence in which the ventricles are activated, of one network and over many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers, Singles
from fascicle.core.ranges import short_repr
from fascicle.heart.endocardium import about_long_axis
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label, labelled_mesh
from fascicle.mesh.measures import unit


class MappedRange(NamedTuple):
    """Range of a time (ms) of `ActivationSequence` in mapped human hearts, and its name."""

    lower: float
    upper: float
    name: str

    def holds(self, time: float) -> bool:
        """True if a time (ms) is within it."""
        return self.lower <= time <= self.upper


# Human hearts with a QRS below 120 ms: Durrer et al., Circulation 41 (1970) 899-912; Wyndham et
# al., Circulation 59 (1979) 161-168
MAPPED: Mapping[str, MappedRange] = {
    "lv_septum": MappedRange(0.0, 1.0, "left septum after the first activation"),
    "rv_delay": MappedRange(3.0, 12.0, "right endocardium after the left one"),
    "rv_breakthrough": MappedRange(7.0, 25.0, "right epicardial breakthrough"),
    "total": MappedRange(60.0, 100.0, "last activation"),
}
LATE_QRS = 120.0  # ms; from this duration on, with a block, the sequence of activation differs
PARTS = {
    "lv_septum": "left septum",
    "lv_free_wall": "left free wall",
    "rv_septum": "right septum",
    "rv_free_wall": "right free wall",
}


@dataclass(frozen=True)
class ActivationSequence:
    """First activation of parts of the ventricles, in ms after the earliest activation.

    Attributes
    ----------
    lv_septum, lv_free_wall, rv_septum, rv_free_wall : float
        Endocardium of the septum and of the free wall, left and right; inf if there is none.
    rv_breakthrough, lv_breakthrough : float
        Epicardium of the right and of the left ventricle.
    total : float
        Latest activation of the ventricles.
    last : str
        Place of the latest activation.
    """

    lv_septum: float
    lv_free_wall: float
    rv_septum: float
    rv_free_wall: float
    rv_breakthrough: float
    lv_breakthrough: float
    total: float
    last: str

    @property
    def rv_delay(self) -> float:
        """First activation of the right endocardium after that of the left one (ms)."""
        right = min(self.rv_septum, self.rv_free_wall)
        return right - min(self.lv_septum, self.lv_free_wall)

    @property
    def first(self) -> str:
        """Part of the endocardium that is activated first."""
        return PARTS[min(PARTS, key=lambda name: getattr(self, name))]

    @property
    def is_mapped(self) -> bool:
        """True if every time that `MAPPED` names is in its range of mapped human hearts."""
        return all(mapped.holds(getattr(self, name)) for name, mapped in MAPPED.items())


@dataclass(frozen=True)
class VentricularSurfaces:
    """Parts of a heart's surface, and the place of each vertex in the ventricles.

    A vertex of an endocardium is septal if the other endocardium is nearer than the epicardium.

    Attributes
    ----------
    parts : mapping of str to (k,) array
        Vertices of each part that `ActivationSequence` names.
    places : (n,) array of str
        Third of the LV long axis, wall and ventricle of each vertex, in words.
    rv_wall : (m,) array
        Mask of the tetrahedra of the free wall of the right ventricle.
    """

    parts: Mapping[str, Integers]
    places: np.ndarray[tuple[int], np.dtype[np.str_]]
    rv_wall: Booleans

    __repr__ = short_repr

    @classmethod
    def of(cls, heart: Heart) -> VentricularSurfaces:
        """Find the surfaces of a heart."""
        vertices, mesh = heart.vertices, cKDTree(heart.vertices)
        endocardium = {
            e.side: np.unique(mesh.query(e.vertices[np.unique(e.triangles)])[1])
            for e in heart.endocardia
        }
        outside = np.unique(labelled_mesh(heart).having(Label.EPICARDIUM))
        epicardium = np.setdiff1d(outside, np.concatenate([*endocardium.values()]))
        endocardial_trees = {side: cKDTree(vertices[wall]) for side, wall in endocardium.items()}
        epicardial_tree = cKDTree(vertices[epicardium]) if len(epicardium) else None
        parts: dict[str, Integers] = {}
        for side, other in (("lv", "rv"), ("rv", "lv")):
            wall = endocardium[side]
            septal = np.ones(len(wall), bool)
            if epicardial_tree is not None:
                to_other = endocardial_trees[other].query(vertices[wall])[0]
                septal = to_other < epicardial_tree.query(vertices[wall])[0]
            parts |= {f"{side}_septum": wall[septal], f"{side}_free_wall": wall[~septal]}
        right = (
            endocardial_trees["rv"].query(vertices)[0] < endocardial_trees["lv"].query(vertices)[0]
        )
        parts["rv_breakthrough"] = epicardium[right[epicardium]]
        parts["lv_breakthrough"] = epicardium[~right[epicardium]]
        middles = vertices[heart.tetrahedra].mean(axis=1)
        distances = {
            name: cKDTree(vertices[wall]).query(middles)[0] if len(wall) else np.inf
            for name, wall in parts.items()
            if name in PARTS
        }
        to_left = np.minimum(distances["lv_septum"], distances["lv_free_wall"])
        rv_wall = distances["rv_free_wall"] < np.minimum(to_left, distances["rv_septum"])
        return cls(parts, _places(heart, right), np.broadcast_to(rv_wall, len(middles)))

    def sequence(self, activation: Floats) -> ActivationSequence:
        """Activation sequence of activation times (n,) at the vertices (ms)."""
        delays = activation - activation.min()
        firsts = {
            name: float(delays[part].min(initial=np.inf)) for name, part in self.parts.items()
        }
        reached = np.where(np.isfinite(delays), delays, -1.0)
        last = int(reached.argmax())
        return ActivationSequence(**firsts, total=float(delays[last]), last=str(self.places[last]))


def _places(heart: Heart, right: Booleans) -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """Place of each vertex in words; `right` (n,) is the mask of those nearer to the RV cavity."""
    left_endocardium = heart.lv.vertices, heart.lv.triangles
    height, around, down = about_long_axis(*left_endocardium, heart.vertices)
    septal = unit(about_long_axis(*left_endocardium, heart.rv.vertices)[1].mean(axis=0))
    angle = np.degrees(np.arctan2(around @ np.cross(septal, down), around @ septal))
    third = np.select([height < 1 / 3, height < 2 / 3], ["basal", "mid"], "apical")
    wall = np.select(
        [np.abs(angle) < 60, np.abs(angle) > 120, angle > 0], ["septal", "lateral", "anterior"],
        "posterior",
    )  # fmt: skip
    left = np.char.add(np.char.add(third, " "), np.char.add(wall, " left ventricle"))
    return np.where(right, np.char.add(third, " right ventricle"), left)


@dataclass(frozen=True)
class SequenceSummary:
    """Summary of the activation sequences of several networks.

    Attributes
    ----------
    times : mapping of str to (float, float, float)
        Median, 5th and 95th percentile (ms) of each time that `MAPPED` names.
    first, last : mapping of str to float
        Share of the networks in which a part is activated first, and last.
    mapped : float
        Share of the networks whose sequence is that of mapped human hearts.
    """

    times: Mapping[str, tuple[float, float, float]]
    first: Mapping[str, float]
    last: Mapping[str, float]
    mapped: float

    @classmethod
    def of(cls, sequences: Sequence[ActivationSequence]) -> SequenceSummary:
        """Summary of one sequence or more."""
        times = {}
        for name in MAPPED:
            median, low, high = np.percentile([getattr(s, name) for s in sequences], (50, 5, 95))
            times[name] = float(median), float(low), float(high)
        first, last = (  # the most frequent first
            {
                part: count / len(sequences)
                for part, count in Counter(sorted(getattr(s, end) for s in sequences)).most_common()
            }
            for end in ("first", "last")
        )
        return cls(times, first, last, float(np.mean([s.is_mapped for s in sequences])))

    @property
    def departure(self) -> str:
        """Main difference of the networks from mapped hearts, in words; empty if most have none."""
        if self.mapped >= 0.5:
            return ""
        first = next(iter(self.first))
        if first != PARTS["lv_septum"]:
            return f"activation begins on the {first}"
        median = {name: times[0] for name, times in self.times.items()}
        for name, mapped in MAPPED.items():
            if not mapped.holds(median[name]):
                return (
                    f"{mapped.name} at {median[name]:.0f} ms, {mapped.lower:.0f} to "
                    f"{mapped.upper:.0f} ms in mapped hearts"
                )
        return "the sequence of activation is that of a mapped heart in less than half of them"

    @property
    def lines(self) -> list[str]:
        """Lines of text: first and last activated parts, and times with the mapped ranges."""
        ends = (
            f"{event}: " + ", ".join(f"{n} {p:.0%}" for n, p in [*shares.items()][:3] if p > 0.005)
            for event, shares in (("first activated", self.first), ("last activated", self.last))
        )
        times = [
            f"{mapped.name}: {middle:.0f} ms (90 % CrI {low:.0f} to {high:.0f}; normally "
            f"{mapped.lower:.0f} to {mapped.upper:.0f})"
            for (name, mapped), (middle, low, high) in zip(
                MAPPED.items(), self.times.values(), strict=True
            )
        ]
        return [*ends, *times]


def since_first(activation: Floats | Singles) -> Floats:
    """Activation times (..., n) (ms) from the first of each row on; NaN where no front arrives."""
    times = np.where(np.isfinite(activation), activation, np.nan).astype(float)
    return np.asarray(times - activation.min(axis=-1, keepdims=True))


def nearest_to_median(activations: Floats | Singles) -> int:
    """Index of the network whose activation map (n_networks, n) is nearest to the median map.

    Times count from the first activation of each network on. The median map is that of the medians
    at each vertex; distance is the root mean square over the vertices that a network reaches.
    """
    times = since_first(activations)
    times = times[:, np.isfinite(times).any(axis=0)]
    squares = (times - np.nanmedian(times, axis=0)) ** 2
    return int(np.nanmean(squares, axis=1).argmin())


def activation_maps(activations: Sequence[Floats | Singles]) -> dict[str, Floats]:
    """Activation over networks at each of n vertices, from the first of each network on.

    Mean and standard deviation (ms), and the probability that the vertex is among the latest fifth,
    of activation times (n,) of each network, which are inf where no front arrives. A vertex that no
    network reaches is NaN; elsewhere only networks that reach the vertex count.
    """

    def total(of_times: Callable[[Floats], Any]) -> Any:
        # network by network, since copies of all maps of a large heart take a gigabyte
        return sum(of_times(since_first(activation)) for activation in activations)

    reached = total(np.isfinite)
    counts = np.where(reached > 0, reached, np.nan)
    mean = total(np.nan_to_num) / counts
    return {
        "activation_mean": mean,
        "activation_sd": np.sqrt(total(lambda times: np.nan_to_num((times - mean) ** 2)) / counts),
        "probability_latest_fifth": total(lambda t: t >= np.nanquantile(t, 0.8)) / counts,
    }
