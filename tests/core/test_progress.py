"""Progress of long computations."""

from fascicle.core import progress


def test_one_estimate_for_a_run_of_several_stages(monkeypatch):
    now, reports = [0.0], []
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    run = progress.WholeRun(lambda *report: reports.append(report))
    run("reading", 1, 1, "")  # not expected: reported as it is
    run.expect([("lead fields", 50.0), ("simulations", 20.0), ("training", 10.0)], 30.0)
    now[0] = 20.0
    run("simulations", 5, 10, "")  # with 10 s at the usual pace, 30 s for what usually takes 20
    run.expect([("training", 10.0)], message="normal")
    now[0] = 50.0
    run("training", 10, 10, "")
    run.end()
    whole = [report[1:] for report in reports if report[0] == "whole run"]
    assert whole == [(20, 95, ""), (50, 50, "normal"), (50, 50, "")]
    stages = [stage for stage, *_ in reports if stage != "whole run"]
    assert stages == ["reading", "simulations", "training"]


def test_a_note_is_said_at_once():
    said = []
    lines = progress.ProgressLines(said.append)
    lines("resuming", 1, 1, "what is stored is not simulated again")
    lines("training", 1, 1, "of an emulator")  # nothing to wait for
    lines.end()
    assert said == ["resuming: what is stored is not simulated again"]
