"""Tetrahedra of a file: voids filled, crumbs left out, touching vertices doubled, pieces joined."""

from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest
import pyvista as pv
from anatomies import MYOCARDIUM, circular_fibres, tissue
from scipy.spatial import cKDTree

from fascicle.build.endocardia import endocardia
from fascicle.build.labelled_files import Anatomy
from fascicle.build.mesh_repair import (
    joined_pieces,
    repaired_mesh,
    separated_vertices,
    with_common_vertices,
)
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh, labelled_mesh
from fascicle.mesh.checks import check_tetrahedra
from fascicle.mesh.measures import closed_volume, signed_volumes
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.topology import boundary_triangles, pieces_of, places_in, without_unused_vertices
from fascicle.mesh.vtk import write_grid


@pytest.fixture(scope="module")
def heart(default_heart):
    return default_heart


@pytest.fixture(scope="module")
def shared(heart):
    """How many vertices of an inner tetrahedron each other one that is inside shares with it."""
    outer = np.unique(heart.boundary[0])
    inside = np.flatnonzero(~np.isin(heart.tetrahedra, outer).any(axis=1))
    chosen = inside[100]
    count = np.isin(heart.tetrahedra, heart.tetrahedra[chosen]).sum(axis=1)
    return chosen, np.where(np.isin(np.arange(len(count)), inside), count, 0)


def file_of(heart, rows=slice(None), tetrahedra=None, vertices=None):
    """Some tetrahedra of a heart, then others, with fibres and the number of each."""
    others = np.empty((0, 4), dtype=np.int64) if tetrahedra is None else tetrahedra
    own = np.arange(len(heart.tetrahedra))[rows]
    fibres = np.concatenate([heart.fibres[own], np.tile([1.0, 0, 0], (len(others), 1))])
    return MeshFile(
        Path("heart.vtu"),
        heart.vertices if vertices is None else vertices,
        {TETRAHEDRON: np.concatenate([heart.tetrahedra[own], others])},
        {"z": (heart.vertices if vertices is None else vertices)[:, 2]},
        {TETRAHEDRON: {"fibre": fibres, "number": np.append(own, np.full(len(others), -1))}},
    )


def gone(heart, shared, which):
    """Inner tetrahedra whose removal leaves voids: how many, and which rows."""
    chosen, count = shared
    if which == "star":
        vertex = heart.tetrahedra[chosen][0]
        return 1, np.flatnonzero((heart.tetrahedra == vertex).any(axis=1))
    other = np.flatnonzero(count == {"two": 3, "vertex": 1}[which])[0]
    return (1 if which == "two" else 2), np.array([chosen, other])


@pytest.mark.parametrize("which", ["two", "vertex", "star"])
def test_voids_are_filled(heart, shared, which):
    voids, rows = gone(heart, shared, which)
    given = file_of(heart, np.delete(np.arange(len(heart.tetrahedra)), rows))
    found, notes = repaired_mesh(given)
    tetrahedra = found.cells[TETRAHEDRON]
    check_tetrahedra("filled", *without_unused_vertices(found.points, tetrahedra))
    boundary, _ = boundary_triangles(tetrahedra)
    assert (places_in(boundary, heart.boundary[0]) >= 0).all()
    lost = heart.volumes[rows].sum()
    added = signed_volumes(found.points, tetrahedra)[len(given.cells[TETRAHEDRON]) :]
    assert added.sum() == pytest.approx(lost)
    assert f"were filled: {voids} (" in notes[0]
    assert f"{lost:.3g} mm³ in all, with {len(added)} tetrahedra" in notes[0]
    numbers = found.cell_data[TETRAHEDRON]["number"][-len(added) :]
    near = heart.vertices[heart.tetrahedra[numbers]].mean(axis=1)
    assert cKDTree(near).query(heart.vertices[heart.tetrahedra[rows]].mean(axis=1))[0].max() < 6
    cosine = found.cell_data[TETRAHEDRON]["fibre"][-len(added) :] @ heart.fibres[rows].T
    assert np.abs(cosine).max(axis=1).min() > 0.9
    assert len(found.point_data["z"]) == len(found.points)


@pytest.mark.parametrize(("number", "count"), [(1, 1), (2, 2), (0, 1)])
def test_crumbs_that_share_few_vertices_are_left_out(heart, number, count):
    a, b, c = corners = heart.boundary[0][500]
    out = np.cross(*(heart.vertices[[b, c]] - heart.vertices[a]))
    out *= 3 / np.linalg.norm(out)
    tip = heart.vertices[a] + out + [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0], [1, 1, 1]]
    vertices = np.concatenate([heart.vertices, tip])
    new = len(heart.vertices) + np.arange(5)
    crumb = [[*corners[:number], *new[: 4 - number]]]
    if count == 2:  # on a face of the first, away from the heart
        crumb.append([*crumb[0][1:], new[4]])
    crumb = np.array(crumb)
    turned = signed_volumes(vertices, crumb) < 0
    crumb[turned] = crumb[turned][:, [0, 2, 1, 3]]
    triangles, _ = boundary_triangles(crumb)
    given = file_of(heart, tetrahedra=crumb, vertices=vertices)
    found, notes = repaired_mesh(replace(given, cells={**given.cells, TRIANGLE: triangles}))
    np.testing.assert_array_equal(found.cells[TETRAHEDRON], heart.tetrahedra)
    np.testing.assert_array_equal(found.cell_data[TETRAHEDRON]["fibre"], heart.fibres)
    assert f"with {count} of {len(heart.tetrahedra) + count} tetrahedra" in notes[0]
    assert not len(found.cells[TRIANGLE])


