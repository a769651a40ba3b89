"""The closed surface of the ventricles, with a label for every triangle, and names of labels."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, printable
from fascicle.heart.endocardium import long_axis
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.mesh.topology import boundary_loops


class Label(IntEnum):
    """Anatomical part of the surface.

    Valve openings are parts of the base: tissue was cut there, and there is no endocardium. They
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
ENDOCARDIA = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
NEEDED_LABELS = (Label.BASE, Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)


def missing_parts(labels: Integers) -> list[str]:
    """Names of the parts that no triangle is labelled as; a valve opening counts as base."""
    present = {Label.BASE if label in BASAL else label for label in np.unique(labels)}
    return [label.words for label in NEEDED_LABELS if label not in present]


class _Labelled:
    """A boundary with a label for every triangle."""

    vertices: Floats
    triangles: Integers
    labels: Integers

    def part(self, label: Label) -> tuple[Floats, Integers]:
        """The vertices, and the triangles with a label."""
        return self.vertices, self.having(label)

    def having(self, *labels: Label) -> Integers:
        """Triangles of the boundary with any of these labels, shape (k, 3)."""
        return self.triangles[np.isin(self.labels, labels)]


@dataclass(frozen=True)
class LabelledSurface(_Labelled):
    """The boundary of the ventricular myocardium.

    Vertices (n, 3) (mm); triangles (m, 3), counter-clockwise seen from outside the tissue; a
    `Label` for each (m,); a name for messages, usually the file; and notes for the user on how the
    surface was repaired.
    """

    vertices: Floats
    triangles: Integers
    labels: Integers
    name: str = "surface"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class LabelledMesh(_Labelled):
    """Tetrahedra of the ventricular myocardium and its labelled boundary, in register.

    Vertices (n, 3) (mm); tetrahedra (m, 4), positively oriented; the boundary as in
    `LabelledSurface`; and perhaps the label of a region, such as scar, for each tetrahedron (m,).
    """

    vertices: Floats
    tetrahedra: Integers
    triangles: Integers
    labels: Integers
    regions: Integers | None = None
    name: str = "mesh"


def labelled_mesh(heart: Heart) -> LabelledMesh:
    """Labels of base, epicardium and endocardia, for a heart whose endocardia are known.

    The base is the boundary that faces away from the apex, at the level of the endocardia's
    openings. The endocardia need not be in register with the mesh.
    """
    triangles = heart.boundary[0]
    middle = heart.vertices[triangles].mean(axis=1)
    normals = unit(triangle_normals(heart.vertices, triangles))

    loops = [e.vertices[boundary_loops(e.triangles)[0]] for e in heart.endocardia]
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    length = float(np.linalg.norm(base - apex))
    up = (base - apex) / length
    lowest = min(float(((loop - apex) @ up).min()) for loop in loops)
    # the base lies at most 15 % of the way to the apex below the openings, and faces up (60°)
    basal = ((middle - apex) @ up > lowest - 0.15 * length) & (normals @ up > 0.5)
    labels = np.where(basal, int(Label.BASE), int(Label.EPICARDIUM))

    reach = 0.35 * heart.edge_length  # a triangle whose centre is nearer lies on the endocardium
    for label, e in ((Label.LV_ENDOCARDIUM, heart.lv), (Label.RV_ENDOCARDIUM, heart.rv)):
        square, face, _ = igl.point_mesh_squared_distance(middle, e.vertices, e.triangles)
        theirs = unit(triangle_normals(e.vertices, e.triangles)[face])
        # across a thin wall the other side is near too, but faces away; the base faces sideways
        same_way = np.einsum("ij,ij->i", normals, theirs) > 0.5
        labels[same_way & (np.asarray(square) < reach**2)] = label
    tissue = heart.vertices, heart.tetrahedra
    return LabelledMesh(*tissue, triangles, labels, heart.regions, heart.name)


Names = Mapping[str, Label]  # the caller's own names and numbers (as text) of labels

