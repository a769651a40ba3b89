"""The file of the networks of a study: ArviZ InferenceData."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path
from fascicle.core.leads import LEADS
from fascicle.core.netcdf import load_netcdf
from fascicle.core.parameters import ParameterSpace
from fascicle.recording.target import Target
from fascicle.study.population import PaperPopulation, Population, Posterior
from fascicle.study.predictive import Checks, Prediction

if TYPE_CHECKING:
    import xarray as xr

Item = TypeVar("Item")

PRIOR_DRAWS = 1000  # of each parameter, for comparison with the posterior
SHARE, PROBABILITIES = "discrepancy_over_signal", "probabilities_under_the_model"
FIRST_ALONE = "posterior_first_alone"  # group
RUN_STATISTICS = ("log_evidences", "effective", "evaluations")


def write_population(
    path: Path,
    population: Population,
    space: ParameterSpace,
    targets: Sequence[Target],
    predicted: Floats | Sequence[Prediction],
    attributes: Mapping[str, Any],
) -> None:
    """Write the networks as ArviZ InferenceData, whole or not at all.

    Parameters
    ----------
    path : Path
        The netCDF file.
    population : Population
        The n networks. Of a posterior, each run of the sampler is a chain.
    space : ParameterSpace
        Units and priors of the parameters.
    targets : sequence of Target
        The recorded beats, as observed data. Variables of all but the first end in their numbers:
        ``ecg_2``.
    predicted : (n, 12, n_time) array or sequence of Prediction
        The networks' ECGs aligned with the target's time (mV); of a posterior with the noise, too,
        and of each recording.
    attributes : mapping
        Of the file: what the networks are, and where they come from.
    """
    with warnings.catch_warnings():  # announces its next major version at every import
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
        import xarray as xr

    groups = _groups(population, predicted)
    chains = 2 if isinstance(population, Posterior) else 1
    split = {
        group: {name: v.reshape(chains, -1, *v.shape[1:]) for name, v in variables.items()}
        for group, variables in groups.items()
    }
    if isinstance(population, Posterior):
        shares = np.random.default_rng(0).random((PRIOR_DRAWS, len(space)))
        split["prior"] = {
            p.name: p.from_unit(share)[None]
            for p, share in zip(space.parameters, shares.T, strict=True)
        }
    with warnings.catch_warnings():  # nothing accepted is no mistake in the shape of the arrays
        warnings.filterwarnings("ignore", "More chains")
        data = az.from_dict(
            **split,
            observed_data={
                f"{name}{end}": values
                for end, target in _numbered(targets)
                for name, values in (("ecg", target.mean), ("beats", target.beats))
            },
            coords={"lead": list(LEADS)} | {f"time{e}": t.time for e, t in _numbered(targets)},
            dims={
                f"{name}{end}": [*first, "lead", f"time{end}"]
                for end, _ in _numbered(targets)
                for name, first in (("ecg", []), ("ecg_model", []), ("beats", [f"beat{end}"]))
            },
        )
    data.attrs.update(attributes)
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
        if isinstance(population, Posterior):
            apart = population.means_apart[parameter.name]
            data.posterior[parameter.name].attrs["means_apart"] = apart
    _describe(data, population)
    if not isinstance(predicted, np.ndarray):
        checks = Checks.joined([each.checks for each in predicted])
        data.sample_stats.attrs[SHARE] = checks.share
        data.sample_stats.attrs[PROBABILITIES] = json.dumps(dict(checks.probabilities))
    if isinstance(population, Posterior) and population.first_alone is not None:
        alone = {name: ("draw", values) for name, values in population.first_alone.items()}
        data.sample_stats.attrs[FIRST_ALONE] = 1
        data.add_groups({FIRST_ALONE: xr.Dataset(alone)}, warn_on_custom_groups=False)
    with atomic_path(path) as temporary:
        data.to_netcdf(str(temporary), engine="h5netcdf")


def _numbered(items: Sequence[Item]) -> list[tuple[str, Item]]:
    """Each with what the names of its variables end in."""
    return [(f"_{k}" if k > 1 else "", item) for k, item in enumerate(items, 1)]


def _groups(
    population: Population, predicted: Floats | Sequence[Prediction]
) -> dict[str, dict[str, Floats]]:
    """Arrays (n, ...) by group and name."""
    groups = {
        "posterior": dict(population.values),
        "sample_stats": {"loss": population.losses},
        "posterior_predictive": {},
    }
    if isinstance(predicted, np.ndarray):
        groups["posterior_predictive"] = {"ecg": predicted}
        predicted = ()
    for end, prediction in _numbered(predicted):
        groups["posterior_predictive"] |= {
            f"ecg{end}": prediction.noisy.astype(np.float32),
            f"ecg_model{end}": prediction.ecg.astype(np.float32),
        }
        groups["sample_stats"] |= {
            f"gain{end}": prediction.gains,
            f"onset_shift{end}": prediction.shifts,
            f"discrepancy{end}": prediction.discrepancies,
        }
    if isinstance(population, PaperPopulation):
        groups["sample_stats"]["distance"] = population.distances
    if isinstance(population, Posterior):
        groups["log_likelihood"] = {
            f"ecg{end}": values for end, values in _numbered(list(population.log_likelihoods.T))
        }
    return groups


def _describe(data: Any, population: Population) -> None:
    """Units, and what holds for the whole sample."""
    units = {"loss": "mV2", "onset_shift": "ms", "discrepancy": "mV", "gain": "1"}
    stats = data.sample_stats
    for name in stats.data_vars:
        unit = units.get(re.sub(r"_\d+$", "", str(name)))
        if unit is not None:
            stats[name].attrs["units"] = unit
    stats.attrs["best_loss"] = population.best_loss
    if isinstance(population, Posterior):
        stats.attrs["converged"] = int(population.converged)
        for name in RUN_STATISTICS:
            stats.attrs[name] = getattr(population, name)
    for group in (data.posterior_predictive, data.observed_data):
        for name in group.data_vars:
            group[name].attrs["units"] = "mV"
        for name in group.coords:
            if str(name).startswith("time"):
                group[name].attrs.update(units="ms", long_name="time from the R peak")


def read_population(path: Path) -> Population:
    """Read networks written by `write_population`.

    Raises
    ------
    InputError
        If the file is missing or holds something else.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; finish the study with 'fascicle fit'")
    try:
        posterior, stats = load_netcdf(path, "posterior"), _statistics(path)
        names = [str(name) for name in posterior.data_vars]
        values = {name: posterior[name].to_numpy().ravel() for name in names}
        losses = stats["loss"].to_numpy().ravel()
        best = {name: float(posterior[name].attrs["best"]) for name in names}
        best_loss = float(stats.attrs["best_loss"])
        if "distance" in stats:
            distances = stats["distance"].to_numpy().ravel()
            return PaperPopulation(values, losses, best, best_loss, distances)
        return Posterior(
            values,
            losses,
            best,
            best_loss,
            _log_likelihoods(load_netcdf(path, "log_likelihood")),
            log_evidences=np.asarray(stats.attrs["log_evidences"]),
            effective=np.asarray(stats.attrs["effective"]),
            evaluations=np.asarray(stats.attrs["evaluations"]),
            means_apart={name: float(posterior[name].attrs["means_apart"]) for name in names},
            converged=bool(stats.attrs["converged"]),
            first_alone=_first_alone(path) if FIRST_ALONE in stats.attrs else None,
        )
    except (OSError, KeyError, ValueError, IndexError, TypeError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{path}: not a readable result ({first}); run 'fascicle fit' again to rewrite it"
        ) from None


def _log_likelihoods(stored: xr.Dataset) -> Floats:
    """Of every draw and recording, (n, n_recordings)."""
    names = [f"ecg{end}" for end, _ in _numbered(list(stored.data_vars))]
    return np.stack([stored[name].to_numpy().ravel() for name in names], axis=1)


def _first_alone(path: Path) -> dict[str, Floats]:
    """Draws from the posterior of the first of several recordings."""
    stored = load_netcdf(path, FIRST_ALONE)
    return {str(name): values.to_numpy() for name, values in stored.data_vars.items()}


def read_gains(path: Path) -> Floats | None:
    """Gains (n,) that were drawn with a posterior, for its first recording; None of others."""
    stats = _statistics(path)
    return stats["gain"].to_numpy().ravel() if "gain" in stats else None


def read_checks(path: Path) -> Checks | None:
    """How a posterior written by `write_population` compares with its recording; None of others."""
    stats = _statistics(path)
    if SHARE not in stats.attrs:
        return None
    return Checks(float(stats.attrs[SHARE]), json.loads(stats.attrs[PROBABILITIES]))


def _statistics(path: Path) -> xr.Dataset:
    return load_netcdf(path, "sample_stats")
