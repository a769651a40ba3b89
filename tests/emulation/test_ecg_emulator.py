"""The emulator of a heart's ECG: what it learns, and the likelihood on it against plain sums."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.fft import dct, idct

from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS, limb_leads_from
from fascicle.core.parameters import EXAMPLE_PARAMETERS, HUMAN_SPACE, ParameterSpace, free
from fascicle.emulation import ecg_emulator as tested
from fascicle.emulation.ecg_emulator import (
    EcgEmulator,
    _scaled_in_time,
    learn,
    refined,
    tissue_inputs,
)
from fascicle.emulation.heart_emulator import emulator_of, simulations_for, usual_prior
from fascicle.emulation.likelihood import EmulatedLikelihood, beat_noise, checked, likelihood_of
from fascicle.emulation.predictive import Checks
from fascicle.forward.beat import Beat, Signals
from fascicle.forward.loss import placed
from fascicle.heart.conduction import Conduction
from fascicle.networks.prior import AveragedOver, Prior
from fascicle.networks.prior_simulations import BEFORE, HELD_OUT, Examples, PriorSimulations
from fascicle.networks.settings import FitSettings
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network
from fascicle.pools.pool import Threads
from fascicle.recording.target import Target, smooth_noise

SPACE = ParameterSpace(tuple(free(name) for name in ("root_time", "cv", "alpha", "gain")))
AVERAGED = AveragedOver(
    ParameterSpace((free("anterograde_delay", lower=0.0, upper=3.0),)),
    ({}, {"anisotropy_ratio": 2.0}),
)
LENGTH, COUNT = 160, 800
PRIOR = Prior(SPACE, averaged=AVERAGED)
SIMULATOR = SimpleNamespace(prior=PRIOR, model=SimpleNamespace(conduction=Conduction()))


def ecgs_of(points):
    """ECGs (n, 8, length) of a law that is the same on any clock; the tissue matters, too."""
    values = SPACE.columns(points[:, : len(SPACE)])
    delay = AVERAGED.space.columns(points[:, 4:5])["anterograde_delay"]
    slower = np.where(AVERAGED.tissue(points[:, 4:]) == 1, 1.3, 1.0)
    middle = 3 * slower / values["alpha"] + delay
    width = 0.4 * middle + 60 / values["cv"]
    lead = np.arange(1, 9)[:, None]
    t = np.arange(LENGTH) - BEFORE
    place = (t - middle[:, None, None]) / (0.3 * width[:, None, None])
    late = 1 + 0.3 * np.tanh(values["root_time"] / width)[:, None, None] * np.sin(lead)
    return (np.cos(lead) * late * place * np.exp(-0.5 * place**2)).astype(np.float32)


def network_fits(points):
    return points[:, 1] > 0.2


def of_the_prior(points):
    """Of those that fit, those with early right ventricles do not belong to the prior."""
    return network_fits(points) & (points[:, 0] > 0.15)


@pytest.fixture(scope="module")
def examples():
    rng = np.random.default_rng(0)
    points = rng.random((COUNT, 6))
    return examples_at(points, ecgs_of(points[network_fits(points)]), rng)


def examples_at(points, ecgs, rng):
    feasible = network_fits(points)
    ecgs += 0.05 * smooth_noise(rng, ecgs.shape, 1.0).astype(np.float32)  # what is left to chance
    held_out = (np.arange(len(points)) % HELD_OUT == HELD_OUT - 1)[feasible]
    count = PriorSimulations.torsos
    bodies = rng.integers(count, size=held_out.sum())
    # a body adds half of a lead to the next one, and noise that no sum of leads explains
    plain, drawn = ecgs[held_out], rng.standard_normal(count)[bodies][:, None, None]
    in_bodies = plain + 0.5 * drawn * np.roll(plain, 1, axis=1)
    in_bodies += 0.1 * smooth_noise(rng, plain.shape, 1.0).astype(np.float32)
    kept = of_the_prior(points)
    return Examples(points, feasible, kept, ecgs, in_bodies.astype(np.float32), bodies)


@pytest.fixture(scope="module")
def emulator(examples):
    found = learn(examples, PRIOR, 2.5, np.random.default_rng(0))
    return EcgEmulator.from_arrays(found.arrays()), found


def slow(ecgs):
    """Without what is faster than an emulator knows."""
    count = round(2 * tested.HIGHEST * LENGTH)
    return idct(dct(ecgs, axis=2)[:, :, :count], axis=2, n=LENGTH)


def emulated_ecgs(emulator, points):
    values = SPACE.columns(points[:, :4]) | AVERAGED.space.columns(points[:, 4:5])
    tissues = np.array([[np.log(2.5), 0.0], [np.log(2.0), 0.0]])
    inputs = emulator.inputs(values, tissues[AVERAGED.tissue(points[:, 4:])])
    leads = emulator.mean_leads + np.tensordot(emulator.scores(inputs), emulator.series, 1)
    return leads, emulator.log_validity(inputs)


def test_it_learns_and_says_how_well(examples, emulator):
    """What held-out networks have beside it, in random bodies, is what it says of itself.

    Of networks of the prior alone.
    """
    (emulator, _), examples = emulator, examples.of_the_prior
    points = examples.points[examples.held_out & examples.feasible]
    leads, _ = emulated_ecgs(emulator, points)
    assert "gain" not in emulator.names
    own = leads[:, list(INDEPENDENT_ROWS)]
    true = ecgs_of(points)
    assert ((own - true) ** 2).sum() < 0.1 * (true**2).sum()  # of the law, without what is chance
    given, size = slow(examples.ecgs[examples.held_out[examples.feasible]]), emulator.report
    spread = ((given - given.mean(axis=0)) ** 2).sum()
    assert size["r_squared"] == pytest.approx(1 - ((given - own) ** 2).sum() / spread, abs=0.01)
    error = np.sqrt(((given - own) ** 2).sum() / (given**2).sum())
    assert size["error"] == pytest.approx(error, abs=0.02)
    # of what bodies add, sums of the leads are known; what is left is what components hold of it
    rest, unknown = slow(examples.in_torsos) - own, size["error_in_bodies"] ** 2
    assert (rest**2).sum() / (given**2).sum() > 1.3 * unknown
    left = emulator.residual_leads[:, list(INDEPENDENT_ROWS)]
    assert 0.6 * unknown < (left**2).sum() < 1.2 * unknown
    assert (
        0.1 < (emulator.torso_residual_factor**2).sum() / (emulator.residual_factor**2).sum() < 0.9
    )
    added = emulator.torso_modes_of_all_leads[0] @ leads[0]
    assert_allclose(added[2:6], limb_leads_from(INDEPENDENT_LEADS)[2:, :2] @ added[:2], atol=1e-9)
    into = emulator.torso_modes[0] / np.abs(emulator.torso_modes[0]).max()
    assert np.abs(np.diag(np.roll(into, -1, axis=0))).mean() > 2 * np.abs(into).mean()
    limb = limb_leads_from(INDEPENDENT_LEADS)
    assert_allclose(leads[:, :6], np.einsum("al,nlt->nat", limb[:, :2], leads[:, :2]), atol=1e-9)


def test_trained_on_where_a_posterior_lies(emulator):
    """There it learns what it did not know, and how much it still does not; elsewhere it stays."""
    emulator, rng = emulator[0], np.random.default_rng(5)

    def of(points):
        values = SPACE.columns(points[:, :4]) | AVERAGED.space.columns(points[:, 4:5])
        return emulator.inputs(
            values, np.log([[2.5, 1.0], [2.0, 1.0]])[AVERAGED.tissue(points[:, 4:])]
        )

    near, usual = 0.3 + 0.2 * rng.random((400, 6)), rng.random((400, 6))
    near[:, 1] += 0.3
    changed = 1.3 * ecgs_of(near)  # as no network of the prior was
    noise = 0.05 * smooth_noise(rng, changed.shape, 1.0).astype(np.float32)
    train, unseen = slice(0, 300), slice(300, None)
    found = refined(emulator, of(near[train]), (changed + noise)[train], of(usual), rng, 200)
    off = {}
    for name, each in (("before", emulator), ("after", found)):
        own = emulated_ecgs(each, near[unseen])[0][:, list(INDEPENDENT_ROWS)]
        off[name] = np.sqrt(((own - changed[unseen]) ** 2).sum() / (changed[unseen] ** 2).sum())
    assert off["after"] < 0.5 * off["before"]
    noisy, clean = slow(changed + noise), slow(changed)
    error = np.sqrt(((noisy - clean) ** 2).sum() / (noisy**2).sum())
    assert found.expected_error == pytest.approx(np.hypot(error, off["after"]), rel=0.25)
    left = (found.residual_factor**2).sum() - (found.torso_residual_factor**2).sum()
    assert 0.6 < left / found.expected_error**2 < 1.1  # what components hold of it
    far = rng.random((200, 6))
    one, other = (emulated_ecgs(each, far)[0] for each in (emulator, found))
    assert np.sqrt(((one - other) ** 2).sum() / (one**2).sum()) < 0.5 * off["before"]


def test_where_there_are_networks(emulator):
    points = np.random.default_rng(3).random((400, 6))
    _, logs = emulated_ecgs(emulator[0], points)
    clear = (np.abs(points[:, 1] - 0.2) > 0.05) & (np.abs(points[:, 0] - 0.15) > 0.05)
    assert ((logs > np.log(0.5)) == of_the_prior(points))[clear].mean() > 0.97
    assert (of_the_prior(points) != network_fits(points))[clear].mean() > 0.05
    assert (logs <= 0).all()


def test_what_is_stored_is_what_was_learnt(emulator, examples):
    """And the same seed gives the same bits."""
    stored, found = emulator
    one, other = (emulated_ecgs(each, examples.points[:50])[0] for each in emulator)
    assert np.abs(one - other).max() < 0.02 * np.abs(other).max()  # weights of half precision
    assert stored.report == found.report
    again = learn(examples, PRIOR, 2.5, np.random.default_rng(0))
    for one, other in ((stored, EcgEmulator.from_arrays(stored.arrays())), (found, again)):
        for name, array in one.arrays().items():
            assert_array_equal(other.arrays()[name], array)


def test_it_learns_from_few_networks_after_hearts_of_an_atlas(emulator):
    """The heart to learn has higher R waves and a Q wave, and the tissue of the atlas's first."""
    atlas = replace(emulator[0], hearts=np.array([[np.log(2.5), 0.0], [np.log(1.2), 5.0]]))
    rng, q_wave = np.random.default_rng(5), np.zeros((8, LENGTH), np.float32)
    points = rng.random((400, 6)) * [1, 1, 1, 1, 1, 0.5]
    q_wave[3, BEFORE : BEFORE + 8] = -0.3
    few = examples_at(points[:150], 1.3 * ecgs_of(points[:150][network_fits(points[:150])]), rng)
    few = replace(few, ecgs=few.ecgs + q_wave)
    prior, errors = replace(PRIOR, averaged=replace(AVERAGED, tissues=({},))), []
    unseen = points[150:][network_fits(points[150:])]
    true = slow(1.3 * ecgs_of(unseen) + q_wave)
    for begin in (atlas, None):
        found = learn(few, prior, 2.5, np.random.default_rng(0), atlas=begin)
        values = SPACE.columns(unseen[:, :4]) | AVERAGED.space.columns(unseen[:, 4:5])
        scores = found.scores(found.inputs(values, np.empty((len(unseen), 0))))
        leads = idct(found.cosines(scores), axis=2, n=LENGTH, norm="ortho")
        errors.append(((leads - true) ** 2).sum() / (true**2).sum())
    assert errors[0] < min(0.1, 0.7 * errors[1])
    more = replace(few, ecgs=np.pad(few.ecgs, ((0, 0), (0, 1), (0, 0))))
    tissues, values = np.empty((150, 0)), tested.emulated_quantities(prior, few.points)
    assert tested.most_similar(atlas, more, values, tissues) is None  # an additional lead
    assert tested.most_similar(atlas, few, {**values, "v1_up": values["cv"]}, tissues) is None
    similar = tested.most_similar(atlas, few, values, tissues)
    assert_allclose(similar.centre, atlas.centre[: len(values)])
    # without a quantity that is fixed; more samples of no ECG, and components that add nothing
    fewer = atlas.of_heart(0, ("cv", "alpha"), 0)
    assert fewer.names == tuple(n for n in atlas.names if n in ("cv", "alpha"))
    longer = similar.lasting(LENGTH + 40)
    before, after = slice(LENGTH - 10), slice(LENGTH + 10, None)
    assert_allclose(longer.mean_leads[:, before], similar.mean_leads[:, before], atol=0.01)
    assert np.abs(longer.mean_leads[:, after]).max() < 0.01
    wider = similar.with_components_of(few.ecgs[..., : similar.mean.shape[1]])
    assert len(wider.components) == len(similar.components) + 30
    flat = wider.components.reshape(len(wider.components), -1)
    assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-6)
    inputs = similar.inputs(values, tissues)
    assert_allclose(wider.cosines(wider.scores(inputs)), similar.cosines(similar.scores(inputs)))


