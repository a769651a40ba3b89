"""Batches of networks: a heart on a card, and its kernels one after the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.quantities import SIDES
from fascicle.forward.device.card import BATCH_FIELDS, HEART_FIELDS, SITE, SIZES, Card, structure
from fascicle.forward.device.packing import packed_heart
from fascicle.forward.electrocardiogram import SAMPLE_STEP, Electrocardiograph
from fascicle.forward.preparation import Prepared
from fascicle.kernels.arrays import CORNERS
from fascicle.kernels.growth import NODE
from fascicle.kernels.jit import CHANNELS


@dataclass(frozen=True)
class Results:
    """Results of a batch of networks.

    Attributes
    ----------
    simulated : (b,) bool array
        Whether a network was simulated; else only `status`, `missing` and `ends` are valid.
    status, missing : (b, 2) arrays
        Outcome of the growth of both trees, and missing lengths: `fascicle.kernels.growth`.
    ends : (b, 2) array of NODE
        Last node of both trees.
    sizes, junctions : (b, 2) arrays
        Numbers of nodes and junctions of both trees.
    first, last : (b,) arrays
        Activation times of the first and the last vertex that is reached (ms).
    channels : list of (8, n_time) arrays
        Potentials (mV), every `SAMPLE_STEP` ms from 0; empty where a network was not simulated.
    """

    simulated: Booleans
    status: Integers
    missing: Floats
    ends: NDArray[np.void]
    sizes: Integers
    junctions: Integers
    first: Floats
    last: Floats
    channels: list[Floats]


class Simulator:
    """A heart, as `packed_heart` takes it, on a card, with room for a number of networks."""

    # Room for each tree, and each network. Larger ones, which hardly any heart has, are left to the
    # processor: the packaged heart's trees have at most 5000 nodes, its networks 800 junctions.
    most_grown: ClassVar[int] = 16_384
    most_sprouts: ClassVar[int] = 2048
    most_sites: ClassVar[int] = 2048

    def __init__(
        self,
        device: Card,
        prepared: Prepared,
        electrocardiograph: Electrocardiograph,
        networks: int,
    ) -> None:
        self.device = device
        self._quiet = electrocardiograph.action_potential.span[1]
        heart = packed_heart(prepared, electrocardiograph)
        self._vertices: int = heart["vertices"]
        self._bin_width: float = heart["bin_width"]
        if _waiting(self._most_nodes) > device.shared_bytes:
            raise InputError(
                f"a heart of {self._vertices} vertices is too large for the card; leave the device "
                "out"
            )
        self._heart_buffers = self._uploaded(heart)
        self._heart = device.upload(
            structure(HEART_FIELDS, heart | self._addresses(self._heart_buffers))
        )
        self._buffers = {name: device.room(networks * size) for name, size in self._sizes().items()}

    @property
    def _most_tree_nodes(self) -> int:
        """Room for the nodes of both trees: sites, forks and two roots."""
        return 2 * self.most_sites + 2

    @property
    def _most_nodes(self) -> int:
        return self._vertices + self._most_tree_nodes

    def _sizes(self) -> dict[str, int]:
        """Bytes that each network takes in the buffers that kernels write to."""
        node, number, integer = NODE.itemsize, 8, 4
        return {
            "nodes": 2 * self.most_grown * node,
            "sprouts": 2 * self.most_sprouts * SIZES["Sprout"],
            "moves": 2 * 2 * self.most_sprouts * SIZES["Move"],
            **dict.fromkeys(("grown", "status", "junctions", "root"), 2 * integer),
            "missing": 2 * number,
            "ends": 2 * node,
            **dict.fromkeys(("children", "place"), 2 * self.most_grown * integer),
            "sites": self.most_sites * SITE.itemsize,
            **dict.fromkeys(("site_count", "node_count"), integer),
            **dict.fromkeys(("up", "first_child", "next_child"), self._most_tree_nodes * integer),
            "up_length": self._most_tree_nodes * number,
            "seen": CORNERS * self.most_sites * number,
            "time": self._most_nodes * number,
            **dict.fromkeys(("first", "last"), number),
        }

    def run(self, plans: NDArray[np.void], beats: NDArray[np.void]) -> Results:
        """Simulate b networks, at most as many as there is room for.

        `plans` (2b,) are records PLAN of the trees, left first; `beats` (b,) records BEAT of times.
        """
        count, inputs = len(beats), {"plans": plans, "beats": beats}
        self._launch("grow", 2 * count, 0, inputs)
        self._launch("attach", count, 0, inputs)
        simulated = self._array("site_count", np.int32, count) >= 0
        in_trees = self._array("node_count", np.int32, count)[simulated]
        nodes = self._vertices + int(in_trees.max(initial=0))
        waiting, both = _waiting(nodes), _waiting(nodes) + 8 * nodes
        shared = both <= self.device.shared_bytes  # activation times are shared if they fit
        self._launch("solve", count, both if shared else waiting, inputs, times_are_shared=shared)
        first, last = (self._array(name, np.float64, count) for name in ("first", "last"))
        # activations that end after 2000 ms, or never begin, are left to the processor
        simulated &= (first < np.inf) & (last < 2000.0)
        return Results(
            simulated,
            self._array("status", np.int32, count, 2),
            self._array("missing", np.float64, count, 2),
            self._array("ends", NODE, count, 2),
            self._array("grown", np.int32, count, 2),
            self._array("junctions", np.int32, count, 2),
            first,
            last,
            self._channels(simulated, last, inputs),
        )

    def activation(self, number: int) -> Floats:
        """Activation (ms) in one of the last networks, in the mesh's vertex order."""
        return self._part("time", np.float64, number * self._most_nodes, self._vertices)

    def nodes(self, number: int, side: int, size: int) -> NDArray[np.void]:
        """Nodes, an array of NODE, of a tree of the last networks; `Results.sizes` has its size."""
        return self._part("nodes", NODE, (len(SIDES) * number + side) * self.most_grown, size)

    def _channels(
        self, simulated: Booleans, last: Floats, inputs: Mapping[str, NDArray[Any]]
    ) -> list[Floats]:
        """ECG channels of the networks that were simulated."""
        samples = np.zeros(len(last), np.int32)
        samples[simulated] = (
            np.ceil((last[simulated] + self._quiet) / SAMPLE_STEP).astype(np.int32) + 1
        )
        most = int(samples.max(initial=1))
        latest = last.max(where=simulated, initial=0.0)
        bins = int(latest / self._bin_width) + 8  # and some to spare
        size = CHANNELS * bins * 8
        shared = size <= self.device.shared_bytes
        room = {
            "channels": self.device.room(len(last) * CHANNELS * most * 8),
            "bins": self.device.room(8 if shared else len(last) * size),
        }
        self._launch(
            "electrocardiogram",
            len(last),
            size if shared else 0,
            {**inputs, "samples": samples},
            room,
            bins_are_shared=shared,
            most_bins=bins,
            most_samples=most,
        )
        values = self.device.download(room["channels"], 0, len(last) * CHANNELS * most * 8)
        rows = values.view(np.float64).reshape(len(last), -1)
        return [
            row[: CHANNELS * n].reshape(CHANNELS, n) for row, n in zip(rows, samples, strict=True)
        ]

    def _launch(
        self,
        kernel: str,
        blocks: int,
        shared: int,
        inputs: Mapping[str, NDArray[Any]],
        room: Mapping[str, Any] | None = None,
        **numbers: int,
    ) -> None:
        """Run a kernel on inputs, in the batch's buffers and `room`, buffers of its results."""
        uploaded = self._uploaded(inputs)
        members = dict.fromkeys(BATCH_FIELDS, 0) | {
            "most_grown": self.most_grown,
            "most_sprouts": self.most_sprouts,
            "most_sites": self.most_sites,
            "most_tree_nodes": self._most_tree_nodes,
            "most_nodes": self._most_nodes,
        }
        members |= self._addresses({**self._buffers, **uploaded, **(room or {})}) | numbers
        batch = self.device.upload(structure(BATCH_FIELDS, members))
        self.device.launch(kernel, blocks, shared, self._heart, batch)

    def _uploaded(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: self.device.upload(array.reshape(-1).view(np.uint8))
            for name, array in values.items()
            if isinstance(array, np.ndarray)
        }

    def _addresses(self, buffers: Mapping[str, Any]) -> dict[str, int]:
        return {name: self.device.address(buffer) for name, buffer in buffers.items()}

    def _array(self, name: str, kind: Any, *shape: int) -> NDArray[Any]:
        """Array at the beginning of a buffer of the batch."""
        return self._part(name, kind, 0, math.prod(shape)).reshape(shape)

    def _part(self, name: str, kind: Any, first: int, count: int) -> NDArray[Any]:
        size = np.dtype(kind).itemsize
        part = self.device.download(self._buffers[name], first * size, count * size)
        return part.view(kind)


def _waiting(nodes: int) -> int:
    """Bytes of a set of queued nodes: a bit for each node, in words of 64 bits."""
    return 8 * -(-nodes // 64)
