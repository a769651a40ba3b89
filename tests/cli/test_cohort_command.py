"""`fascicle cohort`: its exit statuses, and what it prints."""

import json

import pytest

from fascicle.core.errors import InputError
from fascicle.patients import patient
from fascicle.patients.patient import Outcome, Status

HEAD = "patient,heart,recording\n"


@pytest.fixture
def fitted(monkeypatch):
    """Fit patients at once: 'bad' has a bad file, 'bug' meets a bug, 'stop' is interrupted."""

    def inputs(row):
        if row.name == "bad":
            raise InputError("bad.csv: is bad; mend it")
        if row.name == "bug":
            raise ZeroDivisionError("one over none")
        if row.name == "stop":
            raise KeyboardInterrupt

    def is_done(one, inputs):
        found = Outcome(
            patient=one.name, status=Status.FITTED, verdict="converged; explained", converged=True,
            explained=True, explained_power=0.9,
        )  # fmt: skip
        one.ended(found)
        return True

    monkeypatch.setattr(patient, "_inputs", inputs)
    monkeypatch.setattr(patient, "_is_done", is_done)
    monkeypatch.setattr(patient.Patient, "check", lambda one: None)


@pytest.fixture
def table(tmp_path):
    def write(*names):
        path = tmp_path / "t.csv"
        path.write_text(HEAD + "".join(f"{name},default,{name}.nc\n" for name in names))
        return path

    return write


def test_all_are_fitted(run, fitted, table, tmp_path):
    ended = run("cohort", table("anna", "carl"), "--out", tmp_path / "o")
    assert (ended.status, ended.err) == (0, "")
    first, _, count, page = ended.out.splitlines()
    assert first == "anna             converged; explained"
    assert count == "2 of 2 patients fitted"
    assert page == (tmp_path / "o" / "index.html").as_uri()
    assert "verdict good" in (tmp_path / "o" / "index.html").read_text()


def test_some_are_not(run, fitted, table, tmp_path):
    log, out = tmp_path / "log", tmp_path / "o"
    ended = run("cohort", table("bad", "anna", "bug"), "--out", out, "--log", log)
    assert ended.status == 1
    lines = ended.out.splitlines()
    assert lines[0] == "bad              FAILED: bad.csv: is bad; mend it"
    assert lines[2].startswith("bug              FAILED: bug: ZeroDivisionError: one over none (")
    assert lines[3:5] == [
        "1 of 3 patients fitted", f"2 not fitted: the reasons are in {out / 'results.csv'}",
    ]  # fmt: skip
    assert ended.err.startswith("Traceback")
    assert "ZeroDivisionError: one over none" in log.read_text()
    assert "verdict doubt" in (out / "index.html").read_text()
    ended = run("cohort", table("bad", "anna", "bug"), "--out", out, "--json", "--only", "1/3")
    assert ended.status == 1
    (found,) = json.loads(ended.out)["patients"]
    assert (found["patient"], found["status"]) == ("bad", "failed")


def test_a_wrong_table_stops_before_any_work(refused, fitted, table, tmp_path):
    out = tmp_path / "o"
    refused(["cohort", table("anna", "anna"), "--out", out], "line 3", "is there twice")
    refused(["cohort", table("anna"), "--out", out, "--only", "3/2"], "give i/n")
    assert not out.exists()


def test_interrupted(run, fitted, table, tmp_path):
    ended = run("cohort", table("anna", "stop"), "--out", tmp_path / "o")
    assert ended.status == 130
    assert ended.err.startswith("interrupted; simulations are stored in")
    assert "1 not done yet" in (tmp_path / "o" / "index.html").read_text()
