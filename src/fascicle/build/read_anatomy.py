"""Reading the files that a heart is built from as one labelled mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from fascicle.build.borders import cut_along_borders
from fascicle.build.classify import classify_surface
from fascicle.build.join import JoinedPart, join_surfaces, label_map_beside_lv
from fascicle.build.labelled_files import (
    Anatomy,
    FibreChoice,
    has_labels,
    labelled_surface,
    labelled_tetrahedra,
    with_arrays,
)
from fascicle.build.mesh_repair import (
    count_pieces,
    joined_pieces,
    repaired_edges,
    repaired_mesh,
    separated_vertices,
    with_common_vertices,
)
from fascicle.build.meshing import (
    carried_over,
    check_memory,
    mesh_surface,
    remeshed_anatomy,
    subdivided,
)
from fascicle.build.segmentation import (
    Segmentation,
    SegmentationLabels,
    part_of_segment,
    regions_at,
)
from fascicle.build.segmentation_files import read_segmentation
from fascicle.build.segmentation_surface import surface_from_segmentation
from fascicle.build.surface_checks import Volumes, check_sides, compared, mirror_warning, volumes
from fascicle.build.surface_repair import closed_surface, prepared_surface
from fascicle.build.whole_heart import Regions, labels_of_ventricles, regions_in, ventricles
from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.labelled_surface import Label, LabelledMesh, LabelledSurface, labels_by_number
from fascicle.mesh.checks import check_units, check_volumes
from fascicle.mesh.measures import closed_volume, mean_edge_length
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.read import MESH_FORMATS, read_mesh
from fascicle.mesh.topology import boundary_triangles, without_unused_vertices


@dataclass(frozen=True)
class Source:
    """Files that a heart is built from, and how to read them."""

    # options for tetrahedra alone
    of_tetrahedra: ClassVar = ("remesh", "regions", "region_array", "fibres")

    file: Path | None  # closed surface, segmentation or tetrahedral mesh; None if there are parts
    # surfaces of ``lv``, ``rv``, ``epicardium`` and perhaps ``base``
    parts: Mapping[str, Path] = field(default_factory=dict)
    labels: Mapping[str, int] | None = None  # number of each label in the file
    label_array: str | None = None
    remesh: bool | None = None  # the inside of a tetrahedral mesh
    regions: Regions | None = None  # region numbers of a whole heart; `region_array` is their array
    region_array: str | None = None
    fibres: FibreChoice = None  # fibres of a tetrahedral mesh

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

    def check_unused(self, anatomy: str, *names: str) -> None:
        """Refuse options, named by attribute, that do not apply to this kind of anatomy."""
        for name in names:
            if getattr(self, name) is not None:
                option = "--" + name.replace("_", "-")
                raise InputError(f"{option} does not apply to {anatomy}; leave it out")

    @property
    def name(self) -> str:
        """Name of the file without its suffixes."""
        path = self.file if self.file is not None else self.parts["epicardium"].resolve().parent
        return path.name.split(".")[0] or "heart"


def read_anatomy(source: Source, edge_length: float, progress: Progress | None = None) -> Anatomy:
    """Read the files; surfaces and segmentations are meshed with this edge length (mm)."""
    if source.file is None:
        source.check_unused("separate surfaces", "labels", "label_array", *source.of_tetrahedra)
        meshes = {part: read_mesh(path, part) for part, path in source.parts.items()}
        parts = {
            part: JoinedPart(str(mesh.path), mesh.points, mesh.require(TRIANGLE, "triangles"))
            for part, mesh in meshes.items()
        }
        if (label_map := label_map_beside_lv(parts)) is not None:
            return _from_segmentation(source, label_map, edge_length, progress)
        joined = join_surfaces(parts)
        return _meshed(*_fine_enough(joined, edge_length), joined, edge_length, progress)
    segmentations = (".nii", ".nii.gz", ".nrrd", ".nhdr")
    if source.file.name.lower().endswith(segmentations):
        return _from_segmentation(source, read_segmentation(source.file), edge_length, progress)
    check_file(source.file, MESH_FORMATS + segmentations, "anatomy")
    mesh = read_mesh(source.file, "anatomy")
    if TETRAHEDRON in mesh.cells:
        return _from_tetrahedra(source, mesh, edge_length, progress)
    return _from_surface(source, mesh, edge_length, progress)


def _meshed(
    surface: LabelledSurface,
    notes: tuple[str, ...],
    reference: LabelledSurface | Volumes,
    edge_length: float,
    progress: Progress | None,
) -> Anatomy:
    """Mesh a surface, and compare the volumes with those of the reference."""
    prepared = prepared_surface(surface)
    mesh = mesh_surface(prepared, edge_length, stage_progress(progress, "meshing"))
    before = reference if isinstance(reference, Volumes) else volumes(closed_surface(reference))
    note, warnings = compared(volumes(mesh), before, surface.name)
    return Anatomy(mesh, notes=(*notes, *prepared.notes, note), warnings=warnings)


def _fine_enough(
    surface: LabelledSurface, edge_length: float
) -> tuple[LabelledSurface, tuple[str, ...]]:
    """Subdivide a surface if its mean edge is above three edge lengths; with a note if so.

    Remeshing follows flat triangles, so the mesh would have the edges and creases of coarse ones.
    """
    if mean_edge_length(surface.vertices, surface.triangles) <= 3.0 * edge_length:
        return surface, ()
    check_memory(surface, edge_length)
    finer, note = subdivided(surface, edge_length)
    return finer, (note,)


def _from_surface(
    source: Source, mesh: MeshFile, edge_length: float, progress: Progress | None
) -> Anatomy:
    source.check_unused("a surface, which is meshed again anyway", *source.of_tetrahedra)
    if has_labels(mesh, source.label_array) or source.labels is not None:
        labelled = labelled_surface(mesh, source.label_array, source.labels)
        return _meshed(*_fine_enough(labelled, edge_length), labelled, edge_length, progress)
    triangles = mesh.require(TRIANGLE, "triangles")
    unlabelled = np.zeros(len(triangles), dtype=np.int64)
    closed = closed_surface(LabelledSurface(mesh.points, triangles, unlabelled, str(mesh.path)))
    return _classified_surface(closed, edge_length, progress)


def _classified_surface(
    closed: LabelledSurface, edge_length: float, progress: Progress | None
) -> Anatomy:
    """Mesh a closed surface whose labels are found from its shape."""
    volume = closed_volume(closed.vertices, closed.triangles) / 1e3
    repairs = closed.notes
    closed, notes = _fine_enough(closed, edge_length)
    report = stage_progress(progress, "surface")
    classified = classify_surface(closed.vertices, closed.triangles, closed.name, report)
    cut = cut_along_borders(classified, edge_length)
    reference = volumes(cut)._replace(myocardium=volume)
    return replace(
        _meshed(cut, (*repairs, *notes, *classified.notes), reference, edge_length, progress),
        guessed=True,
    )


def _from_segmentation(
    source: Source, segmentation: Segmentation, edge_length: float, progress: Progress | None
) -> Anatomy:
    source.check_unused("a segmentation", "label_array", *source.of_tetrahedra)
    labels, notes = _segmentation_labels(segmentation, source.labels)
    if segmentation.space:
        notes.append(
            f"coordinates: {segmentation.space}, as in the file; --pose "
            f"{segmentation.space.lower()} aligns the torso with them"
        )
    report = stage_progress(progress, "surface")
    surface, reference = surface_from_segmentation(segmentation, labels, report, notes, edge_length)
    anatomy = _meshed(surface, tuple(notes), reference, edge_length, progress)
    mirrored = mirror_warning(anatomy.mesh, segmentation.space)
    anatomy = replace(anatomy, warnings=(*anatomy.warnings, *mirrored))
    if labels.scar is None:
        return anatomy
    scar = "region_1_conductivity"  # the quantity of its conductivity
    note = f"scar: region 1; it does not conduct ({scar} = 0 in heart.toml)"
    mesh = anatomy.mesh
    centres = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    mesh = replace(mesh, regions=regions_at(segmentation, labels, centres))
    return replace(anatomy, mesh=mesh, notes=(*anatomy.notes, note), values={scar: 0.0})


def _segmentation_labels(
    segmentation: Segmentation, numbers: Mapping[str, int] | None
) -> tuple[SegmentationLabels, list[str]]:
    """Numbers of the parts, by the names of the file's segments if none are given; with notes."""
    if numbers is not None:
        parts = [part.name for part in fields(SegmentationLabels)]
        if unknown := [name for name in numbers if name not in parts]:
            raise InputError(f"--labels: unknown '{unknown[0]}'; the parts are {', '.join(parts)}")
        return SegmentationLabels(**numbers), []
    named = {n: segmentation.segments.get(n, "") for n in np.unique(segmentation.labels).tolist()}
    part_of = {n: part_of_segment(name) for n, name in named.items()}
    by_part = {p: tuple(n for n in named if part_of[n] == p) for p in part_of.values() if p}
    if not {"lv", "rv", "myocardium"} <= by_part.keys():
        listed = ", ".join(f"{number} {name}".strip() for number, name in named.items())
        raise InputError(
            f"{segmentation.name}: the meaning of its labels ({listed}) depends on the program "
            "that wrote them; give it, as --labels lv=1,rv=2,myocardium=3,scar=4"
        )
    said = "; ".join(f"{part} {n} {named[n]}" for part in by_part for n in by_part[part])
    return SegmentationLabels(**by_part), [f"labels, by the names of segments: {said}"]


