"""What the viewer of a report shows, as small as a page needs it: quantised, in base64."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.heart import Heart
from fascicle.prediction.scenarios import Predicted, PredictedBeat
from fascicle.reporting.rendering import heart_views

STEPS = 65_534  # of a quantised value; the next number stands for none
NONE = 65_535
# Fields of a scenario beside the networks': name in `Predicted.maps`, what it is, unit
MAPS = (
    ("activation_mean", "mean of the networks", "ms", "time"),
    ("activation_sd", "spread: standard deviation over the networks", "ms", "scalar"),
    ("probability_latest_fifth", "probability to be among the latest fifth", "1", "scalar"),
)


def scene(heart: Heart, predicted: Mapping[str, Predicted]) -> dict[str, Any]:
    """Surface of a heart with the activations of scenarios, for ``fascicleViewer``.

    Parameters
    ----------
    heart : Heart
        The heart.
    predicted : mapping of name to Predicted
        Scenarios over its networks.

    Returns
    -------
    dict
        Of texts, numbers and base64, for JSON.
    """
    triangles = heart.boundary[0]
    shown, numbered = np.unique(triangles, return_inverse=True)
    low, high = heart.vertices.min(axis=0), heart.vertices.max(axis=0)
    for found in predicted.values():  # trees end on the endocardium, roots may lie outside the mesh
        for tree, _ in found.beats[found.extremes()["median"]].trees:
            low, high = np.minimum(low, tree.nodes.min(0)), np.maximum(high, tree.nodes.max(0))
    anterior = heart_views(heart)["anterior"].axes
    surface = {
        "name": "heart",
        "vertices": _positions(heart.vertices[shown], low, high),
        "triangles": _encoded(numbered.reshape(triangles.shape).astype("<u4")),
        "index": _encoded(np.arange(len(shown), dtype="<u4")),
        "opacity": 1.0,
    }
    return {
        "surfaces": [surface],
        "box": {"low": low.tolist(), "high": high.tolist()},
        "up": anterior[1].tolist(),
        "front": (-anterior[2]).tolist(),
        "scenarios": [_scenario(n, p, shown, low, high) for n, p in predicted.items()],
    }


def _scenario(
    name: str, found: Predicted, shown: Integers, low: Floats, high: Floats
) -> dict[str, Any]:
    extremes, maps = found.extremes(), found.maps()
    begin = {k: float(found.beats[k].activation.min()) for k in extremes.values()}
    fields = []
    for which in ("median", "minimum", "maximum"):
        number = extremes[which]
        times = found.beats[number].activation[shown].astype(float) - begin[number]
        label = f"network of {which} total activation time"
        fields.append(_field(f"activation_{which}", label, "ms", "time", times))
    fields += [_field(key, label, unit, kind, maps[key][shown]) for key, label, unit, kind in MAPS]
    median = found.beats[extremes["median"]]
    return {
        "name": name,
        "label": found.scenario.description or name,
        "duration": max(field["high"] for field in fields if field["kind"] == "time"),
        "fields": fields,
        "trees": _trees(median, begin[extremes["median"]], low, high),
    }


def _field(name: str, label: str, unit: str, kind: str, values: Floats) -> dict[str, Any]:
    known = values[np.isfinite(values)]
    low, high = (0.0, float(known.max())) if len(known) else (0.0, 1.0)
    encoded = _quantised(values, low, high)
    return {
        "name": name, "label": label, "unit": unit, "kind": kind, "low": low, "high": high,
        "values": encoded,
    }  # fmt: skip


def _trees(beat: PredictedBeat, begin: float, low: Floats, high: Floats) -> list[dict[str, Any]]:
    trees = []
    for tree, times in beat.trees:
        ends = np.flatnonzero(tree.parents >= 0)
        since = times.astype(float) - begin
        known = since[np.isfinite(since)]
        first, last = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        trees.append(
            {
                "side": tree.side,
                "nodes": _positions(tree.nodes, low, high),
                "segments": _encoded(np.column_stack([tree.parents[ends], ends]).astype("<u4")),
                "times": _quantised(since, first, last),
                "low": first,
                "high": last,
            }
        )
    return trees


def _positions(points: Floats, low: Floats, high: Floats) -> str:
    return _encoded(np.round((points - low) / (high - low) * NONE).astype("<u2"))


def _quantised(values: Floats, low: float, high: float) -> str:
    """Values from `low` to `high` in `STEPS`; what is not finite as `NONE`."""
    share = (np.where(np.isfinite(values), values, low) - low) / max(high - low, 1e-9)
    steps = np.round(np.clip(share, 0, 1) * STEPS)
    return _encoded(np.where(np.isfinite(values), steps, NONE).astype("<u2"))


def _encoded(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")


def decoded(text: str, kind: str, columns: int = 1) -> NDArray[Any]:
    """Array (n, columns), or (n,), of what a scene holds; for tests and other readers."""
    array = np.frombuffer(base64.b64decode(text), dtype=kind)
    return array.reshape(-1, columns) if columns > 1 else array
