import numpy as np

from fascicle.predict.pacing import Pacing
from fascicle.report.pacing import pacing_figure

PACING = Pacing(
    before=[],
    after=[],
    qrs_before=np.array([150.0, 160.0, 155.0]),
    qrs_after=np.array([110.0, 112.0, 120.0]),
    tat_before=np.array([140.0, 150.0, 146.0]),
    tat_after=np.array([100.0, 103.0, 111.0]),
)
LABELS = ("before", "after")


def test_each_network_is_one_line_from_before_to_after():
    figure = pacing_figure(PACING, LABELS)
    for axes, name in zip(figure.axes, ("qrs", "tat"), strict=True):
        pairs = [line.get_ydata() for line in axes.lines[:3]]
        np.testing.assert_array_equal(
            pairs,
            np.transpose([getattr(PACING, f"{name}_before"), getattr(PACING, f"{name}_after")]),
        )
    assert figure.axes[0].get_ylabel() == "QRS duration (ms)"
    assert figure.axes[1].get_ylabel() == "total activation time (ms)"
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()


def test_the_change_is_of_pairs_with_a_true_minus_sign():
    # paired changes −40, −48, −35: median −40, where the medians differ by −43
    title = pacing_figure(PACING, LABELS).axes[0].get_title()
    assert title.startswith("median change −40 ms")
    assert "−47 to −36 ms" in title  # 5th −47.2, 95th −35.5, rounded half to even
    medians = [line.get_ydata()[0] for line in pacing_figure(PACING, LABELS).axes[0].lines[4::2]]
    assert medians == [155.0, 112.0]


def test_labels_stand_under_the_dots():
    axes = pacing_figure(PACING, ("LBBB", "His pacing")).axes[0]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["LBBB", "His pacing"]
