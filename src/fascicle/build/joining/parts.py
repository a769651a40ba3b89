"""One part of the ventricles' surface, read from anywhere: points welded, one piece, its rims."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from fascicle.core.errors import InputError
from fascicle.heart.validate import check_units
from fascicle.mesh.topology import boundary_loops

SAME_POINT = 1e-3  # mm; points closer than this within a part are one (STL repeats them)
DECAY = 3.0  # a rim's move fades over this many times its size ...
LEAST_FADE = 3.0  # ... or this many mm


@dataclass(frozen=True)
class Part:
    """An open surface that is one manifold piece.

    Attributes
    ----------
    what : str
        What it is, in messages.
    vertices : (n, 3) array
        Positions (mm).
    triangles : (m, 3) array
        Vertex indices, consistently oriented.
    """

    what: str
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    @property
    def rims(self) -> list[NDArray[np.int64]]:
        """Boundary loops, as vertex indices."""
        return boundary_loops(self.triangles)

    def with_split_edges(self, splits: dict[tuple[int, int], NDArray[np.float64]]) -> Part:
        """Insert points into edges of the boundary.

        Parameters
        ----------
        splits : dict of (int, int) to (k, 3) array
            New points for each edge, from its first vertex to its second.

        Returns
        -------
        Part
            The new vertices come last, in the order given.
        """
        if not splits:
            return self
        triangles = [tuple(triangle) for triangle in self.triangles.tolist()]
        at = {frozenset((t[k], t[k - 1])): i for i, t in enumerate(triangles) for k in range(3)}
        points = [self.vertices]
        following = len(self.vertices)
        for (start, end), new in splits.items():
            owner = at[frozenset((start, end))]
            triangle = triangles[owner]
            k = next(k for k in range(3) if {triangle[k], triangle[k - 1]} == {start, end})
            apex, first, last = triangle[k - 2], triangle[k - 1], triangle[k]
            chain = list(range(following, following + len(new)))
            chain = [first, *(chain if first == start else chain[::-1]), last]
            pieces = [(a, b, apex) for a, b in pairwise(chain)]
            triangles[owner] = pieces[0]
            triangles += pieces[1:]
            at[frozenset((last, apex))] = len(triangles) - 1 if len(pieces) > 1 else owner
            points.append(np.reshape(new, (-1, 3)))
            following += len(new)
        return Part(self.what, np.vstack(points), np.array(triangles, dtype=np.int64))

    def with_moved_rims(self, rim: NDArray[np.int64], places: NDArray[np.float64]) -> Part:
        """Move boundary vertices to places (mm); what is near them follows, smoothly less."""
        moves = places - self.vertices[rim]
        farthest = float(np.linalg.norm(moves, axis=1).max())
        if farthest < SAME_POINT:
            return self
        fade = max(LEAST_FADE, DECAY * farthest)
        return Part(self.what, self.vertices + _fading(self, rim, moves, fade), self.triangles)


def clean_part(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], what: str, rims: int
) -> Part:
    """Check units, weld the points of a part, turn its triangles alike, check pieces and rims.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices; points may be repeated, orientations mixed.
    what : str
        What to call the part in messages.
    rims : int
        How many boundary loops it must have.

    Returns
    -------
    Part
        Vertices that are not used are dropped.

    Raises
    ------
    InputError
        If the part is not in mm, or not one manifold piece with that many rims.
    """
    if not len(triangles) or not np.isfinite(vertices).all():
        fault = "no triangles" if not len(triangles) else "coordinates that are not finite"
        raise InputError(f"{what}: the surface has {fault}; export it again")
    check_units(what, vertices[np.unique(triangles)])
    welded = _welded(np.asarray(vertices, dtype=float))[np.asarray(triangles)]
    whole = (welded != np.roll(welded, 1, axis=1)).all(axis=1)
    welded = welded[whole]
    _, once = np.unique(np.sort(welded, axis=1), axis=0, return_index=True)
    used, local = np.unique(welded[np.sort(once)], return_inverse=True)
    points = np.ascontiguousarray(vertices[used], dtype=float)
    triangles = np.ascontiguousarray(local.reshape(-1, 3), dtype=np.int64)
    _check_manifold(points, triangles, what)
    oriented, piece = igl.bfs_orient(triangles)
    part = Part(what, points, np.ascontiguousarray(oriented, dtype=np.int64))
    _check_pieces(part, np.asarray(piece))
    _check_rims(part, rims)
    return part


def point(position: NDArray[np.float64]) -> str:
    """Position as messages give it (mm)."""
    return "(" + ", ".join(f"{x:.0f}" for x in position) + ")"


def _welded(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each vertex the first one in its place."""
    pairs = cKDTree(vertices).query_pairs(SAME_POINT, output_type="ndarray")
    count = len(vertices)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, cluster = connected_components(graph, directed=False)
    _, first = np.unique(cluster, return_index=True)
    return np.asarray(first[cluster], dtype=np.int64)


