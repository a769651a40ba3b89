"""The demonstration."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow


def test_the_demonstration_explains_a_beat_names_a_block_and_ends_with_a_report(tmp_path):
    """By how much pacing shortens activation in truth lies within the intervals.

    In a process of its own, whose posteriors are not the small ones of other tests.
    """
    command = [sys.executable, "-m", "fascicle.cli", "demo", "--out", tmp_path / "demo"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = ended.stdout.splitlines()
    assert "conduction fixed at normal; converged; fit acceptable: 9" in lines[0]
    (first,) = [line for line in lines if line.startswith("result")]
    result = first.partition("result")[2].strip()
    assert result.startswith(("left bundle branch block: 0.", "left bundle branch block: 1.00"))
    assert "; converged; fit acceptable: " in first
    page = tmp_path / "demo" / "report.html"
    assert ended.stdout.rstrip().endswith(page.resolve().as_uri())
    gains = ended.stdout.split("total activation time against intrinsic:\n")[1]
    names = [line.split()[0] for line in gains.splitlines()[:3]]
    assert names == ["his-pacing", "left-bundle-branch-pacing", "biventricular-pacing"]
    truths = [float(text.split()[0]) for text in gains.splitlines()[3].split(" by ")[1:]]
    for line, truth in zip(gains.splitlines(), truths, strict=False):
        low, high = line.split("CrI ")[1].split(")")[0].split(" to ")
        assert float(low) <= truth <= float(high)
    pacings = tmp_path / "demo" / "pacings"
    assert {p.name for p in pacings.iterdir() if p.is_dir()} == {"intrinsic", *names}
    assert (tmp_path / "demo" / "target.png").exists()
    summary = json.loads((tmp_path / "demo" / "study" / "summary.json").read_text())
    assert summary["conduction_states"]["left bundle branch block"] > 0.5
