"""The ventricles of a whole heart: taken out by their numbers, labelled by where they were cut."""

from pathlib import Path

import numpy as np
import pytest
from builders import box
from scipy.spatial import cKDTree

from fascicle.build.endocardia import endocardia
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.build.whole_heart import region_arrays, regions_in, ventricles
from fascicle.core.errors import InputError
from fascicle.heart.fibres import placeholder
from fascicle.heart.labelled_surface import NEEDED_LABELS, Label, labelled_mesh
from fascicle.mesh.measures import signed_volumes, triangle_areas
from fascicle.mesh.mesh_file import TETRAHEDRON, MeshFile
from fascicle.mesh.vtk import write_grid

REGIONS = {"lv": (11,), "rv": (12,), "septum": (17,)}


@pytest.fixture(scope="module")
def ventricular(default_heart):
    """The packaged heart with labels, each a closed band or shell."""
    return labelled_mesh(default_heart)


@pytest.fixture(scope="module")
def whole(default_heart, ventricular):
    """A whole heart: the packaged ventricles, and atria as a layer of 4 mm on their base."""
    vertices = default_heart.vertices
    base = np.sort(ventricular.having(Label.BASE), axis=1)
    ring, number = np.unique(base, return_inverse=True)
    lower = number.reshape(-1, 3)
    up = vertices[ring].mean(axis=0) - vertices.mean(axis=0)
    raised = vertices[ring] + 4 * up / np.linalg.norm(up)
    upper = lower + len(vertices)
    # three tetrahedra a prism; cut alike on both sides as corners ascend
    columns = np.hstack([base, upper])
    layer = np.concatenate([columns[:, k : k + 4] for k in range(3)])
    points = np.concatenate([vertices, raised])
    turned = signed_volumes(points, layer) < 0
    layer[turned] = layer[turned][:, [0, 2, 1, 3]]
    layer = layer[signed_volumes(points, layer) > 1e-6]
    middle = vertices[default_heart.tetrahedra].mean(axis=1)
    to = [cKDTree(e.vertices).query(middle)[0] for e in default_heart.endocardia]
    region = np.where(to[0] < to[1], 11, 12)
    region[(to[0] < 12) & (to[1] < 12)] = 17
    region = np.concatenate([region, np.full(len(layer), 4)])
    tetrahedra = np.concatenate([default_heart.tetrahedra, layer])
    arrays = {
        "cell id": np.arange(len(region)),
        "fibre": np.tile([0.0, 0, 1], (len(region), 1)),
        "zone": np.where(region == 4, 2, 1),
        "_volume": region.astype(float),
    }
    return MeshFile(Path("whole.vtu"), points, {TETRAHEDRON: tetrahedra}, {}, {TETRAHEDRON: arrays})


def test_the_regions_are_told_with_their_sizes(whole, default_heart):
    assert list(region_arrays(whole)) == ["_volume", "zone"]
    words = regions_in(whole)
    values = whole.cell_data[TETRAHEDRON]["_volume"][: len(default_heart.volumes)]
    for number in (11, 12, 17):
        ml = default_heart.volumes[values == number].sum() / 1e3
        assert f"{number} ({(values == number).sum()} elements, {ml:.3g} ml)" in words
    assert "other arrays: zone" in words


def test_the_ventricles_are_taken_out_where_they_were_joined(whole, default_heart, ventricular):
    found, cut = ventricles(whole, REGIONS)
    np.testing.assert_array_equal(found.cells[TETRAHEDRON], default_heart.tetrahedra)
    np.testing.assert_array_equal(np.unique(found.cell_data[TETRAHEDRON]["region"]), [11, 12, 17])
    basal = np.sort(ventricular.having(Label.BASE), axis=1)
    assert {tuple(row) for row in np.sort(cut, axis=1)} <= {tuple(row) for row in basal}
    assert len(cut) > 0.95 * len(basal)


def write(whole, path, **without):
    arrays = {k: v for k, v in whole.cell_data[TETRAHEDRON].items() if k not in without}
    write_grid(path, whole.points, whole.cells[TETRAHEDRON], TETRAHEDRON, {}, arrays)
    return path


