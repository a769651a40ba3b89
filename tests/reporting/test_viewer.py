"""The heart of a report in a real browser: it paints, and every control does what it says."""

import base64
import hashlib
import io
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from builders import case, recorded
from matplotlib.image import imread

from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.primitives import His
from fascicle.forward.scenario import Scenario
from fascicle.heart.conduction import Region
from fascicle.networks.target_comparison import TargetComparison
from fascicle.prediction.indices import Territories
from fascicle.prediction.predicted import Predicted
from fascicle.reporting.page.page import _file
from fascicle.reporting.page.scene import scene

VIEWS = ("AP", "LAO 45°", "RAO 30°", "left lateral", "inferior", "base")
BACKGROUND = 0.98  # of light; the page is white


def test_the_viewer_is_built_from_its_sources():
    sources = Path(__file__).parents[2] / "viewer"
    files = ["package.json", "package-lock.json", *sorted(sources.glob("src/*.js"))]
    digest = hashlib.sha256(b"".join((sources / file).read_bytes() for file in files))
    assert _file("viewer.js").endswith(f"/* built from {digest.hexdigest()} */\n"), (
        "run 'npm ci && npm run build' in viewer/"
    )


@pytest.fixture(scope="module")
def content(default_heart, default_model):
    """Two scenarios in three networks, of which the second is fitted to a recorded beat."""
    scar = Region(
        label=None, conductivity=0.0, centre=tuple(default_heart.vertices[0]), radius=15.0
    )
    model = replace_conduction(default_model, (scar,))
    learnt = [EXAMPLE_PARAMETERS | {"cv": cv} for cv in (2.0, 3.0, 4.0)]
    torsos = (None, np.eye(12), np.eye(12)[::-1])
    networks = [
        SimpleNamespace(parameters=each, torso=torso)
        for each, torso in zip(learnt, torsos, strict=True)
    ]
    found = {}
    for name, his in (("intrinsic", His()), ("left-bundle-branch-block", His(left=0.0))):
        scenario = (
            case(his=his, description=f"<b>{name}</b>") if name != "intrinsic" else Scenario()
        )
        each = [default_model.simulate(values, scenario) for values in learnt]
        beats = [one.in_single_precision() for one in each]
        totals = {"total_activation_time": np.array([one.total_activation_time for one in each])}
        found[name] = Predicted(scenario, beats, totals)
        if name == "intrinsic":
            recording = TargetComparison(recorded(each[1]))
    return scene(default_heart, found, networks, recording, model)


def replace_conduction(model, regions):
    """The sites of a model, and its conduction with other regions."""
    return SimpleNamespace(sites=model.sites, conduction=replace(model.conduction, regions=regions))


@pytest.fixture(scope="module")
def path(content, tmp_path_factory):
    page = tmp_path_factory.mktemp("page") / "page.html"
    page.write_text(
        "<!DOCTYPE html><meta name=viewport content='width=device-width'>"
        "<style>body { margin: 8px; background: #fff }</style><div id=viewer></div>"
        f"<script id=scene type=application/json>{json.dumps(content)}</script>"
        f"<script>{_file('viewer.js')}</script><script>window.viewer = fascicleViewer("
        "document.getElementById('viewer'), JSON.parse(document.getElementById('scene')"
        ".textContent))</script>",
        encoding="utf-8",
    )
    return page


@pytest.fixture
def page(visit, path):
    opened = visit(path.as_uri(), viewport={"width": 700, "height": 700})
    settle(opened)
    return opened


def potentials(text):
    """Leads (12, t) of what a scene holds (mV)."""
    raw = zlib.decompress(base64.b64decode(text))
    return np.frombuffer(raw, "<i2").reshape(12, -1) / 1000


def settle(page):
    page.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")


def picture(page, what=".fv-picture"):
    settle(page)
    image = page.locator(what).first.screenshot()
    return imread(io.BytesIO(image), format="png")[..., :3]


def state(page):
    return page.evaluate("viewer.state()")


