"""The cell model against a second implementation and published values."""

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.forward.cable import duration, max_upstroke, simulate_cell
from fascicle.kernels.cable import cable_of
from fascicle.kernels.ten_tusscher import CELLS, C, Row, advance

MIDMYOCARDIAL = np.array(CELLS["midmyocardial"].constants)
EPICARDIAL = CELLS["epicardial"]

# A state at rest, one in the plateau and one below -40 mV, and the time derivatives there, without
# stimulus, of the mid-myocardial cell as MonoAlg3D computes them (github.com/rsachetto/MonoAlg3D_C,
# ten_tusscher_2006_RS_CPU.c, commit 5c9bf3f7), but for the time constant of f2, where that program
# follows the CellML version: put in its place was that of the authors' program.
STATES = np.array(
    [
        [-85.23, 0.00172, 0.7444, 0.7045, 3.373e-05, 0.7888, 0.9755, 0.9953, 2.42e-08, 0.999998,
         0.00621, 0.4712, 0.0095, 0.9073, 0.000126, 3.64, 0.00036, 8.604, 136.89],
        [10, 0.99, 0.01, 0.05, 0.9, 0.6, 0.7, 0.8, 0.2, 0.5, 0.3, 0.02, 0.1, 0.8, 0.0006, 2.5, 0.02,
         9, 137],
        [-45, 0.3, 0.2, 0.3, 0.05, 0.5, 0.6, 0.9, 0.01, 0.3, 0.2, 0.2, 0.2, 0.9, 0.0005, 3, 0.001,
         10, 138],
    ]
)  # fmt: skip
RATES = np.array(
    [
        [-0.0016314932, -0.0043103647, 6.5901345e-05, 0.00052978211, -2.1035034e-08, 0.0010592847,
         0.0015051826, 5.6940655e-05, -8.9230247e-12, -1.8582319e-08, -0.00012738141,
         -2.9927388e-05, -7.758525e-05, 0.00044560123, -1.7839621e-07, -1.6016246e-05,
         -7.8864507e-07, 4.442201e-05, 1.599334e-05],
        [2.6639336, 0.15971685, -0.051260906, -0.052264278, 0.074480694, -0.0052897367,
         -0.057749348, 0.0016520894, -0.012979771, -0.067136778, 0.0086233756, -0.0011373403,
         0.00060655533, -5.8823529e-06, -3.0809282e-06, 0.0031731889, 0.062904023, -2.9855797e-05,
         -0.00027804286],
        [2.8128902, 2.2510078, -0.024991281, -0.0039647157, -0.043773671, 0.0011018073,
         0.0038549541, 0.0012170613, -0.00098144375, 0.0074549165, -0.00012983243, -0.025166641,
         -0.0014339456, 0.00044735, -3.735072e-06, 0.0031514755, 0.00024549846, 0.00042183228,
         -6.4095368e-05],
    ]
)  # fmt: skip


def central_rates(state):
    """Time derivatives by a step forwards and one backwards."""
    step = 1e-5
    ends = []
    for dt in (step, -step):
        end = state[None].copy()
        cable_of(advance, keep=True)(end, MIDMYOCARDIAL, (0.0, 0, 0), 0.0, dt, 1, np.zeros(1, int))
        ends.append(end[0])
    return (ends[0] - ends[1]) / (2 * step)


@pytest.mark.parametrize("which", range(3))
def test_rates_are_those_of_a_second_implementation(which):
    """But for the curvature over the step, which m at rest shows, and rounding."""
    rounding = 2e-16 * np.abs(STATES[which]) / 1e-5
    error = np.abs(central_rates(STATES[which]) - RATES[which])
    assert (error < 1e-4 * np.abs(RATES[which]) + 2 * rounding).all()


@pytest.fixture(scope="module")
def paced():
    """Each type after 20 beats at 1000 ms."""
    return {name: simulate_cell(cell, beats=20) for name, cell in CELLS.items()}


def test_resting_potentials_are_the_published_ones(paced):
    """Initial potentials of the paper's three cells (CellML, workspace 604), to within a drift."""
    published = {"endocardial": -86.709, "midmyocardial": -85.423, "epicardial": -85.23}
    for cell, run in paced.items():
        assert run.potential[0] == pytest.approx(published[cell], abs=0.75)


def test_durations_of_the_types(paced):
    """Values of this code, not published ones: they change if any constant does."""
    apd = {cell: duration(run.time, run.potential) for cell, run in paced.items()}
    assert apd["epicardial"] == pytest.approx(305.4, abs=0.5)
    assert apd["endocardial"] == pytest.approx(297.8, abs=0.5)
    assert apd["midmyocardial"] == pytest.approx(391.3, abs=0.5)


