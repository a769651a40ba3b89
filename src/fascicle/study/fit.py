"""Fitting a population of networks to a target: the study, its results, its figures."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import ValidationError

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_folder, write_text
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.core.progress import Progress
from fascicle.forward.compile_kernels import compile_kernels
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Heart
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.formats.vtk import write_grid
from fascicle.purkinje.tree_files import write_tree
from fascicle.recording.target import Target
from fascicle.recording.target_files import read_target, write_target
from fascicle.study.networks import Network, simulate_all, simulate_best
from fascicle.study.population import Accepted, read_posterior, write_posterior
from fascicle.study.problem import Problem
from fascicle.study.settings import StudyConfig
from fascicle.study.study import Study

if TYPE_CHECKING:
    from fascicle.study.posterior_result import Posterior

POSTERIOR = "posterior.nc"
WORKERS = 2  # default; fixed rather than the number of cores, so that results travel


@dataclass(frozen=True)
class FittedStudy:
    """A finished study, read back from its folder.

    Attributes
    ----------
    folder : Path
        Where it is.
    study : Study
        Configuration and evaluations.
    problem : Problem
        Forward model and target.
    accepted : Accepted
        The posterior sample of networks.
    """

    folder: Path
    study: Study
    problem: Problem
    accepted: Accepted

    @property
    def best_initial_loss(self) -> float:
        """Least mismatch among the points of the Latin hypercube (mV²)."""
        outcomes = [r.evaluation for r in self.study.records() if r.stage == "initial"]
        return min(evaluation.loss for evaluation in outcomes if evaluation.feasible)

    def networks(self, progress: Progress | None = None) -> list[Network]:
        """Simulate the accepted networks; the best one alone where none was accepted."""
        if progress is not None:
            compile_kernels(progress)
        if not len(self.accepted):
            return [simulate_best(self.problem, self.accepted)]
        return simulate_all(
            self.problem,
            self.accepted,
            None if progress is None else lambda done, total: progress("networks", done, total, ""),
        )


def fit(
    heart: Heart | Path | str,
    target: Target | Path | str,
    out: Path | str,
    *,
    initial: int = 250,
    steps: int = 300,
    refine: int = 200,
    samples: int = 30,
    seed: int = 0,
    workers: int = WORKERS,
    draws: int = 5_000_000,
    candidate_order: Literal["random", "density"] = "random",
    free_gain: bool = False,
    progress: Progress | None = None,
) -> FittedStudy:
    """Fit a population of Purkinje networks to a target.

    Started again on the same folder it resumes, and with one worker gives exactly the result of a
    run that was never interrupted.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    target : Target or path
        The target, or its netCDF file.
    out : path
        Folder of the study.
    initial, steps, refine, samples : int
        Latin hypercube points, Bayesian-optimisation steps, generations of refinement (up
        to 20 simulations each; 0 leaves it out, as in the paper), networks to accept.
    seed : int
        Of every random number.
    workers : int
        Simulations at a time, and networks proposed per optimisation step; part of the study.
    draws : int
        Uniform draws for the informed prior in each posterior round.
    candidate_order : {"random", "density"}
        Order in which posterior candidates are tried: at random, which does not prefer modes, or
        by descending prior density as in the paper.
    free_gain : bool
        Whether each simulated ECG is scaled by its best global gain before it is compared.
    progress : callable, optional
        Told how far each stage is.

    Returns
    -------
    FittedStudy

    Raises
    ------
    InputError
        If an input cannot be used, or the folder holds another study.
    """
    heart = load_heart(heart) if not isinstance(heart, Heart) else heart
    target = read_target(target) if not isinstance(target, Target) else target
    if workers < 1:
        raise InputError(f"workers is {workers}; at least 1 is needed")
    folder = Path(out)
    config = _config(
        heart=heart.digest,
        target=target_digest(target),
        space=StudyConfig.free(NETWORK_SPACE),
        gain=free_gain,
        initial=initial,
        steps=steps,
        refine=refine,
        samples=samples,
        batch=workers,
        draws=draws,
        candidate_order=candidate_order,
        seed=seed,
    )
    study = Study.create_or_resume(folder, config)
    if not (folder / "heart").exists():
        write_heart(heart, folder / "heart")
    if not (folder / "target.nc").exists():
        write_target(target, folder / "target.nc")
    if progress is not None:
        compile_kernels(progress)
    model = ForwardModel(heart, progress=progress)
    problem = Problem(model, target, NETWORK_SPACE, free_gain, workers)
    posterior = study.run(problem, progress if progress is not None else _silent)
    fitted = FittedStudy(folder, study, problem, _accepted(posterior))
    write_results(fitted, posterior, progress)
    return fitted


def load_study(folder: Path | str, progress: Progress | None = None) -> FittedStudy:
    """Read a finished study.

    Parameters
    ----------
    folder : path
        The study.
    progress : Progress, optional
        Told how far the preparation of a large heart is.

    Raises
    ------
    InputError
        If the folder is not a study, or the study is not finished.
    """
    folder = Path(folder)
    study = Study.open(folder)
    accepted = read_posterior(folder / POSTERIOR)
    heart = load_heart(folder / "heart")
    target = read_target(folder / "target.nc")
    for name, found, wanted in (
        ("heart", heart.digest, study.config.heart),
        ("target.nc", target_digest(target), study.config.target),
    ):
        if found != wanted:
            raise InputError(
                f"{folder / name}: not the one that was fitted; put the original back, or fit anew"
            )
    space = study.config.parameter_space()
    if set(accepted.best) != set(space.names):
        raise InputError(
            f"{folder / POSTERIOR}: its parameters are not those of the study; run 'fascicle fit' "
            "again to rewrite it"
        )
    model = ForwardModel(heart, progress=progress)
    problem = Problem(model, target, space, study.config.gain, study.config.batch)
    return FittedStudy(folder, study, problem, accepted)


def _config(**settings: Any) -> StudyConfig:
    """A study's configuration, with impossible settings refused in one line."""
    try:
        return StudyConfig(**settings)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        raise InputError(f"'{name}' is {first['input']!r}: {first['msg'].lower()}") from None