def test_a_whole_heart_is_read_and_labelled(whole, ventricular, tmp_path):
    path = write(whole, tmp_path / "whole.vtu")
    read = read_anatomy(Source(path, regions=REGIONS), 2.0)
    assert read.fibres is None  # one direction everywhere is a placeholder
    assert "placeholder, as all lie along (0, 0, 1); a rule" in str(read.notes)
    for label in NEEDED_LABELS:
        areas = [
            triangle_areas(mesh.vertices, mesh.having(label)).sum()
            for mesh in (read.mesh, ventricular)
        ]
        assert areas[0] == pytest.approx(areas[1], rel=0.06)
    kept = read_anatomy(Source(path, regions=REGIONS, fibres="file"), 2.0)
    np.testing.assert_array_equal(kept.fibres[:, 2], 1.0)
    assert read_anatomy(Source(path, regions=REGIONS, fibres="rule"), 2.0).fibres is None


@pytest.mark.parametrize(
    ("regions", "array", "words"),
    [
        ({"lv": 1, "rv": 2, "septum": 7}, None, "has all of the regions 1, 2, 7; its array"),
        ({"lv": 11, "rv": 12}, "zone", "no array 'zone' of the tetrahedra has all"),
        ({"lv": 11}, None, "lv or rv missing"),
        ({"lv": 11, "rv": 12, "la": 4}, None, "unknown 'la'"),
        ({"lv": 11, "rv": 11}, None, "a number is given twice"),
    ],
)
def test_numbers_that_are_not_there_are_refused(whole, regions, array, words):
    with pytest.raises(InputError, match=words):
        ventricles(whole, {part: (number,) for part, number in regions.items()}, array)


def test_two_arrays_with_the_same_numbers_must_be_told_apart(whole):
    arrays = whole.cell_data[TETRAHEDRON]
    other = {**arrays, "zone": np.roll(arrays["_volume"], 1000)}
    given = MeshFile(whole.path, whole.points, whole.cells, {}, {TETRAHEDRON: other})
    with pytest.raises(InputError, match="arrays 'zone' and '_volume' both have these regions"):
        ventricles(given, REGIONS)
    found, _ = ventricles(given, REGIONS, "zone")
    assert len(found.cells[TETRAHEDRON]) == np.isin(other["zone"], (11, 12, 17)).sum()


def test_a_mesh_that_is_no_pair_of_ventricles_tells_its_regions(tmp_path):
    block = box(60.0, 4)
    arrays = {"tag": np.where(np.arange(len(block.tetrahedra)) < 100, 3, 8).astype(float)}
    path = tmp_path / "block.vtu"
    write_grid(path, block.vertices, block.tetrahedra, TETRAHEDRON, {}, arrays)
    words = r"0 cavities found.*'tag' has the regions 3 \(100 elements, 56.2 ml\), 8 .*regions="
    with pytest.raises(InputError, match=words):
        read_anatomy(Source(path), 2.0)


def test_a_four_chamber_heart(data_folder):
    path = data_folder / "hearts" / "rodero01" / "rodero_01_fullheart_2.0mm.vtu"
    read = read_anatomy(Source(path, regions={"lv": (1,), "rv": (2,), "septum": (7,)}), 2.0)
    mesh = read.mesh
    assert signed_volumes(mesh.vertices, mesh.tetrahedra).sum() == pytest.approx(226.1e3, rel=1e-3)
    assert read.fibres is None
    # the file's surface of the left cavity has 7421 triangles; the rim of the aorta is more
    assert (mesh.labels == Label.LV_ENDOCARDIUM).sum() == pytest.approx(7421, rel=0.06)
    caps = [surface.valve.sum() > 0 for surface in endocardia(mesh)]
    assert caps == [True, True]  # aortic and pulmonary openings, or mitral and tricuspid


RNG = np.random.default_rng(0)
RANDOM = RNG.standard_normal((500, 3))
RANDOM /= np.linalg.norm(RANDOM, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("vectors", "words"),
    [
        (np.tile([0.0, 0, -2], (500, 1)), "all lie along"),
        (np.zeros((500, 3)), "100% of them are zero"),
        (RANDOM * RNG.uniform(0.1, 3, (500, 1)), "lengths vary from 0.1"),
        (5 * RANDOM, ""),
        (RANDOM * RNG.uniform(0.7, 1, (500, 1)), ""),  # means of unit vectors
        (np.where(np.arange(500)[:, None] == 7, np.nan, RANDOM), ""),  # refused elsewhere
    ],
)
def test_placeholders(vectors, words):
    found = placeholder(vectors)
    assert words in found
    assert bool(found) == bool(words)
