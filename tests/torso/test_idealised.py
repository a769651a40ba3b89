from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import LabelledMesh, labelled_mesh
from fascicle.mesh.measures import intersections
from fascicle.torso.electrode_sites import check_not_mirrored, check_on_skin, electrode_warnings
from fascicle.torso.heart_pose import endocardial_surfaces, opening, torso_frame
from fascicle.torso.idealised import idealised_torso
from fascicle.torso.lead_fields import contacts_on
from fascicle.torso.surfaces import Surface, TorsoSurfaces, check_within, signed_distance
from fascicle.torso.trunk import TrunkSize, exclusion_hull, lungs_of, trunk

MIRRORS = [np.diag(np.where(np.arange(3) == axis, -1.0, 1.0)) for axis in range(3)]


@pytest.fixture(scope="module")
def mesh(default_heart: Heart) -> LabelledMesh:
    return labelled_mesh(default_heart)


@pytest.fixture(scope="module")
def torso(mesh: LabelledMesh) -> TorsoSurfaces:
    return idealised_torso(mesh)


def at_level(surface: Surface, z: float) -> np.ndarray:
    """Where the edges of a surface cross a level, in order around it."""
    edges = surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    start, end = surface.vertices[edges].transpose(1, 0, 2)
    across = (start[:, 2] - z) * (end[:, 2] - z) < 0
    start, end = start[across], end[across]
    share = ((z - start[:, 2]) / (end[:, 2] - start[:, 2]))[:, None]
    points = start + share * (end - start)
    return points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]


@pytest.mark.parametrize("build", [TrunkSize(), TrunkSize(1.85, 95), TrunkSize(1.60, 50, 80)])
def test_girth_is_that_asked_for(build: TrunkSize) -> None:
    outline = at_level(trunk(build), 0.0)
    girth = np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1).sum()
    assert girth / 10 == pytest.approx(build.girth, rel=0.015)
    assert np.ptp(outline[:, 1]) / np.ptp(outline[:, 0]) == pytest.approx(0.70, abs=0.02)


def test_girth_follows_height_and_weight() -> None:
    """Means of Heinz et al. 2003: men 101.0 cm, women 86.1 cm."""
    assert TrunkSize(1.777, 78.1).girth == pytest.approx(101.0, rel=0.05)
    assert TrunkSize(1.649, 60.6).girth == pytest.approx(86.1, rel=0.05)


def test_measures_of_the_standard_adult(torso: TorsoSurfaces) -> None:
    # trunk: half of 66.5 kg at 1.03 kg/l (Dempster 1955), which the gas in the lungs adds to
    assert torso.skin.litres == pytest.approx(0.497 * 66.5 / 1.03 + 2.9, rel=0.1)
    left, right = (lung.litres for lung in torso.lungs)
    # 2.9 l of gas, 1.1 l of tissue and blood
    assert left + right == pytest.approx(4.0, rel=0.1)
    assert left < right


def test_surfaces_fit_into_one_another(mesh: LabelledMesh, torso: TorsoSurfaces) -> None:
    check_within(mesh, torso.skin, torso.lungs)
    heart = mesh.vertices[np.unique(mesh.triangles)]
    # Rahko 2008: 32.1 ± 7.9 mm
    assert -signed_distance(heart, torso.skin).max() == pytest.approx(32, abs=4)
    for lung in torso.lungs:
        assert signed_distance(heart, lung).min() > 3
        assert -signed_distance(lung.vertices, torso.skin).max() > 15
    assert not len(intersections(*torso.lungs))


def test_electrodes_are_on_the_skin_where_they_belong(
    mesh: LabelledMesh, torso: TorsoSurfaces
) -> None:
    assert torso.electrodes is not None
    assert np.abs(signed_distance(torso.electrodes, torso.skin)).max() < 1e-3
    place = dict(
        zip(ELECTRODES, torso_frame(mesh, TrunkSize()).to_torso(torso.electrodes), strict=True)
    )
    np.testing.assert_allclose(place["V1"] * [-1, 1, 1], place["V2"], atol=1)
    np.testing.assert_allclose(place["RA"] * [-1, 1, 1], place["LA"], atol=2)
    assert place["V1"][2] == pytest.approx(0)
    # one intercostal space lower
    assert [place[name][2] for name in ("V4", "V5", "V6")] == pytest.approx([-36] * 3, abs=5)
    assert place["V1"][1] < place["V4"][1] < place["V5"][1] < place["V6"][1]  # ever further back
    assert place["LL"][2] < -250
    assert place["RA"][2] > 100


def test_electrodes_off_the_skin_are_refused(mesh: LabelledMesh, torso: TorsoSurfaces) -> None:
    assert torso.electrodes is not None
    v1, to_the_front = ELECTRODES.index("V1"), -torso_frame(mesh, TrunkSize()).rotation[:, 1]
    moved = torso.electrodes.copy()
    moved[v1] += 25 * to_the_front
    expected = np.where(np.arange(9) == v1, 25, 0)  # the chest is nearly flat there
    assert contacts_on(*torso.skin, moved).moved == pytest.approx(expected, abs=1)
    heart = SimpleNamespace(electrode_names=ELECTRODES)
    check_on_skin(heart, contacts_on(*torso.skin, moved).moved, "e.csv")
    moved[v1] += 25 * to_the_front
    message = r"^e\.csv: electrode V1 is (49|50) mm from the skin, more than 30; .*torso=FILE"
    with pytest.raises(InputError, match=message):
        check_on_skin(heart, contacts_on(*torso.skin, moved).moved, "e.csv")


