"""Ventricular coordinates: exact where they are known, the same in every mesh and pose."""

from dataclasses import replace

import igl
import numpy as np
import pytest
from anatomies import EDGE, FINER, HALF_AXES, LV, half_ellipsoid, heart_on, tissue
from labelled_walls import layered, oriented
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import fascicle
from fascicle.core.errors import InputError
from fascicle.forward.primitives import Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import read_scenario, scenario_text
from fascicle.heart.assembly import read_coordinates
from fascicle.heart.coordinates import computed_coordinates, line_shares, with_coordinates
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Heart, VentricularCoordinates
from fascicle.heart.labelled_surface import BASAL, Label, LabelledMesh
from fascicle.heart.sites import CoordinateSite, Sites
from fascicle.mesh.mesh_file import TETRAHEDRON, MeshFile
from fascicle.mesh.topology import boundary_triangles


@pytest.fixture(scope="module")
def mesh() -> LabelledMesh:
    """Half-ellipsoids; the septum's middle is towards x, anterior is y, the apex down z."""
    return tissue(FINER)


@pytest.fixture(scope="module")
def found(mesh) -> VentricularCoordinates:
    return computed_coordinates(mesh)


@pytest.fixture(scope="module")
def heart(mesh, found) -> Heart:
    return heart_on(mesh, found)


def turned(a, b):
    """How far two rotational coordinates are apart."""
    return np.abs((a - b + 0.5) % 1 - 0.5)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def distances(mesh, label):
    """From each vertex to a part of the surface (mm)."""
    squares = igl.point_mesh_squared_distance(mesh.vertices, mesh.vertices, mesh.having(label))[0]
    return np.sqrt(squares)


def in_a_shell(potential, inner=20.0, outer=30.0, layers=6):
    """Half a spherical shell, a potential in it, and how far across it each vertex is."""
    points, faces = half_ellipsoid(LV)
    points = points / HALF_AXES[LV]
    radii = np.linspace(inner, outer, layers + 1)
    vertices = np.concatenate([radius * points for radius in radii])
    tetrahedra = oriented(vertices, layered(points, np.asarray(faces), layers))
    triangles, _ = boundary_triangles(tetrahedra)
    surface = LabelledMesh(vertices, tetrahedra, triangles, np.zeros(len(triangles), dtype=int))
    radius = np.repeat(radii, len(points))
    return surface, potential(radius), (radius - inner) / (outer - inner)


def test_lines_across_a_shell_are_measured_by_length():
    """The harmonic potential itself is 0.6 where half of the way is left."""
    shell, potential, exact = in_a_shell(lambda r: (1 / 20 - 1 / r) / (1 / 20 - 1 / 30))
    assert np.abs(potential - exact).max() > 0.09
    np.testing.assert_allclose(line_shares(shell, potential), exact, atol=0.005)


def test_on_the_surfaces_and_between_them(mesh, found):
    """0 and 1 where they are by definition; each ventricle has its half of the septum."""
    inner = np.unique(mesh.having(Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM))
    outer = np.setdiff1d(mesh.having(Label.EPICARDIUM), inner)
    assert (found.transmural[inner] == 1).all()
    assert (found.transmural[outer] == 0).all()
    assert (found.apicobasal[np.unique(mesh.having(*BASAL))] == 1).all()
    assert found.apicobasal.min() == 0
    for name, values in found.arrays.items():
        assert ((values >= 0) & (values <= 1)).all(), name
    left, right = (
        np.unique(mesh.having(label)) for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    )
    assert (found.ventricle[left] == 0).all()
    assert (found.ventricle[right] == 1).all()
    septum = found.rotational > 2 / 3 + 0.02
    thin = septum & (found.apicobasal > 0.5) & (found.apicobasal < 0.9)
    to_left, to_right = (
        distances(mesh, label) for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    )
    depth = to_left / (to_left + to_right)  # 1/2 in the middle, and 0 and 1 on the endocardia
    assert rms((found.transmural - np.abs(1 - 2 * depth))[thin]) < 0.08
    # in the left free wall nearly by the shortest ways, which are not quite the lines
    x, _, z = mesh.vertices.T
    to_outer = distances(mesh, Label.EPICARDIUM)
    free = (x < -5) & (z < -10)
    share = to_outer / (to_outer + to_left)
    assert free.sum() > 300
    assert rms((found.transmural - share)[free]) < 0.03


