"""Figures of parameters: pairs, priors, and how a fit went."""

from itertools import pairwise

import numpy as np
import pytest

from fascicle.core.parameters import HUMAN_SPACE, NETWORK_SPACE, Parameter, ParameterSpace
from fascicle.core.quantities import parameter_name
from fascicle.reporting.names import MEASURES, index_name
from fascicle.reporting.parameters import draw_convergence, pair_figure, prior_figure
from fascicle.reporting.style import one_axes

SPACE = ParameterSpace(
    (
        Parameter("lv_initial_length", "mm", 30.0, 100.0),
        Parameter("rv_fascicle_angle_1", "rad", -0.5, 1.5),
        Parameter("cv", "mm/ms", 2.0, 4.0),
        Parameter("gain", "1", 0.5, 2.0, "log-normal", median=1.0, sd=0.3),
    )
)
BEST = {"lv_initial_length": 50.0, "rv_fascicle_angle_1": 0.0, "cv": 2.5, "gain": 1.0}
LOSSES = np.array([np.nan, 0.8, 0.3, 0.5, np.nan, 0.1, 0.2])
STAGES = ["initial"] * 3 + ["optimisation"] * 3 + ["rejection"]


@pytest.mark.parametrize(
    ("index", "name"),
    [
        ("qrs_duration", "QRS duration"),
        ("lv_rv_delay", "LV-RV delay"),
        ("v6_v1_interpeak_interval", "V6 V1 interpeak interval"),
    ],
)
def test_names_of_indices(index, name):
    assert index_name(index) == name


def test_names_of_parameters_and_measures():
    every = {*NETWORK_SPACE.names, *HUMAN_SPACE.names}
    names = {parameter_name(name) for name in every}
    assert len(names) == len(every)
    assert {
        "LV bundle length", "RV fascicle\N{NO-BREAK SPACE}2 angle", "Purkinje conduction velocity",
        "delay between the roots",
    } < names  # fmt: skip
    assert parameter_name("anisotropy_ratio") == "anisotropy ratio"
    assert parameter_name("v1_left") == "V1 left"
    assert MEASURES["axis_degrees"].name == "frontal axis"


def samples(count=30):
    unit = np.random.default_rng(3).uniform(0.4, 0.6, (count, len(SPACE)))
    return {p.name: p.from_unit(share) for p, share in zip(SPACE.parameters, unit.T, strict=True)}


