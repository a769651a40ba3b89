"""What a heart is built from: files of several kinds, brought to one labelled mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.build.classification.classify import classify_surface
from fascicle.build.joining.join import join_surfaces
from fascicle.build.labelled_mesh_files import read_labelled_mesh
from fascicle.build.meshing import mesh_surface
from fascicle.build.repair import prepared_surface
from fascicle.build.segmentation.files import read_segmentation
from fascicle.build.segmentation.image import Segmentation, SegmentationLabels, regions_at
from fascicle.build.segmentation.surface import surface_from_segmentation
from fascicle.build.surface_files import has_labels, labelled_surface
from fascicle.build.wall import check_not_swapped
from fascicle.core.errors import InputError
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.label_names import labels_by_number
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.formats.read import read_mesh

PARTS = ("lv", "rv", "epicardium", "base")  # of which the last may be missing
OPTIONS = {"numbers": "--labels", "array": "--label-array", "labels_file": "--labels-file"}
SEGMENTATIONS = (".nii", ".nii.gz", ".nrrd", ".nhdr")
VOLUMES = (".vtk", ".vtu", ".msh", ".pts", ".elem")  # may hold tetrahedra


@dataclass(frozen=True)
class Source:
    """The files that a heart is built from.

    Attributes
    ----------
    file : Path or None
        A closed surface, a segmentation or a tetrahedral mesh; None if there are parts.
    parts : mapping of str to Path
        Surfaces of ``lv``, ``rv``, ``epicardium`` and perhaps ``base``.
    numbers : mapping of str to int, optional
        Which number in the file stands for what.
    array : str, optional
        The array of labels.
    labels_file : Path, optional
        Labels of a surface whose file holds none.
    """

    file: Path | None
    parts: Mapping[str, Path] = field(default_factory=dict)
    numbers: Mapping[str, int] | None = None
    array: str | None = None
    labels_file: Path | None = None

    def __post_init__(self) -> None:
        if (self.file is None) == (not self.parts):
            raise InputError(
                "give either one file (surface, segmentation or mesh) or separate surfaces "
                "(--lv-endocardium, --rv-endocardium, --epicardium)"
            )
        missing = [part for part in PARTS[:3] if self.parts and part not in self.parts]
        if missing:
            raise InputError(
                f"separate surfaces: {', '.join(missing)} missing; give all of --lv-endocardium, "
                "--rv-endocardium and --epicardium"
            )

    @property
    def name(self) -> str:
        """What to call it: the file without its endings."""
        path = self.file if self.file is not None else self.parts["epicardium"].resolve().parent
        return path.name.split(".")[0] or "heart"


@dataclass(frozen=True)
class Anatomy:
    """A labelled mesh, and what else its source tells.

    Attributes
    ----------
    mesh : LabelledMesh
        Tetrahedra and their labelled boundary.
    fibres, sheets : (m, 3) array, optional
        Unit directions, where the source has them.
    notes : tuple of str
        What was decided on the way, for people.
    guessed : bool
        Whether the labels were found from the shape, and somebody should look at them.
    own_mesh : bool
        Whether the tetrahedra are the source's own.
    """

    mesh: LabelledMesh
    fibres: NDArray[np.float64] | None = None
    sheets: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    guessed: bool = False
    own_mesh: bool = False


def read_anatomy(source: Source, edge_length: float, progress: Progress | None = None) -> Anatomy:
    """Read the files and mesh what is not a mesh yet.

    Parameters
    ----------
    source : Source
        The files.
    edge_length : float
        Of the tetrahedra (mm); a mesh of the user's own stays as it is.
    progress : Progress, optional
        Told how far it is.

    Raises
    ------
    InputError
        If a file cannot be used; the message says why.
    """
    if source.file is None:
        _check_unused(source, "separate surfaces", "numbers", "array", "labels_file")
        return Anatomy(_meshed(_joined(source, progress), edge_length, progress))
    suffix = source.file.name.lower()
    if suffix.endswith(SEGMENTATIONS):
        _check_unused(source, "a segmentation", "array", "labels_file")
        return _from_segmentation(source, source.file, edge_length, progress)
    mesh = read_mesh(source.file, "anatomy" if suffix.endswith(VOLUMES) else "surface")
    if TETRAHEDRON in mesh.cells:
        return _from_tetrahedra(source, source.file, progress)
    return _from_surface(source, mesh, edge_length, progress)


def _check_unused(source: Source, what: str, *names: str) -> None:
    """Refuse options that would do nothing."""
    for name in names:
        if getattr(source, name) is not None:
            raise InputError(f"{OPTIONS[name]} says nothing about {what}; leave it out")


def _joined(source: Source, progress: Progress | None) -> LabelledSurface:
    read = {part: _triangles(read_mesh(path, part)) for part, path in source.parts.items()}
    name = str(source.parts["epicardium"])
    told = stage_progress(progress, "surface")
    return join_surfaces(read["lv"], read["rv"], read["epicardium"], read.get("base"), name, told)


def _triangles(mesh: MeshFile) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    return mesh.points, mesh.require(TRIANGLE, "triangles")


def _from_surface(
    source: Source, mesh: MeshFile, edge_length: float, progress: Progress | None
) -> Anatomy:
    if has_labels(mesh, source.array, source.labels_file) or source.numbers is not None:
        surface = labelled_surface(mesh, source.array, source.numbers, source.labels_file)
        return Anatomy(_meshed(surface, edge_length, progress))
    told = stage_progress(progress, "surface")
    surface = classify_surface(*_triangles(mesh), str(mesh.path), told)
    return Anatomy(_meshed(surface, edge_length, progress), guessed=True)


def _meshed(
    surface: LabelledSurface, edge_length: float, progress: Progress | None
) -> LabelledMesh:
    return mesh_surface(prepared_surface(surface), edge_length, stage_progress(progress, "meshing"))


def _from_segmentation(
    source: Source, file: Path, edge_length: float, progress: Progress | None
) -> Anatomy:
    notes: list[str] = []
    segmentation = read_segmentation(file)
    labels = _segmentation_labels(segmentation, source.numbers)
    if segmentation.space:
        notes.append(
            f"coordinates: {segmentation.space}, as in the file; --pose "
            f"{segmentation.space.lower()} lays the torso along them"
        )
    surface = surface_from_segmentation(
        segmentation, labels, stage_progress(progress, "surface"), notes.append
    )
    mesh = _meshed(surface, edge_length, progress)
    if labels.scar is not None:
        centres = mesh.vertices[mesh.tetrahedra].mean(axis=1)
        mesh = replace(mesh, regions=regions_at(segmentation, labels, centres))
        notes.append("scar: region 1; it conducts as the rest unless a scenario says otherwise")
    return Anatomy(mesh, notes=tuple(notes))


def _segmentation_labels(
    segmentation: Segmentation, numbers: Mapping[str, int] | None
) -> SegmentationLabels:
    if numbers is None:
        there = ", ".join(map(str, np.unique(segmentation.labels)))
        raise InputError(
            f"{segmentation.name}: which of its labels ({there}) is what differs from one program "
            "to another; say so, as --labels lv=1,rv=2,myocardium=3,scar=4"
        )
    known = [field.name for field in fields(SegmentationLabels)]
    unknown = [name for name in numbers if name not in known]
    if unknown:
        raise InputError(f"--labels: unknown '{unknown[0]}'; the parts are {', '.join(known)}")
    return SegmentationLabels(**numbers)


def _from_tetrahedra(source: Source, file: Path, progress: Progress | None) -> Anatomy:
    _check_unused(source, "tetrahedra", "labels_file")
    names = None if source.numbers is None else labels_by_number(source.numbers)
    read = read_labelled_mesh(file, array=source.array, names=names)
    labels = read.labels
    if labels is None:
        _check_unused(source, f"{file}, which has no labels (--label-array names one)", "numbers")
        vertices, triangles, _ = read.boundary_surface()
        told = stage_progress(progress, "surface")
        labels = classify_surface(vertices, triangles, str(file), told).labels
    mesh = read.labelled(labels)
    check_not_swapped(mesh)
    return Anatomy(
        mesh, read.fibres, read.sheets, read.notes, guessed=read.labels is None, own_mesh=True
    )
