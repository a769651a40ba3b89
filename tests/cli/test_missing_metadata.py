"""What a table does not say is asked for at once, with guesses that work."""

from __future__ import annotations

import re
import shlex

import numpy as np
import pandas as pd
import pytest

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.recording.missing_metadata import (
    MissingMetadataError,
    collect_missing,
    missing_rate,
    missing_time_unit,
    missing_unit,
)


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
def test_one_question_whose_answer_works(run, table, tmp_path, factor, time, step, options):
    path, out = table(factor, time, step), tmp_path / "t.nc"
    ended = run("target", path, "--out", out)
    assert ended.status == 2
    assert ended.err.count("\n") == 1
    assert not out.exists()
    proposed = re.search(r"such as (.*?) if these guesses are right", ended.err)[1]
    words = shlex.split(proposed)
    assert dict(zip(words[::2], words[1::2], strict=True)) == options
    assert run("target", path, "--out", out, *words).status == 0
    assert out.exists()


def test_what_was_said_is_not_asked_for(run, table, tmp_path):
    said = run("target", table(1e3), "--out", tmp_path / "t.nc", "--unit", "uV").err
    assert "sampling rate, noise" in said
    assert "--unit" not in said


def test_one_thing_keeps_its_own_message(run, table, tmp_path):
    options = ("--unit", "uV", "--sampling-rate", "1000")
    said = run("target", table(1e3), "--out", tmp_path / "t.nc", *options).err
    assert "a single beat (class A) does not show how beats vary" in said
    assert "--noise 0.03 is a guess" in said


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

    def test_nothing_is_tried_without_a_guess(self):
        calls = []

        def make(unit):
            calls.append(unit)
            raise MissingMetadataError("it", "unit")

        with pytest.raises(MissingMetadataError, match=r"^it$"):
            collect_missing(make, "a", unit=None)
        assert calls == [None]

    def test_other_errors_wait(self):
        def make(unit, noise):
            if unit is None:
                raise MissingMetadataError("no unit", "unit", "mV", "why")
            raise InputError("something else")

        with pytest.raises(MissingMetadataError, match="no unit; --unit mV is a guess: why"):
            collect_missing(make, "a", unit=None, noise=None)