def _from_tetrahedra(
    source: Source, mesh: MeshFile, edge_length: float, progress: Progress | None
) -> Anatomy:
    names = labels_by_number(source.labels if source.labels is not None else {})
    original, cut, notes = mesh, None, list(mesh.notes)
    if source.regions is not None:
        mesh, cut = ventricles(mesh, source.regions, source.region_array)
        share = len(mesh.cells[TETRAHEDRON]) / len(original.cells[TETRAHEDRON])
        notes.append(f"regions: the ventricles are {share:.0%} of the file's tetrahedra")
    mesh, repairs = repaired_mesh(mesh)
    mesh, merged = with_common_vertices(mesh)
    repairs += merged
    if count_pieces(mesh) > 1:
        read = _from_pieces(source, mesh, edge_length, progress)
        return replace(read, notes=(*notes, *repairs, *read.notes))
    if cut is None and len(mesh.cells[TETRAHEDRON]) != len(original.cells[TETRAHEDRON]):
        cut = np.empty((0, 3), dtype=np.int64)
    read = labelled_tetrahedra(mesh, source.label_array, names, cut=cut, fibres=source.fibres)
    read = replace(read, notes=(*notes, *repairs, *read.notes))
    read = repaired_edges(read)
    if not (read.mesh.labels > Label.BASE).any():
        source.check_unused(f"{mesh.path}, which has no labels (--label-array names one)", "labels")
        read = _classified(read, source, original, progress)
    read = separated_vertices(read)
    check_sides(read.mesh)
    return remeshed_anatomy(read) if source.remesh else read


