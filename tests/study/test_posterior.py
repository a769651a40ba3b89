"""A posterior study: its draws, its file, resuming, and what it says in words."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import Parameter, ParameterSpace, free
from fascicle.emulation.predictive import DURATION, Checks, Prediction
from fascicle.forward.activation_sequence import ActivationSequence, SequenceSummary
from fascicle.heart.conduction import Conduction
from fascicle.inference.evaluation import Evaluation
from fascicle.networks.prior import AveragedOver, Prior
from fascicle.study.evaluations import Stage
from fascicle.study.population import Posterior, read_checks, read_population, write_population
from fascicle.study.statements import (
    Caution,
    Statements,
    correlated,
    how_to_go_on,
    prediction_statement,
)
from fascicle.study.study import Study
from tests.study.test_study_folder import make_config

SPACE = ParameterSpace(
    (Parameter("cv", "mm/ms", 2.0, 4.0), Parameter("root_time", "ms", -75.0, 50.0))
)
AVERAGED = AveragedOver(
    ParameterSpace((free("branch_length", prior="normal", median=8.0, sd=1.0),)),
    ({}, {"anisotropy_ratio": 2.0}),
)
SMALL = {"method": "posterior", "prior_simulations": 400, "effective": 60}
OF_AVERAGED = {"averaged": AVERAGED.space.parameters, "tissues": AVERAGED.tissues}


def emulated(points):
    """The speed is hardly determined; the root time is, to a 50th of its range."""
    speed, root_time = points.T[:2]
    return -0.5 * ((root_time - 0.3) / 0.02) ** 2 - 0.5 * ((speed - 0.5) / 0.5) ** 2


def second(points):
    """A second recording knows the speed."""
    return -0.5 * ((points[:, 0] - 0.6) / 0.05) ** 2


def evaluate(point, emulated):
    """What the emulators do not know: where there is no network."""
    assert point.shape == (4,)
    if point[:2].sum() > 1.2:
        return Evaluation.infeasible(point, "left the endocardium")
    logs = np.concatenate([each(point[None]) for each in emulated])
    return Evaluation(point, 1 - logs.sum() + point[2], np.ones(3), log_likelihoods=logs)


def run(folder, progress=None, emulated=(emulated,), before=lambda: None, **settings):
    """A study's result, where every evaluation is told to `before`."""

    def objective(points):
        for point in points:
            before()
            yield evaluate(point, emulated)

    study = Study.create_or_resume(folder, make_config(**OF_AVERAGED | SMALL | settings))
    return study, study.run(objective, progress, emulated)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    seen = []
    folder = tmp_path_factory.mktemp("s") / "study"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.study.methods.PosteriorFit.most_batches", 4)
        return *run(folder, lambda *news: seen.append(news)), seen


def test_draws_of_two_runs_are_networks(done):
    study, posterior, seen = done
    assert isinstance(posterior, Posterior)
    assert posterior.converged
    assert len(posterior) == 60
    assert (posterior.effective >= 30).all()
    for values in np.split(posterior.values["root_time"], 2):
        assert values.mean() == pytest.approx(-37.5, abs=2)
        assert values.std() == pytest.approx(2.5, rel=0.4)
    # uniform over the cube, but for the cut that the emulator does not know
    assert posterior.log_evidences == pytest.approx(np.log(0.02 * np.sqrt(2 * np.pi)), abs=0.4)
    stored = [record.evaluation for record in study.records()]
    assert {record.stage for record in study.records()} == {Stage.SAMPLING}
    assert sum(each.feasible for each in stored) == 60 < len(stored) < 80
    assert posterior.values["cv"].max() < 2 + 2 * 0.95
    best = min(stored, key=lambda each: each.loss if each.feasible else np.inf)
    assert posterior.best_loss == best.loss
    assert posterior.best == SPACE.from_unit(best.point[:2]) | AVERAGED.values(best.point[2:])
    assert [stage for stage, *_ in seen] == sorted((stage for stage, *_ in seen), reverse=True)
    assert seen[-1][:3] == ("networks", 60, 60)
    assert any(re.match(r"2 runs of \d+, log evidence -3\.\d and -", news[3]) for news in seen)