def panel(figure, row, column):
    return figure.axes[row * (row + 1) // 2 + column]


def test_pairs_are_on_the_whole_prior_and_mark_best_and_truth():
    values, truth = samples(), {name: 1.1 * value for name, value in BEST.items()}
    figure = pair_figure(SPACE, values, BEST, truth)
    assert len(figure.axes) == 10
    for row, y in enumerate(SPACE.parameters):
        for column, x in enumerate(SPACE.parameters[:row]):
            axes = panel(figure, row, column)
            assert axes.get_xlim() == (x.lower, x.upper)
            assert axes.get_ylim() == (y.lower, y.upper)
            offsets = axes.collections[0].get_offsets()
            np.testing.assert_array_equal(offsets.T, [values[x.name], values[y.name]])
            marks = [(line.get_xdata()[0], line.get_ydata()[0]) for line in axes.lines]
            assert marks == [(point[x.name], point[y.name]) for point in (BEST, truth)]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == [
        "network (30)", "density of networks", "prior density", "best fit", "truth",
    ]  # fmt: skip


def test_diagonal_is_a_density_over_the_range_against_the_prior():
    figure = pair_figure(SPACE, samples(400), BEST)
    for index, parameter in enumerate(SPACE.parameters[:3]):
        axes = panel(figure, index, index)
        density, edges, _ = axes.patches[0].get_data()
        assert (edges[0], edges[-1]) == (parameter.lower, parameter.upper)
        assert np.sum(density * np.diff(edges)) == pytest.approx(1.0)
        prior = axes.lines[0].get_ydata()[0]
        assert prior == pytest.approx(1 / (parameter.upper - parameter.lower))
        assert density.max() > 3 * prior  # contracted fivefold
        assert axes.get_ylim()[1] > density.max()


def test_every_figure_calls_a_parameter_the_same():
    """Words of the names with their units, whatever the lines they stand on."""
    pairs, priors = (
        pair_figure(SPACE, samples(), BEST).axes[-4:],
        prior_figure(SPACE, samples()).axes,
    )
    expected = [
        "LV bundle length (mm)", "RV fascicle 1 angle (rad)", "Purkinje conduction velocity (m/s)",
        "gain",
    ]  # fmt: skip
    for row in (pairs, priors):
        assert [" ".join(axes.get_xlabel().split()) for axes in row] == expected


@pytest.mark.parametrize("count", [1, len(NETWORK_SPACE)])
def test_names_and_legend_hide_nothing(count):
    space = ParameterSpace(NETWORK_SPACE.parameters[:count])
    values = {p.name: p.from_unit(np.linspace(0.1, 0.9, 20)) for p in space.parameters}
    best = {name: value[0] for name, value in values.items()}
    figure = pair_figure(space, values, best, best, title="10 networks")
    figure.canvas.draw()
    legend = figure.legends[0].get_window_extent()
    hidden = [figure._suptitle, *figure.axes]
    assert not any(legend.overlaps(each.get_window_extent()) for each in hidden)
    assert legend.x1 <= figure.bbox.width
    below = [axes.xaxis.label.get_window_extent() for axes in figure.axes[-count:]]
    assert min(box.y0 for box in below) >= 0
    assert all(one.x1 < other.x0 for one, other in pairwise(below))


def test_priors_are_densities_on_the_networks_histograms():
    rng = np.random.default_rng(0)
    values = samples(300) | {"gain": rng.uniform(0.8, 1.2, 300)}
    uniform, log_normal = prior_figure(SPACE, values).axes[2:4]
    np.testing.assert_allclose(uniform.lines[0].get_ydata(), 0.5, rtol=1e-6)
    x, y = log_normal.lines[0].get_data()
    assert np.trapezoid(y, x) == pytest.approx(0.99, abs=0.01)
    assert x[np.argmax(y)] == pytest.approx(np.exp(-0.09), abs=0.03)  # the mode of a log-normal
    for axes in (uniform, log_normal):
        assert sum(bar.get_width() * bar.get_height() for bar in axes.patches) == pytest.approx(1)


def test_each_evaluation_is_a_dot_or_a_tick_and_the_best_never_rises():
    (axes,) = one_axes(draw_convergence, LOSSES, STAGES, 0.9).axes
    lines = {line.get_label(): line for line in axes.lines}
    np.testing.assert_array_equal(
        lines["evaluation"].get_xydata().T, [[2, 3, 4, 6, 7], [0.8, 0.3, 0.5, 0.1, 0.2]]
    )
    np.testing.assert_array_equal(lines["infeasible (2)"].get_xdata(), [1, 5])
    best = lines["best so far"].get_ydata()
    np.testing.assert_array_equal(best, [np.nan, 0.8, 0.3, 0.3, 0.3, 0.1, 0.1])
    assert set(lines["flat line (0.9 mV²)"].get_ydata()) == {0.9}
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("evaluation number", "loss (mV²)")
    assert axes.get_xlim() == (0.5, 7.5)
    assert [t.get_text() for t in axes.texts] == ["initial", "optimisation", "rejection"]
    spans = [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches]
    assert spans == [(0.5, 3.5), (3.5, 6.5), (6.5, 7.5)]


@pytest.mark.parametrize("losses", [LOSSES, np.array([0.0, 0.4]), np.array([0.63, 0.97, 5.2])])
def test_the_log_axis_holds_every_loss_and_can_be_read(losses):
    """Plain numbers, two at least, however narrow the range is; also with a perfect fit."""
    figure = one_axes(draw_convergence, losses, STAGES[: len(losses)], 0.9)
    figure.canvas.draw()
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert axes.get_yscale() == "log"
    assert 0 < low < np.nanmin(losses[losses > 0])
    assert high > max(np.nanmax(losses), 0.9)
    labels = axes.yaxis.get_ticklabels(which="both")
    shown = [label.get_text() for label in labels if low <= label.get_position()[1] <= high]
    shown = [text for text in shown if text]
    assert len(shown) >= 2
    assert all(text == f"{float(text):g}" for text in shown)
