"""An NVIDIA card, through CuPy: its kernels' source, and structures that Python and C++ share."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError, check_installed, one_line
from fascicle.core.ranges import check_text
from fascicle.kernels.growth import NODE

# No fused multiply-add: every operation rounds as on a processor, so that trees are the same to the
# last bit.
OPTIONS = ("-std=c++17", "-fmad=false")
THREADS = {"grow": 128, "attach": 256, "solve": 512, "electrocardiogram": 512}  # of a block

Bytes = NDArray[np.uint8]

# The members of the two structures that every kernel gets. Each takes eight bytes, so that the
# layout is the same on both sides.
HEART_FIELDS = {
    # the mesh: `fascicle.kernels.arrays.EikonalMesh`
    "vertices": "long long",
    **dict.fromkeys(("positions", "cells", "solver", "link_time"), "const double*"),
    **dict.fromkeys(("corners", "star_start", "star", "link_start", "link"), "const int*"),
    "least": "const float*",
    "slowness": "double",
    "band": "double",  # nodes later than the earliest by up to this are taken with it (ms)
    # `fascicle.kernels.arrays.TravelTimeTable`
    **dict.fromkeys(("row_start", "row_vertex"), "const int*"),
    "row_square": "const float*",
    "basis": "const double*",
    "site_reach": "double",  # sites further from each other have no ray (mm)
    # boundary triangles; their element is -1 where it does not conduct
    **dict.fromkeys(("surface", "surface_element", "surface_row"), "const int*"),
    "surface_opposite": "const int*",
    # charts, and the boundary triangles that can be nearest to a point of each of their triangles
    **{
        f"{side}_{name}": kind
        for kind, names in {
            "const double*": ("points", "vertices", "metric"),
            "const int*": ("triangles", "neighbours", "near_start", "near"),
        }.items()
        for side in ("lv", "rv")
        for name in names
    },
    # the ECG: `fascicle.forward.electrocardiogram.Electrocardiograph`
    **dict.fromkeys(("source_corners", "source_start", "source"), "const int*"),
    "source_weights": "const float*",
    "response": "const double*",
    **dict.fromkeys(("response_first", "response_length", "bins_per_step"), "long long"),
    "bin_width": "double",
}
BATCH_FIELDS = {
    # room of each tree or network
    **dict.fromkeys(("most_grown", "most_sprouts", "most_sites", "most_tree_nodes"), "long long"),
    **dict.fromkeys(("most_nodes", "most_bins", "most_samples"), "long long"),
    **dict.fromkeys(("times_are_shared", "bins_are_shared"), "long long"),
    # of each tree
    "plans": "const Plan*",
    **dict.fromkeys(("nodes", "ends"), "Node*"),
    "sprouts": "Sprout*",
    "moves": "Move*",
    **dict.fromkeys(("grown", "status"), "int*"),
    "missing": "double*",
    # of each network
    "beats": "const Beat*",
    "sites": "Site*",
    **dict.fromkeys(("children", "place", "site_count", "junctions", "node_count"), "int*"),
    **dict.fromkeys(("up", "first_child", "next_child", "root"), "int*"),
    **dict.fromkeys(("up_length", "seen", "time", "first", "last"), "double*"),
    "samples": "const int*",
    **dict.fromkeys(("bins", "channels"), "double*"),
}

# What the structures of the source are in Python
PLAN = np.dtype(
    [
        *((name, np.float64) for name in ("u", "v", "a", "b", "bundle")),
        *((name, np.float64, 4) for name in ("fascicle", "cosine", "sine")),
        *((name, np.float64) for name in ("step", "repulsion", "too_near")),
        *((name, np.float64) for name in ("branch_cosine", "branch_sine")),
        *((name, np.int32) for name in ("triangle", "fascicles", "segments", "generations")),
    ]
)
SITE = np.dtype(
    [
        ("position", np.float64, 3),
        ("barycentric", np.float64, 4),
        ("to_corner", np.float64, 4),
        ("weight", np.float64, 6),
        *((name, np.int32) for name in ("element", "row", "node", "padding")),
    ]
)
BEAT = np.dtype(
    [
        ("fires", np.float64, 2),
        *((name, np.float64) for name in ("cv", "anterograde", "retrograde", "tissue_speed")),
    ]
)
SIZES = {"Node": NODE.itemsize, "Plan": PLAN.itemsize, "Site": SITE.itemsize}
SIZES |= {"Beat": BEAT.itemsize, "Sprout": 32, "Move": 40}
"""Sizes of the structures (bytes)."""


def source(block: str | None = None) -> str:
    """Source of all kernels; `block` is a text in place of ``block.cuh``, which is for CUDA."""
    folder = files(__package__)
    # each after those that it uses; `block.cuh`, which a test replaces, comes before all
    kernels = ("local_solver", "network", "rays", "growth", "attach", "solve", "ecg")
    parts = [block if block is not None else (folder / "block.cuh").read_text(encoding="utf-8")]
    parts += [f"struct {name};" for name in SIZES]
    parts += [_declared("Heart", HEART_FIELDS), _declared("Batch", BATCH_FIELDS)]
    parts += [(folder / f"{name}.cuh").read_text(encoding="utf-8") for name in kernels]
    parts += [f'static_assert(sizeof({n}) == {size}, "{n}");' for n, size in SIZES.items()]
    return "\n".join(parts) + "\n"


def _declared(name: str, members: Mapping[str, str]) -> str:
    lines = "\n".join(f"    {kind} {member};" for member, kind in members.items())
    return f"struct {name} {{\n{lines}\n}};\n"


def structure(members: Mapping[str, str], values: Mapping[str, Any]) -> Bytes:
    """A structure as bytes, from numbers and addresses of arrays."""
    kinds = "".join("d" if kind == "double" else "q" for kind in members.values())
    return np.frombuffer(struct.pack(kinds, *(values[member] for member in members)), np.uint8)


def card_number(name: str) -> int:
    """The number of a card: 0 of ``"cuda"``, 1 of ``"cuda:1"``; InputError without it or CuPy."""
    check_text(name, "device")
    match = re.fullmatch(r"cuda(?::(\d{1,3}))?", name)
    if match is None:
        raise InputError(f"unknown device '{name}'; give cuda, or cuda:1 for the second card")
    check_installed("cupy", f"device '{name}'", "cuda")
    import cupy

    try:
        count = cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise InputError(
            f"device '{name}': no NVIDIA card can be used ({one_line(error)}); install the card's "
            "driver, or leave the device out"
        ) from error
    number = int(match[1] or 0)
    if number >= count:
        raise InputError(f"device '{name}': the cards of this machine end at cuda:{count - 1}")
    return number


class Card:
    """An NVIDIA card that runs kernels, by its name; in tests a processor takes its place."""

    shared_bytes: int  # memory that the threads of a block can share

    def __init__(self, name: str) -> None:
        number = card_number(name)
        import cupy

        self._cupy, self._device = cupy, cupy.cuda.Device(number)
        with self._device:
            module = cupy.RawModule(code=source(), options=OPTIONS)
            self._kernels = {kernel: module.get_function(kernel) for kernel in THREADS}
            static = max(kernel.shared_size_bytes for kernel in self._kernels.values())
            self.shared_bytes = self._device.attributes["MaxSharedMemoryPerBlockOptin"] - static
            for kernel in self._kernels.values():
                kernel.max_dynamic_shared_size_bytes = self.shared_bytes

    def upload(self, values: Bytes) -> Any:
        """Copy bytes to a new buffer of the card."""
        buffer = self.room(len(values))
        buffer.set(values)
        return buffer

    def room(self, size: int) -> Any:
        """Make an uninitialised buffer of `size` bytes."""
        with self._device:
            try:
                return self._cupy.empty(size, np.uint8)
            except self._cupy.cuda.memory.OutOfMemoryError as error:
                raise InputError(
                    f"the card has no memory left for {size / 1e6:.0f} MB; free some, or leave the "
                    "device out"
                ) from error

    def address(self, buffer: Any) -> int:
        """Address of a buffer."""
        return int(buffer.data.ptr)

    def download(self, buffer: Any, start: int, size: int) -> Bytes:
        """Copy bytes of a buffer, once all kernels have ended."""
        with self._device:
            return np.asarray(self._cupy.asnumpy(buffer[start : start + size]))

    def launch(self, kernel: str, blocks: int, shared: int, heart: Any, batch: Any) -> None:
        """Run a kernel on two structures in `blocks` blocks, each with `shared` bytes of memory."""
        with self._device:
            self._kernels[kernel]((blocks,), (THREADS[kernel],), (heart, batch), shared_mem=shared)
