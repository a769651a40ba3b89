"""Ray travel times from sites: read from the table, traced, and to other sites.

In a uniform box they are geodesics, √(dᵀD⁻¹d); in others none may be shorter than the geodesic.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from builders import (
    OBLIQUE,
    activate,
    box,
    conduction_for,
    face_of,
    heart_vertices,
    line_tree,
    ray_times,
    straight_times,
)

from fascicle.forward.eikonal import myocardium as myocardium_module
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import Myocardium, attach
from fascicle.heart.conduction import Region
from fascicle.kernels.ray_travel_times import POINTS
from fascicle.purkinje.tree import PurkinjeTree

SIZE = np.array([24.0, 20.0, 16.0])  # mm
CELLS = np.array([6, 5, 4])
ALONG, ACROSS = 0.6, 0.25  # mm/ms
TABLE = 2e-6  # ms: the table is in single precision. Measured 1.3e-6
TRACED = 1e-9  # ms
COUNT = 150


def block(cells=CELLS, *, fibre=OBLIQUE, jitter=0.2, scar=None, speeds=(ALONG, ACROSS)):
    """A box whose bottom, z = 0, and side, x = 24, are endocardia; `scar` of centroids is dead."""
    heart = box(SIZE, cells, jitter=jitter, fibre=fibre)
    heart = replace(heart, lv=face_of(heart, 2, 0.0), rv=face_of(heart, 0, SIZE[0]))
    conduction = conduction_for(*speeds)
    if scar is not None:
        dead = scar(heart.vertices[heart.tetrahedra].mean(axis=1))
        heart = replace(heart, regions=dead.astype(np.int64))
        conduction = replace(conduction, regions=(Region(0.0, label=1),))
    return build_myocardium(heart, conduction)


@pytest.fixture(scope="module")
def uniform():
    return block()


def turning(centroids):
    angle = np.deg2rad(120.0) * centroids[:, 2] / SIZE[2]
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])


def anywhere(seed, axis, level, count=COUNT):
    """Random points of a plane through the box."""
    points = np.random.default_rng(seed).uniform(0, SIZE, (count, 3))
    points[:, axis] = level
    return points


def on_endocardia(seed):
    return np.concatenate([anywhere(seed, 2, 0.0), anywhere(seed + 1, 0, SIZE[0])])


def on_epicardium(seed):
    """The top, but for what is within an element of the endocardium."""
    points = anywhere(seed, 2, SIZE[2])
    return points[points[:, 0] < SIZE[0] - 4.0]


def star(leaves):
    nodes = np.vstack([[-9.0, -9.0, -9.0], leaves])
    parents = np.concatenate([[-1], np.zeros(len(leaves), int)])
    return PurkinjeTree("lv", nodes, parents, np.linalg.norm(nodes - nodes[0], axis=1))


def junctions(myocardium, points):
    coupling = attach(myocardium, [star(points)])
    np.testing.assert_allclose(coupling.located.positions, points, atol=1e-12)
    return coupling


def listed(rays):
    """Site, target and time of each ray."""
    return np.repeat(np.arange(len(rays.start) - 1), np.diff(rays.start)), rays.target, rays.time


def exact(myocardium, start, end):
    """√(dᵀD⁻¹d) of pairs of points in a uniform box (ms)."""
    offset = end - start
    return np.sqrt(np.einsum("...i,ij,...j->...", offset, myocardium.mesh.metric[0], offset))


def errors(myocardium, coupling):
    """Travel times less the exact ones (ms) to vertices, and to other sites."""
    at = coupling.located.positions
    for rays, goals in (
        (coupling.sites.to_vertices, myocardium.mesh.vertices),
        (coupling.sites.to_sites, at),
    ):
        site, target, time = listed(rays)
        yield time - exact(myocardium, at[site], goals[target])


class TestInUniformTissue:
    def test_ways_from_the_table_are_exact(self, uniform):
        coupling = junctions(uniform, on_endocardia(0))
        assert (uniform.travel_times.row[coupling.located.triangles] >= 0).all()
        to_vertices, _ = errors(uniform, coupling)
        assert len(to_vertices) > 30 * len(coupling.located.elements)
        assert np.abs(to_vertices).max() < TABLE

    def test_traced_ways_are_exact(self, uniform):
        """From the epicardium and from the inside."""
        coupling = junctions(uniform, on_epicardium(0))
        assert (uniform.travel_times.row[coupling.located.triangles] < 0).all()
        inside = np.random.default_rng(1).uniform(0, SIZE, (COUNT, 3))
        for traced in (coupling, attach(uniform, [], inside)):
            to_vertices, _ = errors(uniform, traced)
            assert len(to_vertices) > 30 * len(traced.located.elements)
            assert np.abs(to_vertices).max() < TRACED

    def test_a_stimulus_has_a_way_to_every_vertex(self, uniform):
        """Even on the endocardium."""
        points = np.concatenate([on_endocardia(2), [SIZE / 2]])
        site, target, _ = listed(attach(uniform, [], points).sites.to_vertices)
        vertices = np.arange(len(uniform.mesh.vertices))
        for k in range(len(points)):
            np.testing.assert_array_equal(np.unique(target[site == k]), vertices)

    def test_ways_between_sites_are_exact_and_the_same_in_both_directions(self, uniform):
        """Junctions and stimuli, some of them in one element, or close by in the next one."""
        points = on_endocardia(3)
        points[1] = points[0] + [1e-3, 1e-3, 0.0]
        points[2:4] = [[8.0 - 1e-4, 7.0, 0.0], [8.0 + 1e-4, 7.0, 0.0]]
        inside = np.random.default_rng(4).uniform(0, SIZE, (20, 3))
        inside[:2] = [[9.0, 9.1, 9.2], [9.0, 9.1, 9.3]]
        coupling = attach(uniform, [star(points)], inside)
        _, between = errors(uniform, coupling)
        assert np.abs(between).max() < TABLE
        site, target, time = listed(coupling.sites.to_sites)
        times = np.full((len(coupling.located.elements),) * 2, np.nan)
        times[site, target] = time
        assert np.isnan(np.diag(times)).all()
        stimulated = np.isfinite(times[len(points) :]).sum(axis=1)
        assert (stimulated == len(times) - 1).all(), "from a stimulus there is a ray to every site"
        both = np.isfinite(times) & np.isfinite(times.T)
        assert both[[0, 2, len(points)], [1, 3, len(points) + 1]].all()
        assert np.abs(times - times.T)[both].max() < 2 * TABLE
        elements = coupling.located.elements
        assert (elements[site] == elements[target]).sum() > 100

    def test_user_trees_on_the_epicardium(self, uniform):
        """Fires what is around as exactly as an endocardial one, and is entered there."""
        tip, other = [8.3, 9.1, SIZE[2]], [13.2, 12.4, SIZE[2]]
        tree = line_tree([tip, [10.0, 10.0, SIZE[2] + 6.0], other], root=1)
        vertices = heart_vertices(uniform)
        fired = activate(uniform, [tree], [0.0], 2.0, speed=[1.0, 1.0, 0.0])
        rays = straight_times(uniform, tip, [tree.lengths[0] / 2.0])
        near = np.linalg.norm(vertices - tip, axis=1) < 8.0
        assert near.sum() > 20
        np.testing.assert_allclose(fired.myocardium[near], rays[near], atol=TRACED, rtol=0)
        entered = activate(uniform, [tree], [np.inf], 2.0, stimuli=[[12.0, 11.0, 3.0]], times=[1.0])
        arrival = straight_times(uniform, [12.0, 11.0, 3.0], [1.0], at=other)[0]
        assert entered.trees[0][2] == pytest.approx(arrival, abs=TRACED)
        assert entered.retrograde[0][1]


@pytest.mark.parametrize("cells", [CELLS, 2 * CELLS], ids=["coarse", "fine"])
def test_how_far_the_table_reaches(cells):
    """To all within reach of a triangle's middle and 50 ms of its six points.

    Reach is 20 mm, but less where there would be more than 150 rays a vertex of the mesh.
    """
    myocardium = block(cells)
    mesh, table = myocardium.mesh, myocardium.travel_times
    assert table.longest == 50.0
    if cells is CELLS:
        assert table.reach == 20.0
    else:
        assert 10.0 < table.reach < 20.0
    ways_within = 0
    for triangle in np.flatnonzero(table.row >= 0):
        row = table.row[triangle]
        corners = mesh.vertices[myocardium.surface[triangle]]
        rays = exact(myocardium, (POINTS @ corners)[:, None], mesh.vertices).max(axis=0)
        near = np.linalg.norm(mesh.vertices - corners.mean(axis=0), axis=1) <= table.reach
        ways_within += near.sum()
        near[mesh.corners[myocardium.owner[triangle]]] = False
        found = np.zeros(len(near), dtype=bool)
        found[table.vertex[table.start[row] : table.start[row + 1]]] = True
        np.testing.assert_array_equal(found, near & (rays <= 50.0))
    assert ways_within < 1.1 * 150 * len(mesh.vertices)


# Largest and mean difference (ms) from the traced time. Measured where fibres turn by 30° in an
# element: 1.95 and 0.046 from the bottom, to which they are parallel, 5.45 and 0.135 from the
# side; where they turn by 15°: 0.52 and 0.019, 1.95 and 0.048
@pytest.mark.parametrize(
    ("cells", "axis", "largest", "mean"),
    [
        (CELLS, 2, 2.2, 0.055),
        (CELLS, 0, 6.0, 0.15),
        (2 * CELLS, 2, 0.6, 0.022),
        (2 * CELLS, 0, 2.2, 0.055),
    ],
)
def test_in_turning_fibres_the_table_is_near_the_traced_ways(cells, axis, largest, mean):
    myocardium = block(cells, fibre=turning)
    coupling = junctions(myocardium, anywhere(7 - axis, axis, 0.0 if axis == 2 else SIZE[0]))
    at, vertices = coupling.located.positions, myocardium.mesh.vertices
    site, target, time = listed(coupling.sites.to_vertices)
    traced = np.concatenate(
        [
            ray_times(myocardium, at[k], coupling.located.elements[k], vertices[target[site == k]])
            for k in range(len(at))
        ]
    )
    assert np.abs(time - traced).max() < largest
    assert np.abs(time - traced).mean() < mean


def test_hardly_anything_is_faster_than_along_the_fibre():
    """Where fibres turn by 30° in an element, interpolation makes one in a hundred so.

    Measured: by 0.05 ms to vertices; traced times to vertices, and times to sites, never.
    """
    myocardium = block(fibre=turning)
    endocardial, epicardial = (
        attach(myocardium, [star(p)]) for p in (on_endocardia(5), on_epicardium(7))
    )
    for coupling, early in ((endocardial, 0.1), (epicardial, TRACED)):
        at = coupling.located.positions
        for rays, goals, earlier in (
            (coupling.sites.to_vertices, myocardium.mesh.vertices, early),
            (coupling.sites.to_sites, at, TRACED),
        ):
            site, target, time = listed(rays)
            ahead = np.linalg.norm(goals[target] - at[site], axis=1) / ALONG - time
            assert ahead.max() < earlier
            assert (ahead > TABLE).mean() < 0.02


class TestAroundScar:
    """A dead pillar, 12 to 16 mm in x and up to 12 mm in y, from bottom to top; isotropic."""

    LOW, HIGH = np.array([12.0, -1.0]), np.array([16.0, 12.0])

    @pytest.fixture(scope="class")
    def pillar(self):
        return block(scar=self.dead, jitter=0.0, speeds=(ALONG, ALONG))

    def dead(self, centroids):
        return ((centroids[:, :2] > self.LOW) & (centroids[:, :2] < self.HIGH)).all(axis=1)

    def clear(self, start, end):
        """Whether straight lines in the x-y plane, (n, 2) to (n, 2), miss the pillar."""
        low, high = self.LOW + 1e-9, self.HIGH - 1e-9
        along = np.where(end == start, 1e-300, end - start)  # parallel to a side: aside or beside
        to_low, to_high = (low - start) / along, (high - start) / along
        enter = np.minimum(to_low, to_high).max(axis=1)
        leave = np.maximum(to_low, to_high).min(axis=1)
        return np.maximum(enter, 0.0) >= np.minimum(leave, 1.0)

    def geodesics(self, start, end):
        """Least travel times around the pillar (ms), past none, one or both of its corners."""
        left, right = np.array([12.0, 12.0]), np.array([16.0, 12.0])
        shortest = np.full(len(start), np.inf)
        for corners in ([], [left], [right], [left, right], [right, left]):
            between = [np.broadcast_to(corner, (len(start), 2)) for corner in corners]
            path = [start[:, :2], *between, end[:, :2]]
            clear = np.all([self.clear(p, q) for p, q in pairwise(path)], axis=0)
            length = np.sum([np.linalg.norm(q - p, axis=1) for p, q in pairwise(path)], axis=0)
            shortest = np.where(clear, np.minimum(shortest, length), shortest)
        return np.hypot(shortest, end[:, 2] - start[:, 2]) / ALONG

    def check(self, coupling, rays, goals, early):
        """No time is shorter than the geodesic's, and many geodesics are longer than the line."""
        site, target, time = listed(rays)
        start, end = coupling.located.positions[site], goals[target]
        shortest = self.geodesics(start, end)
        assert np.isfinite(shortest).all()
        assert (shortest - time).max() < early
        detour = shortest - np.linalg.norm(end - start, axis=1) / ALONG
        assert (detour > 1.0).sum() > 50

    @pytest.mark.parametrize(
        "points", [on_endocardia(10), on_epicardium(9)], ids=["table", "traced"]
    )
    def test_nothing_leads_through_it(self, pillar, points):
        """Traced times are exact. Interpolation between straight ones and others is early.

        Measured: by 0.15 ms, a tenth of a millimetre, to vertices and by 0.10 to sites.
        """
        coupling = attach(pillar, [star(points)])
        np.testing.assert_array_equal(coupling.located.elements < 0, self.dead(points))
        traced = (pillar.travel_times.row[coupling.located.triangles] < 0).all()
        early = TRACED if traced else 0.2
        self.check(coupling, coupling.sites.to_vertices, pillar.mesh.vertices, early)
        self.check(coupling, coupling.sites.to_sites, coupling.located.positions, 0.2)

    def test_no_stimulus_fires_through_it(self, pillar):
        coupling = attach(pillar, [], on_endocardia(11))
        self.check(coupling, coupling.sites.to_vertices, pillar.mesh.vertices, TRACED)
        self.check(coupling, coupling.sites.to_sites, coupling.located.positions, 0.2)

    def test_dead_sites_fire_nothing_and_are_not_fired(self, pillar):
        coupling = attach(pillar, [star(on_endocardia(12))], [[14.0, 5.0, 5.0]])
        dead = np.flatnonzero(coupling.located.elements < 0)
        assert len(dead) > 3
        for rays in (coupling.sites.to_vertices, coupling.sites.to_sites):
            site, _, _ = listed(rays)
            assert not np.isin(dead, site).any()
        _, target, _ = listed(coupling.sites.to_sites)
        assert not np.isin(dead, target).any()

    def test_no_ray_leads_across_a_whole_wall(self):
        """What lies behind is on no list, from the table, traced, or of a stimulus."""
        myocardium = block(scar=lambda c: (c[:, 0] > 12.0) & (c[:, 0] < 16.0), jitter=0.0)
        points = np.concatenate([on_endocardia(13), on_epicardium(14)])
        stimuli = np.random.default_rng(15).uniform(0, SIZE, (20, 3))
        coupling = attach(myocardium, [star(points)], stimuli)
        left = coupling.located.positions[:, 0] < 14.0
        beyond = (myocardium.mesh.vertices[:, 0] > 14.0), ~left
        for rays, behind in zip(
            (coupling.sites.to_vertices, coupling.sites.to_sites), beyond, strict=True
        ):
            site, target, _ = listed(rays)
            assert len(site) > 1000
            np.testing.assert_array_equal(left[site], ~behind[target])


