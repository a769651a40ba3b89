"""Labels of a boundary told from the endocardia alone, against those that are known."""

from __future__ import annotations

from dataclasses import replace

import anatomies
import igl
import numpy as np
import pytest
from anatomies import BASE, EPI, LV, RV

from fascicle.build.anatomy import Anatomy
from fascicle.build.build_heart import heart_of
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.labelled_surface import LabelledMesh, labelled_mesh
from fascicle.mesh.topology import boundary_loops


@pytest.fixture(scope="module")
def heart():
    return heart_of(Anatomy(anatomies.tissue()))


def known_labels(found: LabelledMesh) -> np.ndarray:
    """The true label of each triangle found, which may come in another order."""
    mesh = anatomies.tissue()
    known = {
        tuple(row): label for row, label in zip(np.sort(mesh.triangles), mesh.labels, strict=True)
    }
    assert len(known) == len(found.triangles)
    return np.array([known[tuple(row)] for row in np.sort(found.triangles)])


def shares(mesh, right) -> dict[int, float]:
    """The share of the area of each true label that was given that label."""
    area = igl.doublearea(mesh.vertices, mesh.triangles)
    return {
        label: area[(right == label) & (mesh.labels == label)].sum() / area[right == label].sum()
        for label in (BASE, EPI, LV, RV)
    }


def test_endocardia_in_register_are_found_exactly(heart):
    found = labelled_mesh(heart)
    right = known_labels(found)
    for label in (LV, RV):
        np.testing.assert_array_equal(found.labels == label, right == label)
        assert len(boundary_loops(found.having(label))) == 1
    assert min(shares(found, right).values()) > 0.97


def test_triangles_face_out_of_the_tissue(heart):
    found = labelled_mesh(heart)
    a, b, c = found.vertices[found.triangles].transpose(1, 0, 2)
    enclosed = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert enclosed == pytest.approx(heart.volumes.sum(), rel=1e-9)


def test_regions_name_and_mesh_are_the_heart_s(heart):
    regions = anatomies.halves(anatomies.tissue())
    found = labelled_mesh(replace(heart, regions=regions, name="mine"))
    assert found.name == "mine"
    np.testing.assert_array_equal(found.regions, regions)
    np.testing.assert_array_equal(found.tetrahedra, heart.tetrahedra)


def of_its_own(side: str, label) -> Endocardium:
    """An endocardium with triangles of its own, on the exact ellipsoid."""
    points, faces = anatomies.half_ellipsoid(label)
    return Endocardium(side, points, np.ascontiguousarray(faces[:, ::-1]), 0, 1)


def test_endocardia_that_are_no_part_of_the_mesh(heart):
    apart = replace(heart, lv=of_its_own("lv", LV), rv=of_its_own("rv", RV))
    found = labelled_mesh(apart)
    assert min(shares(found, known_labels(found)).values()) > 0.9


def test_it_does_not_matter_where_the_heart_lies(heart):
    turn = np.linalg.qr(np.array([[0.8, -0.4, 0.45], [0.5, 0.85, -0.15], [-0.3, 0.35, 0.9]]))[0]

    def moved(points):
        return points @ turn.T + np.array([300.0, -40.0, 1000.0])

    elsewhere = replace(
        heart,
        vertices=moved(heart.vertices),
        lv=replace(heart.lv, vertices=moved(heart.lv.vertices)),
        rv=replace(heart.rv, vertices=moved(heart.rv.vertices)),
    )
    np.testing.assert_array_equal(labelled_mesh(elsewhere).labels, labelled_mesh(heart).labels)


@pytest.mark.parametrize("which", ["default_heart", "crtdemo"])
def test_hearts_of_people(which, request):
    """Each endocardium has the area that the heart's own surface has, and base is between."""
    person = request.getfixturevalue(which)
    found = labelled_mesh(person)
    area = igl.doublearea(found.vertices, found.triangles) / 2
    for label, endocardium in ((LV, person.lv), (RV, person.rv)):
        wall = endocardium.triangles
        if endocardium.valves is not None:
            wall = wall[~endocardium.valves]
        own = igl.doublearea(endocardium.vertices, wall).sum() / 2
        assert area[found.labels == label].sum() == pytest.approx(own, rel=0.1)
    share = area[found.labels == BASE].sum() / area.sum()
    assert 0.01 < share < 0.15
