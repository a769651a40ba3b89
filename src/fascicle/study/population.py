"""Networks that a study finds, and their file: ArviZ InferenceData."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from fascicle.core import VERSION
from fascicle.core.arrays import Floats
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path
from fascicle.core.isolated import load_netcdf
from fascicle.core.parameters import MixedParameter, ParameterSpace
from fascicle.core.ranges import short_repr
from fascicle.emulation.predictive import Checks, Prediction
from fascicle.inference.evaluation import Evaluation
from fascicle.inference.tempered_sampling import SamplingRun
from fascicle.networks.prior import Prior
from fascicle.networks.settings import Method
from fascicle.recording.target import Target

if TYPE_CHECKING:  # imports the surrogate, which takes long to load
    from fascicle.inference.abc import Accepted

Item = TypeVar("Item")

# File of the networks, by method
RESULT: dict[Method, str] = {"paper": "population.nc", "posterior": "posterior.nc"}
# Groups of the posterior's file
FIRST_ALONE, AVERAGED = "posterior_first_alone", "averaged_over"


@dataclass(frozen=True)
class Population:
    """The networks that explain a target, and the best one.

    Attributes
    ----------
    values : mapping of name to (n,) array
        Parameters of the networks, in their units.
    losses : (n,) array
        Mismatch (mV²).
    best : mapping of name to float
        Parameters with the least mismatch of all evaluations, with those averaged over.
    best_loss : float
        Least mismatch (mV²).
    version : str
        Version of fascicle that has written the networks; empty if they were not read.
    """

    values: Mapping[str, Floats]
    losses: Floats
    best: Mapping[str, float]
    best_loss: float
    version: str = field(default="", kw_only=True)

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.losses)

    @property
    def effective_size(self) -> float:
        """Effective sample size, taken to be the number of networks."""
        return float(len(self))

    def parameters(self, k: int) -> dict[str, float]:
        """Named parameters of network `k`."""
        return {name: float(values[k]) for name, values in self.values.items()}


@dataclass(frozen=True)
class PaperPopulation(Population):
    """Networks that the paper's rule of acceptance keeps."""

    distances: Floats  # (n,), total variation of the per-beat errors from the best network's

    __repr__ = short_repr

    @classmethod
    def of(cls, space: ParameterSpace, accepted: Accepted) -> PaperPopulation:
        """Name the parameters of accepted evaluations."""
        best, losses = accepted.reference, np.array([e.loss for e in accepted.evaluations])
        points = np.array([draw.point[: len(space)] for draw in accepted.evaluations])
        values = space.columns(points.reshape(-1, len(space)))
        return cls(values, losses, space.from_unit(best.point), best.loss, accepted.distances)


@dataclass(frozen=True)
class Posterior(Population):
    """Equally weighted draws from a posterior, those of one run after those of the other.

    Attributes
    ----------
    log_likelihoods : (n, n_recordings) array
        Log-likelihood of each recording at each draw.
    log_evidences, effective, evaluations : (2,) arrays
        Log-evidence, effective sample size and evaluations of the emulator, of each run.
    means_apart : mapping of name to float
        Difference between the runs' means, in standard deviations.
    converged : bool
        Whether the runs agree, and their effective sample size is as large as the settings ask.
    averaged : mapping of name to (n,) array
        Quantities of the networks that are averaged over: unknown, and not reported.
    first_alone : mapping of name to (m,) array, optional
        With several recordings, draws from the posterior given the first, if it has converged.
    states : mapping of name to float
        Probability of each conduction state, if the state is learnt; ``averaged["conduction"]``
        then holds the number of each network's state.
    unnamed : str
        Reason why no state is named despite these probabilities; else empty.
    """

    log_likelihoods: Floats
    log_evidences: Floats
    effective: Floats
    evaluations: Floats
    means_apart: Mapping[str, float]
    converged: bool
    averaged: Mapping[str, Floats] = field(default_factory=dict)
    first_alone: Mapping[str, Floats] | None = None
    states: Mapping[str, float] = field(default_factory=dict)
    unnamed: str = ""

    __repr__ = short_repr

    def parameters(self, k: int) -> dict[str, float]:
        """Named parameters of network `k`, with those averaged over."""
        averaged = {name: float(values[k]) for name, values in self.averaged.items()}
        return super().parameters(k) | {n: v for n, v in averaged.items() if np.isfinite(v)}

    def in_state(self, number: float) -> Posterior:
        """Posterior with the number of its conduction state as the quantity ``conduction``."""
        averaged = {**self.averaged, "conduction": np.full(len(self), number)}
        return replace(self, averaged=averaged, best={**self.best, "conduction": number})

    @property
    def effective_size(self) -> float:
        """Effective sample size of the runs together, half of whose draws are from each."""
        effective = np.minimum(self.effective, len(self) / len(self.effective))
        return float(len(effective) ** 2 / (1 / effective).sum())

    @classmethod
    def of(
        cls,
        prior: Prior,
        draws: Sequence[Evaluation],
        best: Evaluation,
        runs: Sequence[SamplingRun],
        means_apart: Floats,
        converged: bool,
    ) -> Posterior:
        """Name the parameters of draws, as many from each run, and of the best evaluation."""
        networks = [prior.from_unit(draw.point) for draw in draws]
        settled = {*prior.names, *prior.fixed}
        averaged = sorted({name for network in networks for name in network if name not in settled})
        best_network = prior.from_unit(best.point)
        return cls(
            prior.learnt_columns(np.array([draw.point for draw in draws])),
            np.array([draw.loss for draw in draws]),
            {n: value for n, value in best_network.items() if n not in prior.fixed},
            best.loss,
            np.array([draw.log_likelihoods for draw in draws]),
            np.array([run.log_evidence for run in runs]),
            np.array([run.effective for run in runs]),
            np.array([float(run.evaluations) for run in runs]),
            # the means of quantities averaged over follow
            dict(zip(prior.names, map(float, means_apart), strict=False)),
            converged,
            {n: np.array([network.get(n, np.nan) for network in networks]) for n in averaged},
        )


