"""What the viewer of a report shows, as small as a page needs it: quantised, in base64."""

from __future__ import annotations

import base64
import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.heart import Heart
from fascicle.prediction.predicted import Predicted, PredictedBeat
from fascicle.reporting.rendering import heart_views
from fascicle.study.activation_maps import since_first

STEPS = 65_534  # of a quantised value; the next number stands for none
NONE = 65_535
# Fields of a scenario beside the networks': name in `Predicted.maps`, what it is, unit
MAPS = (
    ("activation_mean", "mean of the networks", "ms", "time"),
    ("activation_sd", "spread: standard deviation over the networks", "ms", "scalar"),
    ("probability_latest_fifth", "probability to be in the latest-activated 20 %", "1", "scalar"),
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
        "scenarios": _scenarios(predicted, shown, low, high),
    }


def _scenarios(
    predicted: Mapping[str, Predicted], shown: Integers, low: Floats, high: Floats
) -> list[dict[str, Any]]:
    """Scenarios whose fields of one name have one scale, so that colours mean the same in all.

    It ends where the last of these fields does: one slow network, which is not shown beside the
    median ones, does not stretch theirs.
    """
    fields = {name: _fields(found, shown) for name, found in predicted.items()}
    tops: dict[str, float] = {}
    for field in itertools.chain(*fields.values()):
        known = field.values[np.isfinite(field.values)]
        tops[field.name] = max(tops.get(field.name, 0.0), float(known.max(initial=0.0)))
    return [
        {
            "name": name,
            "label": found.scenario.description or name,
            "fields": [field.encoded(tops[field.name] or 1.0) for field in fields[name]],
            "trees": _trees(found.beats[found.extremes()["median"]], low, high),
        }
        for name, found in predicted.items()
    ]


@dataclass(frozen=True)
class _Field:
    """Values at the vertices that are shown."""

    name: str
    label: str
    unit: str
    kind: str
    values: Floats

    def encoded(self, top: float) -> dict[str, Any]:
        """For JSON, between 0 and `top`."""
        values = _quantised(self.values, 0.0, top)
        return {**asdict(self), "low": 0.0, "high": top, "values": values}


def _fields(found: Predicted, shown: Integers) -> list[_Field]:
    extremes, maps = found.extremes(), found.maps
    fields = []
    for which in ("median", "minimum", "maximum"):
        times = since_first(found.beats[extremes[which]].activation)
        label = f"network of {which} total activation time"
        fields.append(_Field(f"activation_{which}", label, "ms", "time", times[shown]))
    return fields + [_Field(*each, maps[each[0]][shown]) for each in MAPS]


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
