"""Label maps in NIfTI and NRRD: the same positions from both, and damaged ones in one line."""

from dataclasses import replace

import nibabel
import nrrd
import numpy as np
import pytest
from phantoms import ellipsoid_segmentation

from fascicle.build.read_anatomy import _segmentation_labels
from fascicle.build.segmentation import part_of_segment
from fascicle.build.segmentation_files import read_segmentation
from fascicle.core.errors import InputError

TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
TURN = np.linalg.qr(np.array([[0.8, -0.4, 0.45], [0.5, 0.85, -0.15], [-0.3, 0.35, 0.9]]))[0]
AFFINE = np.eye(4)
AFFINE[:3, :3] = TURN * [1.25, -1.25, 8.0]
AFFINE[:3, 3] = [12.0, -80.0, 301.5]


@pytest.fixture
def labels():
    return np.random.default_rng(0).integers(0, 5, (9, 7, 5)).astype(np.int16)


def write_nifti(path, labels, affine=AFFINE, units="mm", codes=(2, 1)):
    image = nibabel.Nifti1Image(labels, affine)
    image.set_sform(affine, code=codes[0])
    image.set_qform(affine, code=codes[1])
    image.header.set_xyzt_units(units)
    nibabel.save(image, path)
    return path


def write_nrrd(path, labels, affine=TO_LPS @ AFFINE, **header):
    fields = {
        "space": "left-posterior-superior",
        "space directions": affine[:3, :3].T,
        "space origin": affine[:3, 3],
        "encoding": "gzip",
    } | header
    fields = {key: value for key, value in fields.items() if value is not None}
    nrrd.write(str(path), labels, fields)
    return path


def refused(path):
    """The message with which a file is refused: one line that begins with its name."""
    with pytest.raises(InputError) as error:
        read_segmentation(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd", "a.nhdr", "one.nrrd"])
def test_labels_and_positions_are_read_unchanged(tmp_path, labels, name):
    nifti = ".nii" in name
    if name == "one.nrrd":  # an axis of one entry
        directions = np.concatenate([np.full((1, 3), np.nan), (TO_LPS @ AFFINE)[:3, :3].T])
        path = write_nrrd(tmp_path / name, labels[None], **{"space directions": directions})
    else:
        path = (write_nifti if nifti else write_nrrd)(tmp_path / name, labels)
    found = read_segmentation(path)
    np.testing.assert_array_equal(found.labels, labels)
    np.testing.assert_allclose(found.affine, AFFINE if nifti else TO_LPS @ AFFINE, atol=1e-4)
    assert found.space == ("RAS" if nifti else "LPS")
    np.testing.assert_allclose(found.spacing, [1.25, 1.25, 8.0], rtol=1e-6)
    assert found.name == str(tmp_path / name)


@pytest.mark.parametrize(
    ("kind", "encoding", "name"), [(">i4", "ASCII", "a.nrrd"), (np.float32, "bzip2", "a.nhdr")]
)
def test_encodings_of_nrrd(tmp_path, labels, kind, encoding, name):
    found = read_segmentation(write_nrrd(tmp_path / name, labels.astype(kind), encoding=encoding))
    np.testing.assert_array_equal(found.labels, labels)


@pytest.mark.parametrize(
    ("space", "known_as"),
    [("LPS", "LPS"), ("right-anterior-superior", "RAS"), ("3D-right-handed", "")],
)
def test_nrrd_spaces_are_kept(tmp_path, labels, space, known_as):
    found = read_segmentation(write_nrrd(tmp_path / "a.nrrd", labels, AFFINE, space=space))
    np.testing.assert_allclose(found.affine, AFFINE, atol=1e-9)
    assert found.space == known_as


@pytest.mark.parametrize(("units", "factor"), [("meter", 1e-3), ("micron", 1e3)])
def test_nifti_units_are_honoured(tmp_path, labels, units, factor):
    affine = AFFINE.copy()
    affine[:3] *= factor
    found = read_segmentation(write_nifti(tmp_path / "a.nii", labels, affine, units))
    np.testing.assert_allclose(found.affine, AFFINE, rtol=1e-5)


def test_labels_stored_as_whole_floats_are_read_and_others_refused(tmp_path, labels):
    found = read_segmentation(write_nifti(tmp_path / "a.nii", labels.astype(np.float32)))
    np.testing.assert_array_equal(found.labels, labels)
    soft = labels.astype(np.float32)
    soft[2, 3, 1] = 0.25
    message = refused(write_nifti(tmp_path / "b.nii", soft))
    assert "1 of 315 voxels are not whole numbers (first: 0.25)" in message
    soft[2, 3, 1] = np.nan
    assert "1 of 315" in refused(write_nrrd(tmp_path / "b.nrrd", soft))


def test_other_dimensions_are_refused(tmp_path, labels):
    cine = np.stack([labels, labels], axis=-1)
    assert "4 dimensions (9 × 7 × 5 × 2)" in refused(write_nifti(tmp_path / "a.nii", cine))
    assert "2 dimensions" in refused(write_nifti(tmp_path / "b.nii", labels[:, :, 0]))


def test_without_position_or_spacing_or_with_an_unknown_space_it_is_refused(tmp_path, labels):
    message = refused(write_nifti(tmp_path / "a.nii", labels, codes=(0, 0)))
    assert "sform_code and qform_code are 0" in message
    raw = bytearray(write_nifti(tmp_path / "a.nii", labels).read_bytes())
    for size in (0.0, np.nan):
        raw[80:84] = np.float32(size).tobytes()  # pixdim[1]
        (tmp_path / "a.nii").write_bytes(raw)
        assert "pixdim" in refused(tmp_path / "a.nii")
    nrrd.write(str(tmp_path / "a.nrrd"), labels)
    assert "neither space directions nor spacings" in refused(tmp_path / "a.nrrd")
    for header, words in (({"space": "scanner-xyz"}, "space 'scanner-xyz'"),
                          ({"space units": ["s", "s", "s"]}, "space units")):  # fmt: skip
        assert words in refused(write_nrrd(tmp_path / "b.nrrd", labels, **header))


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd"])
def test_other_formats_and_damaged_files_are_refused(tmp_path, labels, name):
    write = write_nifti if ".nii" in name else write_nrrd
    whole = write(tmp_path / name, labels).read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"hello\n" * 50):
        (tmp_path / name).write_bytes(content)
        refused(tmp_path / name)
    for other in (".mha", ".gz"):
        (tmp_path / f"a{other}").write_bytes(b"\x80\x04K\x01.")
        assert f"cannot read '{other}'" in refused(tmp_path / f"a{other}")


