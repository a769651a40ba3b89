"""The table of quantities, and what is refused at it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE, complete
from fascicle.core.quantities import (
    QUANTITIES,
    checked,
    fascicle_names,
    fascicles,
    quantity,
    region_labels,
)
from fascicle.heart.conduction import Conduction
from fascicle.purkinje.growth import GrowthRules

ANY = st.one_of(
    st.floats(), st.integers(), st.booleans(), st.none(), st.text(max_size=5),
    st.lists(st.floats(), max_size=2), st.floats(width=32).map(np.float32),
    st.integers(-100, 100).map(np.int64), st.complex_numbers(),
)  # fmt: skip


@pytest.mark.parametrize("known", QUANTITIES.values(), ids=lambda known: known.name)
def test_every_quantity_fits_its_own_range(known):
    low, high = known.valid_range
    assert low <= known.prior_range[0] < known.prior_range[1] <= high
    if known.default is not None:
        assert checked({known.name: known.default}) == {known.name: known.default}
    assert known.meaning
    assert known.unit


def test_ranges_of_the_paper():
    ranges = {p.name: (p.lower, p.upper) for p in NETWORK_SPACE.parameters}
    assert len(ranges) == 12
    assert ranges["lv_initial_length"] == ranges["rv_initial_length"] == (30.0, 100.0)
    assert ranges["rv_fascicle_length_2"] == (2.0, 50.0)
    assert ranges["lv_fascicle_angle_1"] == (-math.pi / 4, 3 * math.pi / 4)
    assert (ranges["root_time"], ranges["cv"]) == ((-75.0, 50.0), (2.0, 4.0))


def test_defaults_are_those_of_the_model():
    rules, conduction = GrowthRules(), Conduction()
    for owner in (rules, conduction):
        for name, value in vars(owner).items():
            if name in QUANTITIES and QUANTITIES[name].default is not None:
                assert QUANTITIES[name].default == value, name


@given(st.sampled_from(sorted(QUANTITIES)), ANY)
def test_anything_gives_a_possible_float_or_one_line(name, value):
    known, found = QUANTITIES[name], outcome(name, value)
    if isinstance(found, InputError):
        assert name in str(found)
        assert "\n" not in str(found)
        assert len(str(found)) < 160
    else:
        assert type(found) is float
        assert known.valid_range[0] <= found <= known.valid_range[1]
        assert not known.is_integer or found == int(found)


def outcome(name, value):
    try:
        return checked({name: value})[name]
    except InputError as error:
        return error


@pytest.mark.parametrize("value", [np.float32(2.5), np.float64(2.5), np.int64(3), 3])
def test_numbers_of_numpy_are_numbers(value):
    assert checked({"cv": value}) == {"cv": float(value)}


@pytest.mark.parametrize("name", ["kv", "rooot_time", "region_x_conductivity", "", "region_1"])
def test_unknown_names_are_refused(name):
    with pytest.raises(InputError, match=f"unknown parameter '{name}'"):
        quantity(name)


def test_the_nearest_name_is_offered():
    with pytest.raises(InputError, match="did you mean 'root_time'"):
        quantity("rooot_time")


def test_regions_are_known_by_label():
    names = ["cv", "region_3_conductivity", "region_12_conductivity"]
    assert region_labels(names) == {3: names[1], 12: names[2]}
    assert quantity(names[1]).valid_range[0] == 0.0


def test_fascicles_are_counted_and_complete():
    assert fascicles("lv", EXAMPLE_PARAMETERS) == 2
    assert fascicles("rv", fascicle_names("rv", 4)) == 4
    with pytest.raises(InputError, match="missing parameters lv_fascicle_angle_1"):
        fascicles("lv", ["lv_fascicle_length_1"])
    with pytest.raises(InputError, match="lv_fascicle_length_1"):
        fascicles("lv", ["lv_fascicle_length_2", "lv_fascicle_angle_2"])
    with pytest.raises(InputError, match="missing parameters rv_fascicle_length_1"):
        fascicles("rv", EXAMPLE_PARAMETERS.keys() - set(fascicle_names("rv", 2)))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"lv_fascicles": 2}, "the names of the others say it"),
        ({"alpha": 0.1, "fibre_speed": 0.6}, "say the same"),
        ({"anterograde_delay": -1}, "is -1 ms"),
        ({"generations": 2.5}, "whole number"),
        ({"gain": math.inf}, "is inf"),
        ({"cv": 1e-9}, "is 1e-09 mm/ms; give 0.1 to 20"),
    ],
)
def test_impossible_networks_are_refused(more, message):
    with pytest.raises(InputError, match=message):
        complete(EXAMPLE_PARAMETERS | more)


def test_a_blocked_junction_is_possible():
    assert complete(EXAMPLE_PARAMETERS | {"retrograde_delay": math.inf})["retrograde_delay"] > 1e9


@pytest.mark.parametrize(
    "wrong",
    [
        {"branch_length": math.nan}, {"branch_length": -1.0}, {"segments": 0}, {"segments": 1.5},
        {"repulsion": -0.1}, {"generations": -1}, {"generations": 10**6}, {"clearance": "0.9"},
        {"branch_angle": math.inf},
    ],
)  # fmt: skip
def test_impossible_rules_of_growth_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        GrowthRules(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"intracellular_l": -3.0}, {"extracellular_t": 0.0}, {"lung": math.nan},
        {"body": math.inf}, {"alpha": 0.0}, {"alpha": -0.05}, {"anisotropy_ratio": 0.5},
        {"endocardial_layer": -1.0}, {"endocardial_speed": 0.0},
    ],
)  # fmt: skip
def test_impossible_conduction_is_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Conduction(**wrong)


def test_groups_are_among_what_may_have_been_meant():
    with pytest.raises(InputError, match="did you mean 'pose'"):
        quantity("poses")
