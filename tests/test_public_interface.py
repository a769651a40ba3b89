"""Whatever the public interface is given: an answer, or one line of an InputError."""

from __future__ import annotations

import inspect
import re
from concurrent.futures import ThreadPoolExecutor
from html import escape
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

import fascicle
from benchmarks.fits import demo_recording
from benchmarks.fuzzing.attempts import outcomes
from benchmarks.fuzzing.calls import CALLS
from fascicle.core.errors import InputError
from fascicle.heart.conduction import Conduction
from tests.builders import box

NUMBER = 250


@pytest.mark.parametrize("name", CALLS)
def test_an_answer_or_one_line(name, monkeypatch, tmp_path):
    """`python -m benchmarks.fuzzing` does the same with 20,000 calls of each."""
    monkeypatch.chdir(tmp_path)
    found = list(outcomes(name, range(NUMBER), tmp_path))
    assert [each for each in found if each.failure] == []
    assert sum(bool(each.message) for each in found) > 10


# One object of every kind, by a name of the kind, to be given to arguments that take others
WRONG: dict[str, Any] = {
    "none": None, "bool": True, "whole": 3, "number": -1.5, "text": "nonsense", "nul": "a\0b",
    "bytes": b"lv", "pair": (1.0, 2.0), "list": [object()], "mapping": {1: 2},
    "array": np.zeros(3), "object": object(), "heart": Ellipsis,  # the packaged heart
}  # fmt: skip
# What the arguments of a function also take; None is taken where it is the default. A text may be
# the name of a file that is not there.
ALSO = {
    ("explore", "source"): {"heart"},
    ("ForwardModel", "heart"): {"heart"},
    ("simulate_prior", "heart"): {"heart"},
    ("ventricular_coordinates", "heart"): {"heart"},
    ("read_recording", "shared_gain"): {"bool"},
    ("simulate_prior", "networks"): {"whole"},
    ("simulate_prior", "workers"): {"whole"},
    ("locate", "heart"): {"heart"},
    ("locate", "prior_simulations"): {"whole"},
    ("locate", "workers"): {"whole"},
    ("state_probabilities", "heart"): {"heart"},
    ("state_probabilities", "priors"): {"whole"},  # the number of a state
    ("state_probabilities", "prior_simulations"): {"whole"},
    ("state_probabilities", "workers"): {"whole"},
    ("fit", "heart"): {"heart"},
    ("fit", "out"): {"text"},
    ("report", "out"): {"text"},
    ("analyse", "choices"): {"none"},
    ("make_target", "onset"): {"whole", "number"},
    ("make_target", "offset"): {"whole", "number"},
    ("ExecutorPool", "workers"): {"whole"},
    ("Conduction", "anisotropy_ratio"): {"whole"},
    ("Conduction", "endocardial_layer"): {"whole"},
    ("Conduction", "endocardial_speed"): {"whole"},
    **{("Conduction", name): {"whole"} for name in Conduction.conductivities},
    ("plot.activation", "heart"): {"heart"},
    ("plot.heart", "heart"): {"heart"},
    ("plot.beat", "heart"): {"heart"},
    ("plot.ecg", "caption"): {"bool"},
    ("read_tree", "side"): {"text"},
    ("read_tree", "file_first"): {"bool"},
    ("plot.activation_spread", "heart"): {"heart"},
    ("Scenario", "source"): {"text", "nul"},
    ("Scenario", "description"): {"none", "text", "nul"},
    ("Scenario", "reference"): {"none", "text", "nul"},
    ("ForwardModel.activate", "root_time"): {"whole", "number", "pair"},
    ("ForwardModel.activate", "cv"): {"whole"},
}
# Of the numbers and texts of these `test_an_answer_or_one_line` tries more
TRIED_ABOVE = {
    "Stimulus", "SlowConduction", "InactiveRoot", "JunctionDelays", "His", "Region", "GrowthRules",
    "TargetOptions", "FitSettings",
    "GrowthTerm", "Quantity", "CellModel",  # made by programmers, as docs/extending.md shows
}  # fmt: skip
# What the program itself makes, and what it raises
MADE = {
    "Beat", "Comparison", "Excitation", "FittedStudy", "Heart", "InputError", "Infeasible",
    "NoStateNamed", "Origin", "Predicted", "Primitive", "PurkinjeTree", "Replicate",
}  # fmt: skip


