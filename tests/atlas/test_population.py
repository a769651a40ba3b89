"""Hearts of the population: published means, what a person's build changes, and the weights."""

from itertools import islice

import numpy as np
import pytest

from fascicle.atlas.population import Build, drawn_hearts, weights_for
from fascicle.heart.heart import Atlas, Components

MEASURES = ("lv_volume", "lv_mass", "rv_volume")


@pytest.fixture(scope="module")
def drawn():
    return list(islice(drawn_hearts(3, 5), 512))


def atlas_of(hearts):
    """An atlas of drawn hearts, without their shapes."""
    none = Components(np.zeros(3), np.zeros((0, 3)), np.zeros((len(hearts), 0)))
    measures = {name: np.array([getattr(h.size, name) for h in hearts]) for name in MEASURES}
    measures |= {
        name: np.array([getattr(h.build, name) for h in hearts])
        for name in ("age", "height", "weight")
    }
    measures["sex"] = np.array([float(h.build.sex == "m") for h in hearts])
    measures["elevation"] = np.array([h.axis[1] for h in hearts])
    count = len(hearts)
    places = np.zeros((count, 9, 3)), np.zeros((count, 2, 2), int), np.ones(count)
    return Atlas(none, *places, none, ({},) * count, measures, np.full(count, 1.0))


def test_healthy_means_are_those_of_the_uk_biobank():
    """Petersen et al. 2017: men 166 ml, 103 g and 182 ml, women 124 ml, 70 g and 130 ml."""
    man = Build("m", 60, 176, 84).expected
    assert [man.lv_volume, man.lv_mass, man.rv_volume] == pytest.approx([166, 103, 182], rel=0.05)
    woman = Build("f", 60, 163, 70).expected
    assert [woman.lv_volume, woman.lv_mass, woman.rv_volume] == pytest.approx(
        [124, 74, 130], rel=0.08
    )


def test_hearts_that_are_drawn_spread_over_adults(drawn):
    assert {heart.tissue for heart in drawn} == set(range(5))
    men = [h.build.height for h in drawn if h.build.sex == "m"]
    women = [h.build.height for h in drawn if h.build.sex == "f"]
    assert np.mean(men) - np.mean(women) == pytest.approx(12.5, abs=2)
    volumes = np.array([h.size.lv_volume for h in drawn])
    assert volumes.min() < 100
    assert volumes.max() > 300  # dilated
    thick = np.mean([h.size.lv_mass / h.size.lv_volume > 0.95 for h in drawn])
    assert 0.03 < thick < 0.2
    lean = [h.axis[1] for h in drawn if h.build.mass_index < 22]
    obese = [h.axis[1] for h in drawn if h.build.mass_index > 30]
    assert np.mean(lean) - np.mean(obese) == pytest.approx(11, abs=4)


def test_a_tall_man_has_a_larger_heart_than_a_small_woman(drawn):
    atlas = atlas_of(drawn)
    of_man = weights_for(atlas, {"sex": 1.0, "age": 40.0, "height": 195.0, "weight": 95.0})
    of_woman = weights_for(atlas, {"sex": 0.0, "age": 75.0, "height": 152.0, "weight": 48.0})
    volume = atlas.measures["lv_volume"]
    assert of_man @ volume > 1.4 * (of_woman @ volume)
    height = atlas.measures["height"]
    assert of_man @ height > 8 + of_woman @ height
    for weights in (of_man, of_woman):
        assert weights.sum() == pytest.approx(1)
        assert 1 / (weights**2).sum() >= 24


def test_without_a_person_fewer_hearts_are_ill_than_were_drawn(drawn):
    atlas = atlas_of(drawn)
    weights = weights_for(atlas, {})
    dilated = atlas.measures["lv_volume"] > 250
    assert 0 < weights[dilated].sum() < dilated.mean()
