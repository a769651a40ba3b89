"""Scenarios: what each does to the packaged heart, and exact answers where there are any."""

import re
from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK
from builders import activate, box, case, conduction_for, heart_vertices, vertex_at

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.electrocardiogram import build_electrocardiograph, unbounded_gradients
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import SlowConduction, Stimulus
from fascicle.forward.scenario_files import read_scenario
from fascicle.heart.conduction import Conduction, Region
from fascicle.mesh.measures import barycentric_gradients
from fascicle.purkinje.tree_files import write_tree

CV = EXAMPLE_PARAMETERS["cv"]
BOTH = ("lv", "rv")
ALONE = {"delays": {"anterograde": np.inf, "retrograde": np.inf}}  # trees cut off
ONE_WAY = {"delays": {"retrograde": np.inf}}  # trees fire the myocardium, never the other way
LATEST = 5962  # vertex of the packaged heart's base, activated last


@pytest.fixture(scope="module")
def simulate(default_model):
    def call(**options):
        return default_model.simulate(EXAMPLE_PARAMETERS, case(**options))

    return call


@pytest.fixture(scope="module")
def normal(default_model):
    return default_model.simulate(EXAMPLE_PARAMETERS)


@pytest.fixture(scope="module")
def place(default_heart):
    return tuple(default_heart.vertices[LATEST].tolist())


def leads(simulation):
    return simulation.ecg.to_numpy()


def along_path(tree, values):
    """Sum of the values of the segments from the root to each node."""
    total = np.zeros(len(tree.nodes))
    for node in range(len(tree.nodes)):  # parents come first in trees that were grown
        if tree.parents[node] >= 0:
            total[node] = total[tree.parents[node]] + values[node]
    return total


class TestStimuli:
    def test_of_the_myocardium_alone(self, simulate, default_heart, default_model, place):
        """Without the trees the front spreads from the site, nowhere faster than along fibres."""
        paced = simulate(stimuli=(Stimulus(0.0, place),), inactive=BOTH, **ALONE)
        assert paced.activation[LATEST] == 0
        assert (np.delete(paced.activation, LATEST) > 0).all()
        distance = np.linalg.norm(default_heart.vertices - place, axis=1)
        assert (paced.activation >= distance / max(default_model.conduction.speeds) - 1e-9).all()
        a, b = default_heart.edges.T
        earliest = np.full(len(distance), np.inf)
        np.minimum.at(earliest, a, paced.activation[b])
        np.minimum.at(earliest, b, paced.activation[a])
        assert (np.delete(earliest < paced.activation, LATEST)).all(), "no other focus"
        number = sum(len(tree.junctions) for tree in paced.trees)
        assert (paced.coupled.origin == number).all()
        assert paced.coupled.captured.tolist() == [True]

    def test_trees_carry_its_front_and_are_the_origin_there(self, simulate, place):
        alone = simulate(stimuli=(Stimulus(0.0, place),), inactive=BOTH, **ALONE)
        paced = simulate(stimuli=(Stimulus(0.0, place),), inactive=BOTH)
        assert (paced.activation <= alone.activation + 1e-9).all()
        assert paced.total_activation_time < 0.85 * alone.total_activation_time
        number = sum(len(tree.junctions) for tree in paced.trees)
        by_stimulus = paced.coupled.origin == number
        pairs = zip(paced.coupled.trees, paced.trees, strict=True)
        junction_times = np.concatenate([times[tree.junctions] for times, tree in pairs])
        assert by_stimulus[LATEST]
        assert 0.02 < by_stimulus.mean() < 0.95
        fired_by = paced.coupled.origin[~by_stimulus]
        assert (junction_times[fired_by] <= paced.activation[~by_stimulus] + 1e-9).all()
        retrograde = np.concatenate(paced.coupled.retrograde)
        # whichever tree is entered first, the stimulus or a junction fired before did it
        entered_by = np.concatenate(paced.coupled.entered_by)
        assert (entered_by[retrograde] >= 0).all()
        first = np.argmin(junction_times)
        assert entered_by[first] == number

    def test_at_a_leaf_runs_back_through_the_tree(self, simulate, normal):
        """From the leaf to the root and on to every node, each segment at cv."""
        tree = normal.trees[0]
        leaf = tree.junctions[100]
        fired = simulate(
            stimuli=(Stimulus(5.0, tuple(tree.nodes[leaf]), "lv"),), inactive=BOTH, **ONE_WAY
        )
        times, depth = fired.coupled.trees[0], along_path(tree, tree.lengths)
        path = [leaf]
        while tree.parents[path[-1]] >= 0:
            path.append(tree.parents[path[-1]])
        np.testing.assert_allclose(times[path], 5.0 + (depth[leaf] - depth[path]) / CV, atol=1e-9)
        assert times[tree.root] == pytest.approx(5.0 + depth[leaf] / CV)
        assert np.isfinite(times).all()
        assert np.isinf(fired.coupled.trees[1]).all(), "the silent right tree is not entered"

    def test_before_zero_moves_the_time_axis(self, simulate, place):
        """40.5 ms earlier: the same ECG on an axis that starts at −41 ms."""
        at_zero, early, whole = (
            simulate(stimuli=(Stimulus(t, place),), inactive=BOTH) for t in (0.0, -40.5, -40.0)
        )
        np.testing.assert_allclose(early.activation, at_zero.activation - 40.5, atol=1e-9)
        assert early.ecg.time.to_numpy()[0] == -41.0
        assert at_zero.ecg.time.to_numpy()[0] == 0.0
        assert whole.ecg.time.to_numpy()[0] == -40.0
        np.testing.assert_allclose(leads(whole), leads(at_zero), rtol=0, atol=1e-9)
        assert whole.qrs_duration == at_zero.qrs_duration

    def test_of_a_tree_that_fires_before_zero_pre_excites(self, simulate, normal):
        """A His-side stimulus of both trees at −30 ms is the normal beat 30 ms earlier."""
        roots = [
            Stimulus(float(times[tree.root]) - 30.0, tuple(tree.nodes[tree.root]), tree.side)
            for tree, times in zip(normal.trees, normal.coupled.trees, strict=True)
        ]
        early = simulate(stimuli=tuple(roots))
        np.testing.assert_allclose(early.activation, normal.activation - 30.0, atol=1e-9)
        assert early.ecg.time.to_numpy()[0] == 0.0, "the trees fire earlier, the myocardium not"
        np.testing.assert_allclose(leads(early), leads(normal)[:, 30:], rtol=0, atol=1e-9)


