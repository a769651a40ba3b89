"""Junctions: leaves, each once, on the endocardium."""

from __future__ import annotations

import numpy as np
import pytest
from grown_trees import ANGLES, grow, on_triangles


@pytest.mark.parametrize("angles", ANGLES)
def test_junctions_are_leaves_unique_and_inside_a_triangle_of_the_endocardium(surface, angles):
    endocardium, _, _ = surface
    tree = grow(surface, angles=angles)
    assert not np.isin(tree.junctions, tree.parents).any()
    assert len(np.unique(tree.junctions)) == len(tree.junctions)
    positions = tree.nodes[tree.junctions]
    assert len(np.unique(positions.round(6), axis=0)) == len(positions)
    _, weights, off = on_triangles(endocardium, positions)
    assert off.max() < 1e-9  # mm
    assert weights.min() > -1e-9
