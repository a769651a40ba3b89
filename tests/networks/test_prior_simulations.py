"""Prior simulations: what is stored, how it goes on, for whom it serves, and the emulator of it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import fascicle
from benchmarks.fits import demo_recording
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, ArrayCache
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.core.quantities import fascicles
from fascicle.emulation import heart_emulator
from fascicle.emulation.ecg_emulator import learn
from fascicle.emulation.heart_emulator import (
    emulator_of,
    made_emulator,
    refined_emulators,
    simulations_for,
)
from fascicle.emulation.likelihood import EmulatedLikelihood
from fascicle.emulation.state_classifier import simulate_prior
from fascicle.forward.beat import Beat
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.loss import placed
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import write_heart
from fascicle.networks import prior_simulations as tested
from fascicle.networks.prior import Prior
from fascicle.networks.prior_simulations import BEFORE, Examples, PriorSimulations, random_bodies
from fascicle.networks.simulator import PointSimulator
from fascicle.pools.pool import Threads

PART, COUNT = 20, 35


class Counting(Threads):
    """Counts what is simulated, and is interrupted after some."""

    def __init__(self, most=10**6):
        super().__init__(2)
        self.sent, self.most = 0, most

    def map(self, function, items, *shared):
        for result in super().map(function, items, *shared):
            self.sent += 1
            if self.sent > self.most:
                raise KeyboardInterrupt
            yield result


@pytest.fixture(scope="module", autouse=True)
def small():
    """Two parts of few networks, in three tissues and two bodies."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PriorSimulations, "part_size", PART)
        patch.setattr(PriorSimulations, "torsos", 2)
        patch.setattr(PriorSimulations, "seed", 1)  # torsos not at the far end of their prior
        patch.setattr(tested, "random_bodies", random_bodies)
        patch.setattr(heart_emulator, "learn", partial(learn, epochs=1, fewest=10))
        patch.setattr("fascicle.networks.prior.TISSUES", ({}, {"anisotropy_ratio": 2.0}))
        yield


def study(heart, wanted=None):
    """Prior of a study of it."""
    return Prior.of("posterior", wanted or {}, heart)


def with_prior(simulations, **changes):
    return replace(simulations, prior=replace(simulations.prior, **changes))


def prior_in(folder, model, wanted=None):
    return PriorSimulations(model, study(model.heart, wanted), ArrayCache(folder, "prior"))


