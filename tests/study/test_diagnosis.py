"""The conduction state, learnt from an ECG."""

import json
from dataclasses import replace
from types import SimpleNamespace

import arviz as az
import numpy as np
import pytest
from builders import recorded

import fascicle
from fascicle.core.conduction_states import CONDUCTION_STATES, told_apart
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS, limb_leads_from
from fascicle.core.parameters import HUMAN_SPACE, ParameterSpace, free
from fascicle.core.quantities import fascicle_names
from fascicle.emulation import state_classifier
from fascicle.emulation.heart_emulator import emulator_of, simulations_for, usual_prior
from fascicle.emulation.state_classifier import (
    NoStateNamed,
    classifier_of,
    probabilities,
    simulations_of_states,
    state_probabilities,
)
from fascicle.forward.beat import Beat
from fascicle.networks.prior import Prior, asked_states, narrowed, read_settings, states_of
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.networks.settings import checked_settings
from fascicle.pools.pool import Threads
from fascicle.prediction.scenarios import prior_networks
from fascicle.recording.target import smooth_noise
from fascicle.reporting.page.content import settings_file
from fascicle.reporting.study import drawings
from fascicle.study.diagnosis import Diagnosis
from fascicle.study.inputs import read_inputs
from fascicle.study.statements import Statements

BLOCK = "left bundle branch block"
PRIORS = {"normal": 0.6, BLOCK: 0.4}
TOGETHER = (3.0, 12.0)  # ms; interventricular delays of mapped hearts
# In the middle of the prior
NETWORK = HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5)) | {
    "interventricular_delay": 7.5, "rv_source": 0.35, "axial_source": 0.25,
}  # fmt: skip
SETTINGS = {"prior_simulations": 100, "effective": 20, "workers": 2, "progress": None}


pytestmark = pytest.mark.usefixtures("plain_tissue")


@pytest.fixture(scope="module")
def target(default_model):
    return recorded(default_model.simulate(NETWORK | {"conduction": BLOCK}))


@pytest.fixture(scope="module")
def fitted(target, tmp_path_factory):
    out = tmp_path_factory.mktemp("diagnosis") / "study"
    return fascicle.fit("default", target, out, parameters={"conduction": PRIORS}, **SETTINGS)


def test_a_block_is_recognised(fitted):
    assert fitted.population.states.keys() == PRIORS.keys()
    assert fitted.population.states[BLOCK] > 0.9
    assert sum(fitted.population.states.values()) == pytest.approx(1)
    assert fitted.verdict.startswith(f"{BLOCK}: 1.00, others below 0.02; converged; fit acceptable")
    # each network has its state
    numbers = fitted.population.averaged["conduction"]
    assert len(numbers) == 20
    assert (numbers == CONDUCTION_STATES[BLOCK].number).mean() > 0.9
    assert fitted.population.parameters(0)["conduction"] == numbers[0]
    data = az.from_netcdf(fitted.folder / "posterior.nc")
    attributes = data.averaged_over["conduction"].attrs
    assert attributes["flag_meanings"].split()[1] == "left_bundle_branch_block"
    summary = json.loads((fitted.folder / "summary.json").read_text())
    assert summary["evaluations"] >= 20
    assert summary["conduction_states"] == dict(fitted.population.states)
    alone = fascicle.load_study(fitted.folder / "states" / "left-bundle-branch-block", None)
    assert alone.simulator.prior.fixed == {"conduction": 1.0}
    delays = alone.population.values["interventricular_delay"]
    assert ((delays >= TOGETHER[0]) & (delays <= TOGETHER[1])).all()
    assert not alone.simulator.prior.mapped


@pytest.mark.slow
def test_a_study_is_read_back_and_fitted_again_as_it_is(fitted, target):
    read = fascicle.load_study(fitted.folder, None)
    assert read.verdict == fitted.verdict
    assert read.population.states == fitted.population.states
    again = fascicle.fit(
        "default", target, fitted.folder, parameters={"conduction": PRIORS}, **SETTINGS
    )
    np.testing.assert_array_equal(again.population.losses, fitted.population.losses)
    with pytest.raises(InputError, match=r"states normal: there 0\.6, now"):
        fascicle.fit(
            "default", target, fitted.folder, parameters={"conduction": "free"}, **SETTINGS
        )