def test_too_few_networks_are_refused(examples):
    few = examples.feasible & (np.arange(COUNT) < 40)
    given = replace(examples, feasible=few, kept=few, ecgs=examples.ecgs[: few.sum()])
    with pytest.raises(InputError, match=f"^only {few.sum()} of {COUNT} networks of the prior fit"):
        learn(given, PRIOR, 2.5, np.random.default_rng(0))
    points = examples.points.copy()
    points[:, 2] = 0.5
    given = replace(examples, points=points)
    with pytest.raises(InputError, match=r"^'alpha' is learnt, and has one value in every 500"):
        learn(given, PRIOR, 2.5, np.random.default_rng(0))


def with_fast_noise(simulation):
    """Leads with as much again at 250 Hz, which no emulator says."""
    t = np.arange(simulation.leads.shape[1])
    fast = np.sin(np.pi * t / 2) * np.hanning(len(t)) * np.ptp(simulation.leads)
    return replace(simulation, leads=simulation.leads + fast)


def test_the_packaged_heart_has_one(default_model, tmp_path):
    """Of its present priors, so that its fits simulate nothing beforehand."""
    prior = usual_prior(default_model.heart, CONDUCTION_STATES["normal"])
    assert prior.mapped
    simulator = PointSimulator(default_model, prior)
    simulations = simulations_for(default_model, prior, tmp_path)
    found = emulator_of(simulations, FitSettings().prior_simulations, Threads(1))
    assert not [*tmp_path.iterdir()]
    assert found.report["r_squared"] > 0.8
    networks, agreed = [], []
    for number, point in enumerate(prior.sample(np.random.default_rng(1), 60)):
        point[-1] = 0.3 * (number > 40)  # the plain tissue, and the second one
        values = prior.from_unit(point)
        simulated = default_model.simulate(values)
        exists = isinstance(simulated, Beat) and simulator.prior.keeps(
            point, simulator.model.surfaces, simulated
        )
        tissue = prior.tissue(point[None])
        inputs = found.inputs(
            {name: np.array([values[name]]) for name in found.names},
            tissue_inputs(prior.averaged, np.divide(*default_model.conduction.speeds))[tissue],
        )
        agreed.append(exists == (found.log_validity(inputs)[0] > np.log(0.5)))
        if exists:
            networks.append(Network(values, simulated, simulated.leads, 1.0, 1.0))
    assert 4 < len(networks) < 30  # few are activated as mapped hearts are
    assert np.mean(agreed) > 0.7
    emulated = [EmulatedLikelihood(simulator, found, None)] * len(networks)
    none = Checks(1.0, {})
    error, expected = checked(none, emulated, networks).emulator
    assert error < 1.3 * expected == pytest.approx(1.3 * found.report["error"])
    noisy = [replace(n, beat=with_fast_noise(n.beat)) for n in networks]
    assert checked(none, emulated, noisy).emulator[0] == pytest.approx(error, rel=0.02)
    others = [*networks[1:], networks[0]]
    swapped = [replace(n, parameters=o.parameters) for n, o in zip(networks, others, strict=True)]
    assert checked(none, emulated, swapped).emulator[0] > 2 * expected


