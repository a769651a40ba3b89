"""Many patients: what is wrong with one does not stop the others, and all goes on where it was."""

import csv
import json
import multiprocessing
import re

import numpy as np
import pytest

import fascicle
from fascicle.core.errors import OutputError
from fascicle.patients import cohort as cohort_module
from fascicle.patients import patient
from fascicle.patients.cohort import answer, write_overview
from fascicle.patients.patient import Outcome, Status, read_table
from fascicle.study.study import study_lock

FORK = multiprocessing.get_context("fork")


@pytest.fixture(autouse=True)
def fits(monkeypatch):
    """Make reports short, and give the studies that are fitted."""
    found = []
    really = patient.fit_inputs

    def fit(inputs, folder, *others):
        found.append(folder.name)
        return really(inputs, folder, *others)

    monkeypatch.setattr(patient, "fit_inputs", fit)
    monkeypatch.setattr(patient, "report", lambda fitted, out, progress: out.write_text("report"))
    return found


def results(folder):
    with (folder / "results.csv").open() as file:
        return {row["patient"]: row for row in csv.DictReader(file)}


def statuses(outcomes):
    return {outcome.patient: str(outcome.status) for outcome in outcomes}


def test_a_bad_file_stops_nobody_and_all_goes_on(table, tmp_path, fits):
    out = tmp_path / "out"
    found = fascicle.cohort(table("anna", "bert", "carl"), out)
    assert statuses(found) == {"anna": "fitted", "bert": "failed", "carl": "fitted"}
    assert fits == ["anna", "carl"]
    written = results(out)
    assert "bert.nc: not a readable netCDF file" in written["bert"]["reason"]
    for name in ("anna", "carl"):
        study = fascicle.load_study(out / "studies" / name)
        row = written[name]
        assert float(row["best_loss_mV2"]) == study.population.best_loss
        values = study.population.values["cv"]
        expected = np.percentile(values, [50, 5, 95])
        assert [float(row[k]) for k in ("cv", "cv_5", "cv_95")] == pytest.approx(expected)
    page = (out / "index.html").read_text()
    assert re.findall(r'href="(.*?)"', page) == [
        "studies/anna/report.html", "studies/carl/report.html", "results.csv",
    ]  # fmt: skip
    assert "2 of 3 patients fitted; 1 failed" in page
    # again: those that are done are left as they are, whatever failed is tried again
    del fits[:]
    (out / "index.html").unlink()
    before = (out / "studies" / "anna" / "report.html").stat().st_mtime_ns
    again = fascicle.cohort(table("anna", "carl"), out)
    assert again == [found[0], found[2]]
    assert fits == []
    assert (out / "studies" / "anna" / "report.html").stat().st_mtime_ns == before
    assert "2 of 2 patients fitted" in (out / "index.html").read_text()
    # another seed is another study
    (refused,) = fascicle.cohort(table("anna", seed="7"), out)
    assert "holds another study (seed: there 0, now 7)" in refused.reason
    assert results(out)["anna"]["verdict"] == ""
    assert fascicle.cohort(table("anna"), out)[0].status is Status.FITTED
    # more networks are the same study, which goes on
    del fits[:]
    assert fascicle.cohort(table("anna", samples="3"), out)[0].status is Status.FITTED
    assert fits == ["anna"]


def test_what_is_missing_or_impossible_is_said_before_anything_is_fitted(
    table, ventricles, tmp_path, fits
):
    (tmp_path / "s.toml").write_text("effective = 100\n")
    path = table("anna", "none", settings="")
    text = path.read_text().splitlines()
    text[1] = text[1].removesuffix(",") + ",s.toml"
    text.append(text[1].replace("anna", "heart", 1).replace(str(ventricles), "nowhere"))
    path.write_text("\n".join(text))
    found = []
    for outcome in cohort_module.outcomes(path, tmp_path / "out"):
        found.append(outcome.reason)
        assert fits == []
    assert "the method 'paper' has no such setting" in found[0]
    assert "none.nc: no such file" in found[1]
    assert "nowhere: not a heart folder" in found[2]


def test_a_bug_is_loud_and_stops_nobody(table, tmp_path, monkeypatch):
    really = patient.read_target

    def read(path):
        if path.stem == "anna":
            raise ZeroDivisionError("one\ntwo")
        return really(path)

    monkeypatch.setattr(patient, "read_target", read)
    one, other = fascicle.cohort(table("anna", "carl"), tmp_path / "out")
    error = tmp_path / "out" / "patients" / "anna" / "error.txt"
    assert one.reason == f"bug: ZeroDivisionError: one two (traceback in {error})"
    assert error.read_text().startswith("Traceback")
    assert "in read\n" in error.read_text()
    assert other.status is Status.FITTED
    monkeypatch.setattr(patient, "read_target", really)
    (mended,) = fascicle.cohort(table("anna"), tmp_path / "out")
    assert mended.status is Status.FITTED
    assert not error.exists()