def test_interrupted_it_resumes_to_the_same_bits(done, tmp_path):
    left, asked = [33], []

    def interrupted():
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.study.methods.PosteriorFit.most_batches", 4)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path / "s", before=interrupted)
        study, again = run(tmp_path / "s", before=lambda: asked.append(1))
    for name, values in (done[1].values | done[1].averaged).items():
        assert (again.values | again.averaged)[name].tobytes() == values.tobytes()
    assert again.log_evidences.tobytes() == done[1].log_evidences.tobytes()
    assert len(asked) < len(study.records()) == len(done[0].records())


def test_more_draws_go_on_from_what_is_there(tmp_path):
    """Even more than there are particles at first."""
    first, _ = run(tmp_path)
    before = {record.evaluation.point.tobytes() for record in first.records()}
    study, posterior = run(tmp_path, effective=900)
    assert len(posterior) == 900
    assert before <= {record.evaluation.point.tobytes() for record in study.records()}
    settings = SimpleNamespace(effective=900, prior_simulations=400)
    assert how_to_go_on(replace(posterior, converged=True), settings) == ""
    posterior = replace(posterior, converged=False)
    assert "--prior-simulations 800, in a new study" in how_to_go_on(posterior, settings)
    words = r"NOT CONVERGED \(\d+ effective draws\); fit acceptable: 99% of the QRS explained by .*"
    assert re.fullmatch(words, said_of(posterior, Checks(0.99, {})).verdict)
    apart = replace(posterior, log_evidences=np.array([-3.0, -5.0]), means_apart={"cv": 0.7})
    why = (
        "log evidence -3.0 and -5.0 of two runs, means of Purkinje conduction velocity 0.7 SD apart"
    )
    assert f" draws, {why})" in said_of(apart, Checks(0.99, {})).verdict


def test_another_likelihood_is_refused(tmp_path):
    run(tmp_path)
    with pytest.raises(InputError, match=r"another forward model .* and log likelihood -\d"):
        run(tmp_path, emulated=[lambda points: 1.1 * emulated(points)])


def infeasible_corner(points):
    """Log-likelihoods that favour a corner of the cube that holds no network."""
    return -1e4 * (2 - points[:, 0] - points[:, 1])


@pytest.mark.parametrize(
    ("likelihood", "mapped", "words"),
    [
        (infeasible_corner, False, r"^only \d+ of 200 draws give a network of this heart; make "
         "more prior simulations"),
        (infeasible_corner, True, r"^only \d+ of 200 draws give a network of this heart that is "
         "activated like mapped hearts: .*; leave out conduction"),
        (lambda points: np.full(len(points), -np.inf), False, "^only 0 of 20000 draws from the "
         "prior have a likelihood: check the ranges of the parameters, and the likelihood$"),
    ],
)  # fmt: skip
def test_draws_that_are_no_networks(tmp_path, likelihood, mapped, words):
    with pytest.raises(InputError, match=words):
        run(tmp_path, emulated=[likelihood], mapped=mapped)


def test_where_few_draws_are_networks_more_are_drawn(tmp_path):
    seen = []

    def mostly_beyond(points):
        return -0.5 * ((points[:, :2].sum(axis=1) - 1.5) / 0.15) ** 2

    _, posterior = run(tmp_path, lambda *news: seen.append(news), emulated=[mostly_beyond])
    assert 20 <= len(posterior) < 60
    further = [re.search(r"since (\d) of 200 draws", news[3]) for news in seen]
    assert all(int(match[1]) < 10 for match in further if match)
    assert any(further)


def said_of(posterior, checks=None, prior=None):
    settings = SimpleNamespace(method="posterior", effective=60)
    model = SimpleNamespace(heart=SimpleNamespace(atlas=None, no_image=""))
    simulator = SimpleNamespace(prior=prior or Prior(SPACE), model=model)
    return Statements(
        SimpleNamespace(population=posterior, checks=checks, settings=settings, simulator=simulator)
    )


