"""Places of pacing and ectopic sites, by name."""

from __future__ import annotations

import difflib
import re
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import Endocardium, long_axis
from fascicle.heart.fibres.rules import Wall
from fascicle.heart.heart import Heart
from fascicle.heart.seeds import septal_seeds
from fascicle.heart.segments import SEGMENTS, Places, places
from fascicle.mesh.measures import unit
from fascicle.mesh.topology import unique_edges

LAYERS = ("endocardium", "epicardium")
LAYER = 0.25  # of a segment's volume, that which is nearest to the surface
LEFT_BUNDLE, LEFT_SEPTUM = 15.0, 25.0  # mm below the left root, on the endocardium
OUTFLOW = (0.05, 0.25)  # of the way from the right ventricle's opening to its apex
MIDDLE = (0.4, 0.6)  # likewise
RIGHT_SITES = ("rv apex", "rv septum", "rv outflow tract", "rv free wall")
LEFT_SITES = ("left bundle", "left septum")
THICK = 10.0  # mm, of a wall, when distances in coordinates are weighed
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_COORDINATES = re.compile(rf"(lv|rv) height {_NUMBER} angle {_NUMBER} depth {_NUMBER}")
_SEGMENT = re.compile(rf"(?:segment (\d+)|({'|'.join(SEGMENTS)})) ({'|'.join(LAYERS)})")


class Sites:
    """The named sites of a heart.

    Parameters
    ----------
    heart : Heart
    """

    def __init__(self, heart: Heart) -> None:
        self.heart = heart
        self._known: dict[str, tuple[float, float, float]] = {}

    @cached_property
    def places(self) -> Places:
        """Where in the ventricles each element lies, computed when first asked for."""
        return places(self.heart)

    def position(self, name: str) -> tuple[float, float, float]:
        """Position of a named site (mm).

        Parameters
        ----------
        name : str
            - ``"mid anterolateral epicardium"``, ``"segment 12 epicardium"``: the middle of a
              segment of the left ventricle (`SEGMENTS`) under one of its `LAYERS`; the epicardium
              of a septal segment is the right side of the septum;
            - ``"rv apex"``, ``"rv septum"``, ``"rv outflow tract"``, ``"rv free wall"``: on the
              right endocardium;
            - ``"lv height 0.5 angle 120 depth 1"``: coordinates that mean the same in every heart,
              as `Places` has them, the angle in degrees; ``rv`` for the right free wall. They serve
              as universal ventricular coordinates do (J. Bayer et al., Med Image Anal 45, 2018),
              but are measured along and about the left ventricle's long axis;
            - ``"left bundle"``: 15 mm below the root of the left tree, towards its direction and
              the apex, and ``"left septum"``, 10 mm further, on the left endocardium. The bundles
              of all networks with the paper's ranges of lengths pass there.

        Raises
        ------
        InputError
            If there is no such site, or coordinates name none.
        """
        if name not in self._known:
            x, y, z = map(float, self._find(name))
            self._known[name] = x, y, z
        return self._known[name]

    def _find(self, name: str) -> Floats:
        match = _SEGMENT.fullmatch(name)
        if match is not None and (match[1] is None or 1 <= int(match[1]) <= len(SEGMENTS)):
            number = int(match[1]) if match[1] is not None else 1 + SEGMENTS.index(match[2])
            return _in_segment(self.heart, self.places, number, match[3])
        coordinates = _COORDINATES.fullmatch(name)
        if coordinates is not None:
            height, angle, depth = map(float, coordinates.groups()[1:])
            wall = coordinates[1].upper()
            return _at_coordinates(self.heart, self.places, name, wall, height, angle, depth)
        if name in LEFT_SITES:
            way = LEFT_BUNDLE if name == "left bundle" else LEFT_SEPTUM
            return _below_root(self.heart.lv, way)
        if name in RIGHT_SITES:
            return _on_the_right(self.heart, name)
        known = [*LEFT_SITES, *RIGHT_SITES, *(f"{segment} {LAYERS[0]}" for segment in SEGMENTS)]
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise InputError(
            f"there is no site '{name}'; did you mean '{near}'? Sites are "
            f"{', '.join(LEFT_SITES + RIGHT_SITES)}, and segments with a layer, such as "
            f"'{SEGMENTS[11]} {LAYERS[1]}' or 'segment 12 {LAYERS[1]}', or coordinates, such as "
            "'lv height 0.5 angle 120 depth 1'"
        )


