"""Ventricular coordinates, by which points of different hearts correspond to each other.

They are the consistent biventricular coordinates (Cobiveco) of Schuler, Pilia, Potyagaylo and Loewe
2021, Med Image Anal 74:102247, which follow from the labels of base, epicardium and endocardia:

- *ventricle* (``tv``): 0 in the left, 1 in the right; each includes half of the septum.
- *transmural* (``tm``): 0 on the epicardium and in the middle of the septum, 1 on the endocardia.
- *rotational* (``rt``): in the free walls from 0 at the posterior to 2/3 at the anterior junction
  of the ventricles, and through the septum from there to 1 at the posterior junction.
- *apicobasal* (``ab``): 0 at the apex, on the junction of the ventricles; 1 at the base.

The last three are relative distances along lines of steepest descent of a harmonic potential, from
where it is 0 to where it is 1. Differences from the paper, which cuts the mesh in two twice:

- The mesh is not cut. The middle of the septum is where a potential that is 1 on the left
  endocardium, −1 on the right one and 0 on the epicardium vanishes; the potential of ``tm`` is then
  its absolute value. The ridges between septum and free walls are the elements that join vertices
  whose lines end in the middle of the septum to vertices whose lines end on the epicardium; so
  ``rt`` is accurate to one element there.
- The lines of ``rt`` descend the potential between the two ridges, and those of ``ab`` the
  potential between apex and base, in place of lines across the other two coordinates.
- Anterior and posterior are told apart by the plane through the middle of the left endocardium
  along the long axis and across the septum; the apex is where it cuts the ridge.

Lengths are integrated upwind, as thickness is by Yezzi and Prince 2003, IEEE Trans Med Imaging
22:1332-1339.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.interpolate import LinearNDInterpolator
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, ArrayCache
from fascicle.core.progress import StageProgress, no_progress
from fascicle.core.ranges import check_kind
from fascicle.heart.fibres import Wall
from fascicle.heart.heart import Heart, VentricularCoordinates
from fascicle.heart.labelled_surface import (
    BASAL,
    ENDOCARDIA,
    Label,
    LabelledMesh,
    labelled_mesh,
    missing_parts,
)
from fascicle.heart.laplace import QuadraticSpace, quadratic_space, solve_laplace
from fascicle.mesh.measures import barycentric_gradients, signed_volumes, triangle_normals, unit
from fascicle.mesh.topology import TETRAHEDRON_FACES, components_of


def ventricular_coordinates(heart: Heart) -> VentricularCoordinates:
    """Ventricular coordinates of a heart's vertices: those it has, or computed (some seconds).

    Computed coordinates are kept in the heart's folder.

    Raises
    ------
    InputError
        If a surface of the heart, its septum or its apex cannot be found.
    """
    check_kind(heart, Heart, "heart", "a heart, as fascicle.load_heart gives")
    if heart.coordinates is not None:
        return heart.coordinates
    if heart.folder is None or not os.access(heart.folder, os.W_OK):
        return computed_coordinates(labelled_mesh(heart))
    cache = ArrayCache(heart.folder / DISPOSABLE, "coordinates")
    if (arrays := cache.read(heart.digest)) is None:
        arrays = computed_coordinates(labelled_mesh(heart)).arrays
        cache.keep(heart.digest, arrays)
    return VentricularCoordinates(*(arrays[name] for name in VentricularCoordinates.names))


def with_coordinates(
    heart: Heart, mesh: LabelledMesh, progress: StageProgress = no_progress
) -> tuple[Heart, tuple[str, ...]]:
    """Return a heart with coordinates, its own or computed on its labelled mesh, and notes.

    A heart whose septum is incomplete, with a hole for example, stays without coordinates.
    """
    if heart.coordinates is not None:
        return heart, ("ventricular coordinates: those of the file; none were computed",)
    try:
        return replace(heart, coordinates=computed_coordinates(mesh, progress)), ()
    except InputError as error:
        return heart, (f"ventricular coordinates: none ({error})",)


def transfer_map(values: Floats, heart: Heart, other: Heart) -> Floats:
    """Transfer values at the vertices of a heart, such as activation times, to another heart.

    Values are interpolated linearly in ventricular coordinates; beyond the outermost vertices, and
    where a value is not finite, that of the nearest vertex is taken.

    Parameters
    ----------
    values : (..., n) array
        Values at the vertices of `heart`.
    heart, other : Heart
        The heart that has the values, and the one to transfer them to.

    Returns
    -------
    (..., k) array
        Values at the vertices of `other`.

    Raises
    ------
    InputError
        If there is not one value a vertex, or the coordinates of a heart cannot be found.
    """
    check_kind(values, np.ndarray, "values", "an array of one value a vertex of the heart")
    for name, argument in (("heart", heart), ("other", other)):
        check_kind(argument, Heart, name, "a heart, as fascicle.load_heart gives")
    if values.dtype.kind not in "biuf" or values.shape[-1:] != (len(heart.vertices),):
        raise InputError(
            f"values are {values.dtype} of shape {values.shape}; give one number for each of the "
            f"{len(heart.vertices)} vertices of '{heart.name}', in the last axis"
        )
    source, destination = ventricular_coordinates(heart), ventricular_coordinates(other)
    transferred = np.empty((*values.shape[:-1], len(destination.ventricle)))
    for side in (Wall.LV, Wall.RV):
        in_source, in_destination = source.ventricle == side, destination.ventricle == side
        places, targets, samples = (
            source.places[in_source],
            destination.places[in_destination],
            values[..., in_source].astype(float),
        )
        nearest = samples[..., cKDTree(places).query(targets)[1]]
        # the base is extended outwards, as the hull of its vertices falls short between them
        edge = source.apicobasal[in_source] > 0.99
        places = np.concatenate([places, places[edge] * (1.1, 1.1, 1)])
        samples = np.moveaxis(np.concatenate([samples, samples[..., edge]], axis=-1), -1, 0)
        # locating a place that is exactly a vertex takes a thousand times as long
        inwards = np.sign(source.wall / 2 - targets[:, 2])
        targets = targets + 1e-6 * np.column_stack([np.ones((len(targets), 2)), inwards])
        interpolated = np.moveaxis(LinearNDInterpolator(places, samples)(targets), 0, -1)
        transferred[..., in_destination] = np.where(
            np.isfinite(interpolated), interpolated, nearest
        )
    return transferred


def computed_coordinates(
    mesh: LabelledMesh, progress: StageProgress = no_progress
) -> VentricularCoordinates:
    """Ventricular coordinates of a mesh's vertices by its labelled surface.

    InputError if the surface lacks a label, or no septum or apex can be found.
    """
    if missing := missing_parts(mesh.labels):
        raise InputError(f"{mesh.name}: no boundary triangle is {', '.join(missing)}; label it")
    progress(0, 4)
    space = quadratic_space(mesh.vertices, mesh.tetrahedra)
    surfaces = (*ENDOCARDIA, Label.EPICARDIUM)
    left, right, outside = (space.on(mesh.having(label)) for label in surfaces)
    base = space.on(mesh.having(*BASAL))
    ventricle = _potential(space, (0.0, left), (1.0, right)) > 0.5
    progress(1, 4)
    across = _potential(space, (1.0, left), (-1.0, right), (0.0, outside))
    transmural, septal = _transmural(mesh, ventricle, across)
    progress(2, 4)
    part = _parts(mesh, space, ventricle, septal)
    anterior, apical = _sides(mesh, part, across)
    corners = part[mesh.tetrahedra]
    ridge = mesh.tetrahedra[corners.min(axis=1) != corners.max(axis=1)]
    mixed = anterior[ridge].any(axis=1) & ~anterior[ridge].all(axis=1)
    mixed &= apical[ridge].all(axis=1)
    on_ridge, at_apex = (np.isin(np.arange(len(part)), cells) for cells in (ridge, ridge[mixed]))
    if not at_apex.any():
        raise InputError(f"{mesh.name}: no apex where the ventricles join; check the labels")
    posterior_nodes, anterior_nodes = (
        _nodes(space, on_ridge & (anterior == side)) for side in (False, True)
    )
    rotation = line_shares(mesh, _potential(space, (0.0, posterior_nodes), (1.0, anterior_nodes)))
    progress(3, 4)
    apicobasal = line_shares(mesh, _potential(space, (0.0, _nodes(space, at_apex)), (1.0, base)))
    progress(4, 4)
    rotational = np.where(part == Wall.SEPTUM, 1 - rotation / 3, 2 / 3 * rotation)
    return VentricularCoordinates(ventricle.astype(float), transmural, rotational, apicobasal)


def _potential(space: QuadraticSpace, *conditions: tuple[float, Integers]) -> Floats:
    """Harmonic function at the vertices (n,) with fixed values on sets of nodes.

    Where sets overlap the first one counts. Quadratic elements overshoot a little; values beyond
    the fixed ones are clipped.
    """
    values = np.full(space.size, np.nan)
    for value, nodes in reversed(conditions):
        values[nodes] = value
    fixed = np.flatnonzero(np.isfinite(values))
    values = values[fixed]
    solved = solve_laplace(space, fixed, values[None])[0]
    return np.asarray(np.clip(solved, values.min(), values.max())[: len(space.vertices)])


def _transmural(mesh: LabelledMesh, ventricle: Booleans, across: Floats) -> tuple[Floats, Booleans]:
    """Transmural coordinate (n,), and mask (n,) of vertices whose line outward ends in the septum.

    The potential `across` (n,) is 1 on the left endocardium, −1 on the right, 0 on the epicardium.
    """
    transmural, septal = np.zeros(len(ventricle)), np.zeros(len(ventricle), dtype=bool)
    for side, potential in ((~ventricle, across), (ventricle, -across)):
        outward, crossing = _lengths(mesh, potential, 0.0)
        inward, _ = _lengths(mesh, -potential, -1.0)
        # lengths are negative on the far side of the middle of the septum
        outward, inward = np.maximum(outward, 0), np.maximum(inward, 0)
        shares = np.where(potential < 1, outward / np.maximum(outward + inward, 1e-12), 1.0)
        transmural[side], septal[side] = shares[side], crossing[side] > 0.5
    return transmural, septal


def line_shares(mesh: LabelledMesh, potential: Floats) -> Floats:
    """Relative position (n,) of each vertex on its line of steepest descent of a potential (n,).

    It is the length from where the potential is 0, over the length from there to where it is 1.
    """
    (from_zero, _), (to_one, _) = _lengths(mesh, potential, 0.0), _lengths(mesh, -potential, -1.0)
    inside = (potential > 0) & (potential < 1) & (from_zero + to_one > 0)
    return np.asarray(
        np.where(inside, from_zero / np.where(inside, from_zero + to_one, 1), potential)
    )


def _lengths(mesh: LabelledMesh, potential: Floats, level: float) -> tuple[Floats, Floats]:
    """Lengths (mm) of lines of steepest descent down to a level (n,), negative beyond it.

    Also returns the share (n,) of each line, which branches at faces, that ends beyond the level.

    A line goes from a vertex through the tetrahedron in which the potential, linear there, falls
    most steeply to the face opposite, and on from the face's corners by their weights.
    """
    vertices, tetrahedra = mesh.vertices, mesh.tetrahedra
    gradients = barycentric_gradients(vertices, tetrahedra)
    down = -unit(np.einsum("mi,mix->mx", potential[tetrahedra], gradients))
    # for each corner: the opposite face, and barycentric weights of the point on it where the line
    # leaves the tetrahedron
    faces = tetrahedra[:, TETRAHEDRON_FACES]
    weights = np.einsum("mix,mx->mi", gradients, down)[:, TETRAHEDRON_FACES].clip(0)
    total = weights.sum(axis=2)
    weights /= np.where(total > 0, total, 1)[..., None]
    end = np.einsum("mik,mikx->mix", weights, vertices[faces])
    length = np.linalg.norm(end - vertices[tetrahedra], axis=2)
    fall = potential[tetrahedra] - np.einsum("mik,mik->mi", weights, potential[faces])
    slope = np.where(total > 0, fall / np.where(length > 0, length, 1), -np.inf).ravel()

    count, corner = len(vertices), tetrahedra.ravel()
    # slopes are rounded, so that rounding errors do not choose among equally steep lines
    order = np.lexsort((slope.round(9), corner))
    steepest = order[np.flatnonzero(np.diff(corner[order], append=count))]
    slope, length = slope[steepest], length.ravel()[steepest]
    ends = (potential <= level) | (slope <= 0)
    weights = weights.reshape(-1, 3)[steepest] * ~ends[:, None]
    beyond = np.minimum(potential - level, 0) / np.where(slope > 0, slope, np.inf)
    right_hand_sides = np.column_stack([np.where(ends, beyond, length), ends & (potential < level)])
    rows = np.arange(0, 3 * count + 1, 3)
    onwards = sparse.csr_matrix((weights.ravel(), faces.reshape(-1, 3)[steepest].ravel(), rows))
    onwards.resize(count, count)
    # in the order of descent the matrix is nearly triangular
    order = np.argsort(potential)
    matrix = (sparse.identity(count) - onwards).tocsr()[order][:, order].tocsc()
    solution = np.empty((count, 2))
    solution[order] = spsolve(matrix, right_hand_sides[order], permc_spec="NATURAL")
    return solution[:, 0], solution[:, 1]


def _parts(
    mesh: LabelledMesh, space: QuadraticSpace, ventricle: Booleans, septal: Booleans
) -> Integers:
    """`Wall` (n,) that each vertex belongs to: septum, or free wall of the LV or the RV.

    Each wall keeps its largest connected piece. Other pieces of the septum become free wall, those
    of the free walls septum.
    """
    part = np.where(septal, Wall.SEPTUM, np.where(ventricle, Wall.RV, Wall.LV))
    joined = space.edges[part[space.edges[:, 0]] == part[space.edges[:, 1]]]
    piece = components_of(joined, len(part))
    size = np.bincount(piece)
    for kind in Wall:
        if not (members := part == kind).any():
            raise InputError(f"{mesh.name}: no septum between two ventricles; check the labels")
        largest = piece[members][np.argmax(size[piece[members]])]
        septal = np.where(members & (piece != largest), ~septal, septal)
    return np.where(septal, Wall.SEPTUM, np.where(ventricle, Wall.RV, Wall.LV))


def _sides(mesh: LabelledMesh, part: Integers, across: Floats) -> tuple[Booleans, Booleans]:
    """Masks (n,) of the anterior vertices, and of those apical to the middle of the LV endocardium.

    The potential `across` (n,) is that of `_transmural`.
    """
    vertices, endocardium = mesh.vertices, mesh.having(Label.LV_ENDOCARDIUM)
    normals = triangle_normals(vertices, endocardium)
    areas = np.linalg.norm(normals, axis=1)
    middle = areas @ vertices[endocardium].mean(axis=1) / areas.sum()
    # the long axis is the direction most nearly orthogonal to the endocardium's normals
    axis = np.linalg.eigh((normals / areas[:, None]).T @ normals)[1][:, 0]
    axis *= np.sign(axis @ (middle - vertices[mesh.having(*BASAL)].mean(axis=(0, 1))))
    septum = mesh.tetrahedra[(part[mesh.tetrahedra] == Wall.SEPTUM).all(axis=1)]
    gradients = np.einsum("mi,mix->mx", across[septum], barycentric_gradients(vertices, septum))
    rightward = -signed_volumes(vertices, septum) @ gradients
    offset = vertices - middle
    return offset @ np.cross(axis, rightward) < 0, offset @ axis > 0


def _nodes(space: QuadraticSpace, vertices: Booleans) -> Integers:
    """Nodes at the vertices of a mask (n,), and at the edges between them."""
    return np.flatnonzero(np.concatenate([vertices, vertices[space.edges].all(axis=1)]))