OF_THE_PAPER = {**EXAMPLE_PARAMETERS, "alpha": 0.06, "root_time": 8.0}
HUMAN = HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5)) | {"interventricular_delay": 8.0}


@pytest.mark.parametrize(
    ("network", "speed", "delay"),
    [
        (OF_THE_PAPER, {"alpha": (0.05, 0.09)}, "root_time"),
        (HUMAN, {"fibre_speed": (0.5, 0.9)}, "interventricular_delay"),
    ],
)
def test_a_faster_heart_is_the_same_on_another_clock(default_model, network, speed, delay):
    """By simulations of both."""
    values = network | {"anterograde_delay": 1.0, "cv": 3.0}
    rows, ends = [*INDEPENDENT_ROWS], {"cv": (2.0, 4.0)} | speed
    ends |= {delay: (-75.0, 50.0), "anterograde_delay": (0.0, 3.0)}

    def ecg(parameters):
        found = default_model.simulate(parameters)
        return placed(found.leads[rows], found.first_activation - BEFORE, 400)

    now = np.array([ecg(values)] * 4, np.float32)
    here = {name: np.full(4, values[name]) for name in ends}
    others, expected = _scaled_in_time(here, ends, now, np.random.default_rng(2))
    clock = others["cv"] / 3.0
    assert np.ptp(clock) > 0.2
    assert others[delay] == pytest.approx(values[delay] / clock)
    for name, (low, high) in ends.items():
        assert ((others[name] >= low - 1e-9) & (others[name] <= high + 1e-9)).all()
    for k in range(4):
        found = ecg(values | {name: float(each[k]) for name, each in others.items()})
        assert ((found - expected[k]) ** 2).sum() < 0.02**2 * (found**2).sum()


