"""Data of the report's viewer, quantised and in base64 to keep the page small."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.heart import Heart
from fascicle.prediction.predicted import Predicted, PredictedBeat
from fascicle.reporting.surfaces import heart_views
from fascicle.study.activation_maps import since_first
from fascicle.torso.variation.conductor import torso_axes

NONE = 65_535  # marks a missing quantised value; others are lower
# Fields over all networks: name in `Predicted.maps`, label, unit, kind
MAPS = (
    ("activation_mean", "mean of the networks", "ms", "time"),
    ("activation_sd", "spread: standard deviation over the networks", "ms", "scalar"),
    ("probability_latest_fifth", "P(among the latest-activated 20 %)", "1", "scalar"),
)


def scene(heart: Heart, predicted: Mapping[str, Predicted]) -> dict[str, Any]:
    """Surface of a heart with the activations of scenarios, JSON for ``fascicleViewer``.

    Fields of one name share one scale, so that colours mean the same in all scenarios. The scale
    ends at the largest value of these fields; one slow network does not stretch that of the median.
    """
    triangles = heart.boundary[0]
    shown, numbered = np.unique(triangles, return_inverse=True)
    beats = {name: each.beats[each.extremes()["median"]] for name, each in predicted.items()}
    # roots may lie outside the mesh
    nodes = [tree.nodes for beat in beats.values() for tree, _ in beat.trees]
    points = np.concatenate([heart.vertices, *nodes])
    low, high = points.min(axis=0), points.max(axis=0)
    fields = {name: _fields(each, shown) for name, each in predicted.items()}
    for alike in zip(*fields.values(), strict=True):
        values = np.concatenate([field["values"] for field in alike])
        top = float(values[np.isfinite(values)].max(initial=0.0)) or 1.0
        for field in alike:
            field.update(low=0.0, high=top, values=_quantised(field["values"], 0.0, top))
    _, back, up = torso_axes(heart.electrodes)
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
        "up": up.tolist(),
        "front": (-back).tolist(),
        "base": (-heart_views(heart)["base"].axes[2]).tolist(),
        "scenarios": [
            {
                "name": name,
                "label": each.scenario.description or name,
                "fields": fields[name],
                "trees": _trees(beats[name], low, high),
            }
            for name, each in predicted.items()
        ],
    }


def _fields(found: Predicted, shown: Integers) -> list[dict[str, Any]]:
    extremes = found.extremes()
    fields = [
        (f"activation_{which}", f"network of {which} total activation time", "ms", "time",
         since_first(found.beats[extremes[which]].activation))
        for which in ("median", "minimum", "maximum")
    ]  # fmt: skip
    fields += [(*each, found.maps[each[0]]) for each in MAPS]
    keys = ("name", "label", "unit", "kind")
    return [dict(zip(keys, said, strict=True), values=v[shown]) for *said, v in fields]


def _trees(beat: PredictedBeat, low: Floats, high: Floats) -> list[dict[str, Any]]:
    trees, begin = [], float(beat.activation.min())
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
    """Values from `low` to `high` in steps; non-finite ones are `NONE`."""
    share = (np.where(np.isfinite(values), values, low) - low) / max(high - low, 1e-9)
    steps = np.round(np.clip(share, 0, 1) * (NONE - 1))
    return _encoded(np.where(np.isfinite(values), steps, NONE).astype("<u2"))


def _encoded(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