class TestSlowConduction:
    def test_blocked_left_bundle_is_left_bundle_branch_block(self, simulate, normal):
        """The left tree is entered from the septum, its root reached by nothing but itself."""
        block = simulate(slow=(SlowConduction("lv", 0.0, "bundle"),))
        assert block.total_activation_time > normal.total_activation_time + 25
        assert block.qrs_duration >= 120
        tree, times = block.trees[0], block.coupled.trees[0]
        first = np.argsort(times[tree.junctions])[:5]
        assert block.coupled.retrograde[0][first[0]]
        assert times[tree.junctions].min() > normal.coupled.trees[0][tree.junctions].max()
        assert block.coupled.retrograde[0].mean() > 0.3
        bundle = np.flatnonzero(tree.parts["bundle"])
        assert times[tree.root] == 0
        assert np.isinf(times[bundle[1:-1]]).all()
        assert np.isfinite(np.delete(times, bundle)).all()
        assert (block.coupled.entered_by[0] >= len(tree.junctions)).any(), "from the right"
        assert np.isfinite(block.activation).all()

    @pytest.mark.parametrize("factor", [0.1, 2.0])
    def test_slow_fascicle_delays_its_own_nodes_exactly(self, simulate, factor):
        """By length/cv·(1/f − 1) of what lies in it; every other node keeps its time."""
        before = simulate(**ONE_WAY)
        slow = simulate(slow=(SlowConduction("rv", factor, "fascicle 2"),), **ONE_WAY)
        tree = before.trees[1]
        inside = along_path(tree, np.where(tree.parts["fascicle 2"], tree.lengths, 0.0))
        delay = slow.coupled.trees[1] - before.coupled.trees[1]
        np.testing.assert_allclose(delay, inside / CV * (1 / factor - 1), atol=1e-9)
        assert inside.max() == pytest.approx(EXAMPLE_PARAMETERS["rv_fascicle_length_2"])
        assert (delay == 0).mean() > 0.2
        np.testing.assert_array_equal(slow.coupled.trees[0], before.coupled.trees[0])

    def test_factors_multiply_where_slowings_overlap(self, simulate, normal):
        tree = normal.trees[0]
        centre = tuple(tree.nodes[tree.parts["bundle"]][20])
        sphere = {"centre": centre, "radius": 6.0}
        both = simulate(
            slow=(SlowConduction("lv", 0.5), SlowConduction("lv", 0.2, **sphere)), **ONE_WAY
        )
        factor = np.where(np.linalg.norm(tree.nodes - centre, axis=1) <= 6.0, 0.1, 0.5)
        assert 5 < (factor == 0.1).sum() < 100
        expected = along_path(tree, tree.lengths / (CV * factor))
        np.testing.assert_allclose(both.coupled.trees[0], expected, atol=1e-9)

    def test_part_and_sphere_are_both_needed(self, normal, default_model):
        tree = normal.trees[0]

        def slowed(*where):
            slow = case(slow=[SlowConduction("lv", 0.0, *where)])
            beat = slow.excitation(normal.trees, 0.0, {}, default_model.sites)
            return beat.speed[: len(tree.nodes)] == 0

        centre = tuple(tree.nodes[np.flatnonzero(tree.parts["fascicle 1"])[0]])
        chosen = slowed("fascicle 1", centre, 3.0)
        ball = slowed(None, centre, 3.0)
        np.testing.assert_array_equal(chosen, ball & tree.parts["fascicle 1"])
        assert 0 < chosen.sum() < ball.sum()
        assert slowed().sum() == len(tree.nodes) - 1

    @pytest.mark.parametrize("fascicles", [2, 3])
    def test_anterior_and_posterior_fascicles_lead_there(self, default_model, fascicles):
        """As the angle of the nearest tissue about the long axis says, not by their numbers."""
        third = {"lv_fascicle_length_3": 20.0, "lv_fascicle_angle_3": 0.2} if fascicles == 3 else {}
        turned = {"lv_fascicle_angle_1": -0.6, "lv_fascicle_angle_2": 0.9}
        heart, found = default_model.heart, default_model.sites.places
        centres = heart.vertices[heart.tetrahedra].mean(axis=1)
        for angles in (turned, dict(zip(turned, reversed(turned.values()), strict=True))):
            tree, _ = default_model.grow(EXAMPLE_PARAMETERS | third | angles)
            beat = case().excitation([tree], [0.0], {}, default_model.sites)
            around = {}
            for name in ("anterior fascicle", "posterior fascicle"):
                end = tree.nodes[np.flatnonzero(beat.part(0, name))[-1]]
                around[name] = np.sin(found.angle[np.linalg.norm(centres - end, axis=1).argmin()])
            assert around["anterior fascicle"] > 0.2 + around["posterior fascicle"]


