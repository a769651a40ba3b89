"""What the inference sees: evaluations, in order, however many workers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.forward.model import ForwardModel
from fascicle.heart.conduction import Conduction
from fascicle.networks.prior import Prior
from fascicle.networks.settings import FitSettings
from fascicle.networks.simulator import BeatMemory, PointSimulator
from fascicle.networks.target_comparison import TargetComparison, evaluate, networks
from fascicle.pools.pool import Threads
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.target import Target
from fascicle.study.fitted import FittedStudy
from fascicle.torso.lead_fields import key_of

NOISE = 0.02  # mV


@pytest.fixture(scope="module")
def truth():
    return EXAMPLE_PARAMETERS | {"root_time": -12.0, "cv": 2.6}


@pytest.fixture(scope="module")
def target(default_model, truth):
    """Five beats of a simulated QRS 40 ms into the beat, with beat-to-beat noise."""
    ecg = default_model.simulate(truth).ecg.to_numpy()
    length = ecg.shape[1]
    beat = np.pad(ecg, ((0, 0), (40, 40)))
    beats = beat + NOISE * np.random.default_rng(0).normal(size=(5, *beat.shape))
    time = np.arange(beat.shape[1]) - 60.0
    return Target(beats, time, -20.0, -20.0 + length - 1, 60.0)


@pytest.fixture(scope="module")
def points(truth):
    """The truth, random points and one that cannot be grown."""
    random = np.random.default_rng(1).uniform(0.2, 0.6, (4, len(NETWORK_SPACE)))
    longest = NETWORK_SPACE.to_unit(truth | {"lv_initial_length": 300.0})
    return [NETWORK_SPACE.to_unit(truth), *random, longest]


def evaluated(model, target, points, fixed=None, **options):
    simulator = PointSimulator(model, Prior(NETWORK_SPACE, fixed or {}), Threads(2))
    return list(evaluate(simulator, [TargetComparison(target, **options)], points))


def test_truth_is_explained_to_the_noise(default_model, target, points):
    """Mean of 5 beats: 12·σ²/5; a single beat: 12·σ²."""
    best, *others = evaluated(default_model, target, points[:5])
    assert best.loss == pytest.approx(12 * NOISE**2 / 5, rel=0.1)
    np.testing.assert_allclose(best.beat_errors, 12 * NOISE**2, rtol=0.15)
    assert min(e.loss for e in others if e.feasible) > 10 * best.loss
    # Ten repetitions with noise σ: each misses the truth by about 12·σ², always the same.
    mean = target.mean[None]
    single = replace(target, beats=mean, noise=0.05)
    (first,) = evaluated(default_model, single, points[:1])
    (again,) = evaluated(default_model, single, points[:1])
    assert len(first.beat_errors) == 10
    np.testing.assert_array_equal(first.beat_errors, again.beat_errors)
    assert first.beat_errors.mean() == pytest.approx(12 * 0.05**2, rel=0.2)
    assert 0.02 < first.beat_errors.std() / first.beat_errors.mean() < 0.3
    assert first.loss == pytest.approx(12 * NOISE**2 / 5, rel=0.1)


def test_networks_that_were_evaluated_are_not_simulated_again(
    default_model, target, points, monkeypatch
):
    simulator = PointSimulator(
        default_model, Prior(NETWORK_SPACE), Threads(2), memory=BeatMemory(True)
    )
    comparison = TargetComparison(target)
    done = [e for e in evaluate(simulator, [comparison], points) if e.feasible]
    columns = NETWORK_SPACE.columns(np.array([each.point for each in done]))
    learnt = [{n: float(v[k]) for n, v in columns.items()} for k in range(len(done))]
    learnt[0]["conduction"] = 0.0  # as a mixture of states names the normal one
    monkeypatch.setattr(ForwardModel, "simulate", None)
    losses = [comparison.align(n.beat.leads).loss for n in networks(simulator, comparison, learnt)]
    assert losses == [each.loss for each in done]


@pytest.mark.parametrize(
    ("which", "fewest_junctions", "reason"),
    [(-1, 0, "LV bundle leaves the endocardium after"), (0, 10_000, "LV tree has ")],
)
def test_what_is_no_network_is_a_typed_evaluation(
    default_model, target, points, which, fewest_junctions, reason
):
    """It cannot be grown, or has fewer junctions than are asked for."""
    given = {"fewest_junctions": fewest_junctions}
    (outcome,) = evaluated(default_model, target, [points[which]], **given)
    assert not outcome.feasible
    assert outcome.reason.startswith(reason)
    assert np.isnan(outcome.loss)
    assert outcome.beat_errors.size == 0


def test_gains_and_the_independent_leads(default_model, target, points):
    half = Target(0.5 * target.beats, target.time, target.qrs_onset, target.qrs_offset, 60.0)
    point = points[0]
    (fixed,) = evaluated(default_model, half, [point])
    (free,) = evaluated(default_model, half, [point], free_gain=True)
    assert free.loss == pytest.approx(3 * NOISE**2 / 5, rel=0.1)
    assert fixed.loss > 20 * free.loss
    leads = default_model.simulate(NETWORK_SPACE.from_unit(point)).leads
    comparison = TargetComparison(half, free_gain=True)
    assert comparison.align(leads).gain == pytest.approx(0.5, abs=0.01)
    # A fixed gain is that of the simulation; eight leads say what twelve do.
    plain = TargetComparison(target)
    loud = PointSimulator(default_model, Prior(NETWORK_SPACE, {"gain": 2.0}))
    network = next(networks(loud, plain, [NETWORK_SPACE.from_unit(points[0])]))
    assert network.parameters["gain"] == 2.0
    (found,) = evaluate(loud, [plain], points[:1])
    assert found.loss == pytest.approx(plain.null_loss, rel=0.05)
    eight = replace(plain, independent_leads=True)
    assert eight.compared.tolist() == [True, True, False, False, False, False] + [True] * 6
    assert 0 < eight.null_loss < plain.null_loss
    (found,) = evaluated(default_model, target, points[:1], independent_leads=True)
    assert found.loss == pytest.approx(8 * NOISE**2 / 5, rel=0.15)


def test_unused_leads_do_not_count(default_model, target, points):
    """As if the lead were not there: no term of the loss, but a prediction in it, too.

    The prediction lies under the whole beat, not only in the QRS window; a shift by the window's
    start would show.
    """
    beats = target.beats.copy()
    beats[:, 7] = np.nan
    comparison = TargetComparison(replace(target, beats=beats))
    simulation = default_model.simulate(NETWORK_SPACE.from_unit(points[0]))
    best = comparison(points[0], simulation.signals)
    assert best.loss == pytest.approx(11 * NOISE**2 / 5, rel=0.1)
    np.testing.assert_allclose(best.beat_errors, 11 * NOISE**2, rtol=0.15)
    assert np.abs(predicted(comparison, simulation.leads) - target.mean).max() < 5 * NOISE


def test_additional_leads_count_like_the_twelve(
    default_heart, default_model, truth, target, points
):
    """An electrode where V6 and one where LA is: the leads of a target that has them are compared.

    In a target without them, the comparison is that of the twelve to the last bit.
    """
    default_heart = default_model.heart
    at = dict(zip(default_heart.electrode_names, default_heart.electrodes, strict=True))
    fields = default_heart.lead_fields
    more = replace(
        default_heart,
        folder=None,
        additional_electrodes={"E6": at["V6"], "EL": at["LA"]},
        lead_fields=replace(fields, values=fields.values[[*range(9), 8, 1]]),
    )
    more = replace(more, lead_fields=replace(more.lead_fields, key=key_of(more, Conduction())))
    model = ForwardModel(more)
    simulated = model.simulate(truth)
    twelve = simulated.leads[:12]
    np.testing.assert_array_equal(twelve, default_model.simulate(truth).leads)
    np.testing.assert_allclose(simulated.leads[12], twelve[11], atol=1e-5)
    np.testing.assert_allclose(simulated.leads[13], twelve[4] * 2 / 3, atol=1e-5)
    signals = [model.simulate(NETWORK_SPACE.from_unit(point)).signals for point in points[:3]]
    plain = TargetComparison(target.in_leads(more.leads))
    assert plain.compared.sum() == 12
    alone = TargetComparison(target)
    for point, each in zip(points, signals, strict=False):
        of_twelve = replace(each, leads=each.leads[:12])
        assert plain(point, each).loss == alone(point, of_twelve).loss
        predicted = plain.predicted(each.leads, plain.align(each.leads))
        assert predicted.shape == (14, len(target.time))
    beats = np.concatenate([target.beats, target.beats[:, [11]]], axis=1)
    of_both = replace(target, beats=beats, leads=(*LEADS, "E6"))
    both = TargetComparison(of_both.in_leads(more.leads))
    assert both.compared.tolist() == [True] * 13 + [False]
    assert both(points[1], signals[1]).loss > plain(points[1], signals[1]).loss


def test_a_network_lies_under_the_recorded_qrs(default_model, target, points):
    simulator = PointSimulator(default_model, Prior(NETWORK_SPACE))
    parameters = [NETWORK_SPACE.from_unit(points[0])]
    truth = next(networks(simulator, TargetComparison(target), parameters))
    assert truth.under_qrs == pytest.approx(1.0, abs=1e-3)
    narrow = TargetComparison(replace(target, qrs_onset=0.0, qrs_offset=20.0))
    assert next(networks(simulator, narrow, parameters)).under_qrs < 0.9


@pytest.fixture(scope="module")
def ringing(default_model, truth):
    """One beat behind a steep low-pass at 35 Hz; its QRS window holds the ringing, too."""
    lowpass = Filter(FilterKind.LOW_PASS, 35.0, FilterOrigin.ESTIMATED, 20.0)
    leads = default_model.simulate(truth).leads
    sharp = np.pad(leads, ((0, 0), (300, 300)))
    size = sharp.shape[1]
    gain = lowpass.gain(np.fft.rfftfreq(size, 1e-3))
    beat = np.fft.irfft(gain * np.fft.rfft(sharp), size)
    time = np.arange(size) - 300.0
    end = 300.0 + leads.shape[1]
    filters = (lowpass,)
    return Target(beat[None], time, -200.0, end - 100.0, None, noise=NOISE, filters=filters), slice(
        100, 300
    )


def predicted(comparison, leads):
    return comparison.predicted(leads, comparison.align(leads))


def test_ringing_is_explained_by_the_filter_and_not_without(default_model, truth, ringing):
    target, before = ringing
    leads = default_model.simulate(truth).leads
    knowing = TargetComparison(target)
    unaware = TargetComparison(replace(target, filters=()))
    assert unaware.align(leads).loss > 1e4 * knowing.align(leads).loss
    recorded = target.mean[:, before]
    assert np.abs(recorded).max() > 0.02  # mV
    np.testing.assert_allclose(predicted(knowing, leads)[:, before], recorded, atol=1e-3)
    assert np.abs(predicted(unaware, leads)[:, before]).max() < 1e-6


@pytest.fixture(scope="module")
def study(default_model, target):
    simulator = PointSimulator(default_model, Prior(NETWORK_SPACE), Threads(2))
    on_disk = SimpleNamespace(folder="study", config=FitSettings())
    return FittedStudy(on_disk, simulator, (TargetComparison(target),), None)


def test_draws_of_ones_own(study, truth):
    draws = {name: [[truth[name], truth[name]]] for name in NETWORK_SPACE.names}
    draws["root_time"] = [[-40.0, truth["root_time"]]]
    table = xr.Dataset({name: (("chain", "draw"), values) for name, values in draws.items()})
    for given in (table, SimpleNamespace(posterior=table)):
        own = study.with_draws(given)
        assert own.population.best["root_time"] == truth["root_time"]
        assert own.population.losses[1] == pytest.approx(12 * NOISE**2 / 5, rel=0.1)
        assert own.population.losses[0] > 10 * own.population.losses[1]
        simulated = own.networks()[0].beat
        np.testing.assert_array_equal(
            simulated.activation,
            study.simulator.model.simulate(truth | {"root_time": -40.0}).activation,
        )
        assert own.verdict.startswith("2 networks of your own, which were not compared")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"cv": None}, "^draws: there is no 'cv', which the study learns; add it$"),
        ({"cv": [2.0, 3.0]}, "^draws: 1 or 2 values; give equally many of each, and one$"),
        ({"cv": [-1.0]}, "'cv' is -1 mm/ms"),
        ({"lv_fascicle_length_1": [300.0]}, r"number 0 gives no network \(LV fascicle 1 leaves"),
    ],
)
def test_draws_that_are_refused(study, truth, changed, words):
    draws = {name: [truth[name]] for name in NETWORK_SPACE.names} | changed
    with pytest.raises(InputError, match=words):
        study.with_draws({name: values for name, values in draws.items() if values is not None})
