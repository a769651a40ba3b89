"""What the explorer answers is what the forward model gives, or one line of what is wrong."""

import asyncio
import json
import re
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Queue
from types import SimpleNamespace
from unittest.mock import AsyncMock

import numpy as np
import pytest
from builders import recorded
from starlette.websockets import WebSocketDisconnect
from websockets.sync.client import connect

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.parameters import HUMAN_SPACE, ParameterSpace, free, read_parameters
from fascicle.explorer.explore import Application, in_thread, serve, session_of
from fascicle.explorer.session import PageState, Session, _spoken
from fascicle.forward.scenario_files import read_scenario
from fascicle.forward.simulation_files import write_ecg
from fascicle.networks.prior import Prior
from fascicle.networks.target_comparison import TargetComparison
from fascicle.recording.pipeline import analyse
from fascicle.study.population import Population


@pytest.fixture(scope="module")
def session(default_model):
    return Session(default_model)


def opened(answer):
    """JSON and arrays of an answer."""
    size = int.from_bytes(answer[:4], "little")
    said = json.loads(answer[4 : 4 + size])
    arrays = {}
    for name, place in said.pop("arrays").items():
        count = int(np.prod(place["shape"]))
        part = np.frombuffer(answer, place["type"], count, 4 + size + place["at"])
        arrays[name] = part.reshape(place["shape"])
    assert (4 + size) % 4 == 0  # arrays of a browser begin there only
    return said, arrays


def ask(session, **state):
    return opened(session.answer({"id": 7, "state": {"values": session.start, **state}}))


def nearest_branch(simulation, side=0):
    """A place within the bundle of a tree."""
    tree = simulation.trees[side]
    return tree.nodes[np.flatnonzero(tree.parts["bundle"])[10]].tolist()


def test_it_describes_the_surface_and_the_sliders(session):
    said, arrays = opened(session.description())
    heart = session.model.heart
    triangles = arrays["triangles"]
    assert len(triangles) == len(heart.boundary[0])
    shown = np.unique(heart.boundary[0])
    np.testing.assert_allclose(arrays["vertices"], heart.vertices[shown], rtol=1e-6)
    # the endocardial triangles come first, and no other lies on an endocardium
    inside = {tuple(p) for e in heart.endocardia for p in e.vertices.astype("<f4").tolist()}
    on = [[tuple(p) in inside for p in arrays["vertices"][t].tolist()] for t in triangles]
    lined = np.all(on, axis=1)
    assert lined[: said["endocardial"]].mean() > 0.99
    assert lined[said["endocardial"] :].mean() < 0.05
    groups = {group["name"]: group["sliders"] for group in said["groups"]}
    assert [*groups] == ["network", "growth and junctions", "tissue", "torso"]
    names = [each["name"] for each in groups["network"]]
    assert {"lv_initial_length", "interventricular_delay", "cv", "fibre_speed"} <= {*names}
    for each in (each for sliders in groups.values() for each in sliders):
        value = said["start"].get(each["name"], each["value"])
        assert each["low"] <= value <= each["high"], each["name"]
    (ratio,) = (e["value"] for e in groups["tissue"] if e["name"] == "anisotropy_ratio")
    assert ratio == pytest.approx(2.5, abs=0.1)
    assert said["networks"] == []


def test_an_answer_is_what_simulate_gives(session):
    assert PageState(values={}).beat() is None  # no scenario, of an intrinsic beat
    values = {**session.start, "cv": 2.4, "interventricular_delay": -20.0}
    said, arrays = ask(session, values=values)
    expected = session.model.simulate(values)
    begin = expected.activation.min()
    shown = np.unique(session.model.heart.boundary[0])
    np.testing.assert_allclose(arrays["activation"], expected.activation[shown] - begin, atol=1e-4)
    np.testing.assert_allclose(arrays["simulated"], expected.leads[:12], atol=1e-6)
    for tree, times in zip(expected.trees, expected.coupled.trees, strict=True):
        np.testing.assert_allclose(arrays[f"{tree.side}_nodes"], tree.nodes, rtol=1e-6)
        np.testing.assert_allclose(arrays[f"{tree.side}_times"], times - begin, atol=1e-4)
    assert said["id"] == 7
    assert said["total"] == pytest.approx(expected.total_activation_time)
    assert said["qrs"] == expected.qrs_duration
    assert said["axis"] == pytest.approx(expected.frontal_axis)
    values = session.start | {"retrograde_delay": np.inf}
    assert _spoken(values)["retrograde_delay"] == "Infinity"
    said, _ = ask(session, values=_spoken(values))
    expected = session.model.simulate(values)
    assert said["total"] == pytest.approx(expected.total_activation_time)
    assert (
        "retrograde_delay = inf"
        in session.files(PageState.of({"values": values}))["parameters.toml"]
    )


