"""Writing of a fitted study's result files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fascicle.core import VERSION
from fascicle.core.arrays import Floats
from fascicle.core.files import atomic_folder, write_text
from fascicle.emulation.predictive import Prediction
from fascicle.forward.activation_sequence import activation_maps, since_first
from fascicle.forward.simulation_files import write_activation, write_maps
from fascicle.networks.agreement import Agreement
from fascicle.networks.target_comparison import Network
from fascicle.purkinje.tree_files import write_tree
from fascicle.study.evaluations import Stage
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import RESULT, Posterior, write_population
from fascicle.study.statements import has_few_junctions


def write_results(
    fitted: FittedStudy,
    networks: Sequence[Network],
    agreements: Sequence[Agreement],
    predictions: Sequence[Prediction] = (),
    emulators: Sequence[Mapping[str, float]] = (),
) -> None:
    """Write networks, trees, activation map and summary into the study's folder.

    `networks` are the simulated population. `agreements` and, for a posterior, `predictions` and
    the reports of the `emulators` hold one entry for each recording.
    """
    population, folder, config = fitted.population, fitted.folder, fitted.study.config
    heart, space = fitted.simulator.model.heart, fitted.simulator.prior.learnt
    result = folder / RESULT[config.method]
    result.unlink(missing_ok=True)  # so that the study does not count as finished meanwhile
    # trees of 30 networks are written, and the parameters of all
    shown = range(0, len(networks), max(1, len(networks) // 30))[:30]
    _write_networks(
        folder / "networks",
        {"best": fitted.best_network} | {f"{k:02d}": networks[k] for k in shown},
    )
    maps = activation_maps([network.beat.activation for network in networks])
    best = since_first(fitted.best_network.beat.activation)
    if heart.atlas is None:
        maps = {"activation": best, **maps}
    else:
        write_activation(folder / "networks/best/activation.vtu", fitted.best_model.heart, best)
    write_maps(folder / "activation.vtu", heart, maps)
    summary = _summary(fitted, networks, agreements) | {"emulators": list(emulators)}
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    predicted = np.stack([network.predicted for network in networks])[: len(population)]
    # last, since its presence says that the study is finished
    write_population(
        result,
        population,
        space,
        [recording.target for recording in fitted.recordings],
        predictions or predicted,
        {
            "networks_are": fitted.statements.networks_called,
            "verdict": fitted.verdict,
            "created_by": f"fascicle {VERSION}",
            "heart": config.heart,
            "target": config.target,
            "recording": _sources(fitted),
            "configuration": config.model_dump_json(),
        },
    )


def _sources(fitted: FittedStudy) -> str:
    """Sources of the recordings."""
    return ", ".join(p.target.provenance.get("source", "") for p in fitted.recordings)


def spread(values: Floats) -> dict[str, float]:
    """Minimum, median and maximum of `values` (n,), for a summary."""
    statistics = {"minimum": values.min(), "median": np.median(values), "maximum": values.max()}
    return {name: float(value) for name, value in statistics.items()}


def _write_networks(folder: Path, networks: Mapping[str, Network]) -> None:
    """Write a folder with the trees of each network, in place of those of an earlier run."""
    shutil.rmtree(folder, ignore_errors=True)
    with atomic_folder(folder) as temporary:
        for name, network in networks.items():
            simulation = network.beat
            for tree, times in zip(simulation.trees, simulation.coupled.trees, strict=True):
                write_tree(temporary / name / f"{tree.side}_tree.vtu", tree, times)
            lines = [f"{key} = {value!r}" for key, value in network.parameters.items()]
            write_text(temporary / name / "parameters.toml", "\n".join(lines) + "\n")


def _summary(
    fitted: FittedStudy, networks: Sequence[Network], agreements: Sequence[Agreement]
) -> dict[str, object]:
    records, population, checks = fitted.study.records(), fitted.population, fitted.checks
    content: dict[str, object] = {
        "verdict": fitted.verdict,
        "converged": fitted.statements.converged,
        "networks_are": fitted.statements.networks_called,
        "heart": fitted.simulator.model.heart.name,
        "recording": _sources(fitted),
        "evaluations": len(records),
        "infeasible_evaluations": sum(not r.evaluation.feasible for r in records),
        "best_loss_mV2": population.best_loss,
        "null_loss_mV2": fitted.null_loss,
        "statements": fitted.statements.content(),
        "fixed_parameters": dict(fitted.simulator.prior.fixed),
        "best_parameters": dict(population.best),
        "networks_accepted": len(population),
        **agreements[0].content(),
        "other_recordings": [other.content() for other in agreements[1:]],
        "energy_under_the_qrs": spread(np.array([n.under_qrs for n in networks])),
        "networks_with_few_junctions": sum(has_few_junctions(n) for n in networks),
        "parameters": {name: spread(v) for name, v in population.values.items() if len(v)},
    }
    if not isinstance(population, Posterior):
        return content | {
            "networks_wanted": fitted.study.config.samples,
            "candidates_evaluated": len(fitted.candidates),
            "rounds": fitted.study.steps(Stage.REJECTION),
            "best_initial_loss_mV2": fitted.best_initial_loss,
        }
    return content | {
        "conduction_states": dict(population.states),
        # with several conduction states, each state has log-evidences of its own
        "log_evidences": None if population.states else population.log_evidences.tolist(),
        "effective_sample_sizes": population.effective.tolist(),
        "standard_deviations_between_runs": dict(population.means_apart),
        "explained_by_the_best": checks.explained if checks else None,
        "probabilities_under_the_model": dict(checks.probabilities) if checks else {},
    }
