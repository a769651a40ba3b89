"""Prior simulations: what is stored, how it goes on, and what it is refused for."""

import shutil

import numpy as np
import pytest

import fascicle
from fascicle.cli.demo import demo_recording
from fascicle.core.errors import InputError
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import write_heart
from fascicle.inference.evaluation import Evaluation
from fascicle.study import prior_simulations as tested
from fascicle.study.fit import load_study
from fascicle.study.prior_simulations import PriorSimulations, prior_points, simulate_prior
from fascicle.study.simulator import PointSimulator
from fascicle.study.space import study_space
from fascicle.study.target_comparison import TargetComparison, evaluate
from tests.study.test_pool import Counting


@pytest.fixture(scope="module")
def heart(tmp_path_factory):
    """A heart of its own, whose prior has two parts of six networks."""
    folder = tmp_path_factory.mktemp("heart") / "heart"
    write_heart(fascicle.load_heart("default"), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tested, "PART", 6)
        simulate_prior(folder, 7, workers=2)
        yield fascicle.load_heart(folder)


@pytest.fixture(scope="module")
def target():
    return fascicle.make_target(fascicle.read_recording(demo_recording()))


def no_prior(folder, names):
    return [name for name in names if name.startswith("prior-")]


def stored_of(heart):
    return PriorSimulations.of(heart, *study_space("posterior", {}, heart))


def same(first: Evaluation, second: Evaluation) -> bool:
    if not first.feasible:
        return first.reason == second.reason
    return second.loss == pytest.approx(first.loss, rel=1e-6) and second.beat_errors == (
        pytest.approx(first.beat_errors, rel=1e-5)
    )


def test_evaluations_are_those_of_simulations(heart, target):
    space, fixed = study_space("posterior", {}, heart)
    model = ForwardModel(heart)
    recordings = [TargetComparison(target)]
    plain = PointSimulator(model, space, fixed)
    stored = PointSimulator(model, space, fixed, prior=stored_of(heart))
    points = list(prior_points(len(space), 12))
    expected = list(evaluate(plain, recordings, points))
    model.simulate = None  # nothing is simulated again
    again = evaluate(stored, recordings, points)
    assert all(same(one, other) for one, other in zip(expected, again, strict=True))
    assert sum(e.feasible for e in expected) > 6


def test_it_goes_on_and_grows(heart):
    stored = stored_of(heart)
    assert len(stored) == 12
    first = stored.file(0).stat().st_mtime_ns
    stored.file(1).unlink()
    simulate_prior(heart, 13, workers=2)
    assert len(stored_of(heart)) == 18
    assert stored.file(0).stat().st_mtime_ns == first


def test_elsewhere_it_is_the_same(heart, tmp_path):
    write_heart(heart, tmp_path / "heart")
    pool = Counting()
    simulate_prior(tmp_path / "heart", 7, pool=pool)
    assert pool.sent == 12
    here, there = (stored_of(each) for each in (heart, fascicle.load_heart(tmp_path / "heart")))
    for number in range(2):
        one, other = (each.cache.read(f"{each.content} {number}") for each in (here, there))
        assert set(one) == set(other)
        for name, values in one.items():
            np.testing.assert_array_equal(other[name], values)


def test_what_is_not_there(heart):
    """Another prior, and a point."""
    space, fixed = study_space("posterior", {"cv": 2.5}, heart)
    assert len(PriorSimulations.of(heart, space, fixed)) == 0
    assert stored_of(heart).get(np.full(13, 0.5)) is None


def test_a_damaged_part_is_named(heart):
    stored = stored_of(heart)
    whole = stored.file(0).read_bytes()
    stored.file(0).write_bytes(whole[:1000])
    with pytest.raises(InputError, match=r"\.npz: damaged; delete it"):
        stored.get(np.full(13, 0.5))
    stored.file(0).write_bytes(whole)


def test_another_forward_model_is_refused(heart):
    space, fixed = study_space("posterior", {}, heart)
    stored = stored_of(heart)
    stored.check(ForwardModel(heart), space, fixed)
    with pytest.raises(InputError, match="of another forward model; delete it"):
        stored.check(ForwardModel(heart), space, {"gain": 1.2})


def test_numbers_that_make_no_sense(heart):
    with pytest.raises(InputError, match="networks is 0"):
        simulate_prior(heart, 0)


@pytest.mark.slow
def test_a_fit_finds_the_same_with_and_without(heart, target, tmp_path):
    sizes = {"prior_simulations": 100, "evaluations": 200, "effective": 20, "workers": 2}
    bare = shutil.copytree(heart.folder, tmp_path / "heart", ignore=no_prior)
    without = fascicle.fit(bare, target, tmp_path / "without", **sizes)
    simulate_prior(heart, 100, workers=2)
    found = fascicle.fit(heart, target, tmp_path / "with", **sizes)
    assert found.population.losses == pytest.approx(without.population.losses, rel=1e-4)
    assert load_study(tmp_path / "with").population.converged == found.population.converged
