"""The idealised torso shaped to electrodes, against bodies that are known."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import tissue
from scipy.spatial.transform import Rotation

from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.heart.electrodes import read_electrodes
from fascicle.mesh.read import read_mesh
from fascicle.torso.electrode_sites import check_not_exchanged
from fascicle.torso.heart_pose import default_position, torso_frame
from fascicle.torso.idealised import fit_trunk, fitted_torso, leaving
from fascicle.torso.lead_fields import contacts_on
from fascicle.torso.trunk import TrunkSize, outside_trunk

TURN = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()


@pytest.fixture(scope="module")
def mesh():
    return tissue()


def sites(mesh, person):
    """The standard sites on the trunk of a person around a heart, in its coordinates."""
    return torso_frame(mesh, person).to_heart(leaving(outside_trunk(person), person))


def fit(mesh, electrodes, **known):
    heart = mesh.vertices[np.unique(mesh.triangles)]
    frame = torso_frame(mesh, TrunkSize())
    centre = frame.to_heart(default_position(TrunkSize()))
    return fit_trunk("e.csv", electrodes, heart, centre, frame.rotation, known)


@pytest.mark.parametrize("person", [TrunkSize(1.90, 75), TrunkSize(1.7, chest=105, shoulders=1.1)])
def test_a_person_is_found_again(mesh, person):
    """From electrodes at their sites; unusual measures are drawn to the usual ones a little."""
    found = fit(mesh, sites(mesh, person))
    assert found.moved.max() < 4
    assert found.size.girth == pytest.approx(person.girth, rel=0.05)
    assert found.size.height == pytest.approx(person.height, rel=0.05)
    assert found.size.shoulders == pytest.approx(person.shoulders, rel=0.06)
    assert np.abs(found.electrodes - found.sites).max() < 20


def test_measures_of_the_person_are_kept(mesh):
    electrodes = sites(mesh, TrunkSize(1.80, 80))
    person = fit(mesh, electrodes, height=1.65, weight=70).size
    assert (person.height, person.weight, person.chest) == (1.65, 70, None)
    assert fit(mesh, electrodes, chest=90).size.girth == 90


def test_the_deformation_puts_the_skin_at_the_electrodes_and_folds_nothing(mesh):
    electrodes = sites(mesh, TrunkSize())
    electrodes[4] += [8, -14, 0]
    electrodes[7] += [15, 0, 10]
    fitted = fit(mesh, electrodes)
    assert fitted.moved.max() > 3
    outside = outside_trunk(fitted.size)
    np.testing.assert_allclose(outside(fitted.undeformed(fitted.electrodes)), 0, atol=1e-6)
    far = np.array([[0.0, 120, -380], [0, 120, 100]])
    assert np.linalg.norm(fitted.undeformed(far) - far, axis=1).max() < 0.5 * fitted.moved.max()
    points = np.random.default_rng(0).uniform([-200, -150, -400], [200, 150, 180], (3000, 3))
    step = 0.1 * np.eye(3)
    columns = [fitted.undeformed(points + e) - fitted.undeformed(points - e) for e in step]
    assert np.linalg.det(np.stack(columns, axis=2) / 0.2).min() > 0.3


def test_torso_turns_with_heart_and_electrodes(mesh):
    electrodes = sites(mesh, TrunkSize(1.8, 80))
    one, fitted = fitted_torso(mesh, electrodes, "e.csv", {})
    moved = replace(mesh, vertices=mesh.vertices @ TURN.T + [30, -50, 900])
    other, _ = fitted_torso(moved, electrodes @ TURN.T + [30, -50, 900], "e.csv", {})
    extent = [np.ptp(surface.skin.vertices @ axes, axis=0) for surface, axes in (
        (one, fitted.frame.rotation), (other, TURN @ fitted.frame.rotation))]  # fmt: skip
    np.testing.assert_allclose(extent[0], extent[1], atol=1)
    for torso in (one, other):
        assert contacts_on(*torso.skin, torso.electrodes).moved.max() < 1
    assert one.skin.litres == pytest.approx(other.skin.litres, rel=1e-3)


def test_an_electrode_on_the_wrist_is_named(mesh):
    electrodes = sites(mesh, TrunkSize())
    electrodes[0] = torso_frame(mesh, TrunkSize()).to_heart(np.array([-600.0, 0.0, -150.0]))
    with pytest.raises(InputError, match=r"e\.csv: electrode RA is \d{3} mm from the skin"):
        fit(mesh, electrodes)


def test_electrodes_of_another_frame(mesh):
    elsewhere = torso_frame(mesh, TrunkSize()).rotation @ [0, 0, 190.0]
    with pytest.raises(InputError, match=r"the heart lies \d+ mm too far to the feet"):
        fit(mesh, sites(mesh, TrunkSize()) + elsewhere)
    # a heart in LPS, electrodes in RAS
    frame = torso_frame(mesh, TrunkSize())
    turned = frame.to_torso(sites(mesh, TrunkSize())) * [-1, -1, 1]
    with pytest.raises(InputError, match="the apex then points to the right and the back"):
        fitted_torso(mesh, frame.to_heart(turned), "e.csv", {})


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ([1, 0, 2, 3, 4, 5, 6, 7, 8], "e.csv: electrodes RA and LA"),
        ([0, 2, 1, 3, 4, 5, 6, 7, 8], "e.csv: electrode"),
        ([2, 1, 0, 3, 4, 5, 6, 7, 8], "e.csv: electrode"),
        ([0, 1, 2, 8, 7, 6, 5, 4, 3], "e.csv: electrodes V1 to V6 run from the left"),
        ([0, 1, 2, 4, 3, 5, 6, 7, 8], "e.csv: electrodes V1 and V2"),
    ],
)
def test_exchanged_electrodes(small_heart, mesh, order, message):
    electrodes = sites(mesh, TrunkSize())
    check_not_exchanged("e.csv", replace(small_heart, electrodes=electrodes))
    with pytest.raises(InputError, match=message):
        check_not_exchanged("e.csv", replace(small_heart, electrodes=electrodes[order]))


def test_a_living_subject(data_folder):
    """Electrodes of a person, once refused at 49 mm from the skin."""
    folder = data_folder / "hearts" / "dti004"
    electrodes, _ = read_electrodes(folder / "electrodes.csv")
    heart = read_mesh(folder / "mesh.vtu", "mesh").points
    fitted = fit_trunk("e.csv", electrodes, heart, heart.mean(axis=0), np.eye(3), {})
    assert fitted.moved.max() < 7
    assert 85 < fitted.size.girth < 110
    placed = fitted.frame.to_torso(heart)
    assert outside_trunk(fitted.size)(fitted.undeformed(placed)).max() < -30
    front = [ELECTRODES.index(name) for name in ("V1", "V2", "V3", "V4")]
    assert (fitted.electrodes[front, 1] < fitted.electrodes[8, 1]).all()
