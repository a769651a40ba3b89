"""Pieces of tissue without common vertices: joined where they touch, refused where they do not."""

import igl
import numpy as np
import pytest
import pyvista as pv

from fascicle.build.mesh_repair import joined_pieces, with_common_vertices
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.checks import check_tetrahedra
from fascicle.mesh.measures import closed_volume, signed_volumes
from fascicle.mesh.mesh_file import TETRAHEDRON, MeshFile
from fascicle.mesh.topology import boundary_triangles, pieces_of, without_unused_vertices
from fascicle.mesh.vtk import write_grid
from tests.anatomies import MYOCARDIUM, circular_fibres, tissue

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


def test_a_channel():
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
@pytest.mark.parametrize(("name", "volume"), [("dog006", 162.5), ("dog007", 124.1)])
def test_dogs(data_folder, name, volume):
    file = data_folder / "hearts" / name / "mesh_hexahedra.vtu"
    if not file.is_file():
        pytest.skip(f"no {file}")
    found = read_anatomy(Source(file), 3.0)
    check_tetrahedra(name, found.mesh.vertices, found.mesh.tetrahedra)
    volumes = signed_volumes(found.mesh.vertices, found.mesh.tetrahedra)
    assert volumes.sum() / 1e3 == pytest.approx(volume, rel=0.02)
    assert set(found.mesh.labels) == {1, 2, 3, 4}
    given = pv.read(file)
    nearest = given.find_closest_cell(found.mesh.vertices[found.mesh.tetrahedra].mean(axis=1))
    cosine = np.abs(np.einsum("ij,ij->i", found.fibres, given["fibre"][nearest]))
    assert np.median(cosine) > 0.98