def test_around_by_symmetry(mesh, found):
    """The plane y = 0 cuts septum and free walls in the middle; the other side is the mirror."""
    y = mesh.vertices[:, 1]
    high = (found.apicobasal > 0.3) & (np.abs(y) < 3)
    septal = found.rotational > 2 / 3
    assert turned(found.rotational, 5 / 6)[high & septal].max() < 0.06
    assert turned(found.rotational, 1 / 3)[high & ~septal].max() < 0.06
    assert found.rotational[(y > 20) & ~septal & (found.apicobasal > 0.3)].min() > 1 / 3
    distance, mirror = cKDTree(mesh.vertices).query(mesh.vertices * [1, -1, 1])
    same = (
        (distance < 1.5) & (found.apicobasal > 0.2) & (found.ventricle == found.ventricle[mirror])
    )
    assert same.sum() > 500
    off = turned(found.rotational, (2 / 3 - found.rotational[mirror]) % 1)
    assert np.quantile(off[same], 0.95) < 0.06


def test_from_apex_to_base(mesh, found):
    """0 at the lower end of the attachment, increasing along every line up, 1 at the base."""
    z = mesh.vertices[:, 2]
    apex = mesh.vertices[found.apicobasal == 0]
    assert np.abs(apex[:, 1]).max() < 2 * FINER
    assert apex[:, 2].max() < -35
    for side in (0, 1):
        for low in np.arange(0, 1, 0.125):  # sectors of the free wall and of the septum
            sector = (found.ventricle == side) & (np.abs(found.rotational - low - 0.0625) < 0.0625)
            assert np.corrcoef(z[sector], found.apicobasal[sector])[0, 1] > 0.9, (side, low)


def test_it_does_not_matter_how_the_heart_lies_nor_how_large_it_is(mesh, found):
    turn = Rotation.from_euler("xyz", [40, -110, 75], degrees=True)
    other = replace(mesh, vertices=1.4 * turn.apply(mesh.vertices) + [5.0, -80.0, 900.0])
    moved = computed_coordinates(other)
    assert (moved.ventricle == found.ventricle).mean() > 0.999
    for name in ("transmural", "apicobasal"):
        assert np.quantile(np.abs(getattr(moved, name) - getattr(found, name)), 0.999) < 1e-3
    assert np.quantile(turned(moved.rotational, found.rotational), 0.999) < 1e-3


def test_without_a_septum_there_are_none(mesh):
    no_right = np.where(mesh.labels == Label.RV_ENDOCARDIUM, Label.EPICARDIUM, mesh.labels)
    with pytest.raises(InputError, match="no boundary triangle is rv endocardium; label it"):
        computed_coordinates(replace(mesh, labels=no_right))
    heart, notes = with_coordinates(heart_on(mesh), replace(mesh, labels=no_right))
    assert heart.coordinates is None
    assert notes[0].startswith("ventricular coordinates: none (")