SEGMENTS = {
    "LV blood pool": "lv", "heart_ventricle_left": "lv", "Right Ventricle": "rv", "RV": "rv",
    "heart_myocardium": "myocardium", "LV wall": "myocardium", "left ventricular scar": "scar",
    "heart_atrium_left": None, "LA wall": None, "papillary muscle": None, "Segment_1": None,
}  # fmt: skip


@pytest.mark.parametrize("layered", [False, True])
def test_names_of_segments_take_the_place_of_labels(tmp_path, layered):
    """3D Slicer's names: overlapping segments are in layers, each with numbers of its own."""
    assert {name: part_of_segment(name) for name in SEGMENTS} == SEGMENTS
    phantom = ellipsoid_segmentation((3.0, 3.0, 3.0)).segmentation
    names, header, voxels = ("LV blood", "RV", "scar", "Myocardium"), {}, phantom.labels
    order = (1, 2, 4, 3)  # numbers of these in the phantom
    in_order = (*names[:2], *names[:1:-1])
    if layered:
        voxels = np.array([voxels == 1, voxels == 2, voxels == 4, voxels >= 3], dtype=np.uint8)
        none = np.full((1, 3), np.nan)
        header["space directions"] = np.concatenate([none, phantom.affine[:3, :3].T])
    for k, name in enumerate(names):
        header |= {f"Segment{k}_Name": name, f"Segment{k}_LabelValue": str(order[k])}
        if layered:
            header |= {f"Segment{k}_Layer": str(k), f"Segment{k}_LabelValue": "1"}
    path = write_nrrd(tmp_path / "a.seg.nrrd", voxels, phantom.affine, **header)
    found = read_segmentation(path)
    numbers = dict(zip(found.segments.values(), found.segments, strict=True))
    for name, number in zip(names, order, strict=True):
        np.testing.assert_array_equal(found.labels == numbers[name], phantom.labels == number)
    parts, (note,) = _segmentation_labels(found, None)
    assert parts.parts() == [
        (part, (numbers[name],))
        for part, name in zip(("LV blood", "RV blood", "myocardium", "scar"), in_order, strict=True)
    ]
    assert f"lv {numbers['LV blood']} LV blood; rv {numbers['RV']} RV" in note
    segments = found.segments | {numbers["RV"]: "A"}
    with pytest.raises(InputError, match=r"labels \(0, 1 LV blood, 2 A, .*\) depends .* lv=1,rv=2"):
        _segmentation_labels(replace(found, segments=segments), None)
