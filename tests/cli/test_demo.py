"""The demonstration, with a budget of seconds."""

from importlib import import_module

import pytest

pytestmark = pytest.mark.slow


def test_the_demonstration_ends_with_a_report_of_three_pacings(run, tmp_path, monkeypatch):
    small = {"initial": 40, "steps": 3, "samples": 3, "draws": 20_000, "rounds": 1, "tolerance": 1}
    demo = import_module("fascicle.cli.demo")  # `fascicle.cli.demo` itself is the command
    monkeypatch.setattr(demo, "SETTINGS", demo.SETTINGS | small)
    ended = run("demo", "--out", tmp_path / "demo")
    assert ended.status == 0
    page = tmp_path / "demo" / "report.html"
    assert ended.out.rstrip().endswith(page.resolve().as_uri())
    gains = ended.out.split("total activation time against left-bundle-branch-block:\n")[1]
    names = [line.split()[0] for line in gains.splitlines()[:3]]
    assert names == ["his-pacing", "left-bundle-branch-pacing", "biventricular-pacing"]
    assert "compared with left-bundle-branch-block" in page.read_text()
    assert {path.name for path in (tmp_path / "demo" / "pacings").iterdir() if path.is_dir()} == {
        "intrinsic", "left-bundle-branch-block", *names,
    }  # fmt: skip
    assert (tmp_path / "demo" / "figures" / "ecg.png").exists()
