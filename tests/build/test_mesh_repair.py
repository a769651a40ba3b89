"""Tetrahedra that meet in an edge alone are drawn apart; nothing else changes."""

import numpy as np
import pytest

from fascicle.build.anatomy import Anatomy
from fascicle.build.volume_meshing import repaired_edges
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.heart.validate import check_tetrahedra
from fascicle.mesh.measures import closed_volume, signed_volumes
from fascicle.mesh.topology import boundary_triangles, unique_edges
from tests.anatomies import circular_fibres, halves, tissue


def gapped(edges):
    """The ventricles, less tetrahedra around some edges, so that the rest meet in the edges."""
    whole = tissue()
    inside = np.setdiff1d(np.arange(len(whole.vertices)), whole.triangles)
    rng = np.random.default_rng(4)
    drop, busy = [], np.zeros(len(whole.vertices), dtype=bool)
    for vertex in rng.permutation(inside):
        if len(drop) == 2 * edges:
            break
        near = whole.tetrahedra[(whole.tetrahedra == vertex).any(axis=1)]
        for other in np.setdiff1d(near, [vertex]):
            around = np.flatnonzero(np.isin(whole.tetrahedra, [vertex, other]).sum(axis=1) == 2)
            star = whole.tetrahedra[around]
            if busy[star].any() or other not in inside or len(around) < 5:
                continue
            first = star[0]
            shared = np.array([len(np.intersect1d(first, row)) for row in star])
            apart = np.flatnonzero(shared == 2)  # not face to face with the first
            if apart.size:
                drop += [around[0], around[apart[0]]]
                busy[np.unique(whole.tetrahedra[np.isin(whole.tetrahedra, star).any(axis=1)])] = (
                    True
                )
                break
    keep = np.setdiff1d(np.arange(len(whole.tetrahedra)), drop)
    tetrahedra = whole.tetrahedra[keep]
    triangles, _ = boundary_triangles(tetrahedra)
    rows = {tuple(sorted(row)): k for k, row in enumerate(whole.triangles.tolist())}
    at = [rows.get(tuple(sorted(row)), -1) for row in triangles.tolist()]
    labels = np.where(np.array(at) < 0, Label.EPICARDIUM, whole.labels[at])
    mesh = LabelledMesh(
        whole.vertices, tetrahedra, triangles, labels, halves(whole)[keep].astype(np.int64), "gap"
    )
    return Anatomy(mesh, fibres=circular_fibres(whole)[keep], own_mesh=True)


def crowded(mesh):
    return int((unique_edges(mesh.triangles)[1] > 2).sum())


def test_few_edges_are_repaired_and_nothing_is_lost():
    given = gapped(1)
    edges = crowded(given.mesh)
    assert 1 <= edges <= 2
    found = repaired_edges(given)
    assert crowded(found.mesh) == 0
    assert f"{edges} of" in found.notes[-1]
    check_tetrahedra("repaired", found.mesh.vertices, found.mesh.tetrahedra)
    volumes = [
        signed_volumes(anatomy.mesh.vertices, anatomy.mesh.tetrahedra) for anatomy in (given, found)
    ]
    # only the gaps beside an edge become larger
    assert volumes[1].sum() == pytest.approx(volumes[0].sum(), rel=2e-3)
    assert volumes[1].sum() < volumes[0].sum()
    assert closed_volume(found.mesh.vertices, found.mesh.triangles) == pytest.approx(
        volumes[1].sum()
    )


def test_fibres_regions_and_labels_stay_where_they_were():
    given = gapped(1)
    found = repaired_edges(given)
    before, after = (
        anatomy.mesh.vertices[anatomy.mesh.tetrahedra].mean(axis=1) for anatomy in (given, found)
    )
    number = {tuple(row): k for k, row in enumerate(before.tolist())}
    same = np.array([number.get(tuple(row), -1) for row in after.tolist()])
    assert (same < 0).sum() < 40
    assert np.array_equal(found.fibres[same >= 0], given.fibres[same[same >= 0]])
    assert np.array_equal(found.mesh.regions[same >= 0], given.mesh.regions[same[same >= 0]])
    for label in set(given.mesh.labels) - {Label.EPICARDIUM}:
        assert len(found.mesh.having(label)) == len(given.mesh.having(label))


def test_many_edges_and_none_are_left_alone():
    sound = Anatomy(tissue(), own_mesh=True)
    assert repaired_edges(sound) is sound
    many = gapped(12)
    assert crowded(many.mesh) > max(2, 1e-3 * len(unique_edges(many.mesh.triangles)[0]))
    assert repaired_edges(many) is many
