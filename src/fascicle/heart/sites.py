"""Places in the ventricles: walls, the 17 segments of the left ventricle, and sites by name.

The segments are those of the American Heart Association (M. D. Cerqueira et al., Circulation 105,
2002): thirds of the long axis from the mitral opening to the end of the cavity, the basal and the
middle one in six sectors of 60°, the apical one in four of 90°; the apex lies beyond the cavity.
Sectors are counted from the middle of the septum (in the standard, from the attachments of the
right ventricle): two of 60° are septal, whatever the septum spans.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.declared import Fraction, Table
from fascicle.core.errors import InputError
from fascicle.core.ranges import did_you_mean, plain_name
from fascicle.heart.coordinates import ventricular_coordinates
from fascicle.heart.endocardium import about_long_axis, long_axis, septal_seeds
from fascicle.heart.fibres import Wall, wall_and_depth, wall_potentials
from fascicle.heart.heart import Heart, VentricularCoordinates
from fascicle.heart.labelled_surface import labelled_mesh
from fascicle.heart.laplace import quadratic_space
from fascicle.mesh.measures import unit
from fascicle.mesh.topology import unique_edges

SEGMENTS = (
    "basal anterior", "basal anteroseptal", "basal inferoseptal",
    "basal inferior", "basal inferolateral", "basal anterolateral",
    "mid anterior", "mid anteroseptal", "mid inferoseptal",
    "mid inferior", "mid inferolateral", "mid anterolateral",
    "apical anterior", "apical septal", "apical inferior", "apical lateral",
    "apex",
)  # fmt: skip
RIGHT, APEX = 0, 17  # segment numbers of the right ventricle's free wall, and of the apex
LAYERS = ("endocardium", "epicardium")


@dataclass(frozen=True)
class Places:
    """Places of tetrahedra (m,) in the ventricles.

    The segment of the left ventricle is 1 to 17, in both halves of the septum too, and 0 in the
    free wall of the right ventricle. Wall and depth are those of `fascicle.heart.fibres.Fibres`.
    The height along the left ventricle's long axis is 0 at the mitral opening, 1 at the end of the
    cavity; the angle about that axis (rad) is 0 in the middle of the septum, positive over the
    anterior wall: seen from the apex, clockwise.
    """

    segment: Integers
    wall: Integers
    depth: Floats
    height: Floats
    angle: Floats


def places(heart: Heart) -> Places:
    """Find the place of each tetrahedron of a heart (seconds, on a fine mesh more).

    An error if a surface of the heart is missing.
    """
    mesh = labelled_mesh(heart)
    potentials, _ = wall_potentials(quadratic_space(mesh.vertices, mesh.tetrahedra), mesh)
    wall, depth = wall_and_depth(potentials)
    middles = heart.vertices[heart.tetrahedra].mean(axis=1)
    height, around, down = about_long_axis(heart.lv.vertices, heart.lv.triangles, middles)
    in_septum = (wall == Wall.SEPTUM) & (height < 1)
    septal = unit(heart.volumes[in_septum] @ unit(around[in_septum]))
    angle = np.arctan2(around @ np.cross(septal, down), around @ septal)
    turn = angle / (2 * np.pi)
    # sixths from the middle of the septum over the anterior wall; the septum is in the middle of
    # the first quarter
    sixth = np.array([2, 1, 6, 5, 4, 3])[np.floor(6 * turn).astype(int) % 6]
    quarter = np.array([14, 13, 16, 15])[np.floor(4 * turn + 0.5).astype(int) % 4]
    third = np.floor(3 * height)
    left = np.select([third < 1, third < 2, third < 3], [sixth, 6 + sixth, quarter], APEX)
    return Places(np.where(wall == Wall.RV, RIGHT, left), wall, depth, height, angle)


class CoordinateSite(Table, table="stimulus.site", once=True):
    """Site by ventricular coordinates, valid in every heart: the vertex nearest to them."""

    ventricle: Annotated[Literal["lv", "rv"], '`"lv"` or `"rv"`; each has its half of the septum']
    apicobasal: Annotated[Fraction, "0 at the apex, 1 at the base"]
    rotational: Annotated[
        Fraction, "0 posterior, 1/3 lateral, 2/3 anterior, 5/6 in the middle of the septum"
    ]
    transmural: Annotated[
        Fraction, "0 on the epicardium, in the septum in its middle; 1 on the endocardium"
    ]

    def vertex(self, coordinates: VentricularCoordinates) -> int:
        """Vertex of a heart that is nearest to the site."""
        right = float(self.ventricle == "rv")
        place_coordinates = (right, self.transmural, self.rotational, self.apicobasal)
        place = VentricularCoordinates(*np.array(place_coordinates)[:, None]).places
        away = np.linalg.norm(coordinates.places - place, axis=1)
        return int(np.argmin(np.where(coordinates.ventricle == right, away, np.inf)))


class Sites:
    """The named sites of a heart."""

    # mm below the left root, on the endocardium
    left: ClassVar = {"left bundle": 5.0, "left septum": 15.0}
    right: ClassVar = ("rv apex", "rv septum", "rv outflow tract", "rv free wall")
    # other names of sites, as `plain_name` gives them
    aliases: ClassVar = {
        "rvot": "rv outflow tract", "rvoutflow": "rv outflow tract",
        "rightventricularapex": "rv apex", "rightseptum": "rv septum", "lbb": "left bundle",
        "leftbundlebranch": "left bundle", "lvseptum": "left septum",
    }  # fmt: skip

    def __init__(self, heart: Heart) -> None:
        self.heart = heart
        self._known: dict[str | CoordinateSite, tuple[float, float, float]] = {}

    @cached_property
    def places(self) -> Places:
        """Places of the heart's tetrahedra, computed on first use."""
        return places(self.heart)

    @cached_property
    def _long_axis(self) -> tuple[Floats, Floats]:
        """Middle of the mitral opening, and the left apex (mm)."""
        return long_axis(self.heart.lv.vertices, self.heart.lv.triangles)

    @cached_property
    def apical(self) -> Floats:
        """From the middle of the mitral opening to the left apex (3,) (mm)."""
        base, apex = self._long_axis
        return np.asarray(apex - base)

    @cached_property
    def anterior(self) -> Floats:
        """Direction (3,) from the posterior wall to the anterior one.

        It is orthogonal to the left ventricle's long axis and to the way to the right ventricle.
        """
        base, _ = self._long_axis
        return unit(np.cross(self.heart.rv.vertices.mean(axis=0) - base, self.apical))

    def position(self, site: str | CoordinateSite) -> tuple[float, float, float]:
        """Position of a site (mm): ventricular coordinates, or a name in any case.

        - ``"mid anterolateral epicardium"``, ``"segment 12 epicardium"``: the middle of a segment
          of the left ventricle (`SEGMENTS`) under one of its `LAYERS`; the epicardium of a septal
          segment is the right side of the septum;
        - ``"rv apex"``, ``"rv septum"``, ``"rv outflow tract"``, ``"rv free wall"``: on the right
          endocardium;
        - ``"left bundle"``: 5 mm below the root of the left network, towards its direction and the
          apex, where even the shortest left bundle passes; and ``"left septum"``, 10 mm further, on
          the left endocardium.

        An error if there is no such site, or the heart has no ventricular coordinates.
        """
        if site not in self._known:
            if isinstance(site, CoordinateSite):
                place = self.heart.vertices[site.vertex(ventricular_coordinates(self.heart))]
            else:
                place = self._find(site)
            x, y, z = map(float, place)
            self._known[site] = x, y, z
        return self._known[site]

    def _find(self, name: str) -> Floats:
        spelling, name = name, re.sub(r"[\s_-]+", " ", name.strip().casefold())
        segment = re.fullmatch(
            rf"(?:segment (\d+)|({'|'.join(SEGMENTS)})) ({'|'.join(LAYERS)})", name
        )
        if segment is not None and (segment[1] is None or 1 <= int(segment[1]) <= len(SEGMENTS)):
            number = int(segment[1]) if segment[1] is not None else 1 + SEGMENTS.index(segment[2])
            return self._in_segment(number, segment[3])
        if name in self.left:
            return self._below_left_root(self.left[name])
        if name in self.right:
            return self._on_the_right(name)
        names = [*self.left, *self.right, *(f"{segment} {LAYERS[0]}" for segment in SEGMENTS)]
        layers = [(plain_name(s), f"{s} {layer}") for s in SEGMENTS for layer in LAYERS]
        hint = did_you_mean(name, names, [*self.aliases.items(), *layers])
        raise InputError(
            f"there is no site '{spelling}'; {f'{hint} Sites' if hint else 'sites'} are "
            f"{', '.join((*self.left, *self.right))}, and segments with a layer, such as "
            f"'{SEGMENTS[11]} {LAYERS[1]}' or 'segment 12 {LAYERS[1]}'; or give ventricular "
            "coordinates"
        )

    def _in_segment(self, number: int, layer: str) -> Floats:
        """The element of a layer that is nearest to the middle of that layer in a segment."""
        heart, place = self.heart, self.places
        if not len(inside := np.flatnonzero(place.segment == number)):
            raise InputError(f"{heart.name}: the {SEGMENTS[number - 1]} segment holds no tissue")
        depth = place.depth[inside] if layer == LAYERS[0] else 1 - place.depth[inside]
        inside = inside[depth <= np.quantile(depth, 0.25)]  # the quarter nearest to the surface
        centres = heart.vertices[heart.tetrahedra[inside]].mean(axis=1)
        middle = np.average(centres, axis=0, weights=heart.volumes[inside])
        return np.asarray(centres[np.argmin(np.linalg.norm(centres - middle, axis=1))])

    def _below_left_root(self, distance: float) -> Floats:
        """Point at a distance (mm) from the root, along edges to direction and then apex."""
        endocardium = self.heart.lv
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
        if along[-1] < distance:
            raise InputError(
                f"the left apex is {along[-1]:.1f} mm from the root of the left network, and the "
                f"site {distance:g} mm; give its position (mm)"
            )
        return np.array([np.interp(distance, along, vertices[path, k]) for k in range(3)])

    def _on_the_right(self, name: str) -> Floats:
        left, right = self.heart.lv, self.heart.rv
        vertices = right.vertices
        if name == "rv apex":
            return long_axis(vertices, right.triangles, self._long_axis)[1]
        if name == "rv septum":
            opposite = left.vertices, right.valves, self._long_axis
            return np.asarray(vertices[septal_seeds(vertices, right.triangles, *opposite)[1]])
        if name == "rv free wall":
            score = cKDTree(left.vertices).query(vertices)[0]
            first, last = 0.4, 0.6  # range of the relative distance from the opening to the apex
        else:
            score = vertices @ self.anterior
            first, last = 0.05, 0.25
        depth, _, _ = about_long_axis(vertices, right.triangles, vertices, self._long_axis)
        allowed = (depth >= first) & (depth <= last)
        if right.valves is not None:
            allowed[right.triangles[right.valves]] = False
        return np.asarray(vertices[np.argmax(np.where(allowed, score, -np.inf))])
