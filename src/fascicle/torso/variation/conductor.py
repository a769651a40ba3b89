"""Heart, torso and electrodes as a conductor that depends on what is not known of the body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.leads import ELECTRODES
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart, Torso, TorsoTissue
from fascicle.mesh.measures import solid_centroid
from fascicle.torso.lead_fields import assemble_stiffness, outer_boundary, total_conductivity
from fascicle.torso.variation.body_axes import Motion, body_axes
from fascicle.torso.variation.morph import Morph, build_morph, symmetric

TISSUES = (TorsoTissue.BODY, TorsoTissue.LUNG, TorsoTissue.BLOOD)
LEAST_COMPRESSION = 0.1  # of the map's volumes: the heart keeps a tenth of its distance to the skin
CHEST = ELECTRODES[3:]


@dataclass(frozen=True)
class InvalidBody:
    """A body that cannot be: an expected outcome of a search, not an error.

    Attributes
    ----------
    reason : str
        Why, in one line.
    """

    reason: str


@dataclass(frozen=True)
class BodyState:
    """What differs from the heart folder's torso.

    Attributes
    ----------
    geometry : (7,) array
        The heart's displacement to the left, back and up (mm), its rotation vector along the same
        axes (rad), and the factor on the trunk.
    ratios : (3,) array
        Factors on the conductivities of body, lung and blood over that on the myocardium's.
    chest : (6, 2) array
        By how much V1 to V6 are moved along the skin, to the left and up (mm).
    """

    geometry: Floats
    ratios: Floats
    chest: Floats

    @classmethod
    def of(cls, values: Mapping[str, float]) -> BodyState:
        """From quantities of `fascicle.core.quantities`; those that are missing are neutral."""

        def value(name: str, neutral: float = 0.0) -> float:
            return values.get(name, neutral)

        pose = [value(f"heart_{way}") for way in ("left", "back", "up")]
        turns = [value(f"heart_turn_{way}") for way in ("left", "back", "up")]
        muscle = value("myocardium_conductivity", 1.0)
        ratios = [value(f"{t.name.lower()}_conductivity", 1.0) / muscle for t in TISSUES]
        together = value("chest_electrodes_up")
        chest = [(value(f"{n.lower()}_left"), value(f"{n.lower()}_up") + together) for n in CHEST]
        geometry = np.array([*pose, *turns, value("chest_size", 1.0)])
        return cls(geometry, np.array(ratios), np.array(chest))


@dataclass(frozen=True)
class Conductor:
    """The mesh of heart and torso, and what changes in it.

    Attributes
    ----------
    heart, torso : Heart, Torso
        The myocardium and what is around it.
    conductivity : (m, 3, 3) array
        σ of the heart's tetrahedra, then of the torso's, as known (mS/cm).
    skin : (t, 3) array
        Triangles of the skin.
    morph : Morph
        The map at the centres of the torso's tetrahedra.
    """

    heart: Heart
    torso: Torso
    conductivity: Floats
    skin: Integers
    morph: Morph

    @cached_property
    def tetrahedra(self) -> Integers:
        """The heart's, then the torso's (m, 4)."""
        return np.concatenate([self.heart.tetrahedra, self.torso.tetrahedra])

    @cached_property
    def of_heart(self) -> Floats:
        """σ of the heart's tetrahedra (h, 3, 3)."""
        return self.conductivity[: len(self.heart.tetrahedra)]

    @cached_property
    def around(self) -> Floats:
        """σ of the torso's tetrahedra (t, 3, 3)."""
        return self.conductivity[len(self.heart.tetrahedra) :]

    @cached_property
    def inside(self) -> Booleans:
        """Which of the torso's tetrahedra (t,) lie in the convex hull of heart and blood."""
        return np.asarray(self.morph.share == 0)

    @cached_property
    def in_hull(self) -> Integers:
        """All tetrahedra (i, 4) of that hull: the heart's and those."""
        return np.concatenate([self.heart.tetrahedra, self.torso.tetrahedra[self.inside]])

    @cached_property
    def axes(self) -> Floats:
        """Rows: to the left, back and up (3, 3)."""
        return body_axes(self.heart.electrodes)

    @cached_property
    def centroid(self) -> Floats:
        """Of the myocardium (3,), mm."""
        return solid_centroid(self.heart.vertices, self.heart.tetrahedra)

    def motion(self, state: BodyState) -> Motion:
        """The skin's motion around the heart."""
        return Motion.of(self.centroid, self.axes, state.geometry)

    def is_possible(self, state: BodyState) -> bool:
        """Whether the heart keeps clear of the skin."""
        return self.morph.compression(self.motion(state)) > LEAST_COMPRESSION

    def stiffness(self, state: BodyState) -> csr_matrix:
        """Conductances (n, n) over the factor on the myocardium's conductivity (1/kΩ)."""
        sigma = np.concatenate([self.of_heart, self.moved(state)])
        return assemble_stiffness(self.torso.vertices, self.tetrahedra, sigma)

    def moved(self, state: BodyState, chosen: Booleans | slice = slice(None)) -> Floats:
        """σT of the torso's tetrahedra, or of those chosen (c, 3, 3), as the body moves (mS/cm)."""
        sigma = self.around[chosen] * self.factors(state)[chosen, None, None]
        return np.asarray(sigma @ symmetric(self.morph.of(chosen).tensors(self.motion(state))))

    def factors(self, state: BodyState) -> Floats:
        """Factor on the conductivity of each of the torso's tetrahedra (m,)."""
        of_tissue = np.zeros(max(TISSUES) + 1)
        of_tissue[list(TISSUES)] = state.ratios
        return np.asarray(of_tissue[self.torso.tissues])


def build_conductor(heart: Heart, torso: Torso, conduction: Conduction) -> Conductor:
    """The conductor of a heart in its torso, tissues conducting as `conduction` has it."""
    sigma = total_conductivity(heart, torso, conduction)
    tetrahedra = np.concatenate([heart.tetrahedra, torso.tetrahedra])
    skin = outer_boundary(torso.vertices, tetrahedra)
    return Conductor(heart, torso, sigma, skin, build_morph(heart, torso, skin))