@pytest.fixture(scope="module")
def recording():
    return fascicle.read_recording(demo_recording())


@pytest.fixture(scope="module")
def study(recording, tmp_path_factory):
    """A study of two networks."""
    folder = tmp_path_factory.mktemp("studies") / "study"
    small = {"initial": 4, "steps": 1, "samples": 2, "draws": 100, "rounds": 1, "workers": 1}
    found = fascicle.fit(
        "default", fascicle.make_target(recording), folder, method="paper", **small
    )
    assert len(found.population)
    return found


@pytest.fixture(scope="module")
def predicted(study):
    return fascicle.predict(study, "left-bundle-branch-pacing")


@pytest.fixture(scope="module")
def right(study, predicted, recording, default_heart, default_model, tmp_path_factory):
    """Every public function, with arguments that it takes."""
    simulation = study.best_network.beat
    simulation.trees[0].save(tree_file := tmp_path_factory.mktemp("trees") / "lv.vtu")
    fitted, target, plot = {"fitted": study}, study.recordings[0].target, fascicle.plot
    of_two = {"predicted": predicted, "name": "left-bundle-branch-pacing"}
    pacing = predicted["left-bundle-branch-pacing"]
    return {
        "outside_allowed": (fascicle.outside_allowed, {}),
        "explore": (fascicle.explore, {"source": default_heart}),
        "example_parameters": (fascicle.example_parameters, {"model": default_model}),
        "ForwardModel": (fascicle.ForwardModel, {"heart": default_heart}),
        "ForwardModel.simulate": (
            default_model.simulate, {"parameters": fascicle.EXAMPLE_PARAMETERS},
        ),
        "ForwardModel.activate": (
            default_model.activate,
            {"trees": default_model.grow(fascicle.EXAMPLE_PARAMETERS), "root_time": 0.0, "cv": 3.0},
        ),
        "ForwardModel.simulate_many": (
            default_model.simulate_many,
            {"parameters": [fascicle.EXAMPLE_PARAMETERS], "executor": ThreadPoolExecutor(1)},
        ),
        "ForwardModel.grow": (default_model.grow, {"parameters": fascicle.EXAMPLE_PARAMETERS}),
        "Scenario": (fascicle.Scenario, {}),
        "Conduction": (fascicle.Conduction, {}),
        "read_scenarios": (fascicle.read_scenarios, {"names": ["his-pacing"]}),
        "ventricular_coordinates": (fascicle.ventricular_coordinates, {"heart": default_heart}),
        "CoordinateSite": (
            fascicle.CoordinateSite,
            {"ventricle": "lv", "apicobasal": 0.5, "rotational": 0.5, "transmural": 0.5},
        ),
        "transfer_map": (
            fascicle.transfer_map,
            {"values": np.zeros(3), "heart": default_heart, "other": default_heart},
        ),
        "load_heart": (fascicle.load_heart, {"path": "default"}),
        "compare": (
            fascicle.compare, {"first": pacing, "second": pacing, "index": "qrs_area"},
        ),
        "predict": (fascicle.predict, fitted | {"scenarios": {}}),
        "analyse": (fascicle.analyse, {"recording": recording}),
        "make_target": (fascicle.make_target, {"recording": recording}),
        "read_recording": (fascicle.read_recording, {"path": demo_recording()}),
        "cell_action_potential": (
            fascicle.cell_action_potential,
            {"cell": fascicle.CellModel("none", lambda *given: None, (0.0,), ())},
        ),
        "read_action_potential": (fascicle.read_action_potential, {"path": "u.csv"}),
        "read_tree": (fascicle.read_tree, {"path": tree_file, "side": "lv"}),
        "read_target": (fascicle.read_target, {"path": study.folder / "target.nc"}),
        "report": (fascicle.report, dict(fitted)),
        "simulate_prior": (fascicle.simulate_prior, {"heart": default_heart}),
        "Cluster": (fascicle.Cluster, {"address": "tcp://localhost:1"}),
        "GpuBackend": (fascicle.GpuBackend, {"device": "cuda"}),
        "cohort": (fascicle.cohort, {"table": "patients.csv", "out": "new"}),
        "ExecutorPool": (fascicle.ExecutorPool, {"executor": ThreadPoolExecutor(1), "workers": 1}),
        "fit": (fascicle.fit, {"heart": default_heart, "target": target, "out": "new"}),
        "locate": (fascicle.locate, {"heart": default_heart, "target": target}),
        "state_probabilities": (
            fascicle.state_probabilities, {"heart": default_heart, "target": target},
        ),
        "load_study": (fascicle.load_study, {"folder": study.folder}),
        "plot.heart": (plot.heart, {"heart": default_heart}),
        "plot.tree": (plot.tree, {"tree": fascicle.read_tree(tree_file, "lv")}),
        "plot.beat": (plot.beat, {"beat": simulation}),
        "plot.prediction": (plot.prediction, {"predicted": pacing}),
        "plot.ecg": (plot.ecg, dict(fitted)),
        "plot.scenario_ecg": (plot.scenario_ecg, of_two),
        "plot.activation": (plot.activation, {"heart": study} | of_two),
        "plot.activation_spread": (
            plot.activation_spread, {"heart": study, "predicted": predicted},
        ),
        "plot.indices": (plot.indices, {"predicted": predicted}),
        "plot.pairs": (plot.pairs, fitted),
        "plot.priors": (plot.priors, fitted),
        "plot.convergence": (plot.convergence, fitted),
        "plot.target": (plot.target, {"target": target}),
    }  # fmt: skip