NORMAL_PRIOR = Prior(SPACE, mapped=True)
BEST = "% of the QRS explained by the best 5% of networks"


@pytest.mark.parametrize(
    ("checks", "words", "caution"),
    [
        (Checks(0.88, {"V1": 0.5}), f"fit acceptable: 88{BEST}", None),
        (Checks(0.849, {}), f"poor fit: 84{BEST}, less than 85%", Caution.POOR_FIT),
        (
            Checks(
                0.9, {"QRS duration": 0.0315, "V1": 0.12}, {"QRS duration": [191, 131, 148, 161]}
            ),
            "poor fit: QRS duration 191 ms recorded, 148 (131–161) simulated",
            Caution.POOR_FIT,
        ),
        (
            Checks(0.9, {}, emulator=[0.52, 0.3]),
            f"fit acceptable: 90{BEST}; emulator 52% off these networks, 30% expected",
            Caution.EMULATOR,
        ),
        (Checks(0.9, {}, emulator=[0.4, 0.3]), f"fit acceptable: 90{BEST}", None),
    ],
)
def test_verdict_and_caution(done, checks, words, caution):
    said = said_of(done[1], checks)
    assert said.verdict == f"converged; {words}"
    assert said.caution is caution
    assert said.acceptable == (caution is not Caution.POOR_FIT)
    assert any(p.constrained for p in said.parameters) == (caution is None)
    for prior, name in ((Prior(SPACE, {"conduction": 1.0}), BLOCK), (NORMAL_PRIOR, "normal")):
        fixed = said_of(done[1], checks, prior).verdict
        assert fixed == f"conduction fixed at {name}; converged; {words}"
    apart = said_of(replace(done[1], converged=False), checks)
    assert apart.caution is Caution.NOT_CONVERGED  # the worse of the two
    assert apart.parameters == apart.correlated == ()
    # a poor fit names what is at the end of its range
    crowded = replace(done[1], values=done[1].values | {"root_time": np.full(60, -74.0)})
    ends = said_of(crowded, checks).verdict.endswith(
        "; at the end of its range: delay between the roots"
    )
    assert ends == (caution is Caution.POOR_FIT)


# Activated first on the free wall of the right ventricle, 9 ms before the left one
RIGHT_FIRST = ActivationSequence(9, 12, 7, 0, 5, 30, 80, "basal lateral left ventricle")
MAPPED = ActivationSequence(0, 4, 8, 15, 20, 30, 75, "basal lateral left ventricle")
BLOCK = "left bundle branch block"
SAID = "activation begins on the right free wall: not seen in mapped hearts with this QRS"


def in_sequence(*sequences, qrs=90.0, share=0.9):
    measured = {DURATION: [qrs, 80.0, 88.0, 95.0]}
    return Checks(share, {}, measured, sequence=SequenceSummary.of(sequences))


def test_a_sequence_that_no_mapped_heart_has_is_said_first_unless_a_block_explains_it(done):
    said = said_of(done[1], in_sequence(RIGHT_FIRST))
    assert said.unmapped == SAID
    assert said.verdict == f"{SAID}; converged; fit acceptable: 90{BEST}"
    assert said.caution is Caution.UNMAPPED
    assert said.acceptable is True  # the ECG is explained all the same
    assert said.sequence[0] == "first activated: right free wall 100%"
    # a worse failure is the caution, but this is still said first
    poor = said_of(done[1], in_sequence(RIGHT_FIRST, share=0.5))
    assert poor.verdict.startswith(f"{SAID}; converged; poor fit: 50%")
    assert poor.caution is Caution.POOR_FIT
    for explained in (
        in_sequence(RIGHT_FIRST, qrs=150.0), in_sequence(MAPPED), in_sequence(MAPPED, RIGHT_FIRST),
        Checks(0.9, {}, {DURATION: [90.0, 80.0, 88.0, 95.0]}),
    ):  # fmt: skip
        said = said_of(done[1], explained)
        assert (said.unmapped, said.caution) == ("", None)
        assert said.verdict == f"converged; fit acceptable: 90{BEST}"
    assert said.sequence == []
    checks = in_sequence(RIGHT_FIRST)
    normal = said_of(replace(done[1], states={"normal": 0.6, BLOCK: 0.4}), checks)
    assert normal.verdict.startswith(
        f"{SAID}; no conduction state is named (not a mapped sequence of activation); converged"
    )
    blocked = said_of(replace(done[1], states={"normal": 0.4, BLOCK: 0.6}), checks)
    assert (blocked.unmapped, blocked.caution) == ("", None)
    assert blocked.verdict.startswith(f"{BLOCK}: 0.60, normal or fascicular block: 0.40; converged")


