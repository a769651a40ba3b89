"""Predictions as files: a table of indices, ECGs, activation maps, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats
from fascicle.core.files import atomic_folder, write_bytes, write_text
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.heart import Heart
from fascicle.heart.sites import SEGMENTS
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.formats.vtk import write_grid
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC, qrs_aligned
from fascicle.reporting.figures import FORMATS, save
from fascicle.reporting.indices import index_figure
from fascicle.reporting.scenario import (
    scenario_activation_figure,
    scenario_ecg_figure,
    spread_figure,
)
from fascicle.study.activation_maps import since_first
from fascicle.study.fitted import FittedStudy

INTERVAL = (5, 50, 95)  # percentiles


def write_prediction(
    fitted: FittedStudy,
    predicted: Mapping[str, Predicted],
    out: Path,
    kind: str = "png",
    progress: Progress | None = None,
) -> None:
    """Write what scenarios do in a population.

    The folder holds ``indices.csv`` (every index of every scenario and network), ``summary.json``,
    ``indices.png``, and a folder for each scenario: ``ecgs.nc``, ``ecg.png``, ``activation.vtu``
    (of the networks with the least, median and largest total activation time; mean, standard
    deviation, and how probably each vertex is in the latest-activated 20 %), ``activation.png`` and
    ``activation-spread.png``.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    predicted : mapping of name to Predicted
        What `fascicle.predict` found.
    out : Path
        Folder to write.
    kind : str
        Of the pictures: ``"png"``, ``"svg"`` or ``"pdf"``.
    progress : Progress, optional
        Called after each scenario.
    """
    report = stage_progress(progress, "pictures")
    heart, own, caution = (
        fitted.simulator.model.heart,
        predicted[INTRINSIC],
        fitted.statements.caution_text,
    )
    with atomic_folder(out, disposable=_pictures(predicted)) as folder:
        write_text(folder / "indices.csv", index_table(predicted))
        said = {"verdict": fitted.verdict, "caution": caution}
        content = said | {name: _summary(found, own) for name, found in predicted.items()}
        write_text(folder / "summary.json", json.dumps(content, indent=2) + "\n")
        compared = index_figure({name: found.indices for name, found in predicted.items()})
        save(compared, folder / f"indices.{kind}", caution)
        for number, (name, found) in enumerate(predicted.items()):
            report(number, len(predicted))
            _write_scenario(folder / name, found, heart)
            for stem, figure in _drawn(heart, predicted, name).items():
                save(figure, folder / name / f"{stem}.{kind}", caution)
        report(len(predicted), len(predicted))


def _drawn(heart: Heart, predicted: Mapping[str, Predicted], name: str) -> dict[str, Figure]:
    """Figures of a scenario; of all but the intrinsic beat beside that, on the same scales."""
    shown = {each: predicted[each] for each in dict.fromkeys((INTRINSIC, name))}
    return {
        "ecg": scenario_ecg_figure(predicted, name),
        "activation": scenario_activation_figure(heart, predicted, name),
        "activation-spread": spread_figure(heart, shown),
    }


def _pictures(predicted: Mapping[str, Predicted]) -> list[str]:
    """Names of the pictures of an earlier prediction, in whatever format."""
    drawn = ("ecg", "activation", "activation-spread")
    stems = ["indices", *(f"{name}/{what}" for name in predicted for what in drawn)]
    return [stem + suffix for stem in stems for suffix in FORMATS]


def index_table(predicted: Mapping[str, Predicted]) -> str:
    """Every index of every scenario and network, as CSV."""
    columns = {index: f"{index}_{unit}" for index, unit in INDICES.items() if unit != "1"}
    tables = []
    for name, found in predicted.items():
        table = pd.DataFrame(dict(found.indices)).rename(columns=columns)
        table.insert(0, "network", np.arange(len(table)))
        table.insert(0, "scenario", name)
        tables.append(table)
    text = pd.concat(tables).to_csv(index=False, float_format="%.2f", lineterminator="\n")
    return str(text)


def _summary(found: Predicted, own: Predicted) -> dict[str, Any]:
    """Percentiles of each index, and of what each network gains against its intrinsic beat."""
    content: dict[str, Any] = {
        "description": found.scenario.description,
        "reference": found.scenario.reference,
        "networks": len(found.beats),
        "activation_maps": found.extremes(),
        "latest_segment": _latest(found.indices["latest_segment"]),
    }
    for index, unit in INDICES.items():
        if unit != "1":
            values = found.indices[index]
            content[f"{index}_{unit}"] = {
                "value": _percentiles(values),
                "change": _percentiles(values - own.indices[index]),
            }
    return content


def _percentiles(values: Floats) -> dict[str, float] | None:
    """Of what is a number; None if nothing is."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    low, middle, high = np.percentile(known, INTERVAL)
    return {"5 %": round(low, 2), "median": round(middle, 2), "95 %": round(high, 2)}


def _latest(numbers: Floats) -> dict[str, float]:
    """Share of the networks in which each segment is the latest, the most frequent first."""
    found, counts = np.unique(numbers.astype(int), return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return {SEGMENTS[found[k] - 1]: round(float(counts[k] / len(numbers)), 3) for k in order}


def _write_scenario(folder: Path, found: Predicted, heart: Heart) -> None:
    maps = found.maps | {
        f"activation_{which}": since_first(found.beats[k].activation)
        for which, k in found.extremes().items()
    }
    write_grid(folder / "activation.vtu", heart.vertices, heart.tetrahedra, TETRAHEDRON, maps)
    time, (ecgs,) = qrs_aligned(found)
    array = xr.DataArray(
        ecgs, {"lead": list(LEADS), "time": time}, ("network", "lead", "time"), "ecg",
        {"units": "mV"},
    )  # fmt: skip
    array["time"].attrs.update(units="ms", long_name="time from QRS onset")
    write_bytes(folder / "ecgs.nc", array.to_dataset().to_netcdf(engine="h5netcdf"))
