"""Networks on a device are those of the processor: trees to the last bit, times and ECGs closely.

Times may differ by what is not worth passing on, 1e-10 ms, along a path: by 2e-10 ms in these
networks. The ECG's histogram is summed in another order, whose rounding the running sums amplify
to 1e-6 of an element's contribution at most: by 2e-10 mV in these networks.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import box, conduction_for, face_of, straight_times, vertex_at
from emulated import Emulated, drawn

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS, HUMAN_SPACE, Infeasible
from fascicle.forward.beat import Beat
from fascicle.forward.device.backend import GpuBackend
from fascicle.forward.device.batch import Simulator
from fascicle.forward.eikonal.myocardium import attach
from fascicle.forward.model import ForwardModel
from fascicle.heart.conduction import Conduction, Region

MS, MV = 1e-7, 1e-7
EDGE, ACROSS = 2.0, 0.3  # of the block (mm) and its slower speed (mm/ms)


def on(device, networks=3):
    return GpuBackend.on(device, networks)


def assert_same(found, expected):
    """Of one network."""
    assert isinstance(found, Beat)
    for one, other in zip(found.trees, expected.trees, strict=True):
        assert one.side == other.side
        for name in ("nodes", "parents", "lengths", "labels"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_allclose(found.activation, expected.activation, rtol=0, atol=MS)
    assert found.onset == expected.onset
    np.testing.assert_allclose(found.leads, expected.leads, rtol=0, atol=MV)


def compare(model, device, networks):
    """Simulate on both; how many networks fit."""
    fit = 0
    for network, found in zip(networks, on(device).beats(model, networks), strict=True):
        expected = model.simulate(network)
        if isinstance(expected, Infeasible):
            assert found == expected
        else:
            assert_same(found, expected)
            fit += 1
    return fit


def test_the_packaged_heart(default_model, device):
    assert compare(default_model, device, drawn(4)) == 4


def test_a_patients_heart(crtdemo_model, device):
    """Where many bundles and fascicles leave the endocardium, of either side."""
    assert compare(crtdemo_model, device, drawn(12)) == 8


def test_quantities_that_change_trees_and_times(crtdemo_model, emulated):
    network = next(n for n in drawn(9) if not isinstance(crtdemo_model.grow(n), Infeasible))
    changes = [
        {"alpha": 0.083},
        {"fibre_speed": 0.5, "anterograde_delay": 3.0, "retrograde_delay": 1.5},
        {"anterograde_delay": 5.0, "retrograde_delay": np.inf, "alpha": 0.04},
        {"retrograde_delay": 0.0, "root_time": -70.0, "cv": 4.0},
        {"gain": 2.5, "his_time": 30.0},
        {"branch_length": 5.0, "branch_angle": 0.4, "repulsion": 0.0},
        {"clearance": 1.4, "repulsion": 0.5},
        {"lv_fascicle_length_3": 8.0, "lv_fascicle_angle_3": 1.0},
    ]
    networks = [network | change for change in changes]
    assert compare(crtdemo_model, emulated, networks) == len(networks)
    times = [beat.activation for beat in on(emulated).beats(crtdemo_model, networks)]
    assert np.abs(times[1] - times[2]).max() > 1.0


def test_directions_and_interventricular_delays(default_model, emulated):
    """Also in a batch with a bundle that does not fit, from which no delay follows."""
    rng = np.random.default_rng(0)
    networks = [HUMAN_SPACE.from_unit(rng.uniform(0.4, 0.6, len(HUMAN_SPACE))) for _ in range(3)]
    networks.insert(1, networks[0] | {"lv_initial_length": 300.0})
    assert compare(default_model, emulated, networks) == 3
    (alone,) = on(emulated, 1).beats(default_model, networks[1:2])
    assert isinstance(alone, Infeasible)


def test_scar_is_not_activated(crtdemo_model, emulated):
    """Vertices inside are never reached, junctions there fire nothing, and it makes no ECG."""
    network = next(n for n in drawn(12) if not isinstance(crtdemo_model.grow(n), Infeasible))
    tree = crtdemo_model.grow(network)[1]
    scar = Region(0.0, centre=tuple(tree.nodes[tree.junctions[0]].tolist()), radius=12.0)
    model = ForwardModel(crtdemo_model.heart, Conduction(regions=(scar,)))
    assert compare(model, emulated, [network]) == 1
    (beat,) = on(emulated).beats(model, [network])
    assert beat.unreached.sum() > 10
    assert (attach(model.myocardium, beat.trees).located.elements < 0).any()


def test_a_block_with_an_exact_solution(emulated):
    """Straight fibres: a vertex is reached on the straight line from the junction that is first."""
    block = box((40.0, 40.0, 8.0), (20, 20, 4), jitter=0.2)
    electrodes = 200.0 * np.random.default_rng(0).normal(size=(9, 3))
    sides = {}
    for side, level in (("lv", 0.0), ("rv", 8.0)):
        face = face_of(block, 2, level)
        root = vertex_at(face.vertices, (20.0, 0.0, level))
        middle = np.linalg.norm(face.vertices - (20.0, 20.0, level), axis=1).argmin()
        sides[side] = replace(face, side=side, root=root, direction=int(middle))
    model = ForwardModel(
        replace(block, **sides, electrodes=electrodes), conduction_for(0.6, ACROSS)
    )
    network = EXAMPLE_PARAMETERS | {"root_time": 4.0} | {
        f"{side}_{name}": value
        for side in sides
        for name, value in {
            "initial_length": 12.0, "fascicle_length_1": 6.0, "fascicle_angle_1": 0.6,
            "fascicle_length_2": 6.0, "fascicle_angle_2": -0.6,
        }.items()
    }  # fmt: skip
    (beat,) = on(emulated).beats(model, [network])
    simulation = model.simulate(network)
    assert_same(beat, simulation)
    coupling = attach(model.myocardium, simulation.trees)
    fired = [
        times[tree.junctions]
        for times, tree in zip(simulation.coupled.trees, simulation.trees, strict=True)
    ]
    exact = straight_times(model.myocardium, coupling.located.positions, np.concatenate(fired))
    error = np.abs(beat.activation - exact)
    assert np.median(error) < 0.03  # where rays reach, but for the table's precision
    assert error.max() < 0.5 * EDGE / ACROSS  # first order beyond, and where fronts collide
    assert np.ptp(exact) > 20.0


def test_signals_are_what_is_compared(crtdemo_model, emulated):
    networks = drawn(5)
    signals = on(emulated).signals(crtdemo_model, networks)
    for network, found in zip(networks, signals, strict=True):
        expected = crtdemo_model.simulate(network)
        if isinstance(expected, Infeasible):
            assert found == expected
            continue
        expected = expected.signals
        assert found.junctions == expected.junctions
        np.testing.assert_allclose(found.first_activation, expected.first_activation, atol=MS)
        np.testing.assert_allclose(found.leads, expected.leads, rtol=0, atol=MV)


@pytest.mark.parametrize(
    ("room", "size"), [("most_grown", 900), ("most_grown", 60), ("most_sprouts", 40)]
)
def test_networks_that_are_too_large_are_left(crtdemo_model, emulated, monkeypatch, room, size):
    """As nodes of a tree, as nodes of its bundle, as branches of a generation."""
    monkeypatch.setattr(Simulator, room, size)
    assert list(on(emulated).beats(crtdemo_model, drawn(11)[8:])) == [None] * 3


def test_junctions_without_rays_in_the_table_are_left(crtdemo_model, emulated):
    networks = [n for n in drawn(12) if not isinstance(crtdemo_model.grow(n), Infeasible)]
    junctions = [
        attach(crtdemo_model.myocardium, crtdemo_model.grow(n)).located.triangles for n in networks
    ]
    table = crtdemo_model.myocardium.travel_times
    rows = table.row.copy()
    rows[junctions[0][0]] = -1  # another ray would have to be traced from it
    myocardium = replace(crtdemo_model.myocardium, travel_times=table._replace(row=rows))
    prepared = replace(crtdemo_model.prepared, myocardium=myocardium)
    model = ForwardModel(crtdemo_model.heart, prepared=prepared)
    found = [beat is None for beat in on(emulated).beats(model, networks)]
    assert found == [junctions[0][0] in triangles for triangles in junctions]
    assert not all(found)


def test_a_heart_in_which_nothing_fires_is_left(crtdemo_model, emulated):
    """The processor says what is wrong with that."""
    blocked = {"anterograde_delay": np.inf, "retrograde_delay": np.inf}
    networks = [n | blocked for n in drawn(2)]
    assert isinstance(crtdemo_model.grow(networks[1]), tuple)
    found = list(on(emulated).signals(crtdemo_model, networks))
    assert found[1] is None
    with pytest.raises(InputError, match="nothing activates the myocardium"):
        crtdemo_model.simulate(networks[1])


@pytest.mark.parametrize("name", ["anisotropy_ratio", "heart_up", "region_3_conductivity"])
def test_another_tissue_or_body_is_simulated_by_the_processor(crtdemo_model, emulated, name):
    backend = on(emulated)
    assert not backend.refusal(crtdemo_model, EXAMPLE_PARAMETERS)
    assert name in backend.refusal(crtdemo_model, [*EXAMPLE_PARAMETERS, name])


def test_additional_electrodes_are_left_to_the_processor(crtdemo_model, emulated):
    heart = replace(crtdemo_model.heart, additional_electrodes={"V7": np.zeros(3)})
    model = SimpleNamespace(rules=crtdemo_model.rules, heart=heart)
    assert "additional electrodes" in on(emulated).refusal(model, EXAMPLE_PARAMETERS)


def test_a_missing_parameter_is_named(crtdemo_model, emulated):
    without = {name: v for name, v in EXAMPLE_PARAMETERS.items() if name != "cv"}
    with pytest.raises(InputError, match="missing parameters cv; add them"):
        list(on(emulated).signals(crtdemo_model, [EXAMPLE_PARAMETERS, without]))


def test_a_heart_that_is_too_large(crtdemo_model):
    with pytest.raises(InputError, match="heart of 4569 vertices is too large for the card"):
        list(on(Emulated(shared_bytes=1000)).beats(crtdemo_model, [EXAMPLE_PARAMETERS]))