# Words that decide, in the order in which they do ("lv_epi" is epicardium, "rv base" is base), and
# words that may accompany them
LABEL_WORDS: dict[Label | None, tuple[str, ...]] = {
    Label.MITRAL: ("mitral", "mv"),
    Label.AORTIC: ("aortic", "aorta", "av", "aov"),
    Label.TRICUSPID: ("tricuspid", "tv"),
    Label.PULMONARY: ("pulmonary", "pulmonic", "pv"),
    Label.EPICARDIUM: ("epi", "epicardium", "epicardial"),
    Label.BASE: ("base", "basal"),
    Label.LV_ENDOCARDIUM: ("lv", "left"),
    Label.RV_ENDOCARDIUM: ("rv", "right"),
    None: (
        "endo", "endocardium", "endocardial", "ventricle", "ventricular", "ventricles", "heart",
        "surface", "surf", "sur", "face", "faces", "boundary", "wall", "valve", "annulus",
        "opening", "plane", "septum", "septal", "sept", "free", "cavity", "side", "set", "the",
        "of",
    ),
}  # fmt: skip


def label_of(name: str) -> Label | None:
    """Label that a name means, or None.

    Letter case, digits and separators do not matter, nor whether words are run together: "LV",
    "lv_endo", "LVendo", "endo-lv" and "Left ventricle" are all the left endocardium. Every word
    must be a known one, so that "lv_endo_stimulus" has no label.
    """
    if len(name) > 60:
        return None
    any_word = "|".join(sorted(sum(LABEL_WORDS.values(), ()), key=len, reverse=True))
    words: set[str] = set()
    for letters in re.findall("[^\\W\\d_]+", name.lower()):
        matches = re.findall(rf"({any_word})(?=(?:{any_word})*$)", letters)
        if "".join(matches) != letters:
            return None
        words.update(matches)
    meant = [label for label, some in LABEL_WORDS.items() if label and words.intersection(some)]
    if not meant or set(meant) == {Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM}:
        return None
    return meant[0]


def labels_by_number(numbers: Mapping[str, int]) -> dict[str, Label]:
    """Labels by their number in the file, as text, from names as in ``{"lv": 3, "rv_endo": 4}``.

    An error if a name means no label, or a number is given to two.
    """
    labels: dict[str, Label] = {}
    for name, number in numbers.items():
        if (label := label_of(name)) is None:
            raise InputError(
                f"--labels: unknown '{printable(name[:60])}'; the parts are base, epicardium, lv, "
                "rv, mitral, aortic, tricuspid, pulmonary"
            )
        if labels.setdefault(str(number), label) != label:
            raise InputError(
                f"--labels: label number {number} is given two meanings; give each number one"
            )
    return labels


def whole_numbers(source: str, values: NDArray[Any]) -> Integers:
    """Values of an array of labels, shape (k,); an error unless they are one whole number each."""
    numbers = np.asarray(values)
    if (
        numbers.ndim != 1
        or not np.issubdtype(numbers.dtype, np.number)
        or not (np.isfinite(numbers) & (numbers == np.round(numbers))).all()
    ):
        raise InputError(
            f"{source} must hold one whole number each, the label; correct or rename it, or name "
            "another (--label-array)"
        )
    return numbers.astype(np.int64)


def labels_of(source: str, numbers: Integers, names: Names, groups: Mapping[int, str]) -> Integers:
    """Label (k,) of each number (k,) in a file: by the caller, by its group's name, or as it is.

    `source` is file and array, for an error. The caller's own `names` and numbers come first, and
    no other number stands for a label that they name. `groups` are names of physical groups by
    number.
    """
    free = [label for label in Label if label not in names.values()]  # known by their own number

    def meaning(number: int) -> Label | None:
        group = groups.get(number)
        for key in (group, str(number)):
            if key is not None and key in names:
                return names[key]
        if group is None:
            return Label(number) if number in free else None
        if (label := label_of(group)) is None:
            raise InputError(
                f"{source}: cannot tell which surface '{printable(group[:60])}' is; name it epi, "
                "base, lv_endo or rv_endo (or mitral, aortic, tricuspid, pulmonary), or say what "
                f"its number is, as in --labels epicardium={number}"
            )
        return label

    kinds, which, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    labels = [meaning(kind) for kind in kinds.tolist()]
    strange = [
        f"{kind} ({count} times)"
        for kind, count, label in zip(kinds, counts, labels, strict=True)
        if label is None
    ]
    if strange:
        by_name = [f"{name} {label.name.lower()}" for name, label in names.items()]
        by_value = [f"{label.value} {label.name.lower()}" for label in free]
        raise InputError(
            f"{source}: unknown labels: {', '.join(strange)}; known are "
            f"{', '.join(by_name + by_value)}; say which number is what, as in "
            "--labels base=1,epicardium=2,lv=3,rv=4"
        )
    return np.array(labels, dtype=np.int64)[which]
