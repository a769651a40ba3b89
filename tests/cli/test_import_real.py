"""`fascicle heart import` of a patient's heart, as published."""

import json

import numpy as np
import pytest
from clinical import SHORT_BUNDLES
from scipy.spatial import cKDTree

from fascicle.heart.folder import load_heart
from fascicle.mesh.topology import boundary_loops
from fascicle.torso.lead_fields import place_electrodes

pytestmark = pytest.mark.usefixtures("blank_pictures")


@pytest.fixture
def command(data_folder, outside):
    folder = data_folder / "hearts" / "crtdemo"
    return [
        "heart", "import",
        "--mesh", folder / "crtdemo_mesh_oriented.vtk",
        "--fibres", folder / "crtdemo_f0_oriented.vtk",
        "--lv-endocardium", folder / "crtdemo_LVendo_heart_cut.obj",
        "--rv-endocardium", folder / "crtdemo_RVendo_heart_cut.obj",
        "--electrodes", folder / "electrodes_mm.csv",
        "--out", outside / "crtdemo",
    ]  # fmt: skip


def test_with_the_published_seeds_to_an_ecg(command, outside, run, tmp_path):
    seeds = ["--lv-root", 388, "--lv-direction", 412, "--rv-root", 198, "--rv-direction", 186]
    ended = run(*command, *seeds)
    assert ended.well
    # the published fibres turn the other way; a mesh of other software has a few flat elements
    assert "the helix angle of the LV free wall goes from -53 degrees inside to" in ended.err
    assert "smallest dihedral angle 1.6 degrees" in ended.err
    assert ended.err.count("warning: ") == 2
    assert "4569 vertices, 17866 tetrahedra, 226.5 ml, edges 4.8" in ended.out
    heart = load_heart(outside / "crtdemo")
    assert (heart.lv.root, heart.rv.direction) == (388, 186)
    np.testing.assert_allclose(np.linalg.norm(heart.fibres, axis=1), 1, atol=1e-12)
    network = tmp_path / "network.toml"
    network.write_text("\n".join(f"{name} = {value}" for name, value in SHORT_BUNDLES.items()))
    simulate = ["simulate", outside / "crtdemo", "--params", network, "--cv", 2.5]
    ended = run(*simulate, "--out", outside / "simulated")
    assert (ended.status, ended.err) == (0, "")
    summary = json.loads((outside / "simulated" / "summary.json").read_text())
    assert 60 < summary["qrs_duration_ms"] < 200


@pytest.mark.slow
def test_in_a_torso_shaped_to_its_electrodes(command, outside, run):
    ended = run(*command, "--torso", "idealised")
    assert ended.status == 0
    assert "torso: fitted to the electrodes" in ended.out
    heart = load_heart(outside / "crtdemo")
    whole = np.concatenate([heart.tetrahedra, heart.torso.tetrahedra])
    assert place_electrodes(heart.torso.vertices, whole, heart.electrodes).moved.max() < 3
    assert heart.lead_fields is not None


def test_without_seeds_they_are_found_on_the_septum(command, outside, run):
    assert run(*command).status == 0
    heart = load_heart(outside / "crtdemo")
    for own, other in ((heart.lv, heart.rv), (heart.rv, heart.lv)):
        base = own.vertices[boundary_loops(own.triangles)[0]].mean(axis=0)
        apex = own.vertices[np.argmax(np.linalg.norm(own.vertices - base, axis=1))]
        root, direction = own.vertices[own.root], own.vertices[own.direction]
        depth = [(p - base) @ (apex - base) / np.sum((apex - base) ** 2) for p in (root, direction)]
        assert 0.05 < depth[0] < 0.25
        assert depth[1] > depth[0] + 0.15
        to_other = cKDTree(other.vertices).query(own.vertices)[0]
        seeds = to_other[[own.root, own.direction]]
        assert (seeds < np.quantile(to_other, 0.4)).all()