def begun(*given: Any, **named: Any) -> Any:
    raise AssertionError("the work has begun")


PUBLIC = {name for name in fascicle.__all__ if callable(getattr(fascicle, name))}
PLOTS = {
    f"plot.{name}" for name, known in vars(fascicle.plot).items()
    if inspect.isfunction(known) and known.__module__ == "fascicle.plot" and name[0] != "_"
}  # fmt: skip
METHODS = {f"ForwardModel.{name}" for name in ("simulate", "activate", "simulate_many", "grow")}


@pytest.mark.parametrize("name", sorted((PUBLIC | PLOTS | METHODS) - TRIED_ABOVE - MADE))
def test_an_argument_of_the_wrong_kind_is_refused_in_one_line(
    right, name, default_heart, monkeypatch, tmp_path
):
    """Before any work has begun, and so that the line says what was given."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fascicle.study.inputs.ForwardModel", begun)
    monkeypatch.setattr("fascicle.explorer.explore.serve", begun)
    for module in ("heart_emulator", "origin", "state_classifier"):
        monkeypatch.setattr(f"fascicle.emulation.{module}.ForwardModel", begun)
    function, arguments = right[name]
    failures = []
    for argument, known in inspect.signature(function).parameters.items():
        if known.kind is known.VAR_KEYWORD:
            continue
        taken = ALSO.get((name, argument), set())
        taken = taken | ({"none"} if known.default in (None, "lines") else set())
        for kind, value in WRONG.items():
            if kind in taken:
                continue
            given = arguments | {argument: default_heart if kind == "heart" else value}
            try:
                function(**given)
            except InputError as error:
                if not str(error).isprintable() or len(str(error)) > 1000:
                    failures.append(f"{argument}, {kind}: no line: {str(error)[:200]!r}")
            except Exception as error:  # noqa: BLE001 - that there is none is what is tested
                failures.append(f"{argument}, {kind}: {type(error).__name__}: {error!s:.120}")
            else:
                failures.append(f"{argument}, {kind}: taken")
    assert not failures, "\n".join(failures)


def test_a_study_may_be_given_by_its_folder(study, predicted, monkeypatch):
    """The folder of a heart, too, where the heart of a study is taken."""
    again = fascicle.predict(str(study.folder), "left-bundle-branch-pacing")
    for name, found in predicted.items():
        np.testing.assert_array_equal(again[name].indices["qrs_area"], found.indices["qrs_area"])
    plot = fascicle.plot
    hearts = study, study.folder, f"{study.folder}/heart"
    first, *others = (pixels(plot.activation_spread(heart, predicted)) for heart in hearts)
    for picture in others:
        np.testing.assert_array_equal(picture, first)
    assert len(plot.target(study.folder / "target.nc")) == 12
    # it takes seconds each time
    read = {study.folder: study}
    monkeypatch.setattr("fascicle.study.fitted.load_study", lambda folder, _: read[folder])
    for draw in (plot.ecg, plot.pairs, plot.priors, plot.convergence):
        assert len(draw(study.folder)) == len(draw(study))
    pyplot.close("all")


def pixels(axes):
    """The picture that a figure is."""
    canvas = axes[0].figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def test_pyplot_saves_the_figure_that_was_drawn_last(study, tmp_path):
    drawn = pixels(fascicle.plot.convergence(study))
    assert len(pyplot.get_fignums()) == 1
    pyplot.savefig(tmp_path / "drawn.png")
    pyplot.close("all")
    assert drawn.std() > 10, "the picture is blank"
    saved = 255 * pyplot.imread(tmp_path / "drawn.png")
    assert np.abs(saved - drawn).mean() < 1


def test_a_study_copies_itself_and_says_what_it_is(study, tmp_path):
    study.save(tmp_path / "copy")
    again = fascicle.load_study(tmp_path / "copy")
    assert again.folder == tmp_path / "copy"
    for name, values in study.population.values.items():
        np.testing.assert_array_equal(again.population.values[name], values)
    card = study._repr_html_()
    assert escape(study.verdict) in card
    assert "conduction velocity (m/s)" in card
    draws = {name: values[:1] for name, values in study.population.values.items()}
    with pytest.raises(InputError, match="draws of your own"):
        study.with_draws(draws).save(tmp_path / "draws")


def test_a_prediction_says_what_it_is(predicted, tmp_path):
    found = predicted["left-bundle-branch-pacing"]
    table = found.index_table()
    assert list(table["qrs_area_µVs"]) == list(found.indices["qrs_area"])
    assert "latest_segment" in table
    found.save(tmp_path / "indices.csv")
    again = pd.read_csv(tmp_path / "indices.csv", index_col="network")
    pd.testing.assert_frame_equal(again, table)
    median = f"{np.median(found.indices['qrs_area']):.4g}"
    assert re.search(rf"QRS area \(µVs\)</th><td[^>]*>{median} ", found._repr_html_())
    assert len(found.plot()) == 12
    pyplot.close("all")


def test_a_caption_stands_below_only_where_it_is_asked_for(study):
    for caption in (False, True):
        (text,) = {axes.figure.get_supxlabel() for axes in study.plot(caption=caption)}
        assert ("of the variance" in text) == caption
    pyplot.close("all")


def test_convergence_is_drawn_into_the_user_s_axes(study):
    figure, (left, right) = pyplot.subplots(1, 2)
    assert fascicle.plot.convergence(study, ax=right) == [right]
    assert right.get_ylabel() == "loss (mV²)"
    assert not left.lines
    assert pyplot.get_fignums() == [figure.number]
    pyplot.close("all")


def test_another_heart_than_that_of_the_predictions_is_refused(predicted):
    with pytest.raises(InputError, match="has 27 vertices, 'intrinsic' was predicted on one of 15"):
        fascicle.plot.activation(box(10, 2), predicted, "left-bundle-branch-pacing")
