"""The compiled growth against the same rules written down plainly."""

import numpy as np
import pytest
from grown_trees import ANGLES, LENGTHS, grow
from plain_growth import grow_plainly

from fascicle.purkinje.growth import GrowthRules


def plainly(surface, lengths, angles, rules):
    _, chart, seed = surface
    return grow_plainly(chart, seed, lengths[0], lengths[1:], angles, rules)


@pytest.mark.parametrize("angles", ANGLES[:2])
def test_same_tree_as_growth_written_down_plainly(surface, angles):
    """Found equal to 1e-12 mm; a nearest node that the search misses moves nodes by far more."""
    rules = GrowthRules(generations=7)
    bundle, fascicles = LENGTHS[surface[0].side]
    wanted, positions = plainly(surface, (bundle, *fascicles), angles, rules)
    tree = grow(surface, angles=angles, rules=rules)
    assert tree.parents.tolist() == wanted.parents
    np.testing.assert_allclose(tree.nodes, positions, rtol=0, atol=1e-9)


def test_a_tree_of_many_nodes_begins_as_one_of_fewer_generations(surface):
    """The nodes' array grows meanwhile: nothing may be lost or mixed up."""
    many, few = (
        grow(surface, rules=GrowthRules(branch_length=3.0, generations=g)) for g in (40, 6)
    )
    n = len(few.nodes)
    assert len(many.nodes) > 10000
    assert n < 8000
    for name in ("nodes", "parents", "lengths"):
        np.testing.assert_array_equal(getattr(many, name)[:n], getattr(few, name))
