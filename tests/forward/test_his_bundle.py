"""The His bundle: the intrinsic beat stays, and what runs backwards goes as through one tree."""

import numpy as np
import pytest
from builders import case

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.core.quantities import default_of
from fascicle.forward.primitives import His, SlowConduction, Stimulus
from fascicle.purkinje.tree import PurkinjeTree

HIS_TIME = default_of("his_time")  # ms

CV = EXAMPLE_PARAMETERS["cv"]
NEVER = His(time=np.inf)


def roots(simulation):
    pairs = zip(simulation.coupled.trees, simulation.trees, strict=True)
    return [float(times[tree.root]) for times, tree in pairs]


def joined(trees, branches):
    """Both trees as one whose root is the His bundle, with its branches as segments."""
    starts = (1, 1 + len(trees[0].nodes))
    parents = [
        np.where(tree.parents >= 0, tree.parents + start, 0)
        for tree, start in zip(trees, starts, strict=True)
    ]
    lengths = [tree.lengths.copy() for tree in trees]
    for length, tree, branch in zip(lengths, trees, branches, strict=True):
        length[tree.root] = CV * branch
    return PurkinjeTree(
        "his",
        np.concatenate([np.zeros((1, 3)), *(tree.nodes for tree in trees)]),
        np.concatenate([[-1], *parents]),
        np.concatenate([[0.0], *lengths]),
    )


@pytest.fixture(scope="module")
def simulate(default_model):
    def call(root_time=0.0, alpha=0.05, **options):
        parameters = EXAMPLE_PARAMETERS | {"root_time": root_time, "alpha": alpha}
        return default_model.simulate(parameters, case(**options))

    return call


@pytest.mark.parametrize(("root_time", "alpha"), [(0.0, 0.05), (-60.3, 0.05), (12.345678, 0.07)])
def test_the_own_beat_is_the_same_to_the_last_bit(simulate, root_time, alpha):
    without, with_it = (simulate(root_time, alpha, his=his) for his in (None, His()))
    np.testing.assert_array_equal(with_it.activation, without.activation)
    np.testing.assert_array_equal(with_it.leads, without.leads)
    for one, other in zip(with_it.coupled.trees, without.coupled.trees, strict=True):
        np.testing.assert_array_equal(one, other)
    assert with_it.coupled.his == pytest.approx(-HIS_TIME)
    assert without.coupled.his == np.inf


class TestBackwards:
    def test_pacing_of_the_left_root_comes_down_on_the_right(self, simulate):
        place = tuple(simulate().trees[0].nodes[simulate().trees[0].root])
        paced = simulate(-15.0, stimuli=(Stimulus(3.0, place, "lv"),), his=NEVER)
        # the left branch is the longer one by the root time
        assert paced.coupled.his == pytest.approx(3.0 + HIS_TIME + 15.0)
        assert roots(paced) == pytest.approx([3.0, 3.0 + 2 * HIS_TIME + 15.0])

    @pytest.mark.parametrize("root_time", [0.0, -30.0, 20.0])
    def test_a_front_from_the_tissue_goes_as_through_one_tree(
        self, simulate, default_model, default_heart, root_time
    ):
        """The same trees as one tree, whose root is the bundle: another way through the code."""
        _, right = (e.vertices for e in default_heart.endocardia)
        apex = tuple(right[np.argmin(right @ (right[0] - right.mean(axis=0)))])
        stimuli = (Stimulus(0.0, apex),)
        paced = simulate(root_time, stimuli=stimuli, his=NEVER)
        branches = [HIS_TIME + max(0.0, -root_time), HIS_TIME + max(0.0, root_time)]
        other = default_model.activate(
            [joined(paced.trees, branches)], [0.0], CV, case(stimuli, inactive=("his",))
        )
        assert paced.coupled.his < np.inf
        np.testing.assert_allclose(paced.activation, other.activation, atol=1e-9, rtol=0)
        times = np.concatenate([[paced.coupled.his], *paced.coupled.trees])
        np.testing.assert_allclose(times, other.coupled.trees[0], atol=1e-9, rtol=0)
        ends = simulate(root_time, stimuli=stimuli, inactive=("lv", "rv"))
        assert (paced.activation <= ends.activation + 1e-9).all()

    def test_a_front_that_returns_by_the_other_tree_activates_earlier(self, default_model):
        parameters = EXAMPLE_PARAMETERS | {"root_time": 0.0, "his_time": 1.0}
        right = default_model.grow(parameters)[1]
        stimuli = (Stimulus(0.0, tuple(right.nodes[right.root]), "rv"),)
        returns, ends = (
            default_model.simulate(parameters, case(stimuli, his=his, inactive=silent))
            for his, silent in ((NEVER, ()), (None, ("lv", "rv")))
        )
        assert roots(returns) == pytest.approx([2.0, 0.0])
        assert returns.total_activation_time < ends.total_activation_time - 10.0

    @pytest.mark.parametrize("blocked", ["left", "right"])
    def test_a_blocked_branch_lets_nothing_through(self, simulate, blocked):
        number = ("left", "right").index(blocked)
        with_block = simulate(his=His(**{blocked: 0.0}))
        silent = simulate(inactive=(("lv", "rv")[number],))
        np.testing.assert_array_equal(with_block.activation, silent.activation)
        assert roots(with_block)[1 - number] == 0.0

    def test_a_slow_branch_takes_longer_both_ways(self, simulate):
        down = simulate(his=His(time=0.0, left=0.5))
        assert roots(down) == pytest.approx([2 * HIS_TIME, HIS_TIME])
        place = tuple(down.trees[0].nodes[down.trees[0].root])
        up = simulate(stimuli=(Stimulus(0.0, place, "lv"),), his=His(time=np.inf, left=0.5))
        assert roots(up) == pytest.approx([0.0, 3 * HIS_TIME])

    def test_a_block_below_leaves_the_bundle_alone(self, simulate):
        """The front that comes to the root of a blocked tree from the bundle ends there."""
        blocked = simulate(slow=(SlowConduction("lv", 0.0, "bundle"),), his=His())
        alone = simulate(inactive=("lv",), slow=(SlowConduction("lv", 0.0, "bundle"),))
        np.testing.assert_array_equal(blocked.activation, alone.activation)


def test_its_own_root_time_counts_in_place_of_the_networks(simulate):
    paced = simulate(-60.0, his=His(time=0.0, root_time=0.0))
    assert roots(paced) == pytest.approx([HIS_TIME, HIS_TIME])


def test_the_time_to_the_roots_is_a_quantity(default_model):
    paced = default_model.simulate(
        EXAMPLE_PARAMETERS | {"root_time": 10.0, "his_time": 35.0}, case(his=His(time=5.0))
    )
    assert roots(paced) == pytest.approx([40.0, 50.0])


class TestRefusals:
    def test_a_silent_root(self, simulate):
        with pytest.raises(InputError, match=r"inactive root 'rv'.*right = 0"):
            simulate(his=His(), inactive=("rv",))

    def test_one_tree_alone(self, default_model, simulate):
        with pytest.raises(InputError, match="joins the trees lv and rv; known: rv"):
            default_model.activate(simulate().trees[1:], [0.0], CV, case(his=His()))

    def test_nothing_that_fires(self, simulate):
        with pytest.raises(InputError, match="nothing activates the myocardium"):
            simulate(his=NEVER)
