import numpy as np
import pytest
from matplotlib.text import Text

from fascicle.core.leads import LEADS
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from tests.reporting.conftest import edges

TIME = np.arange(-40.0, 81.0)


def ecgs(count, time=TIME, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 2.0, (count, 12, len(time)))


def figure_of(predicted, recorded=None, **options):
    groups = [EcgGroup("predicted", "network", TIME, predicted, "#D55E00")]
    if recorded is not None:
        groups.insert(0, EcgGroup("recorded", "beat", TIME, recorded, "#0072B2"))
    return ecg_figure(groups, **options)


def panel(figure, lead):
    return figure.axes[[axes.texts[0].get_text() for axes in figure.axes].index(lead)]


def test_leads_have_means_and_ranges_in_the_clinical_columns():
    beats, networks = ecgs(4), ecgs(6, seed=1)
    figure = figure_of(networks, beats)
    for index, lead in enumerate(LEADS):
        axes = panel(figure, lead)
        recorded, predicted = axes.lines
        np.testing.assert_array_equal(recorded.get_xdata(), TIME)
        np.testing.assert_allclose(recorded.get_ydata(), beats[:, index].mean(axis=0))
        np.testing.assert_allclose(predicted.get_ydata(), networks[:, index].mean(axis=0))
        times, low, high = edges(axes.collections[1])
        np.testing.assert_array_equal(times, TIME)
        np.testing.assert_allclose(low, networks[:, index].min(axis=0))
        np.testing.assert_allclose(high, networks[:, index].max(axis=0))
    figure = figure_of(ecgs(2))
    figure.draw_without_rendering()
    columns = [("I", "II", "III"), ("aVR", "aVL", "aVF"), ("V1", "V2", "V3"), ("V4", "V5", "V6")]
    corners = [[panel(figure, lead).get_position() for lead in column] for column in columns]
    for column in corners:
        assert np.ptp([box.x0 for box in column]) < 1e-6
        assert column[0].y0 > column[1].y0 > column[2].y0
    assert np.all(np.diff([column[0].x0 for column in corners]) > 0.1)


def test_all_leads_share_one_scale_that_holds_every_value():
    networks = ecgs(3)
    networks[2, 7, 30] = -6.2  # one network's V2 alone
    figure = figure_of(networks, ecgs(2))
    limits = {(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}
    assert len(limits) == 1
    (start, stop), (bottom, top) = limits.pop()
    assert (start, stop) == (-40.0, 80.0)
    assert -7.5 < bottom < -6.2
    assert 2.0 < top < 3.5
    assert (figure.get_supxlabel(), figure.get_supylabel()) == ("time (ms)", "potential (mV)")


def test_before_and_after_keep_their_own_time():
    later = np.arange(0.0, 151.0)
    groups = [
        EcgGroup("LBBB", "network", TIME, ecgs(3), "#6B6B6B"),
        EcgGroup("paced", "network", later, ecgs(3, later), "#D55E00"),
    ]
    figure = ecg_figure(groups)
    before, after = panel(figure, "V5").lines
    assert len(before.get_xdata()) == len(TIME)
    assert len(after.get_xdata()) == len(later)
    assert panel(figure, "V5").get_xlim() == (-40.0, 150.0)
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [entry.split(" (")[0] for entry in legend] == ["LBBB", "paced"]
    assert "3 networks" in legend[1]


@pytest.mark.parametrize(("more", "grid"), [(1, (3, 5)), (13, (4, 7))])
def test_additional_leads_have_panels_after_the_twelve(more, grid):
    """Also one that was simulated and not recorded, of which there is no band of beats."""
    leads = [*LEADS, *(f"E{k}" for k in range(more))]
    networks = np.concatenate([ecgs(3)] + more * [ecgs(3)[:, :1]], axis=1)[:, : len(leads)]
    beats = networks.copy()
    beats[:, -1] = np.nan
    figure = figure_of(networks, beats, leads=leads)
    assert {axes.texts[0].get_text() for axes in figure.axes} == {*leads}
    assert figure.axes[0].get_gridspec().get_geometry() == grid
    recorded, predicted = panel(figure, leads[-1]).lines
    assert np.isnan(recorded.get_ydata()).all()
    np.testing.assert_allclose(predicted.get_ydata(), networks[:, -1].mean(axis=0))
    assert len(panel(figure, leads[-1]).collections) == 1


def test_ecgs_that_ended_and_a_single_beat():
    networks = ecgs(3)
    networks[0, :, 100:] = np.nan
    networks[:, :, -1] = np.nan
    line = panel(figure_of(networks), "I").lines[0].get_ydata()
    np.testing.assert_allclose(line[110], networks[1:, 0, 110].mean())
    assert np.isnan(line[-1])
    figure = figure_of(ecgs(5), ecgs(1))
    assert len(panel(figure, "V1").collections) == 1
    assert figure.legends[0].get_texts()[0].get_text() == "recorded (1 beat)"


def test_notes_time_zero_and_caption():
    notes = [f"r {k / 12:.2f}" for k in range(12)]
    caption = (
        "mean explains 83%, r 0.92; QRS duration 177 ms, predicted 126 (121 to 139); frontal axis "
        "-129 degrees, predicted -128 (-160 to -100)"
    )
    texts = {"title": "Title", "notes": notes, "time_zero": "R peak", "caption": caption}
    figure = figure_of(ecgs(3), **texts)
    for index, lead in enumerate(LEADS):
        assert [text.get_text() for text in panel(figure, lead).texts] == [lead, notes[index]]
    first, *lines = figure.get_supxlabel().split("\n")
    assert first == "time (ms; 0: R peak)"
    assert " ".join(lines) == caption
    figure.canvas.draw()
    (below,) = [t for t in figure.findobj(Text) if lines[-1] in t.get_text()]
    box = below.get_window_extent(figure.canvas.get_renderer())
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width