def test_no_state_is_named_of_a_recording_like_no_simulated_one(done):
    """And the parameters are as they are."""
    why = "the recording is unlike all simulated ones of this heart"
    posterior = replace(done[1], states={"normal": 0.1, BLOCK: 0.9}, unnamed=why)
    said = said_of(posterior, Checks(0.9, {}))
    assert said.states == ""
    assert said.verdict.startswith(f"no conduction state is named ({why}); converged; fit accept")
    assert said.caution is None  # of the parameters
    poor = said_of(posterior, Checks(0.5, {}))
    assert poor.verdict.startswith("no conduction state is named (poor fit); ")
    assert said_of(replace(posterior, states={}), Checks(0.9, {})).verdict.startswith("converged")


def test_what_the_ecg_constrains(done):
    cv, root_time = said_of(done[1]).parameters
    assert not cv.constrained
    assert str(cv).endswith("), not identifiable from the ECG")
    assert root_time.constrained
    assert root_time.contraction > 0.98
    assert (root_time.upper - root_time.lower) / 2 == pytest.approx(1.645 * 2.5, rel=0.35)
    assert re.fullmatch(
        r"-3\d\.\d ms \(90 % CrI -4\d\.\d to -3\d\.\d\), constrained by the ECG", str(root_time)
    )
    assert said_of(done[1]).correlated == ()
    alone = {"cv": np.linspace(1.0, 4.0, 100), "root_time": np.linspace(-60.0, 0.0, 100)}
    cv, root_time = map(str, said_of(replace(done[1], first_alone=alone)).parameters)
    assert "; first recording alone ±27 ms)" in root_time
    assert "; first recording alone ±1.4 m/s)" in cv
    assert said_of(SimpleNamespace()).caution is None  # a population of the paper's method
    # α is 0.061, with the default conductivities 12.2 α m/s along the fibre.
    space = ParameterSpace((Parameter("alpha", "cm/ms √(cm/mS)", 0.04, 0.12),))
    values = {"alpha": np.linspace(0.056, 0.066, 60)}
    said = said_of(replace(done[1], values=values))
    said._result.simulator = SimpleNamespace(
        prior=Prior(space),
        model=SimpleNamespace(
            conduction=Conduction(), heart=SimpleNamespace(atlas=None, no_image="")
        ),
    )
    (alpha,) = said.parameters
    assert alpha.along_fibre == pytest.approx((0.747, 0.692, 0.802), abs=2e-3)
    assert ", 0.75 m/s (0.69–0.80) along the fibre, constrained by the ECG" in str(alpha)


def test_a_second_recording_narrows_what_the_first_leaves(tmp_path, monkeypatch):
    """The second knows the speed, which the first hardly does."""
    monkeypatch.setattr("fascicle.study.methods.PosteriorFit.most_batches", 4)
    others = {"other_targets": ("b",), "scenarios": ("", "")}
    _, both = run(tmp_path, emulated=(emulated, second), **others)
    assert both.converged
    assert both.first_alone is not None
    assert both.log_likelihoods.shape == (60, 2)
    assert both.first_alone["root_time"].mean() == pytest.approx(-37.5, abs=1)
    assert both.values["cv"].std() / both.first_alone["cv"].std() < 0.35
    # prior N(0.5, 0.5²) of the first within the range, times N(0.6, 0.05²)
    middle = SPACE.parameters[0].to_unit(both.values["cv"]).mean()
    assert middle == pytest.approx(0.6, abs=0.03)


