"""A custom mesh: repaired where it touches itself, or remeshed inside."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import circular_fibres, halves, tissue

from fascicle.build.labelled_files import Anatomy
from fascicle.build.mesh_repair import repaired_edges
from fascicle.build.meshing import mean_axes, remeshed_anatomy
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.checks import check_tetrahedra
from fascicle.mesh.measures import closed_volume, quality, signed_volumes
from fascicle.mesh.topology import TETRAHEDRON_EDGES, boundary_triangles, places_in, unique_edges


@pytest.fixture(scope="module")
def flat():
    """The ventricles with some inner vertices nearly on a face opposite to them."""
    mesh = tissue()
    vertices = mesh.vertices.copy()
    inside = np.setdiff1d(np.arange(len(vertices)), mesh.triangles)
    rng = np.random.default_rng(1)
    for vertex in rng.choice(inside, 12, replace=False):
        star = mesh.tetrahedra[(mesh.tetrahedra == vertex).any(axis=1)]
        face = star[0][star[0] != vertex]
        before = vertices[vertex].copy()
        vertices[vertex] += 0.98 * (vertices[face].mean(axis=0) - before)
        if (signed_volumes(vertices, star) <= 0).any():
            vertices[vertex] = before
    made = replace(mesh, vertices=vertices, regions=halves(mesh).astype(np.int64))
    return Anatomy(made, fibres=circular_fibres(made), own_mesh=True)


def test_flat_elements_go_and_all_else_stays(flat):
    found = remeshed_anatomy(flat)
    before, after = (
        quality(a.mesh.vertices, a.mesh.tetrahedra).angles.min() for a in (flat, found)
    )
    assert before < 2
    assert after > 8
    assert f"{before:.1f} degrees before, {after:.1f} after" in found.notes[-1]
    for label in set(flat.mesh.labels):
        one, other = (
            {tuple(row) for row in a.mesh.vertices[a.mesh.having(label)].mean(axis=1).round(6)}
            for a in (flat, found)
        )
        assert one == other
    # the same rule written down on the new mesh, up to sign
    cosine = np.abs(np.einsum("ij,ij->i", found.fibres, circular_fibres(found.mesh)))
    assert np.degrees(np.arccos(np.clip(np.percentile(cosine, 5), -1, 1))) < 12
    assert (found.mesh.regions == halves(found.mesh)).mean() > 0.95
    assert np.linalg.norm(found.fibres, axis=1) == pytest.approx(1)


def test_axes_have_no_sign():
    directions = np.array([[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [-0.6, 0.8, 0.0]]])
    assert mean_axes(directions, np.array([[1.0, 1.0, 0.0]]))[0] == pytest.approx([1, 0, 0])
    between = mean_axes(directions[:, 1:], np.ones((1, 2)))[0]
    assert between == pytest.approx(np.array([-1.6, 0.8, 0]) / np.hypot(1.6, 0.8))


def test_dti004(data_folder):
    source = data_folder / "hearts" / "dti004" / "mesh.vtu"
    found = read_anatomy(Source(source, remesh=True), 2.0)
    assert quality(found.mesh.vertices, found.mesh.tetrahedra).angles.min() > 6
    assert "0.2 degrees before" in found.notes[-1]
    assert len(found.fibres) == len(found.mesh.tetrahedra)


def gapped(edges):
    """The ventricles, less tetrahedra around some edges, so that the rest meet in the edges."""
    whole = tissue()
    pairs = np.unique(np.sort(whole.tetrahedra[:, TETRAHEDRON_EDGES].reshape(-1, 2)), axis=0)
    pairs = pairs[~np.isin(pairs, whole.triangles).any(axis=1)]
    drop, busy = [], np.zeros(len(whole.vertices), dtype=bool)
    for pair in np.random.default_rng(4).permutation(pairs):
        around = np.flatnonzero(np.isin(whole.tetrahedra, pair).sum(axis=1) == 2)
        star = whole.tetrahedra[around]
        apart = np.flatnonzero(np.isin(star, star[0]).sum(axis=1) == 2)  # not face to face with it
        if len(drop) < 2 * edges and len(around) > 4 and apart.size and not busy[star].any():
            drop += [around[0], around[apart[0]]]
            near = np.isin(whole.tetrahedra, star).any(axis=1)
            busy[whole.tetrahedra[near]] = True
    keep = np.setdiff1d(np.arange(len(whole.tetrahedra)), drop)
    tetrahedra = whole.tetrahedra[keep]
    triangles, _ = boundary_triangles(tetrahedra)
    at = places_in(triangles, whole.triangles)
    labels = np.where(at < 0, Label.EPICARDIUM, whole.labels[at])
    mesh = LabelledMesh(
        whole.vertices, tetrahedra, triangles, labels, halves(whole)[keep].astype(np.int64), "gap"
    )
    return Anatomy(mesh, fibres=circular_fibres(whole)[keep], own_mesh=True)


def crowded(mesh):
    return int((unique_edges(mesh.triangles)[1] > 2).sum())


def test_few_edges_are_repaired_and_all_else_stays():
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
    # only the gaps next to an edge grow
    assert volumes[1].sum() == pytest.approx(volumes[0].sum(), rel=2e-3)
    assert volumes[1].sum() < volumes[0].sum()
    enclosed = closed_volume(found.mesh.vertices, found.mesh.triangles)
    assert enclosed == pytest.approx(volumes[1].sum())
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