class TestDelays:
    def test_trees_that_cannot_fire_leave_it_all_to_the_stimulus(self, simulate, place):
        paced = simulate(stimuli=(Stimulus(0.0, place),), delays={"anterograde": np.inf})
        alone = simulate(stimuli=(Stimulus(0.0, place),), inactive=BOTH, **ALONE)
        np.testing.assert_array_equal(paced.activation, alone.activation)


class TestExtraTrees:
    def test_fires_as_one_of_the_heart(self, default_model, normal):
        """The left tree under another name, alone, is the left tree alone."""
        left = normal.trees[0]
        mine = replace(left, side="mine")
        extra = default_model.simulate(
            EXAMPLE_PARAMETERS, case(trees=((mine, 12.0),), inactive=BOTH, **ONE_WAY)
        )
        alone = default_model.activate([left], [12.0], CV, case(**ONE_WAY))
        np.testing.assert_array_equal(extra.activation, alone.activation)
        assert [tree.side for tree in extra.trees] == ["lv", "rv", "mine"]
        assert extra.coupled.trees[2][left.root] == 12.0
        first = sum(len(tree.junctions) for tree in normal.trees)
        assert extra.coupled.origin.min() >= first

    def test_can_be_slowed_silenced_and_stimulated_by_name(self, default_model, normal):
        left = normal.trees[0]
        mine = replace(left, side="mine")
        scenario = case(
            trees=((mine, 0.0),),
            inactive=(*BOTH, "mine"),
            slow=(SlowConduction("mine", 0.5),),
            stimuli=(Stimulus(3.0, tuple(left.nodes[left.root]), "mine"),),
            **ONE_WAY,
        )
        times = default_model.simulate(EXAMPLE_PARAMETERS, scenario).coupled.trees
        np.testing.assert_allclose(
            times[2], 3.0 + along_path(left, left.lengths) / (0.5 * CV), atol=1e-9
        )
        assert np.isinf(times[0]).all()

    @pytest.mark.parametrize("off", [0.0, 300.0])
    def test_a_fork_given_as_the_root_fires_there(self, default_model, normal, tmp_path, off):
        """Or the node that is told where the place given is too far from any."""
        left = normal.trees[0]
        write_tree(tmp_path / "mine.vtu", left, normal.coupled.trees[0])
        given = left.nodes[np.argmax(np.bincount(left.parents[1:]) > 1)] + [0.0, 0.0, off]

        def read(root):
            silent = "[[inactive_root]]\ntree = 'lv'\n[[inactive_root]]\ntree = 'rv'\n"
            (tmp_path / "case.toml").write_text(
                f"{silent}[[tree]]\nname = 'mine'\nfile = 'mine.vtu'\ntime = 3\nroot = {root}\n"
                "[delay]\nretrograde = inf\n"
            )
            return read_scenario(tmp_path / "case.toml")[0]

        if off:
            with pytest.raises(InputError, match="give the place of a node") as refused:
                read(given.tolist())
            given = [float(x) for x in re.findall(r"-?\d+\.\d{4}", str(refused.value))[3:]]
        simulation = default_model.simulate(EXAMPLE_PARAMETERS, read(list(map(float, given))))
        tree, times = simulation.trees[2], simulation.coupled.trees[2]
        assert np.linalg.norm(tree.nodes[tree.root] - given) < 1e-4
        if not off:
            assert (tree.parents == tree.root).sum() == 3  # the bundle and two fascicles
        assert times[tree.root] == 3.0 == times.min()
        child = tree.parents >= 0
        steps = times[child] - times[tree.parents[child]]
        np.testing.assert_allclose(steps, tree.lengths[child] / CV, atol=1e-9)

    def test_two_of_one_name_are_refused(self, simulate, normal):
        with pytest.raises(InputError, match="two trees are named 'lv'"):
            simulate(trees=((normal.trees[0], 0.0),))