def slide(page, value, name="time"):
    page.locator(f"input[aria-label^={name}]").evaluate(
        "(e, t) => { e.value = t; e.dispatchEvent(new Event('input')) }", value
    )


def differ(one, other):
    return (np.abs(one - other).max(axis=2) > 0.05).mean()


def painted(image):
    return (image.min(axis=2) < BACKGROUND).mean()


def test_the_heart_is_painted_and_no_part_of_it_is_cut_off(page):
    image = picture(page)
    assert 0.15 < painted(image) < 0.9
    assert len(np.unique((image * 15).round().reshape(-1, 3), axis=0)) > 60
    for width, height in ((390, 700), (1200, 375)):
        page.set_viewport_size({"width": width, "height": height})
        for view in VIEWS:
            page.get_by_role("button", name=view).click()
            image = picture(page)
            edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
            assert edge.min() > BACKGROUND, view
            assert painted(image) > 0.05


def test_the_slider_and_play_move_the_front(page):
    whole = picture(page)
    slide(page, 20)
    early = picture(page)
    assert state(page)["time"] == 20
    assert differ(whole, early) > 0.05
    page.get_by_label("play or pause").click()
    page.wait_for_function("viewer.state().time > 25")
    assert state(page)["playing"]
    page.get_by_label("play or pause").click()
    stopped = state(page)
    assert not stopped["playing"]
    page.wait_for_timeout(200)
    assert state(page)["time"] == stopped["time"]
    # to the end, and from the beginning again
    end = float(page.locator(".fv-row input[aria-label^=time]").get_attribute("max"))
    slide(page, end - 2)
    page.get_by_label("play or pause").click()
    page.wait_for_function("!viewer.state().playing")
    assert state(page)["time"] == end
    page.get_by_label("play or pause").click()
    assert state(page)["time"] < end


def test_scenarios_and_fields_are_shown(page, content):
    before = picture(page)
    page.get_by_label("scenario").select_option("left bundle branch block")
    assert state(page)["scenario"] == "left-bundle-branch-block"
    assert differ(before, picture(page)) > 0.05
    page.get_by_label("shown").select_option(label="spread: standard deviation over the networks")
    assert state(page)["field"] == "activation_sd"
    assert page.locator(".fv-row input[aria-label^=time]").is_disabled()
    assert (
        "standard deviation over the networks (ms)" in page.locator(".fv-keep").nth(1).inner_text()
    )
    page.get_by_label("scenario").select_option("intrinsic beat")
    assert state(page)["field"] == "activation_sd"  # stays


def middle_of_the_heart(page):
    box = page.locator("canvas").first.bounding_box()
    return box, [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]


def picked(page, place):
    return page.evaluate("([x, y]) => viewer.pick(viewer.stage.ray(x, y))", place)


def test_a_click_tells_the_time_of_what_is_shown(page, content):
    box, middle = middle_of_the_heart(page)
    page.mouse.click(*middle)
    read = page.locator(".fv-read")
    assert re.match(rf"{picked(page, middle):.0f} ms — .*, intrinsic beat", read.inner_text())
    assert 0 <= picked(page, middle) <= content["times"]["high"]
    titles = {"intrinsic": "intrinsic beat", "left-bundle-branch-block": "left bundle branch block"}
    for control, chosen in (("scenario", "1"), ("shown", "1"), ("scenario", "0")):
        before = read.inner_text()
        page.get_by_label(control).select_option(chosen)
        text = read.inner_text()
        assert text != before
        assert text.endswith(f", {titles[state(page)['scenario']]}")
        assert text.startswith(f"{picked(page, middle):.0f} ms — ")
    beside = [box["x"] + 3, box["y"] + 3]
    page.mouse.click(*beside)
    assert picked(page, beside) is None
    assert read.inner_text() == "Click on the heart for a value."


