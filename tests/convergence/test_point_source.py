"""A junction in an anisotropic half-space: times against √(dᵀD⁻¹d).

Measured at edges of about 5.4, 2.7 and 1.35 mm, speeds 0.612 and 0.245 mm/ms, 24 mm box; mean / max
error (ms) and observed order of the mean over the last halving:

    no ball       4.79 / 9.97    2.89 / 5.69    1.66 / 3.13    0.80
    two edges     1.34 / 4.02    1.41 / 4.01    1.04 / 2.48    0.44 (the ball shrinks with the mesh)
    6 mm          3.00 / 7.83    1.24 / 3.87    0.58 / 1.54    1.11
"""

from __future__ import annotations

import numpy as np
import pytest
from builders import OBLIQUE, box, line_tree

from fascicle.eikonal.activation import BALL_EDGES, solve
from fascicle.eikonal.tissue import build_tissue
from fascicle.geometry.conduction import Conduction

SIZE = 24.0  # mm
CELLS = (6, 12, 24)  # cells of 4, 2 and 1 mm
FIXED = 6.0  # mm


def point_source_errors(cells, ball_radius):
    """Computed minus exact times (ms) from a junction inside a face of a jittered cube."""
    block = box(SIZE, cells, jitter=0.2, fibre=OBLIQUE, seed=cells)
    radius = BALL_EDGES * block.edge_length if ball_radius is None else ball_radius
    tissue = build_tissue(block, Conduction())
    source = np.array([0.47 * SIZE, 0.55 * SIZE, 0.0])
    tree = line_tree([source - [0, 0, 1.0], source])
    activation = solve(tissue, [tree], [-0.25], 4.0, ball_radius=radius)  # 1 mm at 4 mm/ms
    offset = tissue.vertices - source
    exact = np.sqrt(np.einsum("ni,ij,nj->n", offset, tissue.metric[0], offset))
    return activation.myocardium - exact


@pytest.fixture(scope="module")
def errors():
    """By ball (its radius in mm, None for two edges), coarse to fine."""
    return {
        ball: [point_source_errors(cells, ball) for cells in CELLS] for ball in (0.0, None, FIXED)
    }


def observed_order(coarse, fine):
    return np.log2(coarse.mean() / fine.mean())


def test_speeds_are_those_of_the_paper():
    """0.612 and 0.245 mm/ms along and across at α = 0.05; a slip of √10 would show here."""
    assert Conduction().speeds == pytest.approx((0.6124, 0.2449), abs=1e-4)


def test_no_vertex_is_early(errors):
    """Straight ways through a convex block are geodesics: only rounding may be early."""
    assert min(error.min() for series in errors.values() for error in series) > -1e-9


@pytest.mark.parametrize(("ball", "order"), [(0.0, 0.7), (None, 0.35), (FIXED, 0.95)])
def test_errors_shrink_with_the_mesh(errors, ball, order):
    """Order of the last halving; a wrong local solver gives 0."""
    _, middle, fine = errors[ball]
    assert observed_order(middle, fine) > order
    assert fine.max() < 0.7 * middle.max()


def test_the_ball_reduces_the_point_source_error(errors):
    """Everywhere, and on a mesh as coarse as a heart's by more than half."""
    for with_ball, without in zip(errors[None], errors[0.0], strict=True):
        assert (with_ball <= without + 1e-9).all()
        assert with_ball.mean() < 0.7 * without.mean()
    assert errors[None][0].mean() < 0.4 * errors[0.0][0].mean()