def evenly_spread(total: int, count: int) -> list[int]:
    """Indices of `count` networks evenly spread over `total`; all indices if there are no more."""
    return [round(k) for k in np.linspace(0, total - 1, min(count, total))]


def write_population(
    path: Path,
    population: Population,
    space: ParameterSpace,
    targets: Sequence[Target],
    predicted: Floats | Sequence[Prediction],
    attributes: Mapping[str, Any],
) -> None:
    """Write the networks as ArviZ InferenceData, whole or not at all.

    Each run of the sampler of a posterior is a chain. Variables of all recordings but the first
    end in the recording's number: ``ecg_2``. `predicted` holds the networks' ECGs (n, 12 + k,
    n_time) (mV), aligned with the target's time; for a posterior, the prediction of each recording.
    """
    with warnings.catch_warnings():  # ArviZ announces its next major version at every import
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
        import xarray as xr

    groups = _groups(population, predicted)
    chains = 2 if isinstance(population, Posterior) else 1
    split = {
        group: {name: v.reshape(chains, -1, *v.shape[1:]) for name, v in variables.items()}
        for group, variables in groups.items()
    }
    if isinstance(population, Posterior):  # prior draws, of a fixed seed
        drawn = space.columns(np.random.default_rng(0).random((1000, len(space))))
        split["prior"] = {name: values[None] for name, values in drawn.items()}
    with warnings.catch_warnings():  # ArviZ takes an empty population for transposed arrays
        warnings.filterwarnings("ignore", "More chains")
        data = az.from_dict(
            **split,
            observed_data={f"ecg{end}": target.mean for end, target in _numbered(targets)},
            constant_data={f"beats{end}": target.beats for end, target in _numbered(targets)},
            coords={key: list(targets[0].leads) for key in ("lead", "lead_in_plain_torso")}
            | {f"time{e}": t.time for e, t in _numbered(targets)},
            dims={
                f"{name}{end}": [*first, "lead", f"time{end}"]
                for end, _ in _numbered(targets)
                for name, first in (("ecg", []), ("ecg_model", []), ("beats", [f"beat{end}"]))
            }
            | {f"torso{end}": ["lead", "lead_in_plain_torso"] for end, _ in _numbered(targets)},
        )
    data.attrs.update(attributes)
    for parameter in space.parameters:
        data.posterior[parameter.name].attrs = {
            "units": parameter.unit,
            "prior_lower": parameter.lower,
            "prior_upper": parameter.upper,
            "prior": "mixture" if isinstance(parameter, MixedParameter) else parameter.prior,
            **{
                f"prior_{name}": value
                for name in ("median", "sd", "order")
                if (value := getattr(parameter, name)) is not None
            },
            "best": population.best[parameter.name],
        }
        if isinstance(population, Posterior):
            apart = population.means_apart[parameter.name]
            data.posterior[parameter.name].attrs["means_apart"] = apart
    _describe(data, population)
    if not isinstance(predicted, np.ndarray):
        checks = Checks.joined([prediction.checks for prediction in predicted])
        data.sample_stats.attrs["checks"] = json.dumps(asdict(checks))
    if isinstance(population, Posterior):
        for group, variables in (
            (FIRST_ALONE, population.first_alone),
            (AVERAGED, population.averaged),
        ):
            if variables:
                dataset = xr.Dataset({name: ("draw", values) for name, values in variables.items()})
                for name in population.best.keys() & variables.keys() if group == AVERAGED else ():
                    dataset[name].attrs["best"] = population.best[name]
                if "conduction" in dataset:  # as the CF conventions name flags
                    meanings = " ".join(name.replace(" ", "_") for name in CONDUCTION_STATES)
                    flags = {
                        "flag_values": np.arange(len(CONDUCTION_STATES)),
                        "flag_meanings": meanings,
                    }
                    dataset["conduction"].attrs.update(flags)
                data.sample_stats.attrs[group] = 1
                data.add_groups({group: dataset}, warn_on_custom_groups=False)
    with atomic_path(path) as temporary:
        data.to_netcdf(str(temporary), engine="h5netcdf")


