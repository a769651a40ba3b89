"""What a table does not say is asked for, with guesses that work."""

import re
from itertools import chain

import numpy as np
import pandas as pd
import pytest

import fascicle
from fascicle.core.leads import LEADS
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.simulation_files import write_ecg
from fascicle.recording.recording import missing_rate, missing_time_unit, missing_unit

pytestmark = pytest.mark.usefixtures("blank_pictures")


@pytest.fixture
def table(tmp_path, default_model):
    """Writes one simulated beat with columns for the leads, and a time column or none."""
    ecg = default_model.simulate(EXAMPLE_PARAMETERS).ecg
    beat = np.pad(ecg.sel(lead=list(LEADS)).to_numpy(), ((0, 0), (350, 350)))  # mV, 1000 Hz
    beat += np.random.default_rng(0).normal(0.0, 0.005, beat.shape)

    def write(factor=1.0, time=None, step=1.0):
        signal = factor * beat
        columns = {} if time is None else {time: step * np.arange(signal.shape[1])}
        columns |= dict(zip(LEADS, signal, strict=True))
        path = tmp_path / "beat.csv"
        pd.DataFrame(columns).to_csv(path, index=False)
        return path

    return write


@pytest.mark.parametrize(
    ("factor", "time", "step", "options"),
    [
        (1e3, None, 1.0, {"--unit": "uV", "--sampling-rate": "1000", "--noise": "0.03"}),
        (1.0, "time", 1.0, {"--unit": "mV", "--sampling-rate": "1000", "--noise": "0.03"}),
        (1e-3, "time", 1e-3, {"--unit": "V", "--sampling-rate": "1000", "--noise": "0.03"}),
        (1e6, "time_s", 1e-3, {"--unit": "nV", "--noise": "0.03"}),
    ],
)
def test_guesses_that_work(run, table, tmp_path, factor, time, step, options):
    """Each thing that is missing is asked for in one line, until nothing is."""
    path, out = table(factor, time, step), tmp_path / "t.nc"
    given = {}
    while (ended := run("target", path, "--out", out, *chain(*given.items()))).status != 0:
        assert ended.status == 2
        assert ended.err.count("\n") == 1
        assert not out.exists()
        option, guess = re.search(r"(--\S+) (\S+) is a guess: ", ended.err).groups()
        assert option not in given
        given[option] = guess
    assert out.exists()
    assert given == options


class TestGuesses:
    def test_no_unit_where_none_is_likely(self):
        for span in (0.0, 1e-12, 1e12, np.nan):
            assert missing_unit("it", [np.array([0.0, span])]).guess is None

    @pytest.mark.parametrize(
        ("samples", "rate"), [(5000, 500), (10_000, 1000), (2500, 250), (700, 1000), (60_001, 500)]
    )
    def test_rates(self, samples, rate):
        error = missing_rate("it", samples)
        assert error.guess == rate
        assert f"{samples / rate:.3g} s" in str(error)

    @pytest.mark.parametrize("step", [0.0, -1.0, np.nan, np.inf])
    def test_no_rate_where_times_do_not_run(self, step):
        assert missing_time_unit("it", step).guess is None


def test_what_simulate_writes_is_read_back_of_a_paced_beat_too(default_model, tmp_path):
    """Whose first sample is small, and not zero."""
    pacing = fascicle.read_scenarios("rv-apical-pacing")["rv-apical-pacing"]
    ecg = default_model.simulate(EXAMPLE_PARAMETERS, pacing).ecg
    write_ecg(tmp_path / "ecg.csv", ecg)
    recording = fascicle.read_recording(tmp_path / "ecg.csv")
    assert recording.signal.shape[1] == ecg.sizes["time"] + 1000
    np.testing.assert_allclose(recording.signal[:, 500:-500], ecg.to_numpy(), atol=1e-6)
