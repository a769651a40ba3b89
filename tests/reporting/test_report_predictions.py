"""Figures of predictions: every number stands where it belongs."""

from itertools import pairwise

import numpy as np
import pytest

from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.heart.sites import SEGMENTS
from fascicle.prediction.index_names import INDICES
from fascicle.reporting.indices import SHOWN, index_figure
from fascicle.reporting.names import index_label
from fascicle.reporting.page.page import RESOLUTION
from fascicle.reporting.priors import prior_figure
from fascicle.reporting.sweep import _bulls_eye, bulls_eye_figure, curve_figure


def test_indices_of_scenarios_are_medians_and_intervals():
    rng = np.random.default_rng(0)
    indices = {
        name: {index: rng.normal(100, 10, 200) for index in INDICES} for name in ("own", "a", "b")
    }
    indices["a"]["qrs_area"][:20] = np.nan  # left out
    panels = index_figure(indices).axes
    assert [tick.get_text() for tick in panels[0].get_yticklabels()] == ["own", "a", "b"]
    for panel, index in zip(panels, SHOWN, strict=True):
        assert panel.get_xlabel() == index_label(index)
        thin, thick, dot = panel.lines[3:6]  # of the second scenario
        values = indices["a"][index]
        np.testing.assert_allclose(thin.get_xdata(), np.nanpercentile(values, [5, 95]))
        np.testing.assert_allclose(thick.get_xdata(), np.nanpercentile(values, [25, 75]))
        np.testing.assert_allclose(dot.get_xdata(), np.nanmedian(values))
        assert (np.array([thin.get_ydata(), thick.get_ydata()]) == 1).all()


@pytest.mark.parametrize("count", [1, 7])
def test_names_of_scenarios_are_large_and_stay_in_the_figure(count):
    """Also those of files of one's own, which may be of any length."""
    long = "a-scenario-of-one's-own-" * 5
    names = [f"{long}{k}" for k in range(count)]
    figure = index_figure({name: dict.fromkeys(INDICES, np.arange(5.0)) for name in names})
    figure.canvas.draw()
    assert figure.get_figwidth() <= 960 / RESOLUTION  # not made smaller in the page
    for panel in (figure.axes[0], figure.axes[3]):
        labels = panel.get_yticklabels()
        assert len({label.get_text() for label in labels}) == count
        assert min(label.get_fontsize() for label in labels) >= 9
        boxes = [label.get_window_extent() for label in labels]
        assert min(box.x0 for box in boxes) >= 0
        assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes))


def test_bulls_eye_has_each_segment_in_its_place():
    """Seen from the apex, as the American Heart Association draws it: septal to the left."""
    values = np.arange(1.0, 18.0)
    values[4] = np.nan  # basal inferolateral: white, without a number
    axes = bulls_eye_figure(values, "title", "ms").axes[0]
    places = {t.get_text(): t.get_position() for t in axes.texts}
    assert "5" not in places

    def at(number):
        angle, radius = places[str(number)]
        return radius * np.cos(angle), radius * np.sin(angle)

    for number, name in enumerate(SEGMENTS, 1):
        if number == 5:
            continue
        x, y = at(number)
        if "septal" in name:
            assert x < -0.1
        if "lateral" in name:
            assert x > 0.1
        if name.endswith(" anterior"):
            assert y > abs(x)
        if name.endswith(" inferior"):
            assert -y > abs(x)
    assert np.hypot(*at(1)) > np.hypot(*at(7)) > np.hypot(*at(13)) > np.hypot(*at(17))


@pytest.mark.parametrize(
    "name", ["his-pacing", "a-pacing-with-a-name-that-is-much-longer-than-others" * 2]
)
def test_the_titles_of_a_sweep_name_the_scenario_and_are_whole(name):
    delay = {0.0: np.ones(3), 10.0: np.ones(3)}
    segment = {float(k): np.full(3, float(k)) for k in range(1, 18)}
    for figure in (
        curve_figure(delay, "total_activation_time", "delay (ms)", name),
        _bulls_eye(segment, "total_activation_time", name),
    ):
        title = figure._suptitle
        assert title.get_text().startswith(name[:10])
        figure.draw_without_rendering()
        box = title.get_window_extent()
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1


def test_a_delay_has_its_median():
    values = {float(d): np.array([d, d + 1.0, d + 5.0]) for d in (-10, 0, 10)}
    axes = curve_figure(values, "total_activation_time", "delay (ms)", "pacing").axes[0]
    (line,) = axes.lines
    np.testing.assert_array_equal(line.get_xdata(), [-10, 0, 10])
    np.testing.assert_array_equal(line.get_ydata(), [-9, 1, 11])
    assert axes.get_ylabel() == "total activation time (ms)"
    assert axes.get_xlabel() == "delay (ms)"


def test_priors_are_densities_beside_the_networks():
    space = ParameterSpace(
        (
            Parameter("cv", "mm/ms", 2.0, 4.0),
            Parameter("gain", "1", 0.5, 2.0, "log-normal", median=1.0, sd=0.3),
        )
    )
    rng = np.random.default_rng(0)
    figure = prior_figure(space, {"cv": rng.uniform(2, 4, 300), "gain": rng.uniform(0.8, 1.2, 300)})
    uniform, log_normal = figure.axes[:2]
    np.testing.assert_allclose(uniform.lines[0].get_ydata(), 0.5, rtol=1e-6)
    x, y = log_normal.lines[0].get_data()
    assert np.trapezoid(y, x) == pytest.approx(0.99, abs=0.01)
    assert x[np.argmax(y)] == pytest.approx(np.exp(-0.09), abs=0.03)  # the mode of a log-normal
    for axes in (uniform, log_normal):
        assert sum(bar.get_width() * bar.get_height() for bar in axes.patches) == pytest.approx(1)
    assert uniform.get_xlabel() == "tree speed (mm/ms)"
    assert log_normal.get_xlabel() == "gain"