class TestMaps:
    def test_onto_the_same_heart(self, heart):
        """Where no front arrives none does."""
        times = np.where(heart.vertices[:, 2] < -50, np.inf, 1.0)
        values = np.vstack([heart.vertices.T, times])
        found = fascicle.transfer_map(values, heart, heart)
        assert found.shape == values.shape
        off = np.abs(found[:3] - values[:3]).max(axis=0)
        assert (off < 1e-3).mean() > 0.95  # some places coincide
        assert (np.isinf(found[3]) | (np.abs(found[3] - 1) < 1e-9)).all()
        assert (np.isinf(found[3]) == np.isinf(times)).mean() > 0.97

    def test_of_the_coordinates_themselves(self, heart):
        """Onto another mesh of another shape, which is 1.3 times as long."""
        coarse = tissue(EDGE)
        longer = replace(coarse, vertices=coarse.vertices * [1.0, 1.0, 1.3])
        other = heart_on(longer, computed_coordinates(longer))
        of, to = heart.coordinates, other.coordinates
        around = 2 * np.pi * of.rotational
        maps = np.array([of.apicobasal, of.transmural, np.cos(around), np.sin(around)])
        up, across, cosine, sine = fascicle.transfer_map(maps, heart, other)
        assert rms(up - to.apicobasal) < 0.02
        assert rms(across - to.transmural) < 0.03
        away = to.apicobasal > 0.2
        turn = np.arctan2(sine, cosine) / (2 * np.pi)
        assert rms(turned(turn, to.rotational)[away]) < 0.02

    def test_other_values(self, heart):
        for values in (np.zeros(3), np.array("a"), np.zeros((len(heart.vertices), 2))):
            with pytest.raises(InputError, match="give one number for each of the"):
                fascicle.transfer_map(values, heart, heart)


class TestSites:
    @pytest.mark.parametrize("ventricle", ["lv", "rv"])
    @pytest.mark.parametrize("rotational", [0.0, 0.5])
    def test_the_nearest_vertex(self, heart, ventricle, rotational):
        site = CoordinateSite(ventricle, 0.6, rotational, 1.0)
        place = Sites(heart).position(site)
        vertex = int(np.flatnonzero((heart.vertices == place).all(axis=1))[0])
        of = heart.coordinates
        assert of.ventricle[vertex] == (ventricle == "rv")
        assert of.apicobasal[vertex] == pytest.approx(0.6, abs=0.1)
        assert of.transmural[vertex] == pytest.approx(1.0, abs=0.5)
        assert turned(of.rotational[vertex], rotational) < 0.05

    def test_in_a_scenario_file(self, tmp_path):
        file = tmp_path / "case.toml"
        site = "{ventricle = 'rv', apicobasal = 0.25, rotational = 0.5, transmural = 0}"
        file.write_text(f"[[stimulus]]\ntime = 1.0\nsite = {site}\n")
        scenario, _ = read_scenario(file)
        expected = Stimulus(1.0, site=CoordinateSite("rv", 0.25, 0.5, 0.0))
        assert scenario == Scenario([expected])
        again = tmp_path / "again.toml"
        again.write_text(scenario_text(scenario))
        assert read_scenario(again)[0] == scenario
        given = {"ventricle": "rv", "apicobasal": 0.25, "rotational": 0.5, "transmural": 0}
        assert Stimulus(1.0, site=given) == expected

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ("ventricle = 'lv'", "'apicobasal' is missing"),
            ("ventricle = 'la'", "'ventricle' is 'la': input should be 'lv' or 'rv'"),
            ("ventricle = 'lv', apicobasal = 1.2", "'apicobasal' is 1.2; give 0 to 1"),
            ("ventricle = 'lv', height = 0.5", "unknown key 'height'; known: ventricle, apico"),
        ],
    )
    def test_refused(self, tmp_path, given, words):
        file = tmp_path / "case.toml"
        file.write_text(f"[[stimulus]]\ntime = 1.0\nsite = {{{given}}}\n")
        with pytest.raises(InputError, match=f"stimulus.site: {words}"):
            read_scenario(file)


