"""The demonstration."""

import json

import pytest

pytestmark = pytest.mark.slow


def test_the_demonstration_explains_a_beat_names_a_block_and_ends_with_a_report(run, tmp_path):
    """By how much pacing shortens activation in truth lies within the intervals."""
    ended = run("demo", "--out", tmp_path / "demo")
    assert ended.status == 0
    lines = ended.out.splitlines()
    assert lines[0].split(maxsplit=2)[2].startswith("converged; fit acceptable: 9")
    (first,) = [line for line in lines if line.startswith("result")]
    assert first.partition("result")[2].strip().startswith("left bundle branch block: 0.")
    assert "; converged; fit acceptable: " in first
    page = tmp_path / "demo" / "report.html"
    assert ended.out.rstrip().endswith(page.resolve().as_uri())
    gains = ended.out.split("total activation time against intrinsic:\n")[1]
    names = [line.split()[0] for line in gains.splitlines()[:3]]
    assert names == ["his-pacing", "left-bundle-branch-pacing", "biventricular-pacing"]
    truths = [float(text.split()[0]) for text in gains.splitlines()[3].split(" by ")[1:]]
    for line, truth in zip(gains.splitlines(), truths, strict=False):
        low, high = line.split("CrI ")[1].split(")")[0].split(" to ")
        assert float(low) <= truth <= float(high)
    pacings = tmp_path / "demo" / "pacings"
    assert {p.name for p in pacings.iterdir() if p.is_dir()} == {"intrinsic", *names}
    assert (tmp_path / "demo" / "figures" / "ecg.png").exists()
    summary = json.loads((tmp_path / "demo" / "study" / "summary.json").read_text())
    assert summary["conduction_states"]["left bundle branch block"] > 0.5
