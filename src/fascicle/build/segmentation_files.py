"""Label maps in NIfTI and NRRD files."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.build.segmentation import Segmentation, part_of_segment
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, check_installed, one_line, printable
from fascicle.core.files import check_file, named_by
from fascicle.core.isolated import read_isolated
from fascicle.core.ranges import shown


def read_segmentation(path: Path | str) -> Segmentation:
    """Read a label map.

    NIfTI positions are RAS+ by definition. NRRD positions stay in the file's space, which must be
    LPS or RAS; a file that names no space gives spacings alone, and its own axes are kept, with the
    first voxel at the origin unless the file says otherwise.
    """
    path = Path(path)
    packed = path.name.lower().endswith(".nii.gz")
    check_file(path, (".gz",) if packed else (".nii", ".nrrd", ".nhdr"), "segmentation")
    check_installed("nrrd", f"{path}: a label map")
    import nrrd

    if path.suffix.lower() not in (".nrrd", ".nhdr"):
        return Segmentation(*read_isolated(_read_nifti, path))
    with _refusing_damage(path), path.open("rb") as file:
        header = nrrd.read_header(file)
    if (data_file := header.get("datafile", header.get("data file"))) is None:
        return Segmentation(*read_isolated(_read_nrrd, path))
    voxels = named_by(path, data_file)
    check_file(voxels, (voxels.suffix.lower(),), "voxels")
    return Segmentation(*read_isolated(_read_nrrd, path, companions=(voxels,)))


@contextmanager
def _refusing_damage(path: Path) -> Iterator[None]:
    """Turn any error of a reader into one line, and silence its warnings."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # noqa: BLE001 - nibabel and nrrd raise errors of any type
        raise InputError(
            f"{path}: damaged, truncated or mislabelled ({one_line(error)}); export or copy it "
            "again"
        ) from None


def _read_nifti(path: Path) -> tuple[NDArray[np.integer[Any]], Floats, str, str]:
    """Labels, affine, name and space; checks the file's own header, which nibabel may mend."""
    import nibabel
    from nibabel.openers import ImageOpener

    with _refusing_damage(path):
        image = nibabel.load(path)
        with ImageOpener(path) as file:
            header = type(image.header).from_fileobj(file, check=False)
    if not isinstance(image, nibabel.Nifti1Image | nibabel.Nifti2Image):
        raise InputError(f"{path}: not a NIfTI file inside; convert it to NIfTI")
    shape = image.shape[:3] + tuple(n for n in image.shape[3:] if n > 1)
    _check_shape(path, shape, image.get_data_dtype())
    spacing = np.array(header["pixdim"][1:4], dtype=np.float64)
    if not (np.isfinite(spacing).all() and (spacing > 0).all()):
        listed = ", ".join(f"{value:g}" for value in spacing)
        raise InputError(
            f"{path}: the voxels have no size (pixdim {listed}); write the spacing, in mm, into "
            "the file"
        )
    if not (int(header["sform_code"]) or int(header["qform_code"])):
        raise InputError(
            f"{path}: sform_code and qform_code are 0, so it does not say where the voxels lie; "
            "export it again with its position and directions"
        )
    unit = int(header["xyzt_units"]) & 0x07  # the bits of lengths
    factors = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}  # unknown, m, mm, µm
    if unit not in factors:
        raise InputError(f"{path}: unknown unit of length {unit} (xyzt_units); write it in mm")
    with _refusing_damage(path):
        values = np.asanyarray(image.dataobj).reshape(shape)
    affine = np.array(image.affine, dtype=np.float64)
    return _whole_numbers(path, values), _scaled(affine, factors[unit]), str(path), "RAS"


def _read_nrrd(path: Path) -> tuple[NDArray[np.integer[Any]], Floats, str, str, dict[int, str]]:
    """Labels, affine, name, space and names of the segments."""
    import nrrd

    with _refusing_damage(path):
        values, header = nrrd.read(str(path))
        axes = [k for k, n in enumerate(values.shape) if n > 1 or values.ndim <= 3]
        values, names = _merged(values.squeeze() if values.ndim > 3 else values, header)
        for key in {"space directions", "spacings"} & header.keys():
            header[key] = np.asarray(header[key])[axes[-values.ndim :]]  # without that of layers
    affine, space = _nrrd_affine(path, header)
    _check_shape(path, values.shape, values.dtype)
    return _whole_numbers(path, values), affine, str(path), space, names


