"""Wrong fibres and labels of a mesh: the message says how often, and where the first three are.

Wrong tetrahedra, edges and points: tests/cli/test_import_refused.py.
"""

from pathlib import Path

import numpy as np
import pytest
from builders import box

from fascicle.build.labelled_files import labelled_tetrahedra
from fascicle.core.errors import InputError
from fascicle.mesh.checks import check_fibres, first_places
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.topology import boundary_triangles

BLOCK = box(60.0, 4, jitter=0.1)
P, T = BLOCK.vertices, BLOCK.tetrahedra
SKIN = boundary_triangles(T)[0]
BAD = np.array([7, 40, 41, 90])
WITHIN = np.column_stack([SKIN[BAD, :2], np.setdiff1d(np.arange(len(SKIN)), SKIN)[:4]])


def labelled(triangles):
    """Read the block with these triangles labelled."""
    labels = {"label": np.resize([1.0, 2, 3, 4], len(triangles))}
    cells = {TETRAHEDRON: T, TRIANGLE: triangles}
    labelled_tetrahedra(MeshFile(Path("m"), P, cells, {}, {TRIANGLE: labels}))


def check_zero_fibres(cells):
    fibres = np.ones((len(T), 3))
    fibres[BAD] = 0
    check_fibres("m", fibres, P, cells)


@pytest.mark.parametrize(
    ("check", "given", "numbers", "places"),
    [
        (check_zero_fibres, T, BAD, P[T[BAD]]),
        (labelled, np.concatenate([SKIN, WITHIN]), WITHIN, P[WITHIN]),
        (labelled, SKIN[9:], SKIN[:9], P[SKIN[:9]]),
        (labelled, np.concatenate([SKIN, SKIN[BAD]]), SKIN[BAD], P[SKIN[BAD]]),
    ],
    ids=["fibres", "triangles inside", "not labelled", "two labels"],
)
def test_the_first_three_are_told(check, given, numbers, places):
    with pytest.raises(InputError) as refused:
        check(given)
    assert f" (first: {first_places(numbers, places)}); " in str(refused.value)


def test_a_place_is_the_middle_of_an_element():
    assert first_places(np.array([[3, 12]]), np.array([[[0, 0, 0], [2, -4, 1.0]]])) == (
        "3-12 at (1.0, -2.0, 0.5) mm"
    )
