"""Trees grown on the surfaces that these tests share, and paths in them."""

import math

import numpy as np

from fascicle.purkinje.growth import GrowthRules, grow_from_parameters

RULES = GrowthRules()
BARE = GrowthRules(generations=0)  # bundle and fascicles only
ANGLES = [(0.9, -0.6), (0.3, -0.3), (math.pi / 2, 0.0), (-0.7, 1.2)]  # rad
LENGTHS = {"lv": (40.3, (12.7, 9.6)), "rv": (45.9, (12.7, 9.6))}  # mm; bundle, fascicles


def grow(surface, bundle=None, fascicles=None, angles=ANGLES[0], rules=RULES):
    """Grow on a surface (endocardium, chart, seed), by default with the lengths above."""
    endocardium, chart, seed = surface
    side, (default_bundle, default_fascicles) = endocardium.side, LENGTHS[endocardium.side]
    fascicles = fascicles if fascicles is not None else default_fascicles
    parameters = {f"{side}_initial_length": bundle if bundle is not None else default_bundle}
    for k, (length, angle) in enumerate(zip(fascicles, angles, strict=True), 1):
        parameters[f"{side}_fascicle_length_{k}"] = length
        parameters[f"{side}_fascicle_angle_{k}"] = angle
    return grow_from_parameters(side, chart, seed, parameters, rules)


def path_to_root(tree, node):
    path = [node]
    while tree.parents[path[-1]] >= 0:
        path.append(int(tree.parents[path[-1]]))
    return path[::-1]


def stretches(tree):
    """Node paths of bundle and fascicles of a tree grown without branches."""
    first, second = (path_to_root(tree, leaf) for leaf in tree.junctions)
    shared = [a for a, b in zip(first, second, strict=False) if a == b]
    return shared, first[len(shared) - 1 :], second[len(shared) - 1 :]


def chord_length(tree, path):
    return np.linalg.norm(np.diff(tree.nodes[path], axis=0), axis=1).sum()


def on_triangles(endocardium, positions):
    """Triangle each position lies on, its barycentric coordinates there, and how far off (mm)."""
    import igl

    triangles = np.ascontiguousarray(endocardium.triangles)
    _, found, _ = igl.point_mesh_squared_distance(positions, endocardium.vertices, triangles)
    corners = endocardium.vertices[triangles[found]]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    offset = (positions - corners[:, 0])[:, :, None]
    last_two = (np.linalg.pinv(edges) @ offset)[:, :, 0]
    weights = np.column_stack([1 - last_two.sum(axis=1), last_two])
    off = np.linalg.norm(np.einsum("nk,nkd->nd", weights, corners) - positions, axis=1)
    return found, weights, off
