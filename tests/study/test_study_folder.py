"""A study survives interruption and refuses to be mixed with another."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fascicle
from benchmarks.fits import demo_recording
from fascicle.core.errors import InputError
from fascicle.core.parameters import Parameter, ParameterSpace, free
from fascicle.inference import optimisation as bo_step
from fascicle.inference.abc import ErrorDensity, total_variation
from fascicle.inference.evaluation import Evaluation
from fascicle.networks.prior import NOT_KNOWN
from fascicle.networks.settings import FitSettings
from fascicle.study.evaluations import Stage
from fascicle.study.inputs import read_inputs
from fascicle.study.study import CHECKED, STUDY_FORMAT, Study, StudyConfig, check_same

SPACE = ParameterSpace((Parameter("cv", "mm/ms", 2.0, 4.0), Parameter("root_time", "ms", -75, 50)))
NOISE = np.linspace(-1, 1, 6) ** 3


def make_config(**changes):
    settings = {
        "heart": "aa", "target": "bb", "space": SPACE.parameters, "initial": 12, "steps": 5,
        "samples": 4, "draws": 3000, "refit_after": 6, "rounds": 4, "seed": 3, "workers": 1,
        "refit_every": 3, "method": "paper", "growth": {"branch_length": 8.0},
        "conduction": {"alpha": 0.05, "anisotropy_ratio": None},
    }  # fmt: skip
    return StudyConfig(**(settings | changes))


def evaluate(point):
    if point.sum() > 1.5:
        return Evaluation.infeasible(point, "left the endocardium")
    loss = 2 + 60 * float(((point - [0.3, 0.7]) ** 2).sum())
    return Evaluation(point, loss, loss + 0.7 * NOISE)


def objective(points):
    return [evaluate(point) for point in points]


def summary(study, population):
    """Everything that must come out the same, bit for bit."""
    records = study.records()
    return (
        [(r.stage, r.evaluation.point.tobytes(), r.evaluation.reason) for r in records],
        [np.float64(r.evaluation.loss).tobytes() for r in records],
        [r.evaluation.beat_errors.tobytes() for r in records],
        population.distances.tobytes(),
        population.losses.tobytes(),
        {name: values.tobytes() for name, values in population.values.items()},
        (population.best, population.best_loss, study.steps(Stage.REJECTION)),
    )


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    study = Study.create_or_resume(tmp_path_factory.mktemp("whole") / "study", make_config())
    return summary(study, study.run(objective))


def test_stages_and_result(tmp_path):
    seen = []
    study = Study.create_or_resume(tmp_path / "s", make_config())
    population = study.run(objective, lambda *news: seen.append(news))
    records = study.records()
    stages = [record.stage for record in records]
    assert stages[:17] == ["initial"] * 12 + ["optimisation"] * 5
    assert set(stages[17:]) == {"rejection"}
    assert len(population) == 4
    found = [r.evaluation for r in records[:17] if r.evaluation.feasible]
    best = min(found, key=lambda e: e.loss)  # of design and optimisation, as in the paper
    assert population.best_loss == best.loss
    assert population.best == SPACE.from_unit(best.point)
    known = {r.evaluation.loss: SPACE.from_unit(r.evaluation.point) for r in records[17:]}
    assert [population.parameters(k) for k in range(4)] == [known[y] for y in population.losses]
    assert {stage for stage, *_ in seen} == {"initial", "optimisation", "draws", "rejection"}
    assert all(0 <= done <= total for _, done, total, _ in seen)
    assert [news[1] for news in seen if news[0] == "optimisation"] == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("calls", [5, 14])
def test_interrupted_study_resumes_to_the_same_bits(tmp_path, uninterrupted, calls):
    done = 0

    def interrupted(points):
        nonlocal done
        if done == calls:
            raise KeyboardInterrupt
        done += 1
        return objective(points)

    study = Study.create_or_resume(tmp_path / "s", make_config())
    with pytest.raises(KeyboardInterrupt):
        study.run(interrupted)
    assert len(study.records()) == calls
    again = 0

    def counting(points):
        nonlocal again
        again += len(points)
        return objective(points)

    resumed = Study.create_or_resume(tmp_path / "s", make_config())
    assert summary(resumed, resumed.run(counting)) == uninterrupted
    assert again == len(uninterrupted[0]) - calls + CHECKED


def test_every_fit_but_the_first_starts_warm(tmp_path, monkeypatch):
    starts = []
    learn = bo_step.Surrogates.learn.__func__

    def spy(cls, observations, before=None):
        learnt = learn(cls, observations, before)
        starts.append((before and before.loss.gp.hyperparameters, learnt.loss.gp.hyperparameters))
        return learnt

    def stop_after_15(points):
        if len(Study.open(tmp_path).records()) == 15:
            raise KeyboardInterrupt
        return objective(points)

    monkeypatch.setattr(bo_step.Surrogates, "learn", classmethod(spy))
    study = Study.create_or_resume(tmp_path, make_config(refit_every=2))
    with pytest.raises(KeyboardInterrupt):
        study.run(stop_after_15)
    study.run(objective)
    assert len(starts) == 3
    assert starts[0][0] is None
    assert [start for start, _ in starts[1:]] == [end for _, end in starts[:-1]]


def test_finished_study_evaluates_nothing_new(tmp_path, uninterrupted):
    study = Study.create_or_resume(tmp_path / "s", make_config())
    study.run(objective)
    asked = []

    def counting(points):
        asked.extend(points)
        return objective(points)

    reopened = Study.open(tmp_path / "s")
    assert summary(reopened, reopened.run(counting)) == uninterrupted
    stored = {record.evaluation.point.tobytes() for record in study.records()}
    assert len(asked) == CHECKED
    assert {point.tobytes() for point in asked} <= stored


def test_batches_are_repeatable(tmp_path):
    config = make_config(workers=3)
    one, two = (Study.create_or_resume(tmp_path / name, config) for name in "ab")
    sizes = []

    def watched(points):
        sizes.append(len(points))
        return objective(points)

    assert summary(one, one.run(watched)) == summary(two, two.run(objective))
    assert sizes[:11] == [3, 3, 3, 3, 1, 1, 1, 1, 1, 3, 3]  # the optimisation's steps are single


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"free_gain": True, "seed": 9}, r"\(seed: there 3, now 9; free_gain: there False, now"),
        (
            {"space": SPACE.parameters[1:], "fixed": {"cv": 2.5}},
            r"\(cv: there learnt \(uniform 2 to 4\), now 2.5\)",
        ),
        (
            {"conduction": {"alpha": 0.07, "anisotropy_ratio": 3.0}},
            r"\(conduction alpha: there 0.05, now 0.07; "
            r"conduction anisotropy_ratio: there none, now 3\)",
        ),
        ({"space": SPACE.parameters[::-1]}, r"\(the order of the parameters\)"),
        (
            {"likelihood": {"name": "Mine"}, "averaged": (free("branch_angle"),)},
            r"\(likelihood name: there none, now Mine; "
            r"branch_angle: there none, now averaged over \(uniform 0.05 to 0.5\)\)",
        ),
        (
            {"initial": 13, "draws": 1, "rounds": 1, "seed": 4, "fixed": {"gain": 2.0}},
            r"\(draws: there 3000, now 1; rounds: there 4, now 1; .*; and 2 more\)",
        ),
    ],
)
def test_other_settings_are_refused(tmp_path, change, message):
    Study.create_or_resume(tmp_path / "s", make_config())
    with pytest.raises(InputError, match=message) as caught:
        Study.create_or_resume(tmp_path / "s", make_config(**change))
    assert "\n" not in str(caught.value)
    assert "choose another folder (out), or give the settings" in str(caught.value)
    assert len(str(caught.value)) < 300 + len(str(tmp_path))


def test_an_infinite_delay_is_read_back(tmp_path):
    config = make_config(fixed={"anterograde_delay": np.inf})
    Study.create_or_resume(tmp_path / "s", config)
    assert Study.create_or_resume(tmp_path / "s", config).config == config
    assert Study.open(tmp_path / "s").config == config


def outcome(population):
    """The result alone, bit for bit."""
    return {name: values.tobytes() for name, values in population.values.items()}, population.best


@pytest.mark.parametrize("change", [{"steps": 8, "samples": 6}, {"steps": 3}, {"samples": 2}])
def test_other_numbers_give_what_they_give_at_once(tmp_path, change):
    Study.create_or_resume(tmp_path / "s", make_config()).run(objective)
    (tmp_path / "s" / "population.nc").write_text("says that the study is finished")
    config = make_config(**change)
    study = Study.create_or_resume(tmp_path / "s", config)
    stored = {record.evaluation.point.tobytes() for record in study.records()}
    asked = []

    def counting(points):
        asked.extend(point.tobytes() for point in points)
        return objective(points)

    found = study.run(counting)
    assert not (tmp_path / "s" / "population.nc").exists()
    assert len(stored.intersection(asked)) == len(asked) - len(set(asked) - stored) == CHECKED
    whole = Study.create_or_resume(tmp_path / "whole", config)
    assert outcome(found) == outcome(whole.run(objective))
    assert Study.open(tmp_path / "s").config == config


def test_more_workers_go_on(tmp_path):
    def stop(points):
        if len(Study.open(tmp_path).records()) == 14:
            raise KeyboardInterrupt
        return objective(points)

    with pytest.raises(KeyboardInterrupt):
        Study.create_or_resume(tmp_path, make_config()).run(stop)
    study = Study.create_or_resume(tmp_path, make_config(workers=3))
    study.run(objective)
    stages = [record.stage for record in study.records()]
    assert stages.count("optimisation") == 5
    assert study.steps(Stage.OPTIMISATION) == 5  # single ones, whatever the workers


def other(points):
    """The objective of another forward model."""
    return [Evaluation(p, 3.0, 3 + NOISE) for p in points]


def test_another_forward_model_is_refused_and_changes_nothing(tmp_path):
    Study.create_or_resume(tmp_path, make_config()).run(objective)
    (tmp_path / "population.nc").write_text("says that the study is finished")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    study = Study.create_or_resume(tmp_path, make_config(steps=8))
    with pytest.raises(InputError, match=r"another forward model .* then, 3 mV² now.*\(out\)"):
        study.run(other)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_foreign_folders_are_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="not a study"):
        Study.create_or_resume(tmp_path, make_config())
    with pytest.raises(InputError, match=r"no study\.json"):
        Study.open(tmp_path)
    with pytest.raises(InputError, match=r"thesis.tex: .*\(out\)"):
        Study.create_or_resume(tmp_path / "thesis.tex", make_config())
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_study_of_another_format_is_refused(tmp_path):
    """Losses of earlier formats are not those of this one."""
    Study.create_or_resume(tmp_path / "s", make_config())
    path = tmp_path / "s" / "study.json"
    path.write_text(path.read_text().replace(f'"version": {STUDY_FORMAT}', '"version": 1'))
    with pytest.raises(InputError, match=r"study\.json: a study of format 1, ") as caught:
        Study.open(tmp_path / "s")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{", '{"heart": "a", "colour": 1}', "\udcff"])
def test_damaged_configuration_is_refused(tmp_path, text):
    (tmp_path / "study.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=r"study\.json") as caught:
        Study.create_or_resume(tmp_path, make_config())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("of", "message"),
    [
        (lambda p: Evaluation.infeasible(p, "bundle left"), r"none of the 12 .*bundle left"),
        (lambda p: Evaluation(p, 1.0, np.ones(1)), "1 beat"),
    ],
)
def test_nothing_to_learn_from_is_refused(tmp_path, of, message):
    study = Study.create_or_resume(tmp_path, make_config())
    with pytest.raises(InputError, match=message):
        study.run(lambda points: [of(p) for p in points])


def test_accepted_lie_in_the_acceptance_region(tmp_path):
    """Accepted samples of a quadratic loss lie in the disc that the distance defines."""
    config = make_config(steps=10, samples=25, draws=20_000, refit_after=50)
    population = Study.create_or_resume(tmp_path, config).run(objective)
    assert len(population) == config.samples
    best = ErrorDensity.fit(population.best_loss + 0.7 * NOISE)
    shifts = np.linspace(0, 5, 2001)
    distances = [total_variation(ErrorDensity.fit(best.errors + s), best) for s in shifts]
    largest = population.best_loss + shifts[np.argmax(np.array(distances) >= 0.9)]
    assert 2.2 < largest < 6
    assert population.losses.max() <= largest


def narrow(points):
    """Beats that hardly vary: uniform draws then miss the acceptance region."""
    outcomes = objective(points)
    return [
        Evaluation(e.point, e.loss, e.loss + 1e-3 * NOISE) if e.feasible else e for e in outcomes
    ]


def test_the_paper_comes_short_where_beats_hardly_vary(tmp_path):
    study = Study.create_or_resume(tmp_path / "s", make_config(rounds=2, draws=500))
    population = study.run(narrow)
    assert len(population) < 4
    assert study.steps(Stage.REJECTION) == 2
    assert {r.stage for r in study.records()} == {"initial", "optimisation", "rejection"}


def test_importing_the_study_loads_no_surrogate():
    heavy = "('scipy.stats', 'fascicle.inference.gaussian_process')"
    code = f"import sys, fascicle.study.study; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_posterior_names_the_constants_of_its_likelihood(default_heart, monkeypatch):
    target = fascicle.make_target(fascicle.read_recording(demo_recording()))

    def named(method):
        return read_inputs(default_heart, target, {}, FitSettings(method=method)).config

    before = named("posterior")
    assert before.likelihood["discrepancy_shares"].split()[0] == "0.1"
    assert [parameter.name for parameter in before.averaged] == [p.name for p in NOT_KNOWN]
    assert not named("paper").likelihood
    monkeypatch.setattr("fascicle.forward.likelihood.SHARES", np.array([0.2, 0.4]))
    with pytest.raises(InputError, match=r"\(likelihood discrepancy_shares: there 0.1 .*, now 0.2"):
        check_same(Path("s"), before, named("posterior"))
