"""Meshing the inside of a mesh again: no flat elements, the surface and what it carries stay."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.build.anatomy import Anatomy, Source
from fascicle.build.read_anatomy import read_anatomy
from fascicle.build.volume_meshing import mean_axes, remeshed_anatomy
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.quality import quality
from tests.anatomies import circular_fibres, halves, tissue


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


def test_flat_elements_go_and_the_surface_stays(flat):
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


def test_fibres_and_regions_are_carried_over(flat):
    found = remeshed_anatomy(flat)
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