def test_the_camera_turns(page):
    before, image = state(page)["camera"], picture(page)
    box = page.locator("canvas").first.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 220, steps=4)
    page.mouse.up()
    turned = state(page)["camera"]
    assert not np.allclose(turned, before, atol=1.0)
    assert differ(image, picture(page)) > 0.02
    page.locator("canvas").first.focus()
    page.keyboard.press("ArrowRight")
    assert not np.allclose(state(page)["camera"], turned, atol=1.0)


def test_views_are_those_of_the_body(page, content):
    """LAO and RAO turn about the long axis of the body, to the patient's left and right."""
    centre = np.array(page.evaluate("viewer.stage.centre.toArray()"))
    up, front = np.array(content["up"]), np.array(content["front"])
    axes = np.array([np.cross(up, front), front, up])
    root = np.sqrt(0.5)
    expected = {
        "AP": (0, 1, 0), "LAO 45°": (root, root, 0), "RAO 30°": (-0.5, np.sqrt(0.75), 0),
        "left lateral": (1, 0, 0), "inferior": (0, 0, -1), "base": axes @ content["base"],
    }  # fmt: skip
    for name, direction in expected.items():
        page.get_by_label(f"view: {name}").click()
        away = np.array(state(page)["camera"]) - centre
        np.testing.assert_allclose(axes @ away / np.linalg.norm(away), direction, atol=1e-3)


def test_networks_are_seen_at_once_and_lit_by_the_front(page):
    before = picture(page)
    page.get_by_label("Purkinje network").uncheck()
    without = picture(page)
    assert differ(before, without) > 0.05
    page.get_by_label("Purkinje network").check()
    assert differ(before, picture(page)) < 0.001
    page.get_by_label("opaque").check()
    assert differ(before, picture(page)) > 0.1
    page.get_by_label("opaque").uncheck()
    # before the ventricles only the network is activated, from the root on
    slide(page, -30)
    early = picture(page)
    slide(page, -1)
    assert 0.001 < differ(early, picture(page)) < 0.05
    assert page.evaluate("viewer.panels[0].heart.values.every((time) => time >= 0)")


def test_the_heart_is_cut_open(page, content):
    before, share = picture(page), []
    for depth in (20, 50, 90):
        slide(page, depth, "cut")
        share.append(painted(picture(page)))
    assert share[0] > share[1] > share[2]
    _, middle = middle_of_the_heart(page)
    picked(page, middle)
    deep = page.evaluate("viewer.stage.isCut(viewer.panels[0].marker.position)")
    assert not deep  # a click meets what is left
    slide(page, 0, "cut")
    page.mouse.click(3, 3)
    assert differ(before, picture(page)) < 0.02
    # and endocardia are shown alone
    surface = content["surfaces"][0]
    page.get_by_label("opaque").check()
    page.get_by_label("endocardia only").check()
    assert painted(picture(page)) < 0.85 * painted(before)
    drawn = page.evaluate("viewer.panels[0].heart.mesh.geometry.drawRange.count")
    assert drawn == 3 * surface["endocardial"]


def test_colours_and_isochrones(page):
    page.get_by_label("opaque").check()
    bright = picture(page)
    page.get_by_label("colours", exact=True).select_option("early is red")
    red = picture(page)
    assert differ(bright, red) > 0.1
    assert page.evaluate("viewer.panels[0].heart.early") == "red"
    page.get_by_label("isochrones in ms").uncheck()
    plain = picture(page)
    assert 0.0005 < differ(red, plain) < 0.1
    labels = page.evaluate(
        "viewer.panels[0].isochrones.map((l) => [l.text, viewer.panels[0].heart.valueAt(l.vertex)])"
    )
    assert len({text for text, _ in labels}) > 3
    for text, value in labels:
        assert abs(value - (0 if text.startswith("first activation: ") else float(text))) <= 1


