"""Fibres, endocardia and seeds on shapes whose answers are known."""

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.heart.assembly import _match_by_position, average_to_tetrahedra
from fascicle.heart.endocardium import oriented_into_cavity, septal_seeds
from fascicle.heart.validate import check_tetrahedra, check_units
from fascicle.mesh.measures import triangle_normals

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def bowl(rings=8, spokes=20, depth=40.0):
    """Paraboloid open at z = 0, apex at z = -depth; triangles in mixed-up orientation."""
    points, triangles = [[0.0, 0.0, -depth]], []
    for ring in range(1, rings + 1):
        angle = 2 * np.pi * np.arange(spokes) / spokes
        r = 20 * ring / rings
        z = -depth * (1 - (ring / rings) ** 2)
        points += np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * angle + z]).tolist()
    for k in range(spokes):
        n = (k + 1) % spokes
        triangles.append([0, 1 + n, 1 + k])
        for ring in range(rings - 1):
            a, b = 1 + ring * spokes + k, 1 + ring * spokes + n
            triangles += [[a, a + spokes, b], [b, b + spokes, a + spokes]]
    return np.array(points), np.array(triangles)


def test_mean_of_two_directions_lies_between():
    angle = np.radians([20, 20, 60, 60])
    given = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    mean = average_to_tetrahedra(given, np.array([[0, 1, 2, 3]]))[0]
    assert np.degrees(np.arctan(mean[1] / mean[0])) == pytest.approx(40)


def test_matching_undoes_a_permutation_and_single_precision():
    rng = np.random.default_rng(0)
    wanted = 100 * rng.random((50, 3))
    order = rng.permutation(50)
    row = _match_by_position("f", wanted[order].astype(np.float32).astype(float), wanted, "points")
    np.testing.assert_array_equal(order[row], np.arange(50))
    with pytest.raises(InputError, match=r"^f: 50 of 50 points .* no fibre within .*; give"):
        _match_by_position("f", wanted + 0.1, wanted, "points")


@pytest.mark.parametrize("flip", [False, True])
def test_endocardium_is_turned_to_its_cavity(flip):
    points, triangles = bowl()
    oriented = oriented_into_cavity(points, triangles[:, ::-1] if flip else triangles, "bowl")
    normals = triangle_normals(points, oriented)
    centres = points[oriented].mean(axis=1)
    assert (normals[:, 2] > 0).all()  # out of the bowl, so into the cavity
    assert (np.einsum("ij,ij->i", normals[:, :2], centres[:, :2]) < 1e-9).all()
    assert {frozenset(t) for t in oriented.tolist()} == {frozenset(t) for t in triangles.tolist()}


@pytest.mark.parametrize("angle", [0.0, 1.0, 3.0])
def test_seeds_look_at_the_other_ventricle(angle):
    points, triangles = bowl()
    triangles = oriented_into_cavity(points, triangles, "bowl")
    towards = np.array([np.cos(angle), np.sin(angle)])
    other = points + np.append(45 * towards, 0.0)
    root, direction = points[list(septal_seeds(points, triangles, other))]
    assert root[:2] @ towards > 0.9 * np.linalg.norm(root[:2])
    assert direction[:2] @ towards > 0.9 * np.linalg.norm(direction[:2])
    assert -0.25 * 40 < root[2] < 0  # near the base, but not on it
    assert direction[2] < root[2] - 5


def test_flat_is_told_from_small():
    points = np.vstack([CORNERS, 1e-3 * CORNERS[1:]])  # the second is 1e-9 of the first
    good = np.array([[0, 1, 2, 3], [0, 4, 5, 6]])
    check_tetrahedra("m", 60 * points * [1, 1, 1], good)
    x, y, z = (60 * points[[0, 1, 2, 2]]).mean(axis=0)
    words = rf"have zero volume \(first: 1 at \({x:.1f}, {y:.1f}, {z:.1f}\) mm\)"
    with pytest.raises(InputError, match=words):
        check_tetrahedra("m", 60 * points, np.array([[0, 1, 2, 3], [0, 1, 2, 2]]))


@pytest.mark.parametrize(
    ("extent", "words"),
    [(0.1, "metres; multiply the coordinates by 1000"), (10, "centimetres; .* by 10 "),
     (1e5, "micrometres; .* by 0.001"), (900, "; check the units"), (0, "; check the units")],
)  # fmt: skip
def test_units_are_told_by_size(extent, words):
    with pytest.raises(InputError, match=words):
        check_units("m", CORNERS * extent)
