"""Label maps of the heart, whose voxels are blood of a ventricle, muscle or scar."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, center_of_mass, find_objects, label
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import ENDOCARDIA, label_of
from fascicle.mesh.checks import check_units, place


@dataclass(frozen=True)
class Segmentation:
    """Label map (i, j, k), in which 0 is background, with its position.

    The affine (4, 4) maps indices of voxel centres to mm in the file's coordinates. The space is
    empty if the axes are not the patient's. The name is used in messages. Segments are the names
    of numbers, if the file has any.
    """

    labels: NDArray[np.integer[Any]]
    affine: Floats
    name: str = "segmentation"
    space: str = ""  # "RAS" or "LPS"
    segments: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        spacing, axes = self.spacing, self.affine[:3, :3]
        if not (np.isfinite(self.affine).all() and np.isfinite(spacing).all() and spacing.all()):
            listed = ", ".join(f"{length:.3g}" for length in spacing)
            raise InputError(
                f"{self.name}: the voxels have no size (spacing {listed} mm) or no place; write "
                "the voxel spacing and origin, in mm, into the file"
            )
        unit = axes / spacing
        shear = float(np.abs(unit.T @ unit - np.eye(3)).max())
        if shear > 0.01:  # more than rounding in the file
            raise InputError(
                f"{self.name}: the voxel axes are not at right angles (cosine {shear:.3f}); "
                "resample the map onto a rectangular grid"
            )

    @property
    def spacing(self) -> Floats:
        """Distance of neighbouring voxel centres along each index (mm)."""
        with np.errstate(over="ignore", invalid="ignore"):  # a file's affine may not be finite
            return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel (mm³)."""
        return float(np.prod(self.spacing))


@dataclass(frozen=True)
class SegmentationLabels:
    """Numbers of the parts in a label map.

    A part with several numbers (such as separate walls of the ventricles) has a tuple of them.
    Other conventions: ACDC has 3 for LV blood, 1 for RV blood and 2 for LV myocardium; UK Biobank
    (Bai et al., J Cardiovasc Magn Reson 20:65, 2018) 1, 3 and 2; MM-WHS (Zhuang and Shen, Med Image
    Anal 31:77–87, 2016) 500, 600 and 205. None of them has an RV wall.
    """

    lv: int | tuple[int, ...] = 1  # blood
    rv: int | tuple[int, ...] = 2
    myocardium: int | tuple[int, ...] = 3  # without the scar
    scar: int | tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        numbers = [number for _, part in self.parts() for number in part]
        if len(set(numbers)) < len(numbers) or 0 in numbers:
            raise InputError(
                f"segmentation labels: lv {self.lv}, rv {self.rv}, myocardium {self.myocardium}, "
                f"scar {self.scar}; give lv, rv and myocardium numbers of their own, other than 0 "
                "(background), in one map: add up masks of one structure each, times 1, 2 and 3"
            )

    def parts(self) -> list[tuple[str, tuple[int, ...]]]:
        """Name and numbers of each part."""
        names = ("LV blood", "RV blood", "myocardium", "scar")
        parts = zip(names, (self.lv, self.rv, self.myocardium, self.scar), strict=True)
        return [(n, p if isinstance(p, tuple) else (p,)) for n, p in parts if p is not None]


def part_of_segment(name: str) -> str | None:
    """Part of `SegmentationLabels` that the name of a segment means, such as "LV blood pool"."""
    name = name.lower().replace("_", " ")
    if re.search(r"scar|infarct|fibrosis", name):
        return "scar"
    if re.search(r"myo|wall|muscle", name):
        return None if re.search(r"atri|aort|papillary|\b[lr]a\b", name) else "myocardium"
    label = label_of(re.sub(r"blood|pool", "", name))
    return label.name[:2].lower() if label in ENDOCARDIA else None