def test_the_networks_of_a_study_are_there(session):
    each = [{**session.start, "cv": cv} for cv in (2.2, 2.4, 3.0)]
    learnt = {name: np.array([e[name] for e in each]) for name in HUMAN_SPACE.names}
    fixed = {name: value for name, value in session.start.items() if name not in learnt}
    fixed["retrograde_delay"] = np.inf
    simulator = SimpleNamespace(prior=Prior(HUMAN_SPACE, fixed), model=session.model)
    population = Population(learnt, np.arange(3.0), each[1], 0.5)
    study = SimpleNamespace(
        simulator=simulator, population=population, verdict="converged", gains=np.full(3, 1.5),
        torsos=np.array([np.eye(12), 2 * np.eye(12), np.eye(12)[::-1]]),
    )  # fmt: skip
    of_study = Session(session.model, study=study)
    said, _ = opened(of_study.description())
    assert said["verdict"] == "converged"
    assert [network["cv"] for network in said["networks"]] == [2.2, 2.4, 3.0]
    sliders = {e["name"]: e for group in said["groups"] for e in group["sliders"]}
    assert sum(sliders["cv"]["posterior"]) == 3
    assert sliders["branch_length"]["posterior"] is None
    shown, _ = ask(session, values=said["networks"][2])
    expected = session.model.simulate(each[2] | {"retrograde_delay": np.inf})
    assert shown["total"] == pytest.approx(expected.total_activation_time)
    recording = TargetComparison(recorded(expected))
    with_recording = replace(of_study, recording=recording)
    for k, torso in ((None, np.eye(12)), (1, 3 * np.eye(12)), (2, 1.5 * np.eye(12)[::-1])):
        _, arrays = ask(with_recording, values=said["networks"][2], network=k)
        leads = torso @ expected.leads[:12]
        under = recording.predicted(leads, recording.align(leads))
        np.testing.assert_allclose(arrays["simulated"], under, atol=1e-6)


@pytest.mark.slow
def test_electrodes_are_moved_on_the_skin(torso_model):
    session = Session(torso_model)
    plain = ask(session)[1]
    np.testing.assert_allclose(
        plain["electrodes"], torso_model.heart.electrode_positions, atol=1e-3
    )
    values = session.start | {"v2_left": 10.0}
    moved = ask(session, values=values)[1]
    expected = torso_model.simulate(values)
    np.testing.assert_allclose(moved["simulated"], expected.leads[:12], atol=1e-6)
    away = np.linalg.norm(moved["electrodes"] - plain["electrodes"], axis=1)
    assert away[4] == pytest.approx(10, abs=1.5)
    assert np.delete(away, 4).max() < 0.01
    place = torso_model.heart.vertices[0].tolist()
    said, _ = ask(session, values=values, scars=[place])
    assert "undo one of them" in said["error"]


@pytest.mark.slow
def test_progress_of_long_preparations_is_reported(default_model, monkeypatch):
    def torso(wanted, progress=None):
        progress("torso response", 1, 4, "once for a heart")
        time.sleep(3.2)
        raise InputError("no torso here")

    monkeypatch.setattr(default_model, "torso", torso)
    session, told = Session(default_model), []
    state = {"values": session.start | {"heart_up": 3.0}}
    said, _ = opened(session.answer({"id": 1, "state": state}, told.append))
    assert said["error"] == "no torso here"
    assert "torso response 1/4" in opened(told[0])[0]["progress"]


def test_the_criteria_count_along_once_the_hand_rests(session):
    message = {"id": 1, "state": {"values": session.start | {"conduction": 1.0}}}
    assert "criteria" not in opened(session.answer({**message, "moving": True}))[0]
    said, _ = opened(session.answer(message))
    expected = session.model.simulate(message["state"]["values"]).conventional_criteria
    assert said["criteria"] == [each.name for each in expected if each.met]


def test_paced_places_activate_first_and_blocked_branches_delay_what_lies_behind(session):
    place = session.model.heart.vertices[np.unique(session.model.heart.boundary[0])[200]].tolist()
    said, arrays = ask(session, stimuli=[place])
    assert arrays["activation"][200] == 0
    roots = [arrays[f"{side}_times"][0] for side in ("lv", "rv")]
    assert min(roots) > 1  # entered from the tissue
    assert said["total"] > ask(session)[0]["total"]
    place = nearest_branch(session.model.simulate(session.start))
    before, after = ask(session), ask(session, blocks=[["lv", place]])
    assert after[0]["total"] > before[0]["total"] + 5
    assert after[1]["lv_times"].max() > before[1]["lv_times"].max() + 5


