"""The sequence in which the ventricles are activated, held against mapped human hearts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.ranges import short_repr
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label, labelled_mesh

# What mapped human hearts show, with QRS below 120 ms (docs/posterior.md names the sources):
# attribute of `ActivationSequence`, least and greatest value (ms), name
MAPPED: tuple[tuple[str, float, float, str], ...] = (
    ("lv_septum", 0.0, 1.0, "activation of the left septum"),
    ("rv_delay", 3.0, 12.0, "right after left ventricle"),
    ("rv_breakthrough", 7.0, 25.0, "right epicardial breakthrough"),
    ("total", 60.0, 100.0, "total activation time"),
)


@dataclass(frozen=True)
class ActivationSequence:
    """When the parts of the ventricles are first activated (ms after the first of all).

    Attributes
    ----------
    lv_septum, lv_free_wall, rv_septum, rv_free_wall : float
        Left and right endocardium of the septum and of the free walls.
    rv_breakthrough, lv_breakthrough : float
        Right and left epicardium.
    total : float
        The last activation of all.
    """

    lv_septum: float
    lv_free_wall: float
    rv_septum: float
    rv_free_wall: float
    rv_breakthrough: float
    lv_breakthrough: float
    total: float

    @property
    def rv_delay(self) -> float:
        """First activation of the right endocardium after that of the left one (ms)."""
        right = min(self.rv_septum, self.rv_free_wall)
        return right - min(self.lv_septum, self.lv_free_wall)

    @property
    def is_mapped(self) -> bool:
        """Whether mapped human hearts are activated in this sequence."""
        return all(low <= getattr(self, name) <= high for name, low, high, _ in MAPPED)


@dataclass(frozen=True)
class VentricularSurfaces:
    """Vertices of a heart on the parts of its surface, by the names of `ActivationSequence`.

    An endocardium belongs to the septum where the other endocardium is nearer than the epicardium.
    """

    vertices: Mapping[str, Integers]

    __repr__ = short_repr

    @classmethod
    def of(cls, heart: Heart) -> VentricularSurfaces:
        """Those of a heart."""
        mesh = cKDTree(heart.vertices)
        endocardium = {
            e.side: np.unique(mesh.query(e.vertices[np.unique(e.triangles)])[1])
            for e in heart.endocardia
        }
        outside = np.unique(labelled_mesh(heart).having(Label.EPICARDIUM))
        epicardium = np.setdiff1d(outside, np.concatenate([*endocardium.values()]))
        trees = {name: cKDTree(heart.vertices[k]) for name, k in endocardium.items()}
        beyond = cKDTree(heart.vertices[epicardium])
        found: dict[str, Integers] = {}
        for side, other in (("lv", "rv"), ("rv", "lv")):
            own = endocardium[side]
            places = heart.vertices[own]
            septal = trees[other].query(places)[0] < beyond.query(places)[0]
            found |= {f"{side}_septum": own[septal], f"{side}_free_wall": own[~septal]}
        away = {side: tree.query(heart.vertices[epicardium])[0] for side, tree in trees.items()}
        right = away["rv"] < away["lv"]
        found |= {"rv_breakthrough": epicardium[right], "lv_breakthrough": epicardium[~right]}
        return cls(found)

    def sequence(self, activation: Floats) -> ActivationSequence:
        """The sequence of an activation (ms), one value a vertex."""
        after = activation - activation.min()
        firsts = {name: float(after[k].min(initial=np.inf)) for name, k in self.vertices.items()}
        return ActivationSequence(**firsts, total=float(after.max()))