def sphere(place, conductivity, radius=15.0):
    return Region(conductivity, centre=place, radius=radius)


class TestScar:
    @pytest.fixture(scope="class")
    def normal(self, small_model):
        return small_model.simulate(NETWORK)

    @pytest.fixture(scope="class")
    def place(self, normal):
        """Where the left tree meets the wall."""
        tree = normal.trees[0]
        return tuple(tree.nodes[tree.junctions[60]].tolist())

    @pytest.fixture(scope="class")
    def scarred(self, small_heart, place):
        return ForwardModel(small_heart, Conduction(regions=(sphere(place, 0.0),)))

    @pytest.fixture(scope="class")
    def simulation(self, scarred):
        return scarred.simulate(NETWORK)

    @pytest.fixture(scope="class")
    def scar(self, small_heart, place):
        centroids = small_heart.vertices[small_heart.tetrahedra].mean(axis=1)
        return np.linalg.norm(centroids - place, axis=1) <= 15.0

    def test_inside_is_never_reached(self, simulation, small_heart, scar):
        """Exactly the vertices that belong to no conducting element are left out."""
        conducting = np.zeros(len(small_heart.vertices), dtype=bool)
        conducting[small_heart.tetrahedra[~scar]] = True
        np.testing.assert_array_equal(simulation.unreached, ~conducting)
        assert simulation.unreached.sum() > 20
        assert (simulation.coupled.origin[~conducting] == -1).all()
        assert (simulation.coupled.origin[conducting] >= 0).all()
        assert np.isfinite(simulation.total_activation_time)

    def test_reported_volume_lies_inside_the_scar(self, simulation, small_heart, scar):
        from fascicle.forward.simulation_files import unreached_volume

        volume = unreached_volume(small_heart, simulation)
        whole = small_heart.volumes[scar].sum() / 1000
        assert 0.5 * whole < volume <= whole

    def test_ecg_is_that_of_the_rest(self, simulation, normal, small_heart, scarred, scar):
        """The same as if the elements of the scar were not there at all."""
        heart, conduction = small_heart, scarred.conduction
        rest, fibres = heart.tetrahedra[~scar], heart.fibres[~scar]
        barycentric = barycentric_gradients(heart.vertices, rest)
        electrocardiograph = build_electrocardiograph(
            rest,
            barycentric,
            heart.volumes[~scar],
            conduction.intracellular(fibres),
            unbounded_gradients(heart.vertices, rest, heart.electrodes, conduction.torso),
            scarred.action_potential,
        )
        expected = electrocardiograph.leads(simulation.activation)
        np.testing.assert_allclose(leads(simulation), expected, rtol=0, atol=1e-12)
        assert np.isfinite(leads(simulation)).all()
        n = min(leads(simulation).shape[1], leads(normal).shape[1])
        assert np.abs(leads(simulation)[:, :n] - leads(normal)[:, :n]).max() > 0.02  # mV

    def test_whole_wall_isolates_what_lies_behind(self, small_heart):
        """All elements that a plane cuts: no front crosses it, except through the trees."""
        z = small_heart.vertices[:, 2]
        level = -30.01
        ends = z[small_heart.tetrahedra]
        cut = (ends.min(axis=1) <= level) & (ends.max(axis=1) >= level)
        heart = replace(small_heart, regions=cut.astype(np.int64))
        model = ForwardModel(heart, Conduction(regions=(Region(0.0, label=1),)))
        start = int(np.argmin(z))
        stimulus = Stimulus(0.0, tuple(heart.vertices[start]))
        isolated = model.simulate(NETWORK, case((stimulus,), inactive=BOTH, **ALONE))
        assert isolated.unreached[z > level].all()
        assert (~isolated.unreached[z < level]).mean() > 0.5
        assert np.isfinite(isolated.total_activation_time)
        assert np.isfinite(leads(isolated)).all()
        bridged = model.simulate(NETWORK, case((stimulus,), inactive=BOTH))
        assert (~bridged.unreached[z > level]).mean() > 0.5


