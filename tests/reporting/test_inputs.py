"""What the report says that a study was given, and the commands that make it again."""

from __future__ import annotations

import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.fits import demo_recording
from fascicle.core.quantities import QUANTITIES
from fascicle.forward.scenario_files import read_scenarios
from fascicle.networks.prior import growth_and_conduction, study_space
from fascicle.networks.settings import SETTINGS_OF, checked_settings
from fascicle.prediction.scenarios import with_intrinsic_beat
from fascicle.purkinje.growth import GrowthRules
from fascicle.recording.target_files import read_target
from fascicle.reporting.page.content import (
    commands,
    held,
    learnt,
    recordings,
    report_words,
    settings,
    target_words,
)
from fascicle.study.study import StudyConfig
from tests.cli.conftest import exit_status


@pytest.fixture(scope="module")
def made(default_heart, default_model, tmp_path_factory):
    """A study as far as inputs go, of settings and parameters."""

    def make(parameters, target=None, **given):
        folder = tmp_path_factory.mktemp("a study")
        checked = checked_settings(given)
        space, fixed = study_space(checked.method, parameters, default_heart)
        config = StudyConfig(
            heart="h", target="t", space=space.parameters, fixed=fixed,
            **growth_and_conduction(default_heart, GrowthRules()), **checked.model_dump(),
        )  # fmt: skip
        target = target or SimpleNamespace(provenance={})
        return SimpleNamespace(
            study=SimpleNamespace(config=config),
            simulator=SimpleNamespace(model=default_model),
            recordings=[SimpleNamespace(target=target)],
            folder=folder,
        )

    return make


@pytest.mark.parametrize(("method", "other"), [("posterior", "paper"), ("paper", "posterior")])
def test_only_the_method_s_settings_are_shown(made, method, other):
    shown = settings(made({}, method=method).study.config)
    assert shown.keys() >= {"method", "seed", *SETTINGS_OF[method]}
    assert not shown.keys() & {*SETTINGS_OF[other]}


def test_what_is_learnt_is_not_fixed_as_well(made, default_heart):
    given = {
        "branch_length": "free",
        "endocardial_layer": 1.5,
        "gain": {"lower": 0.5, "upper": 2.0},
    }
    fitted = made(given)
    known = {name: text for _, name, text in learnt(fitted.study.config)}
    fixed = {name: text for _, name, text in held(fitted) if name}
    assert known["fibre_speed"] == "uniform, 0.4 to 0.8 mm/ms"
    assert not {"alpha", "root_time"} & (known.keys() | fixed.keys())
    assert known["gain"] == "uniform, 0.5 to 2"
    assert not known.keys() & fixed.keys()
    assert known.keys() | fixed.keys() <= QUANTITIES.keys()
    assert fixed["endocardial_layer"] == "1.5 mm"
    assert fixed["repulsion"] == "0.1"
    called = [name for name, _, _ in held(fitted)]
    assert ("conductivity of the lungs" in called) == (default_heart.torso is not None)
    assert ("conductivity of the unbounded conductor" in called) == (default_heart.torso is None)
    for fixed, other in (("fibre_speed", "alpha"), ("alpha", "fibre_speed")):
        fitted = made({fixed: 0.07})
        names = [name for _, name, _ in (*held(fitted), *learnt(fitted.study.config))]
        assert fixed in names
        assert other not in names


def test_the_report_s_command_makes_the_page_again(made, tmp_path):
    target = SimpleNamespace(provenance={"source": "/tmp/a.hea", "beats_used": "9"})
    assert dict(recordings(made({}, target))) == {
        "recording": "/tmp/a.hea", "target": "beats_used: 9",
    }  # fmt: skip
    # With the file of a scenario of one's own, and names with spaces in quotes.
    path = tmp_path / "my case.toml"
    path.write_text("inactive_root = [{tree = 'rv'}]\n")
    found = {
        name: SimpleNamespace(scenario=scenario)
        for name, scenario in with_intrinsic_beat(read_scenarios(["his-pacing", path])).items()
    }
    words = report_words(SimpleNamespace(folder=tmp_path / "S"), found, "my case")
    assert words[:5] == ["fascicle", "report", str(tmp_path / "S"), "--scenario", "his-pacing"]
    assert words[5:] == ["--scenario", str(path), "--against", "my case"]