def test_predictions_keep_the_block(fitted):
    names = ["his-pacing-uncorrected", "his-pacing"]
    paced = fascicle.predict(fitted, names, progress=None)
    uncorrected, corrected = (paced[name].indices["total_activation_time"] for name in names)
    assert (uncorrected - corrected).mean() > 15


@pytest.mark.slow
def test_networks_of_the_prior_are_of_all_states(fitted):
    networks = prior_networks(fitted, count=30)
    blocked = [network.parameters.get("conduction", 0.0) == 1.0 for network in networks]
    assert 0.15 < np.mean(blocked) < 0.65  # 0.4, though few of the normal ones are kept
    low, high = TOGETHER
    assert all(low <= n.parameters["interventricular_delay"] <= high for n in networks)
    surfaces = fitted.simulator.model.surfaces
    sequences = [surfaces.sequence(n.beat.activation) for n in networks]
    mapped = [s.is_mapped for s, block in zip(sequences, blocked, strict=True) if not block]
    assert np.mean(mapped) > 0.5


def test_the_settings_file_of_the_report_repeats_it(fitted, target, tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text("\n".join(settings_file(fitted.study.config)))
    read = read_settings(path)
    inputs = read_inputs("default", target, read.pop("parameters"), checked_settings(read))
    config = fitted.study.config.model_copy(update={"workers": inputs.config.workers})
    assert inputs.config == config


@pytest.mark.parametrize(
    ("parameters", "mapped"),
    [
        ({}, False),
        ({"conduction": "normal", "lv_fascicles": 2, "rv_fascicles": 3}, True),
        ({"conduction": "right bundle branch delay", "fibre_speed": 0.5}, False),
        ({"conduction": "left anterior fascicular block"}, False),
    ],
)
def test_a_settings_file_gives_the_same_study(target, tmp_path, default_heart, parameters, mapped):
    """Of one state as well, of which there is nothing to fix if it is normal."""
    first = read_inputs(default_heart, target, parameters, checked_settings({})).config
    assert first.mapped == mapped
    (tmp_path / "settings.toml").write_text("\n".join(settings_file(first)))
    read = read_settings(tmp_path / "settings.toml")
    again = read_inputs(
        default_heart, target, read.pop("parameters"), checked_settings(read)
    ).config
    assert {p.name: p for p in again.space} == {p.name: p for p in first.space}
    unordered = {"space": (), "workers": 1}
    assert again.model_copy(update=unordered) == first.model_copy(update=unordered)


def test_what_is_said(fitted):
    """Of a delay without effect, by the prior of the states that are left; and of a poor fit."""
    said = {p.name: p for p in fitted.statements.parameters}
    assert said["interventricular_delay"].contraction < 0.5
    read = fascicle.load_study(fitted.folder, None).statements.parameters
    assert [str(p) for p in read] == [str(p) for p in fitted.statements.parameters]
    verdict = Statements(replace(fitted, checks=replace(fitted.checks, explained=0.5))).verdict
    assert verdict.startswith("no conduction state is named (poor fit); converged; poor fit: 50%")
    assert not [w for w in fitted.warnings if "paced" in str(w)]
    (one,) = fitted.recordings
    paced = replace(one, target=replace(one.target, earliest_onset=one.target.qrs_onset))
    said = Statements(replace(fitted, recordings=(paced,))).warnings
    assert [w.kind for w in said if "the recorded beats are paced" in w.text] == ["paced"]
    states = {BLOCK: 0.6, "left bundle branch delay": 0.3, "normal": 0.1, "other": 0.001}
    population = replace(fitted.population, states=states)
    assert Statements(replace(fitted, population=population)).states == (
        "left bundle branch block: 0.60, left bundle branch delay: 0.30, normal or fascicular "
        "block: 0.10, others below 0.02 (block and delay of the left bundle branch give much the "
        "same ECG)"
    )


@pytest.mark.slow
def test_the_states_are_drawn_and_not_if_none_is_named(fitted):
    networks = fitted.networks(chosen=[0])
    drawn = drawings(fitted, networks)["states"].figure.axes[0]
    assert [label.get_text() for label in drawn.get_yticklabels()] == ["normal", BLOCK]
    widths = [bar.get_width() for bar in drawn.patches]
    assert widths == pytest.approx([fitted.population.states[n] for n in ("normal", BLOCK)])
    poor = replace(fitted, checks=replace(fitted.checks, explained=0.5))
    assert "states" not in drawings(poor, networks)


@pytest.mark.slow
def test_states_are_learnt_of_one_intrinsic_beat_unless_something_speaks_against_it(
    target, default_heart
):
    def learnt(target, parameters, **more):
        given = read_inputs(default_heart, target, parameters, checked_settings({}), **more)
        return given.config.states

    assert [*learnt(target, {})] == [*learnt(target, {"cv": 2.5})] == [s.name for s in told_apart()]
    assert sum(learnt(target, {}).values()) == pytest.approx(1)
    assert learnt(target, {"conduction": "normal"}) == {}
    assert learnt(target, {"root_time": -60.0}) == {}
    assert learnt(target, {"interventricular_delay": "free"}) == {}
    assert learnt([target, target], {}) == {}
    assert learnt(target, {}, likelihoods=[None]) == {}
    assert learnt(replace(target, earliest_onset=target.qrs_onset), {}) == {}


def test_an_atlas_takes_one_intrinsic_beat_in_a_conduction_state(atlas_model, target):
    paced = replace(target, earliest_onset=target.qrs_onset)
    with pytest.raises(InputError, match="give one recording, without a scenario"):
        read_inputs(atlas_model.heart, [target, target], {}, checked_settings({}))
    with pytest.raises(InputError, match="one is paced or has no state; if"):
        read_inputs(atlas_model.heart, paced, {}, checked_settings({}))
    read_inputs(atlas_model.heart, paced, {"conduction": "normal"}, checked_settings({}))


def test_normal_alone_is_activated_as_mapped_hearts_are(default_heart, target):
    """Unless root times are asked for, of which mapped hearts say nothing."""
    normal = {"conduction": "normal"}

    def of(parameters):
        config = read_inputs(default_heart, target, parameters, checked_settings({})).config
        return config, {p.name: (p.lower, p.upper) for p in config.space}

    config, ranges = of(normal)
    assert ranges["interventricular_delay"] == TOGETHER
    assert (config.fixed, config.states, config.mapped) == ({}, {}, True)
    config, ranges = of(normal | {"root_time": "free"})
    assert ranges["root_time"] == (-20.0, 20.0)
    assert "interventricular_delay" not in ranges
    assert not config.mapped
    config, ranges = of(normal | {"interventricular_delay": 5.0})
    assert config.fixed == {"interventricular_delay": 5.0}
    assert config.mapped
    with pytest.raises(InputError, match="the ranges exclude what was asked"):
        of(normal | {"interventricular_delay": 30.0})
    assert not of({"conduction": "right bundle branch delay"})[0].mapped
    assert not of({"interventricular_delay": "free"})[0].mapped


def test_states_have_simulations_and_emulators_of_their_own(default_model, tmp_path):
    """Also where a quantity is fixed; else this would simulate thousands of networks."""
    prior = Prior.of("posterior", {"cv": 2.5}, default_model.heart)
    for state in told_apart():
        narrowed = prior.narrowed(state)
        assert narrowed.mapped == (state.name == "normal")
        assert narrowed.fixed == {"cv": 2.5} | state.blocks
        simulations = simulations_for(default_model, narrowed, tmp_path)
        emulator = emulator_of(simulations, 8000, Threads(1))
        assert emulator.report["r_squared"] > 0.6
    assert not [*tmp_path.iterdir()]
    # Those of the usual priors, where they are of what is asked for.
    prior = usual_prior(default_model.heart)
    known = simulations_of_states(default_model, prior, tmp_path, 2000)
    assert [*known] == [state.name for state in told_apart()]
    usual = {name: each.simulations.content for name, each in known.items()}
    assert len({*usual.values()}) == len(told_apart())
    delays = {}
    for name, each in known.items():
        its = each.simulations.prior
        (delay,) = (p for p in its.learnt.parameters if p.name == "interventricular_delay")
        delays[name] = delay.lower, delay.upper
        assert its.fixed == CONDUCTION_STATES[name].blocks
        assert its.mapped == (name == "normal")
        assert each.count == (2000 if name == "normal" else 1000)  # of which many are left out
    assert delays.pop("left bundle branch delay") == (-40.0, -5.0)
    assert delays.pop("right bundle branch delay") == (15.0, 40.0)
    assert {*delays.values()} == {TOGETHER}
    first, *others = prior.space.parameters
    for upper, same in ((first.upper - 5, True), (first.upper + 10, False)):
        asked = replace(prior, space=ParameterSpace((replace(first, upper=upper), *others)))
        found = simulations_of_states(default_model, asked, tmp_path, 2000)
        for name, content in usual.items():
            assert (found[name].simulations.content == content) == same


@pytest.mark.slow
def test_one_state_is_a_study_of_it(target, tmp_path):
    given = {"conduction": "right bundle branch delay"}
    found = fascicle.fit("default", target, tmp_path / "study", parameters=given, **SETTINGS)
    assert found.population.states == {}
    assert found.simulator.prior.fixed == {}
    times = found.population.values["interventricular_delay"]
    assert times.min() >= 15


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({}, "'conduction': nothing; give a prior above 0 for each of some of normal, left"),
        ({"normal": 0.0}, r"\['normal'\]; give a prior above 0"),
        ({"block": 0.5}, r"\['block'\]; give a prior above 0"),
        ({"left anterior fascicular block": 0.5}, r"\['left anterior .*'\]; give a prior above 0"),
        ("block", "'block'; give one of normal, left bundle branch block, left"),
        (12, "12"),
    ],
)
def test_no_such_state(asked, said):
    with pytest.raises(InputError, match=said):
        asked_states(asked)


