"""Fronts in the cable: speed, convergence, scaling."""

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.forward.cable import STIMULUS, max_upstroke, simulate_cable, simulate_cell
from fascicle.kernels.cable import cable_of
from fascicle.kernels.ten_tusscher import CELLS

EPICARDIAL = CELLS["epicardial"]
DIFFUSIVITY = 0.154  # mm²/ms


def passage(spacing, step, diffusivity=DIFFUSIVITY, length=12.0):
    """Until the front has left, after two beats."""
    return simulate_cable(EPICARDIAL, diffusivity, length, 30.0, spacing, step, beats=2)


def published_scheme_speed(spacing, step, length=20.0):
    """Speed (mm/ms) with forward Euler and three-point differences, as the paper computes tissue.

    λ = 0 makes the kernel advance the cells without diffusion.
    """
    n = round(length / spacing) + 1
    state = np.tile(simulate_cell(EPICARDIAL, beats=2).state, (n, 1))
    fired = np.full(n, np.nan)
    for k in range(round(30.0 / step)):
        v = state[:, 0].copy()
        stimulus = STIMULUS, int(k * step < 2.0), round(1.5 / spacing)
        constants, run = np.array(EPICARDIAL.constants), cable_of(EPICARDIAL.advance, keep=True)
        run(state, constants, stimulus, 0.0, step, 1, np.array([0]))
        edged = np.pad(v, 1, mode="reflect")
        state[:, 0] += DIFFUSIVITY * step / spacing**2 * np.diff(edged, 2)
        crossing = np.isnan(fired) & (state[:, 0] >= -40.0)
        share = (-40.0 - v) / (state[:, 0] - v)
        fired[crossing] = (k + share[crossing]) * step
    first, last = n // 3, 2 * n // 3
    return (last - first) * spacing / (fired[last] - fired[first])


def test_published_speed_with_the_published_discretisation():
    """70 cm/s at D = 154 mm²/s, dx = 0.25 mm, dt = 0.02 ms (2004 and 2006 papers)."""
    assert published_scheme_speed(0.25, 0.02) == pytest.approx(0.70, abs=0.01)


def test_speed_is_that_of_the_benchmark_slab(data_folder):
    """Along the fibre of the N-version slab (Niederer et al. 2011), by fenicsx-beat at 0.1 mm.

    From the stimulated cube, 1.5 mm long and fired at P1's time, to P3 at 20 mm. Its D is
    σᵢσₑ/(σᵢ+σₑ)/(χC) with 0.17 and 0.62 S/m, 140/mm, 0.01 µF/mm².
    """
    path = data_folder / "benchmarks" / "niederer2011" / "fenicsx_beat_points.csv"
    if not path.is_file():
        pytest.skip(f"no {path}")
    finest = np.loadtxt(path, delimiter=",", skiprows=1)[-1]
    published = (20.0 - 1.5) / (finest[4] - finest[2])
    diffusivity = 0.17 * 0.62 / (0.17 + 0.62) / (140 * 0.01)
    assert passage(0.05, 0.01, diffusivity).speed == pytest.approx(published, rel=0.03)


def test_order_of_convergence_in_space():
    """Fourth order once the front is resolved; 3.3 is what the coarsest of these still shows."""
    coarse, middle, fine = (passage(spacing, 0.01).speed for spacing in (0.2, 0.1, 0.05))
    assert np.log2((middle - coarse) / (fine - middle)) > 3.0
    assert fine - middle < 0.002 * fine


def test_order_of_convergence_in_time():
    coarse, middle, fine = (passage(0.1, step).speed for step in (0.02, 0.01, 0.005))
    assert np.log2((middle - coarse) / (fine - middle)) == pytest.approx(2.0, abs=0.3)
    assert fine - middle < 0.001 * fine


def test_speed_goes_with_the_root_of_diffusivity_and_the_time_course_stays():
    fast, slow = passage(0.1, 0.01, length=16.0), passage(0.05, 0.01, DIFFUSIVITY / 4)
    assert fast.speed / slow.speed == pytest.approx(2.0, rel=1e-3)
    steepness = [max_upstroke(run.time, run.potential)[0] for run in (fast, slow)]
    assert steepness[0] == pytest.approx(steepness[1], rel=2e-3)


def test_a_front_that_does_not_arrive_is_an_error():
    with pytest.raises(InputError, match="no front at its end"):
        simulate_cable(EPICARDIAL, 1e-5, 8.0, 40.0, 0.5, 0.02, beats=1)


@pytest.mark.parametrize(
    "wrong", [{"length": 2.0}, {"spacing": 0.6}, {"step": 0.0}, {"diffusivity": 0.0}]
)
def test_wrong_input_is_named(wrong):
    with pytest.raises(InputError, match="cable of"):
        simulate_cable(EPICARDIAL, **wrong)
