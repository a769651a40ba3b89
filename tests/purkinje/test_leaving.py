"""A tree that does not fit says where its bundle or fascicle left the endocardium."""

from __future__ import annotations

import re

import numpy as np
import pytest
from grown_trees import ANGLES, BARE, grow

from fascicle.mesh.topology import boundary_loops
from fascicle.purkinje.tree import InvalidTree, PurkinjeTree

REASON = re.compile(
    r"(LV|RV) (bundle|fascicle \d) leaves the endocardium after ([\d.]+) of ([\d.]+) mm, "
    r"at \((-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\) mm on the base"
)
PRINTED = 0.05 + 1e-9  # mm; the reason has one decimal


def distance_to_base(endocardium, point):
    """Distance (mm) to the polygon that bounds the endocardium."""
    loop = endocardium.vertices[boundary_loops(endocardium.triangles)[0]]
    along = np.roll(loop, -1, axis=0) - loop
    share = np.einsum("ij,ij->i", point - loop, along) / np.einsum("ij,ij->i", along, along)
    nearest = loop + np.clip(share, 0, 1)[:, None] * along
    return np.linalg.norm(nearest - point, axis=1).min()


@pytest.mark.parametrize(
    ("bundle", "fascicles", "stretch"),
    [
        (400.0, (10.0, 10.0), "bundle"),
        (40.0, (400.0, 10.0), "fascicle 1"),
        (40.0, (10.0, 400.0), "fascicle 2"),
    ],
)
@pytest.mark.parametrize("angles", ANGLES[:2])
def test_reason_says_how_far_it_came_and_where_on_the_base(
    surface, bundle, fascicles, stretch, angles
):
    """A tree with just that much of the stretch fits, and ends at that place; more does not fit."""
    endocardium, _, _ = surface
    outcome = grow(surface, bundle, fascicles, angles)
    assert isinstance(outcome, InvalidTree)
    side, which, laid, wanted, *where = REASON.fullmatch(outcome.reason).groups()
    assert (side.lower(), which, float(wanted)) == (endocardium.side, stretch, 400.0)
    point = np.array([float(x) for x in where])
    assert distance_to_base(endocardium, point) < np.sqrt(3) * PRINTED

    def with_stretch(length):
        if stretch == "bundle":
            return grow(surface, length, (0.0,), (0.0,), BARE)
        return grow(surface, bundle, (length,), (angles[int(stretch[-1]) - 1],), BARE)

    fits = with_stretch(float(laid) - PRINTED)
    assert isinstance(fits, PurkinjeTree)
    assert isinstance(with_stretch(float(laid) + PRINTED), InvalidTree)
    end = fits.nodes[fits.junctions[0]]
    assert np.linalg.norm(end - point) < 2 * PRINTED + np.sqrt(3) * PRINTED


def test_a_fascicle_that_cannot_even_begin_reports_its_own_place(surface):
    """Not the end of the fascicle grown before it: the fork lies just short of the base."""
    endocardium, _, _ = surface
    outcome = grow(surface, 400.0, (0.0,), (0.0,), BARE)
    laid = float(REASON.fullmatch(outcome.reason)[3])
    back, onwards = np.pi, 0.0  # rad
    outcome = grow(surface, laid - 0.4, (20.0, 20.0), (back, onwards), BARE)
    _, which, short, *_, x, y, z = REASON.fullmatch(outcome.reason).groups()
    assert which == "fascicle 2"
    assert float(short) < 0.6
    assert distance_to_base(endocardium, np.array([x, y, z], float)) < np.sqrt(3) * PRINTED