def _check_manifold(vertices: NDArray[np.float64], triangles: NDArray[np.int64], what: str) -> None:
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    bad = edges[count > 2]
    if len(bad):
        raise InputError(
            f"{what}: {len(bad)} of {len(edges)} edges have more than two triangles (first about "
            f"{point(vertices[bad[0]].mean(axis=0))} mm); repair or remesh the surface"
        )


def _check_pieces(part: Part, piece: NDArray[np.int64]) -> None:
    if piece.max() == 0:
        return
    sizes = np.bincount(piece)
    order = np.argsort(-sizes, kind="stable")
    where = ", ".join(
        f"{sizes[k]} triangles about "
        f"{point(part.vertices[part.triangles[piece == k]].mean(axis=(0, 1)))}"
        for k in order[:3]
    )
    raise InputError(
        f"{part.what}: the surface falls into {len(sizes)} pieces ({where} mm"
        f"{', ...' if len(sizes) > 3 else ''}); keep one"
    )


def _check_rims(part: Part, needed: int) -> None:
    rims = part.rims
    pinched = sum(np.unique(rim).size != rim.size for rim in rims)
    if len(rims) == needed and not pinched:
        return
    rims.sort(key=len, reverse=True)
    where = ", ".join(
        f"{len(rim)} vertices about {point(part.vertices[rim].mean(axis=0))}" for rim in rims[:4]
    )
    count = "1 rim" if len(rims) == 1 else f"{len(rims)} rims"
    found = f"{count} ({where} mm{', ...' if len(rims) > 4 else ''})"
    if not rims:
        found = "no rim (it is closed)"
    elif pinched:
        found += f", {pinched} of which touches itself"
    kind = (
        "it must be open at the base, with one rim"
        if needed == 1
        else "it must have three: one towards the epicardium and one around each cavity"
    )
    raise InputError(f"{part.what}: the surface has {found}; {kind}")


def _fading(
    part: Part, rim: NDArray[np.int64], moves: NDArray[np.float64], fade: float
) -> NDArray[np.float64]:
    """Displacements of all vertices (n, 3): given on a rim, decaying over `fade` (mm) from it."""
    count = len(part.vertices)
    ends = np.asarray(igl.edges(part.triangles)).T
    graph = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(count, count))
    whole = csr_array(graph + graph.T)
    area = np.bincount(
        part.triangles.ravel(),
        np.repeat(igl.doublearea(part.vertices, part.triangles) / 6, 3),
        minlength=count,
    )
    diagonal = np.asarray(whole.sum(axis=1)).ravel() + area / fade**2
    system = csr_array(diags_array(diagonal) - whole)
    free = np.setdiff1d(np.arange(count), rim)
    displacement = np.zeros_like(part.vertices)
    displacement[rim] = moves
    if free.size:
        pull = np.asarray(-(system[free][:, rim] @ moves))
        displacement[free] = splu(csc_array(system[free][:, free])).solve(pull)
    return displacement