def test_a_sound_mesh_and_large_pieces_and_voids_stay(heart):
    sound = file_of(heart)
    assert repaired_mesh(sound) == (sound, ())
    middle = heart.vertices[heart.tetrahedra].mean(axis=1)
    shell = np.abs(np.linalg.norm(middle - middle[0], axis=1) - 14) > 3
    largest = file_of(heart, np.flatnonzero(shell))
    found, notes = repaired_mesh(largest)
    assert not any("left out" in note and "of 11" in note for note in notes)
    kept = np.linalg.norm(middle[shell] - middle[0], axis=1) < 11
    assert np.isin(np.flatnonzero(shell)[kept], found.cell_data[TETRAHEDRON]["number"]).mean() > 0.9


def test_a_heart_with_a_void_is_read(heart, shared, tmp_path):
    _, rows = gone(heart, shared, "two")
    given = file_of(heart, np.delete(np.arange(len(heart.tetrahedra)), rows))
    path = tmp_path / "heart.vtu"
    arrays = {"fibre": given.cell_data[TETRAHEDRON]["fibre"]}
    write_grid(path, given.points, given.cells[TETRAHEDRON], TETRAHEDRON, {}, arrays)
    read = read_anatomy(Source(path), 2.0)
    volume = closed_volume(read.mesh.vertices, read.mesh.triangles)
    assert volume == pytest.approx(heart.volumes.sum(), rel=1e-6)
    assert "were filled: 1 (" in str(read.notes)


def touching(heart):
    """Walls of the right ventricle's narrow end that meet in one vertex, labelled."""
    mesh = labelled_mesh(heart)
    outer = np.unique(mesh.triangles)
    normals = igl.per_vertex_normals(mesh.vertices, mesh.triangles)
    one, other = outer[cKDTree(mesh.vertices[outer]).query_pairs(4.0, output_type="ndarray")].T
    apart = mesh.vertices[other] - mesh.vertices[one]
    facing = (np.einsum("ij,ij->i", normals[one], apart) > 0.7 * np.linalg.norm(apart, axis=1)) & (
        np.einsum("ij,ij->i", normals[other], apart) < -0.7 * np.linalg.norm(apart, axis=1)
    )
    for kept, lost in zip(one[facing], other[facing], strict=True):
        vertices = mesh.vertices.copy()
        vertices[[kept, lost]] = vertices[[kept, lost]].mean(axis=0)
        if (signed_volumes(vertices, mesh.tetrahedra) > 0).all():
            into = np.arange(len(vertices))
            into[lost] = kept
            into[lost + 1 :] -= 1
            into[lost] = into[kept]
            return replace(
                mesh,
                vertices=np.delete(vertices, lost, axis=0),
                tetrahedra=into[mesh.tetrahedra],
                triangles=into[mesh.triangles],
            )
    raise AssertionError("no walls are so near")


def test_walls_that_touch_in_a_vertex_are_separated(heart):
    given = touching(heart)
    with pytest.raises(InputError, match=r"more than two triangles|touch themselves"):
        endocardia(given)
    found = separated_vertices(Anatomy(given, fibres=heart.fibres, own_mesh=True))
    assert "were doubled: 1 (" in found.notes[0]
    assert len(found.mesh.vertices) == len(given.vertices) + 1
    for before, after in zip(endocardia(labelled_mesh(heart)), endocardia(found.mesh), strict=True):
        assert len(after.triangles) == len(before.triangles)
    again = separated_vertices(found)
    assert again is found


SPACING = 4.0  # mm


def block(first, shape=(5, 5, 5), without=None):
    """Points (n, 3) and tetrahedra (m, 4) of a block of cubes from a corner (mm) on."""
    image = pv.ImageData(dimensions=np.add(shape, 1), spacing=[SPACING] * 3, origin=first)
    grid = image.cast_to_unstructured_grid()
    if without is not None:
        middle = (grid.cell_centers().points - first) / SPACING - 0.5
        grid = grid.extract_cells(~(np.abs(middle[:, :2] - without) < 0.5).all(axis=1))
    tetrahedra = grid.triangulate().cells_dict[TETRAHEDRON].astype(np.int64)
    turned = signed_volumes(grid.points, tetrahedra) < 0
    tetrahedra[turned] = tetrahedra[turned][:, [0, 2, 1, 3]]
    return without_unused_vertices(np.asarray(grid.points, dtype=float), tetrahedra)


