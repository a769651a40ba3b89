"""What a study learns and what it holds fixed, and settings files."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.core.parameters import HUMAN_SPACE, NETWORK_SPACE, human_space
from fascicle.forward.activation_sequence import ActivationSequence
from fascicle.networks.prior import UNMAPPED, AveragedOver, Prior, read_settings, study_space


def test_default_priors(default_heart):
    """The paper learns twelve; a posterior is of human anatomy."""
    assert study_space("paper", {}, default_heart) == (NETWORK_SPACE, {})
    assert study_space("posterior", {}, default_heart) == (HUMAN_SPACE, {})
    assert len(HUMAN_SPACE) == 15
    for lv, rv in ((1, 2), (2, 3), (4, 1)):
        wanted = {"lv_fascicles": lv, "rv_fascicles": rv}
        assert study_space("posterior", wanted, default_heart) == (human_space(lv, rv), {})
        space, fixed = study_space("paper", wanted, default_heart)
        assert sum(name.startswith("lv_fascicle_length") for name in space.names) == lv
        assert sum(name.startswith("rv_fascicle_angle") for name in space.names) == rv
        assert fixed == {}
    # Or fixed, by either of its names.
    without = tuple(name for name in HUMAN_SPACE.names if name != "fibre_speed")
    for wanted, heart in (
        ({"alpha": 0.08}, default_heart),
        ({"fibre_speed": 0.6}, default_heart),
        ({}, replace(default_heart, values={"alpha": 0.07})),
        ({}, replace(default_heart, values={"fibre_speed": 0.5})),
    ):
        space, fixed = study_space("posterior", wanted, heart)
        assert space.names == without
        assert fixed == wanted


@pytest.mark.parametrize(
    ("method", "name", "other"),
    [
        ("posterior", "root_time", "interventricular_delay"),
        ("posterior", "alpha", "fibre_speed"),
        ("posterior", "lv_fascicle_angle_2", "lv_fascicle_direction_2"),
        ("paper", "interventricular_delay", "root_time"),
        ("paper", "lv_fascicle_direction_1", "lv_fascicle_angle_1"),
    ],
)
def test_what_stands_for_another_is_learnt_in_its_place(default_heart, method, name, other):
    usual, _ = study_space(method, {}, default_heart)
    assert other in usual.names
    assert name not in usual.names
    space, fixed = study_space(method, {name: "free"}, default_heart)
    assert {*space.names} == {*usual.names} - {other} | {name}
    assert fixed == {}


def test_what_is_said_of_a_quantity_counts(default_heart):
    """That of human anatomy where the method has one; else the declared one."""
    wanted = {"interventricular_delay": "free", "fibre_speed": "free", "lv_initial_length": "free"}
    assert study_space("posterior", wanted, default_heart)[0] == HUMAN_SPACE
    paper, _ = study_space("paper", {"fibre_speed": "free"}, default_heart)
    (speed,) = (p for p in paper.parameters if p.name == "fibre_speed")
    assert (speed.lower, speed.upper) == (0.5, 1.5)
    wanted = {
        "cv": np.float32(2.5),
        "root_time": {"lower": -120.0, "upper": 0.0},
        "gain": {"prior": "log-normal", "median": 1.0, "sd": 0.3},
        "endocardial_speed": "free",
        "endocardial_layer": 1,
    }
    space, fixed = study_space("paper", wanted, default_heart)
    assert fixed == {"cv": 2.5, "endocardial_layer": 1.0}
    learnt = {p.name: p for p in space.parameters}
    assert "cv" not in learnt
    assert (learnt["root_time"].lower, learnt["root_time"].upper) == (-120.0, 0.0)
    assert (learnt["gain"].prior, learnt["gain"].median) == ("log-normal", 1.0)
    assert learnt["endocardial_speed"].prior == "uniform"
    assert len(learnt) == 13


def test_a_region_must_be_there(default_heart):
    with pytest.raises(InputError, match="no labels"):
        study_space("paper", {"region_1_conductivity": "free"}, default_heart)
    labels = np.zeros(len(default_heart.tetrahedra), dtype=np.int64)
    labels[:10] = 4
    heart = replace(default_heart, regions=labels)
    with pytest.raises(InputError, match="labels are 0, 4"):
        study_space("paper", {"region_1_conductivity": 0.0}, heart)
    space, _ = study_space("paper", {"region_4_conductivity": "free"}, heart)
    assert space.names[-1] == "region_4_conductivity"


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"kv": 3.0}, "unknown parameter 'kv'"),
        ({"cv": "fixed"}, "give a number"),
        ({"cv": {"mean": 3.0}}, "unknown key 'mean'; known: prior, lower"),
        ({"cv": {"prior": "beta"}}, "'beta'; known: uniform, normal"),
        ({"cv": {"lower": "2"}}, "'lower' is '2'; give a number"),
        ({"pose": 3}, "'pose' is 3: a group of quantities can only be 'free'"),
        ({"generations": "free"}, "fixed, not learnt"),
        ({"lv_fascicles": 5}, "give 1 to 4"),
        ({"lv_fascicle_length_3": 10.0}, "fix lv_fascicles at 3"),
        ({"alpha": 0.05, "fibre_speed": "free"}, "say the same"),
        ({"root_time": "free", "interventricular_delay": 5.0}, "say the same"),
        ({"lv_fascicle_angle_1": 0.1, "lv_fascicle_direction_1": "free"}, "say the same"),
        ({"lv_fascicle_direction_3": 0.5}, "fix lv_fascicles at 3"),
        (dict.fromkeys(NETWORK_SPACE.names, 1.0) | {"cv": 3.0}, "nothing is left to learn"),
    ],
)
def test_impossible_studies_are_refused(default_heart, wanted, message):
    with pytest.raises(InputError, match=message) as caught:
        study_space("paper", wanted, default_heart)
    assert "\n" not in str(caught.value)


def test_settings_file(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text('steps = 7\n[parameters]\ncv = 2.5\nalpha = "free"\n')
    assert read_settings(path) == {"steps": 7, "parameters": {"cv": 2.5, "alpha": "free"}}
    for text, message in (("parameters = 3", r"write \[parameters\]"), ("steps = ", "not valid")):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_settings(path)
    with pytest.raises(InputError, match=r"none\.toml"):
        read_settings(tmp_path / "none.toml")


def test_groups_are_written_out(default_heart):
    space, fixed = study_space("paper", {"pose": "free", "heart_up": 3.0}, default_heart)
    learnt = {p.name: p for p in space.parameters if p.name.startswith("heart_")}
    assert list(learnt) == [
        "heart_left", "heart_posterior",
        "heart_rotation_left", "heart_rotation_posterior", "heart_rotation_up",
    ]  # fmt: skip
    assert fixed == {"heart_up": 3.0}
    assert (learnt["heart_left"].prior, learnt["heart_left"].sd) == ("normal", 8.0)

    for group, count in (("electrodes", 13), ("conductivities", 4)):
        space, _ = study_space("paper", {group: "free"}, default_heart)
        assert len(space.names) == len(NETWORK_SPACE.names) + count
    wanted = {"heart_up": {"lower": -5.0, "upper": 5.0}}  # in place of the usual prior
    space, _ = study_space("paper", wanted, default_heart)
    assert space.parameters[-1].prior == "uniform"


MAPPED = ActivationSequence(0.0, 4.0, 8.0, 15.0, 20.0, 30.0, 75.0, "basal lateral left ventricle")
UNLIKE = replace(MAPPED, total=130.0)


def is_kept(point, sequence, weights=()):
    surfaces = SimpleNamespace(sequence=lambda activation: sequence)
    averaged = AveragedOver(tissues=({},), weights=weights)
    prior = Prior(NETWORK_SPACE, averaged=averaged, mapped=True)
    return prior.keeps(point, surfaces, SimpleNamespace(activation=None))


@pytest.mark.parametrize(("total", "share"), [(59.0, UNMAPPED), (119.0, 1.0), (121.0, UNMAPPED)])
def test_on_an_atlas_activation_may_end_as_late_as_a_normal_qrs(total, share):
    points = np.random.default_rng(0).random((1000, 21))
    kept = [is_kept(point, replace(MAPPED, total=total), (0.5, 0.5)) for point in points]
    assert np.mean(kept) == pytest.approx(share, abs=0.03)


def test_all_that_is_mapped_is_kept_and_few_of_the_rest():
    """And each of these always or never."""
    points = np.random.default_rng(0).random((20_000, 21))
    assert all(is_kept(point, MAPPED) for point in points[:1000])
    kept = np.array([is_kept(point, UNLIKE) for point in points])
    expected, error = UNMAPPED, np.sqrt(UNMAPPED * (1 - UNMAPPED) / len(points))
    assert kept.mean() == pytest.approx(expected, abs=4 * error)
    assert abs(np.corrcoef(kept, points[:, 0])[0, 1]) < 4 / np.sqrt(len(points))
    again = [is_kept(np.array(point.tolist()), UNLIKE) for point in points]
    assert (kept == again).all()
    assert kept[::2].tolist() == [is_kept(point, UNLIKE) for point in points.copy()[::2]]
    columns = np.asfortranarray(points[:200])  # whatever its layout in memory
    assert [is_kept(point, UNLIKE) for point in columns] == kept[:200].tolist()