class TestScaledConductivity:
    def test_whole_box_changes_speeds_by_the_root(self):
        """Factor 4: times are exactly halved; the stimulus lies in no special place."""
        heart = replace(box(20.0, 6, jitter=0.2), regions=np.full(6**3 * 6, 7))
        conduction = conduction_for(0.6, 0.3)
        start = {"stimuli": [[3.1, 4.2, 5.3]], "times": [0.0]}
        plain = activate(build_myocardium(heart, conduction), [], [], 1.0, **start).myocardium
        for factor in (4.0, 0.09):
            scaled = replace(conduction, regions=(Region(factor, label=7),))
            times = activate(build_myocardium(heart, scaled), [], [], 1.0, **start).myocardium
            np.testing.assert_allclose(times, plain / np.sqrt(factor), rtol=1e-9)

    def test_two_layers_along_the_axis(self):
        """20 mm at 0.6 mm/ms, then 20 mm at 0.3: straight ahead it takes 33.3 + 66.7 ms."""
        bar = box((40.0, 8.0, 8.0), (20, 4, 4))
        second = bar.vertices[bar.tetrahedra].mean(axis=1)[:, 0] > 20.0
        heart = replace(bar, regions=second.astype(np.int64))
        conduction = replace(conduction_for(0.6, 0.6), regions=(Region(0.25, label=1),))
        myocardium = build_myocardium(heart, conduction)
        solved = activate(myocardium, [], [], 1.0, stimuli=[[0.0, 4.0, 4.0]], times=[0.0])
        vertices = heart_vertices(myocardium)
        for x, expected in ((20.0, 20 / 0.6), (30.0, 20 / 0.6 + 10 / 0.3), (40.0, 100.0)):
            at = vertex_at(vertices, np.array([x, 4.0, 4.0]))
            assert solved.myocardium[at] == pytest.approx(expected, rel=1e-9)

    def test_intracellular_conductivity_scales_too(self, small_heart, small_model):
        """Amplitudes grow by k and times shrink by √k: a source stronger, and sooner over."""
        place = tuple(small_heart.vertices[168].tolist())
        whole = ForwardModel(small_heart, Conduction(regions=(sphere(place, 4.0, 1e3),)))
        plain = small_model.electrocardiograph
        np.testing.assert_array_equal(whole.electrocardiograph.corners, plain.corners)
        np.testing.assert_allclose(
            whole.electrocardiograph.weights, 4 * plain.weights, rtol=1e-12, atol=1e-18
        )
        scenario = case((Stimulus(0.0, place),), inactive=BOTH, **ALONE)
        one, other = (m.simulate(NETWORK, scenario) for m in (small_model, whole))
        np.testing.assert_allclose(other.activation, one.activation / 2, rtol=1e-9)

    def test_last_of_overlapping_regions_counts(self, small_heart):
        place = tuple(small_heart.vertices[168].tolist())
        large, small = sphere(place, 0.5, 20.0), sphere(place, 2.0, 8.0)
        outer, inner = large.elements(small_heart), small.elements(small_heart)
        scale = Conduction(regions=(large, small)).scale(small_heart)
        np.testing.assert_array_equal(scale, np.where(inner, 2.0, np.where(outer, 0.5, 1.0)))
        swapped = Conduction(regions=(small, large)).scale(small_heart)
        np.testing.assert_array_equal(swapped, np.where(outer, 0.5, 1.0))
        assert 0 < inner.sum() < outer.sum() < len(outer)


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"inactive": ("septum",)}, "no tree 'septum'; known: lv, rv"),
            (
                {"slow": (SlowConduction("lv", 0.0, "fascicle 9"),)},
                "lv tree has no part 'fascicle 9'; known: bundle, fascicle 1, fascicle 2",
            ),
            (
                {"slow": (SlowConduction("lv", 0.0, None, (0.0, 0.0, 400.0), 3.0),)},
                r"no segment ends in the sphere at \(0.0, 0.0, 400.0\); the nearest ends \d{3}\.\d",
            ),
            (
                {"stimuli": (Stimulus(0.0, (0.0, 0.0, 400.0)),)},
                r"stimulus at \(0, 0, 400\): 3\d\d\.\d mm from the tissue",
            ),
            (
                {"stimuli": (Stimulus(0.0, (0.0, 0.0, 400.0), "rv"),)},
                r"nearest node of the rv tree is 3\d\d\.\d mm away",
            ),
        ],
    )
    def test_what_does_not_fit_the_heart(self, simulate, options, message):
        with pytest.raises(InputError, match=message):
            simulate(**options)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"time": 0.0}, "give either a position or a site, not none"),
            ({"time": 0.0, "position": (0, 0, 0), "site": "rv apex"}, "or a site, not both"),
            ({"time": 0.0, "site": "rv apex", "part": "bundle"}, "part 'bundle' is given without"),
        ],
    )
    def test_what_no_stimulus_is(self, options, message):
        with pytest.raises(InputError, match=message):
            Stimulus(**options)

    def test_sphere_off_its_part_tells_the_distance_to_that_part(self, simulate, normal):
        """Not to a node of another part that lies in the sphere."""
        tree = normal.trees[0]
        centre = tuple(tree.nodes[tree.root].tolist())
        nearest = np.linalg.norm(tree.nodes[tree.parts["fascicle 2"]] - centre, axis=1).min()
        with pytest.raises(InputError, match=f"of its fascicle 2 .* nearest ends {nearest:.1f} mm"):
            simulate(slow=(SlowConduction("lv", 0.0, "fascicle 2", centre, 3.0),))

    @pytest.mark.parametrize(
        ("region", "message"),
        [
            (Region(0.0, centre=(0, 0, 0)), "give either a label, or a centre and a radius"),
            (Region(0.0, 1, centre=(0, 0, 0)), "give either a label, or a centre and a radius"),
            (Region(0.5, 3), "region 3 holds no element; the heart's labels are 0, 1"),
            (
                Region(0.5, centre=(0.0, 0.0, 300.0), radius=5.0),
                r"region at \(0.0, 0.0, 300.0\) holds no element; the nearest is 2\d\d\.\d mm",
            ),
        ],
    )
    def test_regions(self, region, message):
        bar = box((4.0, 2.0, 2.0), (4, 2, 2))
        heart = replace(bar, regions=(np.arange(len(bar.tetrahedra)) % 2))
        with pytest.raises(InputError, match=message):
            Conduction(regions=(region,)).scale(heart)