def _numbered(items: Sequence[Item]) -> list[tuple[str, Item]]:
    """Items of the recordings, each after the suffix of its variables' names."""
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
            f"torso{end}": prediction.torsos.astype(np.float32),
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
    """Add units, and attributes of the whole sample, to the data."""
    units = {"loss": "mV2", "onset_shift": "ms", "discrepancy": "mV", "gain": "1", "torso": "1"}
    stats = data.sample_stats
    for name in stats.data_vars:
        unit = units.get(re.sub(r"_\d+$", "", str(name)))
        if unit is not None:
            stats[name].attrs["units"] = unit
    stats.attrs["best_loss"] = population.best_loss
    stats.attrs["version"] = VERSION
    if isinstance(population, Posterior):
        stats.attrs["converged"] = int(population.converged)
        stats.attrs["states"] = json.dumps(dict(population.states))
        stats.attrs["unnamed"] = population.unnamed
        for name in ("log_evidences", "effective", "evaluations"):
            stats.attrs[name] = getattr(population, name)
    for group in (data.posterior_predictive, data.observed_data, data.constant_data):
        for name in group.data_vars:
            group[name].attrs["units"] = "mV"
        for name in group.coords:
            if str(name).startswith("time"):
                group[name].attrs.update(units="ms", long_name="time from the R peak")


def read_population(path: Path) -> Population:
    """Read networks written by `write_population`."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; finish the study with 'fascicle fit'")
    try:
        posterior, stats = load_netcdf(path, "posterior"), load_netcdf(path, "sample_stats")
        names = [str(name) for name in posterior.data_vars]
        values = {name: posterior[name].to_numpy().ravel() for name in names}
        losses = stats["loss"].to_numpy().ravel()
        best = {name: float(posterior[name].attrs["best"]) for name in names}
        best_loss, version = float(stats.attrs["best_loss"]), stats.attrs.get("version", "")
        if "distance" in stats:
            distances = stats["distance"].to_numpy().ravel()
            return PaperPopulation(values, losses, best, best_loss, distances, version=version)
        logs = load_netcdf(path, "log_likelihood")
        numbered = _numbered(list(logs.data_vars))
        stored = {g: load_netcdf(path, g) for g in (FIRST_ALONE, AVERAGED) if g in stats.attrs}
        groups = {
            group: {str(name): values.to_numpy() for name, values in data.data_vars.items()}
            for group, data in stored.items()
        }
        for name, variable in stored[AVERAGED].data_vars.items() if AVERAGED in stored else ():
            if "best" in variable.attrs:
                best[str(name)] = float(variable.attrs["best"])
        return Posterior(
            values,
            losses,
            best,
            best_loss,
            np.stack([logs[f"ecg{end}"].to_numpy().ravel() for end, _ in numbered], axis=1),
            log_evidences=np.asarray(stats.attrs["log_evidences"]),
            effective=np.asarray(stats.attrs["effective"]),
            evaluations=np.asarray(stats.attrs["evaluations"]),
            means_apart={name: float(posterior[name].attrs["means_apart"]) for name in names},
            converged=bool(stats.attrs["converged"]),
            averaged=groups.get(AVERAGED, {}),
            first_alone=groups.get(FIRST_ALONE),
            states=json.loads(stats.attrs.get("states", "{}")),
            unnamed=str(stats.attrs.get("unnamed", "")),
            version=version,
        )
    except (OSError, KeyError, ValueError, IndexError, TypeError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{path}: not a readable result ({first}); run 'fascicle fit' again to rewrite it"
        ) from None


def read_checks(
    path: Path,
) -> tuple[Checks | None, Floats | None, Floats | None, tuple[Floats, ...]]:
    """Read a posterior's checks, its gains and torsos, and its ECGs for each recording.

    Gains have shape (n,), torsos (n, 12 + k, 12 + k), ECGs (n, 12 + k, n_time) (mV). The paper's
    population has none of these.
    """
    stats = load_netcdf(path, "sample_stats")
    if "gain" not in stats:
        return None, None, None, ()
    if "checks" not in stats.attrs:
        raise InputError(f"{path}: of an earlier version; fit again, into another folder")
    predictive = load_netcdf(path, "posterior_predictive")
    names = sorted(str(name) for name in predictive.data_vars if str(name).startswith("ecg_model"))
    torsos = stats["torso"].to_numpy().astype(float) if "torso" in stats else None
    ecgs = (predictive[name].to_numpy().astype(float) for name in names)
    return (
        Checks.from_json(stats.attrs["checks"]),
        stats["gain"].to_numpy().ravel(),
        None if torsos is None else torsos.reshape(-1, *torsos.shape[2:]),
        tuple(ecg.reshape(-1, *ecg.shape[2:]) for ecg in ecgs),
    )