@pytest.mark.parametrize(
    ("count", "method", "words"),
    [
        (1, "paper", "knows no conduction states; leave it out"),
        (2, "posterior", "learnt from one recording of an intrinsic beat; give"),
    ],
)
def test_states_are_not_learnt(target, tmp_path, count, method, words):
    free = {"conduction": "free"}
    with pytest.raises(InputError, match=words):
        fascicle.fit("default", [target] * count, tmp_path / "s", parameters=free, method=method)


def test_six_states_are_told_apart_and_all_are_known():
    """Fascicular blocks belong to normal, and can still be asked for alone."""
    assert asked_states("free") == told_apart()
    assert sum(state.probability for state in told_apart()) == pytest.approx(1)
    assert len(told_apart()) == 6
    assert len(CONDUCTION_STATES) == 9
    (fascicular,) = asked_states("left posterior fascicular block")
    assert fascicular.blocks == {"conduction": fascicular.number}
    assert [s.probability for s in states_of({"normal": 0.2, fascicular.name: 0.8})] == [0.2, 0.8]


def test_states_have_ranges_of_their_own(default_heart):
    prior = usual_prior(default_heart)
    mixed = replace(prior, states={state.name: state.probability for state in told_apart()}).learnt
    ends = {p.name: (p.lower, p.upper) for p in mixed.parameters}
    assert ends["interventricular_delay"] == (-40.0, 40.0)
    assert ends["fibre_speed"] == (0.2, 0.8)
    assert ends["cv"] == (1.0, 3.5)
    assert mixed.parameters[0] == prior.learnt.parameters[0]
    draws = mixed.columns(np.random.default_rng(0).random((20_000, len(mixed))))
    delays, slow = (draws["interventricular_delay"], probability("intraventricular delay"))
    late = {side: probability(f"{side} bundle branch delay") for side in ("left", "right")}
    together = (delays >= TOGETHER[0]) & (delays <= TOGETHER[1])
    assert together.mean() == pytest.approx(1 - sum(late.values()), abs=0.006)
    assert (delays < 0).mean() == pytest.approx(late["left"], abs=0.003)
    assert (delays > TOGETHER[1]).mean() == pytest.approx(late["right"], abs=0.006)
    assert (draws["fibre_speed"] < 0.4).mean() == pytest.approx(slow, abs=0.005)
    named_so = {p.name: p for p in mixed.parameters}
    for name in ("interventricular_delay", "fibre_speed", "cv"):
        shares = named_so[name].to_unit(draws[name])
        assert np.histogram(shares, 5, (0, 1))[0] == pytest.approx([4000] * 5, rel=0.05)


