"""The kernels' source, and the structures that Python and C++ share."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.kernels.growth import NODE

Bytes = NDArray[np.uint8]

# Files, each after those that it uses; `block.cuh`, which a test replaces, comes before all
FILES = (
    "local_solver.cuh",
    "network.cuh",
    "rays.cuh",
    "growth.cuh",
    "attach.cuh",
    "solve.cuh",
    "ecg.cuh",
)

# The members of the two structures that every kernel gets. Each takes eight bytes, so that the
# layout is the same on both sides.
HEART = {
    # the mesh: `fascicle.kernels.arrays.EikonalMesh`
    "vertices": "long long",
    "positions": "const double*",
    "corners": "const int*",
    "cells": "const double*",
    "solver": "const double*",
    "star_start": "const int*",
    "star": "const int*",
    "least": "const float*",
    "link_start": "const int*",
    "link": "const int*",
    "link_time": "const double*",
    "slowness": "double",
    "band": "double",  # nodes later than the earliest by up to this are taken with it (ms)
    # `fascicle.kernels.arrays.TravelTimeTable`
    "row_start": "const int*",
    "row_vertex": "const int*",
    "row_square": "const float*",
    "basis": "const double*",
    "site_reach": "double",  # sites further from each other have no ray (mm)
    # boundary triangles; their element is -1 where it does not conduct
    "surface": "const int*",
    "surface_element": "const int*",
    "surface_row": "const int*",
    "surface_opposite": "const int*",
    # charts, and the boundary triangles that can be nearest to a point of each of their triangles
    **{
        f"{side}_{name}": kind
        for side in ("lv", "rv")
        for name, kind in {
            "points": "const double*",
            "vertices": "const double*",
            "triangles": "const int*",
            "neighbours": "const int*",
            "metric": "const double*",
            "near_start": "const int*",
            "near": "const int*",
        }.items()
    },
    # the ECG: `fascicle.forward.ecg.electrocardiogram.Electrocardiograph`
    "source_corners": "const int*",
    "source_weights": "const float*",
    "source_start": "const int*",
    "source": "const int*",
    "response": "const double*",
    "response_first": "long long",
    "response_length": "long long",
    "bins_per_step": "long long",
    "bin_width": "double",
}
BATCH = {
    # room of each tree or network
    "most_grown": "long long",
    "most_sprouts": "long long",
    "most_sites": "long long",
    "most_tree_nodes": "long long",
    "most_nodes": "long long",
    "most_bins": "long long",
    "most_samples": "long long",
    "times_are_shared": "long long",
    "bins_are_shared": "long long",
    # of each tree
    "plans": "const Plan*",
    "nodes": "Node*",
    "sprouts": "Sprout*",
    "moves": "Move*",
    "grown": "int*",
    "status": "int*",
    "missing": "double*",
    "ends": "Node*",
    # of each network
    "children": "int*",
    "place": "int*",
    "sites": "Site*",
    "site_count": "int*",
    "junctions": "int*",
    "node_count": "int*",
    "up": "int*",
    "first_child": "int*",
    "next_child": "int*",
    "up_length": "double*",
    "root": "int*",
    "seen": "double*",
    "beats": "const Beat*",
    "time": "double*",
    "first": "double*",
    "last": "double*",
    "samples": "const int*",
    "bins": "double*",
    "channels": "double*",
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
SPROUT_BYTES, MOVE_BYTES = 32, 40
SIZES = {
    "Node": NODE.itemsize,
    "Plan": PLAN.itemsize,
    "Site": SITE.itemsize,
    "Beat": BEAT.itemsize,
    "Sprout": SPROUT_BYTES,
    "Move": MOVE_BYTES,
}


def source(block: str | None = None) -> str:
    """All of the source.

    Parameters
    ----------
    block : str, optional
        In place of ``block.cuh``, which is CUDA's.
    """
    here = files(__package__)
    parts = [block if block is not None else (here / "block.cuh").read_text(encoding="utf-8")]
    parts += [f"struct {name};" for name in SIZES]
    parts += [_declared("Heart", HEART), _declared("Batch", BATCH)]
    parts += [(here / name).read_text(encoding="utf-8") for name in FILES]
    parts += [f'static_assert(sizeof({n}) == {size}, "{n}");' for n, size in SIZES.items()]
    return "\n".join(parts) + "\n"


def _declared(name: str, members: Mapping[str, str]) -> str:
    lines = "\n".join(f"    {kind} {member};" for member, kind in members.items())
    return f"struct {name} {{\n{lines}\n}};\n"


def structure(members: Mapping[str, str], values: Mapping[str, Any]) -> Bytes:
    """A structure as bytes, from numbers and, of arrays, addresses."""
    kinds = "".join("d" if kind == "double" else "q" for kind in members.values())
    return np.frombuffer(struct.pack(kinds, *(values[member] for member in members)), np.uint8)
