"""The forward model: from the parameters of a Purkinje network to the ECG.

The parameters are quantities of `fascicle.core.quantities`. Only what depends on a changed
parameter is computed again: trees, conduction velocities of the tissue, or times alone.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from types import NoneType
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from fascicle.core.arrays import Floats, Singles
from fascicle.core.errors import InputError
from fascicle.core.parameters import Infeasible, complete
from fascicle.core.progress import Progress, check_progress
from fascicle.core.quantities import Changes, checked, quantity, torso_values
from fascicle.core.ranges import check_items, check_kind
from fascicle.core.threads import (
    SharedFile,
    made_once,
    read_shared,
    without_its_object,
    write_shared,
)
from fascicle.forward.activation_sequence import VentricularSurfaces
from fascicle.forward.beat import Beat, Signals, check_activation
from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import Coupling, Myocardium, attach
from fascicle.forward.electrocardiogram import (
    ActionPotential,
    Electrocardiograph,
    axial_projection,
    first_sample,
)
from fascicle.forward.preparation import (
    Prepared,
    as_arrays,
    build,
    cached,
    from_arrays,
    prepare,
    with_numbers,
)
from fascicle.forward.primitives import FURTHEST_STIMULUS, in_state
from fascicle.forward.scenario import Scenario
from fascicle.forward.template import default_template
from fascicle.forward.torso_model import TorsoModel, prepare_response, torso_model
from fascicle.heart.atlas import atlas_heart
from fascicle.heart.conduction import Conduction
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart, LeadFields
from fascicle.heart.sites import Sites
from fascicle.kernels.arrays import TravelTimeTable
from fascicle.mesh.measures import barycentric_gradients
from fascicle.purkinje.growth import GrowthRules, grow_from_parameters, with_angles
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.torso.lead_fields import key_of
from fascicle.torso.response import TorsoResponse

SCENARIO = "a fascicle.Scenario; fascicle.read_scenarios reads them"  # what to give


@runtime_checkable
class Backend(Protocol):
    """Simulator of the intrinsic beats of many networks, in place of the processor."""

    batch: int  # networks at a time

    def refusal(self, model: ForwardModel, names: Iterable[str]) -> str:
        """Reason not to simulate a model with other values of these quantities; empty if none."""

    def signals(
        self, model: ForwardModel, parameters: Sequence[Mapping[str, float]]
    ) -> Iterator[Signals | Infeasible | None]:
        """Signals to compare with a recording; None for networks left to the processor."""

    def beats(
        self, model: ForwardModel, parameters: Sequence[Mapping[str, float]]
    ) -> Iterator[Beat | Infeasible | None]:
        """Beats of networks; None for networks left to the processor."""


def usable(
    backend: Backend | None, model: ForwardModel, names: Iterable[str], scenario: Scenario | None
) -> Backend | None:
    """Return the backend if it can simulate this; else None, after a warning with the reason."""
    check_kind(backend, (Backend, NoneType), "backend", "one such as fascicle.GpuBackend()")
    if backend is None:
        return None
    reason = backend.refusal(model, names) if scenario is None else "a scenario is given"
    if reason:
        warnings.warn(f"{reason}: simulated on the processor instead", stacklevel=3)
    return None if reason else backend


def without_heart(parameters: Mapping[str, float]) -> dict[str, float]:
    """Parameters of a network in one heart, without the heart's number in an atlas."""
    return {name: value for name, value in parameters.items() if name != "atlas_heart"}