@dataclass(frozen=True)
class Masks:
    """Masks of each ventricle's blood, and of muscle with scar, on a grid that just holds them.

    No voxel at the edge is in any of them; the affine maps voxel indices to mm.
    """

    lv: Booleans
    rv: Booleans
    tissue: Booleans
    affine: Floats
    name: str

    def positions(self, mask: Booleans) -> Floats:
        """Centres of the voxels of a mask (mm), shape (n, 3)."""
        return np.argwhere(mask) @ self.affine[:3, :3].T + self.affine[:3, 3]

    def thickness(self, normal: Floats) -> float:
        """Extent of a voxel along a unit vector (mm)."""
        return float(np.abs(normal @ self.affine[:3, :3]).sum())


class Faces(NamedTuple):
    """Faces between voxels of a ventricle's blood and voxels that are not.

    Centres (n, 3) (mm) of the voxels of blood and of the faces; normals (n, 3) out of the blood,
    with the face's area (mm²) as length; whether the face is free (n,), with neither tissue nor the
    other ventricle's blood on the other side; and whether it is shared with that blood (n,).
    """

    voxels: Floats
    centres: Floats
    areas: Floats
    free: Booleans
    shared: Booleans


def blood_faces(masks: Masks, blood: Booleans, other: Booleans) -> Faces:
    """Faces of one ventricle's blood; `other` is the blood of the other ventricle."""
    axes = masks.affine[:3, :3]
    groups = []
    for k in range(3):
        across = np.cross(axes[:, (k + 1) % 3], axes[:, (k + 2) % 3])
        across *= np.sign(across @ axes[:, k])
        for step in (-1, 1):
            index = np.argwhere(blood & ~np.roll(blood, -step, axis=k))
            neighbour = index + step * np.eye(3, dtype=np.int64)[k]
            beyond = tuple(neighbour.T)
            voxels = index @ axes.T + masks.affine[:3, 3]
            centres = (index + neighbour) / 2 @ axes.T + masks.affine[:3, 3]
            areas = np.tile(step * across, (len(index), 1))
            free = ~(masks.tissue | other)[beyond]
            groups.append((voxels, centres, areas, free, other[beyond]))
    return Faces(*(np.concatenate(parts) for parts in zip(*groups, strict=True)))


def regions_at(segmentation: Segmentation, labels: SegmentationLabels, points: Floats) -> Integers:
    """Whether points (n, 3) in mm lie in the scar (1) or not (0), by the nearest voxel of tissue.

    The voxel around a point of the tissue's surface may be blood or background. Points farther than
    a voxel's diagonal from all tissue are not scar.
    """
    parts = _parts(segmentation, labels)
    voxels = np.argwhere(parts["myocardium"] | parts["scar"])
    affine = segmentation.affine
    diagonal = float(np.linalg.norm(segmentation.spacing))
    tree = cKDTree(voxels @ affine[:3, :3].T + affine[:3, 3])
    _, nearest = tree.query(points, distance_upper_bound=diagonal)
    of_voxels = np.append(parts["scar"][tuple(voxels.T)], False)  # the last: no voxel is near
    return np.asarray(of_voxels[nearest], dtype=np.int64)


def masks_of(segmentation: Segmentation, labels: SegmentationLabels, notes: list[str]) -> Masks:
    """Masks of the parts, in one piece each; small components join the parts around them.

    A line is added to the notes for every part that had small components. Maps in which the LV
    blood is not mostly surrounded by tissue are refused.
    """
    name = segmentation.name
    parts = np.zeros(segmentation.labels.shape, dtype=np.int8)
    kinds = {"LV blood": 1, "RV blood": 2, "myocardium": 3, "scar": 3}
    for part, mask in _parts(segmentation, labels).items():
        parts[mask] = kinds[part]
    parts, affine = _cropped(parts, segmentation.affine)
    masks = Masks(parts == 1, parts == 2, parts == 3, affine, name)
    faces = blood_faces(masks, masks.lv, masks.rv)
    size = np.linalg.norm(faces.areas, axis=1)
    if (bare := float(size[faces.free | faces.shared].sum() / size.sum())) > 0.5:
        raise InputError(
            f"{name}: {bare:.0%} of the LV blood's surface borders on no tissue, so the "
            "labels seem to be exchanged; give those of this map (--labels; ACDC has lv=3,rv=1,"
            "myocardium=2, UK Biobank lv=1,rv=3,myocardium=2)"
        )
    for kind, part in ((3, "tissue"), (1, "LV blood"), (2, "RV blood")):
        _remove_small_components(parts, kind, part, affine, name, notes)
    parts, affine = _cropped(parts, affine)
    check_units(name, np.array([[0, 0, 0], parts.shape]) * segmentation.spacing)
    return Masks(parts == 1, parts == 2, parts == 3, affine, name)


