import numpy as np

from fascicle.reporting.convergence import convergence_figure, running_best, stage_runs

LOSSES = np.array([np.nan, 0.8, 0.3, 0.5, np.nan, 0.1, 0.2])
FLAT = 0.9  # mV²
STAGES = ["initial"] * 3 + ["optimisation"] * 3 + ["rejection"]


def lines(figure):
    return {line.get_label(): line for line in figure.axes[0].lines}


def test_running_best_skips_infeasible_and_never_rises():
    np.testing.assert_array_equal(running_best(LOSSES), [np.nan, 0.8, 0.3, 0.3, 0.3, 0.1, 0.1])


def test_each_evaluation_is_a_dot_or_a_tick_at_its_number():
    drawn = lines(convergence_figure(LOSSES, STAGES, FLAT))
    np.testing.assert_array_equal(drawn["evaluation"].get_xdata(), [2, 3, 4, 6, 7])
    np.testing.assert_array_equal(drawn["evaluation"].get_ydata(), [0.8, 0.3, 0.5, 0.1, 0.2])
    np.testing.assert_array_equal(drawn["infeasible (2)"].get_xdata(), [1, 5])
    np.testing.assert_array_equal(drawn["best so far"].get_ydata(), running_best(LOSSES))


def test_the_loss_of_a_flat_line_is_drawn_and_named():
    figure = convergence_figure(LOSSES, STAGES, FLAT)
    line = lines(figure)["flat line (0.9 mV²)"]
    assert set(line.get_ydata()) == {FLAT}
    (legend,) = figure.legends
    assert line.get_label() in [text.get_text() for text in legend.get_texts()]
    figure.canvas.draw()
    box = legend.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width


def test_axes_have_units_a_log_scale_and_room_for_all():
    axes = convergence_figure(LOSSES, STAGES, FLAT).axes[0]
    assert axes.get_yscale() == "log"
    assert axes.get_xlabel() == "evaluation number"
    assert axes.get_ylabel() == "loss (mV²)"
    assert axes.get_xlim() == (0.5, 7.5)
    low, high = axes.get_ylim()
    assert low < 0.1 < FLAT < high


def test_stages_are_named_over_their_evaluations():
    assert list(stage_runs(STAGES)) == [
        ("initial", 1, 3), ("optimisation", 4, 6), ("rejection", 7, 7),
    ]  # fmt: skip
    figure = convergence_figure(LOSSES, STAGES, FLAT)
    assert [t.get_text() for t in figure.axes[0].texts] == ["initial", "optimisation", "rejection"]
    spans = [(p.get_x(), p.get_x() + p.get_width()) for p in figure.axes[0].patches]
    assert spans == [(0.5, 3.5), (3.5, 6.5), (6.5, 7.5)]


def test_a_narrow_last_stage_is_named_inside_the_figure():
    stages = ["initial"] * 97 + ["rejection"] * 3
    figure = convergence_figure(np.linspace(2, 1, 100), stages, FLAT)
    name = figure.axes[0].texts[1]
    assert name.get_window_extent().x1 <= figure.bbox.width


def test_a_perfect_fit_does_not_break_the_log_axis():
    low, high = convergence_figure(np.array([0.0, 0.4]), STAGES[:2], FLAT).axes[0].get_ylim()
    assert 0 < low < 0.4 < FLAT < high


def test_the_log_axis_can_be_read():
    """Plain numbers, two at least, however narrow the range is."""
    for losses in (LOSSES, np.array([0.63, 0.97, 5.2] * 3)[: len(STAGES)]):
        figure = convergence_figure(losses, STAGES, FLAT)
        figure.canvas.draw()
        axes = figure.axes[0]
        low, high = axes.get_ylim()
        shown = [
            label.get_text()
            for label in axes.yaxis.get_ticklabels(which="both")
            if label.get_text() and low <= label.get_position()[1] <= high
        ]
        assert len(shown) >= 2
        assert all(text == f"{float(text):g}" for text in shown)
