"""A heart's arrays in the layout of a card's kernels: the only module with both layouts."""

from __future__ import annotations

from typing import Any

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.forward.eikonal.myocardium import Myocardium, grouped
from fascicle.forward.electrocardiogram import SAMPLE_STEP, Electrocardiograph
from fascicle.forward.preparation import Prepared
from fascicle.kernels.arrays import CORNERS
from fascicle.kernels.ray_travel_times import BASIS
from fascicle.mesh.topology import TETRAHEDRON_EDGES


def packed_heart(prepared: Prepared, electrocardiograph: Electrocardiograph) -> dict[str, Any]:
    """Numbers and arrays of `fascicle.forward.device.card.HEART_FIELDS`.

    The ECG integral is without tissue that does not conduct.
    """
    return (
        _mesh(prepared.myocardium)
        | _table(prepared.myocardium)
        | _charts(prepared)
        | _ecg(electrocardiograph, prepared.myocardium.order)
    )


def _mesh(myocardium: Myocardium) -> dict[str, Any]:
    mesh = myocardium.mesh
    star, link = mesh.star, mesh.link
    tetrahedron, place = np.divmod(star["item"], CORNERS)
    least = np.minimum.reduce([star["least_a"], star["least_b"], star["least_c"]])
    # corners of a tetrahedron besides each corner
    other_corners_of = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
    other_corners = np.take_along_axis(mesh.corners[tetrahedron], other_corners_of[place], axis=1)
    return {
        "vertices": len(mesh.vertices),
        "positions": _doubles(mesh.vertices),
        "corners": _ints(mesh.corners),
        "cells": _doubles(mesh.cells),
        "solver": _doubles(mesh.solver),
        "star_start": _ints(mesh.star_start),
        "star": _ints(np.column_stack([other_corners, star["item"]])),
        "least": np.ascontiguousarray(least, np.float32),
        "link_start": _ints(mesh.link_start),
        "link": _ints(link["vertex"]),
        "link_time": _doubles(link["time"]),
        "slowness": mesh.slowness,
        # waiting nodes are processed together if they are later than the earliest by up to twice
        # the mean travel time of an edge: a wide band gives the threads more work, more of it in
        # vain
        "band": 2.0 * float(link["time"].mean()),
    }


def _table(myocardium: Myocardium) -> dict[str, Any]:
    mesh, table = myocardium.mesh, myocardium.travel_times
    i, j = mesh.corners[:, TETRAHEDRON_EDGES].transpose(2, 0, 1)
    longest = np.linalg.norm(mesh.vertices[i] - mesh.vertices[j], axis=2).max()
    element = np.where(myocardium.conducts[myocardium.owner], myocardium.owner, -1)
    return {
        "row_start": _ints(table.start),
        "row_vertex": _ints(table.vertex),
        "row_square": np.ascontiguousarray(table.square, np.float32),
        "basis": _doubles(BASIS),
        # both sites are as near to the centre of a row's triangle as the row reaches, or nearer
        # than an edge
        "site_reach": float(table.reach + longest),
        "surface": _ints(myocardium.surface),
        "surface_element": _ints(element),
        "surface_row": _ints(table.row),
        "surface_opposite": _ints(table.opposite),
    }


def _charts(prepared: Prepared) -> dict[str, Any]:
    packed: dict[str, Any] = {}
    for side, chart in prepared.charts.items():
        candidates = prepared.myocardium.candidates[side]
        packed |= {
            f"{side}_points": _doubles(chart.points),
            f"{side}_vertices": _doubles(chart.vertices),
            f"{side}_triangles": _ints(chart.triangles),
            f"{side}_neighbours": _ints(chart.neighbours),
            f"{side}_metric": _doubles(chart.metric),
            f"{side}_near_start": _ints(candidates.start),
            f"{side}_near": _ints(candidates.triangle),
        }
    return packed


def _ecg(electrocardiograph: Electrocardiograph, order: Integers) -> dict[str, Any]:
    number = np.argsort(order)  # its inverse
    corners = number[electrocardiograph.corners]
    start, source = grouped(corners.ravel(), len(order))  # CORNERS·tetrahedron + corner
    assert CORNERS == 4, "the kernel takes the corner from the two lowest bits"
    first, response = electrocardiograph.response
    return {
        "source_corners": _ints(corners),
        "source_weights": np.ascontiguousarray(electrocardiograph.weights, np.float32),
        "source_start": _ints(start),
        "source": _ints(source),
        "response": _doubles(response),
        "response_first": first,
        "response_length": len(response),
        "bins_per_step": electrocardiograph.bins_per_step,
        "bin_width": SAMPLE_STEP / electrocardiograph.bins_per_step,
    }


def _ints(values: Any) -> np.ndarray[Any, np.dtype[np.int32]]:
    return np.ascontiguousarray(values, np.int32)


def _doubles(values: Any) -> Floats:
    return np.ascontiguousarray(values, np.float64)