def space_in(name, space, fixed):
    return narrowed(CONDUCTION_STATES[name], space, fixed)


def probability(name):
    return CONDUCTION_STATES[name].probability


def test_what_is_asked_for_excludes_states():
    usual = map(free, fascicle_names("lv", 2))
    late = ParameterSpace((free("root_time", lower=10.0, upper=30.0), free("cv"), *usual))
    assert space_in("left bundle branch delay", late, {}) is None
    space = space_in("right bundle branch delay", late, {})
    assert [(p.lower, p.upper) for p in space.parameters[:2]] == [(20.0, 30.0), (2.0, 4.0)]
    for asked, range_ in (
        ({"lower": 10.0, "upper": 30.0}, (15.0, 30.0)), ({"lower": -75.0, "upper": 60.0}, (15, 40))
    ):  # fmt: skip
        delay = ParameterSpace((free("interventricular_delay", **asked), *late.parameters[1:]))
        space = space_in("right bundle branch delay", delay, {}).parameters[0]
        assert (space.lower, space.upper) == range_
        left = space_in("left bundle branch delay", delay, {})
        assert (left is None) == (asked["lower"] == 10.0)
    rest = ParameterSpace(late.parameters[1:])
    assert space_in("normal", rest, {"root_time": -30.0}) is None
    assert space_in("normal", rest, {"interventricular_delay": 2.0}) is None
    assert space_in("normal", rest, {"interventricular_delay": 3.0}) is not None
    one = ParameterSpace(tuple(map(free, fascicle_names("lv", 1))))
    assert space_in("left anterior fascicular block", one, {}) is None


