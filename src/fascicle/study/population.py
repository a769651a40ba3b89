"""The population of networks that a study finds, and its file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import write_bytes
from fascicle.core.leads import LEADS
from fascicle.core.parameters import ParameterSpace
from fascicle.inference.abc.rejection import Sampling
from fascicle.recording.target import Target
from fascicle.study.settings import Method

# The file that holds the networks, called what it is
RESULT: dict[Method, str] = {"paper": "population.nc", "posterior": "posterior.nc"}


@dataclass(frozen=True)
class Population:
    """The networks that explain a target, and the best one.

    Attributes
    ----------
    values : mapping of name to (n,) array
        Parameters of the networks, in their units.
    losses, distances : (n,) arrays
        Mismatch (mV²), and total-variation distance of the per-beat errors from the best's.
    best : mapping of name to float
        θ_min: the parameters with the least mismatch that the search has found.
    best_loss : float
        That mismatch (mV²).
    """

    values: Mapping[str, Floats]
    losses: Floats
    distances: Floats
    best: Mapping[str, float]
    best_loss: float

    @classmethod
    def of(cls, space: ParameterSpace, sampling: Sampling) -> Population:
        """Name the parameters of accepted evaluations.

        Parameters
        ----------
        space : ParameterSpace
            The d parameters.
        sampling : Sampling
            What was accepted.
        """
        accepted, best = sampling.accepted, sampling.reference
        named = [space.from_unit(evaluation.point) for evaluation in accepted]
        return cls(
            {name: np.array([values[name] for values in named]) for name in space.names},
            np.array([evaluation.loss for evaluation in accepted]),
            sampling.distances,
            space.from_unit(best.point),
            best.loss,
        )

    def __len__(self) -> int:
        return len(self.losses)

    def parameters(self, k: int) -> dict[str, float]:
        """Named parameters of network `k`."""
        return {name: float(values[k]) for name, values in self.values.items()}


def write_population(
    path: Path,
    population: Population,
    space: ParameterSpace,
    target: Target,
    predicted: Floats,
    called: str,
) -> None:
    """Write a population as ArviZ InferenceData, whole or not at all.

    Parameters
    ----------
    path : Path
        The netCDF file.
    population : Population
        The n networks.
    space : ParameterSpace
        Units and ranges of the parameters.
    target : Target
        The recorded beats, as observed data.
    predicted : (n, 12, n_time) array
        The networks' ECGs aligned with the target's time (mV).
    called : str
        What the networks are, for readers of the file: its groups have ArviZ's names.
    """
    with warnings.catch_warnings():  # announces its next major version at every import
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az

    with warnings.catch_warnings():  # nothing accepted is no mistake in the shape of the arrays
        warnings.filterwarnings("ignore", "More chains")
        data = az.from_dict(
            posterior={name: values[None] for name, values in population.values.items()},
            sample_stats={"loss": population.losses[None], "distance": population.distances[None]},
            posterior_predictive={"ecg": predicted[None]},
            observed_data={"ecg": target.mean},
            coords={"lead": list(LEADS), "time": target.time},
            dims={"ecg": ["lead", "time"]},
        )
    data.attrs["networks_are"] = called
    for parameter in space.parameters:
        data.posterior[parameter.name].attrs = {
            "units": parameter.unit,
            "prior_lower": parameter.lower,
            "prior_upper": parameter.upper,
            "prior": parameter.prior,
            **{
                f"prior_{name}": value
                for name in ("median", "sd")
                if (value := getattr(parameter, name)) is not None
            },
            "best": population.best[parameter.name],
        }
    data.sample_stats["loss"].attrs["units"] = "mV2"
    data.sample_stats.attrs["best_loss"] = population.best_loss
    for group in (data.posterior_predictive, data.observed_data):
        group["ecg"].attrs["units"] = "mV"
        group["time"].attrs.update(units="ms", long_name="time from the R peak")
    write_bytes(path, data.to_datatree().to_netcdf(engine="h5netcdf"))


def read_population(path: Path) -> Population:
    """Read a population written by `write_population`.

    Raises
    ------
    InputError
        If the file is missing or holds something else.
    """
    import xarray as xr

    if not path.is_file():
        raise InputError(f"{path}: no such file; finish the study with 'fascicle fit'")
    try:
        with (
            xr.open_dataset(path, group="posterior", engine="h5netcdf") as posterior,
            xr.open_dataset(path, group="sample_stats", engine="h5netcdf") as stats,
        ):
            names = [str(name) for name in posterior.data_vars]
            return Population(
                {name: posterior[name].to_numpy()[0] for name in names},
                stats["loss"].to_numpy()[0],
                stats["distance"].to_numpy()[0],
                {name: float(posterior[name].attrs["best"]) for name in names},
                float(stats.attrs["best_loss"]),
            )
    except (OSError, KeyError, ValueError, IndexError, TypeError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{path}: not a readable result ({first}); run 'fascicle fit' again to rewrite it"
        ) from None
