"""What has become of all patients: a table of results, and one page that leads to every report."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from fascicle.core.files import write_text
from fascicle.patients.outcome import Outcome, Said, Status, as_row
from fascicle.patients.patient import REPORT, STUDIES, Patient

PAGE, RESULTS = "index.html", "results.csv"
TEMPLATE = "overview.html"


def write_overview(folder: Path, table: Path, patients: Sequence[Patient]) -> list[Outcome]:
    """Write table and page of what is there.

    Others may do so at the same time: where a patient was done meanwhile it is written again, so
    that whoever writes last leaves the whole.

    Parameters
    ----------
    folder : Path
        Of the cohort.
    table : Path
        Where its patients come from.
    patients : sequence of Patient
        All of them.
    """
    outcomes: list[Outcome] = []
    while (found := [patient.outcome for patient in patients]) != outcomes:
        outcomes = found
        write_text(folder / RESULTS, _results(patients, outcomes))
        write_text(folder / PAGE, _page(table, outcomes))
    return outcomes


def _results(patients: Sequence[Patient], outcomes: Sequence[Outcome]) -> str:
    """A row a patient, with empty cells for what it does not have."""
    rows = [
        as_row(outcome) | {"heart": patient.row.heart, "recording": patient.row.recording}
        for patient, outcome in zip(patients, outcomes, strict=True)
    ]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _page(table: Path, outcomes: Sequence[Outcome]) -> str:
    from jinja2 import Environment
    from markupsafe import Markup

    from fascicle import __version__

    own = files("fascicle")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string((own / "patients" / TEMPLATE).read_text(encoding="utf-8"))
    style = (own / "reporting" / "page" / "style.css").read_text(encoding="utf-8")
    fitted = [outcome for outcome in outcomes if outcome.status is Status.FITTED]
    names = list(dict.fromkeys(name for each in fitted for name in each.parameters))
    content: dict[str, Any] = {
        "version": __version__,
        "style": Markup(style),
        "table": table.name,
        "all": all(outcome.trustworthy for outcome in outcomes),
        "answer": answer(outcomes),
        "outcomes": outcomes,
        "parameters": [(name, _cells(name, fitted)) for name in names],
        "fitted": fitted,
        "report": lambda patient: f"{STUDIES}/{patient}/{REPORT}",
    }
    return template.render(content)


def answer(outcomes: Sequence[Outcome]) -> str:
    """What has become of all, in one line."""
    count = Counter(each.status for each in outcomes)
    posteriors = [each for each in outcomes if each.converged is not None]
    results = _counted(
        {
            "converged and explained": sum(each.trustworthy for each in posteriors),
            "not converged": sum(not each.converged for each in posteriors),
            "converged but not explained": sum(
                bool(each.converged) and not each.explained for each in posteriors
            ),
        }
    )
    others = _counted({"failed": count[Status.FAILED], "not done yet": count[Status.NOT_DONE]})
    fitted = f"{count[Status.FITTED]} of {len(outcomes)} patients fitted"
    return "; ".join([": ".join(filter(None, [fitted, ", ".join(results)])), *others])


def _counted(numbers: Mapping[str, int]) -> list[str]:
    return [f"{number} {what}" for what, number in numbers.items() if number]


def _cells(name: str, outcomes: Sequence[Outcome]) -> list[tuple[str, bool]]:
    """What is said of a parameter by each study, and whether the ECG determines it."""
    found = [outcome.parameters.get(name) for outcome in outcomes]
    return [("", False) if said is None else (_text(said), bool(said.determined)) for said in found]


def _text(said: Said) -> str:
    return f"{said.median:.3g} ({said.lower:.3g} to {said.upper:.3g})"
