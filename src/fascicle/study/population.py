"""Posteriors as ArviZ InferenceData in netCDF."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path
from fascicle.core.leads import LEADS
from fascicle.core.parameters import ParameterSpace
from fascicle.recording.target import Target


@dataclass(frozen=True)
class Accepted:
    """The accepted networks of a study, and the best one.

    Attributes
    ----------
    values : mapping of name to (n,) array
        Parameters of the accepted networks, in their units.
    losses, distances : (n,) arrays
        Mismatch (mV²), and total-variation distance of the per-beat errors from the best's.
    best : mapping of name to float
        The parameters with the least mismatch.
    best_loss : float
        That mismatch (mV²).
    """

    values: Mapping[str, NDArray[np.float64]]
    losses: NDArray[np.float64]
    distances: NDArray[np.float64]
    best: Mapping[str, float]
    best_loss: float

    def __len__(self) -> int:
        return len(self.losses)

    def parameters(self, k: int) -> dict[str, float]:
        """Named parameters of network `k`."""
        return {name: float(values[k]) for name, values in self.values.items()}


def write_posterior(
    path: Path,
    accepted: Accepted,
    space: ParameterSpace,
    target: Target,
    predicted: NDArray[np.float64],
) -> None:
    """Write a posterior, whole or not at all.

    Parameters
    ----------
    path : Path
        The netCDF file.
    accepted : Accepted
        The networks.
    space : ParameterSpace
        Units and ranges of the parameters.
    target : Target
        The recorded beats, as observed data.
    predicted : (n, 12, n_time) array
        The networks' ECGs aligned with the target's time (mV), as posterior predictive.
    """
    with warnings.catch_warnings():  # announces its next major version at every import
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az

    data = az.from_dict(
        posterior={name: values[None] for name, values in accepted.values.items()},
        sample_stats={"loss": accepted.losses[None], "distance": accepted.distances[None]},
        posterior_predictive={"ecg": predicted[None]},
        observed_data={"ecg": target.mean},
        coords={"lead": list(LEADS), "time": target.time},
        dims={"ecg": ["lead", "time"]},
    )
    for parameter in space.parameters:
        data.posterior[parameter.name].attrs = {
            "units": parameter.unit,
            "prior_lower": parameter.lower,
            "prior_upper": parameter.upper,
            "best": accepted.best[parameter.name],
        }
    data.sample_stats["loss"].attrs["units"] = "mV2"
    data.sample_stats.attrs["best_loss"] = accepted.best_loss
    for group in (data.posterior_predictive, data.observed_data):
        group["ecg"].attrs["units"] = "mV"
        group["time"].attrs.update(units="ms", long_name="time from the R peak")
    with atomic_path(path) as temporary:
        data.to_netcdf(str(temporary), engine="h5netcdf")


def read_posterior(path: Path) -> Accepted:
    """Read the networks of a posterior written by `write_posterior`.

    Raises
    ------
    InputError
        If the file is missing or is not such a posterior.
    """
    import xarray as xr

    if not path.is_file():
        raise InputError(f"{path}: no such posterior; finish the study with 'fascicle fit'")
    try:
        with (
            xr.open_dataset(path, group="posterior", engine="h5netcdf") as posterior,
            xr.open_dataset(path, group="sample_stats", engine="h5netcdf") as stats,
        ):
            names = [str(name) for name in posterior.data_vars]
            return Accepted(
                {name: posterior[name].to_numpy()[0] for name in names},
                stats["loss"].to_numpy()[0],
                stats["distance"].to_numpy()[0],
                {name: float(posterior[name].attrs["best"]) for name in names},
                float(stats.attrs["best_loss"]),
            )
    except (OSError, KeyError, ValueError, IndexError, TypeError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{path}: not a readable posterior ({first}); run 'fascicle fit' again to rewrite it"
        ) from None