def _cropped(parts: NDArray[np.int8], affine: Floats) -> tuple[NDArray[np.int8], Floats]:
    """Crop a map to the parts and one voxel of background around them."""
    box = find_objects((parts > 0).astype(np.int8))[0]
    affine = affine.copy()
    affine[:3, 3] += affine[:3, :3] @ [around.start - 1 for around in box]
    return np.pad(parts[box], 1), affine


def _parts(segmentation: Segmentation, labels: SegmentationLabels) -> dict[str, Booleans]:
    """Masks of the parts, by name; an error if a part has no voxels."""
    masks = {}
    for name, numbers in labels.parts():
        masks[name] = np.isin(segmentation.labels, numbers)
        if not masks[name].any():
            counted = zip(*np.unique(segmentation.labels, return_counts=True), strict=True)
            listed = [f"{value} ({count} voxels)" for value, count in counted]
            more = f" and {len(listed) - 12} more" if len(listed) > 12 else ""
            raise InputError(
                f"{segmentation.name}: {name} (label {', '.join(map(str, numbers))}) has 0 voxels; "
                f"the map has labels {', '.join(listed[:12])}{more}; give the label "
                "of every part (--labels; scar alone may be left out)"
            )
    return masks


def largest_pieces(numbered: Integers, volumes: Floats, affine: Floats) -> str:
    """Volumes (ml) and middles (mm) of the three largest pieces of a grid (i, j, k).

    Nodes of a piece have its number, from 1; pieces of no volume are not counted. The affine (4, 4)
    maps indices of nodes to mm.
    """
    count = np.count_nonzero(volumes)
    largest = np.argsort(-volumes, kind="stable")[: min(count, 3)]
    middles = np.array(center_of_mass(numbered > 0, numbered, largest + 1))
    places = middles @ affine[:3, :3].T + affine[:3, 3]
    listed = [
        f"{volumes[k]:.3g} ml about {place(at)}" for k, at in zip(largest, places, strict=True)
    ]
    return ", ".join([*listed, *(["..."] if count > 3 else [])])


def _remove_small_components(
    parts: NDArray[np.int8], kind: int, part: str, affine: Floats, name: str, notes: list[str]
) -> None:
    """Give components below 1 % of a part to the part around most of them, in place."""
    touching = np.ones((3, 3, 3), dtype=bool)
    pieces, n = label(parts == kind, structure=touching)
    if n == 1:
        return
    sizes = np.bincount(pieces.ravel())[1:]
    largest = int(sizes.argmax())
    ml = sizes * abs(np.linalg.det(affine)) / 1000
    if (large := sizes > 0.01 * sizes.sum()).sum() > 1:
        raise InputError(
            f"{name}: {part} falls into {large.sum()} unconnected pieces "
            f"({largest_pieces(pieces, np.where(large, ml, 0), affine)}); join them, or keep one"
        )
    for piece, box in enumerate(find_objects(pieces)):
        if piece == largest:
            continue
        around = tuple(slice(max(interval.start - 1, 0), interval.stop + 1) for interval in box)
        component = pieces[around] == piece + 1
        border = binary_dilation(component, touching) & ~component
        parts[around][component] = np.bincount(parts[around][border]).argmax()
    notes.append(
        f"{name}: {n - 1} small components of {part} ({ml.sum() - ml[largest]:.2g} ml "
        "in all) were given to what surrounds them"
    )
