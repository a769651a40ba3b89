"""From a labelled surface, coarse ones subdivided, to tetrahedra: volume, labels, determinism."""

from __future__ import annotations

import igl
import numpy as np
import pytest
from anatomies import write_surface
from shapes import (
    RV_WALL,
    biventricular_surface,
    exact_volume,
    in_mesh,
    read_labelled_surface,
    volume_of,
)

from fascicle.build import meshing
from fascicle.build.endocardia import endocardia
from fascicle.build.meshing import check_memory, mesh_surface, subdivided, without_short_edges
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.build.surface_checks import wall_thickness
from fascicle.build.surface_repair import prepared_surface
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import oriented_into_cavity
from fascicle.heart.labelled_surface import (
    ENDOCARDIA,
    NEEDED_LABELS,
    Label,
    LabelledMesh,
    LabelledSurface,
)
from fascicle.mesh.measures import (
    mean_edge_length,
    quality,
    self_intersections,
    signed_volumes,
    triangle_areas,
    triangle_normals,
)
from fascicle.mesh.meshing import Interface, tetrahedralise
from fascicle.mesh.topology import boundary_loops, boundary_triangles

EDGE = 3.3  # mm
# A surface much coarser than the wanted edge
POINTS, SCALE = 257, 1.3
TARGET_EDGE = 4.0  # mm


@pytest.fixture(scope="module")
def surface() -> LabelledSurface:
    return prepared_surface(biventricular_surface(4.0))


@pytest.fixture(scope="module")
def mesh(surface) -> LabelledMesh:
    return mesh_surface(surface, EDGE)


def test_tetrahedra_have_the_exact_volume_and_edges_of_the_requested_length(mesh, surface):
    found = quality(mesh.vertices, mesh.tetrahedra)
    assert found.volumes.min() > 0
    assert found.volumes.sum() == pytest.approx(volume_of(surface), rel=0.01)
    assert found.volumes.sum() == pytest.approx(exact_volume(), rel=0.02)
    assert found.edges.mean() == pytest.approx(EDGE, rel=0.05)
    assert found.angles.min() > 8
    assert (found.angles < 10).mean() < 1e-3
    assert np.median(found.angles) > 40
    boundary, _ = boundary_triangles(mesh.tetrahedra)
    assert {*map(frozenset, boundary.tolist())} == {*map(frozenset, mesh.triangles.tolist())}
    outside = LabelledSurface(mesh.vertices, mesh.triangles, mesh.labels)
    assert volume_of(outside) == pytest.approx(found.volumes.sum(), rel=1e-9)


def test_labels_and_walls_stay_as_they_were(mesh, surface):
    for label in NEEDED_LABELS:
        before, after = (
            np.linalg.norm(triangle_normals(tissue.vertices, tissue.having(label)), axis=1).sum()
            for tissue in (surface, mesh)
        )
        assert after == pytest.approx(before, rel=0.03)
        assert len(boundary_loops(mesh.having(label))) == (3 if label == Label.BASE else 1)
    before, after = (list(map(np.median, wall_thickness(tissue))) for tissue in (surface, mesh))
    assert after == pytest.approx(before, rel=0.03)
    assert after[2] == pytest.approx(RV_WALL, rel=0.05)


def test_the_endocardia_are_disks_in_register_with_the_mesh(mesh):
    for side, label in zip(endocardia(mesh), ENDOCARDIA, strict=True):
        assert (side.vertices == mesh.vertices[in_mesh(mesh, side)]).all()
        assert not side.valve.any()
        own = np.sort(in_mesh(mesh, side)[side.triangles], axis=1)
        assert {*map(tuple, own)} == {*map(tuple, np.sort(mesh.having(label), axis=1))}
        again = oriented_into_cavity(side.vertices, side.triangles, "endocardium")
        assert (again == side.triangles).all()


def test_the_same_surface_gives_the_same_mesh_and_nothing_is_printed(mesh, surface, capfd):
    again = mesh_surface(surface, EDGE)
    assert capfd.readouterr().out == ""
    assert np.array_equal(again.vertices, mesh.vertices)
    assert np.array_equal(again.tetrahedra, mesh.tetrahedra)
    assert np.array_equal(again.labels, mesh.labels)


def test_a_surface_that_cannot_be_filled_is_refused_in_one_line(capfd):
    corners = 10 * np.vstack([np.zeros(3), np.eye(3)])
    inside_out = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    words = r"^h\.vtk: inside: 100.00% could not be filled .* \(.+ domain 1\); smooth it$"
    with pytest.raises(InputError, match=words):
        tetrahedralise([Interface(corners, inside_out)], "h.vtk: inside", "smooth it", maxh=EDGE)
    assert capfd.readouterr() == ("", "")


