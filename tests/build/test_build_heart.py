"""Hearts built in a torso: where it lies, its electrodes and lead fields, and what keeps them."""

import pickle
import re
import shutil
from dataclasses import replace

import anatomies
import igl
import numpy as np
import pytest
from anatomies import LV, NETWORK, RV
from scipy.spatial import cKDTree

import fascicle
from fascicle.build.build_heart import TorsoOptions, add_electrodes, build_heart
from fascicle.build.check import cavity_volume
from fascicle.build.endocardia import endocardia
from fascicle.build.read_anatomy import Source
from fascicle.core.errors import InputError
from fascicle.heart.conduction import Conduction
from fascicle.heart.electrodes import read_electrodes, write_electrodes
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import boundary_triangles
from fascicle.torso.lead_fields import key_of


@pytest.fixture(scope="module")
def idealised(tmp_path_factory):
    """Folder of a heart in the idealised torso, from tetrahedra."""
    folder = tmp_path_factory.mktemp("idealised")
    source = Source(anatomies.write_vtu(folder / "mesh.vtu", labelled=True))
    built = build_heart(source, name="in a torso")
    write_heart(built.heart, folder / "heart")
    return folder / "heart"


@pytest.fixture(scope="module")
def in_torso(idealised):
    return load_heart(idealised)


@pytest.fixture(scope="module")
def custom_torso(tmp_path_factory):
    """Folder of the same heart in a small custom torso with one lung."""
    folder = tmp_path_factory.mktemp("own")
    skin, lung = anatomies.body(), anatomies.body((28.0, 40.0, 55.0), (-70.0, 0.0, -30.0))
    torso = TorsoOptions(
        torso=str(anatomies.write_surface(folder / "skin.stl", *skin)),
        lungs=(anatomies.write_surface(folder / "lung.stl", *lung),),
        electrodes=anatomies.write_electrodes(
            folder / "electrodes.csv", anatomies.places_on_body()
        ),
    )
    source = Source(anatomies.write_vtu(folder / "mesh.vtu", labelled=True))
    built = build_heart(source, torso=torso, name="own")
    write_heart(built.heart, folder / "heart")
    return folder / "heart"


@pytest.fixture
def copied(custom_torso, tmp_path):
    """A copy of that folder without its cache."""
    ignored = shutil.ignore_patterns(".fascicle-cache")
    return shutil.copytree(custom_torso, tmp_path / "heart", ignore=ignored)


@pytest.fixture
def never_solved(monkeypatch):
    def fail(*_, **__):
        raise AssertionError("lead fields were solved for")

    monkeypatch.setattr("fascicle.torso.lead_fields.lead_fields", fail)


@pytest.fixture
def solved(monkeypatch):
    """Electrodes of every heart that lead fields are solved for."""
    from fascicle.torso.lead_fields import lead_fields

    electrodes = []

    def solve(heart, *arguments):
        electrodes.append(heart.electrodes)
        return lead_fields(heart, *arguments)

    monkeypatch.setattr("fascicle.torso.lead_fields.lead_fields", solve)
    return electrodes


def trunk(heart):
    """Approximate axes of the patient, leftwards and headwards, from the heart."""
    from_rv = heart.lv.vertices.mean(axis=0) - heart.rv.vertices.mean(axis=0)
    return from_rv / np.linalg.norm(from_rv), np.array([0.0, 0.0, 1.0])  # the base is above


