"""The page from which a target is judged: strip, beats, window, words."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.colors import same_color, to_hex
from matplotlib.text import Text

from fascicle.core.leads import LEADS
from fascicle.recording.beats import DetectedBeat, Drift, Unused
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.pipeline import Analysis, BeatClass
from fascicle.recording.recording import Recording
from fascicle.recording.target import Target
from fascicle.reporting.recording import class_colours, recording_figure, strip_span
from fascicle.reporting.style import Colour, save
from tests.reporting.conftest import edges

HEIGHTS = np.array([0.6, 0.9, 0.3, -0.75, 0.15, 0.6, -1.2, -1.8, -1.5, 0.5, 1.4, 1.2])  # mV
BEFORE, AFTER = 200, 300  # ms about R


def synthetic(
    duration=10.0, interval=0.8, scale=1.0, labels="A", chosen="A", unused=(), source="a.hea",
    warnings=(), **more,
):  # fmt: skip
    """Analysis of Gaussian beats of known height with 0.01 mV of noise; `labels` repeat."""
    rng = np.random.default_rng(4)
    time = np.arange(0, duration, 1e-3)
    peaks = np.round(1e3 * np.arange(0.4, duration - 0.35, interval)).astype(int)
    signal = 0.01 * rng.standard_normal((12, len(time)))
    for peak in peaks:
        signal += scale * HEIGHTS[:, None] * np.exp(-0.5 * ((time - peak / 1e3) / 0.02) ** 2)
    named = [labels[k % len(labels)] for k in range(len(peaks))]
    beats = tuple(
        DetectedBeat(
            k + 1, peak / 1e3, label, interval * 1e3,
            None if label == chosen and k + 1 not in unused else Unused.OTHER_CLASS,
        )
        for k, (peak, label) in enumerate(zip(peaks, named, strict=True))
    )  # fmt: skip
    cut = [
        signal[:, p - BEFORE : p + AFTER + 1] for p, b in zip(peaks, beats, strict=True) if b.used
    ]
    target = Target(
        np.array(cut), np.arange(-BEFORE, AFTER + 1.0), -76.0, 86.0, 60 / interval,
        onset_sd=3.0, offset_sd=4.0, warnings=tuple(warnings),
    )  # fmt: skip
    classes = tuple(
        BeatClass(label, named.count(label), "" if label == "A" else "early, wide")
        for label in sorted(set(named))
    )
    made = Analysis(
        Recording(signal, 1000.0, source), signal, beats, classes, np.zeros(0), (), target, chosen
    )
    return replace(made, **more)


def texts(figure):
    """Everything that is written, by line."""
    return [line for text in figure.findobj(Text) for line in text.get_text().split("\n") if line]


def traces(axes, colour):
    """Lines of one colour on the strip, each (x, y)."""
    return [line.get_data() for line in axes.lines if same_color(line.get_color(), colour)]


def panel(figure, lead):
    return figure.axes[1:][4 * (lead % 3) + lead // 3]


def test_panels_show_every_beat_the_mean_and_the_spread_of_the_target():
    target = synthetic(unused=(3,)).target
    figure = recording_figure(synthetic(unused=(3,)))
    assert len(target.beats) == 11
    for lead, name in enumerate(LEADS):
        axes = panel(figure, lead)
        assert axes.texts[0].get_text() == name
        band, beats = axes.collections
        drawn = np.array(beats.get_segments())
        np.testing.assert_array_equal(drawn[:, :, 0], np.tile(target.time, (11, 1)))
        np.testing.assert_array_equal(drawn[:, :, 1], target.beats[:, lead])
        np.testing.assert_allclose(axes.lines[-1].get_ydata(), target.beats[:, lead].mean(axis=0))
        at, low, high = edges(band)
        np.testing.assert_array_equal(at, target.time)
        np.testing.assert_allclose(high - low, 2 * target.beats[:, lead].std(axis=0, ddof=1))


def test_panels_share_a_scale_about_the_window_that_holds_the_beats():
    analysis = synthetic()
    beats = analysis.target.beats.copy()
    beats[2, 7, BEFORE + 20] = -3.1  # in the window
    beats[3, 4, BEFORE + 150] = 90.0  # an artefact outside
    figure = recording_figure(replace(analysis, target=replace(analysis.target, beats=beats)))
    limits = {(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes[1:]}
    assert len(limits) == 1
    (start, stop), (low, high) = limits.pop()
    assert (start, stop) == (-76 - 80, 86 + 120)
    assert -4.5 < low < -3.1
    assert 90 / 12 < high < 15.0  # the mean is shown whole, the one beat is not


def test_window_and_its_uncertainty_are_where_the_target_has_them():
    analysis = synthetic()
    given = replace(analysis.target, onset_sd=0.0, offset_sd=0.0)
    uncertain = [(-79.0, -73.0), (82.0, 90.0)]
    for target, more in ((analysis.target, uncertain), (given, [])):
        axes = panel(recording_figure(replace(analysis, target=target)), LEADS.index("V4"))
        found = [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches]
        assert found == [(-76.0, 86.0), *more]
        assert [line.get_xdata()[0] for line in axes.lines[:2]] == [-76.0, 86.0]


def test_strip_shows_the_signal_in_mv_on_boxes_that_are_named():
    analysis = synthetic(unused=(2,))
    strip = recording_figure(analysis).axes[0]
    level = analysis.signal - np.median(analysis.signal, axis=1, keepdims=True)
    whole = np.full((12, 10_000), np.nan)
    for colour in {line.get_color() for line in strip.lines}:
        for lead, (x, y) in enumerate(traces(strip, colour)):
            here = np.isfinite(y)
            np.testing.assert_allclose(x, np.arange(10_000) / 1e3)
            assert np.isnan(whole[lead, here]).all()  # no sample is drawn twice
            whole[lead, here] = y[here]
    baselines = np.array(strip.get_yticks())
    assert [label.get_text() for label in strip.get_yticklabels()] == list(LEADS)
    np.testing.assert_allclose(whole - baselines[:, None], level, atol=1e-9)
    assert strip.get_xlabel() == "time (s)   ·   boxes of 200 ms and 0.5 mV"
    np.testing.assert_allclose(np.diff(strip.get_xticks(minor=True)).min(), 0.2)
    levels = [line[0, 1] for line in strip.collections[0].get_segments()]
    np.testing.assert_allclose(np.diff(levels), -0.5)


@pytest.mark.parametrize("scale", [1.0, 60.0])
def test_leads_of_any_size_do_not_cross(scale):
    strip = recording_figure(synthetic(scale=scale)).axes[0]
    rows = np.array([y for _, y in traces(strip, Colour.BLUE)])
    rows = rows[:, np.isfinite(rows).all(axis=0)]
    assert (np.diff(rows, axis=0) < 0).mean() > 0.995
    bottom, top = strip.get_ylim()
    assert bottom < rows.min()
    assert rows.max() < top
    assert top - bottom >= 16.0


def test_artefacts_and_spikes_leave_the_room_of_leads_alone():
    plain = synthetic()
    heights = []
    for times in ([], np.arange(0.3, 9.9, 0.4), [5.0]):
        signal = plain.signal.copy()
        for time in times:
            signal[:, round(time * 1e3)] += 8.0
        figure = recording_figure(replace(plain, signal=signal, spikes=np.array(times)))
        heights.append(np.ptp(figure.axes[0].get_ylim()))
        cut = "excursions cut off" in figure.axes[0].get_xlabel()
        assert cut == (len(times) > 0)
        (marks,) = (c for c in figure.axes[0].collections if c.get_label() == "spikes")
        np.testing.assert_array_equal([line[0, 0] for line in marks.get_segments()], times)
    assert np.ptp(heights) < 0.1


@pytest.mark.parametrize("chosen", ["A", "B"])
def test_beats_have_the_colour_of_their_class_and_the_chosen_one_is_blue(chosen):
    analysis = synthetic(labels="AABAC", chosen=chosen, unused=(6, 8), interval=0.6)
    colours = class_colours(analysis)
    assert colours[chosen] == Colour.BLUE
    assert len(set(colours.values())) == 3
    strip = recording_figure(analysis).axes[0]
    for beat in analysis.beats:
        at = round(beat.time * 1e3)
        for _, y in traces(strip, colours[beat.label]):
            assert np.isfinite(y[at - 99 : at + 399]).all()
            assert not np.isfinite(y[at - 102])


def test_beats_are_numbered_and_classes_named():
    analysis = synthetic(labels="AAB", unused=(4,))
    figure = recording_figure(analysis)
    found = {
        text.get_text(): (to_hex(text.get_bbox_patch().get_facecolor()), text.get_position()[0])
        for text in figure.axes[0].texts
    }
    assert found == {
        f"{beat.number}{beat.label}": (Colour.BLUE.lower() if beat.used else "#ffffff", beat.time)
        for beat in analysis.beats
    }
    assert "not used: 3, 6, 9, 12 (class B); 4 (class A)" in texts(figure)
    assert {"A 8 beats", "B 4 beats: early, wide"} <= set(texts(figure))
    analysis = synthetic(labels="ABCDEFGHIJKL", interval=0.4)
    colours = class_colours(analysis)
    assert len({colours[label] for label in "ABCDEF"}) == 6
    assert len({colours[label] for label in "GHIJKL"}) == 1
    assert "6 more classes, 12 beats" in texts(recording_figure(analysis))


@pytest.mark.parametrize(
    ("given", "span"),
    [
        ({"duration": 38.4}, (0.0, 10.0)),
        ({"duration": 38.4, "unused": tuple(range(1, 26))}, (19.0, 29.0)),  # the 26th is at 20.4 s
        ({"duration": 0.8}, (0.0, 2.5)),
    ],
)
def test_the_strip_is_the_first_ten_seconds_with_used_beats(given, span):
    analysis = synthetic(**given)
    start, stop = strip_span(analysis)
    assert start == pytest.approx(span[0], abs=1)
    assert stop - start == span[1] - span[0]
    strip = recording_figure(analysis).axes[0]
    assert strip.get_xlim() == (start, stop)
    named = f"{start:g} to {stop:g} s of 38.4 s" in strip.get_xlabel()
    assert named == (given["duration"] > 10)


def test_leads_that_are_absent_or_recorded_in_turns_say_so():
    analysis = synthetic()
    signal, beats = analysis.signal.copy(), analysis.target.beats.copy()
    signal[[2, 8]], beats[:, [2, 8]] = np.nan, np.nan
    target = replace(analysis.target, beats=beats)
    recording = Recording(signal, 1000.0, "a.hea")
    figure = recording_figure(replace(analysis, signal=signal, recording=recording, target=target))
    assert texts(figure).count("not used") == 2
    assert {"III not used", "V3 not used"} <= set(texts(figure))
    assert len(traces(figure.axes[0], Colour.BLUE)) == 10
    drawn = [len(panel(figure, lead).lines) for lead in range(12)]
    assert drawn == [2 if lead in (2, 8) else 3 for lead in range(12)]
    analysis = synthetic(duration=20.0)
    signal = np.full((12, 20_000), np.nan)
    for turn in range(4):
        here = (slice(3 * turn, 3 * turn + 3), slice(5000 * turn, 5000 * turn + 5000))
        signal[here] = analysis.signal[here]
    recording = Recording(signal, 1000.0, "paper.csv")
    figure = recording_figure(replace(analysis, signal=signal, recording=recording))
    times = [x[np.isfinite(y)] for x, y in traces(figure.axes[0], Colour.BLUE)]
    assert len(times) == 6
    assert all(time.max() < 5.0 for time in times[:3])
    assert all(time.min() >= 5.0 for time in times[3:])
    assert texts(figure).count("recorded from 10.0 to 15.0 s") == 3


def test_a_single_beat_shows_the_stated_noise_and_its_filters():
    analysis = synthetic(duration=0.8)
    filters = (Filter(FilterKind.LOW_PASS, 40.0, FilterOrigin.STATED, 2.0),)
    target = replace(analysis.target, noise=0.05, heart_rate=None, filters=filters)
    figure = recording_figure(replace(analysis, target=target))
    (band,) = panel(figure, 1).collections
    _, low, high = edges(band)
    np.testing.assert_allclose(high - low, 0.1)
    np.testing.assert_allclose((high + low) / 2, target.beats[0, 1])
    found = texts(figure)
    assert {"the beat", "± 0.05 mV, stated noise"} <= set(found)
    assert "filters: low-pass 40 Hz (order 2), the recorder's, as the user says" in found
    assert any(text.startswith("heart rate unknown") for text in found)


def test_of_very_many_beats_some_are_drawn_and_the_page_says_so():
    analysis = synthetic(duration=100.0, interval=0.7)
    count = len(analysis.target.beats)
    figure = recording_figure(analysis)
    drawn = panel(figure, 0).collections[1].get_segments()
    assert len(drawn) == 100 < count
    np.testing.assert_array_equal(drawn[-1][:, 1], analysis.target.beats[-1, 0])
    assert f"100 of {count} beats" in texts(figure)


def test_the_head_tells_measures_what_was_said_of_the_file_and_warnings():
    analysis = synthetic(labels="AAB", source="/ward 3/scans/a.hea")
    found = texts(recording_figure(analysis))
    assert "a.hea" in found
    (measures,) = (text for text in found if "about R" in text)
    assert measures.split("   ·   ") == [
        "75 beats/min",
        "QRS 162 ± 5 ms, −76 to 86 ms about R",
        "8 of 12 beats used, class A",
    ]
    assert "no warnings" in found
    said = {"shared_gain": "1000 per mV", "choice_sampling_rate_hz": "500"}
    beats = (replace(analysis.beats[0], unused=Unused.DRIFTING, drift=Drift("V6", -0.224)),)
    warned = replace(
        synthetic(warnings=[f"lead {k} is flat" for k in range(9)]),
        recording=replace(analysis.recording, provenance=said),
        beats=beats + analysis.beats[1:2],
    )
    found = texts(recording_figure(warned))
    assert any(text.startswith("read with one gain for all leads, 1000 per mV") for text in found)
    assert "not used: 1 (baseline drifts by 0.22 mV in V6)" in found
    listed = [text for text in found if text.startswith("!")]
    assert listed == [*(f"! lead {k} is flat" for k in range(4)), "! and 5 more warnings"]


@pytest.mark.filterwarnings("error", "ignore:Glyph")
@pytest.mark.parametrize("name", ["b$x_1^{2$ 心\nb\tc.hea", "W" * 200])
def test_no_name_is_read_as_a_formula_leaves_the_page_or_overlaps(name, tmp_path):
    warnings = [f"{name[:30]} $\\alpha$ ".replace("\n", " ") * 12] * 4
    analysis = synthetic(labels="AABAC", source=name, warnings=warnings, unused=(5,))
    figure = recording_figure(replace(analysis, spikes=np.array([1.1, 2.0])))
    path = save(figure, tmp_path / "page.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    figure.canvas.draw()
    upper, lower = figure.subfigs
    boxes = [
        *(each._suptitle.get_window_extent() for each in (figure, upper)),
        figure.axes[0].get_window_extent(),
        upper.legends[0].get_window_extent(),
        lower.legends[0].get_window_extent(),
        panel(figure, 0).get_window_extent(),
    ]
    for upper_box, lower_box in pairwise(boxes):
        assert upper_box.y0 >= lower_box.y1 - 1
    for box in boxes:
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.width