def test_an_edge_length_that_would_not_fit_in_memory_is_refused(surface, monkeypatch):
    check_memory(surface, 2.0)
    monkeypatch.setattr(meshing, "available_memory", lambda: 1e9)
    with pytest.raises(InputError, match=r"2\.8e\+05 vertices, .* 1\.7 GB and 1\.0 GB are free"):
        check_memory(surface, 1.0)
    with pytest.raises(InputError, match="must be above 0"):
        check_memory(surface, 0.0)


def test_short_edges_are_closed_up_and_the_surface_stays_closed(surface):
    shortened = without_short_edges(surface, 1.0)
    corners = shortened.vertices[shortened.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert len(shortened.vertices) < 0.95 * len(surface.vertices)
    assert (lengths < 1.0).mean() < 0.002
    assert boundary_loops(shortened.triangles) == []
    assert volume_of(shortened) == pytest.approx(volume_of(surface), rel=2e-3)
    assert len(shortened.vertices) - len(shortened.triangles) / 2 == 2  # Euler: a sphere


def test_a_real_surface_is_too_thin_for_3_mm(data_folder):
    surface = read_labelled_surface(data_folder / "hearts" / "cobiveco-geo1" / "heart.vtp")
    with pytest.raises(InputError, match=r"3 mm is too coarse .* 3 mm thick .* give 2\.11 mm"):
        mesh_surface(prepared_surface(surface), 3.0)


@pytest.fixture(scope="module")
def fine():
    surface = biventricular_surface(3.0)
    outwards = surface.triangles[:, ::-1]
    return LabelledSurface(SCALE * surface.vertices, outwards, surface.labels, "fine")


@pytest.fixture(scope="module")
def coarse(fine):
    """The same ventricles with 257 points, as programs that simulate ECGs ship them."""
    vertices, triangles, born, _ = igl.qslim(fine.vertices, fine.triangles, 2 * POINTS - 4, True)
    made = LabelledSurface(
        np.asarray(vertices), np.asarray(triangles, np.int64), fine.labels[born], "coarse"
    )
    assert len(made.vertices) == POINTS
    return made


def distances(fine, surface):
    """From the true surface's vertices (mm), but for those within 8 mm of its sharp rim."""
    deep = fine.vertices[fine.vertices[:, 2] < fine.vertices[:, 2].max() - 8.0]
    return np.sqrt(igl.point_mesh_squared_distance(deep, surface.vertices, surface.triangles)[0])


def test_smooth_and_of_the_same_volume(fine, coarse):
    finer, note = subdivided(coarse, TARGET_EDGE)
    assert mean_edge_length(finer.vertices, finer.triangles) <= 1.1 * 2 * TARGET_EDGE
    assert volume_of(finer) == pytest.approx(volume_of(coarse), rel=1e-4)
    assert not len(self_intersections(finer.vertices, finer.triangles))
    assert "subdivided 2 times (Loop)" in note
    # plain Loop subdivision, which this corrects, comes to lie 0.9 mm inside
    loop = igl.loop(coarse.vertices, coarse.triangles, 2)
    plain = LabelledSurface(*loop, np.repeat(coarse.labels, 16))
    assert volume_of(plain) < 0.98 * volume_of(coarse)
    assert distances(fine, finer).mean() < 0.7 * distances(fine, plain).mean()
    assert distances(fine, finer).mean() < distances(fine, coarse).mean()


def test_each_part_keeps_its_label_and_nearly_its_area(coarse):
    finer, _ = subdivided(coarse, TARGET_EDGE)
    areas = [
        [triangle_areas(s.vertices, s.having(label)).sum() for label in NEEDED_LABELS]
        for s in (coarse, finer)
    ]
    assert np.allclose(*areas, rtol=0.1)
    middle = coarse.vertices[coarse.triangles].mean(axis=1)
    nearest = igl.point_mesh_squared_distance(middle, finer.vertices, finer.triangles)[1]
    assert (finer.labels[nearest] == coarse.labels).mean() > 0.97


@pytest.mark.parametrize("labelled", [True, False])
def test_it_becomes_a_mesh_with_a_note(tmp_path, coarse, labelled):
    arrays = {"class": coarse.labels} if labelled else {}
    path = write_surface(tmp_path / "h.vtp", coarse.vertices, coarse.triangles, **arrays)
    anatomy = read_anatomy(Source(path), TARGET_EDGE)
    assert "subdivided 2 times (Loop)" in anatomy.notes[0]
    mesh = anatomy.mesh
    volume = signed_volumes(mesh.vertices, mesh.tetrahedra).sum()
    assert volume == pytest.approx(volume_of(coarse), rel=0.01)
    assert quality(mesh.vertices, mesh.tetrahedra).angles.min() > 8.0
    assert set(mesh.labels) == set(NEEDED_LABELS)