@pytest.fixture(scope="module")
def target(examples):
    """Ten beats of the law, in all leads, louder than it is."""
    ecg = 1.3 * ecgs_of(np.full((1, 6), 0.45))[0].astype(float)
    limb = limb_leads_from(INDEPENDENT_LEADS)
    clean = np.concatenate([limb[:, :2] @ ecg[:2], ecg[2:]])
    beats = clean + smooth_noise(np.random.default_rng(0), (10, *clean.shape), 0.03)
    return Target(beats, np.arange(LENGTH) - BEFORE, 0.0, 90.0, 60.0, {"source": "made"}, 4.0, 5.0)


class OneByOne:
    """A likelihood that only takes one ECG at a time."""

    def __init__(self, likelihood):
        self.log_likelihood, self.predictive = likelihood.log_likelihood, likelihood.predictive


def test_likelihoods_are_those_of_emulated_ecgs(emulator, target):
    likelihood = likelihood_of(target, emulator[0], 0.0)
    points = np.random.default_rng(4).random((20, 6))
    leads, valid = emulated_ecgs(emulator[0], points)
    gains = SPACE.columns(points[:, :4])["gain"]
    expected = [
        likelihood.log_likelihood(Signals(gain * each, float(BEFORE), (50, 50))) + log
        for gain, each, log in zip(gains, leads, valid, strict=True)
    ]
    for each in (likelihood, OneByOne(likelihood)):
        found = EmulatedLikelihood(SIMULATOR, emulator[0], each)(points)
        assert found == pytest.approx(expected, rel=1e-4, abs=0.02)
    assert np.ptp(expected) > 20
    # In proportion to the QRS; the cosines keep most of it.
    for louder in (1.0, 2.0):
        given = replace(target, beats=louder * target.beats)
        energy = (given.qrs[list(INDEPENDENT_ROWS)] ** 2).sum()
        known = likelihood_of(given, emulator[0], 0.3).covariance
        seen = np.trace(known - beat_noise(given)) / energy
        assert 0.75 < seen / (emulator[0].residual_factor ** 2).sum() < 1


