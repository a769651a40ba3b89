"""A likelihood and a growth rule of one's own: those of the documentation."""

from dataclasses import replace

import numpy as np
import pytest

import fascicle
from benchmarks.fits import demo_recording
from fascicle.core.errors import InputError
from fascicle.core.quantities import QUANTITIES
from fascicle.recording.target_files import write_target
from fascicle.study.methods import PosteriorFit
from tests.test_extending import example

pytestmark = pytest.mark.usefixtures("plain_tissue")


@pytest.fixture(scope="module")
def target():
    return fascicle.make_target(fascicle.read_recording(demo_recording()))


def test_the_example_of_the_documentation(target, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(PosteriorFit, "least_particles", 40)  # each takes a millisecond
    monkeypatch.setattr(PosteriorFit, "most_batches", 1)
    write_target(target, tmp_path / "target.nc")
    names = example("Likelihood")
    fitted = names["fitted"]
    (network,) = fitted.networks(chosen=[0])
    found = names["likelihood"].log_likelihood(network.beat.signals)
    assert found == pytest.approx(fitted.population.log_likelihoods[0, 0])
    assert -3 < fitted.checks.explained < 1
    assert np.all(fitted.gains == 1)


def test_what_is_no_likelihood_is_refused(target, tmp_path):
    with pytest.raises(InputError, match="likelihood is 5"):
        fascicle.fit("default", target, tmp_path / "s", likelihood=[5.0])


@pytest.mark.slow
def test_a_growth_rule_is_recorded_and_needed_again(target, tmp_path, monkeypatch):
    monkeypatch.setitem(QUANTITIES, "apical_attraction", None)  # as it was, afterwards
    del QUANTITIES["apical_attraction"]
    term = example("Growth rule")["term"]
    folder, rules = tmp_path / "study", fascicle.GrowthRules(term=term)
    more = {"prior_simulations": 100, "effective": 20}
    more["parameters"] = {"apical_attraction": "free", "conduction": "normal"}
    fitted = fascicle.fit("default", target, folder, rules=rules, **more)
    assert np.ptp(fitted.population.values["apical_attraction"]) > 0.05
    assert fitted.study.config.growth_term == "to_apex"
    for again in (
        lambda: fascicle.load_study(folder),
        lambda: fascicle.fit("default", target, folder, **more),
    ):
        with pytest.raises(InputError, match=r"'to_apex', not by 'repulsion'; .* the same rules="):
            again()
    opened = fascicle.load_study(folder, rules=rules)
    assert opened.simulator.model.rules == rules

    def to_apex(tip, nearest, metric, values):
        return 0.3, 0.0

    other = fascicle.GrowthRules(term=replace(term, function=to_apex))
    with pytest.raises(InputError, match="another forward model"):
        fascicle.load_study(folder, rules=other)
