"""Targets as netCDF files that explain themselves."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fascicle.errors import InputError
from fascicle.io.atomic import atomic_path
from fascicle.leads import LEADS
from fascicle.recording.target import SAMPLING_STEP, Target

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "fascicle target"
FORMAT_VERSION = 1
_PREFIX = "provenance_"
_NUMBERS = ("qrs_onset_ms", "qrs_offset_ms", "heart_rate_bpm")


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
    _check(dataset, path)
    return Target(
        beats=dataset["beats"].transpose("beat", "lead", "time").to_numpy().astype(np.float64),
        time=dataset["time"].to_numpy().astype(np.float64),
        qrs_onset=float(dataset.attrs["qrs_onset_ms"]),
        qrs_offset=float(dataset.attrs["qrs_offset_ms"]),
        heart_rate=float(dataset.attrs["heart_rate_bpm"]),
        provenance={
            str(key).removeprefix(_PREFIX): str(value)
            for key, value in dataset.attrs.items()
            if str(key).startswith(_PREFIX)
        },
    )


def _to_dataset(target: Target) -> xr.Dataset:
    """Build the dataset with units on everything."""
    import xarray as xr

    millivolt = {"units": "mV"}
    variables = {
        "beats": (
            ("beat", "lead", "time"),
            target.beats,
            millivolt | {"long_name": "potential of each beat, isoelectric level removed"},
        ),
        "mean": (("lead", "time"), target.mean, millivolt | {"long_name": "mean beat"}),
        "standard_deviation": (
            ("lead", "time"),
            target.standard_deviation,
            millivolt | {"long_name": "standard deviation from beat to beat"},
        ),
    }
    coordinates = {
        "beat": ("beat", np.arange(len(target.beats)), {"units": "1", "long_name": "beat"}),
        "lead": ("lead", np.array(LEADS, dtype=object), {"long_name": "electrocardiogram lead"}),
        "time": ("time", target.time, {"units": "ms", "long_name": "time from the R peak"}),
    }
    dataset = xr.Dataset(variables, coords=coordinates, attrs=_attributes(target))
    for name in variables:
        dataset[name].encoding["zlib"] = True
    return dataset


def _attributes(target: Target) -> dict[str, str | float | int]:
    attributes: dict[str, str | float | int] = {
        "Conventions": "CF-1.11",
        "title": "12-lead QRS target: aligned beats of one electrocardiogram",
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "software": f"fascicle {version('fascicle')}",
        "comment": (
            "The QRS lasts from qrs_onset_ms to qrs_offset_ms, counted from the R peak (time 0). "
            "Attributes that begin with 'provenance_' say where the beats came from."
        ),
        "qrs_onset_ms": float(target.qrs_onset),
        "qrs_offset_ms": float(target.qrs_offset),
        "qrs_duration_ms": float(target.qrs_duration),
        "heart_rate_bpm": float(target.heart_rate),
    }
    return attributes | {_PREFIX + key: str(text) for key, text in target.provenance.items()}


def _check(dataset: xr.Dataset, path: Path) -> None:
    """Refuse datasets that are not targets, or are damaged ones."""
    remake = "make the target again with 'fascicle target'"
    found = dataset.attrs.get("format")
    if found != FORMAT:
        raise InputError(f"{path}: not a target (format is {found!r}); {remake}")
    number = dataset.attrs.get("format_version")
    if number != FORMAT_VERSION:
        raise InputError(
            f"{path}: target of format version {number}, this fascicle reads {FORMAT_VERSION}; "
            f"{remake}"
        )
    missing = [name for name in ("beats", "lead", "time") if name not in dataset.variables]
    missing += [name for name in _NUMBERS if name not in dataset.attrs]
    if missing:
        raise InputError(f"{path}: damaged target without {', '.join(missing)}; {remake}")
    if set(dataset["beats"].dims) != {"beat", "lead", "time"} or dataset.sizes["beat"] < 2:
        sizes = dict(dataset["beats"].sizes)
        raise InputError(f"{path}: beats have sizes {sizes}, at least 2 beats needed; {remake}")
    leads = tuple(str(lead) for lead in dataset["lead"].to_numpy())
    if leads != LEADS:
        raise InputError(f"{path}: leads are {', '.join(leads)}, not the standard 12; {remake}")
    if not np.isfinite(dataset["beats"].to_numpy()).all():
        raise InputError(f"{path}: beats are not finite; {remake}")
    time = dataset["time"].to_numpy()
    if not np.allclose(np.diff(time), SAMPLING_STEP):  # false for NaN, too
        raise InputError(f"{path}: time does not run in steps of {SAMPLING_STEP:g} ms; {remake}")
    numbers = [dataset.attrs[name] for name in _NUMBERS]
    if not all(isinstance(n, (int, float, np.number)) and np.isfinite(n) for n in numbers):
        raise InputError(f"{path}: {', '.join(_NUMBERS)} are {numbers}, not numbers; {remake}")
    onset, offset = dataset.attrs["qrs_onset_ms"], dataset.attrs["qrs_offset_ms"]
    if not time[0] <= onset < offset <= time[-1]:
        raise InputError(
            f"{path}: QRS from {onset} to {offset} ms, beats from {time[0]} to {time[-1]} ms; "
            f"{remake}"
        )
