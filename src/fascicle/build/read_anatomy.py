"""Reading the files of an anatomy, of several kinds, as one labelled mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from fascicle.build.anatomy import Anatomy, Source
from fascicle.build.classification.borders import cut_along_borders
from fascicle.build.classification.classify import classify_surface
from fascicle.build.joining.join import join_surfaces
from fascicle.build.labelled_mesh_files import labelled_tetrahedra
from fascicle.build.labelled_surface_files import has_labels, labelled_surface
from fascicle.build.mesh_remeshing import remeshed_anatomy
from fascicle.build.mesh_repair import repaired_edges
from fascicle.build.segmentation.files import read_segmentation
from fascicle.build.segmentation.image import Segmentation, SegmentationLabels, regions_at
from fascicle.build.segmentation.surface import surface_from_segmentation
from fascicle.build.sides import check_labelled_sides
from fascicle.build.subdivision import is_coarse, subdivided
from fascicle.build.surface_repair import closed_surface, prepared_surface
from fascicle.build.volume_meshing import check_memory, mesh_surface
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.label_names import labels_by_number
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.formats.read import MESH_FORMATS, read_mesh

SCAR = "region_1_conductivity"  # quantity that says how the scar of a segmentation conducts
SEGMENTATIONS = (".nii", ".nii.gz", ".nrrd", ".nhdr")


def read_anatomy(source: Source, edge_length: float, progress: Progress | None = None) -> Anatomy:
    """Read the files and mesh what is not a mesh yet.

    Parameters
    ----------
    source : Source
        The files.
    edge_length : float
        Of the tetrahedra (mm); a mesh of the user's own stays as it is.
    progress : Progress, optional
        Progress callback.

    Raises
    ------
    InputError
        If a file cannot be used; the message says why.
    """
    if source.file is None:
        source.check_unused("separate surfaces", "numbers", "array", "labels_file", "remesh")
        joined, notes = _fine_enough(_joined(source, progress), edge_length)
        return Anatomy(_meshed(joined, edge_length, progress), notes=notes)
    if source.file.name.lower().endswith(SEGMENTATIONS):
        source.check_unused("a segmentation", "array", "labels_file", "remesh")
        return _from_segmentation(source, source.file, edge_length, progress)
    check_file(source.file, MESH_FORMATS + SEGMENTATIONS, "anatomy")
    mesh = read_mesh(source.file, "anatomy")
    if TETRAHEDRON in mesh.cells:
        return _from_tetrahedra(source, mesh, progress)
    return _from_surface(source, mesh, edge_length, progress)


def _joined(source: Source, progress: Progress | None) -> LabelledSurface:
    parts = {part: _triangles(read_mesh(path, part)) for part, path in source.parts.items()}
    return join_surfaces(
        parts["lv"],
        parts["rv"],
        parts["epicardium"],
        parts.get("base"),
        str(source.parts["epicardium"]),
        stage_progress(progress, "surface"),
    )


def _triangles(mesh: MeshFile) -> tuple[Floats, Integers]:
    return mesh.points, mesh.require(TRIANGLE, "triangles")


def _from_surface(
    source: Source, mesh: MeshFile, edge_length: float, progress: Progress | None
) -> Anatomy:
    source.check_unused("a surface, which is meshed again anyway", "remesh")
    if has_labels(mesh, source.array, source.labels_file) or source.numbers is not None:
        surface, notes = _fine_enough(
            labelled_surface(mesh, source.array, source.numbers, source.labels_file), edge_length
        )
        return Anatomy(_meshed(surface, edge_length, progress), notes=notes)
    points, triangles = _triangles(mesh)
    unlabelled = np.zeros(len(triangles), dtype=np.int64)
    closed, notes = _fine_enough(
        closed_surface(LabelledSurface(points, triangles, unlabelled, str(mesh.path))), edge_length
    )
    surface = classify_surface(
        closed.vertices, closed.triangles, closed.name, stage_progress(progress, "surface")
    )
    surface = cut_along_borders(surface, edge_length)
    return Anatomy(_meshed(surface, edge_length, progress), notes=notes, guessed=True)


def _fine_enough(
    surface: LabelledSurface, edge_length: float
) -> tuple[LabelledSurface, tuple[str, ...]]:
    """The surface, subdivided where it is coarse against the edge length, and a note if so."""
    if not is_coarse(surface, edge_length):
        return surface, ()
    check_memory(surface, edge_length)
    finer, note = subdivided(surface, edge_length)
    return finer, (note,)


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
        segmentation, labels, stage_progress(progress, "surface"), notes
    )
    mesh = _meshed(surface, edge_length, progress)
    values = {}
    if labels.scar is not None:
        centres = mesh.vertices[mesh.tetrahedra].mean(axis=1)
        mesh = replace(mesh, regions=regions_at(segmentation, labels, centres))
        values[SCAR] = 0.0
        notes.append(f"scar: region 1; it does not conduct ({SCAR} = 0 in heart.toml)")
    return Anatomy(mesh, notes=tuple(notes), values=values)


def _segmentation_labels(
    segmentation: Segmentation, numbers: Mapping[str, int] | None
) -> SegmentationLabels:
    if numbers is None:
        there = ", ".join(map(str, np.unique(segmentation.labels)))
        raise InputError(
            f"{segmentation.name}: which of its labels ({there}) is what differs from one program "
            "to another; say so, as --labels lv=1,rv=2,myocardium=3,scar=4"
        )
    known = [part.name for part in fields(SegmentationLabels)]
    unknown = [name for name in numbers if name not in known]
    if unknown:
        raise InputError(f"--labels: unknown '{unknown[0]}'; the parts are {', '.join(known)}")
    return SegmentationLabels(**numbers)


def _from_tetrahedra(source: Source, mesh: MeshFile, progress: Progress | None) -> Anatomy:
    source.check_unused("tetrahedra", "labels_file")
    names = labels_by_number(source.numbers if source.numbers is not None else {})
    read = repaired_edges(labelled_tetrahedra(mesh, source.array, names))
    if not read.mesh.labels.any():
        unlabelled = f"{mesh.path}, which has no labels (--label-array names one)"
        source.check_unused(unlabelled, "numbers")
        found = classify_surface(
            read.mesh.vertices,
            read.mesh.triangles,
            str(mesh.path),
            stage_progress(progress, "surface"),
        )
        read = replace(read, mesh=replace(read.mesh, labels=found.labels), guessed=True)
    check_labelled_sides(read.mesh)
    return remeshed_anatomy(read) if source.remesh else read
