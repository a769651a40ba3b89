import numpy as np
import pytest

from fascicle.core.parameters import NETWORK_SPACE, Parameter, ParameterSpace
from fascicle.reporting.names import MEASURES, index_name, on_narrow_axis, parameter_name
from fascicle.reporting.pairs import pair_figure
from fascicle.reporting.priors import prior_figure

SPACE = ParameterSpace(
    (
        Parameter("lv_initial_length", "mm", 30.0, 100.0),
        Parameter("rv_fascicle_angle_1", "rad", -0.5, 1.5),
        Parameter("cv", "mm/ms", 2.0, 4.0),
        Parameter("gain", "1", 0.5, 2.0),
    )
)


@pytest.mark.parametrize(
    ("index", "name"),
    [
        ("qrs_duration", "window QRS duration"),
        ("global_qrs_duration", "global QRS duration"),
        ("lv_rv_delay", "LV-RV delay"),
        ("total_activation_time", "total activation time"),
        ("rv_activation_time", "RV activation time"),
        ("v6_v1_interpeak_interval", "V6 V1 interpeak interval"),
    ],
)
def test_names_of_indices(index, name):
    assert index_name(index) == name


def test_names_of_parameters_are_distinct_and_fit_a_narrow_axis():
    names = {parameter_name(name) for name in NETWORK_SPACE.names}
    assert {"LV bundle length", "RV fascicle\N{NO-BREAK SPACE}2 angle", "tree speed"} < names
    assert len(names) == len(NETWORK_SPACE)
    lines = [line for name in names for line in on_narrow_axis(name).split("\n")]
    assert max(map(len, lines)) <= 10
    assert parameter_name("anisotropy_ratio") == "anisotropy ratio"
    assert parameter_name("v1_left") == "V1 left"


def test_every_figure_calls_a_parameter_the_same():
    """Words of the names, whatever the lines they stand on."""
    values = {p.name: p.from_unit(np.linspace(0.1, 0.9, 30)) for p in SPACE.parameters}
    best = {name: value[0] for name, value in values.items()}
    pairs = pair_figure(SPACE, values, best).axes[-4:]
    priors = prior_figure(SPACE, values).axes
    called = [[" ".join(axes.get_xlabel().split()) for axes in row] for row in (pairs, priors)]
    expected = ["LV bundle length (mm)", "RV fascicle 1 angle (rad)", "tree speed (mm/ms)", "gain"]
    assert called == [expected, expected]


def test_measures_and_indices_have_one_name():
    assert MEASURES["qrs_duration_ms"].name == index_name("qrs_duration")
    assert str(MEASURES["axis_degrees"]) == "frontal axis"
    assert "as clinics measure it" in str(MEASURES["global_qrs_duration_ms"])
