"""A pacing prediction as files: table, ECGs, activation maps, figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_folder, write_bytes, write_text
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress
from fascicle.forward.simulation_files import write_activation
from fascicle.predict.pacing import Pacing, pace, qrs_aligned
from fascicle.report.ecg import EcgGroup, ecg_figure
from fascicle.report.figures import save
from fascicle.report.hearts import activation_figure
from fascicle.report.pacing import pacing_figure
from fascicle.report.study import activation_row, check_population
from fascicle.report.style import GREY, VERMILION
from fascicle.study.results import FittedStudy, spread


def write_pacing(
    fitted: FittedStudy, root_time: float, out: Path, progress: Progress | None = None
) -> Pacing:
    """Predict pacing with every network of a population and write the result.

    The folder holds ``table.csv`` (QRS duration and total activation time of each network before
    and after), ``ecgs.nc``, ``activation_{minimum,median,maximum}.vtu`` for the networks with the
    least, median and largest total activation time, and figures of the same.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    root_time : float
        t_RV − t_LV of the paced roots (ms).
    out : Path
        Folder to write.
    progress : Progress, optional
        Called after each network that is simulated.

    Raises
    ------
    InputError
        If the study has no network, or the root time is not finite.
    """
    check_population(fitted)
    if not np.isfinite(root_time):
        raise InputError(f"--root-time is {root_time}; give a finite number of ms")
    networks = fitted.networks(progress)
    pacing = pace(fitted.problem.model, networks, root_time)
    with atomic_folder(out) as folder:
        write_text(folder / "table.csv", _table(pacing))
        summary = json.dumps({"verdict": fitted.verdict, **_summary(pacing, root_time)}, indent=2)
        write_text(folder / "summary.json", f"{summary}\n")
        _write_ecgs(folder / "ecgs.nc", pacing)
        for name, k in pacing.extremes().items():
            path = folder / f"activation_{name}.vtu"
            write_activation(path, fitted.problem.model.heart, pacing.after[k])
        _write_figures(folder, fitted, pacing, root_time)
    return pacing


def _durations(pacing: Pacing) -> dict[str, Floats]:
    return {
        "qrs_duration_before_ms": pacing.qrs_before,
        "qrs_duration_after_ms": pacing.qrs_after,
        "total_activation_time_before_ms": pacing.tat_before,
        "total_activation_time_after_ms": pacing.tat_after,
    }


def _table(pacing: Pacing) -> str:
    table = pd.DataFrame(_durations(pacing), [f"{k:02d}" for k in range(len(pacing.after))])
    return str(table.to_csv(index_label="network", float_format="%.2f", lineterminator="\n"))


def _summary(pacing: Pacing, root_time: float) -> dict[str, object]:
    return {
        "root_time_ms": root_time,
        "networks": len(pacing.after),
        **{name: spread(durations) for name, durations in _durations(pacing).items()},
        "activation_maps": {name: f"network {k:02d}" for name, k in pacing.extremes().items()},
    }


def _write_ecgs(path: Path, pacing: Pacing) -> None:
    arrays = {}
    for name, simulations in (("before", pacing.before), ("after", pacing.after)):
        time, ecgs = qrs_aligned(simulations)
        arrays[name] = xr.DataArray(
            ecgs,
            dims=("network", "lead", f"time_{name}"),
            coords={"lead": list(LEADS), f"time_{name}": time},
            attrs={"units": "mV"},
        )
        arrays[name][f"time_{name}"].attrs.update(units="ms", long_name="time from QRS onset")
    write_bytes(path, xr.Dataset(arrays).to_netcdf(engine="h5netcdf"))


def _write_figures(folder: Path, fitted: FittedStudy, pacing: Pacing, root_time: float) -> None:
    labels = ("before", f"roots {root_time:g} ms apart" if root_time else "roots together")
    groups = [
        EcgGroup(label, "network", *qrs_aligned(simulations), colour)
        for label, simulations, colour in zip(
            labels, (pacing.before, pacing.after), (GREY, VERMILION), strict=True
        )
    ]
    figure = ecg_figure(groups, f"Predicted ECG of {len(pacing.after)} networks")
    save(figure, folder / "ecg.png")
    save(pacing_figure(pacing, labels), folder / "durations.png")
    chosen = {name: pacing.after[k] for name, k in pacing.extremes().items()}
    rows = [
        activation_row(f"{name}, {simulation.total_activation_time:.0f} ms", simulation)
        for name, simulation in chosen.items()
    ]
    save(activation_figure(fitted.problem.model.heart, rows), folder / "activation.png")
