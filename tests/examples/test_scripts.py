"""The examples that notebooks are made from run as they stand, and find what they say."""

import re
import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_simulate_and_pace():
    found = runpy.run_path(str(EXAMPLES / "simulate_and_pace.py"))
    qrs = {name: simulation.qrs_duration for name, simulation in found["simulated"].items()}
    assert qrs["left-bundle-branch-block"] > found["paced"].qrs_duration
    assert found["paced"].qrs_duration > qrs["left-bundle-branch-pacing"] + 10
    assert qrs["rv-apical-pacing"] > found["own"].qrs_duration + 20


@pytest.mark.slow
def test_learn_and_predict(capsys):
    found = runpy.run_path(str(EXAMPLES / "learn_and_predict.py"))
    verdict = found["study"].verdict
    assert "converged" in verdict.lower()
    explained = int(re.findall(r"(\d+)% of the QRS explained by the best 5%", verdict)[0])
    assert 60 <= explained < 90  # another person's heart
    assert found["page"].stat().st_size > 500_000
    assert "probability to be faster " in capsys.readouterr().out
    assert found["comparison"].probability() >= 0.7
    assert found["high"] > 10
