"""The forward model on a graphics card: from parameters to signals or beats, in batches."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Infeasible, complete
from fascicle.core.quantities import SIDES, Changes, fascicles, quantity
from fascicle.forward.beat import Beat, Signals
from fascicle.forward.device.batch import Results, Simulator
from fascicle.forward.device.card import BEAT, PLAN, Card
from fascicle.forward.eikonal.activation import Activation
from fascicle.forward.electrocardiogram import SAMPLE_STEP, leads_from_independent
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import root_times
from fascicle.kernels.growth import GROWN, repulsion
from fascicle.purkinje.growth import tree_of_nodes, tree_outside

Made = TypeVar("Made")


class GpuBackend:
    """An NVIDIA card that simulates intrinsic beats; a `fascicle.forward.model.Backend`.

    Parameters
    ----------
    device : str
        ``"cuda"``, or ``"cuda:1"`` for the second card.

    Raises
    ------
    InputError
        If there is no such card, or no CuPy.
    """

    def __init__(self, device: str = "cuda") -> None:
        self._use(Card(device), 512)  # 3 MB each, and several for each of a card's processors

    @classmethod
    def on(cls, device: Card, networks: int) -> GpuBackend:
        """Backend on an open device, with room for `networks` networks at a time."""
        backend = cls.__new__(cls)
        backend._use(device, networks)
        return backend

    def _use(self, device: Card, networks: int) -> None:
        self.batch = networks
        self._simulator = lru_cache(1)(
            lambda model: Simulator(device, model.prepared, model.electrocardiograph, networks)
        )

    def refusal(self, model: ForwardModel, names: Iterable[str]) -> str:
        """Reason not to simulate a model with other values of these quantities; empty if none."""
        if model.rules.term.function is not repulsion:
            return "the card does not know the growth rule"
        if model.heart.additional_electrodes:
            return "the card computes the twelve leads, and the heart has additional electrodes"
        of_the_processor = (Changes.TISSUE, Changes.BLOCKS, Changes.SOURCES, Changes.LEAD_FIELDS)
        for name in names:
            if quantity(name).changes in of_the_processor:
                return f"parameter '{name}' changes {quantity(name).changes}"
        return ""

    def signals(
        self, model: ForwardModel, parameters: Sequence[Mapping[str, float]]
    ) -> Iterator[Signals | Infeasible | None]:
        """Signals to compare with a recording, in order; None for too large networks."""

        def to_signals(number: int, values: Mapping[str, float], results: Results) -> Signals:
            leads = _leads(results.channels[number], values)
            junctions = tuple(int(count) for count in results.junctions[number])
            return Signals(leads, float(results.first[number] / SAMPLE_STEP), junctions)

        return self._simulate_each(model, parameters, to_signals)

    def beats(
        self, model: ForwardModel, parameters: Sequence[Mapping[str, float]]
    ) -> Iterator[Beat | Infeasible | None]:
        """Beats of networks, in order; None for too large networks."""
        simulator, prepared = self._simulator(model), model.prepared

        def to_beat(number: int, values: Mapping[str, float], results: Results) -> Beat:
            trees = tuple(
                tree_of_nodes(side, simulator.nodes(number, k, size), prepared.charts[side])
                for k, (side, size) in enumerate(zip(SIDES, results.sizes[number], strict=True))
            )
            activation = np.empty(len(prepared.myocardium.order))
            activation[prepared.myocardium.order] = simulator.activation(number)
            leads = _leads(results.channels[number], values)
            return Beat(leads, 0.0, trees, Activation(activation))

        return self._simulate_each(model, parameters, to_beat)

    def _simulate_each(
        self,
        model: ForwardModel,
        parameters: Sequence[Mapping[str, float]],
        convert: Callable[[int, Mapping[str, float], Results], Made],
    ) -> Iterator[Made | Infeasible | None]:
        """Simulate networks in batches; yield in order their results, converted by `convert`."""
        completed = [model.with_root_time(complete(network)) for network in parameters]
        for start in range(0, len(completed), self.batch):
            batch = completed[start : start + self.batch]
            networks = [network for network in batch if not isinstance(network, Infeasible)]
            outcomes: Iterator[Made | Infeasible | None] = iter(())
            if networks:
                results = self._simulator(model).run(
                    np.stack([_plan(model, side, n) for n in networks for side in SIDES]),
                    np.array([_beat(model, n) for n in networks], BEAT),
                )
                outcomes = (
                    convert(number, values, results)
                    if results.simulated[number]
                    else _outside(model, number, values, results)
                    for number, values in enumerate(networks)
                )
            # the whole batch before the next one overwrites its results
            yield from [
                network if isinstance(network, Infeasible) else next(outcomes) for network in batch
            ]


def _plan(model: ForwardModel, side: str, values: Mapping[str, float]) -> NDArray[np.void]:
    """Plan of a tree's growth, a record of PLAN.

    Cosines and sines are computed here, as for a processor, so that they round alike.
    """
    seed, rules = model.prepared.seeds[side], model.rules.with_values(values)
    step, count = rules.branch_length / rules.segments, fascicles(side, values)
    plan = np.zeros((), PLAN)
    plan["u"], plan["v"] = seed.point
    plan["a"], plan["b"] = seed.heading
    plan["triangle"], plan["fascicles"] = seed.triangle, count
    plan["bundle"] = values[f"{side}_initial_length"]
    for k in range(count):
        angle = values[f"{side}_fascicle_angle_{k + 1}"]
        plan["fascicle"][k] = values[f"{side}_fascicle_length_{k + 1}"]
        plan["cosine"][k], plan["sine"][k] = math.cos(angle), math.sin(angle)
    plan["step"], (plan["repulsion"],) = step, rules.term.values
    plan["too_near"] = (rules.clearance * step) ** 2
    plan["branch_cosine"] = math.cos(rules.branch_angle)
    plan["branch_sine"] = math.sin(rules.branch_angle)
    plan["segments"], plan["generations"] = rules.segments, rules.generations
    return plan


def _beat(model: ForwardModel, values: Mapping[str, float]) -> tuple[Any, ...]:
    """Times of a beat, scaled so that the tissue conducts as it was prepared.

    The time scaling is that of `fascicle.forward.eikonal.activation.solve`.
    """
    speed = model.conduction.with_values(values).alpha / model.conduction.alpha
    fires = tuple(speed * time for time in root_times(values["root_time"]))
    anterograde, retrograde = (
        values.get(f"{way}_delay", 0.0) for way in ("anterograde", "retrograde")
    )
    return fires, values["cv"] / speed, speed * anterograde, speed * retrograde, speed


def _outside(
    model: ForwardModel, number: int, values: Mapping[str, float], results: Results
) -> Infeasible | None:
    """The first tree that does not fit; None where the network is too large for the card."""
    rows = results.status[number], results.missing[number], results.ends[number]
    for side, status, missing, end in zip(SIDES, *rows, strict=True):
        if status >= 0:
            part = "initial_length" if status == 0 else f"fascicle_length_{status}"
            length, chart = values[f"{side}_{part}"], model.prepared.charts[side]
            return tree_outside(side, int(status), length, float(missing), np.array([end]), chart)
        if status != GROWN:
            return None
    return None


def _leads(channels: Floats, values: Mapping[str, float]) -> Floats:
    """The twelve leads (mV)."""
    return np.asarray(values.get("gain", 1.0) * (leads_from_independent() @ channels))
