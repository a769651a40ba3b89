"""Simulations in other processes: how their workers come by the model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from fascicle.forward.ecg.action_potential import ActionPotential
from fascicle.forward.preparation import Prepared, load_with_heart, save
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Simulation
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules
from fascicle.purkinje.tree import InvalidTree


class Model(Protocol):
    """What workers need of a `fascicle.forward.model.ForwardModel`."""

    heart: Heart
    conduction: Conduction
    rules: GrowthRules
    action_potential: ActionPotential
    prepared: Prepared

    def simulate(
        self, parameters: Mapping[str, float], scenario: Scenario | None = None
    ) -> Simulation | InvalidTree:
        """Grow the trees, activate the heart, compute the ECG."""


MakeModel = Callable[[Heart, Conduction, GrowthRules, ActionPotential, Prepared], Model]


@dataclass(frozen=True)
class _SharedModel:
    """How a worker in another process comes by a model: a file, and its few settings."""

    path: str
    make: MakeModel
    conduction: Conduction
    rules: GrowthRules
    action_potential: ActionPotential


# The model that this process, as a worker, has read, by the file it came from
_READ: dict[str, Model] = {}


def simulate_elsewhere(
    model: Model,
    make: MakeModel,
    parameters: Iterable[Mapping[str, float]],
    executor: Executor,
    scenario: Scenario | None,
) -> list[Simulation | InvalidTree]:
    """Simulate many networks in other processes.

    Parameters
    ----------
    model : Model
        The model.
    make : callable
        Makes one like it of heart, conduction, rules, action potential and what was prepared.
    parameters : iterable of mappings
        Parameters of each network.
    executor : concurrent.futures.Executor
        Where to run; a worker gets the heart once, through a file in the temporary folder.
    scenario : Scenario or None
        The same for all.

    Returns
    -------
    list of Simulation or InvalidTree
        In the order of the parameters.
    """
    with TemporaryDirectory(prefix="fascicle-") as folder:
        path = Path(folder) / "model.npz"
        save(path, model.prepared, model.heart)
        shared = _SharedModel(
            str(path), make, model.conduction, model.rules, model.action_potential
        )
        futures = [executor.submit(_simulate, shared, dict(p), scenario) for p in parameters]
        return [future.result() for future in futures]


def _simulate(
    shared: _SharedModel, parameters: dict[str, float], scenario: Scenario | None
) -> Simulation | InvalidTree:
    model = _READ.get(shared.path)
    if model is None:
        heart, prepared = load_with_heart(Path(shared.path), shared.action_potential)
        model = shared.make(
            heart, shared.conduction, shared.rules, shared.action_potential, prepared
        )
        _READ.clear()  # another thread of this worker may have read another model
        _READ[shared.path] = model
    return model.simulate(parameters, scenario)
