"""Hearts of an atlas: components, files, and forward models of single hearts."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK
from scipy.spatial import cKDTree

from fascicle.core.errors import InputError
from fascicle.forward.model import ForwardModel
from fascicle.heart.atlas import atlas_heart
from fascicle.heart.coordinates import ventricular_coordinates
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Atlas, Components

SCALES = (1.0, 1.1, 0.95)


def beside_left_root(heart):
    """The vertex of the left endocardium that is nearest to its root."""
    vertices, root = heart.lv.vertices, heart.lv.root
    return int(np.argsort(np.linalg.norm(vertices - vertices[root], axis=1))[1])


@pytest.fixture(scope="module")
def atlas(small_heart):
    """The small heart in three sizes, in the unbounded conductor's lead fields."""
    vertices = np.array([(scale * small_heart.vertices).ravel() for scale in SCALES])
    electrodes = np.array([scale * small_heart.electrodes for scale in SCALES])
    fields = np.array(
        [
            1 / np.linalg.norm(small_heart.vertices * scale - electrode, axis=1)
            for scale, places in zip(SCALES, electrodes, strict=True)
            for electrode in places
        ]
    )
    fields -= fields.mean(axis=1, keepdims=True)
    tissues = ({}, {"anisotropy_ratio": 2.0}, {})
    seeds = np.array([[(e.root, e.direction) for e in small_heart.endocardia]] * 3)
    seeds[1, 0, 0] = beside_left_root(small_heart)
    hearts = Atlas(
        Components.of(vertices, 2), electrodes, seeds, np.array([0.6, 1.0, 1.0]),
        Components.of(fields, 27), tissues, {"lv_volume": np.array([100.0, 133.0, 86.0])},
        np.array([0.5, 0.3, 0.2]), {"age": 50.0},
    )  # fmt: skip
    return replace(small_heart, atlas=hearts, folder=None)


def test_components_give_rows_back():
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((12, 3)) @ rng.standard_normal((3, 50)) + 5
    components = Components.of(rows, 3)
    assert components.rows(slice(2, 7)) == pytest.approx(rows[2:7], abs=0.01)
    assert Components.of(rows, 2).rows(slice(None)) != pytest.approx(rows, abs=0.01)


def test_each_heart_has_its_own_shape_and_electrodes(atlas, small_heart):
    for number, scale in enumerate(SCALES):
        heart = atlas_heart(atlas, number)
        assert heart.vertices == pytest.approx(scale * small_heart.vertices, abs=0.1)
        assert heart.lv.area == pytest.approx(scale**2 * small_heart.lv.area, rel=0.01)
        assert heart.electrodes == pytest.approx(scale * small_heart.electrodes)
        assert heart.lv.root == atlas.atlas.seeds[number, 0, 0]
        assert atlas.atlas.lead_fields(number).shape == (9, len(heart.vertices))


def test_a_heart_is_read_as_it_was_written(atlas, tmp_path):
    write_heart(atlas, tmp_path / "atlas")
    back = load_heart(tmp_path / "atlas")
    assert back.digest == atlas.digest
    assert back.atlas.person == {"age": 50.0}
    assert back.atlas.tissues == atlas.atlas.tissues
    np.testing.assert_array_equal(back.atlas.seeds, atlas.atlas.seeds)
    np.testing.assert_array_equal(back.atlas.weights, atlas.atlas.weights)


def test_a_damaged_atlas_is_refused(atlas, tmp_path):
    write_heart(atlas, tmp_path / "atlas")
    (tmp_path / "atlas" / "atlas.npz").write_bytes(b"no atlas")
    with pytest.raises(InputError, match=r"atlas\.npz: not an atlas"):
        load_heart(tmp_path / "atlas")


def test_networks_are_simulated_in_the_heart_that_they_name(atlas):
    model = ForwardModel(atlas)
    alone = ForwardModel(atlas_heart(atlas, 2))
    assert model.of_heart({"atlas_heart": 2.0}) is model.of_heart({"atlas_heart": 2.0})
    beats = [model.simulate({**NETWORK, "atlas_heart": float(k)}) for k in range(3)]
    areas = [model.of_heart({"atlas_heart": float(k)}).heart.lv.area for k in range(3)]
    assert areas[1] > areas[0] > areas[2]
    expected = alone.simulate(NETWORK)
    assert beats[2].activation == pytest.approx(expected.activation, abs=0.5)
    # a larger heart, whose tissue conducts faster across the fibre as well
    assert beats[1].total_activation_time != pytest.approx(beats[0].total_activation_time, abs=0.5)
    tables = [model.of_heart({"atlas_heart": k}).myocardium.travel_times for k in (0.0, 2.0)]
    assert len(tables[0].start) < len(tables[1].start)  # no rays from where no tree grows
    paced = model.activate(beats[1].trees, **{**NETWORK, "root_time": 20.0, "atlas_heart": 1.0})
    assert paced.activation.shape == beats[1].activation.shape


def test_networks_end_below_the_base_of_the_free_walls(atlas, small_heart):
    coordinates, tree = ventricular_coordinates(small_heart), cKDTree(small_heart.vertices)
    free_wall = np.abs(coordinates.rotational - 1 / 3) < 0.2  # away from the septum
    highest = []
    for number in (0, 2):  # up to 0.6 of the way to the base, and all the way
        grown = ForwardModel(atlas_heart(atlas, number)).grow(NETWORK)
        nodes = np.concatenate([tree.query(t.nodes / SCALES[number])[1] for t in grown])
        highest.append(coordinates.apicobasal[nodes[free_wall[nodes]]].max())
    assert highest[0] < 0.75 < highest[1]  # to within a triangle


@pytest.mark.parametrize(
    ("of_atlas", "number", "message"), [(True, 3.0, "hearts 0 to 2"), (False, 0.0, "one heart")]
)
def test_hearts_that_are_not_there_are_refused(atlas, small_model, of_atlas, number, message):
    model = ForwardModel(atlas) if of_atlas else small_model
    with pytest.raises(InputError, match=message):
        model.simulate({**NETWORK, "atlas_heart": number})