def test_inputs_that_are_fixed(emulator):
    """An emulator whose tissue is fixed gives what it gave with that tissue."""
    emulator, _ = emulator
    points = np.random.default_rng(4).random((20, 6))
    values = SPACE.columns(points[:, :4]) | AVERAGED.space.columns(points[:, 4:5])
    tissue = np.array([np.log(2.2), 0.0])
    inputs = emulator.inputs(values, np.tile(tissue, (20, 1)))
    fixed = emulator.with_fixed_inputs(np.arange(inputs.shape[1] - 2, inputs.shape[1]), tissue)
    fewer = fixed.inputs(values, np.empty((20, 0)))
    assert fewer.shape[1] == inputs.shape[1] - 2
    assert_allclose(fixed.scores(fewer), emulator.scores(inputs), rtol=1e-4, atol=1e-4)
    assert_allclose(fixed.log_validity(fewer), emulator.log_validity(inputs), atol=1e-4)


def test_inputs_of_hearts_are_kept_in_files(emulator):
    emulator, _ = emulator
    hearts = np.array([[0.5, -1.0], [2.0, 0.25], [0.0, 1.5]])
    back = EcgEmulator.from_arrays(replace(emulator, hearts=hearts).arrays())
    assert_array_equal(back.hearts, hearts)
    assert not len(EcgEmulator.from_arrays(emulator.arrays()).hearts)
