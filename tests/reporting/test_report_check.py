"""The page on a heart leaves no more room than the heart needs, whatever its shape."""

from dataclasses import replace

import numpy as np
import pytest

from fascicle.build.check import check_heart
from fascicle.purkinje.chart import build_chart
from fascicle.reporting.check import check_figure
from fascicle.reporting.rendering import heart_views


@pytest.fixture(scope="module")
def checked(default_heart):
    return check_heart(default_heart, {e.side: build_chart(e) for e in default_heart.endocardia})


def stretched(heart, share):
    """The heart with its height, as seen from the front, a share of what it was."""
    up = heart_views(heart)["anterior"].axes[1]

    def moved(positions):
        return positions + (share - 1) * np.outer(positions @ up, up)

    lv, rv = (replace(each, vertices=moved(each.vertices)) for each in heart.endocardia)
    return replace(heart, vertices=moved(heart.vertices), lv=lv, rv=rv)


@pytest.mark.parametrize("share", [0.5, 1.0, 1.5])
def test_the_figure_is_as_high_as_the_heart_needs(default_heart, checked, share):
    heart = stretched(default_heart, share)
    figure = check_figure(heart, checked)
    for _ in range(2):  # as when it is saved
        figure.canvas.draw()
    upper, lower = figure.axes[:3], figure.axes[3:]
    top = min(axes.get_window_extent().y1 for axes in upper)
    bottom = max(axes.get_window_extent().y0 for axes in upper)
    inch = figure.dpi
    assert (figure.bbox.height - top) / inch < 1.0
    assert (bottom - max(axes.get_window_extent().y1 for axes in lower)) / inch < 1.0
    width = upper[0].get_window_extent().width
    assert width > 0.28 * figure.bbox.width  # the heart, too, has what room there is
