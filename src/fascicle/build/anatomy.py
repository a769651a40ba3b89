"""The files that a heart is built from, and the labelled mesh that they become."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh


@dataclass(frozen=True)
class Source:
    """The files that a heart is built from.

    Attributes
    ----------
    file : Path or None
        A closed surface, a segmentation or a tetrahedral mesh; None if there are parts.
    parts : mapping of str to Path
        Surfaces of ``lv``, ``rv``, ``epicardium`` and perhaps ``base``.
    labels, label_array, labels_file : optional
        Which number in the file stands for what, the array of labels, or a file of them.
    remesh : bool, optional
        Whether to mesh the inside of a tetrahedral mesh again.
    """

    file: Path | None
    parts: Mapping[str, Path] = field(default_factory=dict)
    labels: Mapping[str, int] | None = None
    label_array: str | None = None
    labels_file: Path | None = None
    remesh: bool | None = None

    def __post_init__(self) -> None:
        if (self.file is None) == (not self.parts):
            raise InputError(
                "give either one file (surface, segmentation or mesh) or separate surfaces "
                "(--lv-endocardium, --rv-endocardium, --epicardium)"
            )
        missing = [part for part in ("lv", "rv", "epicardium") if part not in self.parts]
        if self.parts and missing:
            raise InputError(
                f"separate surfaces: {', '.join(missing)} missing; give all of "
                "--lv-endocardium, --rv-endocardium and --epicardium"
            )

    def check_unused(self, what: str, *names: str) -> None:
        """Refuse options, by the names of attributes, that would do nothing for an anatomy."""
        for name in names:
            if getattr(self, name) is not None:
                option = "--" + name.replace("_", "-")
                raise InputError(f"{option} says nothing about {what}; leave it out")

    @property
    def name(self) -> str:
        """What to call it: the file without its endings."""
        path = self.file if self.file is not None else self.parts["epicardium"].resolve().parent
        return path.name.split(".")[0] or "heart"


@dataclass(frozen=True)
class Anatomy:
    """A labelled mesh, and what else its files say."""

    mesh: LabelledMesh  # labels are 0 as long as they are not known
    fibres: Floats | None = None  # unit directions (m, 3), where the source has them
    sheets: Floats | None = None
    notes: tuple[str, ...] = ()  # what was decided on the way, for people
    guessed: bool = False  # labels from the shape, which should be looked at
    own_mesh: bool = False  # tetrahedra of the source
    values: Mapping[str, float] = field(default_factory=dict)  # the patient's, of quantities
