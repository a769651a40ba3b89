"""Targets as self-describing netCDF files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fascicle.core import VERSION
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import as_path, write_bytes
from fascicle.core.isolated import load_netcdf
from fascicle.core.leads import LEADS
from fascicle.core.ranges import RANGES, shown
from fascicle.recording.filters import SAMPLING_STEP, Filter, FilterKind, FilterOrigin
from fascicle.recording.target import Target, residual_covariance

if TYPE_CHECKING:
    import xarray as xr

FORMAT: dict[str, str | int] = {"format": "fascicle target", "format_version": 3}
NUMBERS = {  # attribute of the file: field of the target, and whether it is always there
    "qrs_onset_ms": ("qrs_onset", True),
    "qrs_offset_ms": ("qrs_offset", True),
    "qrs_onset_sd_ms": ("onset_sd", True),
    "qrs_offset_sd_ms": ("offset_sd", True),
    "heart_rate_bpm": ("heart_rate", False),  # only if more than one beat was recorded
    "stated_noise_mV": ("noise", False),  # only if stated by the user
    "earliest_onset_ms": ("earliest_onset", False),  # only of paced beats
}


def write_target(target: Target, path: str | Path) -> None:
    """Write a target as netCDF-4, whole or not at all; a file that exists is replaced."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file, such as target.nc")
    write_bytes(path, _to_dataset(target).to_netcdf(engine="h5netcdf"))


def as_target(target: Target | Path | str) -> Target:
    """Return a target as it is, or read it from its file."""
    if isinstance(target, Target):
        return target
    return read_target(as_path(target, "target", "a target, or its netCDF file"))


def read_target(path: str | Path) -> Target:
    """Read a target that `write_target` wrote.

    Raises
    ------
    InputError
        When there is no such file or it is not a target.
    """
    path = as_path(path, "target")
    if not path.is_file():
        fault = "is a folder" if path.is_dir() else "no such file"
        raise InputError(f"{path}: {fault}; make a target with 'fascicle target'")
    try:
        dataset = load_netcdf(path)
    except InputError as error:
        raise InputError(
            f"{path}: not a readable netCDF file; make a target with 'fascicle target'"
        ) from error
    for problem in _problems(dataset):
        raise InputError(f"{path}: {problem}; make the target again with 'fascicle target'")
    attributes = {str(key): value for key, value in dataset.attrs.items()}
    numbers: dict[str, Any] = {"heart_rate": None} | {
        name: float(attributes[key]) for key, (name, _) in NUMBERS.items() if key in attributes
    }
    provenance = {
        key.removeprefix("provenance_"): str(value)
        for key, value in attributes.items()
        if key.startswith("provenance_")
    }
    warnings = tuple(provenance.pop("warnings", "").splitlines())
    return Target(
        beats=dataset["beats"].transpose("beat", "lead", "time").to_numpy().astype(np.float64),
        time=dataset["time"].to_numpy().astype(np.float64),
        provenance=provenance,
        warnings=warnings,
        filters=_filters_from(attributes["filters"]),
        leads=tuple(str(lead) for lead in dataset["lead"].to_numpy()),
        **numbers,
    )


def _to_dataset(target: Target) -> xr.Dataset:
    import xarray as xr

    qrs_time = target.time[target.qrs_samples]
    inside = np.isin(target.time, qrs_time).astype(np.int8)
    leads = np.array(target.leads, dtype=object)
    coordinates = {
        name: (dimension, values, {"long_name": text} | ({"units": unit} if unit else {}))
        for name, dimension, values, unit, text in (
            ("beat", "beat", np.arange(len(target.beats)), "1", "beat"),
            ("lead", "lead", leads, "", "electrocardiogram lead"),
            ("time", "time", target.time, "ms", "time from the R peak"),
            ("in_qrs", "time", inside, "1", "1 within the QRS, 0 outside"),
            ("lead_2", "lead_2", leads, "", "the other lead"),
            ("qrs_time_2", "qrs_time_2", qrs_time, "ms", "the other time, from the R peak"),
            ("qrs_time", "qrs_time", qrs_time, "ms", "time from the R peak, within the QRS"),
        )
    }
    spread = "standard deviation of a beat"
    spread += " about the mean" if target.noise is None else ", as stated by the user"
    beats = "potential of each beat, isoelectric level removed"
    covariance = residual_covariance(target)
    across = {
        "units": "1",
        "comment": "The covariance of the beats about their mean, of lead l at time t with lead m "
        "at time s, is standard_deviation[l, t] * standard_deviation[m, s] * "
        "residual_covariance_leads[l, m] * residual_covariance_time[t, s]; both factors are "
        "correlations, shrunk towards none.",
    }
    over_leads = {"long_name": "correlation of residuals across leads"}
    over_time = {"long_name": "correlation of residuals across time, within the QRS"}
    variables: dict[str, tuple[tuple[str, ...], Floats, dict[str, Any]]] = {
        "beats": (
            ("beat", "lead", "time"), target.beats,
            {"units": "mV", "long_name": beats, "comment": "NaN in leads that are not used."},
        ),
        "mean": (("lead", "time"), target.mean, {"units": "mV", "long_name": "mean beat"}),
        "standard_deviation": (
            ("lead", "time"), target.standard_deviation, {"units": "mV", "long_name": spread},
        ),
        "residual_covariance_leads": (
            ("lead", "lead_2"), covariance.leads,
            across | over_leads | {"shrinkage": covariance.shrinkage_leads},
        ),
        "residual_covariance_time": (
            ("qrs_time", "qrs_time_2"), covariance.time,
            across | over_time | {"shrinkage": covariance.shrinkage_time},
        ),
    }  # fmt: skip
    dataset = xr.Dataset(variables, coords=coordinates, attrs=_attributes(target))
    for name in variables:
        dataset[name].encoding["zlib"] = True
    return dataset


