"""Separate surfaces of endocardia, epicardium and base, joined to one closed labelled surface."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.joining.base import fitted_base, made_base, outline_of
from fascicle.build.joining.parts import OpenSurface, clean_part
from fascicle.build.sides import Surface, check_sides
from fascicle.build.surface_checks import check_edges, oriented_piece, place
from fascicle.core.arrays import Booleans, Floats
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.measures import turned_outwards
from fascicle.mesh.topology import fan

NAMES = ("epicardium", "LV endocardium", "RV endocardium")
LABELS = (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.BASE)
BASE_ZONE = 10.0  # mm from its boundary within which an endocardium may leave the epicardium
# Winding numbers of points that lie clearly outside and inside another part; its opening, closed by
# a fan, leaves them close to 0 or 1.
OUTSIDE, INSIDE = 0.6, 0.4
STAGES = 4


def join_surfaces(
    lv: Surface,
    rv: Surface,
    epicardium: Surface,
    base: Surface | None,
    name: str,
    progress: StageProgress = no_progress,
) -> LabelledSurface:
    """Join separate surfaces of the ventricles to one that is closed.

    Endocardia and epicardium stay as they are. A base whose boundary loops lie within 2.5 mm of
    theirs is fitted to them; without a base, one is spanned between them.

    Parameters
    ----------
    lv, rv, epicardium : pair of (n, 3) and (m, 3) arrays
        Vertices (mm) and triangles; each open at the base, with one boundary loop. Points may be
        repeated and triangles turned either way.
    base : pair of (n, 3) and (m, 3) arrays, optional
        The surface between the loops.
    name : str
        What to call the whole in messages.
    progress : StageProgress
        Called with the steps done and in all.

    Returns
    -------
    LabelledSurface
        Closed, manifold, facing out of the tissue.

    Raises
    ------
    InputError
        If a part has several pieces or the wrong number of boundary loops, the parts do not lie
        within one another as those of a heart do, left and right are swapped, loops are too far
        apart, or the coordinates are not in mm.
    """
    parts = [
        clean_part(*surface, f"{name}: {what}", 1)
        for surface, what in zip((epicardium, lv, rv), NAMES, strict=True)
    ]
    given = None if base is None else clean_part(*base, f"{name}: base", 3)
    progress(1, STAGES)
    _check_places(parts)
    check_sides(name, *((part.vertices, part.triangles) for part in parts))
    progress(2, STAGES)
    parts = [replace(part, what=what) for what, part in zip(NAMES, parts, strict=True)]
    outline = outline_of(parts)
    inner, between = (
        made_base(outline, name) if given is None else fitted_base(outline, given, name)
    )
    progress(3, STAGES)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    number = np.concatenate(
        [
            *(part.loops[0] + start for part, start in zip(parts, starts, strict=False)),
            starts[-1] + np.arange(len(inner)),
        ]
    )
    triangles = [part.triangles + start for part, start in zip(parts, starts, strict=False)]
    triangles.append(number[between])
    vertices = np.vstack([*(part.vertices for part in parts), inner])
    whole = np.vstack(triangles)
    check_edges(name, vertices, whole, closed=True)
    whole = turned_outwards(vertices, oriented_piece(name, vertices, whole))
    labels = np.repeat(LABELS, list(map(len, triangles))).astype(np.int64)
    progress(STAGES, STAGES)
    return LabelledSurface(vertices, whole, labels, name)


def _check_places(parts: list[OpenSurface]) -> None:
    """Refuse endocardia that leave the epicardium, or reach into one another, below the base."""
    epicardium, lv, rv = parts
    for part in (lv, rv):
        outside = _deep(part) & (_winding(epicardium, part.vertices) < OUTSIDE)
        _refuse_if(outside, part, "outside the epicardium")
    _refuse_if(_deep(lv) & (_winding(rv, lv.vertices) > INSIDE), lv, "within the RV endocardium")
    _refuse_if(_deep(rv) & (_winding(lv, rv.vertices) > INSIDE), rv, "within the LV endocardium")


def _refuse_if(bad: Booleans, part: OpenSurface, where: str) -> None:
    if bad.any():
        raise InputError(
            f"{part.what}: {int(bad.sum())} of {len(bad)} vertices lie {where} (first at "
            f"{place(part.vertices[np.argmax(bad)])}); give parts of one heart, in one frame, that "
            "do not cross"
        )


def _deep(part: OpenSurface) -> Booleans:
    """Which vertices are farther from the boundary than the zone where a fan's shape matters."""
    distance, _ = cKDTree(part.vertices[part.loops[0]]).query(part.vertices)
    return np.asarray(distance > BASE_ZONE)


def _winding(part: OpenSurface, points: Floats) -> Floats:
    """Winding number of a part, closed by a fan over its opening, about points; 0 outside it."""
    loop = part.loops[0]
    vertices = np.vstack([part.vertices, part.vertices[loop].mean(axis=0)])
    triangles = np.vstack([part.triangles, fan(loop, len(part.vertices))])
    around = igl.fast_winding_number(vertices, triangles, np.ascontiguousarray(points))
    return np.asarray(np.abs(around))
