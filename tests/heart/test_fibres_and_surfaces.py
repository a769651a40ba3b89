"""Fibres, endocardia, seeds and electrodes whose answers are known."""

import numpy as np
import pytest
from anatomies import PLACES, write_electrodes
from builders import half_ellipsoid

from fascicle.core.errors import InputError
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.endocardium import long_axis, oriented_into_cavity, septal_seeds
from fascicle.mesh.checks import check_tetrahedra, check_units
from fascicle.mesh.measures import principal_axes, triangle_normals

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def bowl():
    """Half-ellipsoid open at z = 0; triangles in mixed-up orientation."""
    surface = half_ellipsoid(rings=12, sectors=20, radius=20.0, depth=40.0)
    flip = np.random.default_rng(0).random(len(surface.triangles)) < 0.5
    triangles = surface.triangles.copy()
    triangles[flip] = triangles[flip][:, ::-1]
    return surface.vertices, triangles


@pytest.mark.parametrize("name", ["RL", "rl"])
def test_the_grounded_electrode_is_left_out(tmp_path, name):
    file = write_electrodes(tmp_path / "e.csv", {**PLACES, name: (1, 2, 3), "E1": (4, 5, 6)})
    nine, more = read_electrodes(file)
    assert nine.shape == (9, 3)
    assert {key: at.tolist() for key, at in more.items()} == {"E1": [4, 5, 6]}


def test_mean_of_two_directions_lies_between():
    angle = np.radians([20, 20, 60, 60])
    given = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    mean = principal_axes(given[None])[0]
    assert np.degrees(np.arctan(mean[1] / mean[0])) == pytest.approx(40)


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


def test_the_right_apex_is_not_in_the_outflow_tract():
    points, triangles = bowl()
    high, left = np.argmin(np.abs(points[:, 2] + 5)), (np.zeros(3), np.array([5, 5, -60]))
    _, apex = long_axis(points, triangles)
    points[high] += [0, 80, 0]
    assert (long_axis(points, triangles)[1] == points[high]).all()
    assert (long_axis(points, triangles, left)[1] == apex).all()


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
    [(0.1, "metres; multiply the coordinates by 1000"), (10, "centimetres .* by 10 "),
     (1e5, "micrometres; .* by 0.001"), (900, "; check the units"), (0, "; check the units")],
)  # fmt: skip
def test_units_are_told_by_size(extent, words):
    with pytest.raises(InputError, match=words):
        check_units("m", CORNERS * extent)
