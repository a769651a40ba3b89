"""The mean shape of 1000 hearts, from a labelled surface to an ECG, as its user would have it."""

import numpy as np
import pytest
from clinical import assert_left_bundle_branch_block, assert_normal

import fascicle
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.mesh.topology import boundary_loops

pytestmark = pytest.mark.slow

VOLUME = 144.8  # ml, of the myocardium; data's SOURCE.txt


@pytest.fixture(scope="module")
def folder(data_folder, tmp_path_factory):
    """Built by the command line at its defaults: 2 mm, rule-based fibres, idealised torso."""
    from fascicle.cli.hearts import heart_app

    surface = data_folder / "hearts" / "cobiveco-geo1" / "heart.vtp"
    if not surface.is_file():
        pytest.skip(f"no {surface}")
    out = tmp_path_factory.mktemp("built") / "mean"
    heart_app(["build", str(surface), "--out", str(out)], standalone_mode=False)
    return out


@pytest.fixture(scope="module")
def heart(folder):
    return fascicle.load_heart(folder)


@pytest.fixture(scope="module")
def model(heart):
    return fascicle.ForwardModel(heart)


def test_volume_edge_and_rims(heart, folder):
    assert heart.volumes.sum() / 1000 == pytest.approx(VOLUME, rel=0.02)
    assert heart.edge_length == pytest.approx(2.0, rel=0.05)
    for endocardium in heart.endocardia:
        assert len(boundary_loops(endocardium.triangles)) == 1
        where = {tuple(vertex) for vertex in heart.vertices}
        assert all(tuple(vertex) in where for vertex in endocardium.vertices), "in register"
    assert heart.torso is not None
    assert heart.lead_fields is not None
    assert (folder / "check.png").is_file()


def test_normal_ecg(model):
    found = model.simulate(fascicle.example_parameters(model))
    assert_normal(found)
    assert model.surfaces.sequence(found.activation).is_mapped


def test_left_bundle_branch_block(model):
    block = {"conduction": CONDUCTION_STATES["left bundle branch block"].number}
    found = model.simulate(fascicle.example_parameters(model) | block)
    assert_left_bundle_branch_block(found)
    met = {criterion.name for criterion in found.conventional_criteria if criterion.met}
    assert "complete left bundle branch block" in met


def test_fit_accepts_it(folder, model, tmp_path):
    """A few evaluations against the heart's own normal ECG."""
    from examples.recover_known_network import synthetic_target

    leads = model.simulate(fascicle.example_parameters(model)).leads
    fitted = fascicle.fit(
        folder, synthetic_target(leads, np.random.default_rng(0)), tmp_path / "study",
        method="paper", initial=6, steps=1, samples=1, draws=1000,
    )  # fmt: skip
    assert len(fitted.study.records()) >= 7
    kept = fascicle.load_heart(tmp_path / "study" / "heart")
    assert kept.lead_fields.key == model.heart.lead_fields.key, "the study's copy is complete"
