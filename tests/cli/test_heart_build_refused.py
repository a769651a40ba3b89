"""What `fascicle heart build` cannot use: one line, exit status 2, nothing written."""

from __future__ import annotations

import pickle

import anatomies
import numpy as np
import pytest
import pyvista as pv
from anatomies import BASE, COARSER, EDGE, EPI, LV, RV, SCAR, options_of, ventricles

# Options that leave the volume conductor unbounded, so that little is done before an error
AROUND = ("--torso", "none", "--electrodes", "electrodes.csv", "--edge-length", EDGE)
IN_SKIN = ("--torso", "skin.stl", "--electrodes", "electrodes.csv")
BAR = "━"  # of what progress bars are made


@pytest.fixture
def refused_late(run):
    """Refuse a command that may have told its progress: then one line, with these words in it."""

    def call(arguments, *words):
        ended = run(*arguments)
        assert ended.status == 2, ended
        assert ended.out == ""
        *before, message = ended.err.splitlines()
        assert all(BAR in line for line in before), ended.err
        assert message.startswith("error: ")
        for word in words:
            assert str(word) in message
        return message

    return call


@pytest.fixture
def build_refused(refused_late, tmp_path, outside, monkeypatch):
    """Refuse a build in a folder with electrodes; nothing may be left of it anywhere."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    anatomies.write_electrodes(folder / "electrodes.csv")

    def call(*arguments, words, around=AROUND):
        before = sorted(folder.rglob("*"))
        out = ["--out", outside / "heart"]
        message = refused_late(["heart", "build", *arguments, *around, *out], *words)
        assert list(outside.iterdir()) == []
        assert sorted(folder.rglob("*")) == before
        return message

    call.folder = folder
    return call


@pytest.fixture
def surface(build_refused):
    return anatomies.write_labelled(build_refused.folder / "heart.vtp")


@pytest.fixture
def mesh(build_refused):
    return anatomies.write_vtu(build_refused.folder / "mesh.vtu", labelled=True)


class TestInput:
    def test_none(self, build_refused):
        build_refused(words=["give either one file", "--lv-endocardium"])

    def test_a_file_and_parts(self, build_refused, surface):
        build_refused(surface, "--epicardium", surface, words=["give either one file"])

    def test_a_part_is_missing(self, build_refused, surface):
        build_refused("--lv-endocardium", surface, words=["rv, epicardium missing"])
        build_refused("--base", surface, words=["lv, rv, epicardium missing"])

    def test_no_such_file(self, build_refused):
        build_refused("none.vtp", words=["none.vtp: no such file", "; check the path"])

    @pytest.mark.parametrize("name", ["folder", "folder.vtp", "folder.nii", "folder.pts"])
    def test_a_folder(self, build_refused, name):
        (build_refused.folder / name).mkdir()
        build_refused(name, words=[name, "; "])

    @pytest.mark.parametrize("name", ["heart.pkl", "heart.npy"])
    def test_a_pickle(self, build_refused, name):
        (build_refused.folder / name).write_bytes(pickle.dumps({"vertices": [1.0]}))
        build_refused(name, words=[name, "cannot read"])

    @pytest.mark.parametrize("name", ["heart.vtp", "heart.stl", "heart.nii.gz", "heart.msh"])
    def test_rubbish(self, build_refused, name):
        (build_refused.folder / name).write_bytes(np.random.default_rng(0).bytes(5000))
        build_refused(name, words=[name])

    def test_nothing_of_use_within(self, build_refused):
        pv.PolyData(np.eye(3)).save(build_refused.folder / "points.vtp")
        build_refused("points.vtp", words=["no triangles in this file"])

    @pytest.mark.parametrize(
        ("factor", "words"),
        [
            (1e-3, ["in metres", "multiply the coordinates by 1000"]),
            (1e3, ["in micrometres", "multiply the coordinates by 0.001"]),
            (30.0, ["check the units"]),
        ],
    )
    @pytest.mark.parametrize("labelled", [True, False])
    def test_units(self, build_refused, factor, words, labelled):
        write = anatomies.write_labelled if labelled else anatomies.write_surface
        write(build_refused.folder / "heart.vtp", ventricles().vertices * factor)
        build_refused("heart.vtp", words=["heart.vtp: the largest extent is", *words])


class TestSurfaces:
    @pytest.mark.parametrize("labelled", [True, False])
    def test_open(self, build_refused, labelled):
        whole = ventricles()
        hole = (whole.labels == EPI) & (whole.vertices[whole.triangles][:, :, 2].max(axis=1) < -50)
        arrays = {"class": whole.labels[~hole]} if labelled else {}
        file = build_refused.folder / "heart.vtp"
        anatomies.write_surface(file, triangles=whole.triangles[~hole], **arrays)
        build_refused(file, words=["heart.vtp", "hole"])

    @pytest.mark.parametrize("labelled", [True, False])
    def test_cavities_that_reach_through_the_wall(self, build_refused, labelled):
        vertices = ventricles().vertices.copy()
        rv = np.unique(ventricles().having(RV))
        vertices[rv[vertices[rv, 2] < -5], 0] += 15.0  # the free wall is 11 mm thick
        arrays = {"class": ventricles().labels} if labelled else {}
        anatomies.write_surface(build_refused.folder / "heart.vtp", vertices, **arrays)
        found = " at (" if labelled else "3 cavities"
        build_refused("heart.vtp", words=["heart.vtp: ", found])

    def test_labels_are_swapped(self, build_refused):
        swapped = np.array([0, 1, 2, 4, 3])[ventricles().labels]
        anatomies.write_labelled(build_refused.folder / "heart.vtp", labels=swapped)
        build_refused("heart.vtp", words=["LV and RV endocardium seem to be swapped"])

    def test_parts_are_swapped(self, build_refused):
        parts = anatomies.write_parts(build_refused.folder)
        swapped = {
            "lv-endocardium": parts["rv-endocardium"],
            "rv-endocardium": parts["lv-endocardium"],
        }
        build_refused(*options_of(parts | swapped), words=["seem to be swapped"])

    def test_a_part_too_far_away(self, build_refused):
        parts = anatomies.write_parts(build_refused.folder, 4.0)
        build_refused(*options_of(parts), words=["boundary loops of", "mm apart"])

    @pytest.mark.parametrize(("label", "name"), [(BASE, "base"), (RV, "rv endocardium")])
    def test_a_label_is_missing(self, build_refused, label, name):
        labels = np.where(ventricles().labels == label, int(EPI), ventricles().labels)
        anatomies.write_labelled(build_refused.folder / "heart.vtp", labels=labels)
        build_refused("heart.vtp", words=["heart.vtp", name])

    def test_unknown_numbers(self, build_refused):
        anatomies.write_labelled(build_refused.folder / "heart.vtp", labels=ventricles().labels * 7)
        build_refused("heart.vtp", words=["unknown labels: 14 (", "28 (", "base=1"])

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ("base=1,apex=9", ["apex"]),
            ("base=1,epicardium=one", ["epicardium=one"]),
            ("base", ["--labels base: give names"]),
            ("lv=1,rv=1", ["label number 1 is given two meanings"]),
        ],
    )
    def test_labels_that_say_nothing(self, build_refused, surface, given, words):
        build_refused(surface, "--labels", given, words=words)

    def test_no_such_array(self, build_refused, surface):
        build_refused(surface, "--label-array", "tags", words=["no array 'tags'", "class"])

    def test_too_few_labels_in_a_file(self, build_refused):
        anatomies.write_surface(build_refused.folder / "heart.stl")
        (build_refused.folder / "labels.txt").write_text("1\n2\n3\n")
        count = len(ventricles().triangles)
        words = ["labels.txt: 3 labels", f"{count} triangles"]
        build_refused("heart.stl", "--labels-file", "labels.txt", words=words)

    def test_tissue_in_pieces(self, build_refused):
        whole = ventricles()
        twice = np.concatenate([whole.vertices, whole.vertices + np.array([150, 0, 0])])
        triangles = np.concatenate([whole.triangles, whole.triangles + len(whole.vertices)])
        file = build_refused.folder / "heart.vtp"
        anatomies.write_surface(file, twice, triangles, **{"class": np.tile(whole.labels, 2)})
        build_refused(file, words=["falls into 2 pieces"])
        anatomies.write_surface(file, twice, triangles)
        build_refused(file, words=["falls into 2 pieces"])


class TestTetrahedra:
    def test_in_pieces(self, build_refused):
        mesh = anatomies.tissue()
        middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)[:, 2]
        apart = mesh.tetrahedra[(middle < -35) | (middle > -15)]
        grid = pv.UnstructuredGrid({pv.CellType.TETRA: apart}, mesh.vertices)
        grid.save(build_refused.folder / "mesh.vtu")
        build_refused("mesh.vtu", words=["mesh.vtu: the tissue falls into 2 unconnected pieces"])

    def test_labels_are_swapped(self, build_refused):
        swapped = np.array([0, 1, 2, 4, 3])[anatomies.tissue().labels]
        file = build_refused.folder / "mesh.vtu"
        anatomies.write_vtu(file, labelled=True, labels=swapped)
        build_refused(file, words=["mesh.vtu: LV and RV endocardium seem to be swapped"])

    def test_unknown_label_names(self, build_refused, mesh):
        build_refused(mesh, "--labels", "myocardium=3", words=["unknown 'myocardium'"])

    def test_a_label_is_missing(self, build_refused):
        file = build_refused.folder / "mesh.vtu"
        labels = np.where(anatomies.tissue().labels == LV, int(EPI), anatomies.tissue().labels)
        anatomies.write_vtu(file, labelled=True, labels=labels)
        build_refused(file, words=["labels missing: lv endocardium"])


class TestSegmentations:
    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ("lv=1,rv=7,myocardium=3", ["RV blood (label 7) has 0 voxels", "1 (", "4 ("]),
            ("lv=1,rv=2,myocardium=3,scar=9", ["scar (label 9) has 0 voxels"]),
            ("lv=1,rv=2,atrium=3", ["unknown 'atrium'", "lv, rv, myocardium, scar"]),
            ("lv=1,rv=1,myocardium=3", ["lv 1, rv 1", "its own numbers"]),
            ("lv=0,rv=2,myocardium=3", ["other than 0"]),
            ("lv=3,rv=2,myocardium=1", ["; "]),
        ],
    )
    def test_wrong_labels(self, build_refused, given, words):
        anatomies.write_nifti(build_refused.folder / "map.nii.gz")
        build_refused("map.nii.gz", "--labels", given, words=words)

    def test_an_empty_cavity(self, build_refused):
        labels = anatomies.label_map()[0].copy()
        labels[labels == anatomies.NUMBERS[LV]] = 0
        anatomies.write_nifti(build_refused.folder / "map.nii.gz", labels)
        words = ["LV blood (label 1) has 0 voxels"]
        build_refused("map.nii.gz", "--labels", "lv=1,rv=2,myocardium=3", words=words)

    def test_labels_that_nobody_explained(self, build_refused):
        anatomies.write_nifti(build_refused.folder / "map.nii.gz")
        build_refused("map.nii.gz", words=["its labels (0, 1, 2, 3, 4)", "--labels lv=1,rv=2"])

    def test_no_voxel_spacing(self, build_refused):
        anatomies.write_nrrd(build_refused.folder / "map.nrrd", spacing=False)
        build_refused("map.nrrd", words=["neither space directions nor spacings"])

    def test_voxels_of_metres(self, build_refused):
        file = anatomies.write_nifti(build_refused.folder / "map.nii", factor=1e-3)
        labels = f"lv=1,rv=2,myocardium=3,scar={SCAR}"
        build_refused(file, "--labels", labels, words=["in metres", "by 1000"])


class TestNumbers:
    @pytest.mark.parametrize(
        ("length", "words"),
        [
            (COARSER, ["10 mm is too coarse for the", "fewer than two elements fit across; give"]),
            (0, ["0 mm", "above 0"]),
            (-2, ["-2 mm", "above 0"]),
            ("nan", ["nan mm", "above 0"]),
            ("inf", ["inf mm"]),
            (0.01, ["0.01 mm", "GB are free; give", "mm or more"]),
        ],
    )
    def test_edge_length(self, build_refused, surface, length, words):
        build_refused(surface, "--edge-length", length, words=words, around=AROUND[:4])

    @pytest.mark.parametrize("angles", ["60", "60,-60,0", "91,0", "a,b", "nan,0", ""])
    @pytest.mark.parametrize("option", ["--lv-angles", "--rv-angles"])
    def test_angles(self, build_refused, surface, option, angles):
        build_refused(surface, option, angles, words=[option, "give two angles between -90 and 90"])

    @pytest.mark.parametrize(
        ("option", "seed", "words"),
        [
            ("--lv-root", "99999", ["LV root 99999 is not one of its points"]),
            ("--rv-direction", "-3", ["-3"]),
            ("--lv-root", "nan,0,0", ["--lv-root nan,0,0: give the number"]),
            ("--rv-root", "200,0,0", ["RV root (200, 0, 0) is", "mm from the endocardium"]),
        ],
    )
    def test_seeds(self, build_refused, mesh, option, seed, words):
        build_refused(mesh, option, seed, words=words)

    def test_seeds_that_are_one(self, build_refused, mesh):
        seeds = ("--lv-root", 4, "--lv-direction", 4)
        build_refused(mesh, *seeds, words=["LV root and direction are the same point (4)"])

    @pytest.mark.parametrize(
        ("option", "value", "words"),
        [
            ("--height", 5, ["height 5 m is not that of an adult; give 1.2 to 2.3 m"]),
            ("--weight", 700, ["weight 700 kg"]),
            ("--chest", 20, ["chest girth 20 cm"]),
            ("--height", "nan", ["height nan m"]),
        ],
    )
    def test_build_of_the_person(self, build_refused, mesh, option, value, words):
        build_refused(mesh, option, value, words=words, around=())

    def test_pose(self, run, outside, mesh):
        """Words that an option does not have are refused by the parser, with its own layout."""
        ended = run("heart", "build", mesh, "--pose", "upright", "--out", outside / "heart")
        assert ended.status == 2
        assert "'upright' is not one of" in " ".join(ended.err.replace("│", " ").split())
        assert list(outside.iterdir()) == []


class TestBody:
    def test_a_mirrored_heart(self, build_refused):
        mirrored = anatomies.tissue().vertices * [-1, 1, 1] + [2 * anatomies.CENTRE_X[EPI], 0, 0]
        file = build_refused.folder / "mesh.vtu"
        anatomies.write_vtu(file, labelled=True, vertices=mirrored)
        build_refused(file, words=["the RV lies", "mirrored"])

    def test_electrodes_within_the_heart(self, build_refused, mesh):
        places = {**anatomies.PLACES, "V1": (-26.0, 0.0, -15.0)}  # in the LV's free wall
        anatomies.write_electrodes(build_refused.folder / "within.csv", places=places)
        around = ("--torso", "none", "--electrodes", "within.csv")
        build_refused(mesh, around=around, words=["electrode V1 lies inside the tissue"])

    def test_an_electrode_is_missing(self, build_refused, mesh):
        places = {name: place for name, place in anatomies.PLACES.items() if name != "V4"}
        anatomies.write_electrodes(build_refused.folder / "eight.csv", places=places)
        around = ("--torso", "none", "--electrodes", "eight.csv")
        build_refused(mesh, around=around, words=["eight.csv: electrodes missing: V4"])

    @pytest.mark.parametrize("torso", ["none", "skin.stl"])
    def test_no_electrodes(self, build_refused, mesh, torso):
        words = [f"--torso {torso}: electrodes are missing; give --electrodes"]
        build_refused(mesh, around=("--torso", torso), words=words)

    @pytest.mark.parametrize("around", [(), AROUND])
    def test_lungs_without_a_torso_of_their_own(self, build_refused, mesh, around):
        words = ["--lung goes with a torso of your own"]
        build_refused(mesh, "--lung", "lung.stl", around=around, words=words)

    def test_a_torso_that_is_not_there(self, build_refused, mesh):
        build_refused(mesh, around=IN_SKIN, words=["skin.stl: no such file (torso)"])

    @pytest.mark.parametrize(
        ("half_axes", "centre", "words"),
        [
            ((130.0, 105.0, 150.0), (400.0, 0.0, 0.0), ["lies outside the torso"]),
            ((130.0, 105.0, 150.0), (120.0, 0.0, -30.0), ["pokes", "through the torso's skin"]),
            ((0.13, 0.105, 0.15), (0.0, 0.0, 0.0), ["skin.stl", "metres"]),
        ],
    )
    def test_a_torso_elsewhere(self, build_refused, mesh, half_axes, centre, words):
        anatomies.write_surface(
            build_refused.folder / "skin.stl", *anatomies.body(half_axes, centre)
        )
        build_refused(mesh, around=IN_SKIN, words=words)

    def test_an_open_torso(self, build_refused, mesh):
        skin = anatomies.body()
        anatomies.write_surface(
            build_refused.folder / "skin.stl", skin.vertices, skin.triangles[9:]
        )
        build_refused(mesh, around=IN_SKIN, words=["skin.stl: the surface has an open edge at"])

    def test_a_lung_in_the_heart(self, build_refused, mesh):
        anatomies.write_surface(build_refused.folder / "skin.stl", *anatomies.body())
        lung = anatomies.body((40.0, 40.0, 60.0), (-30.0, 0.0, -30.0))
        anatomies.write_surface(build_refused.folder / "lung.stl", *lung)
        build_refused(mesh, "--lung", "lung.stl", around=IN_SKIN, words=["lung.stl: overlaps"])


class TestOut:  # told before the work is done, so that the error stands alone
    def test_a_file(self, refused, mesh, outside):
        (outside / "heart").write_text("mine")
        refused(["heart", "build", mesh, *AROUND, "--out", outside / "heart"], "is a file; give")
        assert (outside / "heart").read_text() == "mine"

    def test_a_folder_that_is_no_heart(self, refused, mesh, outside):
        (outside / "notes.txt").write_text("mine")
        arguments = ["heart", "build", mesh, *AROUND, "--out", outside]
        refused(
            arguments, "holds files and is not a heart folder (no heart.toml); give another --out"
        )
        assert [path.name for path in outside.iterdir()] == ["notes.txt"]

    def test_a_heart_with_something_else_in_it(self, refused, mesh, outside):
        for name in ("heart.toml", "notes.txt"):
            (outside / name).write_text("mine")
        arguments = ["heart", "build", mesh, *AROUND, "--out", outside]
        refused(arguments, "holds 'notes.txt', which would be lost")
        assert {path.name for path in outside.iterdir()} == {"heart.toml", "notes.txt"}

    def test_below_a_file(self, refused, mesh, outside):
        (outside / "file").write_text("mine")
        arguments = ["heart", "build", mesh, *AROUND, "--out", outside / "file" / "heart"]
        refused(arguments, "cannot be written", "; choose another place (--out)")


def test_kinds_of_files_that_are_no_anatomy_are_told_those_that_are(build_refused):
    (build_refused.folder / "heart.csv").write_text("x,y,z\n")
    build_refused("heart.csv", words=["cannot read '.csv' as anatomy", ".vtu", ".nii.gz", ".nrrd"])