def test_restitution_slope_is_the_published_one():
    """Dynamic restitution, S = 1.1: the paper's name for its standard constants (table 2).

    Between cycle lengths of 280 and 260 ms, near the shortest at which the epicardial cell does
    not alternate for good; two beats in a row are averaged, since alternation dies out slowly.
    """
    state, durations = None, {}
    for cycle_length in (400.0, 350.0, 320.0, 300.0, 290.0, 280.0, 270.0, 260.0):
        pair = []
        for beats in (30, 1):
            run = simulate_cell(EPICARDIAL, cycle_length, beats, state, step=0.02)
            state = run.state
            pair.append(duration(run.time, run.potential))
        durations[cycle_length] = np.mean(pair)
    longer, shorter = durations[280.0], durations[260.0]
    slope = (longer - shorter) / ((280.0 - longer) - (260.0 - shorter))
    assert slope == pytest.approx(1.1, abs=0.1)
    assert (np.diff(list(durations.values())) < 0).all()


def test_second_order_in_time():
    state = simulate_cell(EPICARDIAL, beats=1).state
    peaks = [
        simulate_cell(EPICARDIAL, 20.0, 1, state, step).potential.max()
        for step in (0.04, 0.02, 0.01, 0.005)
    ]
    first, second, third = np.diff(peaks)
    assert np.log2(first / second) == pytest.approx(2.0, abs=0.35)
    assert np.log2(second / third) == pytest.approx(2.0, abs=0.35)


def test_charge_is_conserved():
    """The potential follows from the ions: V·C = F·V_c·(Na + K + 2·Ca) + constant.

    With the calcium in buffers, reticulum and subspace counted; the midpoint rule keeps it exactly.
    """

    def charge(state):
        free = state[[Row.CA_I, Row.CA_SR, Row.CA_SS]]
        buffers = np.array([C.buf_c, C.buf_sr, C.buf_ss])
        halves = np.array([C.k_buf_c, C.k_buf_sr, C.k_buf_ss])
        calcium = (free + buffers * free / (free + halves)) @ [C.v_c, C.v_sr, C.v_ss]
        ions = C.v_c * (state[Row.NA_I] + state[Row.K_I]) + 2 * calcium
        return C.faraday * ions / C.capacitance

    start = np.array(CELLS["endocardial"].start)
    run = simulate_cell(CELLS["endocardial"], 250.0)  # ends in the middle of repolarisation
    moved = run.state[Row.V] - start[Row.V]
    assert moved > 20
    assert charge(run.state) - charge(start) == pytest.approx(moved, abs=1e-6)


def test_a_beat_goes_on_from_a_state():
    whole = simulate_cell(EPICARDIAL, 400.0, 3)
    first = simulate_cell(EPICARDIAL, 400.0, 2)
    last = simulate_cell(EPICARDIAL, 400.0, 1, first.state)
    np.testing.assert_array_equal(last.potential, whole.potential)
    assert last.time[-1] == pytest.approx(400.0)
    assert len(last.time) == len(last.potential)


def test_measures_of_a_known_curve():
    """A logistic upstroke of slope A/(4w) and an exponential fall of time constant 50 ms."""
    time = np.concatenate([np.arange(0, 20, 0.05), np.arange(20, 400, 0.5)])
    rise = 100 / (1 + np.exp(-(time - 10.013) / 0.3))
    potential = -80 + np.where(time < 20, rise, 100 * np.exp(-(time - 20) / 50))
    slope, when = max_upstroke(time, potential)
    assert slope == pytest.approx(100 / 1.2, rel=1e-4)
    assert when == pytest.approx(10.013, abs=1e-3)
    assert potential.max() == pytest.approx(20.0)
    assert duration(time, potential) == pytest.approx(20 + 50 * np.log(10) - 10.013, abs=0.01)
    assert duration(time, potential, 0.5) == pytest.approx(20 + 50 * np.log(2) - 10.013, abs=0.01)
    with pytest.raises(InputError, match="record longer"):
        duration(time[:600], potential[:600])


def test_wrong_input_is_named():
    for wrong in ({"beats": 0}, {"cycle_length": 5.0}, {"step": 0.0}, {"step": 2.0}):
        with pytest.raises(InputError, match="pacing"):
            simulate_cell(EPICARDIAL, **wrong)
