"""Targets as netCDF files that explain themselves."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path
from fascicle.core.leads import LEADS
from fascicle.recording.covariance import residual_covariance
from fascicle.recording.target import SAMPLING_STEP, Target

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "fascicle target"
FORMAT_VERSION = 2
_PREFIX = "provenance_"
_REMAKE = "make the target again with 'fascicle target'"
_NUMBERS = (
    "qrs_onset_ms", "qrs_offset_ms", "qrs_onset_sd_ms", "qrs_offset_sd_ms", "heart_rate_bpm",
)  # fmt: skip


def write_target(target: Target, path: str | Path) -> None:
    """Write a target as netCDF-4, whole or not at all.

    Parameters
    ----------
    target : Target
        Beats and window.
    path : path
        File to write, usually ``.nc``; replaced if it exists.
    """
    dataset = _to_dataset(target)
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file, such as target.nc")
    with atomic_path(path) as temporary:
        dataset.to_netcdf(temporary, engine="h5netcdf")


def read_target(path: str | Path) -> Target:
    """Read a target that `write_target` wrote.

    Raises
    ------
    InputError
        When there is no such file or it is not a target.
    """
    import xarray as xr

    path = Path(path)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "no such file"
        raise InputError(f"{path}: {what}; make a target with 'fascicle target'")
    try:
        dataset = xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise InputError(
            f"{path}: not a readable netCDF file; make a target with 'fascicle target'"
        ) from error
    for check in _CHECKS:
        problem = check(dataset)
        if problem is not None:
            raise InputError(f"{path}: {problem}; {_REMAKE}")
    attributes = dataset.attrs
    return Target(
        beats=dataset["beats"].transpose("beat", "lead", "time").to_numpy().astype(np.float64),
        time=dataset["time"].to_numpy().astype(np.float64),
        qrs_onset=float(attributes["qrs_onset_ms"]),
        qrs_offset=float(attributes["qrs_offset_ms"]),
        heart_rate=float(attributes["heart_rate_bpm"]),
        provenance={
            str(key).removeprefix(_PREFIX): str(value)
            for key, value in attributes.items()
            if str(key).startswith(_PREFIX)
        },
        onset_sd=float(attributes["qrs_onset_sd_ms"]),
        offset_sd=float(attributes["qrs_offset_sd_ms"]),
        noise=float(attributes["stated_noise_mV"]) if "stated_noise_mV" in attributes else None,
    )


def _to_dataset(target: Target) -> xr.Dataset:
    """Build the dataset with units on everything."""
    import xarray as xr

    variables = _beat_variables(target) | _covariance_variables(target)
    inside = np.zeros(len(target.time), dtype=np.int8)
    inside[target.qrs_samples] = 1
    coordinates = {
        "beat": ("beat", np.arange(len(target.beats)), {"units": "1", "long_name": "beat"}),
        "lead": ("lead", np.array(LEADS, dtype=object), {"long_name": "electrocardiogram lead"}),
        "time": ("time", target.time, {"units": "ms", "long_name": "time from the R peak"}),
        "in_qrs": ("time", inside, {"units": "1", "long_name": "1 within the QRS, 0 outside"}),
        "lead_2": ("lead_2", np.array(LEADS, dtype=object), {"long_name": "the other lead"}),
        "qrs_time_2": (
            "qrs_time_2",
            target.time[target.qrs_samples],
            {"units": "ms", "long_name": "the other time, from the R peak"},
        ),
        "qrs_time": (
            "qrs_time",
            target.time[target.qrs_samples],
            {"units": "ms", "long_name": "time from the R peak, within the QRS"},
        ),
    }
    dataset = xr.Dataset(variables, coords=coordinates, attrs=_attributes(target))
    for name in variables:
        dataset[name].encoding["zlib"] = True
    return dataset


def _beat_variables(target: Target) -> dict[str, Any]:
    """Beats, their mean and their spread."""
    millivolt = {"units": "mV"}
    return {
        "beats": (
            ("beat", "lead", "time"),
            target.beats,
            millivolt
            | {
                "long_name": "potential of each beat, isoelectric level removed",
                "comment": "NaN in leads that are not used.",
            },
        ),
        "mean": (("lead", "time"), target.mean, millivolt | {"long_name": "mean beat"}),
        "standard_deviation": (
            ("lead", "time"),
            target.standard_deviation,
            millivolt
            | {
                "long_name": "standard deviation of a beat about the mean"
                if target.noise is None
                else "standard deviation of a beat, as stated by the user"
            },
        ),
    }


def _covariance_variables(target: Target) -> dict[str, Any]:
    """Both factors of the residual covariance."""
    covariance = residual_covariance(target)
    explanation = (
        "The covariance of the beats about their mean, of lead l at time t with lead m at time s, "
        "is standard_deviation[l, t] * standard_deviation[m, s] * residual_covariance_leads[l, m] "
        "* residual_covariance_time[t, s]; both factors are correlations, shrunk towards none."
    )
    return {
        "residual_covariance_leads": (
            ("lead", "lead_2"),
            covariance.leads,
            {
                "units": "1",
                "long_name": "correlation of residuals across leads",
                "shrinkage": covariance.shrinkage_leads,
                "comment": explanation,
            },
        ),
        "residual_covariance_time": (
            ("qrs_time", "qrs_time_2"),
            covariance.time,
            {
                "units": "1",
                "long_name": "correlation of residuals across time, within the QRS",
                "shrinkage": covariance.shrinkage_time,
                "comment": explanation,
            },
        ),
    }


def _attributes(target: Target) -> dict[str, str | float | int]:
    attributes: dict[str, str | float | int] = {
        "Conventions": "CF-1.11",
        "title": "12-lead QRS target: aligned beats of one electrocardiogram",
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "software": f"fascicle {version('fascicle')}",
        "comment": (
            "The QRS lasts from qrs_onset_ms to qrs_offset_ms, counted from the R peak (time 0); "
            "their standard deviations are 0 where the user has given them. Attributes that begin "
            "with 'provenance_' say where the beats came from and what was chosen."
        ),
        "qrs_onset_ms": float(target.qrs_onset),
        "qrs_offset_ms": float(target.qrs_offset),
        "qrs_onset_sd_ms": float(target.onset_sd),
        "qrs_offset_sd_ms": float(target.offset_sd),
        "qrs_duration_ms": float(target.qrs_duration),
        "heart_rate_bpm": float(target.heart_rate),
    }
    if target.noise is not None:
        attributes["stated_noise_mV"] = float(target.noise)
    # a path may hold bytes that are no text
    texts = {key: str(text).encode("utf-8", "replace") for key, text in target.provenance.items()}
    return attributes | {_PREFIX + key: text.decode() for key, text in texts.items()}


def _check_format(dataset: xr.Dataset) -> str | None:
    """Tell what is not of this format."""
    found = dataset.attrs.get("format")
    if found != FORMAT:
        return f"not a target (format is {found!r})"
    number = dataset.attrs.get("format_version")
    if number != FORMAT_VERSION:
        return f"target of format version {number}, this fascicle reads {FORMAT_VERSION}"
    missing = [name for name in ("beats", "lead", "time") if name not in dataset.variables]
    missing += [name for name in _NUMBERS if name not in dataset.attrs]
    return f"damaged target without {', '.join(missing)}" if missing else None


def _check_beats(dataset: xr.Dataset) -> str | None:
    """Tell what is wrong with the beats."""
    beats = dataset["beats"]
    stated = "stated_noise_mV" in dataset.attrs
    if set(beats.dims) != {"beat", "lead", "time"}:
        return f"beats have sizes {dict(beats.sizes)}, not beat, lead and time"
    if dataset.sizes["beat"] < 2 and not stated:
        return f"{dataset.sizes['beat']} beats without a stated noise"
    leads = tuple(str(lead) for lead in dataset["lead"].to_numpy())
    if leads != LEADS:
        return f"leads are {', '.join(leads)}, not the standard 12"
    finite = np.isfinite(beats.transpose("lead", "beat", "time").to_numpy()).reshape(len(LEADS), -1)
    if not finite.any() or not (finite.all(axis=1) | ~finite.any(axis=1)).all():
        return "beats are not finite"
    return None


def _check_numbers(dataset: xr.Dataset) -> str | None:
    """Tell what is wrong with the time axis and the window."""
    time, attributes = dataset["time"].to_numpy(), dataset.attrs
    if not np.allclose(np.diff(time), SAMPLING_STEP):  # false for NaN, too
        return f"time does not run in steps of {SAMPLING_STEP:g} ms"
    names = [*_NUMBERS, *(["stated_noise_mV"] if "stated_noise_mV" in attributes else [])]
    for name in names:
        value = attributes[name]
        unknown = name == "heart_rate_bpm" and dataset.sizes["beat"] == 1  # one beat has no rate
        if not isinstance(value, (int, float, np.number)) or not (np.isfinite(value) or unknown):
            return f"{name} is {value!r}, not a number"
    onset, offset = attributes["qrs_onset_ms"], attributes["qrs_offset_ms"]
    if not time[0] <= onset < offset <= time[-1]:
        return f"QRS from {onset} to {offset} ms, beats from {time[0]} to {time[-1]} ms"
    return None


_CHECKS: tuple[Callable[[Any], str | None], ...] = (_check_format, _check_beats, _check_numbers)
