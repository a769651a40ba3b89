"""Torsos in files: that of a heart folder, and the user's own surfaces."""

from dataclasses import replace

import anatomies
import numpy as np
import pytest
from block_heart import HEART_CENTRE, SKIN, block_heart, lung, skin

from fascicle.core.errors import InputError
from fascicle.heart.folder import read_torso, write_torso
from fascicle.heart.heart import Torso
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE
from fascicle.mesh.vtk import write_grid
from fascicle.torso.surfaces import Surface, read_torso_surfaces, signed_distance


@pytest.fixture
def around(default_heart):
    """One tetrahedron of each tissue beside the packaged heart."""
    count = len(default_heart.vertices)
    corners = np.array([(0, 0, 0), (9, 0, 0), (0, 9, 0), (0, 0, 9.0)])
    vertices = [default_heart.vertices, *(corners + np.array([200, 20 * k, 0]) for k in range(3))]
    tetrahedra = count + np.arange(12).reshape(3, 4)
    return Torso(np.concatenate(vertices), tetrahedra, np.array([1, 2, 3]))


def test_reads_what_was_written(default_heart, around, tmp_path):
    write_torso(tmp_path / "torso.vtu", around)
    again = read_torso(tmp_path / "torso.vtu", default_heart.vertices)
    for name in ("vertices", "tetrahedra", "tissues"):
        np.testing.assert_array_equal(getattr(again, name), getattr(around, name))


@pytest.mark.parametrize("what", ["points", "tissue 7", "inverted", "no array"])
def test_refuses_a_damaged_torso(default_heart, around, tmp_path, what):
    vertices, torso = default_heart.vertices, around
    if what == "points":
        vertices, message = vertices + 0.01, "points are not the heart's"
    elif what == "tissue 7":
        torso, message = replace(torso, tissues=np.array([1, 2, 7])), r"not 1 \(other\) or 2"
    elif what == "inverted":
        torso = replace(torso, tetrahedra=torso.tetrahedra[:, [1, 0, 2, 3]])
        message = "3 of 3 tetrahedra are flat or inverted"
    write_torso(tmp_path / "torso.vtu", torso)
    if what == "no array":
        write_grid(tmp_path / "torso.vtu", torso.vertices, torso.tetrahedra, TETRAHEDRON)
        message = "no cell array 'tissue'"
    with pytest.raises(InputError, match=message):
        read_torso(tmp_path / "torso.vtu", vertices)


def write_stl(path, surface):
    """Binary STL, every triangle with its own corners, in single precision."""
    content = np.zeros(
        len(surface.triangles), dtype=[("normal", "<3f4"), ("x", "<9f4"), ("", "<u2")]
    )
    content["x"] = surface.corners.reshape(-1, 9)
    path.write_bytes(bytes(80) + len(content).to_bytes(4, "little") + content.tobytes())


def test_reads_and_welds_stl(tmp_path):
    write_stl(tmp_path / "skin.stl", skin())
    write_stl(tmp_path / "left.stl", Surface(lung().vertices, lung().triangles[:, ::-1]))
    body = read_torso_surfaces(tmp_path / "skin.stl", [tmp_path / "left.stl"], block_heart())
    assert len(body.skin.vertices) == len(skin().vertices)
    assert body.skin.litres == pytest.approx(skin().litres, rel=1e-6)
    # inside out in the file, and turned here
    assert body.lungs[0].litres == pytest.approx(lung().litres, rel=1e-6)
    assert body.electrodes is None


def test_remeshes_what_is_too_fine(tmp_path):
    fine = anatomies.body(SKIN, HEART_CENTRE, 6)
    write_grid(tmp_path / "skin.vtu", fine.vertices, fine.triangles, TRIANGLE)
    body = read_torso_surfaces(tmp_path / "skin.vtu", [], block_heart())
    assert 1000 < len(body.skin.triangles) < len(fine.triangles) / 3
    assert body.skin.litres == pytest.approx(fine.litres, rel=0.01)
    assert np.abs(signed_distance(body.skin.vertices, fine)).max() < 2.75
    write_grid(tmp_path / "skin.vtu", fine.vertices / 1000, fine.triangles, TRIANGLE)
    with pytest.raises(InputError, match="seems to be in metres"):
        read_torso_surfaces(tmp_path / "skin.vtu", [], block_heart())


def test_takes_the_outside_of_tetrahedra(tmp_path):
    body = skin()
    vertices = np.concatenate([body.vertices, [HEART_CENTRE]])
    apex = np.full((len(body.triangles), 1), len(body.vertices))
    write_grid(tmp_path / "t.vtu", vertices, np.hstack([apex, body.triangles]), TETRAHEDRON)
    found = read_torso_surfaces(tmp_path / "t.vtu", [], block_heart()).skin
    assert len(found.triangles) == len(body.triangles)
    assert found.litres == pytest.approx(body.litres, rel=1e-12)


def test_refuses_surfaces_by_the_name_of_their_file(tmp_path):
    body = skin()
    write_grid(tmp_path / "open.vtu", body.vertices, body.triangles[3:], TRIANGLE)
    write_grid(tmp_path / "m.vtu", body.vertices / 1000, body.triangles, TRIANGLE)
    twice = np.concatenate([body.triangles, body.triangles + len(body.vertices)])
    both = np.concatenate([body.vertices, body.vertices + 500])
    write_grid(tmp_path / "two.vtu", both, twice, TRIANGLE)
    for name, message in (
        ("open.vtu", r"open\.vtu: \d of \d+ edges are open \("),
        ("m.vtu", r"m\.vtu: .* seems to be in metres; multiply the coordinates by 1000"),
        ("two.vtu", r"two\.vtu: the surface falls into 2 pieces"),
        ("none.vtp", r"none\.vtp: no such file \(torso\)"),
    ):
        with pytest.raises(InputError, match=message):
            read_torso_surfaces(tmp_path / name, [], block_heart())
