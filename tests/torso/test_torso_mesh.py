from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from anatomies import body
from block_heart import CUBE, HEART_CENTRE, LV, RV, block_heart, lung, skin

from fascicle.core.errors import InputError
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.measures import intersections, signed_volumes
from fascicle.mesh.topology import boundary_triangles
from fascicle.torso.conductor import mesh_torso
from fascicle.torso.surfaces import Surface, check_within

CUBES = [np.prod(np.subtract(high, low)) for low, high in (LV, RV)]


@pytest.fixture(scope="module")
def heart():
    return block_heart()


@pytest.fixture(scope="module")
def reported() -> list[tuple[int, int]]:
    return []


@pytest.fixture(scope="module")
def torso(heart, reported):
    return mesh_torso(heart, skin(), [lung(1), lung(-1)], lambda *step: reported.append(step))


def volume_of(torso, tissue) -> float:
    volumes = signed_volumes(torso.vertices, torso.tetrahedra)
    return float(volumes[torso.tissues == tissue].sum())


def keys(triangles) -> set[tuple[int, ...]]:
    return set(map(tuple, np.sort(triangles, axis=1).tolist()))


def test_fills_the_torso_around_the_heart(heart, torso, reported):
    outside = signed_volumes(torso.vertices, torso.tetrahedra)
    assert outside.min() > 0
    whole = outside.sum() + signed_volumes(heart.vertices, heart.tetrahedra).sum()
    assert whole / 1e6 == pytest.approx(skin().litres, rel=1e-9)
    assert reported == [(0, 2), (1, 2), (2, 2)]


def test_conforms_to_heart_and_skin(heart, torso):
    np.testing.assert_array_equal(torso.vertices[: len(heart.vertices)], heart.vertices)
    boundary, _ = boundary_triangles(torso.tetrahedra)
    assert keys(heart.triangles) <= keys(boundary)
    assert len(boundary) == len(heart.triangles) + len(skin().triangles)
    # and together they leave no boundary but the skin
    both, _ = boundary_triangles(np.concatenate([heart.tetrahedra, torso.tetrahedra]))
    assert len(both) == len(skin().triangles)


def test_tissues_have_their_volumes(torso):
    assert set(np.unique(torso.tissues)) == set(map(int, TorsoTissue))
    lungs = lung(1).litres + lung(-1).litres
    assert volume_of(torso, TorsoTissue.LUNG) / 1e6 == pytest.approx(lungs, rel=1e-9)
    # the lid is known to the size of the tetrahedra, and those here are as large as the cubes
    assert volume_of(torso, TorsoTissue.BLOOD) == pytest.approx(sum(CUBES) * CUBE**3, rel=0.04)


def test_blood_lies_in_the_cavities(torso):
    centres = (
        torso.vertices[torso.tetrahedra].mean(axis=1)[torso.tissues == TorsoTissue.BLOOD] / CUBE
    )
    inside = [((centres > low) & (centres < high)).all(axis=1) for low, high in (LV, RV)]
    assert np.any(inside, axis=0).all()


def shifted(surface: Surface, by) -> Surface:
    return Surface(surface.vertices + np.asarray(by, dtype=float), surface.triangles)


def dented() -> Surface:
    """A skin whose left pole is pulled out through its right side."""
    surface = skin()
    vertices = surface.vertices.copy()
    vertices[np.argmax(vertices[:, 0]), 0] = -300.0
    return Surface(vertices, surface.triangles)


def one_turned() -> Surface:
    triangles = skin().triangles.copy()
    triangles[5] = triangles[5, ::-1]
    return Surface(skin().vertices, triangles)


@pytest.mark.parametrize(
    ("body", "lungs", "message"),
    [
        (Surface(skin().vertices / 10, skin().triangles), [], "seems to be in centimetres"),
        (Surface(skin().vertices, skin().triangles[1:]), [], r"torso: 3 of \d+ edges are open"),
        (Surface(skin().vertices, skin().triangles[:, ::-1]), [], "inside out"),
        (one_turned(), [], "wound against each other"),
        (shifted(skin(), [500, 0, 0]), [], "block: lies outside the torso, 31. mm from its skin"),
        (shifted(skin(), [0, 95, 0]), [], r"block: pokes \d+\.\d mm through the torso's skin at"),
        (dented(), [], r"torso: the surface crosses itself in \d+ pairs .*first: "),
        (skin(), [shifted(lung(), [-20, 0, 0])], r"lung 1: overlaps block by \d\.\d mm at"),
        (skin(), [shifted(lung(), [40, 0, 0])], r"lung 1: pokes \d+\.\d mm through the torso"),
        (skin(), [lung(), shifted(lung(), [5, 0, 9])], r"lung 2: overlaps lung 1 by \d\.\d mm"),
        (skin(), [body((80, 60, 90), HEART_CENTRE, 3)], "lung 1: overlaps block"),
    ],
)
def test_refuses_surfaces_that_do_not_fit(heart, body, lungs, message):
    with pytest.raises(InputError, match=message):
        check_within(heart, body, lungs)


def test_refuses_an_open_heart(heart):
    opened = replace(heart, triangles=heart.triangles[1:], labels=heart.labels[1:])
    with pytest.raises(InputError, match=r"block: 3 of \d+ edges are open"):
        check_within(opened, skin())


def test_a_fill_that_fails_is_one_line_and_nothing_is_printed(heart, capfd):
    message = r"^block: the torso around it: 100\.00% could not be filled .* remesh"
    with pytest.raises(InputError, match=message) as error:
        mesh_torso(heart, dented())
    assert "\n" not in str(error.value)
    mesh_torso(heart, skin())
    assert capfd.readouterr() == ("", "")


def test_finds_no_crossing_of_nested_surfaces():
    outer, inner = body((10, 10, 10), (0, 0, 0), 3), body((9, 9, 9), (0, 0, 0), 3)
    assert not len(intersections(outer, inner))
    # an edge through one triangle is enough, and lies where the two meet
    pairs = intersections(outer, shifted(inner, [1.5, 0, 0]))
    where = outer.corners[pairs[0, 0]].mean(axis=0)
    assert np.linalg.norm(where) == pytest.approx(10, abs=0.5)
