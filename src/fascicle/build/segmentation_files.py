"""Label maps in NIfTI and NRRD files."""

from __future__ import annotations

import bz2
import gzip
import io
import math
import warnings
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fascicle.build.segmentation import Segmentation
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line
from fascicle.core.files import check_file, named_by
from fascicle.core.ranges import shown

UNPACKERS: dict[str, Any] = {
    "gzip": gzip.open, "gz": gzip.open, "bzip2": bz2.open, "bz2": bz2.open,
}  # fmt: skip


def read_segmentation(path: Path | str) -> Segmentation:
    """Read a label map.

    NIfTI positions are RAS+ by definition. NRRD positions stay in the file's space, which must be
    LPS or RAS; a file that names no space gives spacings alone, and its own axes are kept, with the
    first voxel at the origin unless the file says otherwise.

    Parameters
    ----------
    path : path
        A ``.nii``, ``.nii.gz``, ``.nrrd`` or ``.nhdr`` file.

    Returns
    -------
    Segmentation
        Labels, and the affine from voxel index to mm.

    Raises
    ------
    InputError
        If the file is missing, of another format, damaged, not three-dimensional, without voxel
        spacing, in other units, or has values that are not whole numbers.
    """
    path = Path(path)
    packed = path.name.lower().endswith(".nii.gz")
    check_file(path, (".gz",) if packed else (".nii", ".nrrd", ".nhdr"), "segmentation")
    read = _read_nrrd if path.suffix.lower() in (".nrrd", ".nhdr") else _read_nifti
    values, affine, space = read(path)
    return Segmentation(_whole_numbers(path, values), affine, str(path), space)


@contextmanager
def _refusing_damage(path: Path, *errors: type[Exception]) -> Iterator[None]:
    """Say in one line what a reader found wrong, and nothing else that it has to say."""
    refused: tuple[type[Exception], ...] = (
        OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError,
        MemoryError, AssertionError, StopIteration, zlib.error, *errors,
    )  # fmt: skip
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    except refused as error:
        raise InputError(
            f"{path}: damaged, truncated or mislabelled ({one_line(error)}); export or copy it "
            "again"
        ) from None


@contextmanager
def _unlogged() -> Iterator[None]:
    """Keep nibabel from logging: it mends headers on reading, and a missing spacing becomes 1."""
    from nibabel.imageglobals import logger

    logged, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = logged


def _read_nifti(path: Path) -> tuple[NDArray[Any], Floats, str]:
    """Voxels, affine and space; the header counts as it is in the file, not as nibabel mends it."""
    import nibabel
    from nibabel.filebasedimages import ImageFileError
    from nibabel.openers import ImageOpener
    from nibabel.spatialimages import HeaderDataError
    from nibabel.wrapstruct import WrapStructError

    errors = ImageFileError, HeaderDataError, WrapStructError
    with _unlogged(), _refusing_damage(path, *errors):
        image = nibabel.load(path)
        with ImageOpener(path) as file:
            header = type(image.header).from_fileobj(file, check=False)
        shape = tuple(int(n) for n in image.shape)
        dtype = image.get_data_dtype()
    if not isinstance(image, nibabel.Nifti1Image | nibabel.Nifti2Image):
        raise InputError(f"{path}: not a NIfTI file inside; convert it to NIfTI")
    _check_size(path, shape, dtype)
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
    with _refusing_damage(path, *errors):
        values = np.asanyarray(image.dataobj)
    affine = np.array(image.affine, dtype=np.float64)
    return values, _scaled(affine, factors[unit]), "RAS"


def _read_nrrd(path: Path) -> tuple[NDArray[Any], Floats, str]:
    """Voxels, affine and space."""
    import nrrd

    with _refusing_damage(path, nrrd.NRRDError), path.open("rb") as file:
        header = nrrd.read_header(file)
        shape = tuple(int(n) for n in header["sizes"])
        dtype = _nrrd_type(header)
    data_file = header.get("datafile", header.get("data file"))  # as the reader looks for it
    if data_file is not None:
        check_file(named_by(path, data_file), (Path(data_file).suffix.lower(),), "voxels")
    _check_size(path, shape, dtype)
    affine, space = _nrrd_affine(path, header)
    with _refusing_damage(path, nrrd.NRRDError), path.open("rb") as file:
        header = nrrd.read_header(file)  # the data follow
        if header["encoding"] in UNPACKERS:
            values = _unpacked(path, header, file, dtype)
        else:
            values = nrrd.read_data(header, file, str(path))
    return values, affine, space


