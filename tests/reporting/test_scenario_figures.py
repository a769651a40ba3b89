"""Figures of scenarios: every number stands where it belongs."""

from itertools import pairwise

import numpy as np
import pytest

from fascicle.forward.scenario import Scenario
from fascicle.heart.sites import SEGMENTS
from fascicle.prediction.comparison import Swept, Varied
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.reporting.names import index_label
from fascicle.reporting.prediction import SHOWN, bulls_eye_figure, index_figure, sweep_figure

LONG = "a-scenario-of-one's-own-" * 5


def with_indices(values):
    """A scenario of which all indices are the same."""
    return Predicted(Scenario(), [], dict.fromkeys(INDICES, np.asarray(values, dtype=float)))


def test_indices_of_scenarios_are_medians_and_intervals():
    rng = np.random.default_rng(0)
    found = {name: with_indices(rng.normal(100, 10, 200)) for name in ("own", "a", "b")}
    found["a"].indices["qrs_area"][:20] = np.nan  # left out
    panels = index_figure(found).axes
    assert [tick.get_text() for tick in panels[0].get_yticklabels()] == ["own", "a", "b"]
    for panel, index in zip(panels, SHOWN, strict=True):
        assert panel.get_xlabel() == index_label(index)
        thin, thick, dot = panel.lines[3:6]  # of the second scenario
        values = found["a"].indices[index]
        np.testing.assert_allclose(thin.get_xdata(), np.nanpercentile(values, [5, 95]))
        np.testing.assert_allclose(thick.get_xdata(), np.nanpercentile(values, [25, 75]))
        np.testing.assert_allclose(dot.get_xdata(), np.nanmedian(values))
        assert (np.array([thin.get_ydata(), thick.get_ydata()]) == 1).all()


def test_long_names_of_scenarios_stay_in_the_figure():
    figure = index_figure({f"{LONG}{k}": with_indices(np.arange(5)) for k in range(7)})
    figure.canvas.draw()
    for panel in (figure.axes[0], figure.axes[3]):
        labels = panel.get_yticklabels()
        assert len({label.get_text() for label in labels}) == 7
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


def test_swept_delays_and_segments_have_their_medians():
    found = {float(d): with_indices([d, d + 1.0, d + 5.0]) for d in (-10, 0, 10)}
    (axes,) = sweep_figure(Swept(Varied.DELAY, found, {}), "total_activation_time", "pacing").axes
    (line,) = axes.lines
    np.testing.assert_array_equal(line.get_xdata(), [-10, 0, 10])
    np.testing.assert_array_equal(line.get_ydata(), [-9, 1, 11])
    assert axes.get_ylabel() == "total activation time (ms)"
    assert axes.get_xlabel() == Varied.DELAY
    found = {float(k): with_indices([-k] * 3) for k in range(1, 18)}
    figure = sweep_figure(Swept(Varied.SEGMENT, found, {}), "lv_rv_delay", "pacing")
    numbers = {text.get_text() for text in figure.axes[0].texts if text.get_text().isdigit()}
    assert numbers == {str(k) for k in range(1, 18)}
    assert figure.get_suptitle() == "pacing: median LV-RV delay (absolute) by stimulated segment"


@pytest.mark.parametrize("varied", [Varied.DELAY, Varied.SEGMENT])
def test_the_title_of_a_sweep_is_whole(varied):
    found = {float(k): with_indices([k] * 3) for k in range(1, 18)}
    figure = sweep_figure(Swept(varied, found, {}), "total_activation_time", LONG)
    assert figure.get_suptitle().startswith(LONG[:10])
    figure.draw_without_rendering()
    box = figure._suptitle.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
