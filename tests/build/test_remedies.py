"""Anatomies that are refused: the message names the file and the thing, and its remedy works."""

import re
from dataclasses import replace

import anatomies
import numpy as np
import pytest
import pyvista as pv
from anatomies import EPI, LV, RV, label_map, ventricles, write_nifti, write_parts
from test_classify import distances, grid, surface_of

from fascicle.build.classify import classify_surface
from fascicle.build.labelled_files import labelled_surface
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.build.segmentation import SegmentationLabels
from fascicle.build.segmentation_files import read_segmentation
from fascicle.build.segmentation_surface import surface_from_segmentation
from fascicle.build.surface_checks import mirror_warning
from fascicle.build.surface_repair import prepared_surface
from fascicle.core.errors import InputError
from fascicle.mesh.read import read_mesh
from fascicle.mesh.topology import boundary_loops, fan

NUMBERS = {"lv": 1, "rv": 2, "myocardium": 3, "scar": 4}


def build(file=None, **options):
    return read_anatomy(Source(file, **options), 7.5).mesh


def surface_of_map(file):
    surface_from_segmentation(read_segmentation(file), SegmentationLabels(**NUMBERS))


def refused(words, **options):
    with pytest.raises(InputError, match=words):
        build(**options)


@pytest.fixture
def parts(tmp_path):
    return {name.split("-")[0]: file for name, file in write_parts(tmp_path).items()}


def test_one_cavity(tmp_path):
    whole = ventricles()
    kept = whole.labels != RV
    loop = boundary_loops(whole.triangles[kept])[0]
    points = np.vstack([whole.vertices, whole.vertices[loop].mean(axis=0)])
    lid = fan(loop, len(whole.vertices))
    triangles = np.concatenate([whole.triangles[kept], lid])
    labels = np.append(whole.labels[kept], np.full(len(lid), anatomies.BASE))
    both = "give a surface of both ventricles"
    file = anatomies.write_surface(tmp_path / "one.vtp", points, triangles)
    refused(rf"one\.vtp: 1 cavity found \(43\.\d ml\), and two needed; {both}", file=file)
    file = anatomies.write_surface(tmp_path / "label.vtp", points, triangles, label=labels)
    refused(r"label\.vtp: no triangle is labelled rv endocardium .*\(labels=\)", file=file)
    file = write_nifti(tmp_path / "a.nii", np.where(label_map()[0] == 2, 0, label_map()[0]))
    refused(r"a\.nii: RV blood \(label 2\) has 0 voxels.*give the label", file=file, labels=NUMBERS)
    assert len(build(anatomies.write_surface(tmp_path / "two.vtp")).tetrahedra)
    surface_of_map(write_nifti(tmp_path / "b.nii"))


def five(points, cells):
    """A body and four copies of a third of its size above it."""
    others = [0.3 * points + [0, 0, 45.0 + 35 * k] for k in range(4)]
    numbers = [cells + k * len(points) for k in range(5)]
    return np.vstack([points, *others]), np.vstack(numbers)


def test_five_pieces(tmp_path):
    """Of a surface, with labels or without, of tetrahedra and of a label map: one is kept."""
    whole, mesh = ventricles(), anatomies.tissue()
    points, triangles = five(whole.vertices, whole.triangles)
    where = r"3492 triangles about \(22\.0, 0\.1, -23\.7\) mm, .*, \.\.\."
    for arrays in ({}, {"label": np.tile(whole.labels, 5)}):
        file = anatomies.write_surface(tmp_path / "a.vtp", points, triangles, **arrays)
        refused(rf"a\.vtp: the surface falls into 5 pieces \({where}\); keep one", file=file)
        one = {name: values[: len(whole.triangles)] for name, values in arrays.items()}
        anatomies.write_surface(tmp_path / "b.vtp", whole.vertices, whole.triangles, **one)
        assert len(build(tmp_path / "b.vtp").tetrahedra)
    points, tetrahedra = five(mesh.vertices, mesh.tetrahedra)
    pv.UnstructuredGrid({pv.CellType.TETRA: tetrahedra}, points).save(tmp_path / "c.vtu")
    words = r"c\.vtu: its pieces of tissue \(213 ml about .*, 6\.05 ml about .*"
    words += "keep one piece or join them"
    refused(words, file=tmp_path / "c.vtu")
    assert len(build(anatomies.write_vtu(tmp_path / "d.vtu", labelled=False)).tetrahedra)
    labels = np.pad(label_map()[0], ((0, 0), (0, 0), (0, 20)))
    kept = labels.copy()
    for k in range(4):
        labels[10 * k + 2 : 10 * k + 9, 5:12, -8:-1] = 3
    file = write_nifti(tmp_path / "e.nii", labels)
    words = r"e\.nii: tissue falls into 5 unconnected pieces \(212 ml about \(22\.2, .*keep one"
    refused(words, file=file, labels=NUMBERS)
    surface_of_map(write_nifti(tmp_path / "f.nii", kept))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lv": "rv", "rv": "lv"}, r"/rv-.*stl, .*/lv-.*stl, .*swapped: .*; exchange the two"),
        ({"lv": "epicardium", "epicardium": "lv"}, r"/epi.* \(LV endo.* outside .*/lv-.* \(epi"),
        ({"rv": "epicardium", "epicardium": "rv"}, r"/lv-.* \(LV endo.* outside .*/rv-.* \(epi"),
        ({"rv": "lv"}, r"/lv-.* \(LV endo.* lie within .*/lv-.* \(RV endo.* own option"),
        ({"lv": "base"}, r"/base\.stl \(LV endocardium\): the surface has 3 boundary loops"),
        ({"base": "lv"}, r"/lv-.* \(base\): the surface has 1 boundary loops .*, and 3 needed"),
    ],
)  # fmt: skip
def test_a_part_given_as_another(parts, given, words):
    """The file is named that has the fault, and what it was taken for; built right: see below."""
    refused(words, parts=parts | {part: parts[other] for part, other in given.items()})