def _nrrd_type(header: dict[str, Any]) -> np.dtype[Any]:
    """Type of the voxels: that of an array which the reader makes without any."""
    import nrrd

    encoding = "raw" if header["encoding"] in UNPACKERS else header["encoding"]
    none = {"encoding": encoding, "sizes": np.zeros(3, dtype=np.int64), "dimension": 3}
    fields = {name: header[name] for name in ("type", "endian") if name in header}
    return nrrd.read_data(none | fields, io.BytesIO()).dtype  # type: ignore[no-any-return]


def _unpacked(
    path: Path, header: dict[str, Any], attached: BinaryIO, dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Unpack as many bytes as an NRRD file states; nrrd would unpack all there are."""
    skips = ("byteskip", "byte skip", "lineskip", "line skip")
    skipped = [name for name in skips if header.get(name)]
    if skipped:
        raise ValueError(f"compressed data with '{skipped[0]}'")
    data_file = header.get("datafile", header.get("data file"))
    shape = [int(n) for n in header["sizes"]]
    content = np.zeros(math.prod(shape) * dtype.itemsize, dtype=np.uint8)
    with ExitStack() as stack:
        file = attached
        if data_file is not None:
            file = stack.enter_context((path.parent / data_file).open("rb"))
        stream = stack.enter_context(UNPACKERS[header["encoding"]](file))
        found = stream.readinto(content)
        if found < content.size or stream.read(1):
            holds = f"holds {found}" if found < content.size else "more follow"
            raise ValueError(f"{content.size} bytes announced, {holds}")
    return content.view(dtype).reshape(shape, order="F")


def _nrrd_affine(path: Path, header: dict[str, Any]) -> tuple[Floats, str]:
    """Voxel index to mm, in the file's own space, and what that is called."""
    spaces = {
        "right-anterior-superior": "RAS", "ras": "RAS", "left-posterior-superior": "LPS",
        "lps": "LPS", "3d-right-handed": "",
    }  # fmt: skip
    space = str(header.get("space", "3D-right-handed")).lower()
    if space not in spaces:  # in a left-handed one the heart would be mirrored
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
    units = {
        str(unit).strip().lower() for unit in header.get("space units", header.get("units", []))
    }
    if len(units) > 1 or not units <= factors.keys():
        raise InputError(f"{path}: space units {sorted(units)} are not of length; write it in mm")
    return _scaled(affine, factors[units.pop()] if units else 1.0), spaces[space]


def _scaled(affine: Floats, millimetres: float) -> Floats:
    """The affine in mm; what becomes infinite is refused as a size of voxels."""
    with np.errstate(over="ignore"):
        return np.vstack([affine[:3] * millimetres, affine[3:]])


def _check_size(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse what is not a volume of numbers, before memory is taken for it."""
    if dtype.kind not in "iubf":
        raise InputError(f"{path}: voxels of type {dtype}; give whole numbers as labels")
    written = " × ".join(str(n) for n in shape)
    if len(shape) != 3:
        raise InputError(
            f"{path}: {len(shape)} dimensions ({written}); give one label map in three dimensions "
            "(one frame of a cine, no channels)"
        )
    voxels, content = math.prod(shape), math.prod(shape) * dtype.itemsize
    # a CT of the whole thorax at 0.5 mm, or 512 x 512 x 1024; 1.5 GB
    if min(shape) < 2 or voxels > 1 << 28 or content > 3 << 29:
        raise InputError(
            f"{path}: {written} voxels of type {dtype}; give a label map of the heart: 2 voxels or "
            "more along each axis, at most 2^28 in all and 1.5 GB"
        )


def _whole_numbers(path: Path, values: NDArray[Any]) -> NDArray[np.integer[Any]]:
    """Labels, in a type no larger than in the file: a map may have hundreds of millions."""
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.kind in "iu":
        return values.astype(values.dtype.newbyteorder("="))
    with np.errstate(invalid="ignore"):
        labels = values.astype(np.int32)
    broken = labels != values  # so is what is not finite, or too large
    if broken.any():
        raise InputError(
            f"{path}: {int(broken.sum())} of {values.size} voxels are not whole numbers (first: "
            f"{values[broken][0]:g}); give the label map, not the image or a probability, and "
            "resample with nearest neighbours"
        )
    return labels
