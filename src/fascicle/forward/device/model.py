"""The forward model on a device: from parameters to signals, beats, or what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.parameters import complete
from fascicle.core.quantities import SIDES, Changes, quantity
from fascicle.forward.device.batch import NETWORKS, Device, Network, Results, Simulator
from fascicle.forward.ecg.electrocardiogram import STEP, Electrocardiograph, leads_from_independent
from fascicle.forward.preparation import Prepared
from fascicle.forward.scenario import Scenario, root_times
from fascicle.forward.simulation import Signals, SimulatedBeat
from fascicle.heart.conduction import Conduction
from fascicle.kernels.growth import GROWN
from fascicle.purkinje.growth import GrowthRules, tree_of_nodes, tree_outside
from fascicle.purkinje.tree import InvalidTree

Made = TypeVar("Made")


def check_simulated(names: Sequence[str]) -> None:
    """Refuse quantities that ask for another tissue or body than the heart's.

    Raises
    ------
    InputError
        With the name of the first.
    """
    for name in names:
        if quantity(name).changes in (Changes.TISSUE, Changes.BODY):
            raise InputError(
                f"parameter '{name}' changes {quantity(name).changes}, which a card does not "
                "simulate; leave the parameter or the card out"
            )


class DeviceModel:
    """The forward model of a heart on a device: intrinsic beats of networks, in batches.

    Parameters
    ----------
    device : Device
        Where.
    prepared, electrocardiograph, conduction, rules
        Of the forward model.
    networks : int
        In a batch.
    """

    def __init__(
        self,
        device: Device,
        prepared: Prepared,
        electrocardiograph: Electrocardiograph,
        conduction: Conduction,
        rules: GrowthRules,
        networks: int = NETWORKS,
    ) -> None:
        self._simulator = Simulator(device, prepared, electrocardiograph, networks)
        self._prepared, self._conduction, self._rules = prepared, conduction, rules

    @property
    def batch(self) -> int:
        """How many networks are simulated at a time."""
        return self._simulator.networks

    def signals(
        self, parameters: Sequence[Mapping[str, float]]
    ) -> Iterator[Signals | InvalidTree | None]:
        """What of networks is compared with a recording; None where it is left to the processor.

        Parameters
        ----------
        parameters : sequence of mappings
            Of each network, as for `fascicle.ForwardModel.simulate`.
        """
        return self._each(parameters, self._signals)

    def beats(
        self, parameters: Sequence[Mapping[str, float]]
    ) -> Iterator[SimulatedBeat | InvalidTree | None]:
        """The beats of networks, likewise."""
        return self._each(parameters, self._beat)

    def _each(
        self,
        parameters: Sequence[Mapping[str, float]],
        make: Callable[[int, Mapping[str, float], Results], Made],
    ) -> Iterator[Made | InvalidTree | None]:
        """What is made of each network in a batch's results, in order."""
        every = [complete(network) for network in parameters]
        for start in range(0, len(every), self.batch):
            networks = every[start : start + self.batch]
            results = self._simulator.run([self._network(values) for values in networks])
            # all of them before the next batch takes their place
            yield from [
                make(number, values, results)
                if results.simulated[number]
                else self._outside(number, values, results)
                for number, values in enumerate(networks)
            ]

    def _network(self, values: Mapping[str, float]) -> Network:
        check_simulated([*values])
        anatomy = {n: v for n, v in values.items() if quantity(n).changes is Changes.TREES}
        left, right = root_times(values["root_time"])
        delays = Scenario().delays(values)
        return Network(
            anatomy,
            self._rules.with_values(anatomy),
            roots=(left, right),
            cv=values["cv"],
            anterograde=delays["anterograde_delay"],
            retrograde=delays["retrograde_delay"],
            tissue_speed=self._conduction.with_values(values).alpha / self._conduction.alpha,
        )

    def _outside(
        self, number: int, values: Mapping[str, float], results: Results
    ) -> InvalidTree | None:
        """The first tree that does not fit; None where the network is too large for the device."""
        for side, status, missing, end in zip(
            SIDES,
            results.status[number],
            results.missing[number],
            results.ends[number],
            strict=True,
        ):
            if status >= 0:
                part = "initial_length" if status == 0 else f"fascicle_length_{status}"
                wanted, chart = values[f"{side}_{part}"], self._prepared.charts[side]
                return tree_outside(
                    side, int(status), wanted, float(missing), np.array([end]), chart
                )
            if status != GROWN:
                return None
        return None

    def _signals(self, number: int, values: Mapping[str, float], results: Results) -> Signals:
        leads = _leads(results.channels[number], values)
        junctions = tuple(int(count) for count in results.junctions[number])
        return Signals(leads, float(results.first[number] / STEP), junctions)

    def _beat(self, number: int, values: Mapping[str, float], results: Results) -> SimulatedBeat:
        trees = tuple(
            tree_of_nodes(side, self._simulator.nodes(number, k, size), self._prepared.charts[side])
            for k, (side, size) in enumerate(zip(SIDES, results.sizes[number], strict=True))
        )
        order = self._prepared.myocardium.order
        activation = np.empty(len(order))
        activation[order] = self._simulator.activation(number)
        return SimulatedBeat(_leads(results.channels[number], values), 0.0, activation, trees)


def _leads(channels: Floats, values: Mapping[str, float]) -> Floats:
    """The twelve leads (mV)."""
    return np.asarray(values.get("gain", 1.0) * (leads_from_independent() @ channels))
