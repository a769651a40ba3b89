"""The whole forward model on the packaged heart: clinical signs, conventions, refusals."""

import numpy as np
import pytest
from clinical import assert_left_bundle_branch_block, assert_normal

import fascicle
from fascicle.core.leads import LEADS
from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.forward.beat import Beat


@pytest.fixture(scope="module")
def own(default_model):
    return fascicle.example_parameters(default_model)


@pytest.fixture(scope="module")
def normal(default_model, own):
    return default_model.simulate(own)


@pytest.fixture(scope="module")
def left_block(default_model, own):
    return default_model.simulate(own | {"interventricular_delay": -60.0})


def test_normal_qrs(normal):
    assert_normal(normal)
    assert normal.ecg.dims == ("lead", "time")
    assert normal.ecg.lead.to_numpy().tolist() == list(LEADS)


def test_left_bundle_branch_block(normal, left_block):
    """Late left root. Mirrored charts or signs would fail."""
    assert_left_bundle_branch_block(left_block)
    assert left_block.qrs_duration > normal.qrs_duration + 25


def test_left_bundle_branch_block_enters_the_left_tree_backwards(left_block):
    """Before its root fires at 60 ms, the left tree conducts what comes through the septum.

    In a tree that fires first, the tissue overtakes detours here and there (a tenth of them).
    """
    left, right = left_block.coupled.retrograde
    assert left.mean() > 0.2
    assert right.mean() < 0.15
    assert left_block.total_activation_time > 100.0


def test_complete_block_conducts_back_to_the_root(default_model, own, left_block):
    """A left root that would fire at 300 ms is reached from below long before."""
    simulation = default_model.activate(left_block.trees, -300.0, own["cv"])
    left = simulation.coupled.trees[0]
    assert left.max() < 200.0
    assert left[0] > left[simulation.trees[0].junctions].min()
    assert simulation.activation.max() < 200.0


def test_right_bundle_branch_block_turns_v1_positive_late(default_model, own):
    """Late right root: the last thing V1 sees comes towards it."""
    simulation = default_model.simulate(own | {"interventricular_delay": 60.0})
    v1 = simulation.ecg.sel(lead="V1").to_numpy()
    late = v1[len(v1) // 2 :]
    assert late.max() > -late.min()


@pytest.mark.parametrize(("root_time", "left", "right"), [(30.0, 0, 30), (-30.0, 30, 0), (0, 0, 0)])
def test_root_time_is_right_minus_left(default_model, root_time, left, right):
    """The later root may fire earlier than that through the tissue, the earlier one is exact."""
    coupled = default_model.simulate(EXAMPLE_PARAMETERS | {"root_time": root_time}).coupled
    roots = [times[0] for times in coupled.trees]
    assert roots[0] == pytest.approx(left)
    assert roots[1] == pytest.approx(right)


def test_simulating_twice_is_identical(default_model, own, normal):
    again = default_model.simulate(own)
    np.testing.assert_array_equal(again.ecg.to_numpy(), normal.ecg.to_numpy())
    np.testing.assert_array_equal(again.activation, normal.activation)


def test_every_vertex_and_node_is_reached(normal):
    assert np.isfinite(normal.activation).all()
    assert normal.activation.min() >= 0
    assert all(np.isfinite(times).all() for times in normal.coupled.trees)
    assert max(d.max() for d in normal.coupled.junction_distances) < 0.5  # mm off the tissue


def test_ecg_changes_smoothly_with_the_parameters(default_model, own, normal):
    """A nudge of 0.01 ms or 0.01 % must not change any lead by a per cent of the largest."""
    size = np.abs(normal.ecg.to_numpy()).max()
    for name, nudge in (("interventricular_delay", 0.01), ("cv", 3e-4)):
        nudged = default_model.simulate(own | {name: own[name] + nudge}).ecg.to_numpy()
        n = min(nudged.shape[1], normal.ecg.shape[1])
        change = np.abs(nudged[:, :n] - normal.ecg.to_numpy()[:, :n]).max()
        assert 0 < change < 0.01 * size


def test_zero_is_an_angle_and_a_root_time(default_model):
    """`x or default` would replace them."""
    zeros = {name: 0.0 for name in NETWORK_SPACE.names if "angle" in name} | {"root_time": 0.0}
    straight = default_model.simulate(EXAMPLE_PARAMETERS | zeros)
    assert isinstance(straight, Beat)
    assert straight.trees[0].nodes.shape != default_model.grow(EXAMPLE_PARAMETERS)[0].nodes.shape
