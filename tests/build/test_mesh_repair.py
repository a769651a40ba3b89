"""Tetrahedra of a file: voids are filled, crumbs left out, vertices that touch doubled."""

from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest
from scipy.spatial import cKDTree

from fascicle.build.endocardia import endocardia
from fascicle.build.labelled_files import Anatomy
from fascicle.build.mesh_repair import repaired_mesh, separated_vertices
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import labelled_mesh
from fascicle.mesh.checks import check_tetrahedra
from fascicle.mesh.measures import closed_volume, signed_volumes
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.topology import boundary_triangles, places_in, without_unused_vertices
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
    wanted = {"one": 4, "two": 3, "edge": 2, "vertex": 1}[which]
    other = np.flatnonzero(count == wanted)[0]
    return (1 if wanted > 2 else 2), np.unique([chosen, other])


@pytest.mark.parametrize("which", ["one", "two", "edge", "vertex", "star"])
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


@pytest.mark.parametrize("by", ["vertex", "edge", "nothing"])
@pytest.mark.parametrize("count", [1, 2])
def test_crumbs_are_left_out(heart, by, count):
    number = {"vertex": 1, "edge": 2, "nothing": 0}[by]
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
