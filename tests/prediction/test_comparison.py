"""Comparisons whose answer is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import case

from fascicle.core.errors import InputError
from fascicle.forward.primitives import His, SlowConduction, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.prediction.comparison import Comparison, compare, missing_blocks
from fascicle.prediction.predicted import Predicted
from fascicle.recording.window import OFFSET_ERROR, ONSET_ERROR


def predicted(beats=(), effective=np.inf, **indices):
    found = {name: np.asarray(values) for name, values in indices.items()}
    return Predicted(Scenario(), beats, found, effective)


def test_counts_networks():
    a = predicted(qrs_duration=[100.0, 110.0, 120.0, 130.0])
    b = predicted(qrs_duration=[112.0, 115.0, 120.0, 125.0])
    found = compare(a, b, "qrs_duration")
    np.testing.assert_array_equal(found.reductions, [12, 5, 0, -5])
    assert found.unit == "ms"
    assert found.probability() == (2 + 0.5) / 4
    assert found.probability(10.0) == 0.25
    share = (4 * 0.25 + 0.5) / 5
    assert found.standard_error(10.0) == pytest.approx(np.sqrt(share * (1 - share) / 4))
    assert found.standard_error(-100.0) > 0  # all agree, and yet they are few
    assert found.median == 2.5
    assert found.interval == pytest.approx(np.percentile([12, 5, 0, -5], [5, 95]))
    assert str(found) == "2 ms (90 % CrI -4 to 11)"
    same = predicted(qrs_duration=[100.2, 99.9])
    assert str(compare(same, predicted(qrs_duration=[100.0, 99.8]), "qrs_duration")) == (
        "0 ms (90 % CrI 0 to 0)"
    )
    assert compare(b, a, "qrs_duration").probability() == 1 - found.probability()
    with pytest.raises(InputError, match="threshold is '10'; give a number"):
        found.probability("10")


def test_a_pacing_without_the_block_it_is_compared_with():
    paced, off = [Stimulus(0.0, site="rv apex")], His(time=np.inf)
    cut = His(time=np.inf, left=0.0)
    slow = SlowConduction("lv", 0.0, part="fascicle 1")
    scenarios = {
        "block": case(his=His(left=0.0), slow=(slow,)),
        "intrinsic": Scenario(),
        "his": case(his=His(root_time=0.0)),
        "pacing": case(paced, his=off),
        "half": case(paced, his=cut),
        "blocked": case(paced, his=cut, slow=(slow,)),
    }
    found = {name: replace(predicted(), scenario=each) for name, each in scenarios.items()}
    said = missing_blocks("pacing", found, "block")
    assert said.startswith(
        "block blocks LV fascicle 1 and the left bundle branch, and pacing does not: what it"
    )
    assert "block blocks LV fascicle 1, and half" in missing_blocks("half", found, "block")
    for name in ("his", "intrinsic", "blocked", "block"):
        assert missing_blocks(name, found, "block") == ""
    assert missing_blocks("pacing", found, "intrinsic") == ""


def test_other_networks_are_refused():
    three, two = predicted(qrs_area=[1.0, 2.0, 3.0]), predicted(qrs_area=[1.0, 2.0])
    with pytest.raises(InputError, match="3 networks cannot be compared with 2; predict both"):
        compare(three, two, "qrs_area")

    def grown(*tips):
        trees = [
            SimpleNamespace(nodes=np.array([[0.0, 0.0, 0.0], [tip, 0.0, 0.0]])) for tip in tips
        ]
        return [SimpleNamespace(trees=tuple(trees))]

    one, same, other = (
        predicted(grown(*tips), qrs_area=[1.0]) for tips in ((1.0, 2.0), (1.0, 2.0), (1.0, 3.0))
    )
    assert compare(one, same, "qrs_area").median == 0
    with pytest.raises(InputError, match="1 networks cannot be compared with 1 others; predict"):
        compare(one, other, "qrs_area")


def test_what_few_independent_networks_are_worth():
    """Thousands of draws that are worth 100, or 10, are as sure of a probability as so many."""
    rng = np.random.default_rng(2)
    gain = rng.normal(size=5000)
    for effective in (100.0, 10.0):
        found = compare(
            predicted(qrs_area=np.zeros(5000), effective=effective), predicted(qrs_area=gain),
            "qrs_area",
        )  # fmt: skip
        assert found.standard_error() == pytest.approx(0.5 / np.sqrt(effective), rel=0.01)
        if effective < Comparison.fewest:
            assert found.variance_explained_by({"x": gain}) == []
            assert found.value_of_measurement({"intrinsic": predicted(lv_rv_delay=gain)}) == []
        else:
            assert dict(found.variance_explained_by({"x": gain}))["x"] == pytest.approx(1.0)
            chance = dict(found.variance_explained_by({"y": gain + 10 * rng.normal(size=5000)}))[
                "y"
            ]
            assert chance < 0.01  # 0.01 of the variance is what 100 networks have by chance


def test_a_delay_is_as_bad_either_way():
    a, b = predicted(lv_rv_delay=[-10.0, 5.0]), predicted(lv_rv_delay=[30.0, -40.0])
    np.testing.assert_array_equal(compare(a, b, "lv_rv_delay").reductions, [20, 35])


def test_says_what_leaves_it_open():
    rng = np.random.default_rng(0)
    x, y, z = rng.normal(size=(3, 20_000))
    gain = np.exp(x + 0.5 * y)  # ranks see what is monotonous, not what is linear
    found = compare(
        predicted(qrs_area=np.zeros(20_000)), predicted(qrs_area=gain), "qrs_area"
    ).variance_explained_by({"z": z, "y": y, "x": x, "fixed": np.ones(20_000)})
    assert [name for name, _ in found] == ["x", "y", "z", "fixed"]
    shares = dict(found)
    assert shares["x"] == pytest.approx(0.8, abs=0.03)  # 1 / (1 + 0.25), a little less in ranks
    assert shares["y"] == pytest.approx(0.2, abs=0.03)
    assert shares["z"] == pytest.approx(0.0, abs=0.01)
    assert shares["fixed"] == 0.0


def test_says_what_would_help():
    """A datum that is the gain itself, one with as much error as spread, one that says nothing."""
    rng = np.random.default_rng(1)
    gain, noise = 6.0 * rng.normal(size=(2, 50_000))
    paced = predicted(qrs_duration=gain, qrs_area=noise)
    own = predicted(lv_rv_delay=1000 * gain**3, lv_activation_time=np.full(50_000, 80.0))
    found = compare(predicted(qrs_area=np.zeros(50_000)), predicted(qrs_area=gain), "qrs_area")
    helped = found.value_of_measurement({"rv-apical-pacing": paced, "intrinsic": own})
    assert [what[:2] for what in helped[:2]] == [
        ("intrinsic", "lv_rv_delay"), ("rv-apical-pacing", "qrs_duration"),
    ]  # fmt: skip
    shares = {what: share for _, what, share in helped}
    assert shares["lv_rv_delay"] == pytest.approx(1.0, abs=1e-3)
    error = np.hypot(ONSET_ERROR, OFFSET_ERROR)
    assert shares["qrs_duration"] == pytest.approx(36 / (36 + error**2), abs=0.01)
    assert shares["qrs_area"] == pytest.approx(0.0, abs=0.001)
    assert shares["lv_activation_time"] == 0.0
    assert [scenario for scenario, _, _ in found.value_of_measurement({"intrinsic": own})] == [
        "intrinsic"
    ] * 2


@pytest.mark.parametrize("index", ["latest_segment", "v6_r_wave_peak_time", "speed"])
def test_what_is_not_compared(index):
    with pytest.raises(InputError, match=f"index '{index}' is not compared; choose one of qrs_"):
        compare(predicted(), predicted(), index)