def cut_at(path, low, high):
    """The part without the triangles between two heights (mm)."""
    surface = pv.read(path)
    points, triangles = np.asarray(surface.points), surface.regular_faces
    height = points[triangles][:, :, 2].mean(axis=1)
    return points, triangles[(height < low) | (height > high)]


def test_a_part_in_pieces_or_with_several_openings(parts, tmp_path):
    two = anatomies.write_surface(tmp_path / "two.stl", *cut_at(parts["lv"], -48, -46))
    refused(r"two\.stl \(LV endo.*: the surface falls into 2 pieces", parts=parts | {"lv": two})
    holed = anatomies.write_surface(tmp_path / "holed.stl", *cut_at(parts["lv"], -99, -48))
    words = r"holed\.stl \(LV endocardium\): the surface has 2 boundary loops .*; close all but"
    refused(words, parts=parts | {"lv": holed})
    mended = pv.read(holed).fill_holes(12.0)  # mm, radius; smaller than the opening at the base
    mended.clean().save(tmp_path / "mended.stl")
    assert len(build(parts=parts | {"lv": tmp_path / "mended.stl"}).tetrahedra)


@pytest.mark.parametrize("other", ["lv", "myocardium"])
def test_labels_of_a_map_that_are_exchanged(tmp_path, other):
    given = NUMBERS | {"rv": NUMBERS[other], other: NUMBERS["rv"]}
    words = r"map\.nii: .* seem to be (swapped|exchanged).*; (give those|exchange)"
    refused(words, file=write_nifti(tmp_path / "map.nii"), labels=given)


def bridge(points, parts):
    """Tissue across the opening of the right ventricle."""
    return np.max([np.abs(points[:, 1]) - 5, np.abs(points[:, 2] + 4) - 4, parts[EPI]], axis=0)


def partition(points, parts):
    """Tissue that divides the right ventricle."""
    return np.max([np.abs(points[:, 1]) - 4, parts[EPI], points[:, 0] + 20, points[:, 2]], axis=0)


@pytest.mark.parametrize("tissue", [bridge, partition])
def test_several_openings_or_cavities(tmp_path, tissue):
    points, shape = grid(3.5)
    parts = distances(points, 0.0)
    whole = np.minimum(np.max(list(parts.values()), axis=0), tissue(points, parts))
    vertices, triangles = surface_of(whole, points, shape)
    file = anatomies.write_surface(tmp_path / "a.vtp", vertices, triangles)
    if tissue is bridge:
        note, *_ = classify_surface(vertices, triangles, "a").notes
        assert re.search(r"has 2 openings: the longest, about \(-4\d.*, is taken as the base", note)
    else:
        words = r"3 cavities found \(84.* ml, 35.* ml, 35.* ml\).*; .*label the surface"
        refused(rf"a\.vtp: .*{words} \(label_array=\)", file=file)
    middle = vertices[triangles].mean(axis=1)
    there = distances(middle, 0.0)
    off = np.abs(list(there.values()))
    labels = np.array(list(there))[off.argmin(axis=0)].astype(np.int64)
    labels[(off.min(axis=0) > 0.8) & (middle[:, 0] < -20) & (middle[:, 2] < -1)] = RV
    if tissue is bridge:
        labels[(off.min(axis=0) > 0.8) & (middle[:, 2] > -9)] = anatomies.BASE
    else:
        labels[(labels == RV) & (middle[:, 1] < 0)] = anatomies.BASE
    anatomies.write_surface(file, vertices, triangles, label=labels)
    found = prepared_surface(labelled_surface(read_mesh(file)))
    assert {LV, RV} <= set(found.labels)


@pytest.mark.parametrize("space", ["RAS", "LPS", ""])
def test_a_mirrored_map_is_noticed_in_a_chest_alone(space):
    """The apex to the left, front and below, the right ventricle to the right and in front."""
    down, aside = np.array([-0.5, 0.6, -0.62]), np.array([0.8, 0.6, 0.1])
    across = np.cross(aside, down)
    axes = np.array([np.cross(down, across), across, -down])  # of the phantom, as rows
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    assert np.linalg.det(axes) == pytest.approx(1)
    to_file = np.diag([-1, -1, 1] if space == "LPS" else [1, 1, 1])
    mirror = np.diag([-1, 1, 1])
    for turn, warned in ((axes, False), (axes @ mirror, bool(space)), (mirror, False)):
        mesh = anatomies.tissue()
        mesh = replace(mesh, vertices=mesh.vertices @ turn @ to_file)
        assert bool(mirror_warning(mesh, space)) == warned
