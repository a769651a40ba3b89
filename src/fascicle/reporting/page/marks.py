"""Sites of pacing, of block and of first activation in a scenario, for the viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.forward.primitives import His, Stimulus, in_state
from fascicle.forward.scenario import Scenario
from fascicle.heart.fibres import Wall
from fascicle.heart.sites import SEGMENTS, Sites
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.reporting.names import capitals


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