def test_a_known_speed_excludes_slow_tissue(default_heart, target):
    for known in ({"fibre_speed": 0.6}, {"alpha": 0.07}):
        heart = replace(default_heart, values=known, folder=None)
        free = {"conduction": "free"}
        states = read_inputs(heart, target, free, checked_settings({})).config.states
        assert {*states} == {state.name for state in told_apart()} - {"intraventricular delay"}
    slow = {"conduction": "intraventricular delay"}
    with pytest.raises(InputError, match="the heart's values or the ranges exclude what was asked"):
        read_inputs(heart, target, slow, checked_settings({}))


def test_probabilities_are_of_priors_and_the_classifier():
    """States that are not asked for are left out; the most probable ones are fitted."""
    classifier = SimpleNamespace(probabilities=lambda target: np.array([0.2, 0.5, 0.3]))
    known = ["normal", BLOCK, "left bundle branch delay"]
    found = probabilities(classifier, known, {"normal": 3.0, BLOCK: 1.0}, None)
    assert found == pytest.approx({"normal": 6 / 11, BLOCK: 5 / 11})
    probable = {"normal": 0.3, BLOCK: 0.61, "left bundle branch delay": 0.09}
    assert Diagnosis(probable, "", {}).shares == pytest.approx({BLOCK: 61 / 91, "normal": 30 / 91})
    assert Diagnosis({"normal": 0.05, BLOCK: 0.95}, "", {}).shares == {BLOCK: 1.0}
    assert Diagnosis({"a": 0.7, "b": 0.25, "c": 0.05}, "", {}).apportioned(10) == [7, 3]
    even = Diagnosis({f"{k}": 1 / 7 for k in range(7)}, "", {})
    assert sum(even.apportioned(150)) == 150