def parts(prior):
    numbers = range(-(-COUNT // PART))
    return [prior.cache.read(f"{prior.content} {number}") for number in numbers]


@pytest.fixture(scope="module")
def model(default_heart):
    """The packaged heart in an unbounded conductor, where bodies take no time."""
    return ForwardModel(replace(default_heart, lead_fields=None, torso=None, folder=None))


@pytest.fixture(scope="module")
def prior(model, tmp_path_factory):
    found = prior_in(tmp_path_factory.mktemp("prior"), model)
    found.simulate(COUNT, Counting())
    return found


def test_examples_are_simulations_of_their_points(prior, model):
    examples = prior.examples(COUNT)
    parameters = [each for number in range(2) for each in prior.parameters(number)]
    assert len(parameters) == len(examples.points) == len(examples.feasible) == 2 * PART
    assert_array_equal(examples.kept, examples.feasible)  # the prior is not that of mapped hearts
    numbers = np.cumsum(examples.feasible) - 1
    for k in (0, 9, 25, 39):
        found = model.simulate(parameters[k])
        assert isinstance(found, Beat) == examples.feasible[k]
        if examples.feasible[k]:
            begin, length = found.first_activation - BEFORE, examples.ecgs.shape[2]
            own = placed(found.leads[list(INDEPENDENT_ROWS)], begin, length)
            assert examples.ecgs[numbers[k]] == pytest.approx(own, abs=1e-4)
    first = np.abs(examples.ecgs).max(axis=(0, 1)) > 1e-3
    assert BEFORE - 10 < np.flatnonzero(first)[0] <= BEFORE + 2
    assert prior.prior.from_unit(examples.points[0]) == parameters[0]
    # held out ones are in other torsos than the plain one, too, with the same activation
    plain = examples.ecgs[examples.held_out[examples.feasible]]
    assert 0 < len(plain) == len(examples.in_torsos)
    assert examples.held_out.sum() == 2 * PART / tested.HELD_OUT
    for one, other in zip(plain, examples.in_torsos, strict=True):
        apart = ((one - other) ** 2).sum() / (one**2).sum()
        assert 1e-3 < apart < 3
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.3


def test_parameters_are_those_asked_for(model, tmp_path):
    """As many fascicles; and one tissue in a part."""
    for count in (1, 2, 3):
        prior = prior_in(tmp_path, model, {"lv_fascicles": count})
        assert {fascicles("lv", each) for each in prior.parameters(0)} == {count}
        assert {fascicles("rv", each) for each in prior.parameters(1)} == {2}
    prior = prior_in(tmp_path, model, {"endocardial_speed": "free"})
    speeds = [{each["endocardial_speed"] for each in prior.parameters(n)} for n in range(3)]
    assert [len(each) for each in speeds] == [1, 1, 1]
    assert len(set.union(*speeds)) == 3
    assert len({each["fibre_speed"] for each in prior.parameters(0)}) == PART


def test_interrupted_it_goes_on_to_the_same_bits(prior, model, tmp_path):
    again, pool = prior_in(tmp_path, model), Counting(PART + 10)
    with pytest.raises(KeyboardInterrupt):
        again.simulate(COUNT, pool)
    assert [each is None for each in parts(again)] == [False, True]
    assert len(list(tmp_path.iterdir())) == 1
    pool = Counting()
    again.simulate(COUNT, pool)
    again.simulate(PART, pool)
    assert pool.sent == PART
    for one, other in zip(parts(again), parts(prior), strict=True):
        for name, values in other.items():
            assert_array_equal(one[name], values)


def test_a_damaged_part_is_named_and_made_again(prior, model):
    file, pool = prior._file(0), Counting()
    whole = file.read_bytes()
    file.write_bytes(whole[:1000])
    with pytest.raises(InputError, match=rf"^{file}: damaged; delete it, and .* again$"):
        prior.examples(COUNT)
    file.unlink()
    prior.simulate(COUNT, pool)
    assert pool.sent == PART
    assert file.read_bytes() == whole


@pytest.mark.parametrize(
    ("wanted", "served"),
    [
        ({}, True),
        ({"cv": {"lower": 2.5, "upper": 3.5}}, True),
        ({"cv": {"lower": 1.4, "upper": 3.5}}, False),
        ({"cv": 2.5, "branch_length": 7.0}, True),
        ({"cv": 5.0}, False),
        ({"branch_length": {"lower": 7.0, "upper": 9.0}}, True),  # learnt, not averaged over
        ({"gain": "free"}, True),
        ({"anisotropy_ratio": 2.0}, False),
        ({"his_time": 40.0}, False),
        ({"lv_fascicles": 1}, False),
        ({"lv_fascicles": 2}, False),
        ({"lv_fascicles": 3}, True),
        ({"fibre_speed": 0.6}, True),
        ({"fibre_speed": 0.9}, False),
        ({"alpha": "free"}, False),
        ({"root_time": 10.0}, False),
        ({"interventricular_delay": 10.0}, True),
        ({"axial_source": 0.4}, True),
        ({"axial_source": 0.6}, False),
        ({"rv_source": 0.5}, True),
        ({"rv_source": "free"}, False),  # beyond two SD of what is averaged over
    ],
)
def test_whom_it_serves(prior, model, wanted, served):
    asked = study(model.heart, wanted)
    assert prior.prior.covers(asked) == served
    mapped, asked_mapped = (replace(p, mapped=True) for p in (prior.prior, asked))
    assert not prior.prior.covers(asked_mapped)  # of networks that are activated otherwise
    assert mapped.covers(asked_mapped) == served
    assert not mapped.covers(asked)


def test_another_prior_has_other_simulations(prior, model, tmp_path):
    assert len({prior_in(tmp_path, model, wanted).content
                for wanted in ({}, {"cv": 5.0}, {"gain": "free"})}) == 3  # fmt: skip
    known = replace(model.heart, values={"alpha": 0.07})
    assert not prior.prior.covers(study(known))
    assert with_prior(prior, mapped=True).content != prior.content


def test_examples_of_the_prior_leave_out_what_does_not_belong_to_it():
    """Ten networks that are feasible but for the second, of which half are kept; two held out."""
    feasible, kept = np.ones(20, bool), np.arange(20) % 4 != 2
    feasible[1] = kept[1] = False
    kept[9] = False  # held out, as the last is
    numbers = np.arange(20.0)
    ecgs = np.broadcast_to(numbers[feasible, None, None], (19, 8, 5)).astype(np.float32)
    in_bodies = -np.broadcast_to(numbers[[9, 19], None, None], (2, 8, 5)).astype(np.float32)
    examples = Examples(numbers[:, None], feasible, kept, ecgs, in_bodies, np.array([4, 7]))
    found = examples.of_the_prior
    assert_array_equal(found.points, examples.points)
    assert_array_equal(found.feasible, kept)
    assert_array_equal(found.ecgs[:, 0, 0], numbers[kept])
    assert_array_equal(found.in_torsos[:, 0, 0], [-19])
    assert_array_equal(found.torsos, [7])
    assert_array_equal(found.held_out, examples.held_out)
    assert_array_equal(found.of_the_prior.ecgs, found.ecgs)


def test_networks_that_mapped_hearts_are_not_activated_like_are_marked(model, tmp_path):
    """All are kept with their ECGs; of the prior are the mapped ones, and few of the others."""
    surfaces, leads = model.surfaces, np.ones((12, 50))
    mapped = np.full(len(model.heart.vertices), 60.0)
    for name, time in (
        ("lv_septum", 0.0), ("lv_free_wall", 4.0), ("rv_septum", 8.0), ("rv_free_wall", 15.0),
        ("rv_breakthrough", 20.0),
    ):  # fmt: skip
        mapped[surfaces.parts[name]] = time
    mapped[surfaces.parts["lv_breakthrough"]] = 80.0
    assert surfaces.sequence(mapped).is_mapped
    activations = [mapped, mapped[::-1].copy(), None]

    class Pool:
        def map(self, function, items, *shared):
            for k, _ in enumerate(items):
                times = activations[k % 3]
                yield None if times is None else Beat(leads, 0.0, (), Activation(times))

    prior = with_prior(prior_in(tmp_path, model), mapped=True)
    prior.simulate(COUNT, Pool())
    examples = prior.examples(COUNT)
    which = np.tile(np.arange(PART) % 3, 2)
    assert_array_equal(examples.feasible, which < 2)
    unlike = Beat(leads, 0.0, (), Activation(activations[1]))
    assert not surfaces.sequence(unlike.activation).is_mapped
    expected = [
        k == 0 or (k == 1 and prior.prior.keeps(point, surfaces, unlike))
        for k, point in zip(which, examples.points, strict=True)
    ]
    assert_array_equal(examples.kept, expected)
    assert len(examples.ecgs) == (which < 2).sum()
    assert len(examples.of_the_prior.ecgs) == examples.kept.sum() < len(examples.ecgs)


def emulator_for(model, folder, pool, wanted=None):
    simulations = simulations_for(model, study(model.heart, wanted), folder)
    return emulator_of(simulations, COUNT, pool)


def test_an_emulator_serves_all_studies_that_it_covers(prior, model, tmp_path):
    """It is made once, and what is read is what was made."""
    (tmp_path / DISPOSABLE).mkdir()
    for file in prior.cache.folder.iterdir():
        (tmp_path / DISPOSABLE / file.name).write_bytes(file.read_bytes())
    pool = Counting()
    first = emulator_for(model, tmp_path, pool)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(heart_emulator, "learn", None)
        again = emulator_for(model, tmp_path, pool, {"cv": 2.5})
    assert pool.sent == 0
    for name, values in first.arrays().items():
        assert_array_equal(again.arrays()[name], values)
    assert first.report["networks"] == 2 * PART
    with pytest.raises(KeyboardInterrupt):
        emulator_for(model, tmp_path, Counting(0), {"cv": 5.0})


@pytest.mark.parametrize("fixed", [{}, {"anterograde_delay": 1.0}])
def test_only_hearts_without_fixed_delays_are_the_same_on_any_clock(
    prior, model, monkeypatch, fixed
):
    asked = {}

    def learn(*given, **options):
        asked.update(options)
        raise KeyboardInterrupt

    monkeypatch.setattr(heart_emulator, "learn", learn)
    monkeypatch.setattr(PriorSimulations, "examples", lambda self, count: None)
    monkeypatch.setattr(PriorSimulations, "simulate_enough", lambda self, *given: 1)
    with pytest.raises(KeyboardInterrupt):
        heart_emulator.made_emulator(with_prior(prior, fixed=fixed), 1, Threads(1))
    assert asked["time_scaling"] == (not fixed)


@pytest.mark.slow
def test_a_heart_in_a_folder_that_cannot_be_written_to(model, tmp_path, monkeypatch):
    """Simulations are kept with the study's own copy of the heart."""
    folder, out = tmp_path / "heart", tmp_path / "study"
    write_heart(model.heart, folder)
    writable = heart_emulator.os.access
    monkeypatch.setattr("os.access", lambda path, how: folder != path and writable(path, how))
    with pytest.raises(InputError, match="heart: cannot be written to; copy the heart"):
        simulate_prior(folder, COUNT)
    target = fascicle.make_target(fascicle.read_recording(demo_recording()))
    monkeypatch.setattr("fascicle.study.methods.PosteriorFit.most_batches", 1)
    given = {"prior_simulations": 100, "effective": 20, "parameters": {"conduction": "normal"}}
    fitted = fascicle.fit(folder, target, out, **given)
    kept = {file.name.partition("-")[0] for file in (out / "heart" / DISPOSABLE).iterdir()}
    assert {"prior", "emulator"} <= kept
    assert not [*folder.rglob("prior-*")]
    found = fitted.recordings[0].align(fitted.best_network.beat.leads).loss
    assert found == pytest.approx(fitted.population.best_loss)


def test_an_emulator_is_refined_with_draws_of_the_posterior(prior, model, tmp_path):
    """Of the study's own draws, which are kept with it, and again where the posterior has moved.

    Not where each has a tissue of its own.
    """
    refine = partial(refined_emulators, share=PART / COUNT, particles=60)
    emulator, pool = made_emulator(prior, COUNT, Threads(1)), Counting()
    simulator = PointSimulator(model, prior.prior, pool)
    delay, seen = prior.prior.names.index("interventricular_delay"), []

    class Emulated(EmulatedLikelihood):
        first = 0.5  # where the posterior lies by the emulator of the prior

        def __call__(self, points):
            middle = self.first if self.emulator is emulator else 0.5
            return -0.5 * ((points[:, delay] - middle) / 0.02) ** 2

        def inputs(self, points):
            seen.append(points)
            return super().inputs(points)

    def given(simulator=simulator, count=2, made=Emulated):
        def by(emulators):
            return [made(simulator, each, None) for each in emulators]

        return [emulator] * count, by, [None] * count, COUNT, tmp_path

    first, again = refine(*given(), np.random.default_rng(0))
    assert first is again
    assert pool.sent == PART
    drawn, usual = seen
    assert drawn[:, delay].std() < 0.04 < usual[:, delay].std()
    assert first.expected_error != emulator.expected_error
    assert len([*(tmp_path / DISPOSABLE).glob("posterior-*.npz")]) == 1
    found = refine(*given(), np.random.default_rng(0))[0]
    assert pool.sent == PART  # found
    assert_array_equal(found.residual_factor, first.residual_factor)
    free = given(PointSimulator(model, study(model.heart, {"anisotropy_ratio": "free"}), pool), 1)
    assert refine(*free, None) == [emulator]

    class Moving(Emulated):
        first = 0.3

    seen.clear()
    refine(*given(made=Moving), np.random.default_rng(0))
    assert pool.sent == 3 * PART  # the posterior moves once, and then stays
    drawn, again = seen[::2]
    assert drawn[:, delay].mean() == pytest.approx(0.3, abs=0.01)
    assert again[:, delay].mean() == pytest.approx(0.5, abs=0.01)
