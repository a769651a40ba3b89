"""What `fascicle heart build` cannot use: one line, exit status 2, nothing written.

What is wrong with surfaces, labels, segmentations and torsos is tried in tests/build and
tests/torso; here one of each kind, and what the options say.
"""

import anatomies
import numpy as np
import pytest
from anatomies import COARSER, EDGE, ventricles

# Options that leave the volume conductor unbounded, so that little is done before an error
AROUND = ("--torso", "none", "--electrodes", "electrodes.csv", "--edge-length", EDGE)
IN_SKIN = ("--torso", "skin.stl", "--electrodes", "electrodes.csv")
BAR = "━"  # of what progress bars are made


@pytest.fixture
def build_refused(run, tmp_path, outside, monkeypatch):
    """Refuse a build in a folder with electrodes; nothing may be left of it anywhere.

    The command may have told its progress before it says what is wrong, in one line.
    """
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    anatomies.write_electrodes(folder / "electrodes.csv")

    def call(*arguments, words, around=AROUND):
        there = sorted(folder.rglob("*"))
        ended = run("heart", "build", *arguments, *around, "--out", outside / "heart")
        assert (ended.status, ended.out) == (2, ""), ended
        *before, message = ended.err.splitlines()
        assert all(BAR in line for line in before), ended.err
        assert message.startswith("error: ")
        for word in words:
            assert word in message
        assert list(outside.iterdir()) == []
        assert sorted(folder.rglob("*")) == there

    call.folder = folder
    return call


@pytest.fixture
def surface(build_refused):
    return anatomies.write_labelled(build_refused.folder / "heart.vtp")


@pytest.fixture
def mesh(build_refused):
    return anatomies.write_vtu(build_refused.folder / "mesh.vtu", labelled=True)


class TestInput:
    def test_neither_a_file_nor_all_parts(self, build_refused, surface):
        build_refused(words=["give either one file", "--lv-endocardium"])
        build_refused(surface, "--epicardium", surface, words=["give either one file"])
        build_refused("--lv-endocardium", surface, words=["rv, epicardium missing"])
        build_refused("--base", surface, words=["lv, rv, epicardium missing"])

    def test_no_file(self, build_refused):
        build_refused("none.vtp", words=["none.vtp: no such file", "; check the path"])
        for name in ("folder", "folder.vtp", "folder.nii", "folder.pts"):
            (build_refused.folder / name).mkdir()
            build_refused(name, words=[name, "; "])
        (build_refused.folder / "heart.csv").write_text("x,y,z\n")
        words = ["cannot read '.csv' as anatomy", ".vtu", ".nii.gz", ".nrrd"]
        build_refused("heart.csv", words=words)

    @pytest.mark.parametrize("name", ["heart.vtp", "heart.nii.gz"])
    def test_rubbish(self, build_refused, name):
        (build_refused.folder / name).write_bytes(np.random.default_rng(0).bytes(5000))
        build_refused(name, words=[name])

    @pytest.mark.parametrize("labelled", [True, False])
    def test_units(self, build_refused, labelled):
        write = anatomies.write_labelled if labelled else anatomies.write_surface
        write(build_refused.folder / "heart.vtp", ventricles().vertices * 1e-3)
        build_refused("heart.vtp", words=["heart.vtp: the largest extent is", "in metres"])


class TestAnatomy:
    def test_swapped_labels_of_tetrahedra(self, build_refused):
        swapped = np.array([0, 1, 2, 4, 3])[anatomies.tissue().labels]
        file = build_refused.folder / "mesh.vtu"
        anatomies.write_vtu(file, labelled=True, labels=swapped)
        build_refused(file, words=["mesh.vtu: LV and RV endocardium seem to be swapped"])

    def test_labels_that_are_not_there(self, build_refused, surface, mesh):
        build_refused(mesh, "--labels", "myocardium=3", words=["unknown 'myocardium'"])
        build_refused(surface, "--label-array", "tags", words=["no array 'tags'", "class"])

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            (None, ["its labels (0, 1, 2, 3, 4)", "--labels lv=1,rv=2"]),
            ("lv=1,rv=7,myocardium=3", ["RV blood (label 7) has 0 voxels", "1 (", "4 ("]),
            ("lv=1,rv=2,atrium=3", ["unknown 'atrium'", "lv, rv, myocardium, scar"]),
            ("lv=0,rv=2,myocardium=3", ["other than 0"]),
            ("myocardium=1", ["add up masks of one structure each"]),
            ("lv=3,rv=2,myocardium=1", ["; "]),
        ],
    )
    def test_labels_of_segmentations(self, build_refused, given, words):
        anatomies.write_nifti(build_refused.folder / "map.nii.gz")
        options = [] if given is None else ["--labels", given]
        build_refused("map.nii.gz", *options, words=words)

    def test_voxels_of_metres(self, build_refused):
        file = anatomies.write_nifti(build_refused.folder / "map.nii", factor=1e-3)
        labels = f"lv=1,rv=2,myocardium=3,scar={anatomies.SCAR}"
        build_refused(file, "--labels", labels, words=["in metres", "by 1000"])


