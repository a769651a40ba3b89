"""The body around the heart, as the lead fields see it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from fascicle.core.arrays import Floats, Integers


class TorsoTissue(IntEnum):
    """What a tetrahedron outside the myocardium is."""

    BODY = 1
    LUNG = 2
    BLOOD = 3


@dataclass(frozen=True)
class Torso:
    """A conforming mesh of everything outside the myocardium.

    Attributes
    ----------
    vertices : (k, 3) array
        Positions (mm). The first ones are all vertices of the heart, in its order.
    tetrahedra : (m, 4) array
        Vertex indices, positively oriented; the myocardium's own are not among them.
    tissues : (m,) array
        A `TorsoTissue` for each.
    """

    vertices: Floats
    tetrahedra: Integers
    tissues: Integers


@dataclass(frozen=True)
class LeadFields:
    """Lead fields at the heart's vertices, and what they were computed from.

    Attributes
    ----------
    values : (9, n) array
        Potential for unit current through each electrode (kΩ), up to a constant.
    key : str
        `fascicle.torso.resolve.key_of` heart and conduction.
    torso : str
        `fascicle.torso.resolve.torso_key` of the body they were computed in.
    """

    values: Floats
    key: str
    torso: str