def test_heart_does_not_move_but_the_torso(mesh: LabelledMesh, torso: TorsoSurfaces) -> None:
    turn = np.linalg.qr(np.array([[1.0, 2, 0], [0, 1, 3], [1, 0, 1]]))[0]
    turn *= np.linalg.det(turn)
    moved = replace(mesh, vertices=mesh.vertices @ turn.T + [30, -50, 900])
    other = idealised_torso(moved)
    assert torso.electrodes is not None
    assert other.electrodes is not None
    expected = torso.electrodes @ turn.T + [30, -50, 900]
    np.testing.assert_allclose(other.electrodes, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((170.0, 66.5), r"height 1\.7e\+04 cm is not that of an adult; give 120 to 230 cm"),
        ((0.0, 66.5), "height 0 cm"),
        ((1.7, -3.0), "weight -3 kg"),
        ((1.7, 66.5, 0.92), "chest girth 0.92 cm"),
        ((float("nan"), 66.5), "height nan cm"),
    ],
)
def test_refuses_what_is_no_adult(values, message) -> None:
    with pytest.raises(InputError, match=message):
        TrunkSize(*values)


def test_refuses_a_heart_that_does_not_fit(mesh: LabelledMesh) -> None:
    vast = replace(mesh, vertices=mesh.vertices * 2.2)
    with pytest.raises(InputError, match=r"does not fit into the idealised torso, \d+ mm too far"):
        idealised_torso(vast)


def test_refuses_a_heart_without_room_for_a_lung(mesh: LabelledMesh) -> None:
    frame = torso_frame(mesh, TrunkSize())
    heart = frame.to_torso(mesh.vertices[np.unique(mesh.triangles)])
    base = frame.to_torso(np.stack([opening(side) for side in endocardial_surfaces(mesh)]))
    with pytest.raises(InputError, match="leaves no room for the left lung"):
        # litres, between the left and the right
        lungs_of("heart", TrunkSize(), exclusion_hull(heart, base), smallest=1.95)


def test_lungs_of_another_adult(mesh: LabelledMesh) -> None:
    build = TrunkSize(1.60, 120)
    other = idealised_torso(mesh, build)
    for lung in other.lungs:
        assert signed_distance(lung.vertices, other.skin).max() < -10
        assert signed_distance(mesh.vertices[np.unique(mesh.triangles)], lung).min() > 3
    # with the cube of the measures, and those are height times girth twice
    size = build.height * build.girth**2 / (TrunkSize().height * TrunkSize().girth ** 2)
    litres = sum(lung.litres for lung in other.lungs)
    assert litres == pytest.approx(3.9 * size, rel=0.15)


def swapped(heart: Heart, *names: str) -> Heart:
    """The heart with two electrodes' positions exchanged."""
    a, b = (ELECTRODES.index(name) for name in names)
    electrodes = heart.electrodes.copy()
    electrodes[[a, b]] = electrodes[[b, a]]
    return replace(heart, electrodes=electrodes)


def test_has_nothing_against_a_patient(crtdemo: Heart) -> None:
    assert [*electrode_warnings(crtdemo)] == []
    check_not_mirrored("heart", crtdemo)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("RA", "LA"), "electrodes RA and LA: LA lies to the right of RA, so lead I is reversed"),
        (("RA", "LL"), "electrode LL lies above RA and LA"),
        (("V2", "V3"), "electrodes V2 and V3: the second lies to the right"),
    ],
)
def test_notices_swapped_electrodes(default_heart: Heart, names, message) -> None:
    warnings = list(electrode_warnings(swapped(default_heart, *names)))
    assert [w for w in warnings if w.startswith(message)]
    check_not_mirrored("heart", swapped(default_heart, *names))  # it is not the heart's fault


def test_notices_electrodes_at_odd_places(default_heart: Heart) -> None:
    electrodes = default_heart.electrodes.copy()
    electrodes[4] += [0, 0, 250]
    electrodes[7] = default_heart.vertices.max(axis=0)
    electrodes[8] *= 4
    said = " ".join(electrode_warnings(replace(default_heart, electrodes=electrodes)))
    assert "electrode V2 lies above RA and LA" in said
    assert "electrode V6 is" in said
    assert "further than any chest is wide" in said


@pytest.mark.parametrize(("axis", "where"), [(0, "to the left of"), (1, "behind")])
def test_refuses_a_mirrored_heart(default_heart: Heart, axis: int, where: str) -> None:
    centre = default_heart.vertices.mean(axis=0)
    electrodes = (default_heart.electrodes - centre) @ MIRRORS[axis] + centre
    with pytest.raises(InputError, match=f"the RV lies {where} the LV .* mirrored"):
        check_not_mirrored("heart", replace(default_heart, electrodes=electrodes))
