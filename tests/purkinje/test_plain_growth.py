"""The compiled growth against the same rules written down plainly, and what moves nodes."""

import numpy as np
import pytest
from grown_trees import ANGLES, LENGTHS, grow
from plain_growth import grow_plainly

from fascicle.purkinje.growth import GrowthRules

NUDGE = 1e-3  # mm


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


def test_lengths_move_nodes_continuously_between_changes_of_the_rules_choices(surface):
    """0.001 mm more of a bundle or fascicle moves no node by more than 0.01 mm.

    That holds while every node keeps its nearest node, its triangle and its children. Another
    nearest node turns a branch; another triangle has another metric, constant on each: found to
    move nodes by 0.06 mm at most in four generations.
    """
    rules = GrowthRules(generations=3)
    rng = np.random.default_rng(0)
    bundle, fascicles = LENGTHS[surface[0].side]
    moved, moved_by_triangle = [], []
    for _ in range(4):
        lengths = np.array([bundle, *fascicles]) + rng.uniform(-2, 2, 3)
        before, _ = plainly(surface, lengths, ANGLES[0], rules)
        for nudge in NUDGE * np.eye(3):
            after, _ = plainly(surface, lengths + nudge, ANGLES[0], rules)
            if (after.parents, after.steered_by) != (before.parents, before.steered_by):
                continue
            one, other = (
                grow(surface, at[0], at[1:], ANGLES[0], rules) for at in (lengths, lengths + nudge)
            )
            distance = np.linalg.norm(other.nodes - one.nodes, axis=1).max()
            if after.triangle == before.triangle:
                moved.append(distance)
            else:
                moved_by_triangle.append(distance)
    assert len(moved) >= 6  # of 12
    assert min(moved) > 0.5 * NUDGE
    assert max(moved) < 10 * NUDGE
    assert max(moved_by_triangle, default=0.0) < 0.1
