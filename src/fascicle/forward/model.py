"""From parameters to the ECG: the stages, chained."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

from fascicle.core.errors import InputError
from fascicle.core.parameters import NETWORK_SPACE, check_names
from fascicle.core.progress import Progress
from fascicle.forward.cable.template import default_template
from fascicle.forward.ecg.electrocardiogram import ActionPotential, first_sample
from fascicle.forward.eikonal.activation import attach, solve
from fascicle.forward.preparation import Prepared, load, prepare, save
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Simulation, check_activation
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules, grow_from_parameters
from fascicle.purkinje.tree import InvalidTree, PurkinjeTree

REMEMBERED = 8  # grown networks that are kept, in case only speeds and times change next
PHYSIOLOGY = ("root_time", "cv")  # parameters that change no tree

_Settings = tuple[Conduction, GrowthRules, ActionPotential]


class ForwardModel:
    """The forward model of one heart; construction does all that depends on the heart alone.

    Parameters
    ----------
    heart : Heart
        The heart.
    conduction : Conduction, optional
        Conductivities and speeds of the myocardium, and regions where they differ.
    rules : GrowthRules, optional
        What is held fixed while trees grow.
    action_potential : ActionPotential, optional
        The template U; `fascicle.forward.cable.template.default_template` if not given.
    prepared : Prepared, optional
        What `fascicle.forward.preparation.prepare` makes of heart and conduction, if it is at hand.
    progress : Progress, optional
        Progress callback for the preparation of a large heart.

    Notes
    -----
    What depends on heart and conduction alone is kept on disk beside the heart and read back when
    both are the same again (`fascicle.forward.preparation`).

    Examples
    --------
    >>> import fascicle
    >>> model = fascicle.ForwardModel(fascicle.load_heart("default"))
    >>> simulation = model.simulate(fascicle.EXAMPLE_PARAMETERS)
    >>> simulation.ecg.sel(lead="V1").max().item()  # doctest: +SKIP
    """

    def __init__(
        self,
        heart: Heart,
        conduction: Conduction | None = None,
        rules: GrowthRules | None = None,
        action_potential: ActionPotential | None = None,
        prepared: Prepared | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.heart = heart
        self.conduction = conduction if conduction is not None else Conduction()
        self.rules = rules if rules is not None else GrowthRules()
        self.action_potential = (
            action_potential if action_potential is not None else default_template()
        )
        if prepared is None:
            prepared = prepare(heart, self.conduction, self.action_potential, progress)
        self.prepared = prepared
        self.myocardium = prepared.myocardium
        self.electrocardiograph = prepared.electrocardiograph
        self._grow = lru_cache(REMEMBERED)(partial(_grow_trees, prepared, self.rules))
        self._attach = lru_cache(REMEMBERED)(partial(attach, self.myocardium))

    def grow(self, parameters: Mapping[str, float]) -> tuple[PurkinjeTree, ...] | InvalidTree:
        """Grow both trees, left first, or say which one does not fit.

        Networks that were grown lately are remembered: where only root time and speed change, no
        tree is grown again.
        """
        anatomy = sorted((n, value) for n, value in parameters.items() if n not in PHYSIOLOGY)
        return self._grow(tuple(anatomy))

    def simulate(
        self, parameters: Mapping[str, float], scenario: Scenario | None = None
    ) -> Simulation | InvalidTree:
        """Grow the trees, activate the heart, compute the ECG.

        Parameters
        ----------
        parameters : mapping of name to float
            The twelve parameters of `fascicle.core.parameters.NETWORK_SPACE`, in its units.
        scenario : Scenario, optional
            Extra stimuli, blocked or slow segments, junction delays, trees of your own.

        Returns
        -------
        Simulation or InvalidTree
            `InvalidTree` where a bundle or fascicle would leave its endocardium.

        Raises
        ------
        InputError
            If a parameter is unknown, missing or not finite, or a length or speed not positive;
            if the scenario does not fit the heart, or nothing in it fires.
        """
        check_names(parameters, NETWORK_SPACE.names)
        for name, value in parameters.items():
            if (name == "cv" or "_length" in name) and value <= 0:
                raise InputError(f"parameter '{name}' is {value}; it must be positive")
        trees = self.grow(parameters)
        if isinstance(trees, InvalidTree):
            return trees
        return self.activate(trees, parameters["root_time"], parameters["cv"], scenario)

    def activate(
        self,
        trees: Sequence[PurkinjeTree],
        root_time: float | Sequence[float],
        cv: float,
        scenario: Scenario | None = None,
    ) -> Simulation:
        """Activate the heart through given trees and compute the ECG.

        Parameters
        ----------
        trees : sequence of PurkinjeTree
            Left and right, or any number; not to be changed in place, since where they meet the
            myocardium is remembered.
        root_time : float or sequence of float
            t_RV − t_LV (ms), the earlier root firing at time 0; or when each root fires (ms).
        cv : float
            Speed in the trees (mm/ms).
        scenario : Scenario, optional
            Extra stimuli, blocked or slow segments, junction delays, trees of your own.
        """
        roots = _roots(root_time) if isinstance(root_time, (float, int)) else root_time
        scenario = scenario if scenario is not None else Scenario()
        trees = (*trees, *(tree for tree, _ in scenario.trees))
        if len(scenario.points):  # rays to every vertex are too many to keep for several networks
            coupling = attach(self.myocardium, trees, scenario.points)
            scenario.check_stimuli(coupling.stimuli.distances)
        else:
            coupling = self._attach(trees)
        coupled = solve(
            coupling,
            scenario.root_times(trees, roots),
            cv,
            stimuli=scenario.times,
            node_times=scenario.node_times(trees),
            speed=scenario.speeds(trees) if scenario.slowings else 1.0,
            orthodromic_delay=scenario.orthodromic_delay,
            antidromic_delay=scenario.antidromic_delay,
        )
        times = coupled.myocardium
        check_activation(times)
        leads = self.electrocardiograph.leads(times)
        return Simulation(leads, first_sample(times), times, trees, coupled)

    def simulate_many(
        self,
        parameters: Iterable[Mapping[str, float]],
        executor: Executor,
        scenario: Scenario | None = None,
    ) -> list[Simulation | InvalidTree]:
        """Simulate many networks at a time.

        Parameters
        ----------
        parameters : iterable of mappings
            Parameters of each network.
        executor : concurrent.futures.Executor
            Where to run: threads (the kernels run outside Python's global lock), processes, or
            a cluster, such as Dask's ``client.get_executor()``. A worker of another process gets
            the heart once, through a file in the temporary folder, which all must see.
        scenario : Scenario, optional
            The same for all.

        Returns
        -------
        list of Simulation or InvalidTree
            In the order of the parameters.
        """
        if isinstance(executor, ThreadPoolExecutor):
            return list(executor.map(lambda p: self.simulate(p, scenario), parameters))
        with TemporaryDirectory(prefix="fascicle-") as folder:
            path = Path(folder) / "model.npz"
            save(path, self.prepared, self.heart)
            settings = self.conduction, self.rules, self.action_potential
            futures = [
                executor.submit(_simulate_elsewhere, path, settings, dict(p), scenario)
                for p in parameters
            ]
            return [future.result() for future in futures]


# The model that this process, as a worker of another one, has read, by the file it came from
_READ: dict[Path, ForwardModel] = {}


def _simulate_elsewhere(
    path: Path, settings: _Settings, parameters: dict[str, float], scenario: Scenario | None
) -> Simulation | InvalidTree:
    model = _READ.get(path)
    if model is None:
        heart, prepared = load(path, settings[-1])
        model = ForwardModel(heart, *settings, prepared)
        _READ.clear()  # another thread of this worker may have read another model
        _READ[path] = model
    return model.simulate(parameters, scenario)


def _grow_trees(
    prepared: Prepared, rules: GrowthRules, anatomy: Sequence[tuple[str, float]]
) -> tuple[PurkinjeTree, ...] | InvalidTree:
    """Grow both trees, left first, from names and values of their parameters."""
    trees = []
    for side, chart in prepared.charts.items():
        tree = grow_from_parameters(side, chart, prepared.seeds[side], dict(anatomy), rules)
        if isinstance(tree, InvalidTree):
            return tree
        trees.append(tree)
    return tuple(trees)


def _roots(root_time: float) -> tuple[float, float]:
    """When the left and the right root fire (ms), the earlier one at 0."""
    return max(0.0, -root_time), max(0.0, root_time)
