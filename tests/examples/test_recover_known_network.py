"""The example that looks for a known network, with a budget of seconds."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from fascicle.networks.target_comparison import evaluate

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "recover_known_network.py"


def at(fitted, point):
    return next(evaluate(fitted.simulator, fitted.recordings, [point]))


def test_fit_comes_closer_to_the_truth_than_the_first_networks(tmp_path):
    spec = importlib.util.spec_from_file_location("recover_known_network", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    fitted = example.recover(
        "default", example.TRUTH, tmp_path / "study", 0,
        prior_simulations=200, effective=20,
    )  # fmt: skip
    prior = fitted.simulator.prior
    plain = {"branch_length": 8.0, "branch_angle": 0.15, "repulsion": 0.1, "anterograde_delay": 0.0}
    rest = prior.averaged.space.to_unit(plain | example.TRUTH)  # the truth says its sources
    assert ((rest >= 0) & (rest <= 1)).all()
    parts = prior.learnt.to_unit(example.TRUTH), rest, [0.0]  # the first tissue
    at_truth = at(fitted, np.concatenate(parts)).loss
    assert at_truth < 0.02  # noise alone
    assert at_truth < fitted.population.best_loss < 0.3 * fitted.null_loss
