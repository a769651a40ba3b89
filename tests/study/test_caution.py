from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.study.caution import NOT_CONVERGED, NOT_EXPLAINED, caution, caution_text
from fascicle.study.population import Posterior
from fascicle.study.predictive import Checks

EXPLAINED, APART = Checks(0.2, {"V1": 0.5}), Checks(0.6, {"V1": 0.5})


def study(*, converged, checks):
    posterior = Posterior(
        {"cv": np.ones(4)}, np.ones(4), {}, 0.1, np.zeros((4, 1)), np.zeros(2), np.ones(2),
        np.ones(2), {"cv": 0.1}, converged,
    )  # fmt: skip
    return SimpleNamespace(population=posterior, checks=checks)


@pytest.mark.parametrize(
    ("converged", "checks", "expected"),
    [
        (True, EXPLAINED, None),
        (True, APART, NOT_EXPLAINED),
        (False, EXPLAINED, NOT_CONVERGED),
        (False, APART, NOT_CONVERGED),  # the worse of the two
    ],
)
def test_of_a_posterior(converged, checks, expected):
    fitted = study(converged=converged, checks=checks)
    assert caution(fitted) is expected
    assert caution_text(fitted) == (expected and expected.text)


def test_a_population_of_the_paper_s_method_has_its_own_words():
    assert caution(SimpleNamespace(population=SimpleNamespace(), checks=None)) is None
