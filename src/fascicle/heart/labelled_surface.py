"""The closed surface of the ventricles, with a label for every triangle."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fascicle.core.arrays import Floats, Integers


class Label(IntEnum):
    """What a part of the surface is.

    Valve openings are parts of the base: tissue was cut there, and nothing is endocardium. They
    need not be told apart; where the arterial ones are, fibres turn towards them.
    """

    BASE = 1
    EPICARDIUM = 2
    LV_ENDOCARDIUM = 3
    RV_ENDOCARDIUM = 4
    MITRAL = 5
    AORTIC = 6
    TRICUSPID = 7
    PULMONARY = 8

    @property
    def words(self) -> str:
        """Name for messages."""
        return self.name.replace("_", " ").lower()


BASAL = (Label.BASE, Label.MITRAL, Label.AORTIC, Label.TRICUSPID, Label.PULMONARY)
NEEDED = (Label.BASE, Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)


def missing_parts(labels: Integers) -> list[str]:
    """Names of the parts that no triangle is labelled as; a valve opening counts as base."""
    found = {Label.BASE if label in BASAL else label for label in np.unique(labels)}
    return [label.words for label in NEEDED if label not in found]


class _Labelled:
    """A boundary with a label for every triangle."""

    triangles: Integers
    labels: Integers

    def having(self, *labels: Label) -> Integers:
        """Triangles of the boundary with any of these labels, shape (k, 3)."""
        return self.triangles[np.isin(self.labels, labels)]


@dataclass(frozen=True)
class LabelledSurface(_Labelled):
    """The boundary of the ventricular myocardium.

    Attributes
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices, counter-clockwise seen from outside the tissue
        (normals leave the tissue).
    labels : (m,) array
        A `Label` for each triangle.
    name : str
        What to call it in messages; usually the file.
    """

    vertices: Floats
    triangles: Integers
    labels: Integers
    name: str = "surface"


@dataclass(frozen=True)
class LabelledMesh(_Labelled):
    """Tetrahedra of the ventricular myocardium and its labelled boundary, in register.

    Attributes
    ----------
    vertices, triangles, labels, name
        The boundary, as in `LabelledSurface`; vertices (mm) are those of the tetrahedra.
    tetrahedra : (m, 4) array
        Vertex indices, positively oriented.
    regions : (m,) array, optional
        A label for each tetrahedron (scar, for one); `None` where there are none.
    """

    vertices: Floats
    tetrahedra: Integers
    triangles: Integers
    labels: Integers
    regions: Integers | None = None
    name: str = "mesh"
