"""The explorer in a real browser: what is moved there is what is simulated; nobody else gets in."""

import base64
import json
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from queue import Queue
from threading import Thread

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from fascicle.explorer.explore import serve
from fascicle.explorer.session import Session, packed
from fascicle.reporting.page.page import _file


class Process:
    """A command in a process of its own, which prints the address of its page."""

    def __init__(self, *command):
        self.process = subprocess.Popen(
            [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            # as a terminal would: a shell's background job ignores Ctrl-C
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        self.url = re.search(r"http://\S+", self.process.stdout.readline())[0]

    def ended(self):
        """Its exit status, and what it said on standard error."""
        said = self.process.communicate(timeout=120)[1]
        return self.process.returncode, said


@pytest.fixture
def process(tmp_path):
    log = str(tmp_path / "log")
    made = Process("-m", "fascicle.cli", "explore", "default", "--no-browser", "--log", log)
    yield made
    made.process.kill()
    made.process.communicate()


def served(session):
    """A thread that serves a session, and the address of its page."""
    urls = Queue()
    thread = Thread(target=serve, args=(session, None, urls.put, False), daemon=True)
    thread.start()
    return thread, urls.get(timeout=60)


@pytest.fixture(scope="module")
def session(default_model):
    return Session(default_model)


@pytest.fixture(scope="module")
def url(session):
    """Address of a page that is served until the module's end, as another page is open."""
    thread, url = served(session)
    own = url[: url.index("/", 8)]
    with connect(f"{url.replace('http', 'ws')}socket", origin=own, max_size=None):
        yield url
    thread.join(60)
    assert not thread.is_alive()


@pytest.fixture
def explore(visit):
    def open_page(url):
        # the policy of the page forbids what the test's own questions need
        page = visit(url, bypass_csp=True, viewport={"width": 1000, "height": 700})
        answered(page, 1)
        return page

    return open_page


@pytest.fixture
def page(url, explore):
    return explore(url)


def answered(page, count):
    """Wait for so many answers in all."""
    page.wait_for_function(f"window.explorer?.latencies?.length >= {count}", timeout=60_000)
    page.wait_for_function("!window.explorer.busy && !window.explorer.waiting")


def change(page, act):
    """Do something that asks for another beat, and wait for it."""
    before = page.evaluate("explorer.latencies.length")
    act()
    answered(page, before + 1)


def slide(page, name, value):
    row = page.locator(f"[data-name={name}] input[type=range]")
    row.evaluate("(e, v) => { e.value = v; e.dispatchEvent(new Event('input')) }", value)


def shown(page):
    """State, numbers and simulated leads of the beat on the page."""
    return page.evaluate(
        "({ state: explorer.state, said: explorer.beat.said,"
        " leads: [...explorer.beat.arrays.simulated], pixels: explorer.canvas.toDataURL() })"
    )


def total(page):
    return shown(page)["said"]["total"]


def in_the_middle(page):
    box = page.locator(".fx canvas").first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.55


def test_a_slider_gives_the_ecg_that_simulate_gives(page, default_model):
    before = shown(page)
    change(page, lambda: slide(page, "lv_initial_length", 18))
    after = shown(page)
    expected = default_model.simulate(after["state"]["values"])
    assert after["state"]["values"]["lv_initial_length"] == pytest.approx(18, abs=0.2)
    found = np.array(after["leads"]).reshape(12, -1)
    np.testing.assert_allclose(found, expected.leads[:12], atol=1e-6)
    assert after["pixels"] != before["pixels"]
    text = page.locator(".fx-measured").inner_text()
    assert f"{expected.qrs_duration:.0f} ms" in text
    latest = np.ceil(np.ptp(expected.activation[np.unique(default_model.heart.boundary[0])]))
    bar = page.get_by_role("img", name="colours of activation (ms; 0: first ventricular")
    assert bar.get_attribute("aria-label").endswith(f" from 0 to {latest:.0f}")
    assert page.evaluate("explorer.heart.shared.high.value") == latest
    change(page, lambda: page.keyboard.press("Control+z"))
    assert shown(page)["leads"] == before["leads"]
    slide_to = "e => { e.value = 30; e.dispatchEvent(new Event('input')) }"
    page.get_by_label("time after the first").evaluate(slide_to)
    assert page.evaluate("explorer.ecg.time") == 30
    page.get_by_label("time in the ECG").press("ArrowRight")
    assert page.evaluate("explorer.time") == 31


def test_a_value_is_typed(page):
    speed = page.get_by_label("Purkinje conduction velocity (m/s)")
    speed.fill("2,345")
    change(page, lambda: speed.press("Enter"))
    typed = shown(page)
    assert typed["state"]["values"]["cv"] == 2.345
    at = page.locator("[data-name=cv] input[type=range]").input_value()
    assert float(at) == pytest.approx(2.345, abs=0.005)
    for text, key in (("9", "Enter"), ("", "Enter"), ("x", "Tab"), ("3", "Escape")):
        speed.fill(text)
        speed.press(key)
        assert speed.input_value() == "2.345"
        words = "Purkinje conduction velocity: give 1.5 to 3.5 m/s" if key != "Escape" else ""
        assert page.locator(".fx-status").inner_text() == words
        page.evaluate("explorer.say('')")
    assert shown(page) == typed


def test_what_was_found_is_saved(page, tmp_path):
    kept = []
    page.on("download", lambda each: kept.append(each))
    page.get_by_role("button", name="save parameters").click()
    page.wait_for_timeout(500)
    assert {each.suggested_filename for each in kept} == {"parameters.toml", "scenario.toml"}
    with page.expect_download() as picture:
        page.get_by_role("button", name="picture").click()
    picture.value.save_as(tmp_path / "heart.png")
    assert (tmp_path / "heart.png").read_bytes().startswith(b"\x89PNG")


def test_clicks_pace_and_block_and_undo_takes_them_back(page):
    sinus = total(page)
    page.get_by_label("click", exact=True).select_option("pace here")
    change(page, lambda: page.mouse.click(*in_the_middle(page)))
    paced = shown(page)
    assert len(paced["state"]["stimuli"]) == 1
    assert paced["said"]["total"] > sinus
    change(page, lambda: page.get_by_role("button", name="undo").click())
    assert total(page) == sinus
    page.get_by_label("click", exact=True).select_option("block a branch")
    change(page, lambda: page.mouse.click(*in_the_middle(page)))
    blocked = shown(page)
    assert len(blocked["state"]["blocks"]) == 1
    assert blocked["pixels"] != paced["pixels"]
    page.get_by_label("click", exact=True).select_option("make a scar")
    change(page, lambda: page.mouse.click(*in_the_middle(page)))
    assert len(shown(page)["state"]["scars"]) == 1
    assert "Infinity" in page.evaluate("String(Math.max(...explorer.beat.arrays.activation))")


def test_states_and_pacings_are_chosen_and_compared_with_a_pinned_beat(page):
    sinus = shown(page)["said"]
    page.get_by_role("button", name="pin").click()
    conduction = page.get_by_label("conduction", exact=True)
    change(page, lambda: conduction.select_option("left bundle branch block"))
    assert total(page) > sinus["total"] + 10
    assert f"(pinned {sinus['total']:.0f})" in page.locator(".fx-measured").inner_text()
    change(page, lambda: page.get_by_role("button", name="left bundle: left bundle").click())
    assert shown(page)["state"]["scenario"] == "left-bundle-branch-pacing"
    assert shown(page)["state"]["values"]["conduction"] == 1  # stays blocked
    change(page, lambda: page.get_by_role("button", name="start again").click())
    assert shown(page)["said"] == sinus | {"id": shown(page)["said"]["id"]}


def test_every_exercise_can_be_begun(page):
    exercises = page.get_by_label("exercises").locator("summary")
    for summary in exercises.all():
        summary.click()
        change(page, lambda one=summary: one.locator("..").get_by_role("button").click())
        assert page.locator(".fx-status").inner_text() == ""
    assert exercises.count() == 5


@pytest.mark.slow
def test_what_is_not_learnt_has_sliders_too(page, default_model):
    page.get_by_text("growth and junctions").click()
    change(page, lambda: slide(page, "branch_length", 12))
    grown = default_model.simulate(shown(page)["state"]["values"])
    found = np.array(shown(page)["leads"]).reshape(12, -1)
    np.testing.assert_allclose(found, grown.leads[:12], atol=1e-6)
    page.get_by_text("tissue", exact=True).click()
    for name, value in (("endocardial_layer", 2), ("endocardial_speed", 3)):
        slide(page, name, value)  # nothing is asked before the hand rests
        assert name not in shown(page)["state"]["values"]
        row = page.locator(f"[data-name={name}] input[type=range]")
        change(page, lambda row=row: row.dispatch_event("change"))
    assert total(page) < grown.total_activation_time


@pytest.mark.slow
def test_an_electrode_is_dragged(torso_model, browser):
    session, page, said = Session(torso_model), browser.new_page(), []
    page.on("pageerror", lambda error: said.append(str(error)))
    page.expose_function("kernel", lambda m: base64.b64encode(session.answer(m)).decode())
    page.add_script_tag(content=_file("viewer.js"))
    page.evaluate(
        """(first) => {
          const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
          window.explorer = fascicleExplorer(document.body, async (message) =>
            explorer.heard(bytes(await kernel(message))));
          explorer.heard(bytes(first));
        }""",
        base64.b64encode(session.description()).decode(),
    )
    answered(page, 1)
    page.get_by_label("click", exact=True).select_option("pace here")
    page.get_by_label("electrodes", exact=True).check()
    where = "explorer.stage.onScreen(explorer.chest()[4].place).toArray()"
    before, leads = page.evaluate(where), shown(page)["leads"]
    page.mouse.move(*before)
    page.mouse.down()
    page.mouse.move(before[0], before[1] - 15, steps=3)
    page.mouse.up()
    answered(page, 3)
    state = shown(page)["state"]["values"]
    assert state["v5_up"] > 3
    after = page.evaluate(where)
    np.testing.assert_allclose(after, [before[0], before[1] - 15], atol=6)
    page.mouse.move(*after)  # on to the heart, where its end is no click
    page.mouse.down()
    page.mouse.move(*in_the_middle(page), steps=3)
    page.mouse.up()
    page.wait_for_function("!explorer.busy && !explorer.waiting")
    assert shown(page)["state"]["stimuli"] == []
    page.get_by_role("button", name="undo").click()
    page.wait_for_function("!explorer.busy && !explorer.waiting")
    assert shown(page)["leads"] != leads
    camera = page.evaluate("explorer.stage.camera.position.toArray()")
    page.get_by_role("button", name="view: AP").click()
    np.testing.assert_allclose(
        page.evaluate("explorer.stage.camera.position.toArray()"), camera, atol=1e-6
    )
    page.get_by_role("button", name="undo").click()
    page.wait_for_function("!explorer.busy && !explorer.waiting")
    assert "v5_up" not in shown(page)["state"]["values"]
    assert said == []
    page.close()


def test_two_pages_and_the_server_ends_with_the_last(process, explore):
    one, other = explore(process.url), explore(process.url)
    change(one, lambda: slide(one, "cv", 2.0))
    assert total(one) != total(other)
    one.close()
    change(other, lambda: slide(other, "cv", 2.0))
    other.reload()
    answered(other, 1)
    other.close()
    assert process.ended() == (0, "")


def test_ctrl_c_ends_it_and_its_page_says_so(process, explore, tmp_path):
    page = explore(process.url)
    process.process.send_signal(signal.SIGINT)
    page.get_by_role("alert").wait_for()
    assert "fascicle explore" in page.get_by_role("alert").inner_text()
    status, said = process.ended()
    assert (status, said) == (130, "")
    log, token = (tmp_path / "log").read_text(), process.url.split("/")[-2]
    assert "exploring at http://127.0.0.1:" in log
    assert token not in log


class Slow(Session):
    """A session whose answers take ten minutes, longer than a test waits."""

    def answer(self, message, report=None):
        for k in range(6000):
            time.sleep(0.1)
            report(packed({"progress": f"step {k}"}, {}))
        return super().answer(message, report)


SCRIPT = """
import sys
sys.path.insert(0, {folder!r})
from test_explorer_page import Slow
import fascicle
from fascicle.explorer.explore import serve
serve(Slow(fascicle.ForwardModel("default")), browser=False)
"""


def begun(browser, url):
    """A page whose answer is being computed."""
    page = browser.new_page()
    page.goto(url)
    page.get_by_text("step 5").wait_for()
    return page


def test_it_ends_at_once_while_it_computes(browser, default_model, capfd):
    thread, url = served(Slow(default_model))
    begun(browser, url).close()
    thread.join(60)
    assert not thread.is_alive()
    assert capfd.readouterr().err == ""


def test_ctrl_c_ends_it_while_it_computes(browser):
    process = Process("-c", SCRIPT.format(folder=str(Path(__file__).parent)))
    page = begun(browser, process.url)
    process.process.send_signal(signal.SIGINT)
    page.close()
    _, said = process.ended()
    assert "ASGI" not in said
    assert "running task" not in said


def test_nobody_else_gets_in(url):
    own = url[: url.index("/", 8)]
    socket = url.replace("http", "ws") + "socket"
    for other in (f"{own}/", f"{own}/other/", f"{own}/other/viewer.js", f"{url}../x"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(other)
    stranger = urllib.request.Request(url, headers={"Host": "example.org"})
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(stranger)
    port = own.rpartition(":")[2]
    for origin in (None, "http://example.org", f"http://example.org:{port}", "null"):
        with pytest.raises(InvalidStatus, match="403"), connect(socket, origin=origin):
            pass
    with connect(socket, origin=own, max_size=None) as page:
        assert b'"sliders"' in page.recv()
        page.send(json.dumps({"id": 1, "state": {"values": {}}}))
        assert b"missing parameters" in page.recv()


def test_damaged_messages_are_answered_in_a_line(session, url, capfd):
    own = url[: url.index("/", 8)]
    nested, long = "[" * 10**5, json.dumps({"state": {"values": {}, "scenario": "x" * 2**21}})
    with connect(f"{url.replace('http', 'ws')}socket", origin=own, max_size=None) as page:
        page.recv()
        for damaged in ("{x", "", "3", "[1]", '{"state": 3}', b"\0\xff", "1" * 5000, nested, long):
            page.send(damaged)
            assert b"the page sent a damaged message; reload the page" in page.recv()
        page.send(json.dumps({"id": float("nan"), "state": {"values": session.start}}))
        assert b'{"id": null, "qrs": ' in page.recv()
    assert capfd.readouterr().err == ""


def test_a_port_that_is_taken_is_said(url, monkeypatch, capsys):
    from tests.cli.conftest import exit_status  # the script above cannot import it

    monkeypatch.setattr("fascicle.explorer.explore.session_of", None)  # refused before the work
    port = url[: url.index("/", 8)].rpartition(":")[2]
    assert exit_status("explore", "default", "--port", port) == 2
    assert f"port {port}" in capsys.readouterr().err.splitlines()[-1]


def test_the_heart_follows_its_number(atlas_model, explore):
    """What was clicked in one heart of an atlas is no part of another."""
    session = Session(atlas_model)
    thread, url = served(session)
    page = explore(url)
    vertices = np.unique(atlas_model.heart.boundary[0])
    place = atlas_model.heart.vertices[vertices[0]].tolist()
    change(page, lambda: page.evaluate(f"explorer.change((s) => s.stimuli.push({place}))"))
    for number in (1, 0):

        def choose(number=number):
            page.locator("[data-name=atlas_heart] input[type=range]").evaluate(
                "(e, v) => { e.value = v; e.dispatchEvent(new Event('change')) }", number
            )

        change(page, choose)
        assert page.evaluate("explorer.state.stimuli") == []
        drawn = page.evaluate(
            "Array.from(explorer.heart.mesh.geometry.getAttribute('position').array)"
        )
        own = atlas_model.of_heart({"atlas_heart": float(number)}).heart.vertices[vertices]
        np.testing.assert_allclose(np.reshape(drawn, (-1, 3)), own, rtol=1e-5)
        middle = page.evaluate("explorer.stage.centre.toArray()")
        assert np.linalg.norm(middle - own.mean(axis=0)) < 20  # mm; the hearts are 30 apart
        assert page.evaluate("explorer.status.textContent") == ""
    page.close()
    thread.join(60)