class TestFiles:
    def test_written_and_read(self, small_heart, tmp_path):
        """To single precision; what the model computes does not depend on them."""
        rng = np.random.default_rng(0)
        values = rng.random((4, len(small_heart.vertices)))
        values[0] = np.round(values[0])
        heart = replace(small_heart, coordinates=VentricularCoordinates(*values))
        assert heart.digest == small_heart.digest
        write_heart(heart, tmp_path / "heart")
        again = load_heart(tmp_path / "heart")
        for name, array in again.coordinates.arrays.items():
            np.testing.assert_allclose(array, heart.coordinates.arrays[name], atol=1e-7)
        assert fascicle.ventricular_coordinates(again) is again.coordinates

    def test_computed_once_where_the_heart_has_none(self, small_heart, monkeypatch, tmp_path):
        assert small_heart.coordinates is None
        heart = replace(small_heart, folder=tmp_path)
        first = fascicle.ventricular_coordinates(heart)
        monkeypatch.setattr("fascicle.heart.coordinates.computed_coordinates", None)
        kept = fascicle.ventricular_coordinates(heart)
        np.testing.assert_array_equal(kept.apicobasal, first.apicobasal)

    @pytest.fixture
    def points(self, mesh, found):
        """A file that has coordinates, and a point that no tetrahedron has."""

        def file(**arrays):
            arrays = {name: np.append(values, np.nan) for name, values in arrays.items()}
            return MeshFile(
                "mesh.vtu", np.append(mesh.vertices, [[0, 0, 0]], axis=0),
                {TETRAHEDRON: mesh.tetrahedra}, arrays,
            )  # fmt: skip

        return file

    def test_of_cobiveco(self, points, found):
        around = 2 * np.pi * found.rotational
        without = {name: found.arrays[name] for name in ("tv", "tm", "ab")}
        for given in (found.arrays, without | {"rtSin": np.sin(around), "rtCos": np.cos(around)}):
            read = read_coordinates(points(**given))
            for name in ("tv", "tm", "ab"):
                np.testing.assert_array_equal(read.arrays[name], found.arrays[name])
            assert turned(read.rotational, found.rotational).max() < 1e-9
        assert read_coordinates(points(**without)) is None

    def test_universal_ones(self, points, found):
        """Those that correspond to the heart's, with the septum at the left."""
        septal = found.rotational > 2 / 3
        right = (found.ventricle == 1) & ~septal
        behind, before = -1.8, 0.8  # attachments, as in the meshes of Rodero et al. 2021
        rt = found.rotational
        phi = np.where(septal, behind + 3 * (1 - rt) * (before - behind), 0)
        phi[right] = (behind + 1.5 * rt * (before - behind))[right]
        free = ~septal & ~right
        phi[free] = (behind - 1.5 * rt * (2 * np.pi - before + behind))[free]
        phi = (phi + np.pi) % (2 * np.pi) - np.pi
        inwards = np.where(found.ventricle == 1, -1, 1) * found.transmural
        rho = np.where(septal, (1 - inwards) / 2, 1 - found.transmural)
        read = read_coordinates(
            points(V=np.where(right, 1, -1), Rho=rho, Phi=phi, Z=found.apicobasal)
        )
        off_edge = (turned(rt, 0) > 0.01) & (turned(rt, 2 / 3) > 0.01) & (inwards != 0)
        assert off_edge.mean() > 0.5
        np.testing.assert_array_equal(read.ventricle[off_edge], found.ventricle[off_edge])
        np.testing.assert_allclose(read.transmural[off_edge], found.transmural[off_edge], atol=1e-9)
        assert turned(read.rotational, rt)[off_edge].max() < 0.01
        np.testing.assert_array_equal(read.apicobasal, found.apicobasal)

    @pytest.mark.parametrize(
        ("name", "value", "words"),
        [
            ("ab", 1.2, r"values are not 0 to 1, as 1.2 \(first: 7 at"),
            ("tm", np.nan, r"values are not 0 to 1, as nan \(first: 7 at"),
            ("tv", 0.5, r"values are not 0 or 1, as 0.5 \(first: 7 at"),
        ],
    )
    def test_out_of_range(self, points, found, name, value, words):
        arrays = {each: values.copy() for each, values in found.arrays.items()}
        arrays[name][7] = value
        with pytest.raises(InputError, match=f"array '{name}'.*{words}.*, or remove"):
            read_coordinates(points(**arrays))
        file = points(**found.arrays)
        file.point_data["ab"] = np.zeros((len(file.points), 3))
        with pytest.raises(InputError, match=r"'ab' has shape .*; ventricular coordinates are one"):
            read_coordinates(file)
