"""Predictions and simulations as files: a table of indices, ECGs, activation maps, figures."""

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
from fascicle.core.progress import Progress, stage_progress
from fascicle.forward.beat import Beat
from fascicle.heart.heart import Heart
from fascicle.heart.sites import SEGMENTS
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.formats.vtk import write_grid
from fascicle.networks.activation_maps import since_first
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC, qrs_aligned
from fascicle.prediction.sweeps import Swept
from fascicle.reporting import scenarios
from fascicle.reporting.activation import ActivationRow, activation_figure, total_time
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.style import KINDS, Colour, mark, save
from fascicle.study.fitted import FittedStudy


def write_prediction(
    fitted: FittedStudy,
    predicted: Mapping[str, Predicted],
    out: Path,
    kind: str = "png",
    progress: Progress | None = None,
) -> None:
    """Write the predictions of scenarios in a population.

    The folder holds ``indices.csv`` (every index of every scenario and network), ``summary.json``,
    ``indices.png``, and a folder for each scenario: ``ecgs.nc``, ``ecg.png``, ``activation.vtu``
    (of the networks with the least, median and largest total activation time; mean, standard
    deviation, and how probably each vertex is in the latest-activated 20 %), ``activation.png`` and
    ``activation-spread.png``. Pictures are of one of the `KINDS`.
    """
    report = stage_progress(progress, "pictures")
    heart, caution = fitted.simulator.model.heart, fitted.statements.caution_text
    pictures = ("ecg", "activation", "activation-spread")
    drawn = ["indices", *(f"{name}/{picture}" for name in predicted for picture in pictures)]
    old = [f"{stem}.{suffix}" for stem in drawn for suffix in KINDS]
    with atomic_folder(out, disposable=old) as folder:
        write_text(folder / "indices.csv", index_table(predicted))
        reliability = {"verdict": fitted.verdict, "caution": caution}
        content = {name: _summary(p, predicted[INTRINSIC]) for name, p in predicted.items()}
        write_text(folder / "summary.json", json.dumps(reliability | content, indent=2) + "\n")
        save(mark(scenarios.index_figure(predicted), caution), folder / f"indices.{kind}")
        for number, (name, prediction) in enumerate(predicted.items()):
            report(number, len(predicted))
            _write_scenario(folder / name, prediction, heart)
            both = {scenario: predicted[scenario] for scenario in dict.fromkeys((INTRINSIC, name))}
            figures = (
                scenarios.scenario_ecg_figure(predicted, name),
                scenarios.scenario_activation_figure(heart, predicted, name),
                scenarios.spread_figure(heart, both),  # on one scale
            )
            for stem, figure in zip(pictures, figures, strict=True):
                save(mark(figure, caution), folder / name / f"{stem}.{kind}")
        report(len(predicted), len(predicted))


def write_sweep(fitted: FittedStudy, swept: Swept, name: str, index: str, out: Path) -> None:
    """Write the predictions of a sweep, a family of scenarios.

    The folder holds ``indices.csv`` (every index of every scenario and network), ``summary.json``
    and ``sweep.png``, one index over the varied quantity of the scenario `name`.
    """
    named = {swept.called(key): prediction for key, prediction in swept.predicted.items()}
    values = {key: prediction.indices[index] for key, prediction in named.items()}
    content: dict[str, Any] = {
        "verdict": fitted.verdict,
        "caution": fitted.statements.caution_text,
        "networks": len(next(iter(values.values()))),
        "index": index,
        "medians": {key: round(float(np.nanmedian(v)), 2) for key, v in values.items()},
        "impossible": {swept.called(key): why for key, why in swept.impossible.items()},
    }
    with atomic_folder(out) as folder:
        write_text(folder / "indices.csv", index_table(named))
        write_text(folder / "summary.json", json.dumps(content, indent=2) + "\n")
        figure = mark(scenarios.sweep_figure(swept, index, name), content["caution"])
        save(figure, folder / "sweep.png")


def draw_simulation(
    heart: Heart, simulation: Beat, folder: Path, kind: str, time_zero: str
) -> list[Path]:
    """Write ``ecg`` and ``activation``, pictures of one of the `KINDS`; returns the files."""
    ecg = simulated_ecg_figure(simulation, time_zero)
    activation = simulated_activation_figure(heart, simulation, f"\n0: {time_zero}")
    figures = {"ecg": ecg, "activation": activation}
    return [save(figure, folder / f"{stem}.{kind}") for stem, figure in figures.items()]


def simulated_ecg_figure(simulation: Beat, time_zero: str = "") -> Figure:
    """Draw the ECG of a simulation."""
    time, leads = simulation.ecg["time"].to_numpy(), simulation.leads[None]
    group = EcgGroup("simulated", "network", time, leads, Colour.VERMILION)
    return ecg_figure([group], "Simulated ECG", time_zero=time_zero, leads=simulation.lead_names)


def simulated_activation_figure(heart: Heart, simulation: Beat, zero: str = "") -> Figure:
    """Draw the activation of a simulation on its heart."""
    row = ActivationRow.of(total_time(simulation.total_activation_time), simulation)
    return activation_figure(heart, [row], f"activation (ms){zero}")


def index_table(predicted: Mapping[str, Predicted]) -> str:
    """Every index of every scenario and network, as CSV."""
    table = pd.concat({name: prediction.index_table() for name, prediction in predicted.items()})
    table = table.rename_axis(["scenario", "network"])
    return str(table.to_csv(float_format="%.2f", lineterminator="\n"))


def latest_segments(found: Predicted) -> dict[str, float]:
    """Share of the networks in which each segment is the latest, the most frequent first."""
    numbers = found.indices["latest_segment"].astype(int)
    which, counts = np.unique(numbers, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return {SEGMENTS[which[k] - 1]: round(float(counts[k] / len(numbers)), 3) for k in order}


def _summary(prediction: Predicted, intrinsic: Predicted) -> dict[str, Any]:
    """Percentiles of each index, and of its change from each network's intrinsic beat."""
    content: dict[str, Any] = {
        "description": prediction.scenario.description,
        "reference": prediction.scenario.reference,
        "networks": len(prediction.beats),
        "activation_maps": prediction.extremes(),
        "latest_segment": latest_segments(prediction),
    }
    for index, unit in INDICES.items():
        if unit != "1":
            values = prediction.indices[index]
            content[f"{index}_{unit}"] = {
                "value": _percentiles(values),
                "change": _percentiles(values - intrinsic.indices[index]),
            }
    return content


def _percentiles(values: Floats) -> dict[str, float] | None:
    """Percentiles of the finite values; None if there are none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    low, middle, high = np.percentile(finite, (5, 50, 95))
    return {"5 %": round(low, 2), "median": round(middle, 2), "95 %": round(high, 2)}


def _write_scenario(folder: Path, prediction: Predicted, heart: Heart) -> None:
    maps = prediction.maps | {
        f"activation_{which}": since_first(prediction.beats[k].activation)
        for which, k in prediction.extremes().items()
    }
    write_grid(folder / "activation.vtu", heart.vertices, heart.tetrahedra, TETRAHEDRON, maps)
    time, (ecgs,) = qrs_aligned(prediction)
    array = xr.DataArray(
        ecgs, {"lead": list(heart.leads), "time": time}, ("network", "lead", "time"), "ecg",
        {"units": "mV"},
    )  # fmt: skip
    array["time"].attrs.update(units="ms", long_name="time from QRS onset")
    write_bytes(folder / "ecgs.nc", array.to_dataset().to_netcdf(engine="h5netcdf"))