def _silent(stage: str, done: int, total: int, message: str) -> None:
    """Progress that nobody watches."""


def target_digest(target: Target) -> str:
    """SHA-256 of what the fit sees of a target."""
    digest = hashlib.sha256()
    numbers = [target.qrs_onset, target.qrs_offset]
    if target.noise is not None:
        numbers.append(target.noise)
    for array in (target.beats, target.time, np.array(numbers)):
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def _accepted(posterior: Posterior) -> Accepted:
    return Accepted(
        dict(posterior.values),
        posterior.losses,
        posterior.distances,
        dict(posterior.best_values),
        posterior.best_loss,
    )


def write_results(
    fitted: FittedStudy, posterior: Posterior, progress: Progress | None = None
) -> None:
    """Write posterior, trees, activation map and summary into the study's folder."""
    problem, accepted, folder = fitted.problem, fitted.accepted, fitted.folder
    networks = fitted.networks(progress)
    best = simulate_best(problem, accepted)
    predicted = np.stack([network.predicted for network in networks])
    _write_networks(folder / "networks", best, networks)
    activations = np.stack([network.simulation.activation for network in networks])
    write_grid(
        folder / "activation.vtu",
        problem.model.heart.vertices,
        problem.model.heart.tetrahedra,
        TETRAHEDRON,
        point_data={
            "activation": best.simulation.activation,
            "activation_mean": activations.mean(axis=0),
            "activation_sd": activations.std(axis=0),
        },
    )
    write_text(folder / "summary.json", json.dumps(_summary(fitted, posterior), indent=2) + "\n")
    # last, since its presence says that the study is finished
    write_posterior(
        folder / POSTERIOR, accepted, problem.space, problem.target, predicted[: len(accepted)]
    )


def _write_networks(folder: Path, best: Network, networks: list[Network]) -> None:
    """One folder a network, with its two trees; results of an earlier run are replaced."""
    (folder.parent / POSTERIOR).unlink(missing_ok=True)  # not finished while this is under way
    shutil.rmtree(folder, ignore_errors=True)
    with atomic_folder(folder) as temporary:
        for name, network in [
            ("best", best),
            *((f"{k:02d}", network) for k, network in enumerate(networks)),
        ]:
            simulation = network.simulation
            for tree, times in zip(simulation.trees, simulation.coupled.trees, strict=True):
                write_tree(temporary / name / f"{tree.side}_tree.vtu", tree, times)
            lines = [f"{key} = {value!r}" for key, value in network.parameters.items()]
            write_text(temporary / name / "parameters.toml", "\n".join(lines) + "\n")


def _summary(fitted: FittedStudy, posterior: Posterior) -> dict[str, object]:
    records = fitted.study.records()
    return {
        "heart": fitted.problem.model.heart.name,
        "recording": fitted.problem.target.provenance.get("source", ""),
        "evaluations": len(records),
        "infeasible_evaluations": sum(not r.evaluation.feasible for r in records),
        "best_initial_loss_mV2": fitted.best_initial_loss,
        "best_loss_mV2": posterior.best_loss,
        "best_parameters": dict(posterior.best_values),
        "networks_accepted": len(posterior.losses),
        "networks_wanted": posterior.wanted,
        "candidates_evaluated": posterior.evaluated,
        "posterior_rounds": posterior.rounds,
        "posterior_walk_steps": posterior.sweeps,
        "parameters": {
            name: {
                "minimum": float(v.min()),
                "median": float(np.median(v)),
                "maximum": float(v.max()),
            }
            for name, v in posterior.values.items()
            if len(v)
        },
    }
