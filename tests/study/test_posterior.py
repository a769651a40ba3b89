"""A posterior study: its draws, its file, resuming, and what it says in words."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.heart.conduction import Conduction
from fascicle.inference.evaluation import Evaluation
from fascicle.study.evaluations import Stage
from fascicle.study.population import Posterior, read_checks, read_population, write_population
from fascicle.study.predictive import Checks, Prediction
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
SMALL = {"method": "posterior", "prior_simulations": 400, "effective": 60, "evaluations": 8000}


def objective(points):
    return [evaluate(point) for point in points]


def evaluate(point):
    """The speed is hardly determined; the root time is, to a 50th of its range."""
    if point.sum() > 1.9:
        return Evaluation.infeasible(point, "left the endocardium")
    log_likelihood = -0.5 * ((point[1] - 0.3) / 0.02) ** 2 - 0.5 * ((point[0] - 0.5) / 0.5) ** 2
    return Evaluation(
        point, 1 - log_likelihood, np.ones(3), log_likelihoods=np.array([log_likelihood])
    )


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    study = Study.create_or_resume(tmp_path_factory.mktemp("s") / "study", make_config(**SMALL))
    seen = []
    posterior = study.run(objective, lambda *news: seen.append(news))
    return study, posterior, seen


def test_draws_of_two_runs(done):
    study, posterior, seen = done
    assert isinstance(posterior, Posterior)
    assert posterior.converged
    assert len(posterior) == 60
    assert (posterior.effective >= 30).all()
    first, second = np.split(posterior.values["root_time"], 2)
    for values in (first, second):
        assert values.mean() == pytest.approx(-37.5, abs=2)
        assert values.std() == pytest.approx(2.5, rel=0.4)
    assert {record.stage for record in study.records()} == {Stage.SAMPLING}
    assert posterior.best_loss == min(
        r.evaluation.loss for r in study.records() if r.evaluation.feasible
    )
    stage, number, total, message = seen[-1]
    assert (stage, total) == ("sampling", 8400)
    assert 400 < number <= 8400
    assert message.startswith("2 runs, log evidence -")
    assert re.search(r", effective sample about \d+ of 60, best loss 1", message)


def test_interrupted_it_resumes_to_the_same_bits(done, tmp_path):
    left = [1500]

    def interrupted(points):
        left[0] -= len(points)
        if left[0] < 0:
            raise KeyboardInterrupt
        return objective(points)

    study = Study.create_or_resume(tmp_path / "s", make_config(**SMALL))
    with pytest.raises(KeyboardInterrupt):
        study.run(interrupted)
    study, seen = Study.create_or_resume(tmp_path / "s", make_config(**SMALL)), []
    stored = len(study.records())
    again = study.run(objective, lambda *news: seen.append(news))
    for name, values in done[1].values.items():
        assert again.values[name].tobytes() == values.tobytes()
    assert again.log_evidences.tobytes() == done[1].log_evidences.tobytes()
    # what was stored is done at once, and does not count as sampling
    gone_through = [news for news in seen if news[0] == "stored"]
    assert 400 <= gone_through[-1][1] <= stored == gone_through[-1][2]
    first = next(news for news in seen if news[0] == "sampling")
    assert gone_through[-1][1] < first[1] <= stored + 100


def test_more_draws_go_on_from_what_is_there(tmp_path):
    Study.create_or_resume(tmp_path, make_config(**SMALL)).run(objective)
    asked = []

    def counting(points):
        asked.extend(points)
        return objective(points)

    study = Study.create_or_resume(tmp_path, make_config(**SMALL | {"effective": 3000}))
    before = len(study.records())
    posterior = study.run(counting)
    assert len(posterior) == 3000
    assert 0 < len(asked) <= len(study.records()) - before + 4  # and those of the check


def test_another_likelihood_is_refused(tmp_path):
    config = make_config(**SMALL | {"evaluations": 1000})
    Study.create_or_resume(tmp_path, config).run(objective)

    def surer(points):
        return [replace(e, log_likelihoods=1.1 * e.log_likelihoods) for e in objective(points)]

    with pytest.raises(InputError, match=r"another forward model .* and log likelihood -\d"):
        Study.create_or_resume(tmp_path, config).run(surer)


def test_too_few_evaluations_have_not_converged(tmp_path):
    config = make_config(
        **SMALL | {"prior_simulations": 100, "evaluations": 1000, "effective": 2000}
    )
    posterior = Study.create_or_resume(tmp_path, config).run(objective)
    checks = Checks(0.99, {})
    assert re.fullmatch(
        r"NOT CONVERGED \(\d+ effective draws\); fit acceptable: 99% of the QRS explained by .*",
        said_of(posterior, checks).verdict,
    )
    apart = replace(posterior, log_evidences=np.array([-3.0, -5.0]), means_apart={"cv": 0.7})
    why = (
        "log evidence -3.0 and -5.0 of two runs, means of Purkinje conduction velocity 0.7 SD apart"
    )
    assert f" draws, {why})" in said_of(apart, checks).verdict


class TestHowToGoOn:
    @pytest.mark.parametrize(
        ("draws", "made", "most", "said"),
        [
            # as many as the slower run needs: 12,000 / 20 * 300
            ((20.0, 40.0), (12_000.0, 12_000.0), 24_000, "60 of 300 effective draws after 24000 "),
            ((20.0, 40.0), (12_000.0, 12_000.0), 24_000, "--evaluations 180000 goes on"),
            # twice as many where they are nearly there
            ((149.0, 160.0), (500.0, 500.0), 1000, "--evaluations 2000 "),
            # more draws where both ended and disagree
            ((150.0, 150.0), (1000.0, 2000.0), 24_000, "--effective 600 goes on"),
        ],
    )
    def test_with_which_numbers(self, done, draws, made, most, said):
        numbers = {"effective": np.array(draws), "evaluations": np.array(made)}
        assert said in how_to_go_on(replace(done[1], converged=False, **numbers), 300, most)

    def test_it_is_enough(self, tmp_path):
        """What is advised to a fit with too few evaluations lets it converge."""
        few = SMALL | {"prior_simulations": 400, "evaluations": 1000, "effective": 900}
        study = Study.create_or_resume(tmp_path, make_config(**few))
        said = how_to_go_on(study.run(objective), 900, 1000)
        enough = int(said.split("--evaluations ")[1].split()[0])
        more = Study.create_or_resume(tmp_path, make_config(**few | {"evaluations": enough}))
        assert more.run(objective).converged

    def test_not_where_they_agree(self, done):
        assert how_to_go_on(done[1], 60, 8000) == ""


def said_of(posterior, checks=None):
    settings = SimpleNamespace(method="posterior", effective=60, evaluations=8000)
    simulator = SimpleNamespace(space=SPACE)
    return Statements(
        SimpleNamespace(population=posterior, checks=checks, settings=settings, simulator=simulator)
    )


BEST = "% of the QRS explained by the best 5% of networks"


@pytest.mark.parametrize(
    ("checks", "words", "caution"),
    [
        (Checks(0.88, {"V1": 0.5}), f"fit acceptable: 88{BEST}", None),
        (Checks(0.879, {}), f"poor fit: 87{BEST}, less than 88%", Caution.POOR_FIT),
        (
            Checks(
                0.9, {"QRS duration": 0.0315, "V1": 0.06}, {"QRS duration": [191, 131, 148, 161]}
            ),
            "poor fit: QRS duration 191 ms recorded, 148 (131–161) simulated",
            Caution.POOR_FIT,
        ),
    ],
)
def test_verdict_and_caution(done, checks, words, caution):
    said = said_of(done[1], checks)
    assert said.verdict == f"converged; {words}"
    assert said.caution is caution
    assert said.acceptable == (caution is None)
    apart = said_of(replace(done[1], converged=False), checks)
    assert apart.caution is Caution.NOT_CONVERGED  # the worse of the two
    assert apart.parameters == apart.correlated == ()


def test_a_poor_fit_names_what_is_at_the_end_of_its_range(done):
    values = done[1].values | {"root_time": np.full(60, -74.0)}
    said = said_of(replace(done[1], values=values), Checks(0.5, {}))
    assert said.verdict.endswith("; at the end of its range: RV–LV activation delay")
    assert "range" not in said_of(replace(done[1], values=values), Checks(0.9, {})).verdict


def test_what_the_ecg_constrains(done):
    cv, root_time = said_of(done[1]).parameters
    assert not cv.constrained
    assert str(cv).endswith("), not identifiable from the ECG")
    assert root_time.constrained
    assert root_time.contraction > 0.98
    assert (root_time.upper - root_time.lower) / 2 == pytest.approx(1.645 * 2.5, rel=0.35)
    assert re.fullmatch(
        r"-3\d\.\d ms \(90 % CrI -4\d\.\d–-3\d\.\d\), constrained by the ECG", str(root_time)
    )
    assert said_of(done[1]).correlated == ()
    assert said_of(SimpleNamespace()).caution is None  # a population of the paper's method


def test_alpha_is_given_as_a_speed_too(done):
    """α is 0.061, with the default conductivities 12.2 α m/s along the fibre."""
    space = ParameterSpace((Parameter("alpha", "cm/ms √(cm/mS)", 0.04, 0.12),))
    values = {"alpha": np.linspace(0.056, 0.066, 60)}
    said = said_of(replace(done[1], values=values))
    said._result.simulator = SimpleNamespace(
        space=space, model=SimpleNamespace(conduction=Conduction())
    )
    (alpha,) = said.parameters
    assert alpha.along_fibre == pytest.approx((0.747, 0.692, 0.802), abs=2e-3)
    assert ", 0.75 m/s (0.69–0.80) along the fibre, constrained by the ECG" in str(alpha)


def test_what_the_first_recording_alone_constrains(done):
    alone = {"cv": np.linspace(1.0, 4.0, 100), "root_time": np.linspace(-60.0, 0.0, 100)}
    cv, root_time = map(str, said_of(replace(done[1], first_alone=alone)).parameters)
    assert "; first recording alone ±27 ms)" in root_time
    assert "; first recording alone ±1.4 mm/ms)" in cv


def test_a_second_recording_narrows_what_the_first_leaves(tmp_path):
    """The second knows the speed, which the first hardly does; the first alone stays as it was."""

    def second(points):
        found = [evaluate(point) for point in points]
        return [
            replace(
                e, log_likelihoods=np.append(e.log_likelihoods, -0.5 * ((p[0] - 0.6) / 0.05) ** 2)
            )
            if e.feasible
            else e
            for e, p in zip(found, points, strict=True)
        ]

    config = make_config(**SMALL, other_targets=("b",), scenarios=("", ""))
    both = Study.create_or_resume(tmp_path / "both", config).run(second)
    single = Study.create_or_resume(tmp_path / "one", make_config(**SMALL)).run(objective)
    assert both.converged
    assert both.first_alone is not None
    for name, values in single.values.items():
        assert both.first_alone[name] == pytest.approx(values)
    assert both.log_likelihoods.shape == (60, 2)
    narrowed = both.values["cv"].std() / both.first_alone["cv"].std()
    assert narrowed < 0.35
    # prior N(0.5, 0.5²) of the first within the range, times N(0.6, 0.05²)
    middle = SPACE.parameters[0].to_unit(both.values["cv"]).mean()
    assert middle == pytest.approx(0.6, abs=0.03)


def test_what_the_ecg_constrains_of_a_prediction():
    prior = np.random.default_rng(0).normal(150, 20, 60)
    assert prediction_statement(0.3 * prior, prior).endswith(", constrained by the ECG")
    assert prediction_statement(prior, prior).endswith(", not identifiable from the ECG")


def test_strongly_correlated_parameters():
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
    drawn = rng.random((3, 60))
    checks = Checks(0.92, {"QRS duration": 0.03, "V1": 0.4}, {"QRS duration": [191, 131, 148, 161]})
    target = SimpleNamespace(time=time, mean=ecg[0], beats=ecg[:5], leads=LEADS)
    path = tmp_path / "posterior.nc"
    prediction = Prediction(ecg, ecg + 1, *drawn, checks)
    write_population(path, posterior, SPACE, [target], [prediction], {"verdict": "converged"})
    data = az.from_netcdf(path)
    assert set(data.groups()) == {
        "posterior", "prior", "sample_stats", "log_likelihood", "posterior_predictive",
        "observed_data", "constant_data",
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
    assert read_checks(path)[0] == checks