def _merged(values: NDArray[Any], header: Mapping[str, Any]) -> tuple[NDArray[Any], dict[int, str]]:
    """Label map and names of its numbers, from the segments of 3D Slicer.

    Segments that overlap are in several layers, the first axis of four. They get numbers from 1;
    where they overlap, the last of myocardium, LV, RV and scar counts.
    """
    keys = [key for key in header if re.fullmatch(r"Segment\d+_Name", key)]
    names = [printable(header[key]) for key in keys]
    numbers = [int(header.get(key.replace("Name", "LabelValue"), 1)) for key in keys]
    if not names or values.ndim != 4:
        return values, dict(zip(numbers, names, strict=True))
    merged = np.zeros(values.shape[1:], dtype=np.int32)
    parts = (None, "myocardium", "lv", "rv", "scar")
    for k in sorted(range(len(names)), key=lambda k: parts.index(part_of_segment(names[k]))):
        layer = int(header.get(keys[k].replace("Name", "Layer"), k))
        merged[values[layer] == numbers[k]] = k + 1
    return merged, dict(enumerate(names, start=1))


def _nrrd_affine(path: Path, header: dict[str, Any]) -> tuple[Floats, str]:
    """Affine from voxel indices to mm in the file's own space, and the name of that space."""
    spaces = {
        "right-anterior-superior": "RAS", "ras": "RAS", "left-posterior-superior": "LPS",
        "lps": "LPS", "3d-right-handed": "",
    }  # fmt: skip
    space = str(header.get("space", "3D-right-handed")).lower()
    if space not in spaces:  # a left-handed space would mirror the heart
        raise InputError(
            f"{path}: space {shown(space)} is unknown or left-handed; export the map in "
            "left-posterior-superior or right-anterior-superior"
        )
    directions, spacings = header.get("space directions"), header.get("spacings")
    affine = np.eye(4)
    if directions is not None:
        directions = np.asarray(directions, dtype=np.float64)
        if directions.shape != (3, 3):
            raise InputError(
                f"{path}: space directions for {directions.shape} axes; give a map in three "
                "dimensions"
            )
        affine[:3, :3] = directions.T
        origin = np.asarray(header.get("space origin", np.zeros(3)), dtype=np.float64)
        affine[:3, 3] = origin if origin.shape == (3,) else np.nan
    elif spacings is not None and len(spacings) == 3:
        affine[:3, :3] = np.diag(np.asarray(spacings, dtype=np.float64))
    else:
        raise InputError(
            f"{path}: neither space directions nor spacings; write the voxel spacing, in mm, into "
            "the file"
        )
    factors = {"mm": 1.0, "millimeter": 1.0, "millimeters": 1.0, "": 1.0, "m": 1e3, "cm": 10.0,
               "um": 1e-3, "μm": 1e-3, "µm": 1e-3}  # fmt: skip
    unit_names = header.get("space units", header.get("units", []))
    units = {str(unit).strip().lower() for unit in unit_names}
    if len(units) > 1 or not units <= factors.keys():
        raise InputError(f"{path}: space units {sorted(units)} are not of length; write it in mm")
    return _scaled(affine, factors[units.pop()] if units else 1.0), spaces[space]


def _scaled(affine: Floats, millimetres: float) -> Floats:
    """Affine in mm; `Segmentation` refuses one that becomes infinite."""
    with np.errstate(over="ignore"):
        return np.vstack([affine[:3] * millimetres, affine[3:]])


def _check_shape(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    if dtype.kind not in "iubf":
        raise InputError(f"{path}: voxels of type {dtype}; give whole numbers as labels")
    if len(shape) != 3 or min(shape) < 2:
        raise InputError(
            f"{path}: {len(shape)} dimensions ({' × '.join(map(str, shape))}); give one label map "
            "in three dimensions (one frame of a cine, no channels), with 2 voxels or more along "
            "each"
        )


def _whole_numbers(path: Path, values: NDArray[Any]) -> NDArray[np.integer[Any]]:
    """Labels, in a type no larger than in the file: a map may have hundreds of millions."""
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.kind in "iu":
        return values.astype(values.dtype.newbyteorder("="))
    with np.errstate(invalid="ignore"):
        labels: NDArray[np.integer[Any]] = np.rint(values).astype(np.int32)
        # includes values that are not finite, or too large; scaled ones are rounded
        broken = ~(np.abs(labels - values) < 1e-3)
    if broken.any():
        raise InputError(
            f"{path}: {int(broken.sum())} of {values.size} voxels are not whole numbers (first: "
            f"{values[broken][0]:g}); give the label map, not the image or a probability, and "
            "resample with nearest neighbours"
        )
    return labels
