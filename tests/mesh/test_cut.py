"""Hexahedra, wedges and pyramids: cut into tetrahedra that share whole faces."""

import meshio
import numpy as np
import pytest
import pyvista as pv

from fascicle.core.errors import InputError
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE
from fascicle.mesh.read import read_mesh
from fascicle.mesh.topology import boundary_triangles, places_in

N = 4
CORNERS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
FACES = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
ROTATED = [range(8), (1, 2, 3, 0, 5, 6, 7, 4), (4, 0, 3, 7, 5, 1, 2, 6), (3, 2, 6, 7, 0, 1, 5, 4)]


def warped_blocks(rng):
    """Points (n, 3) and hexahedra (m, 8) of a cube of side 4, numbered and warped at random."""
    number = rng.permutation((N + 1) ** 3)
    points = np.empty((len(number), 3))
    points[number] = np.indices((N + 1,) * 3).reshape(3, -1).T + rng.uniform(-0.15, 0.15, (125, 3))
    grid = number.reshape((N + 1,) * 3)
    cells = [grid[i : i + N, j : j + N, k : k + N].ravel() for i, j, k in CORNERS]
    rotation = np.array(ROTATED)[rng.integers(4, size=N**3)]
    return points, np.take_along_axis(np.column_stack(cells), rotation, axis=1)


def saved(folder, points, cells, **arrays):
    grid = pv.UnstructuredGrid(cells, points)
    grid.cell_data.update(arrays)
    grid.save(folder / "blocks.vtu")
    return folder / "blocks.vtu"


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_share_faces(tmp_path, seed):
    points, cells = warped_blocks(np.random.default_rng(seed))
    mesh = read_mesh(saved(tmp_path, points, {12: cells}, number=np.arange(len(cells))))
    tetrahedra = mesh.cells[TETRAHEDRON]
    assert len(boundary_triangles(tetrahedra)[0]) == 2 * 6 * N**2  # inner faces pair off
    volumes = signed_volumes(points, tetrahedra)
    assert volumes.min() > 0
    parent = mesh.cell_data[TETRAHEDRON]["number"]
    own = np.array([np.isin(t, cells[k]).all() for t, k in zip(tetrahedra, parent, strict=True)])
    assert own.all()
    assert f"{N**3} hexahedra were cut into {len(tetrahedra)} tetrahedra" in mesh.notes[0]


def test_corners_that_coincide(tmp_path):
    points = np.array([[*at] for at in np.ndindex(3, 2, 2)], dtype=float)
    # the first block ends in an edge: its corners 0 and 1 are one, and so are 3 and 2
    cells = np.array([[4, 0, 2, 6, 5, 0, 2, 7], [8, 4, 6, 10, 9, 5, 7, 11]])
    tetrahedra = read_mesh(saved(tmp_path, points, {12: cells})).cells[TETRAHEDRON]
    assert signed_volumes(points, tetrahedra).min() > 0
    assert signed_volumes(points, tetrahedra).sum() == pytest.approx(1.5)
    assert len(boundary_triangles(tetrahedra)[0]) == 2 * 5 + 2 * 2 + 2


def test_wedges_and_pyramids_either_way_round(tmp_path):
    points = np.array([[*at] for at in np.ndindex(2, 2, 2)] + [[0.5, 0.5, 2.0]])
    wedges = np.array([[0, 4, 2, 1, 5, 3], [7, 5, 3, 6, 4, 2]])
    cells = {13: wedges, 14: np.array([[1, 5, 7, 3, 8]])}
    mesh = read_mesh(saved(tmp_path, points, cells, fibre=np.eye(3)))
    tetrahedra = mesh.cells[TETRAHEDRON]
    volumes = signed_volumes(points, tetrahedra)
    assert volumes.min() > 0
    assert np.bincount(mesh.cell_data[TETRAHEDRON]["fibre"].argmax(axis=1), volumes) == (
        pytest.approx([0.5, 0.5, 1 / 3])
    )
    assert len(boundary_triangles(tetrahedra)[0]) == 2 * 5 + 4


def test_gmsh_with_labelled_quadrangles(tmp_path):
    """Quadrangles of the boundary are cut like the hexahedra, and keep their groups."""
    points, cells = warped_blocks(np.random.default_rng(1))
    sides = np.concatenate([cells[:, side] for side in FACES])
    _, first, count = np.unique(np.sort(sides), axis=0, return_index=True, return_counts=True)
    outer = sides[first[count == 1]]
    groups = [np.ones(len(cells), int), 2 + np.arange(len(outer))]
    data = {"gmsh:physical": groups, "gmsh:geometrical": groups}
    blocks = meshio.Mesh(points, [("hexahedron", cells), ("quad", outer)], cell_data=data)
    meshio.gmsh.write(tmp_path / "a.msh", blocks, fmt_version="2.2", binary=False)
    mesh = read_mesh(tmp_path / "a.msh")
    by_vtk = read_mesh(saved(tmp_path, points, {12: cells})).cells[TETRAHEDRON]
    np.testing.assert_array_equal(mesh.cells[TETRAHEDRON], by_vtk)
    rows = places_in(boundary_triangles(by_vtk)[0], mesh.cells[TRIANGLE])
    assert sorted(rows) == list(range(2 * len(outer)))
    groups = mesh.cell_data[TRIANGLE]["gmsh:physical"]
    np.testing.assert_array_equal(groups, 2 + np.repeat(np.arange(len(outer)), 2))


@pytest.mark.parametrize("name", ["a.vtu", "a.msh"])
def test_quadratic_hexahedra(tmp_path, name):
    """Their corners; the points between them are not used."""
    points, cells = warped_blocks(np.random.default_rng(2))
    middles = np.zeros((12 * len(cells), 3))
    numbers = len(points) + np.arange(len(middles)).reshape(-1, 12)
    cells20 = [("hexahedron20", np.column_stack([cells, numbers]))]
    form = "vtu" if name == "a.vtu" else "gmsh"
    meshio.Mesh(np.concatenate([points, middles]), cells20).write(tmp_path / name, form)
    found = read_mesh(tmp_path / name).require(TETRAHEDRON, "tetrahedra")
    by_vtk = read_mesh(saved(tmp_path, points, {12: cells})).cells[TETRAHEDRON]
    np.testing.assert_array_equal(found, by_vtk)


def test_folded(tmp_path):
    points, cells = warped_blocks(np.random.default_rng(0))
    cells[5] = cells[5][[0, 2, 1, 3, 4, 5, 6, 7]]
    with pytest.raises(InputError, match=r"1 of 64 hexahedra are flat or folded.* \(first: 5 at "):
        read_mesh(saved(tmp_path, points, {12: cells}))


def test_quadratic_tetrahedra_and_wire_frames_are_read(data_folder):
    """Of quadratic cells the corners; of a PLY file with edges, as of Blender, the faces."""
    mesh = read_mesh(data_folder / "cases" / "quadratic.vtu")
    tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    assert tetrahedra.shape == (4814, 4)
    assert (signed_volumes(mesh.points, tetrahedra) > 0).all()
    surface = read_mesh(data_folder / "cases" / "ply_edges.ply")
    assert len(surface.require(TRIANGLE, "triangles"))