def test_a_slider_goes_through_the_networks(page, content):
    before, ecg, first = picture(page), picture(page, ".fv-ecg"), state(page)["network"]
    assert first == 2  # the median one
    slide(page, 0, "network")
    assert differ(before, picture(page)) > 0.01
    other = picture(page, ".fv-ecg")  # perhaps of another height
    assert ecg.shape != other.shape or differ(ecg, other) > 0.002
    slowest = state(page)["network"]
    page.get_by_label("ordered by").select_option(label="Purkinje conduction velocity (m/s)")
    assert state(page)["network"] == slowest  # stays
    for rank, speed in enumerate((2, 3, 4)):
        slide(page, rank, "network")
        said = f"{rank + 1} of 3: Purkinje conduction velocity {speed} m/s"
        assert page.locator(".fv-clock").last.inner_text() == said
        assert state(page)["network"] == rank + 1


def test_segments_and_ecgs_are_those_of_the_networks(page, content, default_model):
    eye = page.get_by_role("img", name="17 segments: activation, intrinsic beat")
    one = picture(page, "[aria-label^='17 segments']")
    territories = Territories.of(default_model.heart, default_model.sites.places)
    found = default_model.simulate(EXAMPLE_PARAMETERS | {"cv": 3.0})
    times = territories.times(found.activation - found.activation.min())
    expected = territories.segment_means(times)[1:]
    # network 3 is in the last of the torsos
    first = content["scenarios"][0]
    ecg = potentials(first["ecgs"][content["networks"].index(3)])
    leads = default_model.simulate(EXAMPLE_PARAMETERS | {"cv": 4.0}).leads[:12]
    np.testing.assert_allclose(np.ptp(ecg, axis=1), np.ptp(leads[::-1], axis=1), rtol=0.05)
    segments = first["segments"]
    np.testing.assert_allclose(segments["one"][content["median"]], expected, atol=0.02)
    mean = segments["all"][0]
    assert all(
        low <= v <= high
        for low, v, high in zip(*(mean[n] for n in ("low", "values", "high")), strict=True)
    )
    slide(page, 0, "network")
    assert differ(one, picture(page, "[aria-label^='17 segments']")) > 0.01
    assert eye.count() == 1
    page.get_by_label("shown").select_option("spread: standard deviation over the networks")
    assert page.get_by_role("img", name="17 segments: spread").count() == 1


def test_two_scenarios_are_seen_from_one_side(page):
    page.get_by_label("compare with").select_option("left bundle branch block")
    settle(page)
    assert page.get_by_role("img", name="17 segments").count() == 2
    assert page.locator(".fv-panel").count() == 2
    assert page.locator(".fv-panel > .fv-title").all_inner_texts() == [
        "intrinsic beat", "left bundle branch block",
    ]  # fmt: skip
    assert page.evaluate("viewer.panels[0].heart.shared.high.value") == page.evaluate(
        "viewer.panels[1].heart.shared.high.value"
    )
    for canvas, arrow in ((0, "ArrowLeft"), (1, "ArrowUp")):
        before = state(page)["camera"]
        page.locator(".fv-picture canvas[tabindex]").nth(canvas).focus()
        page.keyboard.press(arrow)
        assert not np.allclose(before, state(page)["camera"], atol=1)
        both = page.evaluate("viewer.panels.map((p) => p.stage.camera.position.toArray())")
        np.testing.assert_allclose(both[0], both[1], atol=1e-6)
    assert "simulated, left bundle branch block" in page.locator(".fv-ecg").inner_text()
    page.get_by_label("compare with").select_option("nothing")
    assert page.locator(".fv-panel").count() == 1


def test_ecg_and_heart_share_one_time(page):
    paper = page.get_by_label("time in the ECG")
    slide(page, 40)
    assert paper.get_attribute("aria-valuenow") == "40"
    at_40, heart = picture(page, ".fv-ecg"), picture(page)
    paper.focus()
    for _ in range(3):
        page.keyboard.press("PageUp")
    page.keyboard.press("ArrowRight")
    assert state(page)["time"] == 71
    assert 0.001 < differ(at_40, picture(page, ".fv-ecg")) < 0.1
    assert differ(heart, picture(page)) > 0.02
    box = paper.bounding_box()
    left, unit, width = page.evaluate(
        "[viewer.ecg.layout.offsets[0], viewer.ecg.layout.unit, viewer.ecg.layout.width]"
    )
    page.mouse.click(box["x"] + unit * (left + width / 2), box["y"] + 20)
    middle = page.evaluate("(viewer.start + viewer.end) / 2")
    assert state(page)["time"] == pytest.approx(middle, abs=3)
    assert float(page.locator("input[aria-label^=time]").input_value()) == pytest.approx(
        middle, abs=3
    )