class TestIdealisedTorso:
    def test_torso_and_heart_fill_the_trunk_without_overlap(self, in_torso):
        torso, count = in_torso.torso, len(in_torso.vertices)
        np.testing.assert_array_equal(in_torso.vertices, anatomies.tissue().vertices)
        np.testing.assert_array_equal(torso.vertices[:count], in_torso.vertices)
        volumes = signed_volumes(torso.vertices, torso.tetrahedra)
        assert volumes.min() > 0
        whole = np.concatenate([in_torso.tetrahedra, torso.tetrahedra])
        skin, _ = boundary_triangles(whole)
        a, b, c = torso.vertices[skin].transpose(1, 0, 2)
        enclosed = abs(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
        assert volumes.sum() + in_torso.volumes.sum() == pytest.approx(enclosed, rel=1e-6)
        litres = {t: volumes[torso.tissues == t].sum() / 1e6 for t in TorsoTissue}
        assert 20 < litres[TorsoTissue.OTHER] < 45
        assert 2 < litres[TorsoTissue.LUNG] < 6
        cavities = sum(map(cavity_volume, in_torso.endocardia)) / 1000  # litres
        assert litres[TorsoTissue.BLOOD] == pytest.approx(cavities, rel=0.15)

    def test_electrodes_lie_on_the_skin_in_their_places(self, in_torso):
        torso, places = in_torso.torso, in_torso.electrodes
        skin, _ = boundary_triangles(np.concatenate([in_torso.tetrahedra, torso.tetrahedra]))
        distance, _ = cKDTree(torso.vertices[np.unique(skin)]).query(places)
        assert distance.max() < 12  # the skin's edges are 11 mm long
        left, up = trunk(in_torso)
        ra, la, ll, *chest = places
        assert (la - ra) @ left > 150
        assert min((ra - ll) @ up, (la - ll) @ up) > 200
        assert (np.diff(np.array(chest) @ left) > 5).all()  # V1 to V6 go around to the left
        assert (np.array(chest) - ll).dot(up).min() > 0
        assert cKDTree(in_torso.vertices).query(places)[0].min() > 15

    def test_lead_fields_are_there_and_fresh(self, in_torso, never_solved):
        assert in_torso.lead_fields.values.shape == (9, len(in_torso.vertices))
        assert in_torso.lead_fields.key == key_of(in_torso, Conduction())
        simulation = fascicle.ForwardModel(in_torso).simulate(NETWORK)
        assert 0.1 < np.abs(simulation.leads).max() < 10  # mV


class TestAdditionalElectrodes:
    @pytest.fixture(scope="class")
    def more(self, in_torso):
        return add_electrodes(in_torso, ["V7", "V8", "V9", "V4R", "X", "Y", "Z"])

    def test_lie_at_their_standard_places(self, in_torso, more):
        assert more.leads == (*in_torso.leads, "V7", "V8", "V9", "V4R", "X", "Y", "Z")
        at = dict(zip(more.electrode_names, more.electrode_positions, strict=True))
        left = (at["LA"] - at["RA"]) / np.linalg.norm(at["LA"] - at["RA"])
        back = at["M"] - at["E"]
        back /= np.linalg.norm(back)
        up = np.cross(left, back)
        assert abs(left @ back) < 0.1
        skin, _ = boundary_triangles(np.concatenate([more.tetrahedra, more.torso.tetrahedra]))
        distance, *_ = igl.point_mesh_squared_distance(
            more.electrode_positions, more.torso.vertices, skin
        )
        assert np.sqrt(distance.max()) < 5  # mm; the nine are where the skin was before meshing
        for first, second in ("IE", "EC", "CA", ("V9", "V8"), ("V8", "V7"), ("V4R", "V3")):
            assert (at[second] - at[first]) @ left > 20
        assert (np.diff([at[name] @ back for name in ("V6", "V7", "V8", "V9")]) > 5).all()
        assert np.linalg.norm(at["A"] - at["V6"]) < 10
        assert (at["H"] - at["LA"]) @ up > 20
        level = [at[name] @ up for name in ("A", "C", "E", "I", "M", "V4R", "V5")]
        assert np.ptp(level) < 40

    @pytest.mark.usefixtures("never_solved")
    def test_leave_the_twelve_leads_alone_and_are_kept_and_pickled(self, in_torso, more, tmp_path):
        write_heart(more, tmp_path / "more")
        again = load_heart(tmp_path / "more")
        assert again.leads == more.leads
        assert again.digest == more.digest != in_torso.digest
        model = pickle.loads(pickle.dumps(fascicle.ForwardModel(again)))
        assert model.heart.leads == more.leads
        found = model.simulate(NETWORK)
        plain = fascicle.ForwardModel(in_torso).simulate(NETWORK)
        assert found.ecg.lead.to_numpy().tolist() == [*more.leads]
        np.testing.assert_array_equal(found.leads[:12], plain.leads)
        # Frank's A is next to V6, and the back of the heart looks the other way
        lead = dict(zip(more.leads, found.leads, strict=True))
        assert np.corrcoef(lead["X"], lead["V6"])[0, 1] > 0.9
        assert np.corrcoef(lead["Y"], lead["aVF"])[0, 1] > 0.9
        assert np.corrcoef(lead["Z"], lead["V2"])[0, 1] < -0.5

    def test_of_a_vest_are_lines_of_the_file(self, copied, solved):
        folder = copied
        places = load_heart(folder).electrodes
        lines = [f"E{k},{x},{y},{z}" for k, (x, y, z) in enumerate(places, 1)]
        with (folder / "electrodes.csv").open("a") as file:
            file.write("\n".join(lines) + "\n")
        leads = fascicle.ForwardModel(load_heart(folder)).simulate(NETWORK).ecg
        assert len(solved) == 1
        # at the places of the nine: the potentials that the twelve leads tell
        for name, same in (("E4", "V1"), ("E9", "V6")):
            np.testing.assert_allclose(leads.sel(lead=name), leads.sel(lead=same), atol=1e-5)
        np.testing.assert_allclose(leads.sel(lead="E1"), leads.sel(lead="aVR") * 2 / 3, atol=1e-5)

    def test_without_a_standard_place_or_a_skin_are_refused(self, in_torso):
        with pytest.raises(InputError, match=r"^lead E1: its electrodes have no standard place"):
            add_electrodes(in_torso, ["E1"])
        bare = replace(in_torso, torso=None, lead_fields=None)
        with pytest.raises(InputError, match="unbounded conductor"):
            add_electrodes(bare, ["V7"])


class TestOwnTorso:
    def test_lead_fields_of_a_moved_electrode_are_solved_again(self, copied, solved):
        folder = copied
        before = fascicle.ForwardModel(load_heart(folder)).simulate(NETWORK).ecg
        assert solved == []
        electrodes, _ = read_electrodes(folder / "electrodes.csv")
        electrodes[4] += [0.0, -60.0, -30.0]  # V2
        write_electrodes(folder / "electrodes.csv", electrodes)
        after = fascicle.ForwardModel(load_heart(folder)).simulate(NETWORK).ecg
        np.testing.assert_array_equal(solved, [electrodes])
        change = np.abs(after - before).max("time") / np.abs(before).max()
        assert change.sel(lead="V2") > 0.02
        others = [lead for lead in before.lead.values if lead != "V2"]
        assert change.sel(lead=others).max() < 1e-6
        fascicle.ForwardModel(load_heart(folder))
        assert len(solved) == 1  # it was kept

    def test_lungs_and_other_conductivities_count(self, custom_torso, solved):
        heart = load_heart(custom_torso)
        assert set(np.unique(heart.torso.tissues)) == set(TorsoTissue)
        as_body = Conduction(lung=Conduction().body)
        with_lung = fascicle.ForwardModel(heart).simulate(NETWORK)
        without = fascicle.ForwardModel(heart, as_body).simulate(NETWORK)
        assert len(solved) == 1
        change = np.abs(without.leads - with_lung.leads).max() / np.abs(with_lung.leads).max()
        assert 0.02 < change < 1

    def test_lead_fields_without_their_torso_fit_their_electrodes_only(
        self, custom_torso, tmp_path, never_solved
    ):
        folder = tmp_path / "heart"
        write_heart(replace(load_heart(custom_torso), torso=None), folder)
        assert not (folder / "torso.vtu").exists()
        fascicle.ForwardModel(load_heart(folder))
        electrodes, _ = read_electrodes(folder / "electrodes.csv")
        electrodes[0] += [5.0, 0.0, 0.0]
        write_electrodes(folder / "electrodes.csv", electrodes)
        with pytest.raises(InputError, match="lead fields are for other electrodes") as caught:
            fascicle.ForwardModel(load_heart(folder))
        assert "\n" not in str(caught.value)


def test_volumes_converge_with_the_edge_length():
    """Chords cut off a share that goes with the square of their length."""
    shares = []
    for mesh in (anatomies.tissue(), anatomies.tissue(anatomies.FINER)):
        muscle = signed_volumes(mesh.vertices, mesh.tetrahedra).sum() / 1000
        assert muscle == pytest.approx(anatomies.MYOCARDIUM, rel=0.02)
        found = [
            cavity_volume(Endocardium(side, surface.vertices, surface.triangles, 0, 1))
            for side, surface in zip(("lv", "rv"), endocardia(mesh), strict=True)
        ]
        exact = [anatomies.volume_below(label) for label in (LV, RV)]
        shares.append(1 - np.array(found) / exact)
    coarse, fine = shares
    assert (coarse < 0.1).all()
    assert (np.abs(fine) < 0.035).all()
    assert (fine < 0.6 * coarse).all()


def test_electrodes_by_their_names_of_the_iec(data_folder, tmp_path):
    """R, L, F and C1 to C6; N, like RL, is the ground."""
    positions = read_electrodes(data_folder / "cases" / "ten_electrodes.csv")[0]
    text = (data_folder / "cases" / "ten_electrodes.csv").read_text()
    for ours, theirs in (("RA", "R"), ("LA", "L"), ("LL", "F"), ("RL", "N"), ("V", "C")):
        text = re.sub(rf"^{ours}(?=[,\d])", theirs, text, flags=re.MULTILINE)
    (tmp_path / "iec.csv").write_text(text)
    electrodes, more = read_electrodes(tmp_path / "iec.csv")
    np.testing.assert_array_equal(electrodes, positions)
    assert more == {}
