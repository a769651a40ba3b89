import warnings
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
import pytest
from matplotlib.colors import same_color, to_hex
from matplotlib.text import Text

from fascicle.core.leads import LEADS
from fascicle.recording.analysis import Analysis, Beat, BeatClass, Drift, Unused
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.recording import Recording
from fascicle.recording.target import Target
from fascicle.reporting.beat_panels import MOST_DRAWN
from fascicle.reporting.ecg_paper import strip_start
from fascicle.reporting.figures import RESOLUTION, save
from fascicle.reporting.fitted_text import KEPT, drawable, shortened, width, wrapped
from fascicle.reporting.recording import class_colours, recording_figure
from fascicle.reporting.style import BLUE

HEIGHTS = np.array([0.6, 0.9, 0.3, -0.75, 0.15, 0.6, -1.2, -1.8, -1.5, 0.5, 1.4, 1.2])  # mV
BEFORE, AFTER = 200, 300  # ms about R
MM = RESOLUTION / 25.4  # pixels


def synthetic(
    duration=10.0,
    interval=0.8,
    scale=1.0,
    labels="A",
    chosen="A",
    unused=(),
    source="a.hea",
    warnings=(),
    **more,
):
    """Analysis of Gaussian beats of known height with 0.01 mV of noise; `labels` repeat."""
    rng = np.random.default_rng(4)
    time = np.arange(0, duration, 1e-3)
    peaks = np.round(1e3 * np.arange(0.4, duration - 0.35, interval)).astype(int)
    signal = 0.01 * rng.standard_normal((12, len(time)))
    for peak in peaks:
        signal += scale * HEIGHTS[:, None] * np.exp(-0.5 * ((time - peak / 1e3) / 0.02) ** 2)
    named = [labels[k % len(labels)] for k in range(len(peaks))]
    beats = tuple(
        Beat(
            k + 1,
            peak / 1e3,
            label,
            interval * 1e3,
            None if label == chosen and k + 1 not in unused else Unused.OTHER_CLASS,
        )
        for k, (peak, label) in enumerate(zip(peaks, named, strict=True))
    )
    cut = [
        signal[:, p - BEFORE : p + AFTER + 1] for p, b in zip(peaks, beats, strict=True) if b.used
    ]
    target = Target(
        np.array(cut), np.arange(-BEFORE, AFTER + 1.0), -76.0, 86.0, 60 / interval,
        {"warnings": "\n".join(warnings)} if warnings else {}, onset_sd=3.0, offset_sd=4.0,
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
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def traces(axes, colour):
    """Lines of one colour on the strip, each (x, y)."""
    return [line.get_data() for line in axes.lines if same_color(line.get_color(), colour)]


def numbers(axes):
    """Number, fill, and place of each label above the strip."""
    return {
        int(text.get_text()): (
            to_hex(text.get_bbox_patch().get_facecolor()),
            text.get_position()[0],
        )
        for text in axes.texts
        if text.get_text().isdigit()
    }


def baselines(axes):
    named = {text.get_text(): text.xy[1] for text in axes.texts if hasattr(text, "xy")}
    return np.array([named[lead] for lead in LEADS])


def placed(figure):
    """Every text beside the panels with its place on the page (pixels)."""
    figure.set_dpi(RESOLUTION)
    figure.draw_without_rendering()
    strip, legends = figure.axes[0], [legend.get_texts() for legend in figure.legends]
    found = [*figure.texts, *chain.from_iterable(legends), *strip.texts, *strip.get_xticklabels()]
    return [(text.get_text(), text.get_window_extent()) for text in found]


def edges(polygon):
    """Lower and upper edge of a `fill_between` polygon."""
    outline = polygon.get_paths()[0].vertices
    at = np.unique(outline[:, 0])
    values = [outline[outline[:, 0] == t, 1] for t in at]
    return at, np.array([v.min() for v in values]), np.array([v.max() for v in values])


def test_panels_show_every_beat_the_mean_and_the_spread_of_the_target():
    analysis = synthetic(unused=(3,))
    target = analysis.target
    panels = recording_figure(analysis).axes[1:]
    assert [axes.texts[0].get_text() for axes in panels] == list(LEADS)
    assert len(target.beats) == 11
    for lead, axes in enumerate(panels):
        band, beats = axes.collections
        drawn = np.array(beats.get_segments())
        np.testing.assert_array_equal(drawn[:, :, 0], np.tile(target.time, (11, 1)))
        np.testing.assert_array_equal(drawn[:, :, 1], target.beats[:, lead])
        mean = axes.lines[-1]
        np.testing.assert_allclose(mean.get_ydata(), target.beats[:, lead].mean(axis=0))
        assert mean.get_linewidth() > 2 * beats.get_linewidth()[0]
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
    def spans(analysis):
        axes = recording_figure(analysis).axes[1 + LEADS.index("V4")]
        found = [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches]
        return found, [line.get_xdata()[0] for line in axes.lines[:2]]

    analysis = synthetic()
    assert spans(analysis) == ([(-76.0, 86.0), (-79.0, -73.0), (82.0, 90.0)], [-76.0, 86.0])
    given = replace(analysis.target, onset_sd=0.0, offset_sd=0.0)
    assert spans(replace(analysis, target=given)) == ([(-76.0, 86.0)], [-76.0, 86.0])


def test_strip_shows_the_signal_at_the_stated_scale():
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
    np.testing.assert_allclose((whole - baselines(strip)[:, None]) / 7.6, level, atol=1e-9)


def test_squares_of_the_paper_are_squares_of_40_ms_and_a_tenth_of_a_millivolt():
    figure = recording_figure(synthetic())
    figure.set_dpi(RESOLUTION)
    assert figure.get_size_inches() * 25.4 == pytest.approx([210, 297])
    strip = figure.axes[0]
    down, across = (
        np.array(
            [strip.transData.transform(line[0]) for line in strip.collections[k].get_segments()]
        )
        for k in (0, 1)
    )
    columns, rows = np.diff(down[:, 0]), -np.diff(across[:, 1])
    np.testing.assert_allclose(columns, 0.76 * MM, rtol=1e-6)
    np.testing.assert_allclose(rows, 0.76 * MM, rtol=1e-6)
    origin, moved = strip.transData.transform([(0.0, 0.0), (0.04, 0.1 * 7.6)])
    np.testing.assert_allclose(moved - origin, 0.76 * MM, rtol=1e-6)
    large = strip.collections[2].get_segments()
    assert len(large) == 51  # 200 ms each
    assert any("19 mm/s, 7.6 mm/mV" in text and "40 ms, 0.1 mV" in text for text in texts(figure))


@pytest.mark.parametrize("chosen", ["A", "B"])
def test_beats_have_the_colour_of_their_class_and_the_chosen_one_is_blue(chosen):
    analysis = synthetic(labels="AABAC", chosen=chosen, unused=(6, 8), interval=0.6)
    colours = class_colours(analysis)
    assert colours[chosen] == BLUE
    assert len(set(colours.values())) == 3
    strip = recording_figure(analysis).axes[0]
    for beat in analysis.beats:
        if beat.label == chosen and not beat.used:
            continue
        at = round(beat.time * 1e3)
        for lead in range(12):
            _, y = traces(strip, colours[beat.label])[lead]
            assert np.isfinite(y[at - 99 : at + 399]).all()
            assert not np.isfinite(y[at - 102])
    paler = [b for b in analysis.beats if b.label == chosen and not b.used]
    for beat in paler:
        assert not np.isfinite(traces(strip, BLUE)[0][1][round(beat.time * 1e3)])
    assert len(paler) == {"A": 1, "B": 1}[chosen]


def test_numbers_stand_above_their_beats_and_are_hollow_where_unused():
    analysis = synthetic(labels="AAB", unused=(4,))
    figure = recording_figure(analysis)
    found = numbers(figure.axes[0])
    assert list(found) == [beat.number for beat in analysis.beats]
    for beat in analysis.beats:
        fill, place = found[beat.number]
        assert place == beat.time
        assert fill == (BLUE.lower() if beat.used else "#ffffff")
    assert "not used: 3, 6, 9, 12 (class B); 4 (class A)" in texts(figure)
    assert {"A 8 beats", "B 4 beats: early, wide"} <= set(texts(figure))
    assert sum(text == "B" for text in texts(figure)) == 4


def test_classes_beyond_the_colours_share_the_grey_and_a_line_of_the_legend():
    analysis = synthetic(labels="ABCDEFGHIJKL", interval=0.4)
    colours = class_colours(analysis)
    assert len({colours[label] for label in "ABCDEF"}) == 6
    assert len({colours[label] for label in "GHIJKL"}) == 1
    assert "6 more classes, 12 beats" in texts(recording_figure(analysis))


def test_pacing_spikes_are_marked_at_their_time():
    spikes = np.array([0.35, 1.15, 1.95, 12.0])
    strip = recording_figure(synthetic(duration=20.0, spikes=spikes)).axes[0]
    (marks,) = (c for c in strip.collections if c.get_label() == "spikes")
    np.testing.assert_array_equal([line[0, 0] for line in marks.get_segments()], spikes[:3])


def test_spikes_do_not_take_the_room_of_the_leads():
    plain = synthetic()
    signal, times = plain.signal.copy(), np.arange(0.3, 9.9, 0.4)
    for time in times:
        signal[:, round(time * 1e3)] += 8.0
    with_spikes = recording_figure(replace(plain, signal=signal, spikes=times))
    assert any("7.6 mm/mV" in text for text in texts(with_spikes))
    assert any("excursions cut off" in text for text in texts(with_spikes))
    assert not any("excursions cut off" in text for text in texts(recording_figure(plain)))


def test_of_a_long_recording_the_first_ten_seconds_are_shown():
    analysis = synthetic(duration=38.4)
    figure = recording_figure(analysis)
    assert figure.axes[0].get_xlim() == (0.0, 10.0)
    assert any(text.startswith("first 10 s of 38.4 s") for text in texts(figure))
    assert list(numbers(figure.axes[0])) == list(range(1, 13))


def test_ten_seconds_with_used_beats_are_shown_where_the_first_have_none():
    analysis = synthetic(duration=38.4, unused=tuple(range(1, 26)))  # the 26th is at 20.4 s
    start = strip_start(analysis)
    assert 18.0 <= start <= 20.0
    figure = recording_figure(analysis)
    assert figure.axes[0].get_xlim() == (start, start + 10.0)
    assert any(
        text.startswith(f"{start:g} to {start + 10:g} s of 38.4 s") for text in texts(figure)
    )
    x, y = traces(figure.axes[0], BLUE)[0]
    assert x[np.nanargmax(y)] - 20.4 == pytest.approx(
        0.8 * round((x[np.nanargmax(y)] - 20.4) / 0.8), abs=0.01
    )


def test_absent_leads_say_so_and_draw_nothing():
    analysis = synthetic()
    signal, beats = analysis.signal.copy(), analysis.target.beats.copy()
    signal[[2, 8]], beats[:, [2, 8]] = np.nan, np.nan
    figure = recording_figure(
        replace(
            analysis, signal=signal, recording=Recording(signal, 1000.0, "a.hea"),
            target=replace(analysis.target, beats=beats),
        )
    )  # fmt: skip
    assert texts(figure).count("not used") == 4
    assert len(traces(figure.axes[0], BLUE)) == 10
    assert [len(axes.lines) for axes in figure.axes[1:]] == [
        4 if k in (2, 8) else 5 for k in range(12)
    ]


def test_leads_in_turns_are_drawn_in_their_turn():
    analysis = synthetic(duration=20.0)
    signal = np.full((12, 20_000), np.nan)
    for turn in range(4):
        here = (slice(3 * turn, 3 * turn + 3), slice(5000 * turn, 5000 * turn + 5000))
        signal[here] = analysis.signal[here]
    figure = recording_figure(
        replace(analysis, signal=signal, recording=Recording(signal, 1000.0, "paper.csv"))
    )
    drawn = traces(figure.axes[0], BLUE)
    assert len(drawn) == 6
    times = [x[np.isfinite(y)] for x, y in drawn]
    assert all(time.max() < 5.0 for time in times[:3])
    assert all(time.min() >= 5.0 for time in times[3:])
    assert texts(figure).count("recorded from 10.0 to 15.0 s") == 3
    assert texts(figure).count("recorded from 15.0 to 20.0 s") == 3


def test_tall_leads_halve_the_gain_and_do_not_cross():
    figure = recording_figure(synthetic(scale=3.0))
    assert any("3.8 mm/mV" in text and "5 mm/mV: half gain" in text for text in texts(figure))
    assert any("40 ms, 0.2 mV" in text for text in texts(figure))
    strip = figure.axes[0]
    rows = np.array([y for _, y in traces(strip, BLUE)])
    rows = rows[:, np.isfinite(rows).all(axis=0)]
    assert (np.diff(rows, axis=0) < 0).mean() > 0.995
    reach = np.nanmax(rows[8]) - np.nanmin(rows[8])
    assert reach / 3.8 == pytest.approx(3.0 * 1.5, abs=0.1)
    assert np.diff(baselines(strip)).max() < -4.5  # mm between the names


def test_leads_too_tall_for_any_gain_stay_on_the_paper():
    strip = recording_figure(synthetic(scale=60.0)).axes[0]
    bottom, top = strip.get_ylim()
    names = baselines(strip)
    assert bottom < names.min()
    assert names.max() < top
    assert np.diff(names).max() < -4.5


def test_a_short_artefact_leaves_the_gain_alone():
    analysis = synthetic()
    signal = analysis.signal.copy()
    signal[7, 5000:5010] += 20.0
    figure = recording_figure(replace(analysis, signal=signal))
    assert any("7.6 mm/mV" in text and "excursions cut off" in text for text in texts(figure))
    (_, highest) = max((np.nanmax(y), k) for k, (_, y) in enumerate(traces(figure.axes[0], BLUE)))
    assert highest == 0


def test_single_beat_shows_the_stated_noise():
    analysis = synthetic()
    single = replace(analysis.target, beats=analysis.target.beats[:1], noise=0.05, heart_rate=None)
    figure = recording_figure(replace(analysis, target=single))
    axes = figure.axes[1 + LEADS.index("II")]
    (band,) = axes.collections
    _, low, high = edges(band)
    np.testing.assert_allclose(high - low, 0.1)
    np.testing.assert_allclose((high + low) / 2, single.beats[0, 1])
    assert {"the beat", "± 0.05 mV, noise as stated"} <= set(texts(figure))
    assert any(text.startswith("heart rate unknown") for text in texts(figure))


def single_beat(scale=1.0):
    """A recording of 0.8 s with its one beat at 0.4 s, behind a known low-pass."""
    analysis = synthetic(duration=0.8, scale=scale)
    filters = (Filter(FilterKind.LOW_PASS, 40.0, FilterOrigin.STATED, 2.0),)
    target = replace(analysis.target, noise=0.05, heart_rate=None, filters=filters)
    return replace(analysis, target=target)


def test_recording_of_one_beat_is_shown_large():
    figure = recording_figure(single_beat())
    paper = figure.axes[0]
    size = paper.bbox.size / figure.dpi * 25.4
    np.testing.assert_allclose((np.ptp(paper.get_xlim()), np.ptp(paper.get_ylim())), size)
    lines = traces(paper, BLUE)
    assert len(lines) == 12
    for (x, y), height in zip(lines, HEIGHTS, strict=True):
        assert np.ptp(x) == pytest.approx(50.0 * 0.649)  # mm: from 0.25 s before R to the end
        assert np.ptp(y) == pytest.approx(20.0 * abs(height), abs=20.0 * 0.08)
    shown = texts(figure)
    assert any("50 mm/s, 20 mm/mV" in text and "0.05 mV" in text for text in shown)
    assert any(text.startswith("heart rate unknown") and "a single beat" in text for text in shown)
    assert "filters: low-pass 40 Hz (order 2), the recorder's, as the user says" in shown
    assert not any("filled number" in text for text in shown)


@pytest.mark.parametrize(("scale", "gain"), [(1.0, 20), (2.0, 10), (4.0, 5), (8.0, 2.5)])
def test_leads_of_a_single_beat_keep_apart(scale, gain):
    figure = recording_figure(single_beat(scale))
    assert any(f" {gain:g} mm/mV" in text for text in texts(figure))
    lines = [y for _, y in traces(figure.axes[0], BLUE)]
    for lead, (upper, lower) in enumerate(pairwise(lines)):
        if lead % 3 < 2:  # of one column
            assert upper.min() > lower.max()
    bottom, top = figure.axes[0].get_ylim()
    assert bottom < min(y.min() for y in lines) < max(y.max() for y in lines) < top


def test_lead_without_a_signal_says_so_beside_a_single_beat():
    analysis = single_beat()
    signal = analysis.signal.copy()
    signal[LEADS.index("V2")] = np.nan
    assert "V2 not used" in texts(recording_figure(replace(analysis, signal=signal)))


def test_of_very_many_beats_some_are_drawn_and_the_page_says_so():
    analysis = synthetic(duration=100.0, interval=0.7)
    count = len(analysis.target.beats)
    assert count > MOST_DRAWN
    figure = recording_figure(analysis)
    drawn = figure.axes[1].collections[1].get_segments()
    assert len(drawn) == MOST_DRAWN
    np.testing.assert_array_equal(drawn[-1][:, 1], analysis.target.beats[-1, 0])
    assert f"{MOST_DRAWN} of {count} beats" in texts(figure)


def test_head_tells_the_measures():
    analysis = synthetic(labels="AAB", source="/ward 3/scans/a.hea")
    outermost = analysis.target.global_qrs_duration
    assert outermost != pytest.approx(162)
    figure = recording_figure(analysis)
    found = [text.get_text() for text in figure.texts]
    assert found[0] == "a.hea"
    (measures,) = (text for text in found if "QRS" in text and "about R" in text)
    assert measures.split("   ·   ") == [
        "75 beats/min",
        f"QRS 162 ± 5 ms, −76 to 86 ms about R (global {outermost:.0f} ms)",
        "8 of 12 beats used, class A",
    ]
    assert "no warnings" in found


def test_what_was_said_of_the_file_stands_above_the_warnings():
    analysis = synthetic()
    said = {"shared_gain": "1000 per mV", "choice_sampling_rate_hz": "500"}
    recording = replace(analysis.recording, provenance=said)
    found = texts(recording_figure(replace(analysis, recording=recording)))
    remark = next(text for text in found if text.startswith("read with"))
    assert remark == (
        "read with one gain for all leads, 1000 per mV, in place of the file's (amplitudes rest on "
        "it); sampling rate 500 Hz"
    )
    assert found.index(remark) < found.index("no warnings")
    assert not any(text.startswith("read with") for text in texts(recording_figure(analysis)))


def test_a_drifting_beat_is_named():
    analysis = synthetic()
    drift = Drift("V6", -0.224)
    beats = (replace(analysis.beats[0], unused=Unused.DRIFTING, drift=drift), *analysis.beats[1:])
    found = texts(recording_figure(replace(analysis, beats=beats)))
    assert "not used: 1 (baseline drifts by 0.22 mV in V6)" in found


def test_warnings_are_named_as_far_as_they_fit():
    def page(count):
        return texts(
            recording_figure(
                synthetic(warnings=[f"lead {k} hums; filter it" for k in range(count)])
            )
        )

    assert [t for t in page(5) if t.startswith("!")] == [
        f"! lead {k} hums; filter it" for k in range(5)
    ]
    listed = [t for t in page(9) if t.startswith("!")]
    assert listed == [f"! lead {k} hums; filter it" for k in range(4)] + ["! and 5 more warnings"]


NAMES = ("b$x_1^{2$.hea", r"50% \frac{a}$b$.xml", "心电图 Müller.dcm", "a\nb\tc.csv", "W" * 400)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", NAMES)
def test_no_name_is_read_as_a_formula_or_leaves_the_page(name):
    warnings = [f"{name} $\\alpha$ ".replace("\n", " ") * 12] * 4
    analysis = synthetic(labels="AB", source=name, warnings=warnings, unused=(5,))
    classes = tuple(replace(known, description=name) for known in analysis.classes)
    figure = recording_figure(replace(analysis, classes=classes))
    for text, box in placed(figure):
        assert box.x0 >= 3 * MM, text
        assert box.x1 <= (210 - 3) * MM, text
    if "\\" not in name and name.isascii() and len(name) < 20:
        assert figure.texts[0].get_text() == " ".join(name.split())


def test_drawn_texts_do_not_overlap():
    analysis = synthetic(labels="AABAC", spikes=np.array([1.1, 2.0]), unused=(1,))
    figure = recording_figure(analysis)
    boxes = placed(figure)
    for k, (text, box) in enumerate(boxes):
        for other, second in boxes[k + 1 :]:
            assert not box.padded(-1).overlaps(second.padded(-1)), (text, other)


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_page_is_written_in_every_format_without_a_warning(tmp_path, suffix):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        analysis = synthetic(labels="AAB", source="心 $5 & <b>.hea", unused=(2,))
        path = save(recording_figure(analysis), tmp_path / f"page.{suffix}")
    start = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[suffix]
    assert path.read_bytes().startswith(start)
    assert 20_000 < path.stat().st_size < 5_000_000


@pytest.mark.parametrize(
    ("name", "window"),
    [("ludb/24_common.hea", (-65.0, 108.0)), ("ptb-s0010/s0010_re.hea", (-42.0, 95.0))],
)
def test_real_recordings_fit_at_the_standard_gain(data_folder, name, window):
    from fascicle import read_recording
    from fascicle.recording.filters import resample

    recording = read_recording(data_folder / "ecg" / name)
    signal = resample(recording.signal, recording.sampling_rate)
    target = replace(synthetic().target, qrs_onset=window[0], qrs_offset=window[1])
    figure = recording_figure(
        replace(synthetic(), recording=recording, signal=signal, target=target)
    )
    assert any("7.6 mm/mV" in text for text in texts(figure))
    assert figure.texts[0].get_text() == name.split("/")[1]


def test_text_is_shortened_in_the_middle_and_wrapped_between_words():
    long = "start " + "x" * 300 + " end"
    short = shortened(long, 9.0, 60.0)
    assert 57.0 < width(short, 9.0) <= 60.0
    assert short.startswith("start x")
    assert short.endswith("x end")
    assert shortened("start", 9.0, 60.0) == "start"
    lines = wrapped("one two three " * 30, 7.0, 50.0)
    assert " ".join(lines).split() == ["one", "two", "three"] * 30
    assert max(width(line, 7.0) for line in lines) <= 50.0
    assert min(width(line, 7.0) for line in lines[:-1]) > 40.0
    lines = wrapped(f"frontal axis 59{KEPT}degrees", 9.0, 1.01 * width("frontal axis 59", 9.0))
    assert lines == ["frontal axis", f"59{KEPT}degrees"]
    assert drawable("a\x00b\u200bc\r\nd\u5fc3é") == "a?b?c d?é"
