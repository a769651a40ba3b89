"""Objects that hold arrays are shown on one short line."""

from __future__ import annotations

import numpy as np
import pytest
from pydicom.data import get_testdata_file

import fascicle
from fascicle.core.parameters import EXAMPLE_PARAMETERS


@pytest.fixture(scope="module")
def objects(default_model, default_heart):
    simulation = default_model.simulate(EXAMPLE_PARAMETERS)
    recording = fascicle.read_recording(get_testdata_file("waveform_ecg.dcm", download=False))
    analysis = fascicle.analyse(recording)
    return {
        "heart": default_heart, "endocardium": default_heart.lv, "model": default_model,
        "simulation": simulation, "tree": simulation.trees[0], "recording": recording,
        "analysis": analysis, "target": analysis.target,
    }  # fmt: skip


@pytest.mark.parametrize(
    "name",
    ["heart", "endocardium", "model", "simulation", "tree", "recording", "analysis", "target"],
)
def test_one_line_without_arrays(objects, name):
    text = repr(objects[name])
    assert "\n" not in text
    assert "array" not in text
    assert len(text) < 300
    assert text.startswith(type(objects[name]).__name__)


def test_numbers_and_shapes_are_shown(objects):
    target = objects["target"]
    text = repr(target)
    assert " × ".join(map(str, target.beats.shape)) in text
    assert f"qrs_onset={target.qrs_onset:.4g}" in text
    comparison = fascicle.Comparison("qrs_duration", "ms", np.zeros(7), 7.0)
    assert repr(comparison) == ("Comparison(index='qrs_duration', unit='ms', gains=7, effective=7)")
