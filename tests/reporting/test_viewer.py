"""The heart of a report in a real browser: it paints, and every control does what it says."""

import io
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from builders import case
from matplotlib.image import imread

from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.primitives import His
from fascicle.prediction.predicted import Predicted, PredictedBeat
from fascicle.reporting.page.page import _file
from fascicle.reporting.page.scene import scene

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
# WebGL without a graphics card
ARGUMENTS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
VIEWS = ("AP", "LAO 45°", "RAO 30°", "left lateral", "inferior", "base")
BACKGROUND = 0.98  # of light; the page is white

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the path")


@pytest.fixture(scope="module")
def content(default_heart, default_model):
    found = {}
    for name, his in (("intrinsic", His()), ("block", His(left=0.0))):
        scenario = case(his=his, description=f"<b>{name}</b>")
        simulation = default_model.simulate(EXAMPLE_PARAMETERS, scenario)
        beat = PredictedBeat.of(simulation, simulation.leads, simulation.leads)
        faster = replace(beat, activation=beat.activation / 2)
        totals = {"total_activation_time": np.array([100.0, 50.0])}
        found[name] = Predicted(scenario, [beat, faster], totals)
    return scene(default_heart, found)


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


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=CHROMIUM, args=[*ARGUMENTS, "--no-sandbox"]
        )
        yield opened
        opened.close()


@pytest.fixture
def page(browser, path):
    """An open page; in the end nothing was complained of, nor asked of a network."""
    context = browser.new_context(viewport={"width": 1000, "height": 1000})
    opened, said, asked = context.new_page(), [], []
    opened.on("console", lambda message: said.append(message.text))
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(path.as_uri())
    settle(opened)
    yield opened
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    context.close()


def settle(page):
    page.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")


def picture(page):
    settle(page)
    return imread(io.BytesIO(page.locator(".fv-picture").screenshot()), format="png")[..., :3]


def state(page):
    return page.evaluate("viewer.state()")


def slide(page, time):
    page.get_by_role("slider").evaluate(
        "(e, t) => { e.value = t; e.dispatchEvent(new Event('input')) }", time
    )


def differ(one, other):
    return (np.abs(one - other).max(axis=2) > 0.05).mean()


def painted(image):
    return (image.min(axis=2) < BACKGROUND).mean()


def test_the_heart_is_painted(page):
    image = picture(page)
    assert 0.15 < painted(image) < 0.9
    assert len(np.unique((image * 15).round().reshape(-1, 3), axis=0)) > 60


@pytest.mark.parametrize("size", [(1000, 1000), (390, 700), (1600, 500)])
def test_no_part_of_the_heart_is_cut_off(page, size):
    page.set_viewport_size({"width": size[0], "height": size[1]})
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


def test_it_plays_to_the_end_and_begins_anew(page):
    end = float(page.get_by_role("slider").get_attribute("max"))
    slide(page, end - 2)
    page.get_by_label("play or pause").click()
    page.wait_for_function("!viewer.state().playing")
    assert state(page)["time"] == end
    page.get_by_label("play or pause").click()
    assert state(page)["time"] < end


def test_scenarios_and_fields_are_shown(page, content):
    before = picture(page)
    page.get_by_label("scenario").select_option("block")
    assert state(page)["scenario"] == "block"
    assert differ(before, picture(page)) > 0.02
    page.get_by_label("shown").select_option(label="spread: standard deviation over the networks")
    assert state(page)["field"] == "activation_sd"
    assert page.get_by_role("slider").is_disabled()
    assert (
        "standard deviation over the networks (ms)" in page.locator(".fv-keep").first.inner_text()
    )
    page.get_by_label("scenario").select_option("intrinsic")
    assert state(page)["field"] == "activation_sd"  # stays


def test_a_click_tells_the_time(page, content, default_heart):
    box = page.locator("canvas").first.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    text = page.locator(".fv-read").inner_text()
    value = page.evaluate(
        "([x, y]) => viewer.pick(viewer.stage.ray(x, y))",
        [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
    )
    assert re.match(rf"{value:.0f} ms — .*, intrinsic", text)
    assert 0 <= value <= content["scenarios"][0]["fields"][0]["high"]
    page.mouse.click(box["x"] + 3, box["y"] + 3)
    assert (
        page.evaluate(
            "([x, y]) => viewer.pick(viewer.stage.ray(x, y))", [box["x"] + 3, box["y"] + 3]
        )
        is None
    )


def test_a_clicked_value_is_read_anew_from_what_is_shown(page):
    box = page.locator("canvas").first.bounding_box()
    middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    page.mouse.click(*middle)
    read = page.locator(".fv-read")
    for control, chosen in (("scenario", "block"), ("shown", "1"), ("scenario", "intrinsic")):
        before = read.inner_text()
        page.get_by_label(control).select_option(chosen)
        text = read.inner_text()
        assert text != before
        assert text.endswith(f", {state(page)['scenario']}")
        value = page.evaluate("([x, y]) => viewer.pick(viewer.stage.ray(x, y))", middle)
        assert text.startswith(f"{value:.0f} ms — ")
        assert read.inner_text() == text
    page.mouse.click(box["x"] + 3, box["y"] + 3)
    assert read.inner_text() == "Click on the heart for a value."


def test_the_camera_turns(page):
    before, image = state(page)["camera"], picture(page)
    box = page.locator("canvas").first.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 220, steps=4)
    page.mouse.up()
    assert not np.allclose(state(page)["camera"], before, atol=1.0)
    assert differ(image, picture(page)) > 0.02
    seen = set()
    for name in VIEWS:
        page.get_by_label(f"view: {name}").click()
        seen.add(tuple(np.round(state(page)["camera"])))
        assert painted(picture(page)) > 0.1, name
    assert len(seen) == len(VIEWS)
    page.locator("canvas").first.focus()
    page.keyboard.press("ArrowRight")
    assert tuple(np.round(state(page)["camera"])) not in seen


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


def test_trees_are_seen_through_the_wall(page):
    before = picture(page)
    page.get_by_label("trees").check()
    through = picture(page)
    assert differ(before, through) > 0.05
    slide(page, 5)
    assert differ(through, picture(page)) > 0.05
    page.get_by_label("trees").uncheck()
    slide(page, 10_000)
    assert differ(before, picture(page)) < 0.01


def test_a_picture_is_printed(page):
    page.emulate_media(media="print")
    settle(page)
    assert page.locator(".fv-picture img").count() == 1
    assert page.locator(".fv-picture canvas").count() == 0
    page.emulate_media(media="screen")
    settle(page)
    assert page.locator(".fv-picture canvas").count() == 1
    assert painted(picture(page)) > 0.1


def test_texts_are_texts(page, content):
    """Names from files are never taken for elements."""
    assert content["scenarios"][0]["label"] == "<b>intrinsic</b>"
    assert page.locator(".fv b").count() == 0


@pytest.mark.parametrize("width", [320, 700])
def test_narrow_pages_hold_it(browser, path, width):
    context = browser.new_context(viewport={"width": width, "height": 700}, color_scheme="dark")
    opened = context.new_page()
    opened.goto(path.as_uri())
    settle(opened)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    context.close()


def test_without_webgl_it_says_so(browser, path):
    context = browser.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    opened, said = context.new_page(), []
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.goto(path.as_uri())
    assert "no WebGL" in opened.locator("#viewer").inner_text()
    assert said == []
    context.close()
