"""Data of the report's viewer, quantised and compressed to keep the page small."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS
from fascicle.core.quantities import SHOWN_UNITS, parameter_name, quantity
from fascicle.forward.activation_sequence import since_first
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import first_sample
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import His, Stimulus, in_state
from fascicle.forward.scenario import Scenario
from fascicle.heart.fibres import Wall
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import ENDOCARDIA, labelled_mesh
from fascicle.heart.sites import SEGMENTS, Sites, places
from fascicle.networks.target_comparison import Network, TargetComparison
from fascicle.prediction.indices import Territories
from fascicle.prediction.predicted import RINGING, Predicted
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.reporting.names import capitals, on_template, scenario_name
from fascicle.reporting.surfaces import heart_views
from fascicle.study.population import evenly_spread
from fascicle.torso.conductor import torso_axes

NONE = 65_535  # marks a missing quantised value; others are lower
MAPS = (  # over all networks: name in `Predicted.maps`, label, unit, kind
    ("activation_mean", "mean of the networks", "ms", "time"),
    ("activation_sd", "spread: standard deviation over the networks", "ms", "scalar"),
    ("probability_latest_fifth", "P(among the latest-activated 20 %)", "1", "scalar"),
)
Thinned = tuple[Integers, Integers]  # nodes, and where their parents are: see `_thinned`


def marks(
    scenario: Scenario, values: Mapping[str, float], trees: Sequence[PurkinjeTree], sites: Sites
) -> list[dict[str, Any]]:
    """Marks for the viewer: kind (``"paced"`` or ``"blocked"``), text and place (mm).

    `values` are the network's parameters, `trees` those of its beat in the scenario.
    """
    network_trees = trees[: len(trees) - len(scenario.trees)]
    scenario = in_state(scenario, values.get("conduction", 0.0))
    marked: list[tuple[str, str, Floats]] = []
    roots = np.array([tree.nodes[tree.root] for tree in network_trees])
    for primitive in scenario.primitives:
        if isinstance(primitive, Stimulus):
            site, place = primitive.site, primitive.position
            if place is None:
                assert site is not None
                place = sites.position(site)
            marked.append(("paced", site if isinstance(site, str) else "stimulus", np.array(place)))
        elif isinstance(primitive, His) and primitive.stimulus_time is not None:
            marked.append(("paced", "His bundle", roots[:2].mean(axis=0)))
        if not primitive.blocked:
            continue
        alone = Scenario((primitive,), scenario.trees)
        excitation = alone.excitation(network_trees, values.get("root_time", 0.0), values, sites)
        text = ", ".join(sorted(structure.removeprefix("the ") for structure in primitive.blocked))
        branches = excitation.his.branches if excitation.his is not None else ()
        places = [root for root, way in zip(roots, branches, strict=False) if np.isinf(way)]
        ends = np.cumsum([len(tree.nodes) for tree in excitation.trees])
        parts = np.split(np.broadcast_to(excitation.speed, ends[-1]), ends[:-1])
        for tree, speed in zip(excitation.trees, parts, strict=True):
            # where parts of a tree without conduction begin
            dead = (speed == 0) & (tree.parents >= 0)
            begins = dead & ~dead[tree.parents]
            places += list(tree.nodes[np.unique(tree.parents[begins])])
        marked += [("blocked", text, place) for place in places]
    return [
        {"kind": kind, "text": capitals(text), "place": np.round(place, 1).tolist()}
        for kind, text, place in marked
    ]


def where(vertex: int, sites: Sites) -> str:
    """Location of a vertex of the heart in words: the segment, and the side of the septum."""
    heart, places = sites.heart, sites.places
    element = int(np.flatnonzero((heart.tetrahedra == vertex).any(axis=1))[0])
    segment, wall = places.segment[element], places.wall[element]
    name = SEGMENTS[segment - 1] if segment > 0 else "RV free wall"
    if wall != Wall.SEPTUM:
        return name
    left, right = (
        np.linalg.norm(e.vertices - heart.vertices[vertex], axis=1).min() for e in heart.endocardia
    )
    return f"{name}, {'left' if left < right else 'right'} side of the septum"


def scene(
    heart: Heart,
    predicted: Mapping[str, Predicted],
    networks: Sequence[Network] = (),
    recording: TargetComparison | None = None,
    model: ForwardModel | None = None,
) -> dict[str, Any]:
    """Surface of a heart with scenarios in some of the networks, JSON for ``fascicleViewer``.

    All times are counted from the first activation of the ventricles. The networks shown are
    evenly spread over the order of total activation time, the median one among them. Of an atlas,
    ``hearts`` are the positions of the surface in their hearts, and ``heart`` the number among
    these of each network; maps over all networks are shown on the template.

    Parameters
    ----------
    heart : Heart
        The heart, or the atlas of the networks' hearts.
    predicted : mapping of name to Predicted
        Scenarios, the intrinsic beat first.
    networks : sequence of Network, optional
        The population, for the parameters by which it can be ordered.
    recording : TargetComparison, optional
        The recording, and its comparison with simulated networks.
    model : ForwardModel, optional
        Forward model, which has the sites, the blocks, the scar, and the hearts of an atlas.
    """
    first = next(iter(predicted.values()))
    triangles, shown, endocardial = boundary(heart)
    chosen = _chosen(first, len(shown), len(predicted), heart.atlas is not None)
    models, distinct = [model] * len(chosen), list[ForwardModel]()
    if model is not None and heart.atlas is not None:
        own = [model.of_heart(networks[k].parameters) for k in chosen]
        models, distinct = [*own], [*dict.fromkeys(own)]
    beats = {name: [prediction.beats[k] for k in chosen] for name, prediction in predicted.items()}
    all_beats = [beat for scenario_beats in beats.values() for beat in scenario_beats]
    # trees by hash, so that each is stored once
    geometry: dict[bytes, tuple[int, PurkinjeTree]] = {}
    for tree in (tree for beat in all_beats for tree in beat.trees):
        geometry.setdefault(_key(tree), (len(geometry), tree))
    trees = [tree for _, tree in geometry.values()]
    drawn = {key: _thinned(tree) for key, (_, tree) in geometry.items()}
    torsos = [networks[k].torso if len(networks) else None for k in chosen]
    times = {name: [_tree_times(b, drawn) for b in of_name] for name, of_name in beats.items()}
    # roots may lie outside the mesh
    hearts = [heart.vertices, *(other.heart.vertices for other in distinct)]
    points = np.concatenate([*hearts, *(tree.nodes for tree in trees)])
    low, high = points.min(axis=0), points.max(axis=0)
    fired = (of_tree for of_name in times.values() for of_beat in of_name for of_tree in of_beat)
    begin = min([0.0, *(float(np.nanmin(of_tree, initial=0.0)) for of_tree in fired)])
    last = max(float(np.nanmax(since_first(beat.activation))) for beat in all_beats)
    # whole boxes of ECG paper, up to where the QRS has ended
    start, end = 10 * np.floor((begin - 5) / 10), 10 * np.ceil((last + 30) / 10)
    step = 2  # ms, of the ECG
    window = np.arange(start, end + 1, step)
    fields, scar = _fields(predicted, shown, on_template(heart)), _scar(heart, model)[shown]
    territories = Territories.of(heart, model.sites.places if model is not None else places(heart))
    of_networks = [territories.of_network(heart, network.parameters) for network in networks]
    content: dict[str, Any] = {
        "surfaces": [
            {
                "name": "heart",
                "vertices": _positions(heart.vertices[shown], low, high),
                "triangles": _encoded(triangles.astype("<u4")),
                "index": _encoded(np.arange(len(shown), dtype="<u4")),
                "endocardial": endocardial,
                "scar": _encoded(np.flatnonzero(scar).astype("<u4")),
                "scarred": bool(scar.any()),
            }
        ],
        "box": {"low": low.tolist(), "high": high.tolist()},
        **body_axes(heart),
        "trees": [
            {
                "side": tree.side,
                "nodes": _positions(tree.nodes[nodes], low, high),
                "before": _encoded(before.astype("<i4")),
            }
            for tree, (nodes, before) in zip(trees, drawn.values(), strict=True)
        ],
        "networks": [int(k) + 1 for k in chosen],
        "median": [*chosen].index(first.percentile_networks()["median"]),
        "orders": _orders(predicted, networks, chosen),
        "times": {"low": begin, "high": last, "top": fields[0][0]["high"]},
        "ecg": {"start": float(start), "step": step, "count": len(window), "leads": LEADS},
        "recorded": _recorded(recording, predicted, beats, torsos),
        "scenarios": [
            {
                "name": name,
                "title": scenario_name(name),
                "label": prediction.scenario.description or name,
                "fields": scenario_fields,
                "segments": _segments(territories, prediction, chosen, of_networks),
                "activations": [
                    _bytes(since_first(beat.activation)[shown], 0.0, last) for beat in beats[name]
                ],
                "trees": [[geometry[_key(tree)][0] for tree in beat.trees] for beat in beats[name]],
                "tree_times": [
                    [_bytes(of_tree, begin, last) for of_tree in beat] for beat in times[name]
                ],
                "ecgs": [
                    _microvolts(_ecg(prediction, k, torso, window))
                    for k, torso in zip(chosen, torsos, strict=True)
                ],
                "marks": [
                    marks(prediction.scenario, networks[k].parameters, beat.trees, of_heart.sites)
                    if of_heart is not None and len(networks)
                    else []
                    for k, beat, of_heart in zip(chosen, beats[name], models, strict=True)
                ],
                "first": [
                    where(int(beat.activation.argmin()), model.sites) if model is not None else ""
                    for beat in beats[name]
                ],
            }
            for (name, prediction), scenario_fields in zip(predicted.items(), fields, strict=True)
        ],
    }
    if distinct:
        content["hearts"] = [_positions(vertices[shown], low, high) for vertices in hearts[1:]]
        content["heart"] = [distinct.index(of_heart) for of_heart in models if of_heart is not None]
    return content


def body_axes(heart: Heart) -> dict[str, list[float]]:
    """Unit vectors up, to the front of the torso, and from apex to base, which the views follow."""
    _, back, up = torso_axes(heart.electrodes)
    base = -heart_views(heart)["base"].axes[2]
    return {"up": up.tolist(), "front": (-back).tolist(), "base": base.tolist()}


def boundary(heart: Heart) -> tuple[Integers, Integers, int]:
    """Boundary triangles, endocardial first; vertices they index; number of endocardial ones."""
    labels = labelled_mesh(heart).labels
    inside = np.isin(labels, ENDOCARDIA)
    order = np.argsort(~inside, kind="stable")
    shown, numbered = np.unique(heart.boundary[0][order], return_inverse=True)
    return numbered.reshape(-1, 3), shown, int(inside.sum())


def _scar(heart: Heart, model: ForwardModel | None) -> NDArray[np.bool_]:
    """Mask (n,) of the vertices in tissue that does not conduct."""
    scar = np.zeros(len(heart.vertices), dtype=bool)
    for region in model.conduction.regions if model is not None else ():
        if region.conductivity == 0:
            scar[heart.tetrahedra[region.elements(heart)]] = True
    return scar


def _chosen(first: Predicted, vertices: int, scenarios: int, own_hearts: bool) -> Integers:
    """Networks evenly spread over total activation time, as many as the page has room for."""
    order = np.argsort(first.indices["total_activation_time"], kind="stable")
    nodes = sum(len(tree.nodes) for tree in first.beats[order[0]].trees) // 2
    ecg = 2 * len(LEADS) * 125  # bytes of an ECG of about 250 ms
    size = scenarios * (vertices + nodes + ecg) + 8 * nodes + 6 * vertices * own_hearts
    count = int(np.clip(3_000_000 // size, 3, 40))  # compressed they are little more than half
    spread = order[evenly_spread(len(order), count - 1)]
    return order[np.isin(order, [*spread, first.percentile_networks()["median"]])]


def _orders(
    predicted: Mapping[str, Predicted], networks: Sequence[Network], chosen: Integers
) -> list[dict[str, Any]]:
    """Quantities by which the networks can be ordered: label, unit and values."""
    total = "total activation time"
    orders = [
        (f"{total}, {scenario_name(name)}", "ms", p.indices["total_activation_time"][chosen])
        for name, p in predicted.items()
    ]
    words: dict[str, Sequence[str]] = {}  # names of the values, if a quantity is a choice
    points = [networks[k].parameters for k in chosen] if len(networks) else [{}]
    for name in points[0]:
        if not all(name in point for point in points):
            continue  # a parameter of the tissue of some networks only
        values = np.array([point[name] for point in points], dtype=float)
        if len(np.unique(values)) > 1:
            parameter, label = quantity(name), parameter_name(name)
            orders.append((label, SHOWN_UNITS.get(parameter.unit, parameter.unit), values))
            words[label] = parameter.choices
    return [
        {
            "label": label,
            "unit": unit,
            "values": [float(f"{v:.4g}") for v in values],
            "words": words.get(label, ()),
        }
        for label, unit, values in orders
    ]


def _fields(
    predicted: Mapping[str, Predicted], shown: Integers, note: str
) -> list[list[dict[str, Any]]]:
    """Maps over all networks, of each scenario, with a note in their labels.

    Fields of one name share one scale.

    Times end with the latest of the mean maps and of the median networks, in any scenario: one
    slow network does not stretch the scale.
    """
    fields = [
        [
            {"name": name, "label": label + note, "unit": unit, "kind": kind,
             "values": prediction.maps[name][shown]}
            for name, label, unit, kind in MAPS
        ]
        for prediction in predicted.values()
    ]  # fmt: skip
    slow = [
        since_first(e.beats[e.percentile_networks()["median"]].activation)
        for e in predicted.values()
    ]
    for alike in zip(*fields, strict=True):
        values = [field["values"] for field in alike]
        joined = np.concatenate(values + (slow if alike[0]["kind"] == "time" else []))
        top = float(joined[np.isfinite(joined)].max(initial=0.0)) or 1.0
        for field in alike:
            field.update(low=0.0, high=top, values=_quantised(field["values"], 0.0, top))
    return fields


def _segments(
    territories: Territories,
    predicted: Predicted,
    chosen: Integers,
    of_networks: Sequence[Territories],
) -> dict[str, Any]:
    """Mean activation of the 17 LV segments in the chosen networks, and `MAPS` of the segments.

    Over all networks these are the mean activation of a segment with its 90 % interval, its
    standard deviation, and the mean probability. None where no part of a segment is activated; no
    interval where one of the networks activates none.
    """

    def means(values: Floats, within: Territories = territories) -> Floats:
        return within.segment_means(within.times(values))[1:]

    within = of_networks or [territories] * len(predicted.beats)
    activations = np.array(
        [
            means(since_first(beat.activation), of_network)
            for beat, of_network in zip(predicted.beats, within, strict=True)
        ]
    )
    low, high = np.percentile(activations, (5, 95), axis=0)
    maps = {name: {"values": means(predicted.maps[name])} for name, *_ in MAPS}
    maps["activation_mean"] |= {"low": low, "high": high}
    maps["activation_sd"] = {"values": activations.std(axis=0)}
    per_network = [_numbers(activations[k]) for k in chosen]
    all_ = [{name: _numbers(v) for name, v in statistics.items()} for statistics in maps.values()]
    return {"one": per_network, "all": all_}


def _numbers(values: Floats) -> list[float | None]:
    """Rounded numbers for JSON; None for NaN and infinity."""
    return [round(float(v), 2) if np.isfinite(v) else None for v in values]


def _tree_times(beat: Beat, drawn: Mapping[bytes, Thinned]) -> list[Floats]:
    """Times of the drawn nodes of each tree (ms); NaN where no front arrives."""
    begin = float(beat.activation.min())
    drawn_times = [
        times[drawn[_key(tree)][0]].astype(float)
        for tree, times in zip(beat.trees, beat.coupled.trees, strict=True)
    ]
    return [np.where(np.isfinite(times), times, np.nan) - begin for times in drawn_times]


def _thinned(tree: PurkinjeTree) -> Thinned:
    """Nodes to draw of a tree, ascending, and how many places in the list each follows its parent.

    Drawn are the root (0 places), forks and ends, and every third node between.
    """
    parents, depth = tree.parents, np.zeros(len(tree.parents), dtype=np.int64)
    above = parents.copy()
    while (below := above >= 0).any():
        depth += below
        above = np.where(below, parents[above], -1)
    drawn = (np.bincount(parents[parents >= 0], minlength=len(parents)) != 1) | (depth % 3 == 0)
    above = parents.copy()
    while (passed := (above >= 0) & ~drawn[above]).any():
        above[passed] = parents[above[passed]]
    nodes, number = np.flatnonzero(drawn), np.cumsum(drawn) - 1
    return nodes, number[nodes] - np.where(above >= 0, number[above], number)[nodes]


def _key(tree: PurkinjeTree) -> bytes:
    """Bytes that identify a tree: its nodes and their parents."""
    return tree.nodes.tobytes() + tree.parents.tobytes()


def _in_torso(torso: Floats | None, leads: Floats) -> Floats:
    """Leads (12 + k, t) in the torso that was sampled with a network."""
    return leads if torso is None else torso @ leads


def _ecg(prediction: Predicted, k: int, torso: Floats | None, window: Floats) -> Floats:
    """The twelve leads (12, t) of network `k` (mV) at times from the first activation on (ms)."""
    leads, activation = _in_torso(torso, prediction.filtered(k)), prediction.beats[k].activation
    leads = leads[: len(LEADS)]
    begin = first_sample(activation.astype(float)) - float(activation.min()) - RINGING
    time = begin + np.arange(leads.shape[1])
    return np.array([np.interp(window, time, lead, left=0.0, right=0.0) for lead in leads])


def _recorded(
    recording: TargetComparison | None,
    predicted: Mapping[str, Predicted],
    beats: Mapping[str, Sequence[Beat]],
    torsos: Sequence[Floats | None],
) -> dict[str, Any] | None:
    """The mean recorded beat, and its start (ms) in each network that was fitted to it."""
    if recording is None:
        return None
    scenario = recording.scenario or Scenario()
    name = next((name for name, p in predicted.items() if p.scenario == scenario), None)
    if name is None:
        return None
    target, begins = recording.target, []
    for beat, torso in zip(beats[name], torsos, strict=True):
        sample = recording.align(_in_torso(torso, beat.leads)).shift - target.qrs_samples.start
        begins.append(
            first_sample(beat.activation.astype(float)) + sample - float(beat.activation.min())
        )
    used = np.flatnonzero(target.used[: len(LEADS)])
    return {
        "scenario": name,
        "leads": [LEADS[k] for k in used],
        "values": _microvolts(target.mean[used]),
        "begins": [round(begin, 1) for begin in begins],
    }


def _microvolts(leads: Floats) -> str:
    """Leads (mV) as integers (µV)."""
    return _encoded(np.round(np.clip(1000 * leads, -32_767, 32_767)).astype("<i2"))


def _positions(points: Floats, low: Floats, high: Floats) -> str:
    return _encoded(np.round((points - low) / (high - low) * NONE).astype("<u2"))


def _bytes(values: Floats, low: float, high: float) -> str:
    """Values from `low` to `high` in 254 steps; 255 if not finite."""
    return _quantised(values, low, high, 255)


def _quantised(values: Floats, low: float, high: float, none: int = NONE) -> str:
    """Values from `low` to `high` in steps below `none`, which stands for what is not finite."""
    share = (np.where(np.isfinite(values), values, low) - low) / max(high - low, 1e-9)
    steps = np.round(np.clip(share, 0, 1) * (none - 1))
    coded = np.where(np.isfinite(values), steps, none)
    return _encoded(coded.astype("<u2" if none > 255 else "<u1"))


def _encoded(array: NDArray[Any]) -> str:
    packed = zlib.compress(np.ascontiguousarray(array).tobytes(), 9)
    return base64.b64encode(packed).decode("ascii")