def _at_coordinates(
    heart: Heart, found: Places, name: str, wall: str, height: float, angle: float, depth: float
) -> Floats:
    """Middle of the element whose coordinates are nearest, as lengths in this heart."""
    if not (0 <= height <= 1 and 0 <= depth <= 1 and -360 <= angle <= 360):
        raise InputError(
            f"site '{name}': height and depth go from 0 to 1, and the angle from -360 to 360 "
            "degrees"
        )
    inside = np.flatnonzero((found.wall == Wall.RV) == (wall == "RV"))
    centres = heart.vertices[heart.tetrahedra[inside]].mean(axis=1)
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    length = np.linalg.norm(apex - base)
    away = centres - base
    radius = np.linalg.norm(np.cross(away, apex - base), axis=1) / length
    turn = np.angle(np.exp(1j * (found.angle[inside] - np.radians(angle))))
    apart = np.array(
        [
            length * (found.height[inside] - height),
            radius * turn,
            THICK * (found.depth[inside] - depth),
        ]
    )
    return np.asarray(centres[np.argmin((apart**2).sum(axis=0))])


def _in_segment(heart: Heart, found: Places, number: int, layer: str) -> Floats:
    """The element of a layer that is nearest to the middle of that layer in a segment."""
    inside = np.flatnonzero(found.segment == number)
    if not len(inside):
        raise InputError(f"{heart.name}: the {SEGMENTS[number - 1]} segment holds no tissue")
    depth = found.depth[inside] if layer == LAYERS[0] else 1 - found.depth[inside]
    inside = inside[depth <= np.quantile(depth, LAYER)]
    centres = heart.vertices[heart.tetrahedra[inside]].mean(axis=1)
    middle = np.average(centres, axis=0, weights=heart.volumes[inside])
    return np.asarray(centres[np.argmin(np.linalg.norm(centres - middle, axis=1))])


def _below_root(endocardium: Endocardium, way: float) -> Floats:
    """Point so far (mm) from the root over the edges to the direction, and on to the apex."""
    vertices = endocardium.vertices
    a, b = unique_edges(endocardium.triangles)[0].T
    lengths = np.linalg.norm(vertices[a] - vertices[b], axis=1)
    graph = csr_matrix((lengths, (a, b)), shape=(len(vertices),) * 2)
    _, apex = long_axis(vertices, endocardium.triangles)
    last = int(np.argmin(np.linalg.norm(vertices - apex, axis=1)))
    path = [endocardium.root]
    for end in (endocardium.direction, last):
        before = dijkstra(graph, directed=False, indices=path[-1], return_predecessors=True)[1]
        leg = [end]
        while leg[-1] != path[-1]:
            leg.append(int(before[leg[-1]]))
        path += leg[-2::-1]
    steps = np.linalg.norm(np.diff(vertices[path], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    if along[-1] < way:
        raise InputError(
            f"the left apex is {along[-1]:.1f} mm from the root of the left tree, and the site "
            f"{way:g} mm; give its position (mm)"
        )
    return np.array([np.interp(way, along, vertices[path, k]) for k in range(3)])


def _on_the_right(heart: Heart, name: str) -> Floats:
    vertices, triangles = heart.rv.vertices, heart.rv.triangles
    base, apex = long_axis(vertices, triangles)
    if name == "rv apex":
        return apex
    if name == "rv septum":
        own = septal_seeds(vertices, triangles, heart.lv.vertices, heart.rv.valves)
        return np.asarray(vertices[own[1]])
    depth = (vertices - base) @ unit(apex - base) / np.linalg.norm(apex - base)
    if name == "rv free wall":
        score = cKDTree(heart.lv.vertices).query(vertices)[0]
        band = MIDDLE
    else:
        left_base, left_apex = long_axis(heart.lv.vertices, heart.lv.triangles)
        # from the left ventricle to the right one, and down: the anterior wall is across
        score = vertices @ np.cross(vertices.mean(axis=0) - left_base, left_apex - left_base)
        band = OUTFLOW
    allowed = (depth >= band[0]) & (depth <= band[1])
    if heart.rv.valves is not None:
        allowed[triangles[heart.rv.valves]] = False
    return np.asarray(vertices[np.argmax(np.where(allowed, score, -np.inf))])