def test_the_recorded_beat_lies_on_the_simulated_one(page):
    """The recording is network 2 with noise of 0.02 mV / √10, from 80 ms before it on.

    The paper is to scale.
    """
    text = page.locator(".fv-ecg").inner_text()
    assert text.split("\n")[:2] == ["recorded", "simulated"]
    scale = r"100 mm/s, (10|20) mm/mV; time in ms, 0: first ventricular activation"
    assert re.search(scale, text)
    width, duration, unit = page.evaluate(
        "[viewer.ecg.layout.width, viewer.end - viewer.start, viewer.ecg.layout.unit]"
    )
    assert width == pytest.approx(duration / 1000 * 100)  # mm
    assert unit == pytest.approx(96 / 25.4)  # pixels
    apart = page.evaluate("""() => {
      const [recorded, simulated] = viewer.ecg.content.traces.map(({ values }) => values.V3);
      const apart = recorded.map((value, k) => value - simulated[k]);
      const known = apart.filter((value) => !Number.isNaN(value));
      return [known.length, Math.hypot(...known) / Math.sqrt(known.length),
              Math.hypot(...simulated) / Math.sqrt(known.length)];
    }""")
    assert apart[0] > 60
    assert apart[1] < 0.05 < apart[2]


def test_blocks_and_scar_are_marked_and_a_picture_is_printed(page, content):
    (mark,) = content["scenarios"][1]["marks"][0]
    assert (mark["kind"], mark["text"]) == ("blocked", "left bundle branch")
    assert content["scenarios"][0]["marks"] == [[], [], []]
    assert content["surfaces"][0]["scarred"]
    assert "Hatched: scar." in page.locator(".fv").inner_text()
    page.get_by_label("scenario").select_option("left bundle branch block")
    with_mark = picture(page)
    page.evaluate("viewer.panels[0].overlay.labels = []; viewer.stage.draw()")
    assert 0.0005 < differ(with_mark, picture(page)) < 0.1
    # of which a picture is printed
    page.emulate_media(media="print")
    settle(page)
    assert page.locator(".fv-picture img").count() == 1
    assert page.locator(".fv-picture canvas[tabindex]").count() == 0
    page.emulate_media(media="screen")
    settle(page)
    assert page.locator(".fv-picture canvas[tabindex]").count() == 1
    assert painted(picture(page)) > 0.1


def test_texts_are_texts(visit, path, content, tmp_path):
    """Names from files are never taken for elements, and a narrow page holds it all."""
    evil = json.loads(json.dumps(content))
    evil["scenarios"][0]["title"] = "<b>intrinsic</b>"
    page = tmp_path / "evil.html"
    page.write_text(path.read_text(encoding="utf-8").replace(json.dumps(content), json.dumps(evil)))
    narrow = {"width": 320, "height": 700}
    opened = visit(page.as_uri(), viewport=narrow, color_scheme="dark")
    settle(opened)
    assert opened.evaluate("document.documentElement.scrollWidth") <= 320
    assert "<b>intrinsic</b>" in opened.locator(".fv").inner_text()
    assert opened.locator(".fv b").all_inner_texts() == [""]  # the whole beat is shown


def test_without_webgl_it_says_so(browser, path):
    context = browser.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    opened, said = context.new_page(), []
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.goto(path.as_uri())
    assert "no WebGL" in opened.locator("#viewer").inner_text()
    assert said == []
    context.close()
