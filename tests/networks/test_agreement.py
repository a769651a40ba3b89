"""Agreement of networks with a recording, against a second computation."""

from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.leads import LEADS
from fascicle.networks.agreement import agreement
from fascicle.recording.target import Target

N = 5


@pytest.fixture
def target():
    rng = np.random.default_rng(1)
    time = np.arange(-100.0, 101.0)
    beats = rng.normal(size=(3, 12, len(time))) + 5 * np.exp(-((time / 20) ** 2))
    beats[:, LEADS.index("V6")] = np.nan
    return Target(beats, time, -40.0, 40.0, 60.0)


@pytest.fixture
def networks(target):
    rng = np.random.default_rng(2)
    mean = np.nan_to_num(target.mean)
    return [
        SimpleNamespace(
            predicted=0.8 * mean + rng.normal(size=mean.shape),
            beat=SimpleNamespace(qrs_duration=80.0 + k),
        )
        for k in range(N)
    ]


def test_of_each_lead_and_over_all(target, networks):
    found = agreement(target, networks)
    inside = (target.time >= -40) & (target.time <= 40)
    mean = sum(network.predicted for network in networks) / N
    recorded = target.beats.mean(axis=0)
    every = []
    for row, lead in enumerate(LEADS):
        r, p = recorded[row, inside], mean[row, inside]
        if lead == "V6":
            assert np.isnan(found.explained[row])
            assert np.isnan(found.correlation[row])
            continue
        assert found.explained[row] == pytest.approx(
            1 - np.var(r - p) / np.mean(r**2) - np.mean(r - p) ** 2 / np.mean(r**2)
        )
        assert found.correlation[row] == pytest.approx(np.corrcoef(r, p)[0, 1])
        every.append((r, p))
    # a share that is rounded to whole percent is the same from the summary
    content = found.content()
    shares = content["explained_power"]
    assert shares["II"] == pytest.approx(found.explained[LEADS.index("II")], abs=1e-6)
    assert shares["V6"] is None
    assert set(content["correlation"]) == {*LEADS, "all"}
    r, p = np.hstack(every)
    assert found.explained_over_all == pytest.approx(1 - np.sum((r - p) ** 2) / np.sum(r**2))
    assert found.correlation_over_all == pytest.approx(np.corrcoef(r, p)[0, 1])
    # durations
    assert found.recorded["qrs_duration_ms"] == target.qrs_duration
    assert found.percentiles("qrs_duration_ms")[1] == 82.0
    assert content["qrs_duration_ms"]["networks"]["median"] == 82.0


def test_axes_across_the_half_turn_are_near(target, networks):
    """170 and -170 degrees are 20 degrees apart, and their median is about 180."""
    beats = np.zeros_like(target.beats)
    shape = np.exp(-((target.time / 20) ** 2))

    def of(angle):
        lead = np.tile(shape, (12, 1))
        lead[0] = np.cos(np.radians(angle)) * shape
        lead[5] = np.sin(np.radians(angle)) * shape * np.sqrt(3) / 2
        return lead

    beats[:] = of(170.0)
    for k, network in enumerate(networks):
        network.predicted = of((-170.0, 175.0, -175.0, 178.0, -178.0)[k])
    found = agreement(Target(beats, target.time, -40.0, 40.0, 60.0), networks)
    assert found.recorded["axis_degrees"] == pytest.approx(170.0)
    assert found.percentiles("axis_degrees")[1] == pytest.approx(182.0)


def test_flat_predictions_explain_nothing(target, networks):
    for network in networks:
        network.predicted = np.zeros_like(network.predicted)
    found = agreement(target, networks)
    assert found.explained_over_all == 0.0
    assert found.correlation_over_all == 0.0
