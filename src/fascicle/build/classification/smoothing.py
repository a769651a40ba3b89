"""From a rough division of a closed surface to one whose regions are clean pieces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.build.classification.ambient_occlusion import Patchwork
from fascicle.core.errors import InputError

RIM = 3  # the region that must lie between all others
ROUNDS = 20


def tidy(patchwork: Patchwork, regions: NDArray[np.int64], name: str) -> NDArray[np.int64]:
    """Make each region one piece without pinches, the others apart from one another by the rim.

    Parameters
    ----------
    patchwork : Patchwork
        The closed surface.
    regions : (m,) array
        Region of each triangle, 0 to `RIM`.
    name : str
        What to call the surface in an error.

    Returns
    -------
    (m,) array
        Regions.

    Raises
    ------
    InputError
        If it does not come to rest.
    """
    for _ in range(ROUNDS):
        before = regions
        regions = _without_pinches(patchwork, _in_one_piece(patchwork, _parted(patchwork, regions)))
        if (regions == before).all():
            return regions
    raise InputError(
        f"{name}: no clean borders between endocardia, epicardium and base found; remesh the "
        "surface evenly, or give its parts one by one"
    )


def _parted(patchwork: Patchwork, regions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Give the triangles about vertices at which two regions other than the rim meet to the rim."""
    sides = regions[patchwork.edges[0]]
    meeting = (sides[:, 0] != sides[:, 1]) & (sides < RIM).all(axis=1)
    if not meeting.any():
        return regions
    touched = np.isin(patchwork.triangles, patchwork.edges[1][meeting]).any(axis=1)
    return np.where(touched, RIM, regions)


def _in_one_piece(patchwork: Patchwork, regions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Keep the largest piece of each region; the rest goes to what it is surrounded by."""
    kept = np.full(len(regions), -1)
    for region in range(RIM + 1):
        kept[patchwork.components(regions == region) == 0] = region
    return patchwork.walk(kept, RIM + 1)


def _without_pinches(patchwork: Patchwork, regions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Give all triangles about a vertex at which a region touches itself to one region."""
    sides = regions[patchwork.edges[0]]
    border = patchwork.edges[1][sides[:, 0] != sides[:, 1]]
    changes = np.bincount(border.ravel(), minlength=len(patchwork.vertices))
    corners = patchwork.triangles.ravel()
    present = np.zeros((len(patchwork.vertices), RIM + 1), dtype=bool)
    present[corners, np.repeat(regions, 3)] = True
    # around a vertex k regions change k times (two regions twice), more where one comes back
    kinds = present.sum(axis=1)
    pinched = (changes > kinds) & (changes > 2)
    result = regions.copy()
    for vertex in np.flatnonzero(pinched):
        around = np.flatnonzero((patchwork.triangles == vertex).any(axis=1))
        result[around] = RIM if present[vertex, RIM] else regions[around[0]]
    return result
