"""A likelihood of one's own: the example of the documentation is run as it stands."""

from pathlib import Path

import numpy as np
import pytest

import fascicle
from fascicle.cli.demo import demo_recording
from fascicle.core.errors import InputError
from fascicle.forward.simulation import Signals
from fascicle.recording.target_files import write_target

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"


@pytest.fixture(scope="module")
def target():
    return fascicle.make_target(fascicle.read_recording(demo_recording()))


def test_the_example_of_the_documentation(target, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_target(target, tmp_path / "target.nc")
    code = PAGE.read_text().split("## Likelihood")[1].split("```python")[1].split("```")[0]
    assert code.count("\n") < 40
    names = {}
    exec(compile(code, str(PAGE), "exec"), names)
    fitted = names["fitted"]
    (network,) = fitted.networks(chosen=[0])
    found = names["likelihood"].log_likelihood(Signals.of(network.simulation))
    assert found == pytest.approx(fitted.population.log_likelihoods[0, 0])
    assert 0 < fitted.checks.share < 2
    assert np.all(fitted.gains == 1)


def test_what_is_no_likelihood_is_refused(target, tmp_path):
    with pytest.raises(InputError, match="likelihood is 5"):
        fascicle.fit("default", target, tmp_path / "s", likelihood=[5.0])
