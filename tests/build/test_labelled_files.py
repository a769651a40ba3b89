"""Files of labelled surfaces, and labels derived from the endocardia alone."""

from __future__ import annotations

import anatomies
import igl
import meshio
import numpy as np
import pytest
from anatomies import BASE, EPI, LV, RV, ventricles, write_surface
from shapes import read_labelled_surface

from fascicle.build.build_heart import heart_of
from fascicle.build.labelled_files import Anatomy, has_labels
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, labelled_mesh
from fascicle.mesh.read import read_mesh
from fascicle.mesh.topology import boundary_loops, places_in, unique_edges


def test_whole_numbers_are_labels_by_name_only(tmp_path):
    labels = ventricles().labels
    path = write_surface(tmp_path / "heart.vtk", patch=labels, RegionId=np.zeros(len(labels), int))
    assert not has_labels(read_mesh(path))
    with pytest.raises(InputError, match=r"\(arrays: RegionId, patch\); name .*label_array="):
        read_labelled_surface(path)
    assert (read_labelled_surface(path, array="patch").labels == labels).all()
    for name in ("class", "Label", "surface"):
        arrays = {name: labels, "other": np.arange(len(labels))}
        path = write_surface(tmp_path / f"{name}.vtk", **arrays)
        assert has_labels(read_mesh(path))
        surface = read_labelled_surface(path)
        assert (surface.labels == labels).all()
        assert surface.name == str(path)


def test_names_of_physical_groups(tmp_path):
    labels, path = ventricles().labels, tmp_path / "heart.msh"
    names = ("base", "epi", "LV endo", "right ventricle")
    groups = {name: np.array([number, 2]) for number, name in enumerate(names, 11)}
    data = {key: [labels + 10] for key in ("gmsh:physical", "gmsh:geometrical")}
    cells = [("triangle", ventricles().triangles)]
    mesh = meshio.Mesh(ventricles().vertices, cells, cell_data=data, field_data=groups)
    meshio.gmsh.write(path, mesh, fmt_version="2.2", binary=True)
    assert has_labels(read_mesh(path))
    assert (read_labelled_surface(path).labels == labels).all()


def test_own_numbers_are_translated_even_if_they_exchange_the_default_ones(tmp_path):
    own = np.array([0, 10, 20, 30, 40])[ventricles().labels]
    path = write_surface(tmp_path / "heart.vtp", label=own)
    numbers = {"base": 10, "epicardium": 20, "lv": 30, "rv": 40}
    assert (read_labelled_surface(path, names=numbers).labels == ventricles().labels).all()
    with pytest.raises(InputError, match=rf"40 \({(own == 40).sum()} times\); known are"):
        read_labelled_surface(path, names={k: v for k, v in numbers.items() if k != "rv"})
    with pytest.raises(InputError, match="two meanings"):
        read_labelled_surface(path, names={"lv": 10, "rv": 10})
    shorter = {"BASE": 10, "epi": 20, "lv_endo": 30, "Right ventricle": 40}
    assert (read_labelled_surface(path, names=shorter).labels == ventricles().labels).all()
    with pytest.raises(InputError, match=r"as in labels= base=1,epicardium=2,lv=3,rv=4$"):
        read_labelled_surface(path)
    with pytest.raises(InputError, match="unknown 'apex'; the parts are base, epicardium, lv"):
        read_labelled_surface(path, names={"apex": 10})
    labels = ventricles().labels
    exchanged = np.where(labels == 3, 4, np.where(labels == 4, 3, labels))
    path = write_surface(tmp_path / "heart.vtp", label=exchanged)
    assert (read_labelled_surface(path, names={"lv": 4, "rv": 3}).labels == labels).all()


def test_labels_of_points_of_the_mean_heart(data_folder):
    surface = read_labelled_surface(data_folder / "hearts" / "cobiveco-geo1" / "heart.vtp")
    for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.EPICARDIUM):
        assert len(boundary_loops(surface.having(label))) == 1
    lv, outer, rv = (
        set(map(tuple, unique_edges(surface.having(label))[0].tolist()))
        for label in (Label.LV_ENDOCARDIUM, Label.EPICARDIUM, Label.RV_ENDOCARDIUM)
    )
    assert not (lv | rv) & outer


def test_endocardia_in_register_are_found_exactly():
    mesh = anatomies.tissue()
    found = labelled_mesh(heart_of(Anatomy(mesh)))
    assert len(found.triangles) == len(mesh.triangles)
    right = mesh.labels[places_in(found.triangles, mesh.triangles)]
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
