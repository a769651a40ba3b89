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
    """Lines that share no point, as many programs write them; `length` is not their length."""
    points = np.concatenate([np.asarray(line, float) for line in lines])
    starts = np.cumsum([0, *map(len, lines)])
    cells = np.concatenate(
        [[len(line), *range(start, start + len(line))]
         for line, start in zip(lines, starts, strict=False)]
    )  # fmt: skip
    poly = pv.PolyData(points.astype(np.float32), lines=cells)
    poly.cell_data["length"] = np.ones(len(lines))  # of nothing that is meant here
    poly.save(file)
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


def test_a_point_repeated_by_its_number_makes_a_node_more_and_no_detour(tmp_path):
    lines = np.array([[0, 1], [1, 2], [2, 3]])
    points = np.array([[0.0, 0, 0], [0, 0, 4], [0, 0, 4], [0, 0, 10]])
    pv.UnstructuredGrid({pv.CellType.LINE: lines}, points).save(tmp_path / "tree.vtu")
    tree = read_tree(tmp_path / "tree.vtu", "lv", np.zeros(3))
    assert tree.lengths.tolist() == [0.0, 4.0, 0.0, 6.0]


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


PLACES = {"end": 5, "fork": 2, "within a branch": 1}  # nodes of the tree below


@pytest.mark.parametrize("off", [0.0, 1.9, 2.1])
@pytest.mark.parametrize("place", PLACES)
def test_a_root_is_the_nearest_node_whatever_its_degree(tmp_path, place, off):
    """Within 2 mm; the leaves are the junctions, but for the root."""
    points = np.array([[0.0, 0, 0], [0, 0, 5], [0, 0, 10], [5, 0, 15], [-5, 0, 15], [-9, 0, 20]])
    lines = np.array([[0, 1], [1, 2], [2, 3], [4, 2], [4, 5]])
    pv.UnstructuredGrid({pv.CellType.LINE: lines}, points).save(tmp_path / "tree.vtu")
    node = PLACES[place]
    given = points[node] + [0, off, 0]
    if off > 2:
        with pytest.raises(InputError) as refused:
            read_tree(tmp_path / "tree.vtu", "lv", given)
        at = ", ".join(f"{x:.4f}" for x in points[node])
        assert f"is 2.1 mm away, at ({at}) mm, more than 2 mm; give " in str(refused.value)
        return
    tree = read_tree(tmp_path / "tree.vtu", "lv", given)
    assert tree.root == node
    assert tree.junctions.tolist() == [leaf for leaf in (0, 3, 5) if leaf != node]
    parts = (
        ["bundle", "fascicle 1", "fascicle 2"] if place == "end" else ["fascicle 1", "fascicle 2"]
    )
    assert list(tree.parts) == (parts if place != "fork" else [*parts, "fascicle 3"])
    write_tree(tmp_path / "again.vtu", tree, np.zeros(6))
    write_opencarp_tree(tmp_path / "again", tree)
    for name in ("again.vtu", "again.pts"):  # which mark their root
        again = read_tree(tmp_path / name, "lv", points[node] + 50, file_first=True)
        assert again.parents.tolist() == tree.parents.tolist()


@pytest.mark.parametrize("marked", [[0, 0, 0], [1, 0, 1]])
def test_a_file_marks_one_root(tmp_path, marked):
    lines = pv.UnstructuredGrid({pv.CellType.LINE: np.array([[0, 1], [1, 2]])}, 9 * np.eye(3))
    lines.point_data["root"] = marked
    lines.save(tmp_path / "tree.vtu")
    with pytest.raises(InputError, match=f"marks {sum(marked)} points; mark one with 1"):
        read_tree(tmp_path / "tree.vtu", "lv", np.zeros(3), file_first=True)


def test_a_root_that_is_a_fork_of_six(data_folder):
    given = np.array([49.5453, 34.2090, 66.7906])
    tree = read_tree(data_folder / "cases" / "c20_fork" / "fork.vtu", "lv", given)
    assert np.linalg.norm(tree.nodes[tree.root] - given) < 1e-3
    assert (tree.parents == tree.root).sum() == 6


def test_a_tree_in_micrometres_says_so(data_folder):
    with pytest.raises(InputError, match=r"seems to be in micrometres; multiply .* by 0.001"):
        read_tree(data_folder / "cases" / "tree_um.vtk", "lv", np.zeros(3))
