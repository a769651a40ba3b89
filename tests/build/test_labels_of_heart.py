"""Labels of a boundary derived from the endocardia alone, against the known ones."""

from __future__ import annotations

import anatomies
import igl
import numpy as np
import pytest
from anatomies import BASE, EPI, LV, RV

from fascicle.build.build_heart import heart_of
from fascicle.build.labelled_files import Anatomy
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


def test_endocardia_in_register_are_found_exactly(heart):
    found = labelled_mesh(heart)
    right = known_labels(found)
    for label in (LV, RV):
        np.testing.assert_array_equal(found.labels == label, right == label)
        assert len(boundary_loops(found.having(label))) == 1
    area = igl.doublearea(found.vertices, found.triangles)
    for label in (BASE, EPI):
        same = (right == label) & (found.labels == label)
        assert area[same].sum() > 0.97 * area[right == label].sum()


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
