"""The declarations of quantities: what follows from them, and what is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from anatomies import NETWORK
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.core.errors import InputError, ValueRefusedError
from fascicle.core.parameters import (
    EXAMPLE_PARAMETERS,
    HUMAN_SPACE,
    NETWORK_SPACE,
    complete,
    human_space,
)
from fascicle.core.quantities import (
    QUANTITIES,
    Changes,
    Quantity,
    check_not_twice,
    checked,
    declare,
    fascicle_names,
    fascicles,
    quantity,
    region_labels,
    stand_ins,
)
from fascicle.core.ranges import RANGES, digits
from fascicle.forward.scenario_files import tables
from fascicle.heart.conduction import Conduction
from fascicle.heart.sites import CoordinateSite
from fascicle.purkinje.growth import GrowthRules
from tests.test_extending import example

DOCS = Path(__file__).parents[2] / "docs"
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


def test_fascicles_of_human_anatomy():
    """Anterior, septal and posterior ones; of two on the left, none is septal."""
    ranges = {p.name: (p.lower, p.upper) for p in HUMAN_SPACE.parameters}
    assert len(ranges) == 15
    for known in HUMAN_SPACE.parameters:
        low, high = quantity(known.name).valid_range
        assert low <= known.lower < known.upper <= high
    anterior, septal, posterior = (ranges[f"lv_fascicle_direction_{k}"] for k in (1, 2, 3))
    assert posterior[1] < 0 < anterior[0]
    assert septal[0] == -septal[1]
    two = {p.name: (p.lower, p.upper) for p in human_space(lv=2).parameters}
    assert two["lv_fascicle_direction_2"] == posterior
    assert two["lv_fascicle_length_2"] == ranges["lv_fascicle_length_3"]
    for lv, rv in ((1, 1), (2, 3), (4, 4)):
        names = human_space(lv, rv).names
        assert (fascicles("lv", names), fascicles("rv", names)) == (lv, rv)
        assert len({*names}) == len(names) == 5 + 2 * (lv + rv)


@given(st.sampled_from(sorted(QUANTITIES)), ANY)
@settings(deadline=None)
def test_anything_gives_a_possible_float_or_one_line(name, value):
    known = QUANTITIES[name]
    try:
        found = checked({name: value})[name]
    except ValueRefusedError as refused:
        found = str(refused)
    if isinstance(found, str):
        assert name in found
        assert "\n" not in found
        assert len(found) < 160
    else:
        assert type(found) is float
        assert known.valid_range[0] <= found <= known.valid_range[1] or found == known.also
        assert not known.is_integer or found == int(found)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("rooot_time", "unknown parameter 'rooot_time'; did you mean 'root_time'"),
        ("conduction_velocity", "did you mean 'cv' or 'fibre_speed'?"), ("qrs", "'qrs'; 'fascicle"),
        ("poses", "did you mean 'pose'"), ("region_x_conductivity", "region_x"),
    ],
)  # fmt: skip
def test_unknown_names_are_refused(name, words):
    with pytest.raises(ValueRefusedError, match=re.escape(words)):
        quantity(name)


def test_regions_are_known_by_label():
    names = ["cv", "region_3_conductivity", "region_12_conductivity"]
    assert region_labels(names) == {3: names[1], 12: names[2]}
    assert quantity(names[1]).valid_range[0] == 0.0


def test_fascicles_are_counted_and_complete():
    assert fascicles("lv", EXAMPLE_PARAMETERS) == 2
    assert fascicles("rv", fascicle_names("rv", 4)) == 4
    assert fascicles("lv", HUMAN_SPACE.names) == 3  # directions stand for angles
    for names, missing in (
        (["lv_fascicle_length_1"], "lv_fascicle_angle_1"),
        (["lv_fascicle_length_2", "lv_fascicle_angle_2"], "lv_fascicle_length_1"),
        (["cv"], "lv_fascicle_length_1"),
        (["lv_fascicle_length_1", "lv_fascicle_direction_2"], "lv_fascicle_angle_1"),
    ):
        with pytest.raises(ValueRefusedError, match=missing):
            fascicles("lv", names)


@pytest.mark.parametrize(
    ("more", "word"),
    [
        ({"lv_fascicles": 2}, "'lv_fascicles'"), ({"alpha": 0.1, "fibre_speed": 0.6}, "alpha"),
        ({"interventricular_delay": 5.0}, "'root_time' and 'interventricular_delay' say the same"),
        ({"lv_fascicle_direction_2": 0.0}, "'lv_fascicle_angle_2' and 'lv_fascicle_direction_2'"),
        ({"anterograde_delay": -1}, "-1 ms"), ({"generations": 2.5}, "whole number"),
        ({"gain": math.inf}, "inf"), ({"cv": 1e-9}, "is 1e-09 mm/ms; give 0.1 to 20 mm/ms"),
    ],
)  # fmt: skip
def test_impossible_networks_are_refused(more, word):
    with pytest.raises(ValueRefusedError, match=word):
        complete(EXAMPLE_PARAMETERS | more)


def test_what_stands_for_another_takes_its_place():
    pairs = (
        ("alpha", "fibre_speed"), ("root_time", "interventricular_delay"),
        ("lv_fascicle_angle_3", "lv_fascicle_direction_3"),
    )  # fmt: skip
    for one, other in pairs:
        assert (stand_ins(one), stand_ins(other)) == ({other}, {one})
        with pytest.raises(ValueRefusedError, match=f"'{other}' and '{one}' say the same; give"):
            check_not_twice([other, "cv", one])
    assert stand_ins("rv_fascicle_angle_1") == stand_ins("lv_fascicle_length_1") == set()
    check_not_twice([*NETWORK_SPACE.names, "alpha"])
    check_not_twice(["lv_fascicle_angle_1", "lv_fascicle_direction_2"])


def test_a_delay_of_the_ventricles_needs_no_root_time():
    rest = {name: value for name, value in EXAMPLE_PARAMETERS.items() if name != "root_time"}
    assert "root_time" not in complete(rest | {"interventricular_delay": 5.0})
    with pytest.raises(ValueRefusedError, match="missing parameters root_time; add them"):
        complete(rest)


def test_a_blocked_junction_is_possible():
    assert complete(EXAMPLE_PARAMETERS | {"retrograde_delay": math.inf})["retrograde_delay"] > 1e9


@pytest.mark.parametrize(
    ("owner", "wrong"),
    [
        *((GrowthRules, {name: value}) for name, value in {
            "branch_length": math.nan, "segments": 1.5, "generations": 10**6,
            "clearance": "0.9", "branch_angle": math.inf,
        }.items()),
        *((Conduction, {name: value}) for name, value in {
            "intracellular_l": -3.0, "extracellular_t": 0.0, "lung": math.nan, "body": math.inf,
            "alpha": -0.05, "anisotropy_ratio": 0.5, "endocardial_layer": -1.0,
        }.items()),
    ],
)  # fmt: skip
def test_impossible_rules_and_conduction_are_refused(owner, wrong):
    with pytest.raises(ValueRefusedError, match=next(iter(wrong))):
        owner(**wrong)


@pytest.mark.parametrize(
    "change", [{"name": "cv"}, {"name": "pose"}, {"apply": None}, {"changes": Changes.LEAD_FIELDS}]
)
def test_declarations_that_cannot_be(change):
    fields = {
        "name": "drug", "unit": "1", "default": 0.0, "valid_range": (0.0, 1.0),
        "prior_range": (0.0, 1.0), "meaning": "dose", "changes": Changes.TIMES,
        "apply": lambda conduction, value: conduction,
    }  # fmt: skip
    with pytest.raises(InputError, match=re.escape(f"'{change.get('name', 'drug')}'")):
        declare(Quantity(**fields | change))
    assert "drug" not in QUANTITIES


def test_the_example_of_the_documentation(monkeypatch, small_model):
    """A quantity that is declared outside the package is one of the model."""
    from fascicle.cli.options import fixed_values
    from fascicle.networks.prior import study_space

    monkeypatch.setattr("fascicle.ForwardModel", lambda heart: small_model)
    monkeypatch.setattr("fascicle.EXAMPLE_PARAMETERS", NETWORK)
    try:
        found = example("Quantity")
        space, _ = study_space("paper", {"sodium_block": "free"}, small_model.heart)
        assert space.parameters[-1].name == "sodium_block"
        assert fixed_values(["sodium_block=0.3"]) == {"sodium_block": 0.3}
        with pytest.raises(ValueRefusedError, match="sodium_block"):
            fixed_values(["sodium_block=0.95"])
    finally:
        QUANTITIES.pop("sodium_block", None)
    slower = small_model.activate(
        small_model.grow(NETWORK),
        root_time=NETWORK["root_time"],
        cv=NETWORK["cv"],
        alpha=Conduction().alpha * math.sqrt(0.7),
    )
    assert found["times"][0.3] == slower.total_activation_time > found["times"][0.0]


def row(known: Quantity) -> str:
    cells = (
        f"`{known.name}`",
        known.unit,
        "" if known.default is None else f"{known.default:.4g}",
        "" if known.is_integer else " to ".join(map(digits, known.prior_range)),
        " to ".join(map(digits, known.valid_range)) + (", or inf" if known.also else ""),
        known.meaning,
        known.changes.value,
    )
    return f"| {' | '.join(cells)} |"


def test_the_page_follows_from_the_declarations():
    lines = (DOCS / "quantities.md").read_text(encoding="utf-8").splitlines()
    listed = [q for name, q in QUANTITIES.items() if "_fascicle_" not in name or name[-1] == "1"]
    expected = [row(known) for known in (*listed, quantity("region_1_conductivity"))]
    assert [line for line in lines if line.startswith("| `")] == expected
    for name, known in RANGES.items():
        assert f"| {name} | {known} | {known.meaning} |" in lines


def test_tables_of_scenario_files_follow_from_the_declarations():
    page = (DOCS / "files.md").read_text(encoding="utf-8")
    for name, table in tables().items():
        assert table.reference() in page, name
    assert CoordinateSite.reference() in page


def test_a_conduction_state_is_fixed_by_its_name():
    from fascicle.cli.options import fixed_values, wanted_parameters

    assert fixed_values(["conduction = left bundle branch block"]) == {"conduction": 1.0}
    assert fixed_values(["conduction=1"]) == {"conduction": 1.0}
    assert wanted_parameters(["conduction"], None) == {"conduction": "free"}
    for item, said in (
        (
            "conduction=left block",
            "parameter 'conduction' is 'left block'; give one of normal, left",
        ),
        ("conduction=9", "parameter 'conduction' is 9"),
        ("alpha=fast", "not a name and a number; write it like alpha=0.08"),
        ("alpha", "not a name and a number"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            fixed_values([item])
