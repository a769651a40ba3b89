"""From parameters to the ECG: the stages, chained."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import NETWORK_SPACE, check_names
from fascicle.core.progress import Progress
from fascicle.forward.cable.stored import default_template
from fascicle.forward.ecg.action_potential import ActionPotential
from fascicle.forward.ecg.electrocardiogram import STEP, first_sample
from fascicle.forward.eikonal.activation import Activation, Coupling, attach, solve
from fascicle.forward.eikonal.myocardium import Tissue
from fascicle.forward.preparation import Prepared, load_with_heart, prepare, save
from fascicle.forward.scenario import FURTHEST_STIMULUS, Scenario
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules, grow_from_parameters
from fascicle.purkinje.tree import InvalidTree, PurkinjeTree
from fascicle.recording.window import qrs_window

REMEMBERED = 8  # grown networks that are kept, in case only speeds and times change next
LONGEST = 100_000.0  # ms that an activation may take; more is a mistake, and much memory
PHYSIOLOGY = ("root_time", "cv")  # parameters that change no tree

T = TypeVar("T")


@dataclass(frozen=True)
class Simulation:
    """What one run of the forward model gives.

    Attributes
    ----------
    leads : (12, n_time) array
        The twelve leads of `fascicle.core.leads.LEADS` (mV), every 1 ms.
    onset : float
        Time of their first sample (ms).
    activation : (n,) array
        Activation time of each vertex of the heart (ms); inf where no front arrives.
    trees : tuple of PurkinjeTree
        The trees, left first.
    coupled : Activation
        Times in the trees, how each junction fired, and from where each vertex was.
    """

    leads: NDArray[np.float64]
    onset: float
    activation: NDArray[np.float64]
    trees: tuple[PurkinjeTree, ...]
    coupled: Activation

    @cached_property
    def ecg(self) -> xr.DataArray:
        """The twelve leads (mV) with their names: dimensions ``lead`` and ``time`` (ms)."""
        ecg = xr.DataArray(
            self.leads,
            coords={
                "lead": list(LEADS),
                "time": self.onset + np.arange(self.leads.shape[1]) * STEP,
            },
            dims=("lead", "time"),
            name="ecg",
            attrs={"units": "mV"},
        )
        ecg["time"].attrs["units"] = "ms"
        return ecg

    @property
    def total_activation_time(self) -> float:
        """From the first to the last activation in the myocardium that is reached (ms)."""
        reached = self.activation[np.isfinite(self.activation)]
        return float(reached.max() - reached.min())

    @property
    def unreached(self) -> NDArray[np.bool_]:
        """Vertices that no front reaches: scar, or isolated tissue; shape (n,).

        They are infinitely late in `activation` and contribute nothing to the ECG.
        """
        return np.asarray(np.isinf(self.activation))

    @property
    def qrs_duration(self) -> float:
        """QRS duration (ms), found in the ECG by the rule that finds it in recordings."""
        onset, offset = qrs_window(self.leads, STEP)
        return (offset - onset) * STEP


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
        The template U; `fascicle.forward.cable.stored.default_template` if not given.
    prepared : Prepared, optional
        What `fascicle.forward.preparation.prepare` makes of heart and conduction, if it is at hand.
    progress : Progress, optional
        Told how far the preparation of a large heart is; see `fascicle.core.progress.Progress`.

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
        self.charts, self.seeds = prepared.charts, prepared.seeds
        self.tissue = prepared.tissue
        self.electrocardiograph = prepared.electrocardiograph
        self._grown: dict[Hashable, tuple[PurkinjeTree, ...] | InvalidTree] = {}
        self._attached: dict[Hashable, Coupling] = {}

    def grow(self, parameters: Mapping[str, float]) -> tuple[PurkinjeTree, ...] | InvalidTree:
        """Grow both trees, left first, or say which one does not fit.

        Networks that were grown lately are remembered: where only root time and speed change, no
        tree is grown again.
        """
        anatomy = {name: value for name, value in parameters.items() if name not in PHYSIOLOGY}
        return _remembered(self._grown, tuple(sorted(anatomy.items())), lambda: self._grow(anatomy))

    def _grow(self, anatomy: Mapping[str, float]) -> tuple[PurkinjeTree, ...] | InvalidTree:
        trees = []
        for side, chart in self.charts.items():
            tree = grow_from_parameters(side, chart, self.seeds[side], anatomy, self.rules)
            if isinstance(tree, InvalidTree):
                return tree
            trees.append(tree)
        return tuple(trees)

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
            tissue is remembered.
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
        if len(scenario.points):  # ways to every vertex are too much to keep for several networks
            _check_stimuli(scenario, self.tissue)
            coupling = attach(self.tissue, trees, scenario.points)
        else:
            coupling = _remembered(self._attached, trees, lambda: attach(self.tissue, trees))
        coupled = solve(
            self.tissue,
            coupling,
            scenario.root_times(trees, roots),
            cv,
            stimuli=scenario.times,
            node_times=scenario.node_times(trees),
            speed=scenario.speeds(trees) if scenario.slowings else 1.0,
            orthodromic_delay=scenario.orthodromic_delay,
            antidromic_delay=scenario.antidromic_delay,
        )
        if not np.isfinite(coupled.myocardium).any():
            raise InputError(
                "nothing activates the myocardium; let a root fire, unblock a bundle, or add a "
                "stimulus"
            )
        reached = coupled.myocardium[np.isfinite(coupled.myocardium)]
        if np.ptp(reached) > LONGEST:
            raise InputError(
                f"activation takes {np.ptp(reached):.3g} ms from first to last, more than "
                f"{LONGEST:g}; check speeds, delays and times of stimuli"
            )
        times = coupled.myocardium
        return Simulation(
            self.electrocardiograph.leads(times), first_sample(times), times, trees, coupled
        )

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
            shared = _Shared(str(path), self.conduction, self.rules, self.action_potential)
            futures = [
                executor.submit(_simulate_shared, shared, dict(p), scenario) for p in parameters
            ]
            return [future.result() for future in futures]


def _remembered(store: dict[Hashable, T], key: Hashable, make: Callable[[], T]) -> T:
    """What was made lately under this key, or else what is made now."""
    found = store.get(key)
    if found is None:
        found = make()
        for oldest in list(store)[: 1 - REMEMBERED]:
            store.pop(oldest, None)  # another thread may have been faster
        store[key] = found
    return found


@dataclass(frozen=True)
class _Shared:
    """How a worker in another process comes by a model: a file, and its few settings."""

    path: str
    conduction: Conduction
    rules: GrowthRules
    action_potential: ActionPotential


# The model that this process, as a worker, has read, by the file it came from
_READ: dict[str, ForwardModel] = {}


def _simulate_shared(
    shared: _Shared, parameters: dict[str, float], scenario: Scenario | None
) -> Simulation | InvalidTree:
    model = _READ.get(shared.path)
    if model is None:
        heart, prepared = load_with_heart(Path(shared.path), shared.action_potential)
        model = ForwardModel(
            heart, shared.conduction, shared.rules, shared.action_potential, prepared
        )
        _READ.clear()  # another thread of this worker may have read another model
        _READ[shared.path] = model
    return model.simulate(parameters, scenario)


def _roots(root_time: float) -> tuple[float, float]:
    """When the left and the right root fire (ms), the earlier one at 0."""
    return max(0.0, -root_time), max(0.0, root_time)


def _check_stimuli(scenario: Scenario, tissue: Tissue) -> None:
    """Refuse stimuli that are not in the myocardium."""
    far = tissue.on_surface(scenario.points).distances
    if far.max() > FURTHEST_STIMULUS:  # or deep in it
        far = tissue.inside(scenario.points).distances
    for position, distance in zip(scenario.points, far, strict=True):
        if distance > FURTHEST_STIMULUS:
            where = ", ".join(f"{x:g}" for x in position)
            raise InputError(
                f"stimulus at ({where}): {distance:.1f} mm from the tissue; give a position in "
                "it, in mm and in the heart's frame"
            )
