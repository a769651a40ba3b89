"""The sweep ends at a solution of the discrete problem: nothing can be lowered any more."""

from __future__ import annotations

import numpy as np
import pytest
from builders import OBLIQUE, box_tissue, lowest_offers, solve_without_trees

from fascicle.parameters import EXAMPLE_PARAMETERS

TOLERANCE = 1e-9  # ms
HALVINGS = 26  # golden sections; leaves 4e-6 of a side, so 1e-10 ms in a smooth minimum


def offers(tissue, time):
    return lowest_offers(tissue.vertices, tissue.corners, tissue.metric, time, HALVINGS)


@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_vertices_of_an_anisotropic_cube_solve_the_discrete_equation(jitter):
    """From two stimuli, both ways: no vertex is too late, and none earlier than it can be."""
    tissue = box_tissue(20.0, 10, jitter=jitter, fibre=OBLIQUE)
    stimuli = {0: 0.0, 700: 13.0}
    time = solve_without_trees(tissue, stimuli)
    offered = offers(tissue, time)
    assert np.max(time - offered) < TOLERANCE
    reached = np.setdiff1d(np.arange(len(time)), list(stimuli))
    assert np.max(offered[reached] - time[reached]) < TOLERANCE


@pytest.mark.parametrize("model", ["default_model", "crtdemo_model"])
def test_no_vertex_of_a_heart_can_be_lowered(model, request):
    """After the coupled sweep. Balls are earlier than the mesh's own solution, so one way only."""
    model = request.getfixturevalue(model)
    simulation = model.simulate(EXAMPLE_PARAMETERS | {"root_time": -20.0})
    time = simulation.activation
    assert np.max(time - offers(model.tissue, time)) < TOLERANCE


def test_order_of_stimuli_does_not_matter():
    tissue = box_tissue(20.0, 8, jitter=0.2, fibre=OBLIQUE)
    stimuli = {3: 1.0, 200: 0.0, 500: 4.0}
    forwards = solve_without_trees(tissue, stimuli)
    backwards = solve_without_trees(tissue, dict(reversed(stimuli.items())))
    np.testing.assert_allclose(forwards, backwards, atol=TOLERANCE, rtol=0)
