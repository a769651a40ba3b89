from itertools import pairwise

import numpy as np
import pytest

from fascicle.core.parameters import NETWORK_SPACE, Parameter, ParameterSpace
from fascicle.reporting.pairs import pair_figure

SPACE = ParameterSpace(
    (
        Parameter("lv_initial_length", "mm", 30.0, 100.0),
        Parameter("rv_fascicle_angle_1", "rad", -0.5, 1.5),
        Parameter("cv", "mm/ms", 2.0, 4.0),
    )
)
BEST = {"lv_initial_length": 50.0, "rv_fascicle_angle_1": 0.0, "cv": 2.5}


def samples(count=30):
    unit = np.random.default_rng(3).uniform(0.4, 0.6, (count, len(SPACE)))
    return {p.name: p.from_unit(share) for p, share in zip(SPACE.parameters, unit.T, strict=True)}


def panel(figure, row, column):
    return figure.axes[row * (row + 1) // 2 + column]


def test_lower_triangle_spans_the_whole_prior():
    figure = pair_figure(SPACE, samples(), BEST)
    assert len(figure.axes) == 6
    for row in range(3):
        for column in range(row + 1):
            axes, x, y = panel(figure, row, column), SPACE.parameters[column], SPACE.parameters[row]
            assert axes.get_xlim() == (x.lower, x.upper)
            if row != column:
                assert axes.get_ylim() == (y.lower, y.upper)


def test_scatter_shows_column_against_row_and_marks_best_and_truth():
    values = samples()
    truth = {"lv_initial_length": 60.0, "rv_fascicle_angle_1": 0.4, "cv": 3.1}
    axes = panel(pair_figure(SPACE, values, BEST, truth), 2, 1)
    offsets = axes.collections[0].get_offsets()
    np.testing.assert_array_equal(offsets[:, 0], values["rv_fascicle_angle_1"])
    np.testing.assert_array_equal(offsets[:, 1], values["cv"])
    marks = [(line.get_xdata()[0], line.get_ydata()[0]) for line in axes.lines]
    assert marks == [(0.0, 2.5), (0.4, 3.1)]


@pytest.mark.parametrize("count", [10, 300, 1000])
def test_points_can_be_seen_and_leave_room_for_others(count):
    (size,) = panel(pair_figure(SPACE, samples(count), BEST), 1, 0).collections[0].get_sizes()
    across = np.sqrt(size)  # points
    assert 1.2 < across <= 3
    assert count * size < 0.5 * (72 * 0.95) ** 2  # of the panel


def test_diagonal_is_a_density_over_the_range_against_the_flat_prior():
    figure = pair_figure(SPACE, samples(400), BEST)
    for index, parameter in enumerate(SPACE.parameters):
        axes = panel(figure, index, index)
        density, edges, _ = axes.patches[0].get_data()
        assert (edges[0], edges[-1]) == (parameter.lower, parameter.upper)
        assert np.sum(density * np.diff(edges)) == pytest.approx(1.0)
        prior = axes.lines[0].get_ydata()[0]
        assert prior == pytest.approx(1 / (parameter.upper - parameter.lower))
        assert density.max() > 3 * prior  # contracted fivefold
        assert axes.get_ylim()[1] > density.max()


def test_outer_axes_name_parameter_and_unit():
    figure = pair_figure(SPACE, samples(), BEST)
    assert panel(figure, 2, 0).get_xlabel() == "LV bundle\nlength\n(mm)"
    assert panel(figure, 2, 1).get_xlabel() == "RV\nfascicle\N{NO-BREAK SPACE}1\nangle\n(rad)"
    assert panel(figure, 2, 0).get_ylabel() == "tree speed\n(mm/ms)"
    assert panel(figure, 1, 1).get_xlabel() == ""


@pytest.mark.parametrize("count", [1, 2, 3, len(NETWORK_SPACE)])
def test_the_legend_hides_neither_panels_nor_the_title(count):
    space = ParameterSpace(NETWORK_SPACE.parameters[:count])
    values, best = spread(space)
    figure = pair_figure(space, values, best, best, title="10 networks, a population")
    figure.canvas.draw()
    legend = figure.legends[0].get_window_extent()
    hidden = [figure._suptitle, *figure.axes]
    assert not any(legend.overlaps(each.get_window_extent()) for each in hidden)
    assert legend.x1 <= figure.bbox.width


def test_names_stay_apart_and_on_the_page():
    figure = pair_figure(NETWORK_SPACE, *spread(NETWORK_SPACE))
    figure.canvas.draw()
    bottom, left = figure.axes[-len(NETWORK_SPACE) :], [
        panel(figure, row, 0) for row in range(1, len(NETWORK_SPACE))
    ]  # fmt: skip
    below = [axes.xaxis.label.get_window_extent() for axes in bottom]
    beside = [axes.yaxis.label.get_window_extent() for axes in left]
    assert min(box.y0 for box in below) > 0
    assert min(box.x0 for box in beside) > 0
    assert all(one.x1 < other.x0 for one, other in pairwise(below))
    assert all(one.y0 > other.y1 for one, other in pairwise(beside))


def spread(space):
    values = {p.name: p.from_unit(np.linspace(0.1, 0.9, 20)) for p in space.parameters}
    return values, {name: value[0] for name, value in values.items()}