def test_the_target_s_command_makes_it_again(tmp_path, monkeypatch):
    """Every choice that its provenance records."""
    monkeypatch.setattr("fascicle.reporting.recording.recording_figure", lambda _: Figure((1, 1)))
    first, second = tmp_path / "first.nc", tmp_path / "second.nc"
    asked = [
        "--leads", "I,II,V1-V6", "--swap", "RA-LA", "--swap", "V1-V2", "--invert", "V3,V4",
        "--exclude-beat", "3", "--exclude-beat", "5-6", "--onset", "-52.5", "--lowpass", "120",
        "--notch", "50",
    ]  # fmt: skip
    assert exit_status("target", demo_recording(), "--out", first, *asked) == 0
    target = read_target(first)
    program, *words = target_words(target, str(second))
    assert (program, exit_status(*words)) == ("fascicle", 0)
    again = read_target(second)
    assert again.provenance == target.provenance
    np.testing.assert_array_equal(again.beats, target.beats)
    assert again.qrs_onset == -52.5
    assert "--offset" not in target_words(target, "t.nc")
    assert target_words(replace(target, provenance={"source": "in memory"}), "t.nc") == []


@pytest.mark.parametrize(
    ("parameters", "given"),
    [
        ({}, {}),
        (
            {
                "lv_fascicles": 3, "repulsion": "free", "pose": "free",
                "alpha": {"prior": "log-normal", "median": 0.07, "sd": 0.2},
                "root_time": {"lower": -120.0, "upper": 0.0}, "anterograde_delay": np.inf,
            },
            {"effective": 40, "gain_sd": 0.0, "seed": 7, "fewest_junctions": 20},
        ),
        (
            {
                "lv_fascicles": 2, "lv_fascicle_angle_2": "free", "rv_source": "free",
                "alpha": 0.071234567891, "interventricular_delay": {"lower": 3.0, "upper": 12.0},
            },
            {},
        ),
        ({"cv": 2.5}, {"method": "paper", "leads": "8", "steps": 10, "free_gain": True}),
    ],
)  # fmt: skip
def test_the_fit_s_command_gives_the_same_study(
    made, monkeypatch, tmp_path, default_heart, parameters, given
):
    fitted = made(parameters, **given)
    monkeypatch.chdir(tmp_path)
    asked = {}

    def note(heart, recordings, out, *, parameters, progress, pool, **settings):
        asked.update(heart=heart, out=out, parameters=parameters, settings=settings)
        raise RuntimeError("that is enough")

    monkeypatch.setattr("fascicle.fit", note)
    monkeypatch.setattr("fascicle.load_heart", lambda path, **person: path)
    *file, fit, report = commands(fitted, {}, "intrinsic")
    assert (file[0], file[-1]) == ("cat > settings.toml <<'END'", "END")
    (tmp_path / "settings.toml").write_text("\n".join(file[1:-1]))
    assert shlex.split(report) == ["fascicle", "report", str(fitted.folder)]
    with pytest.raises(RuntimeError, match="enough"):
        exit_status(*shlex.split(fit)[1:])
    config = fitted.study.config
    assert (asked["heart"], asked["out"]) == (str(fitted.folder / "heart"), fitted.folder)
    space, fixed = study_space(config.method, asked["parameters"], default_heart)
    assert set(space.parameters) == set(config.space)
    assert fixed == config.fixed
    settings = checked_settings(asked["settings"])
    chosen = settings.model_dump()
    assert chosen == config.model_dump(include=chosen.keys())


@pytest.mark.parametrize("changed", [{"growth_term": "steered"}, {"growth": {"branch_angle": 0.3}}])
def test_commands_say_that_growth_rules_came_from_python(made, changed):
    fitted = made({})
    assert commands(fitted, {}, "intrinsic")[0].startswith("cat")
    fitted.study.config = fitted.study.config.model_copy(update=changed)
    said = commands(fitted, {}, "intrinsic")[0]
    assert said.startswith("# The networks grew by rules given in Python (rules=, growth term")