def test_statements_of_predictions_and_of_correlated_parameters():
    prior = np.random.default_rng(0).normal(150, 20, 60)
    assert prediction_statement(0.3 * prior, prior).endswith(", constrained by the ECG")
    assert prediction_statement(prior, prior).endswith(", not identifiable from the ECG")
    values = np.random.default_rng(0).random(100)
    pair = SimpleNamespace(values={"a": values, "b": -values, "c": np.roll(values, 50)})
    (found,) = correlated(pair)
    assert (found.first, found.second) == ("a", "b")
    assert found.rank_correlation == pytest.approx(-1)


def test_the_file_is_whole_inference_data(done, tmp_path):
    import arviz as az

    posterior = done[1]
    time = np.arange(-50.0, 60.0)
    rng = np.random.default_rng(0)
    ecg = rng.standard_normal((60, 12, len(time)))
    drawn, torsos = rng.random((3, 60)), rng.random((60, 12, 12))
    measured, sequence = {DURATION: [191, 131, 148, 161]}, SequenceSummary.of([MAPPED, RIGHT_FIRST])
    checks = Checks(0.92, {DURATION: 0.03, "V1": 0.4}, measured, sequence=sequence)
    posterior = replace(posterior, states={"normal": 0.6, BLOCK: 0.4}, unnamed="unlike all others")
    target = SimpleNamespace(time=time, mean=ecg[0], beats=ecg[:5], leads=LEADS)
    path = tmp_path / "posterior.nc"
    prediction = Prediction(ecg, ecg + 1, drawn[0], torsos, *drawn[1:], checks, None)
    write_population(path, posterior, SPACE, [target], [prediction], {"verdict": "converged"})
    data = az.from_netcdf(path)
    assert set(data.groups()) == {
        "posterior", "prior", "sample_stats", "log_likelihood", "posterior_predictive",
        "observed_data", "constant_data", "averaged_over",
    }  # fmt: skip
    assert data.posterior.sizes["chain"] == 2
    assert data.posterior["cv"].attrs["units"] == "mm/ms"
    assert data.posterior_predictive["ecg"].shape == (2, 30, 12, len(time))
    assert data.prior["root_time"].to_numpy().std() == pytest.approx(125 / np.sqrt(12), rel=0.1)
    assert float(az.rhat(data.posterior)["root_time"]) < 1.1
    again = read_population(path)
    assert isinstance(again, Posterior)
    assert again.converged == posterior.converged
    assert again.means_apart == pytest.approx(posterior.means_apart)
    for name in ("losses", "log_likelihoods", "log_evidences", "effective", "evaluations"):
        assert getattr(again, name) == pytest.approx(getattr(posterior, name))
    assert again.best == posterior.best
    assert (again.states, again.unnamed) == (posterior.states, posterior.unnamed)
    assert [again.parameters(k) for k in range(60)] == [posterior.parameters(k) for k in range(60)]
    kinds = [again.parameters(k).keys() - again.values.keys() for k in range(60)]
    assert {frozenset(each) for each in kinds} == {
        frozenset({"branch_length"}), frozenset({"branch_length", "anisotropy_ratio"})
    }  # fmt: skip
    found, gains, in_torsos, ecgs = read_checks(path)
    assert found.sequence.lines == sequence.lines
    assert found.sequence.departure == sequence.departure
    assert replace(found, sequence=None) == replace(checks, sequence=None)
    np.testing.assert_allclose(ecgs[0], ecg, rtol=1e-6)
    np.testing.assert_array_equal(gains, drawn[0])
    np.testing.assert_allclose(in_torsos, torsos, rtol=1e-6)
