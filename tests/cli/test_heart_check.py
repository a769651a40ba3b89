"""`fascicle heart check` and `refine` of heart folders, good and spoilt."""

import shutil

import numpy as np
import pytest
from anatomies import NETWORK

from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart


@pytest.fixture
def heart(small_heart, outside):
    return shutil.copytree(small_heart, outside / "heart")


@pytest.fixture
def check_refused(heart, refused):
    def call(*words):
        before = sorted(heart.parent.rglob("*"))
        message = refused(["heart", "check", heart], *words)
        assert sorted(heart.parent.rglob("*")) == before
        return message

    return call


def edit(heart, old, new):
    path = heart / "heart.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_packaged_heart(run, outside):
    ended = run("heart", "check", "default", "--picture", outside / "page.png")
    assert (ended.status, ended.err) == (0, "")
    assert "70190 tetrahedra" in ended.out
    assert ended.out.endswith("no problem found\n")
    assert (outside / "page.png").read_bytes()[:4] == b"\x89PNG"


def test_good(heart, run):
    ended = run("heart", "check", f"{heart}/")
    assert ended.well
    assert "warning: LV cavity: 8.4 ml; human adults have 40 to 400" in ended.err
    assert ended.out.startswith("block\n")
    assert f"{ended.err.count('warning: ')} warnings" in ended.out
    assert (heart / "check.png").is_file()


def test_no_heart_folder(outside, refused):
    arguments = ["heart", "check"]
    refused([*arguments, outside / "none"], outside / "none", "no such heart folder; make one")
    refused([*arguments, outside], outside, "not a heart folder (no heart.toml); make one")
    (outside / "file").write_text("hello")
    refused([*arguments, outside / "file"], "file: not a heart folder")
    assert [p.name for p in outside.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"name = ", "not valid TOML"), (b"\xff\xfe\x00", "not valid TOML"),
        (b"a = " + b"9" * 5000, "; import the heart again"),
        (b"", "'format': Field required; correct it or import"),
    ],
)  # fmt: skip
def test_broken_manifest(heart, check_refused, content, words):
    (heart / "heart.toml").write_bytes(content)
    check_refused("heart.toml: ", words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('units = "mm"', 'units = "cm"', "'units': Input should be 'mm'"),
        ('units = "mm"', 'units = "mm"\ncolour = 1', "'colour': Extra inputs are not permitted"),
        ("root = ", 'root = "a" #', "'lv.root': Input should be a valid integer"),
    ],
)
def test_manifest_that_says_something_else(heart, check_refused, old, new, words):
    edit(heart, old, new)
    check_refused(f"heart.toml: {words}", "; correct it or import")


@pytest.mark.parametrize(
    "name", ["mesh.vtu", "lv_endocardium.vtu", "rv_endocardium.vtu", "electrodes.csv"]
)
def test_missing_and_damaged_files(heart, check_refused, name):
    content = (heart / name).read_bytes()
    (heart / name).write_bytes(content[: len(content) // 2])
    check_refused(heart / name, "; ")
    (heart / name).unlink()
    check_refused(heart / name, "no such file", "; check the path")


@pytest.mark.parametrize("name", ["", ".", "a\\u0000b", "evil.pkl"])
def test_odd_file_names(heart, check_refused, name):
    edit(heart, "mesh.vtu", name)
    check_refused("error: ", "; ")


def test_refined_heart(blank_pictures, run, refused, ventricles, outside):
    ended = run("heart", "refine", ventricles, "--out", outside / "fine")
    assert ended.well, ended.err
    coarse, fine = load_heart(ventricles), load_heart(outside / "fine")
    assert len(fine.tetrahedra) == 8 * len(coarse.tetrahedra)
    np.testing.assert_allclose(fine.volumes.sum(), coarse.volumes.sum(), rtol=1e-12)
    said = [line.split() for line in ended.out.splitlines()]
    assert ["tetrahedra", f"{len(coarse.tetrahedra)}", f"{len(fine.tetrahedra)}"] in said
    assert (outside / "fine" / "check.png").is_file()
    again = ["heart", "refine", outside / "fine", "--out", outside / "fine"]
    refused(again, "holds the input heart.toml, which would be lost")
    one, other = (ForwardModel(heart).simulate(NETWORK) for heart in (coarse, fine))
    for tree, same in zip(one.trees, other.trees, strict=True):
        np.testing.assert_array_equal(tree.nodes, same.nodes)
    samples = min(one.leads.shape[1], other.leads.shape[1])
    difference = one.leads[:, :samples] - other.leads[:, :samples]
    assert np.linalg.norm(difference) < 0.08 * np.linalg.norm(other.leads)