def _attributes(target: Target) -> dict[str, str | float | int]:
    numbers = {key: getattr(target, name) for key, (name, _) in NUMBERS.items()}
    # a path may hold bytes that are not text
    warnings = {"warnings": "\n".join(target.warnings)} if target.warnings else {}
    notes = target.provenance | warnings
    texts = {key: str(text).encode("utf-8", "replace") for key, text in notes.items()}
    filters = [
        {
            "kind": filter_.kind.value,
            "frequency_Hz": filter_.frequency,
            filter_.kind.shape_name: filter_.shape,
            "origin": filter_.origin.value,
            "sampling_rate_Hz": filter_.sampling_rate,
        }
        for filter_ in target.filters
    ]
    return {
        "Conventions": "CF-1.11",
        "title": "QRS target: aligned beats of one electrocardiogram",
        **FORMAT,
        "software": f"fascicle {VERSION}",
        "comment": (
            "The QRS lasts from qrs_onset_ms to qrs_offset_ms, counted from the R peak (time 0); "
            "their standard deviations are 0 where the user has given them. 'earliest_onset_ms', "
            "of paced beats, is the end of the pacing spike. Attributes that begin with "
            "'provenance_' say where the beats came from and what was chosen. 'filters' lists (as "
            "JSON) what the potentials have passed: Butterworth low-passes and notches; one with a "
            "sampling rate is digital and was run forward and backward, others analogue, run once."
        ),
        "filters": json.dumps(filters),
        "qrs_duration_ms": float(target.qrs_duration),
        **{key: float(value) for key, value in numbers.items() if value is not None},
        **{f"provenance_{key}": text.decode() for key, text in texts.items()},
    }


def _filters_from(text: object) -> tuple[Filter, ...]:
    """Filters of a list in JSON; ValueError when the text is no such list."""
    try:
        return tuple(
            Filter(
                kind=FilterKind(entry["kind"]),
                frequency=float(entry["frequency_Hz"]),
                origin=FilterOrigin(entry["origin"]),
                shape=float(entry[FilterKind(entry["kind"]).shape_name]),
                sampling_rate=entry["sampling_rate_Hz"] and float(entry["sampling_rate_Hz"]),
            )
            for entry in json.loads(str(text))
        )
    except (TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"{text} is no list of filters") from error


def _problems(dataset: xr.Dataset) -> Iterator[str]:
    """Problems of a file; each check may rely on the absence of the problems before it."""
    attributes = dataset.attrs
    if attributes.get("format") != FORMAT["format"]:
        yield f"not a target (format is {attributes.get('format')!r})"
    if (number := attributes.get("format_version")) != (readable := FORMAT["format_version"]):
        yield f"target of format version {number}, this fascicle reads {readable}"
    missing = [name for name in ("beats", "lead", "time") if name not in dataset.variables]
    needed = [*(name for name, (_, always) in NUMBERS.items() if always), "filters"]
    missing += [name for name in needed if name not in attributes]
    if missing:
        yield f"damaged target without {', '.join(missing)}"
    beats, time = dataset["beats"], dataset["time"].to_numpy()
    leads = tuple(str(lead) for lead in dataset["lead"].to_numpy())
    if set(beats.dims) != {"beat", "lead", "time"} or leads[: len(LEADS)] != LEADS:
        yield f"beats have sizes {dict(beats.sizes)}, not beat, the standard 12 leads and time"
    if len(set(leads)) < len(leads):
        yield "a lead is there twice"
    if dataset.sizes["beat"] < 2 and "stated_noise_mV" not in attributes:
        yield f"{dataset.sizes['beat']} beats without a stated noise"
    values = beats.transpose("lead", "beat", "time").to_numpy().reshape(len(leads), -1)
    finite = np.isfinite(values)
    if not finite.any() or not (finite.all(axis=1) | ~finite.any(axis=1)).all():
        yield "beats are not finite"
    largest = float(np.abs(np.where(finite, values, 0)).max(initial=0))
    if largest not in RANGES["potential"]:
        yield f"beats reach {largest:.4g} mV, possible are {RANGES['potential']}"
    if not np.allclose(np.diff(time), SAMPLING_STEP):  # false for NaN, too
        yield f"time does not run in steps of {SAMPLING_STEP:g} ms"
    for name in NUMBERS:
        value = attributes.get(name, 0.0)
        if not isinstance(value, (int, float, np.number)) or not np.isfinite(value):
            yield f"{name} is {shown(value)}, not a number"
    noise = attributes.get("stated_noise_mV")
    if noise is not None and noise not in RANGES["noise"]:
        yield f"stated_noise_mV is {noise:.4g}, possible are {RANGES['noise']}"
    try:
        _filters_from(attributes["filters"])
    except ValueError:
        yield f"filters are {str(attributes['filters'])[:60]!r}, not a list of filters"
    onset, offset = attributes["qrs_onset_ms"], attributes["qrs_offset_ms"]
    if not time[0] <= onset < offset <= time[-1]:
        yield f"QRS from {onset} to {offset} ms, beats from {time[0]} to {time[-1]} ms"
