"""A patient's values in heart.toml: kept and counted, or refused where they would not count."""

from dataclasses import replace

import pytest
from anatomies import NETWORK

import fascicle
from fascicle.core.errors import InputError
from fascicle.heart.conduction import Conduction
from fascicle.heart.folder import load_heart, write_heart


@pytest.fixture(scope="module")
def folder(tmp_path_factory, small_heart):
    path = tmp_path_factory.mktemp("hearts") / "heart"
    write_heart(replace(small_heart, values={"alpha": 0.08}), path)
    return path


def test_values_come_back_and_count(folder, small_heart):
    heart = load_heart(folder)
    assert heart.values == {"alpha": 0.08}
    assert heart.digest != small_heart.digest
    assert Conduction.of(heart).alpha == 0.08


def test_a_heart_may_have_its_own_example_network(tmp_path, small_heart):
    example = NETWORK | {"cv": 2.5}
    write_heart(replace(small_heart, example=example), tmp_path / "heart")
    heart = load_heart(tmp_path / "heart")
    assert fascicle.example_parameters(fascicle.ForwardModel(heart)) == example
    assert heart.digest == small_heart.digest  # nothing is recomputed
    manifest = tmp_path / "heart" / "heart.toml"
    manifest.write_text(manifest.read_text().replace("cv = 2.5", "cv = 250"), encoding="utf-8")
    with pytest.raises(InputError, match=r"heart\.toml: parameter 'cv' is 250") as caught:
        load_heart(tmp_path / "heart")
    assert "\n" not in str(caught.value)
    text = manifest.read_text().replace("cv = 250\n", "")
    manifest.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"heart\.toml: missing parameters cv; add them"):
        load_heart(tmp_path / "heart")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("gain = 2.0", "'gain' is not a property of the tissue"),
        ("fibre_speed = 0.6", "say the same"),
        ("region_1_conductivity = 0.0", "no labels"),
        ("anisotropy_ratio = 0.5", "give 1 to 10"),
        ("speed = 0.5", "unknown parameter 'speed'"),
    ],
)
def test_what_cannot_be_is_refused_with_the_file(folder, line, words):
    manifest = folder / "heart.toml"
    before = manifest.read_text(encoding="utf-8")
    manifest.write_text(before.replace("[values]\n", f"[values]\n{line}\n"), encoding="utf-8")
    with pytest.raises(InputError, match=words) as caught:
        load_heart(folder)
    manifest.write_text(before, encoding="utf-8")
    assert str(caught.value).startswith(str(manifest))
