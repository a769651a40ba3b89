"""Predictions as files: a table of indices, ECGs, activation maps, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from fascicle.core.arrays import Floats
from fascicle.core.files import atomic_folder, write_bytes, write_text
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress
from fascicle.forward.scenario import Scenario
from fascicle.heart.segments import SEGMENTS
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.formats.vtk import write_grid
from fascicle.predict.indices import INDICES
from fascicle.predict.scenarios import OWN_BEAT, Predicted, predict, qrs_aligned, with_own_beat
from fascicle.report.ecg import EcgGroup, ecg_figure
from fascicle.report.figures import save
from fascicle.report.hearts import activation_figure
from fascicle.report.indices import index_figure
from fascicle.report.study import activation_row, check_population
from fascicle.report.style import GREY, VERMILION
from fascicle.study.results import FittedStudy

INTERVAL = (5, 50, 95)  # percentiles
BAND = 0.9  # of the networks, in the figure of an ECG


def write_prediction(
    fitted: FittedStudy,
    scenarios: Mapping[str, Scenario],
    out: Path,
    progress: Progress | None = None,
) -> dict[str, Predicted]:
    """Predict scenarios with every network of a population and write the result.

    The own beat is always among them. The folder holds ``indices.csv`` (every index of every
    scenario and network), ``summary.json``, ``indices.png``, and a folder for each scenario:
    ``ecgs.nc``, ``ecg.png``, ``activation.vtu`` (of the networks with the least, median and largest
    total activation time; mean, standard deviation, and how probably each vertex is among the
    latest fifth) and ``activation.png``.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    scenarios : mapping of name to Scenario
        What to predict.
    out : Path
        Folder to write.
    progress : Progress, optional
        Called after each network that is simulated.

    Raises
    ------
    InputError
        If the study has no network, or a scenario does not fit its heart.
    """
    check_population(fitted)
    networks = fitted.networks(progress)
    predicted = predict(fitted.problem, networks, with_own_beat(scenarios), progress)
    own = predicted[OWN_BEAT]
    with atomic_folder(out) as folder:
        write_text(folder / "indices.csv", index_table(predicted))
        content = {"verdict": fitted.verdict} | {n: _summary(p, own) for n, p in predicted.items()}
        write_text(folder / "summary.json", json.dumps(content, indent=2) + "\n")
        save(index_figure({n: p.indices for n, p in predicted.items()}), folder / "indices.png")
        for name, found in predicted.items():
            _write_scenario(folder / name, name, found, own, fitted)
    return predicted


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
    """Percentiles of each index, and of what each network gains against its own beat."""
    content: dict[str, Any] = {
        "description": found.scenario.description,
        "reference": found.scenario.reference,
        "networks": len(found.simulations),
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


def _write_scenario(
    folder: Path, name: str, found: Predicted, own: Predicted, fitted: FittedStudy
) -> None:
    heart, extremes = fitted.problem.model.heart, found.extremes()
    maps = found.maps() | {
        f"activation_{which}": found.simulations[k].activation for which, k in extremes.items()
    }
    write_grid(folder / "activation.vtu", heart.vertices, heart.tetrahedra, TETRAHEDRON, maps)
    time, ecgs = qrs_aligned(found)
    array = xr.DataArray(
        ecgs, {"lead": list(LEADS), "time": time}, ("network", "lead", "time"), "ecg",
        {"units": "mV"},
    )  # fmt: skip
    array["time"].attrs.update(units="ms", long_name="time from QRS onset")
    write_bytes(folder / "ecgs.nc", array.to_dataset().to_netcdf(engine="h5netcdf"))
    groups = [EcgGroup(OWN_BEAT, "network", *qrs_aligned(own), GREY, BAND)]
    if found is not own:
        groups.append(EcgGroup(name, "network", time, ecgs, VERMILION, BAND))
    figure = ecg_figure(groups, f"Predicted ECG of {len(ecgs)} networks")
    save(figure, folder / "ecg.png")
    rows = []
    for which, k in extremes.items():
        simulation = found.simulations[k]
        label = f"{which}, {simulation.total_activation_time:.0f} ms"
        rows.append(activation_row(label, simulation))
    save(activation_figure(heart, rows), folder / "activation.png")
