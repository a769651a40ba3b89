"""A study survives interruption and refuses to be mixed with another."""

import shutil
from dataclasses import replace
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
from fascicle.study.study import STUDY_FORMAT, Study, StudyConfig, check_same

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


class Counting:
    """The objective, which remembers what it was asked, and is interrupted after some calls."""

    def __init__(self, calls=np.inf):
        self.calls, self.batches = calls, []

    def __call__(self, points):
        if len(self.batches) == self.calls:
            raise KeyboardInterrupt
        self.batches.append(points)
        return objective(points)

    @property
    def points(self):
        return [point.tobytes() for batch in self.batches for point in batch]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A finished study, its result, and what was reported of it."""
    seen = []
    study = Study.create_or_resume(tmp_path_factory.mktemp("whole") / "study", make_config())
    return study, study.run(objective, lambda *news: seen.append(news)), seen


@pytest.fixture(scope="module")
def uninterrupted(done):
    return summary(*done[:2])


@pytest.fixture
def copied(done, tmp_path):
    """Folder of a copy of the finished study."""
    shutil.copytree(done[0].folder, tmp_path / "s")
    (tmp_path / "s" / "population.nc").write_text("says that the study is finished")
    return tmp_path / "s"


def test_stages_and_result(done):
    study, population, seen = done
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
    study, again = Study.create_or_resume(tmp_path / "s", make_config()), Counting()
    with pytest.raises(KeyboardInterrupt):
        study.run(Counting(calls))
    assert len(study.records()) == calls
    resumed = Study.create_or_resume(tmp_path / "s", make_config())
    assert summary(resumed, resumed.run(again)) == uninterrupted
    assert len(again.points) == len(uninterrupted[0]) - calls + Study.checked


def test_every_fit_but_the_first_starts_warm(tmp_path, monkeypatch):
    starts = []
    learn = bo_step.Surrogates.learn.__func__

    def spy(cls, observations, before=None):
        learnt = learn(cls, observations, before)
        starts.append((before and before.loss.gp.hyperparameters, learnt.loss.gp.hyperparameters))
        return learnt

    monkeypatch.setattr(bo_step.Surrogates, "learn", classmethod(spy))
    study = Study.create_or_resume(tmp_path, make_config(refit_every=2))
    with pytest.raises(KeyboardInterrupt):
        study.run(Counting(15))
    study.run(objective)
    assert len(starts) == 3
    assert starts[0][0] is None
    assert [start for start, _ in starts[1:]] == [end for _, end in starts[:-1]]


def test_finished_study_evaluates_nothing_new_and_refuses_another_model(copied, uninterrupted):
    reopened, again = Study.open(copied), Counting()
    assert summary(reopened, reopened.run(again)) == uninterrupted
    stored = {record.evaluation.point.tobytes() for record in reopened.records()}
    assert len(again.points) == Study.checked
    assert {*again.points} <= stored
    before = {path.name: path.read_bytes() for path in copied.iterdir()}
    study = Study.create_or_resume(copied, make_config(steps=8))
    with pytest.raises(InputError, match=r"another forward model .* then, 3 mV² now.*\(out\)"):
        study.run(lambda points: [Evaluation(p, 3.0, 3 + NOISE) for p in points])
    assert {path.name: path.read_bytes() for path in copied.iterdir()} == before


def test_batches_are_repeatable(tmp_path):
    config = make_config(workers=3)
    one, two = (Study.create_or_resume(tmp_path / name, config) for name in "ab")
    watched = Counting()
    assert summary(one, one.run(watched)) == summary(two, two.run(objective))
    sizes = [len(batch) for batch in watched.batches]
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


def test_configurations_are_read_back_and_foreign_folders_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="not a study"):
        Study.create_or_resume(tmp_path, make_config())
    with pytest.raises(InputError, match=r"no study\.json"):
        Study.open(tmp_path)
    with pytest.raises(InputError, match=r"thesis.tex: .*\(out\)"):
        Study.create_or_resume(tmp_path / "thesis.tex", make_config())
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    config = make_config(fixed={"anterograde_delay": np.inf})
    Study.create_or_resume(tmp_path / "s", config)
    assert Study.create_or_resume(tmp_path / "s", config).config == config
    assert Study.open(tmp_path / "s").config == config


def outcome(population):
    """The result alone, bit for bit."""
    return {name: values.tobytes() for name, values in population.values.items()}, population.best


@pytest.mark.parametrize("change", [{"steps": 8, "samples": 6}, {"steps": 3}, {"samples": 2}])
def test_other_numbers_give_what_they_give_at_once(copied, tmp_path, change):
    config, again = make_config(**change), Counting()
    study = Study.create_or_resume(copied, config)
    stored = {record.evaluation.point.tobytes() for record in study.records()}
    found, asked = study.run(again), again.points
    assert not (copied / "population.nc").exists()
    assert len(stored.intersection(asked)) == len(asked) - len(set(asked) - stored) == Study.checked
    whole = Study.create_or_resume(tmp_path / "whole", config)
    assert outcome(found) == outcome(whole.run(objective))
    assert Study.open(copied).config == config


def test_more_workers_go_on(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        Study.create_or_resume(tmp_path, make_config()).run(Counting(14))
    study = Study.create_or_resume(tmp_path, make_config(workers=3))
    study.run(objective)
    stages = [record.stage for record in study.records()]
    assert stages.count("optimisation") == 5
    assert study.steps(Stage.OPTIMISATION) == 5  # single ones, whatever the workers


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("\udcff", "not JSON"),
        ('{"heart": "a", "colour": 1}', "not a configuration that this version reads"),
        # losses of earlier formats are not those of this one
        (make_config().model_dump_json().replace(f":{STUDY_FORMAT}}}", ":1}"), "a study of format"),
    ],
)
def test_configurations_that_are_refused(tmp_path, text, message):
    (tmp_path / "study.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=rf"study\.json: {message}") as caught:
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


def test_the_paper_comes_short_where_beats_hardly_vary(tmp_path):
    """Uniform draws then miss the acceptance region."""

    def narrow(points):
        return [
            replace(e, beat_errors=e.loss + 1e-3 * NOISE) if e.feasible else e
            for e in objective(points)
        ]

    study = Study.create_or_resume(tmp_path / "s", make_config(rounds=2, draws=500))
    population = study.run(narrow)
    assert len(population) < 4
    assert study.steps(Stage.REJECTION) == 2
    assert {r.stage for r in study.records()} == {"initial", "optimisation", "rejection"}


def test_a_posterior_names_the_constants_of_its_likelihood(default_heart, monkeypatch):
    target = fascicle.make_target(fascicle.read_recording(demo_recording()))

    def named(method):
        return read_inputs(default_heart, target, {}, FitSettings(method=method)).config

    before = named("posterior")
    assert before.likelihood["discrepancy_shares"].split()[0] == "0.1"
    assert [parameter.name for parameter in before.averaged] == [p.name for p in NOT_KNOWN]
    assert not named("paper").likelihood
    monkeypatch.setattr("fascicle.forward.likelihood.QrsLikelihood.shares", np.array([0.2, 0.4]))
    with pytest.raises(InputError, match=r"\(likelihood discrepancy_shares: there 0.1 .*, now 0.2"):
        check_same(Path("s"), before, named("posterior"))
