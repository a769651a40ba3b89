"""Predictions and simulations: figures of indices, ECGs, activations and sweeps, and files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_folder, write_bytes, write_text
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.ranges import check_text
from fascicle.forward.activation_sequence import since_first
from fascicle.forward.beat import Beat
from fascicle.forward.simulation_files import write_activation, write_maps
from fascicle.heart.heart import Heart
from fascicle.heart.sites import SEGMENTS
from fascicle.prediction.comparison import SIGNED, Swept, Varied
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC, qrs_aligned
from fascicle.reporting import style
from fascicle.reporting.activation import (
    ActivationRow,
    activation_figure,
    spread_figure,
    total_time,
)
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.names import index_label, index_name, scenario_name
from fascicle.reporting.style import KINDS, Colour, mark, save
from fascicle.study.fitted import FittedStudy

# Indices in the figure and the table of a report
SHOWN = (
    "qrs_duration", "total_activation_time", "lv_activation_time", "lv_dyssynchrony",
    "lv_rv_delay", "qrs_area",
)  # fmt: skip


def write_prediction(
    fitted: FittedStudy,
    predicted: Mapping[str, Predicted],
    out: Path,
    kind: str | None = "png",
    progress: Progress | None = None,
) -> None:
    """Write the predictions of scenarios in a population.

    The folder holds ``indices.csv`` (every index of every scenario and network), ``summary.json``,
    ``indices.png``, and a folder for each scenario: ``ecgs.nc``, ``ecg.png``, ``activation.vtu``
    (of `Predicted.percentile_networks`; mean, standard deviation, and how probably each vertex is
    in the latest-activated 20 %), ``activation.png`` and ``activation-spread.png``. Of an atlas,
    ``activation-median.vtu`` and so on have these networks on their own hearts. Pictures are of one
    of the `KINDS`; None: there are none.
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
        if kind is not None:
            save(mark(index_figure(predicted), caution), folder / f"indices.{kind}")
        for number, (name, prediction) in enumerate(predicted.items()):
            report(number, len(predicted))
            _write_scenario(folder / name, prediction, fitted)
            if kind is None:
                continue
            both = {key: predicted[key].maps["activation_sd"] for key in (INTRINSIC, name)}
            figures = (
                scenario_ecg_figure(predicted, name),
                scenario_activation_figure(heart, predicted, name, fitted.heart_of),
                spread_figure(heart, both),  # on one scale
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
        figure = mark(sweep_figure(swept, index, name), content["caution"])
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


def latest_segments(prediction: Predicted) -> dict[str, float]:
    """Share of the networks in which each segment is the latest, the most frequent first."""
    numbers = prediction.indices["latest_segment"].astype(int)
    which, counts = np.unique(numbers, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return {SEGMENTS[which[k] - 1]: round(float(counts[k] / len(numbers)), 3) for k in order}


def _summary(prediction: Predicted, intrinsic: Predicted) -> dict[str, Any]:
    """Percentiles of each index, and of its change from each network's intrinsic beat."""
    content: dict[str, Any] = {
        "description": prediction.scenario.description,
        "reference": prediction.scenario.reference,
        "networks": len(prediction.beats),
        "activation_maps": prediction.percentile_networks(),
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


def _write_scenario(folder: Path, prediction: Predicted, fitted: FittedStudy) -> None:
    heart, maps = fitted.simulator.model.heart, dict(prediction.maps)
    for which, k in prediction.percentile_networks().items():
        activation = since_first(prediction.beats[k].activation)
        if heart.atlas is None:
            maps[f"activation_{which.replace(' ', '_')}"] = activation
        else:
            file = folder / f"activation-{which.replace(' ', '-')}.vtu"
            write_activation(file, fitted.heart_of(k), activation)
    write_maps(folder / "activation.vtu", heart, maps)
    time, (ecgs,) = qrs_aligned(prediction)
    array = xr.DataArray(
        ecgs, {"lead": list(heart.leads), "time": time}, ("network", "lead", "time"), "ecg",
        {"units": "mV"},
    )  # fmt: skip
    array["time"].attrs.update(units="ms", long_name="time from QRS onset")
    write_bytes(folder / "ecgs.nc", array.to_dataset().to_netcdf(engine="h5netcdf"))


@style.styled
def index_figure(predicted: Mapping[str, Predicted]) -> Figure:
    """Draw indices of scenarios, one row each; the first, the intrinsic beat, is grey.

    Each index of `SHOWN` has a panel, with the median and the ranges of half and 90 % of networks.
    """
    figure = style.new_figure(8.7, 2 * (0.65 + 0.28 * len(predicted)))
    panels = figure.subplots(2, len(SHOWN) // 2, sharey=True)
    for panel, index in zip(panels.flat, SHOWN, strict=True):
        for row, prediction in enumerate(predicted.values()):
            values, colour = prediction.indices[index], Colour.VERMILION if row else Colour.GREY
            for share, width in (((5, 95), 1.2), ((25, 75), 4.5)):
                panel.plot(np.nanpercentile(values, share), [row, row], color=colour, lw=width)
            panel.plot(np.nanmedian(values), row, "o", color="white", markeredgecolor=colour)
        panel.grid(axis="x", color="#EAEAEA", linewidth=0.6)
        panel.set_xlabel(index_label(index))
    panel.set(yticks=range(len(predicted)), ylim=(len(predicted) - 0.5, -0.5))
    panel.set_yticklabels([style.short(scenario_name(name), 30) for name in predicted])
    return figure


def scenario_ecg_figure(predicted: Mapping[str, Predicted], name: str) -> Figure:
    """Draw the twelve leads of a scenario and the intrinsic beat: means, 90 % of the networks."""
    intrinsic, prediction = _with_intrinsic(predicted, name)
    return prediction_ecg_figure({INTRINSIC: intrinsic, name: prediction})


def prediction_ecg_figure(shown: Mapping[str, Predicted]) -> Figure:
    """Draw the twelve leads of predictions: means, 90 % of the networks."""
    time, ecgs = qrs_aligned(*shown.values())
    groups = [
        EcgGroup(
            style.short(name), "network", time, leads[:, : len(LEADS)],
            Colour.GREY if name == INTRINSIC else Colour.VERMILION, 0.9,
        )
        for name, leads in zip(shown, ecgs, strict=True)
    ]  # fmt: skip
    return ecg_figure(groups, "Predicted ECG", time_zero="QRS onset")


def scenario_activation_figure(
    heart: Heart,
    predicted: Mapping[str, Predicted],
    name: str,
    heart_of: Callable[[int], Heart] | None = None,
) -> Figure:
    """Draw a scenario in the networks at three percentiles of the total activation time.

    The intrinsic beat in its median network stands above, in the same colours. `heart_of` gives
    the heart of each network, if it is not the `heart`.
    """
    intrinsic, prediction = _with_intrinsic(predicted, name)
    shown = [] if prediction is intrinsic else [(INTRINSIC, "median")]
    shown += [(name, which) for which in prediction.percentile_networks()]
    rows = []
    for scenario, which in shown:
        number = predicted[scenario].percentile_networks()[which]
        own_heart = heart if heart_of is None else heart_of(number)
        label = f"{scenario_name(scenario)}\n{which}"
        rows.append(_row(predicted[scenario], label, number, own_heart))
    return activation_figure(heart, rows)


def _with_intrinsic(predicted: Mapping[str, Predicted], name: str) -> tuple[Predicted, Predicted]:
    check_text(name, "name of a scenario")
    if name not in predicted:
        raise InputError(f"'{name}' was not predicted; there are {', '.join(predicted)}")
    if INTRINSIC not in predicted:
        raise InputError(f"'{INTRINSIC}' is not among the predictions; fascicle.predict makes it")
    return predicted[INTRINSIC], predicted[name]


def _row(prediction: Predicted, label: str, number: int, heart: Heart) -> ActivationRow:
    """Row of a network on its heart, with times from its first activation."""
    beat, total = prediction.beats[number], prediction.indices["total_activation_time"][number]
    return ActivationRow.of(f"{label}\n{total_time(total)}", beat, heart).since_first()


def sweep_figure(swept: Swept, index: str, name: str) -> Figure:
    """Draw an index over the quantity that a sweep varies: a curve, or a bull's eye of segments."""
    values = {key: prediction.indices[index] for key, prediction in swept.predicted.items()}
    if swept.varied != Varied.SEGMENT:
        return curve_figure(values, index, swept.varied, name)
    title = f"median {index_name(index)}"
    if index in SIGNED:  # absolute delay
        values, title = {key: np.abs(v) for key, v in values.items()}, f"{title} (absolute)"
    medians = np.full(len(SEGMENTS), np.nan)
    for key, per_network in values.items():
        medians[int(key) - 1] = np.nanmedian(per_network)
    title = f"{style.short(name)}: {title} by stimulated segment"
    return bulls_eye_figure(medians, title, INDICES[index])


@style.styled
def curve_figure(values: Mapping[float, Floats], index: str, varied: str, name: str) -> Figure:
    """Draw an index (n,) over the varied quantity: median, range of half and 90 % of networks."""
    title = f"{style.short(name)}: median, range of half and 90 % of the networks"
    figure = style.new_figure(5.6, 3.6, title)
    axes, samples = figure.subplots(), np.array(list(values.values()))
    for share, opacity in (((5, 95), 0.2), ((25, 75), 0.35)):
        low, high = np.nanpercentile(samples, share, axis=1)
        axes.fill_between(list(values), low, high, color=Colour.VERMILION, alpha=opacity, lw=0)
    axes.plot(list(values), np.nanmedian(samples, axis=1), "o-", color=Colour.VERMILION)
    axes.set(xlabel=varied, ylabel=index_label(index))
    return figure


@style.styled
def bulls_eye_figure(values: Floats, title: str, unit: str) -> Figure:
    """Draw values (17,) of the segments of the left ventricle, seen from the apex; NaN is white."""
    figure = style.new_figure(4.6, 4.2, title)
    axes = figure.add_subplot(projection="polar")
    # lower is lighter, and better; the order is visible with any colour vision
    colours = ScalarMappable(Normalize(np.nanmin(values), np.nanmax(values)), "cividis_r")
    number = iter(values)
    for ring, count in enumerate((6, 6, 4, 1)):  # sectors from outside, the anterior one first
        for sector in range(count):
            angle = np.radians(90 + sector * 360 / count)
            _draw_segment(axes, 4 - ring, angle, 2 * np.pi / count, next(number), colours)
    axes.set_axis_off()
    axes.set_ylim(0, 4)
    walls = {"anterior": 90, "septal": 180, "inferior": 270, "lateral": 0}
    for wall, degrees in walls.items():
        turned = 0 if degrees in (90, 270) else 90
        axes.text(np.radians(degrees), 4.25, wall, ha="center", va="center", rotation=turned)
    figure.colorbar(colours, ax=axes, fraction=0.04, pad=0.08, label=unit)
    return figure


def _draw_segment(
    axes: Axes, outer: int, angle: float, width: float, value: float, colours: ScalarMappable
) -> None:
    """Draw a segment with its value; `outer` 1 is the apex."""
    if np.isfinite(value):
        red, green, blue, _ = colours.to_rgba(np.array([value]))[0]
        axes.bar(
            angle, 1, width, bottom=outer - 1, color=(red, green, blue), edgecolor="white",
            linewidth=0 if outer == 1 else 1,
        )  # fmt: skip
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        axes.text(
            angle, 0 if outer == 1 else outer - 0.5, style.signed(value), ha="center",
            va="center", color="white" if dark else "black",
        )  # fmt: skip