def _from_pieces(
    source: Source, mesh: MeshFile, edge_length: float, progress: Progress | None
) -> Anatomy:
    """Mesh pieces that touch without common vertices as one."""
    source.check_unused("pieces that are joined", "labels", "label_array", "remesh")
    vertices, tetrahedra = without_unused_vertices(mesh.points, mesh.cells[TETRAHEDRON])
    check_units(str(mesh.path), vertices)
    check_volumes(str(mesh.path), vertices, tetrahedra)
    triangles, _ = boundary_triangles(tetrahedra)
    unlabelled = np.zeros(len(triangles), dtype=np.int64)
    pieces = LabelledMesh(vertices, tetrahedra, triangles, unlabelled, name=str(mesh.path))
    read = with_arrays(Anatomy(pieces), mesh, source.fibres)
    remeshed = _classified_surface(joined_pieces(pieces), edge_length, progress)
    joined = carried_over(read, remeshed.mesh)
    return replace(
        joined, notes=(*remeshed.notes, *read.notes), warnings=remeshed.warnings, guessed=True
    )


def _classified(
    read: Anatomy, source: Source, original: MeshFile, progress: Progress | None
) -> Anatomy:
    """Find the labels of an anatomy from its regions, or else from its shape."""
    mesh = read.mesh
    if source.regions is not None and mesh.regions is not None:
        labels = labels_of_ventricles(mesh, np.isin(mesh.regions, source.regions["lv"]))
        if labels is not None:
            return replace(read, mesh=replace(mesh, labels=labels), guessed=True)
    report = stage_progress(progress, "surface")
    try:
        classified = classify_surface(mesh.vertices, mesh.triangles, mesh.name, report)
    except InputError as error:
        region_list = regions_in(original)
        if source.regions is not None or not region_list:
            raise
        raise InputError(
            f"{error}; {region_list}; if this is a whole heart, say which are the ventricles, as "
            "--regions lv=...,rv=...,septum=..."
        ) from None
    notes = (*read.notes, *classified.notes)
    return replace(read, mesh=replace(mesh, labels=classified.labels), notes=notes, guessed=True)