def test_states_of_a_recording_without_a_fit_and_of_noise(target, default_model):
    found = state_probabilities("default", target, progress=None)
    assert not isinstance(found, NoStateNamed)
    assert next(iter(found)) == "normal or fascicular block"
    assert {*found} - {"normal or fascicular block"} == {state.name for state in told_apart()} - {
        "normal"
    }
    assert sum(found.values()) == pytest.approx(1)
    left = BLOCK, "left bundle branch delay"
    assert sum(found[name] for name in left) > 0.9
    priors = {"normal": 1e6, BLOCK: 1.0}
    other = state_probabilities("default", target, priors, progress=None)
    assert {*other} == {"normal or fascicular block", BLOCK}
    assert other[BLOCK] < found[BLOCK]
    asked = {"conduction": priors}
    assert state_probabilities("default", target, parameters=asked, progress=None) == other
    wide = default_model.simulate(NETWORK | {"conduction": "right bundle branch block"})
    assert isinstance(wide, Beat)
    right = state_probabilities("default", recorded(wide), progress=None)
    assert sum(right[f"right bundle branch {how}"] for how in ("block", "delay")) > 0.5
    # It says what the classifier says all the same, and that this cannot be relied on.
    noise = smooth_noise(np.random.default_rng(3), target.beats.shape[1:], 0.5)
    limb = limb_leads_from(INDEPENDENT_LEADS)
    noise[:6] = limb[:, :2] @ noise[:2]
    found = state_probabilities("default", replace(target, beats=target.beats * 0 + noise),
                                progress=None)  # fmt: skip
    assert isinstance(found, NoStateNamed)
    assert found.reason.startswith("the recording is unlike all simulated ones of this heart (")
    assert str(found) == f"no conduction state is named: {found.reason}"
    assert found.unreliable.keys() == {state.name for state in told_apart()}
    assert sum(found.unreliable.values()) == pytest.approx(1)


def test_what_has_no_states_is_refused(target):
    for given, words in (
        ({"priors": {"block": 1.0}}, r"\['block'\]; give a prior above 0"),
        ({"prior_simulations": 0}, "prior_simulations is 0"), ({"workers": 0}, "workers is 0"),
        ({"parameters": [1]}, "parameters is .*; give a dict of names to values"),
        ({"parameters": {"cw": 2.0}}, "'cw'"),
        ({"parameters": {"interventricular_delay": 55.0}}, "exclude what was asked for; fix less"),
        ({"parameters": {"conduction": {"block": 1.0}}}, r"\['block'\]; give a prior above 0"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            state_probabilities("default", target, progress=None, **given)


@pytest.mark.slow
def test_a_heart_without_a_classifier_gets_one(default_model, target, tmp_path, monkeypatch):
    """Of its own simulations, in the leads that were recorded; it is then kept."""
    monkeypatch.setattr(state_classifier.StateSimulations, "fewest", 10)
    monkeypatch.setattr(PriorSimulations, "part_size", 100)
    prior = usual_prior(default_model.heart)
    known = simulations_of_states(default_model, prior, tmp_path, 400)
    two = {name: known[name] for name in ("left bundle branch delay", "right bundle branch delay")}
    rows, pool, seen = np.array([0, 1, 6, 7, 8]), Threads(2), []
    made = classifier_of(two, rows, tmp_path, 400, pool, lambda *news: seen.append(news))
    done = [news[1:3] for news in seen if news[0] == "prior simulations"]
    assert done == [(k + 1, 200) for k in range(200)]  # of both states
    assert made.accuracy > 0.6
    late = probabilities(made, two, dict.fromkeys(two, 1.0), target)
    assert late["left bundle branch delay"] > 0.6
    again = classifier_of(two, rows, tmp_path, 400, None)
    assert again.probabilities(target) == pytest.approx(made.probabilities(target))