def test_interrupted_it_goes_on(table, tmp_path, monkeypatch, fits):
    path, out = table("anna", "carl"), tmp_path / "out"

    def interrupted(stage, done, total, message):
        if fits == ["anna", "carl"]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fascicle.cohort(path, out, progress=interrupted)
    assert "1 of 2 patients fitted; 1 not done yet" in (out / "index.html").read_text()
    del fits[:]
    assert statuses(fascicle.cohort(path, out)) == {"anna": "fitted", "carl": "fitted"}
    assert fits == ["carl"]


def test_parts_at_the_same_time_leave_the_whole(table, tmp_path):
    """Each process writes its own patients, and whoever ends last a page of all."""
    path, out = table("anna", "bert", "carl"), tmp_path / "out"
    processes = [
        FORK.Process(target=fascicle.cohort, args=(path, out), kwargs={"only": f"{i}/3"})
        for i in (1, 2, 3)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
        assert process.exitcode == 0
    found = {name: row["status"] for name, row in results(out).items()}
    assert found == {"anna": "fitted", "bert": "failed", "carl": "fitted"}
    alone = tmp_path / "alone"
    fascicle.cohort(path, alone, only="1/3")
    one, other = (fascicle.load_study(each / "studies" / "anna") for each in (out, alone))
    for key, values in one.population.values.items():
        np.testing.assert_array_equal(values, other.population.values[key])


def test_a_patient_who_is_done_while_the_page_is_written_is_on_it(table, tmp_path, monkeypatch):
    patients = read_table(table("anna", "carl"), tmp_path)
    really, late = cohort_module.write_text, []

    def write(path, text):
        if path.name == "index.html" and not late:
            late.append(patients[1].failed("it came late"))
        really(path, text)

    monkeypatch.setattr(cohort_module, "write_text", write)
    write_overview(tmp_path, tmp_path / "t.csv", patients)
    assert late
    assert "it came late" in (tmp_path / "index.html").read_text()
    assert results(tmp_path)["carl"]["reason"] == "it came late"


def test_a_patient_whom_another_process_fits_is_left_to_it(table, tmp_path, fits):
    out = tmp_path / "out"
    folder = out / "patients" / "anna"
    with study_lock(folder):

        def other_thread():
            return fascicle.cohort(table("anna", "carl"), out)

        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(1) as pool:
            held, fitted = pool.submit(other_thread).result()
    assert held.status is Status.NOT_DONE
    assert "another process is working on this study" in held.reason
    assert fitted.status is Status.FITTED
    assert not (folder / "outcome.json").exists()
    assert fits == ["carl"]


def test_progress_counts_patients_and_not_those_that_were_done(table, tmp_path):
    seen = []
    path, out = table("anna", "carl"), tmp_path / "out"
    fascicle.cohort(path, out, only="1/2")
    fascicle.cohort(path, out, progress=lambda *news: seen.append(news))
    counted = [(done, total, what) for stage, done, total, what in seen if stage == "patients"]
    assert counted == [(1, 2, ""), (1, 2, "carl"), (2, 2, "")]
    assert {"initial", "networks"} <= {stage for stage, *_ in seen}


def test_a_folder_that_is_something_else(table, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("x")
    with pytest.raises(OutputError, match="thesis"):
        fascicle.cohort(table("anna"), tmp_path / "out")


def test_the_answer_counts_every_kind():
    def of(**what):
        return Outcome(patient="a", **{"status": Status.FITTED} | what)

    outcomes = [
        of(converged=True, explained=True), of(converged=True, explained=False),
        of(converged=False, explained=True), of(converged=False, explained=False), of(),
        of(status=Status.FAILED), of(status=Status.NOT_DONE),
    ]  # fmt: skip
    assert answer(outcomes) == (
        "5 of 7 patients fitted: 1 converged and explained, 2 not converged, "
        "1 converged but not explained; 1 failed; 1 not done yet"
    )
    assert [each.trustworthy for each in outcomes] == [True, *[False] * 6]


def test_names_cannot_write_the_page(tmp_path, table):
    patients = read_table(table("anna"), tmp_path)
    patients[0].failed("<script>alert(1)</script>")
    write_overview(tmp_path, tmp_path / "<b>.csv", patients)
    page = (tmp_path / "index.html").read_text()
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "<b>" not in page


def test_outcomes_of_another_version_are_made_again(tmp_path, table):
    (one,) = read_table(table("anna"), tmp_path)
    one.failed("x")
    content = json.loads((one.folder / "outcome.json").read_text()) | {"unknown": 1}
    (one.folder / "outcome.json").write_text(json.dumps(content))
    assert one.outcome.status is Status.NOT_DONE