def together(*blocks):
    """Blocks as one mesh, without common vertices."""
    starts = np.cumsum([0, *(len(points) for points, _ in blocks)])
    cells = np.concatenate([t + start for (_, t), start in zip(blocks, starts, strict=False)])
    triangles, _ = boundary_triangles(cells)
    points = np.concatenate([points for points, _ in blocks])
    return LabelledMesh(points, cells, triangles, np.zeros(len(triangles), dtype=np.int64))


@pytest.mark.parametrize(("gap", "volume"), [(-3.0, 14.8), (0.3, 16.12), (1.5, 16.6)])
def test_blocks(gap, volume):
    found = joined_pieces(together(block((0, 0, 0)), block((20 + gap, 0, 0))))
    assert igl.euler_characteristic(found.triangles) == 2
    assert closed_volume(found.vertices, found.triangles) / 1e3 == pytest.approx(volume, rel=0.01)
    assert "2 pieces" in found.notes[0]
    assert "16.0 ml before" in found.notes[0]


def test_a_gap_too_wide():
    words = r"\(7.\d+ ml about \(10.*, 7.\d+ ml about \(3.*\) are more than 2 mm"
    with pytest.raises(InputError, match=words):
        joined_pieces(together(block((0, 0, 0)), block((26.0, 0, 0))))


def test_a_channel_is_filled():
    found = joined_pieces(together(block((0, 0, 0), without=2), block((20.3, 0, 0))))
    assert igl.euler_characteristic(found.triangles) == 2
    assert closed_volume(found.vertices, found.triangles) / 1e3 == pytest.approx(16.1, rel=0.01)
    assert "filled" in found.notes[0]


def test_vertices_in_the_same_places_are_merged(tmp_path):
    mesh = together(block((0, 0, 0)), block((20, 0, 0)))
    given = MeshFile(tmp_path, mesh.vertices, {TETRAHEDRON: mesh.tetrahedra})
    merged, notes = with_common_vertices(given)
    tetrahedra = merged.cells[TETRAHEDRON]
    check_tetrahedra("merged", *without_unused_vertices(merged.points, tetrahedra))
    assert "2 pieces were joined at 36 vertices" in notes[0]
    apart = together(block((0, 0, 0)), block((20.1, 0, 0)))
    given = MeshFile(tmp_path, apart.vertices, {TETRAHEDRON: apart.tetrahedra})
    assert with_common_vertices(given) == (given, ())


@pytest.mark.slow
def test_ventricles_in_two_pieces(tmp_path):
    """The free wall of the right ventricle ends on the left one, half a mm away."""
    mesh = tissue()
    right = mesh.vertices[mesh.tetrahedra].mean(axis=1)[:, 0] > 38
    cells = mesh.tetrahedra.copy()
    cells[right] += len(mesh.vertices)
    points, cells = without_unused_vertices(
        np.concatenate([mesh.vertices, mesh.vertices + np.array([0.5, 0, 0])]), cells
    )
    assert pieces_of(cells, len(points)).max() == 1
    arrays = {"fibre": circular_fibres(mesh), "region": right.astype(np.int64)}
    write_grid(tmp_path / "heart.vtu", points, cells, TETRAHEDRON, {}, arrays)
    found = read_anatomy(Source(tmp_path / "heart.vtu"), 6.0)
    check_tetrahedra("joined", found.mesh.vertices, found.mesh.tetrahedra)
    volumes = signed_volumes(found.mesh.vertices, found.mesh.tetrahedra)
    assert volumes.sum() / 1e3 == pytest.approx(MYOCARDIUM, rel=0.04)
    assert set(found.mesh.labels) == {1, 2, 3, 4}
    cosine = np.abs(np.einsum("ij,ij->i", found.fibres, circular_fibres(found.mesh)))
    assert np.degrees(np.arccos(np.clip(np.percentile(cosine, 5), -1, 1))) < 15
    x = found.mesh.vertices[found.mesh.tetrahedra].mean(axis=1)[:, 0]
    assert ((found.mesh.regions == 1) == (x > 38)).mean() > 0.95
    with pytest.raises(InputError, match="remesh= does not apply to pieces that are joined"):
        read_anatomy(Source(tmp_path / "heart.vtu", remesh=True), 6.0)


@pytest.mark.slow
def test_a_dog(data_folder):
    file = data_folder / "hearts" / "dog007" / "mesh_hexahedra.vtu"
    if not file.is_file():
        pytest.skip(f"no {file}")
    found = read_anatomy(Source(file), 3.0)
    check_tetrahedra("dog007", found.mesh.vertices, found.mesh.tetrahedra)
    volumes = signed_volumes(found.mesh.vertices, found.mesh.tetrahedra)
    assert volumes.sum() / 1e3 == pytest.approx(124.1, rel=0.02)
    assert set(found.mesh.labels) == {1, 2, 3, 4}
    given = pv.read(file)
    nearest = given.find_closest_cell(found.mesh.vertices[found.mesh.tetrahedra].mean(axis=1))
    cosine = np.abs(np.einsum("ij,ij->i", found.fibres, given["fibre"][nearest]))
    assert np.median(cosine) > 0.98