class ForwardModel:
    """Forward model of one heart; construction prepares all that depends on the heart alone.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    conduction : Conduction, optional
        Conductivities and speeds of the myocardium, and regions where they differ.
    rules : GrowthRules, optional
        Rules of tree growth, which are held fixed.
    action_potential : ActionPotential, optional
        The template U; if not given the heart's, or that of
        `fascicle.forward.template.default_template`.
    prepared : Prepared, optional
        Result of `fascicle.forward.preparation.prepare` for heart and conduction, if at hand.
    progress : Progress, optional
        Progress callback for the preparation of a large heart.

    Notes
    -----
    Arrays that depend on heart and conduction alone are cached in the heart's folder and read back
    as long as both stay the same (`fascicle.forward.preparation`).

    Examples
    --------
    >>> import fascicle
    >>> model = fascicle.ForwardModel(fascicle.load_heart("default"))
    >>> simulation = model.simulate(fascicle.EXAMPLE_PARAMETERS)
    >>> simulation.ecg.sel(lead="V1").max().item()  # doctest: +SKIP
    """

    # grown networks that are kept, in case only speeds and times change next
    networks_kept: ClassVar[int] = 8
    # tissues that are kept; each takes the memory of a heart, or half of it on disk
    tissues_kept: ClassVar[int] = 6
    # hearts of an atlas that are kept, and rays a vertex in their tables (of 30, not 150, ECGs
    # differ by 3 %)
    hearts_kept: ClassVar[int] = 40
    atlas_rays: ClassVar[int] = 30

    def __init__(
        self,
        heart: Heart | Path | str,
        conduction: Conduction | None = None,
        rules: GrowthRules | None = None,
        action_potential: ActionPotential | None = None,
        prepared: Prepared | None = None,
        progress: Progress | None = None,
    ) -> None:
        check_kind(conduction, (Conduction, NoneType), "conduction", "a fascicle.Conduction")
        check_kind(rules, (GrowthRules, NoneType), "rules", "fascicle.GrowthRules")
        template = "a function of time with a 'span'"
        check_kind(action_potential, (ActionPotential, NoneType), "action_potential", template)
        check_kind(prepared, (Prepared, NoneType), "prepared", "what 'prepare' made of the heart")
        check_progress(progress)
        heart = as_heart(heart)
        self.heart = heart
        self.conduction = conduction if conduction is not None else Conduction.of(heart)
        self.rules = rules if rules is not None else GrowthRules()
        potential = action_potential if action_potential is not None else heart.action_potential
        self.action_potential = potential if potential is not None else default_template()
        if prepared is None:
            prepared = prepare(heart, self.conduction, self.action_potential, progress)
        self.prepared = prepared
        self.myocardium = prepared.myocardium
        self._grow = lru_cache(self.networks_kept)(partial(_grow_trees, prepared))
        self._kept: set[Conduction] = set()
        self._tissue = made_once(without_its_object(self._made_tissue), self.tissues_kept)
        self._atlas_model = made_once(without_its_object(self._made_atlas_model), self.hearts_kept)
        self.sites = Sites(heart)
        self._progress = progress
        self._torso: TorsoModel | None = None
        self._torso_lock = Lock()
        self.electrocardiograph = self._tissue(self.conduction).electrocardiograph

    def __repr__(self) -> str:
        return f"ForwardModel({self.heart.name}, {len(self.heart.vertices)} vertices)"

    def of_heart(self, parameters: Mapping[str, float]) -> ForwardModel:
        """Forward model of the heart of the atlas that parameters name; else this one.

        InputError if the atlas has no heart of this number, or this heart is not an atlas.
        """
        number = parameters.get("atlas_heart")
        if number is None:
            return self
        count = 0 if self.heart.atlas is None else len(self.heart.atlas)
        if number >= count:
            has = f"has hearts 0 to {count - 1}" if count else "is one heart, without an atlas"
            raise InputError(f"atlas_heart {number:g}: {self.heart.name} {has}; leave it out")
        model: ForwardModel = self._atlas_model(int(number))
        return model

    def _made_atlas_model(self, number: int) -> ForwardModel:
        """Forward model of a heart of the atlas, with its tissue."""
        atlas, heart = self.heart.atlas, atlas_heart(self.heart, number)
        assert atlas is not None
        tissue = self.conduction.with_values(atlas.tissues[number])
        fields = LeadFields(atlas.lead_fields(number), key_of(heart, tissue), "")
        heart = replace(heart, lead_fields=fields)
        prepared = build(heart, tissue, self.action_potential, rays=self.atlas_rays)
        model = ForwardModel(heart, tissue, self.rules, self.action_potential, prepared)
        model.surfaces = self.surfaces  # a vertex is the same place in each heart of an atlas
        return model

    @cached_property
    def surfaces(self) -> VentricularSurfaces:
        """Parts of the heart's surface, by which an activation sequence is described."""
        return VentricularSurfaces.of(self.heart)

    def keep_tissues(self, tissues: Iterable[Mapping[str, float]]) -> None:
        """Cache the preparation of these tissues, quantities by name, in the heart's folder."""
        conduction = self.conduction
        self._kept.update(
            replace(conduction.with_values(tissue), alpha=conduction.alpha) for tissue in tissues
        )

    def grow(self, parameters: Mapping[str, float]) -> tuple[PurkinjeTree, ...] | Infeasible:
        """Grow both trees, left first, or return the first that does not fit.

        The last networks are cached: where only times and speeds change, no tree is grown again.
        """
        check_kind(parameters, Mapping, "parameters", "a dict of names to numbers")
        if (model := self.of_heart(parameters)) is not self:
            return model.grow(without_heart(parameters))
        of_trees = {n: v for n, v in parameters.items() if quantity(n).changes is Changes.TREES}
        anatomy = checked(of_trees)
        rules = self.rules.with_values(anatomy)
        return self._grow(rules, tuple(sorted(self._with_angles(anatomy).items())))

    def _with_angles(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Parameters with angles of fascicles in place of their directions."""
        chart, seed = self.prepared.charts["lv"], self.prepared.seeds["lv"]
        return with_angles(chart, seed, parameters, self.sites.apical, self.sites.anterior)

    def with_root_time(self, parameters: Mapping[str, float]) -> dict[str, float] | Infeasible:
        """Parameters with angles and a root time, in place of directions and a delay."""
        if (model := self.of_heart(parameters)) is not self:
            values = model.with_root_time(without_heart(parameters))
            if isinstance(values, Infeasible):
                return values
            return values | {"atlas_heart": parameters["atlas_heart"]}
        values = self._with_angles(parameters)
        if "interventricular_delay" in values:
            trees = self.grow(values)
            if isinstance(trees, Infeasible):
                return trees
            values["root_time"] = _root_time(
                trees, values.pop("interventricular_delay"), values["cv"]
            )
        return values

    def torso(self, names: Sequence[str], progress: Progress | None = None) -> TorsoModel:
        """Lead fields as a function of the torso, built when first used: minutes, once per heart.

        An InputError, if the heart lies in an unbounded conductor, says the first of the `names` of
        quantities that need the torso. `progress` takes the place of the model's own callback.
        """
        with self._torso_lock:
            if self._torso is None:
                report = progress or self._progress
                response = prepare_response(self.heart, self.conduction, names, report)
                self.use_response(response)
            assert self._torso is not None
            return self._torso

    def use_response(self, response: TorsoResponse) -> None:
        """Use a response that was built for this heart and conduction."""
        self._torso = torso_model(self.heart, self.conduction, response)

    def simulate(
        self, parameters: Mapping[str, float], scenario: Scenario | None = None
    ) -> Beat | Infeasible:
        """Grow the trees, activate the heart, compute the ECG.

        Parameters
        ----------
        parameters : mapping of name to float
            Quantities of `fascicle.core.quantities.QUANTITIES`, in its units: bundles and
            fascicles, ``cv`` and ``root_time`` (or ``interventricular_delay``) at least. Others
            have the values of the heart, the conduction and the rules of this model.
        scenario : Scenario, optional
            Extra stimuli, blocked or slow segments, junction delays, trees of your own.

        Returns
        -------
        Beat or Infeasible
            `Infeasible` where a bundle or fascicle would leave its endocardium, or the heart would
            touch the skin.

        Raises
        ------
        InputError
            If a parameter is unknown, missing or impossible; if the scenario does not fit the
            heart, or nothing in it fires.
        """
        values = complete(parameters)
        check_kind(scenario, (Scenario, NoneType), "scenario", SCENARIO)
        if (model := self.of_heart(values)) is not self:
            return model.simulate(without_heart(values), scenario)
        torso = torso_values(values)
        if torso:
            coefficients = self.torso([*torso]).lead_coefficients(torso)
            if isinstance(coefficients, Infeasible):
                return coefficients
        trees = self.grow(values)
        if isinstance(trees, Infeasible):
            return trees
        return self.activate(trees, scenario=scenario, **values)

    def activate(
        self,
        trees: Sequence[PurkinjeTree],
        root_time: float | Sequence[float] | None = None,
        cv: float | None = None,
        scenario: Scenario | None = None,
        **values: float,
    ) -> Beat:
        """Activate the heart through given trees and compute the ECG.

        Parameters
        ----------
        trees : sequence of PurkinjeTree
            Left and right, or any number; not to be changed in place, since their attachment to the
            myocardium is cached.
        root_time : float or sequence of float
            t_RV − t_LV (ms), the earlier root firing at time 0; or when each root fires (ms). The
            quantity ``interventricular_delay`` may take its place: the delay between the first
            junctions of the first two trees.
        cv : float
            Purkinje conduction velocity (mm/ms).
        scenario : Scenario, optional
            Extra stimuli, blocked or slow segments, junction delays, trees of your own.
        **values
            Other quantities, as in `simulate`; those of tree growth have no effect here.

        Raises
        ------
        InputError
            If a quantity is unknown or impossible, the scenario does not fit, or the heart would
            touch the skin.
        """
        check_items(trees, PurkinjeTree, "trees", "fascicle.PurkinjeTree")
        check_kind(scenario, (Scenario, NoneType), "scenario", SCENARIO)
        if cv is None:
            raise InputError("missing parameter cv; add it")
        if (model := self.of_heart(values)) is not self:
            return model.activate(trees, root_time, cv, scenario, **without_heart(values))
        values = checked(values | {"cv": cv})
        if root_time is None:
            if "interventricular_delay" not in values:
                raise InputError("missing parameter root_time; add it")
            root_time = _root_time(trees, values["interventricular_delay"], cv)
        blocked = in_state(scenario or Scenario(), values.get("conduction", 0.0))
        excitation = blocked.excitation(trees, root_time, values, self.sites)
        conduction = self.conduction.with_values(values)
        tissue = self._tissue(replace(conduction, alpha=self.conduction.alpha))
        if excitation.stimuli:  # rays to every vertex are too many to keep for several networks
            coupling = attach(
                tissue.myocardium, excitation.trees, excitation.points, excitation.stimuli
            )
            _check_stimuli(excitation.points, coupling.stimuli.distances)
        else:
            coupling = tissue.attach(excitation.trees)
        coupled = solve(
            coupling,
            excitation.root_times,
            values["cv"],
            his=excitation.his,
            stimuli=excitation.point_times,
            node_times=excitation.node_times,
            speed=excitation.speed,
            tissue_speed=conduction.alpha / self.conduction.alpha,
            **excitation.delays,
        )
        times = coupled.myocardium
        check_activation(times)
        leads = self._leads(times, tissue, values)
        onset, groups, names = first_sample(times), excitation.capture_groups, self.heart.leads
        return Beat(leads, onset, excitation.trees, coupled, groups, lead_names=names)

    def _made_tissue(self, conduction: Conduction) -> Tissue:
        """Prepare the tissue of a conduction that has the α of the model's conduction."""
        made = partial(build_myocardium, self.heart, conduction, like=self.myocardium)
        if conduction == self.conduction:
            myocardium = self.myocardium
        elif conduction in self._kept:
            myocardium = cached(
                self.heart,
                conduction,
                "tissue",
                made,
                lambda myocardium: myocardium.travel_times._asdict(),  # nine tenths of the work
                lambda arrays: made(table=TravelTimeTable(**with_numbers(arrays))),
                most=self.tissues_kept,
            )
        else:
            myocardium = made()
        return Tissue(
            myocardium,
            self.prepared.electrocardiograph.scaled(conduction.scale(self.heart)),
            lru_cache(self.networks_kept)(partial(attach, myocardium)),
        )

    def _leads(self, times: Floats, tissue: Tissue, values: Mapping[str, float]) -> Floats:
        """All leads (mV), in the torso that the values describe."""
        torso = torso_values(values)
        if torso:
            ecg = self.electrocardiograph_in_torso(values)
        else:
            ecg = self.with_sources(tissue.electrocardiograph, values)
        if isinstance(ecg, Infeasible):
            raise InputError(f"{', '.join(torso)}: {ecg.reason}; give smaller changes")
        return np.asarray(values.get("gain", 1.0) * ecg.leads(times))

    def electrocardiograph_in_torso(
        self, values: Mapping[str, float]
    ) -> Electrocardiograph | Infeasible:
        """The ECG integral, given checked quantities of the torso."""
        torso = self.torso([*values])
        coefficients = torso.lead_coefficients(values)
        if isinstance(coefficients, Infeasible):
            return coefficients
        standard = self.prepared.electrocardiograph
        ecg: Electrocardiograph = torso.electrocardiograph(standard, coefficients)
        scale = self.conduction.with_values(values).scale(self.heart)
        return self.with_sources(ecg.scaled(scale), values)

    def with_sources(
        self, ecg: Electrocardiograph, values: Mapping[str, float]
    ) -> Electrocardiograph:
        """ECG integral with sources scaled by the quantities `rv_source` and `axial_source`."""
        right, axial = (values.get(name, 1.0) for name in ("rv_source", "axial_source"))
        if right == axial == 1.0:
            return ecg
        factors = np.where(self.surfaces.rv_wall, np.float32(right), np.float32(1.0))
        along, back = self._axial
        conducts = self.conduction.with_values(values).scale(self.heart) > 0
        if not conducts.all():
            factors, along, back = factors[conducts], along[conducts], back[conducts]
        return ecg.with_sources(factors, axial - 1.0, along, back)

    @cached_property
    def _axial(self) -> tuple[Singles, Singles]:
        """Projection of the ECG integral's weights on the fibres."""
        heart, conduction = self.heart, self.conduction
        gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
        excess = 1 - conduction.intracellular_t / conduction.intracellular_l
        along, back = axial_projection(gradients, heart.fibres, excess)
        return along.astype(np.float32), back.astype(np.float32)

    def simulate_many(
        self,
        parameters: Iterable[Mapping[str, float]],
        executor: Executor | None = None,
        scenario: Scenario | None = None,
        *,
        backend: Backend | None = None,
    ) -> Sequence[Beat | Infeasible]:
        """Simulate many networks.

        Parameters
        ----------
        parameters : iterable of mappings
            Parameters of each network.
        executor : concurrent.futures.Executor
            Where to run: threads (the kernels run outside Python's global lock), processes, or
            a cluster, such as Dask's ``client.get_executor()``. A worker of another process gets
            the heart once, through a file in the temporary folder, which all must see.
        scenario : Scenario, optional
            Scenario of all networks.
        backend : Backend, optional
            Such as `fascicle.GpuBackend`, in place of an executor. It simulates intrinsic beats
            without the times in the trees and the site that fired each vertex. A warning says so
            if it does not support the model, the quantities or a scenario; networks that it cannot
            simulate are simulated on the processor.

        Returns
        -------
        list of Beat or Infeasible
            In the order of the parameters.

        Raises
        ------
        InputError
            As `simulate` does.
        """
        check_kind(parameters, Iterable, "parameters", "a list of them, one a network")
        networks = [complete(p) for p in parameters]
        if backend is not None:
            names = {name for network in networks for name in network}
            if usable(backend, self, names, scenario) is None:
                return [self.simulate(network, scenario) for network in networks]
            beats = zip(networks, backend.beats(self, networks), strict=True)
            return [beat if beat is not None else self.simulate(p) for p, beat in beats]
        if executor is None:
            raise InputError("give an executor, or a backend such as fascicle.GpuBackend()")
        check_kind(executor, Executor, "executor", "one of concurrent.futures, or a subclass")
        torso = [name for network in networks for name in torso_values(network)]
        if torso:
            self.torso(torso)  # built here, not by every worker
        if isinstance(executor, ThreadPoolExecutor):
            return list(executor.map(lambda p: self.simulate(p, scenario), networks))
        with TemporaryDirectory(prefix="fascicle-") as folder:
            file = write_shared(Path(folder) / "model", self)
            futures = [executor.submit(_simulate_elsewhere, file, p, scenario) for p in networks]
            return [future.result() for future in futures]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the model with its preparation, for another process."""
        arrays = as_arrays(self.prepared, self.heart)
        response = None if self._torso is None else self._torso.response
        settings = self.conduction, self.rules, self.action_potential
        return _received, (arrays, response, *settings)


def _received(
    arrays: Mapping[str, Any],
    response: TorsoResponse | None,
    conduction: Conduction,
    rules: GrowthRules,
    action_potential: ActionPotential,
) -> ForwardModel:
    """Restore the model that `ForwardModel.__reduce__` pickled."""
    heart, prepared = from_arrays(arrays, action_potential)
    model = ForwardModel(heart, conduction, rules, action_potential, prepared)
    if response is not None:
        model.use_response(response)
    return model


def _simulate_elsewhere(
    file: SharedFile, parameters: dict[str, float], scenario: Scenario | None
) -> Beat | Infeasible:
    model: ForwardModel = read_shared(file)
    return model.simulate(parameters, scenario)


def _check_stimuli(points: Floats, distances: Floats) -> None:
    """Refuse stimuli that are not in the myocardium, by their distances from it (mm)."""
    for position, distance in zip(points, distances, strict=True):
        if distance > FURTHEST_STIMULUS:
            where = ", ".join(f"{x:g}" for x in position)
            raise InputError(
                f"stimulus at ({where}): {distance:.1f} mm from the tissue; give a position in "
                "it, in mm and in the heart's frame"
            )


def _root_time(trees: Sequence[PurkinjeTree], delay: float, cv: float) -> float:
    """t_RV − t_LV of the roots (ms) that gives a delay between the first junctions."""
    left, right = (tree.to_first_junction / cv for tree in trees[:2])
    return delay + left - right if np.isfinite(left) and np.isfinite(right) else delay


def _grow_trees(
    prepared: Prepared, rules: GrowthRules, anatomy: Sequence[tuple[str, float]]
) -> tuple[PurkinjeTree, ...] | Infeasible:
    """Grow both trees, left first, from names and values of their parameters."""
    trees = []
    for side, chart in prepared.charts.items():
        tree = grow_from_parameters(side, chart, prepared.seeds[side], dict(anatomy), rules)
        if isinstance(tree, Infeasible):
            return tree
        trees.append(tree)
    return tuple(trees)


@dataclass(frozen=True)
class Tissue:
    """Preparation that depends on the speeds of the tissue, up to a common factor.

    `attach` attaches trees to the myocardium; the last couplings are cached.
    """

    myocardium: Myocardium
    electrocardiograph: Electrocardiograph
    attach: Callable[[tuple[PurkinjeTree, ...]], Coupling]