class TestNumbers:
    @pytest.mark.parametrize(
        ("length", "words"),
        [
            (COARSER, ["10 mm is too coarse for the", "fewer than two elements fit across; give"]),
            ("nan", ["nan mm", "above 0"]),
            (0.01, ["0.01 mm", "GB are free; give", "mm or more"]),
        ],
    )
    def test_edge_length(self, build_refused, surface, length, words):
        build_refused(surface, "--edge-length", length, words=words, around=AROUND[:4])

    @pytest.mark.parametrize("angles", ["60,-60,0", "91,0", "a,b"])
    def test_angles(self, build_refused, surface, angles):
        for option in ("--lv-angles", "--rv-angles"):
            words = [option, "give two angles between -90 and 90"]
            build_refused(surface, option, angles, words=words)

    @pytest.mark.parametrize(
        ("option", "seed", "words"),
        [
            ("--lv-root", "99999", ["LV root 99999 is not one of its points"]),
            ("--lv-root", "nan,0,0", ["--lv-root nan,0,0: give the number"]),
            ("--rv-root", "200,0,0", ["RV root (200, 0, 0) is", "mm from the endocardium"]),
        ],
    )
    def test_seeds(self, build_refused, mesh, option, seed, words):
        build_refused(mesh, option, seed, words=words)

    @pytest.mark.parametrize(
        ("option", "value", "word"),
        [("--height", 1.7, "height 1.7 cm is not that of an adult"),
         ("--weight", 700, "weight 700 kg"), ("--chest", 20, "chest girth 20 cm")],
    )  # fmt: skip
    def test_build_of_the_person(self, build_refused, mesh, option, value, word):
        build_refused(mesh, option, value, words=[word], around=())

    def test_pose(self, run, outside, mesh):
        """Words that an option does not have are refused by the parser, with its own layout."""
        ended = run("heart", "build", mesh, "--pose", "upright", "--out", outside / "heart")
        assert ended.status == 2
        assert "'upright' is not one of" in " ".join(ended.err.replace("│", " ").split())
        assert list(outside.iterdir()) == []


class TestTorso:
    @pytest.mark.parametrize(
        ("changed", "words"),
        [
            ({"V1": (-26.0, 0.0, -15.0)}, ["electrode V1 lies inside the tissue"]),  # in a wall
            ({"V4": None}, ["spoilt.csv: electrodes missing: V4"]),
        ],
    )
    def test_electrodes(self, build_refused, mesh, changed, words):
        places = {n: place for n, place in (anatomies.PLACES | changed).items() if place}
        anatomies.write_electrodes(build_refused.folder / "spoilt.csv", places=places)
        build_refused(mesh, around=("--torso", "none", "--electrodes", "spoilt.csv"), words=words)

    @pytest.mark.parametrize("torso", ["none", "skin.stl"])
    def test_no_electrodes(self, build_refused, mesh, torso):
        words = [f"--torso {torso}: electrodes are missing; give --electrodes"]
        build_refused(mesh, around=("--torso", torso), words=words)

    @pytest.mark.parametrize("around", [(), AROUND])
    def test_lungs_without_a_torso_of_their_own(self, build_refused, mesh, around):
        words = ["--lung goes with a custom torso"]
        build_refused(mesh, "--lung", "lung.stl", around=around, words=words)

    def test_a_torso_elsewhere(self, build_refused, mesh):
        skin = anatomies.body((130.0, 105.0, 150.0), (400.0, 0.0, 0.0))
        build_refused(mesh, around=IN_SKIN, words=["skin.stl: no such file (torso)"])
        anatomies.write_surface(build_refused.folder / "skin.stl", *skin)
        build_refused(mesh, around=IN_SKIN, words=["lies outside the torso"])


def test_places_of_others(refused, mesh, outside):
    """Told before the work is done, so that the error stands alone; more: test_import_refused."""
    (outside / "notes.txt").write_text("mine")
    words = "holds 'notes.txt', which would be lost; give another --out"
    refused(["heart", "build", mesh, *AROUND, "--out", outside], words)
