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

NUMBER = 100


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
# Kinds that arguments also take; None is taken where it is the default. A text may be the name of a
# file that is not there.
ALSO = {
    "none": ["analyse choices", "Scenario description", "Scenario reference"],
    "bool": [
        "read_recording shared_gain", "plot.ecg caption", "read_tree file_first", "report pdf"
    ],
    "whole": [
        "simulate_prior networks", "simulate_prior workers", "locate prior_simulations",
        "locate workers", "state_probabilities prior_simulations", "state_probabilities workers",
        "state_probabilities priors",  # the number of a state
        "make_target onset", "make_target offset", "ExecutorPool workers",
        "Conduction anisotropy_ratio", "Conduction endocardial_layer",
        "Conduction endocardial_speed", *(f"Conduction {n}" for n in Conduction.conductivities),
        "ForwardModel.activate root_time", "ForwardModel.activate cv",
    ],
    "number": ["make_target onset", "make_target offset", "ForwardModel.activate root_time"],
    "pair": ["ForwardModel.activate root_time"],
    "text": [
        "fit out", "report out", "read_tree side", "Scenario source", "Scenario description",
        "Scenario reference",
    ],
    "nul": ["Scenario source", "Scenario description", "Scenario reference"],
    "heart": [
        "explore source", "ForwardModel heart", "simulate_prior heart", "locate heart", "fit heart",
        "ventricular_coordinates heart", "state_probabilities heart", "plot.activation heart",
        "plot.heart heart", "plot.beat heart", "plot.activation_spread heart",
    ],
}  # fmt: skip
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
    """Arguments that each public function takes."""
    simulation, values = study.best_network.beat, fascicle.EXAMPLE_PARAMETERS
    simulation.trees[0].save(tree_file := tmp_path_factory.mktemp("trees") / "lv.vtu")
    fitted, target = {"fitted": study}, study.recordings[0].target
    of_two = {"predicted": predicted, "name": "left-bundle-branch-pacing"}
    pacing = predicted["left-bundle-branch-pacing"]
    heart, hearts = {"heart": default_heart}, {"heart": default_heart, "other": default_heart}
    pool = ThreadPoolExecutor(1)
    cell = fascicle.CellModel("none", lambda *given: None, (0.0,), ())
    site = {"ventricle": "lv", "apicobasal": 0.5, "rotational": 0.5, "transmural": 0.5}
    return {
        "outside_allowed": {}, "Scenario": {}, "Conduction": {},
        "explore": {"source": default_heart},
        "example_parameters": {"model": default_model},
        "ForwardModel": heart,
        "ForwardModel.simulate": {"parameters": values},
        "ForwardModel.activate": {"trees": default_model.grow(values), "root_time": 0.0, "cv": 3.0},
        "ForwardModel.simulate_many": {"parameters": [values], "executor": pool},
        "ForwardModel.grow": {"parameters": values},
        "read_scenarios": {"names": ["his-pacing"]},
        "ventricular_coordinates": heart,
        "CoordinateSite": site,
        "transfer_map": hearts | {"values": np.zeros(3)},
        "load_heart": {"path": "default"},
        "compare": {"first": pacing, "second": pacing, "index": "qrs_area"},
        "predict": fitted | {"scenarios": {}},
        "analyse": {"recording": recording},
        "make_target": {"recording": recording},
        "read_recording": {"path": demo_recording()},
        "cell_action_potential": {"cell": cell},
        "read_action_potential": {"path": "u.csv"},
        "read_tree": {"path": tree_file, "side": "lv"},
        "read_target": {"path": study.folder / "target.nc"},
        "report": fitted,
        "simulate_prior": heart,
        "Cluster": {"address": "tcp://localhost:1"},
        "GpuBackend": {"device": "cuda"},
        "cohort": {"table": "patients.csv", "out": "new"},
        "ExecutorPool": {"executor": pool, "workers": 1},
        "fit": heart | {"target": target, "out": "new"},
        "locate": heart | {"target": target},
        "state_probabilities": heart | {"target": target},
        "load_study": {"folder": study.folder},
        "plot.heart": heart,
        "plot.tree": {"tree": simulation.trees[0]},
        "plot.beat": {"beat": simulation},
        "plot.prediction": {"predicted": pacing},
        "plot.scenario_ecg": of_two,
        "plot.activation": {"heart": study} | of_two,
        "plot.activation_spread": {"heart": study, "predicted": predicted},
        "plot.indices": {"predicted": predicted},
        "plot.ecg": fitted, "plot.pairs": fitted, "plot.priors": fitted, "plot.convergence": fitted,
        "plot.target": {"target": target},
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
    right, name, default_heart, default_model, monkeypatch, tmp_path
):
    """Before any work has begun, and so that the line says what was given."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fascicle.study.inputs.ForwardModel", begun)
    monkeypatch.setattr("fascicle.explorer.explore.serve", begun)
    for module in ("heart_emulator", "origin", "state_classifier"):
        monkeypatch.setattr(f"fascicle.emulation.{module}.ForwardModel", begun)
    where, _, own_name = name.rpartition(".")
    owner = {"": fascicle, "plot": fascicle.plot, "ForwardModel": default_model}[where]
    function, arguments = getattr(owner, own_name), right[name]
    failures = []
    for argument, known in inspect.signature(function).parameters.items():
        if known.kind is known.VAR_KEYWORD:
            continue
        taken = {kind for kind, places in ALSO.items() if f"{name} {argument}" in places}
        taken |= {"none"} if known.default in (None, "lines") else set()
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
    one, other = (
        pixels(plot.activation_spread(heart, predicted))
        for heart in (study, f"{study.folder}/heart")
    )
    np.testing.assert_array_equal(one, other)
    assert len(plot.target(study.folder / "target.nc")) == 12
    # it takes seconds each time
    read = {study.folder: study}
    monkeypatch.setattr("fascicle.study.fitted.load_study", lambda folder, _: read[folder])
    assert len(plot.activation_spread(study.folder, predicted)) > 4
    for draw in (plot.ecg, plot.pairs, plot.priors, plot.convergence):
        assert len(draw(study.folder)) == len(draw(study))
    pyplot.close("all")


def pixels(axes):
    """The picture that a figure is."""
    canvas = axes[0].figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def test_figures_are_drawn_into_the_user_s_axes_and_saved(study, tmp_path):
    drawn = pixels(fascicle.plot.convergence(study))
    assert len(pyplot.get_fignums()) == 1
    pyplot.savefig(tmp_path / "drawn.png", dpi=300)  # 100 in tests (`coarse_pictures`)
    pyplot.close("all")
    assert drawn.std() > 10, "the picture is blank"
    saved = 255 * pyplot.imread(tmp_path / "drawn.png")
    assert np.abs(saved - drawn).mean() < 1
    figure, (left, right) = pyplot.subplots(1, 2)
    assert fascicle.plot.convergence(study, ax=right) == [right]
    assert right.get_ylabel() == "loss (mV²)"
    assert not left.lines
    assert pyplot.get_fignums() == [figure.number]
    pyplot.close("all")


def test_studies_and_predictions_copy_themselves_and_say_what_they_are(study, tmp_path, predicted):
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


def test_another_heart_than_that_of_the_predictions_is_refused(predicted):
    with pytest.raises(InputError, match="has 27 vertices, 'intrinsic' was predicted on one of 15"):
        fascicle.plot.activation(box(10, 2), predicted, "left-bundle-branch-pacing")
