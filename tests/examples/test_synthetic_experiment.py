"""The paper's synthetic experiment, with a budget of seconds."""

import numpy as np
import pytest

from benchmarks.synthetic import INSIDE, PAPER, contraction, experiment
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.networks.target_comparison import evaluate


def at(fitted, point):
    return next(evaluate(fitted.simulator, fitted.recordings, [point]))


def test_contraction():
    everywhere = np.linspace(-75, 50, 1001)
    assert contraction(everywhere, -75, 50) == pytest.approx(0, abs=0.01)
    assert contraction(everywhere / 10, -75, 50) == pytest.approx(0.99, abs=0.001)


def test_five_values_of_the_paper_are_ends_of_their_ranges():
    angles = {"lv_fascicle_angle_2", "rv_fascicle_angle_1", "rv_fascicle_angle_2"}
    at_end = angles | {"root_time", "cv"}
    for truth, expected in ((PAPER, at_end), (INSIDE, set())):
        places = dict(zip(NETWORK_SPACE.names, NETWORK_SPACE.to_unit(truth), strict=True))
        assert {n for n, x in places.items() if min(x, 1 - x) < 1e-9} == expected
        assert all(0 <= x <= 1 for x in places.values())


@pytest.mark.slow
def test_experiment(crtdemo_model, tmp_path, capsys):
    fitted = experiment(
        crtdemo_model, "inside", 0, 40, tmp_path,
        initial=30, steps=3, samples=2, draws=50_000, rounds=2, tolerance=1.0,
    )  # fmt: skip
    printed = capsys.readouterr().out
    assert "2 networks, a population and not a posterior" in printed
    # a left bundle branch block: the tissue is there before the left tree
    left = int(printed.partition("fire from the tissue: ")[2].split()[0])
    assert left > 10
    at_truth = at(fitted, NETWORK_SPACE.to_unit(INSIDE)).loss
    assert at_truth < 0.01 < fitted.population.best_loss
    names = {path.name for path in (tmp_path / "inside-0").glob("*.png")}
    assert names == {"activation.png", "ecg.png", "pairs.png", "trees.png"}
