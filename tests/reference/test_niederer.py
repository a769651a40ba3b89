"""The slab of the N-version benchmark: eikonal against published monodomain codes' times.

The bounds are what was measured, rounded up by about a tenth. A wrong anisotropy costs far more:
the best isotropic front is off by 7.5 ms (root mean square), fibres across the slab by 34 ms.
"""

import numpy as np
import pytest

from benchmarks import niederer

SPACING = 0.5  # mm


@pytest.fixture(scope="module")
def folder(data_folder):
    """The benchmark's monodomain solutions."""
    path = data_folder / "benchmarks" / "niederer2011"
    for name in (niederer.POINTS_FILE, niederer.FIELD_FILE):
        if not (path / name).is_file():
            pytest.skip(f"no {name} in {path}")
    return path


@pytest.fixture(scope="module")
def finest(folder):
    """The comparison with the finest monodomain solution."""
    return niederer.compare_points(folder, SPACING)


def test_nine_points_agree_with_a_fine_monodomain_solution(finest):
    assert finest.misfit < 0.9
    assert np.abs(finest.difference).max() < 1.5
    assert finest.monodomain.max() > 37  # so that is 4 % of the slab's activation time


def test_fitted_speeds_are_those_of_the_cell_model_and_conductivities(finest):
    assert finest.along == pytest.approx(0.634, abs=0.01)
    assert finest.across == pytest.approx(0.2335, abs=0.004)
    assert finest.along / finest.across == pytest.approx(niederer.speed_ratio(), rel=0.02)


def test_difference_has_the_sign_of_the_monodomain_grids_bias(folder, finest):
    """Later along the diagonals of its tetrahedra, earlier along the axes."""
    p2, p3, p4, p8 = finest.difference[[1, 2, 3, 7]]
    assert p8 > p4 > 0.5
    assert max(p2, p3) < -0.5
    coarser = niederer.read_points(folder)[1:]
    assert (coarser[:, 7] < coarser[:, 3]).all()  # P8 before P4, which is nearer


def test_solver_gives_the_exact_eikonal_solution(finest):
    assert finest.solver_error < 1e-9


def test_other_speeds_along_other_axes_are_seen(finest):
    """Exchanged speeds, as fibres across the slab would give."""
    swapped = niederer.eikonal_times(SPACING, finest.across, finest.along, finest.monodomain[0])
    corners = swapped[[0, -1], [-1, 0], [0, 0]]  # P2, P3
    assert corners[0] < finest.monodomain[1] - 10
    assert corners[1] > finest.monodomain[2] + 10


def test_coarse_monodomain_field_is_no_eikonal_solution(folder):
    """Its far corner fires before nearer ones; still the diagonal stays within a few ms."""
    coarse = niederer.compare_field(folder, SPACING)
    p3, p4, p7, p8 = coarse.monodomain[[2, 3, 6, 7]]
    assert p8 == pytest.approx(36.2962)
    assert p8 < min(p3, p4, p7)
    gap = np.abs(coarse.diagonal[1] - coarse.diagonal[0])
    assert gap.mean() < 1.4
    assert gap.max() < 5.4
