"""Growth written down plainly, to check the compiled one against: no hash, no metric, no bounds.

Lengths and distances come from the triangles' corners in space, positions from barycentric
coordinates, the nearest node from all nodes there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np


class LeftError(Exception):
    """A stretch met the base."""


@dataclass
class PlainTree:
    """Nodes in the order of growth."""

    disk: list = field(default_factory=list)
    triangle: list = field(default_factory=list)
    parents: list = field(default_factory=list)
    branch: list = field(default_factory=list)

    def add(self, disk, triangle, parent, branch):
        self.disk.append(disk)
        self.triangle.append(triangle)
        self.parents.append(parent)
        self.branch.append(branch)
        return len(self.disk) - 1


class PlainSurface:
    """A chart's triangles: rates of the barycentric coordinates, Jacobians, edges."""

    def __init__(self, chart):
        corners = chart.points[chart.triangles]
        self.first = corners[:, 0]
        rates = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        self.rates = np.concatenate([-rates.sum(axis=1, keepdims=True), rates], axis=1)
        self.corners = chart.vertices[chart.triangles]
        self.jacobian = np.einsum("mkd,mke->mde", self.corners, self.rates)
        self.triangles = chart.triangles.tolist()
        self.across = {}
        for t, (a, b, c) in enumerate(self.triangles):
            self.across |= {(a, b): t, (b, c): t, (c, a): t}

    def weights(self, point, t):
        return self.rates[t] @ (point - self.first[t]) + np.array([1.0, 0.0, 0.0])

    def position(self, point, t):
        return self.weights(point, t) @ self.corners[t]

    def walk(self, point, t, heading, length):
        """Walk `length` mm; raises where that leads over the base."""
        while True:
            weights, change = self.weights(point, t), self.rates[t] @ heading
            speed = np.linalg.norm(self.jacobian[t] @ heading)
            with np.errstate(divide="ignore", invalid="ignore"):
                until = np.where(change < 0, -np.maximum(weights, 0.0) / change, np.inf)
            k = int(until.argmin())
            if until[k] >= length / speed:
                return point + heading * (length / speed), t
            point = point + heading * until[k]
            length -= until[k] * speed
            edge = self.triangles[t][(k + 2) % 3], self.triangles[t][(k + 1) % 3]
            if edge not in self.across:
                raise LeftError
            t = self.across[edge]


def turned(heading, angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]]) @ heading


def nearest_but(surface, tree, point, t, hidden):
    """Nearest node that is not hidden, and its distance in the triangle's metric (mm)."""
    offset = point - np.array(tree.disk)
    distance = np.linalg.norm(offset @ surface.jacobian[t].T, axis=1)
    distance[list(hidden)] = np.inf
    best = int(distance.argmin())
    return best, distance[best]


def grow_plainly(chart, seed, bundle, fascicles, angles, rules):
    """Grow a tree; returns it and its nodes' positions (mm)."""
    surface, tree = PlainSurface(chart), PlainTree()
    step = rules.branch_length / rules.segments
    tree.add(np.array(seed.point), seed.triangle, -1, 0)

    def lay(node, heading, left, branch):
        while left > 0:
            mm = min(step, left)
            point, t = surface.walk(tree.disk[node], tree.triangle[node], heading, mm)
            node = tree.add(point, t, node, branch)
            left -= mm
        return node

    fork = lay(0, seed.heading, bundle, 0)
    tips = []
    for k, (length, angle) in enumerate(zip(fascicles, angles, strict=True)):
        heading = turned(seed.heading, angle)
        tips.append((lay(fork, heading, length, k + 1), heading))
    label = len(tips) + 1
    for _ in range(rules.generations):
        tips, label = grow_generation(surface, tree, tips, label, step, rules)
    positions = [surface.position(p, t) for p, t in zip(tree.disk, tree.triangle, strict=True)]
    return tree, np.array(positions)


def grow_generation(surface, tree, tips, label, step, rules):
    """One generation; returns the tips that lived, with headings, and the next free label."""
    ends, headings, alive = [], [], []
    for tip, heading in tips:
        for angle in (rules.branch_angle, -rules.branch_angle):
            ends.append(tip)
            headings.append(turned(heading, angle))
            alive.append(True)
    starts = list(ends)
    laid = [[] for _ in ends]  # the nodes of each branch, by segment
    for segment in range(rules.segments):
        for k in range(len(ends)):
            if not alive[k]:
                continue
            own, sister = {starts[k], *laid[k]}, laid[k ^ 1]
            point, t, heading = tree.disk[ends[k]], tree.triangle[ends[k]], headings[k]
            if segment > 0:
                this_round = sister[segment:]
                near, distance = nearest_but(surface, tree, point, t, own | set(this_round))
                heading = heading / np.linalg.norm(surface.jacobian[t] @ heading)
                heading = (
                    heading + rules.numbers["repulsion"] * (point - tree.disk[near]) / distance
                )
            try:
                point, t = surface.walk(point, t, heading, step)
            except LeftError:
                alive[k] = False
                continue
            _, distance = nearest_but(surface, tree, point, t, own | set(sister))
            if distance < rules.clearance * step:
                alive[k] = False
                continue
            ends[k] = tree.add(point, t, ends[k], label + k)
            laid[k].append(ends[k])
            headings[k] = heading
    lived = [(e, h) for e, h, a in zip(ends, headings, alive, strict=True) if a]
    return lived, label + len(ends)