def test_a_scar_is_never_activated_and_simulated_again_from_its_file(session, tmp_path):
    heart = session.model.heart
    place = heart.vertices[np.unique(heart.boundary[0])[300]].tolist()
    said, arrays = ask(session, scars=[place])
    assert not np.isfinite(arrays["activation"][300])
    assert np.isfinite(arrays["activation"]).mean() > 0.9
    files = session.files(PageState(values=session.start, scars=[place]))
    (tmp_path / "scenario.toml").write_text(files["scenario.toml"])
    scenario, regions = read_scenario(tmp_path / "scenario.toml")
    again = session._scarred(session.model, regions)  # prepared above, if the regions are the same
    assert again.conduction.regions == regions
    expected = again.simulate(session.start, scenario)
    assert said["total"] == pytest.approx(expected.total_activation_time)
    np.testing.assert_allclose(arrays["simulated"], expected.leads[:12], atol=1e-6)


def test_files_repeat_the_state_and_a_scenario_keeps_what_is_blocked(session, tmp_path):
    name, scenario = "rv-apical-pacing", fascicle.read_scenarios("rv-apical-pacing")
    values = {**session.start, "conduction": 1.0}
    said, _ = ask(session, values=values, scenario=name)
    expected = session.model.simulate(values, scenario[name])
    assert said["total"] == pytest.approx(expected.total_activation_time)
    place = session.model.heart.vertices[50].tolist()
    branch = nearest_branch(session.model.simulate(session.start))
    state = {"values": {**session.start, "cv": 2.2}, "stimuli": [place], "blocks": [["lv", branch]]}
    said, _ = opened(session.answer({"id": 0, "ask": "files", "state": state}))
    for name, text in said["files"].items():
        (tmp_path / name).write_text(text)
    scenario, _ = read_scenario(tmp_path / "scenario.toml")
    found = session.model.simulate(read_parameters(tmp_path / "parameters.toml"), scenario)
    again, _ = ask(session, **state)
    assert again["total"] == pytest.approx(found.total_activation_time)


def test_a_recording_lies_under_the_simulation(default_model, tmp_path):
    values = fascicle.example_parameters(default_model)
    write_ecg(tmp_path / "ecg.csv", default_model.simulate(values).ecg)
    recording = fascicle.read_recording(tmp_path / "ecg.csv")
    target = analyse(recording, fascicle.TargetOptions(noise=0.02)).target
    session = Session(default_model, TargetComparison(target))
    said, arrays = ask(session)
    assert said["explained"] > 0.99
    difference = arrays["simulated"] - arrays["recorded"]
    assert np.linalg.norm(difference) < 0.1 * np.linalg.norm(arrays["recorded"])
    # both on the clock of the first activation: the simulation's own first sample
    aligned = said["ecg_start"] + np.abs(arrays["recorded"]).sum(axis=0).argmax()
    alone, of_it = ask(Session(default_model))
    own = alone["ecg_start"] + np.abs(of_it["simulated"]).sum(axis=0).argmax()
    assert abs(aligned - own) < 1.5


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (3, "a damaged message"),
        ({"state": {"values": {"cv": "fast"}}}, "state: 'values.cv'"),
        ({"state": {"values": {}, "other": 1}}, "state: 'other'"),
        ({"state": {"values": {"cv": 3.0}}}, "missing parameters"),
        ({"state": {"values": {"xyz": 3.0}}}, "xyz"),
        ({"state": {"values": {}, "scenario": "/etc/passwd"}}, "not in the library"),
        ({"state": {"values": {}, "stimuli": [[0, 0, 1e9]]}}, "stimuli.0.2"),
    ],
)
def test_what_cannot_be_simulated_is_said_in_a_line(session, message, words):
    said, arrays = opened(session.answer(message))
    assert words in said["error"]
    assert "\n" not in said["error"]
    assert arrays == {}


def test_what_does_not_fit_the_heart_is_said(session, tmp_path):
    assert "stimulus" in ask(session, stimuli=[[9e3, 0, 0]])[0]["error"]
    values = {**session.start, "lv_initial_length": 400.0}
    error = ask(session, values=values)[0]["error"]
    assert error.startswith("LV bundle leaves the endocardium after")
    assert error.endswith("; shorten it, or undo the last change")
    with pytest.raises(fascicle.InputError, match="no such heart folder"):
        session_of(tmp_path / "none", None, None)
    with pytest.raises(fascicle.InputError, match="target"):
        session_of("default", 3, None)


