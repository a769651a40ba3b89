"""Trees read from lines: by point numbers where these make a tree, else by position."""

from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv

from fascicle.core.errors import InputError
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import read_tree, write_opencarp_tree, write_tree

# a bundle and two fascicles whose ends meet in one place without being connected there
MEETING = PurkinjeTree(
    "lv",
    np.array([[0.0, 0, 0], [0, 0, 10], [5, 0, 15], [-5, 0, 15], [0, 0, 20], [0, 0, 20]]),
    np.array([-1, 0, 1, 1, 2, 3]),
    np.array([0.0, 10.5, 7.25, 7.25, 8.0, 8.5]),
)


@pytest.mark.parametrize("form", ["vtu", "opencarp"])
def test_nodes_of_two_branches_in_one_place_stay_two(tmp_path, form):
    if form == "vtu":
        file = tmp_path / "tree.vtu"
        write_tree(file, MEETING, np.zeros(6))
    else:
        file = tmp_path / "tree.pts"
        write_opencarp_tree(tmp_path / "tree", MEETING)
    tree = read_tree(file, "lv", np.zeros(3))
    np.testing.assert_allclose(tree.nodes, MEETING.nodes, atol=1e-9)
    np.testing.assert_array_equal(tree.parents, MEETING.parents)
    np.testing.assert_allclose(tree.lengths, MEETING.lengths, atol=1e-9)
    assert tree.junctions.tolist() == [4, 5]


def test_directions_of_segments(tmp_path):
    """One branch anterograde, one that the myocardium enters and climbs, one silent."""
    fork = replace(MEETING, parents=np.array([-1, 0, 1, 1, 2, 1]))
    times = np.array([0.0, 4.0, 2.0, np.inf, 1.0, 7.0])
    write_tree(tmp_path / "tree.vtu", fork, times)
    found = pv.read(tmp_path / "tree.vtu").cell_data["direction"]
    assert found.tolist() == [1, -1, 0, -1, 1]


def save_polylines(file, *lines):
    """Every line with points of its own, as many programs write them."""
    points = np.concatenate([np.asarray(line, float) for line in lines])
    starts = np.cumsum([0, *map(len, lines)])
    cells = np.concatenate(
        [[len(line), *range(start, start + len(line))]
         for line, start in zip(lines, starts, strict=False)]
    )  # fmt: skip
    pv.PolyData(points, lines=cells).save(file)
    return file


BUNDLE = [[0, 0, 0], [0, 0, 4], [0, 0, 4], [0, 0, 10]]  # one point twice along it
LEFT = [[0, 0, 10], [5, 0, 15]]
RIGHT = [[0, 0, 10], [-5, 0, 15], [-5, 0, 20]]


def test_polylines_that_repeat_the_points_they_share_are_joined_there(tmp_path):
    file = save_polylines(tmp_path / "tree.vtp", BUNDLE, LEFT, RIGHT)
    tree = read_tree(file, "lv", np.zeros(3))
    assert len(tree.nodes) == 6
    assert tree.lengths.sum() == pytest.approx(10 + np.sqrt(50) + np.sqrt(50) + 5)
    assert len(tree.junctions) == 2
    assert (tree.lengths > 0).sum() == 5


def test_polylines_that_close_a_loop_are_refused(tmp_path):
    file = save_polylines(tmp_path / "tree.vtp", BUNDLE, LEFT, RIGHT, [LEFT[-1], RIGHT[-1]])
    with pytest.raises(InputError, match="6 segments between 6 nodes make a loop"):
        read_tree(file, "lv", np.zeros(3))


def test_a_loop_by_point_numbers_is_refused(tmp_path):
    child = np.arange(1, 6)
    lines = np.vstack([np.column_stack([MEETING.parents[child], child]), [2, 3]])
    pv.UnstructuredGrid({pv.CellType.LINE: lines}, MEETING.nodes).save(tmp_path / "tree.vtu")
    with pytest.raises(InputError, match="make a loop"):
        read_tree(tmp_path / "tree.vtu", "lv", np.zeros(3))


def test_lines_of_no_length_are_refused(tmp_path):
    file = save_polylines(tmp_path / "tree.vtp", np.zeros((3, 3)))
    with pytest.raises(InputError, match="every line has length zero"):
        read_tree(file, "lv", np.zeros(3))