def test_stimuli_of_a_scenario_are_looked_for_once(uniform, monkeypatch):
    """Another network does not trace them again, other points do; the times are the same."""
    looked, traced = [], []
    inside, rays_to_mesh = Myocardium.inside, myocardium_module.rays_to_mesh

    def counted_inside(myocardium, points):
        looked.append(len(points))
        return inside(myocardium, points)

    def counted(located, triangles, myocardium):
        traced.append((len(located.elements), triangles is None))
        return rays_to_mesh(located, triangles, myocardium)

    monkeypatch.setattr(Myocardium, "inside", counted_inside)
    monkeypatch.setattr(myocardium_module, "rays_to_mesh", counted)
    myocardium = replace(uniform, last_stimuli={})
    points = np.array([[3.1, 4.2, 5.3], [10.0, 2.0, 9.0]])
    first = attach(myocardium, [star(on_endocardia(16))], points)
    assert looked == [2]
    assert (2, True) in traced
    traced.clear()
    again = attach(myocardium, [star(on_endocardia(17))], points.copy())
    assert looked == [2]
    assert traced == [(2 * COUNT, False)]
    for coupling in (first, again):
        to_vertices, between = errors(uniform, coupling)
        assert max(np.abs(to_vertices).max(), np.abs(between).max()) < TABLE
        assert len(coupling.located.elements) == 2 * COUNT + 2
    attach(myocardium, [], points + 0.1)
    attach(myocardium, [], points)
    assert looked == [2, 2, 2]