def test_a_page_that_closes_while_it_is_answered_is_no_error(session, monkeypatch):
    errors, answer = [], Queue()
    monkeypatch.setattr("threading.excepthook", errors.append)

    async def closed():
        with suppress(TimeoutError):
            await asyncio.wait_for(in_thread(answer.get), 0.1)
        answer.put(b"")
        await asyncio.sleep(0.1)

    asyncio.run(closed())
    assert errors == []
    application, host = Application(session, 1), "127.0.0.1:1"
    page = AsyncMock(headers={"origin": f"http://{host}", "host": host})
    page.receive.side_effect = partial(asyncio.sleep, 60)
    page.send_bytes.side_effect = WebSocketDisconnect
    asyncio.run(application.socket(page))
    assert (page.send_bytes.await_count, application.pages) == (1, 0)


def test_a_browser_in_the_foreground_is_served_and_not_told_the_token(session, monkeypatch):
    opened = []

    def foreground(address):  # returns when it is closed
        page = Path(address.removeprefix("file://"))
        url = re.search('url=(.*?)"', page.read_text())[1]
        with connect(f"{url.replace('http', 'ws')}socket", origin=url[: url.index("/", 8)]) as one:
            one.recv()
        modes = [oct(path.stat().st_mode & 0o777) for path in (page.parent, page)]
        opened.append((page, url.split("/")[-2], modes))

    monkeypatch.setattr("webbrowser.open", foreground)
    serve(session)
    ((page, token, modes),) = opened
    assert token not in str(page)
    assert modes == ["0o700", "0o600"]
    assert not page.parent.exists()


class TestHeartsOfAnAtlas:
    @pytest.fixture(scope="class")
    def session(self, atlas_model):
        return Session(atlas_model)

    def test_an_answer_is_on_the_heart_of_its_values(self, session):
        shown = np.unique(session.model.heart.boundary[0])
        said, arrays = opened(session.description())
        np.testing.assert_allclose(arrays["vertices"], session.model.heart.vertices[shown], 1e-6)
        groups = {group["name"]: group["sliders"] for group in said["groups"]}
        assert "torso" not in groups
        (slider,) = groups["heart"]
        assert [slider[key] for key in ("name", "low", "high", "step")] == ["atlas_heart", 0, 1, 1]
        for number in (0.0, 1.0):
            values = session.start | {"atlas_heart": number}
            said, arrays = ask(session, values=values)
            own = session.model.of_heart(values)
            np.testing.assert_allclose(arrays["vertices"], own.heart.vertices[shown], rtol=1e-5)
            np.testing.assert_allclose(arrays["electrodes"], own.heart.electrodes, rtol=1e-6)
            expected = session.model.simulate(values)
            assert said["total"] == pytest.approx(expected.total_activation_time)
            np.testing.assert_allclose(arrays["lv_nodes"], expected.trees[0].nodes, rtol=1e-5)

    def test_a_scar_lies_in_the_heart_that_was_clicked(self, session):
        values = session.start | {"atlas_heart": 1.0}
        heart = session.model.of_heart(values).heart
        place = heart.vertices[np.unique(heart.boundary[0])[0]].tolist()
        _, arrays = ask(session, values=values, scars=[place])
        unreached = ~np.isfinite(arrays["activation"])
        assert 0 < unreached.sum() < 0.2 * len(unreached)
        away = np.linalg.norm(arrays["vertices"] - place, axis=1)
        assert away[unreached].max() < 16  # mm, of a scar of 8 mm in elements of 8 mm

    def test_no_other_heart_is_there(self, session):
        for number, reason in (
            (2.0, "has hearts 0 to 1"),
            (-1.0, "atlas_heart"),
            (0.5, "whole number"),
        ):
            said, _ = ask(session, values=session.start | {"atlas_heart": number})
            assert reason in said["error"]

    def test_a_study_begins_with_the_heart_of_its_best_network(self, session):
        values = {"cv": np.array([2.2, 3.0])}
        best = session.start | {"atlas_heart": 1.0}
        population = Population(values | {"atlas_heart": np.array([0.0, 1.0])}, np.ones(2), best, 1)
        prior = Prior(ParameterSpace((free("cv"),)))
        study = SimpleNamespace(
            population=population, verdict="", gains=None, torsos=None,
            simulator=SimpleNamespace(prior=prior),
        )  # fmt: skip
        said, arrays = opened(Session(session.model, None, study).description())
        own = session.model.of_heart(best).heart
        shown = np.unique(own.boundary[0])
        np.testing.assert_allclose(arrays["vertices"], own.vertices[shown], rtol=1e-5)
        assert [network["atlas_heart"] for network in said["networks"]] == [0, 1]
