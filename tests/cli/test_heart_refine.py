"""`fascicle heart refine`: the finer heart, what it costs, and what is refused."""

import numpy as np

from fascicle.core.parameters import read_parameters
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart


def test_refined_heart(blank_pictures, run, small_heart, parameters, outside):
    ended = run("heart", "refine", small_heart, "--out", outside / "fine")
    assert ended.well, ended.err
    coarse, fine = load_heart(small_heart), load_heart(outside / "fine")
    assert len(fine.tetrahedra) == 8 * len(coarse.tetrahedra)
    np.testing.assert_allclose(fine.volumes.sum(), coarse.volumes.sum(), rtol=1e-12)
    said = [line.split() for line in ended.out.splitlines()]
    assert ["tetrahedra", f"{len(coarse.tetrahedra)}", f"{len(fine.tetrahedra)}"] in said
    assert (outside / "fine" / "check.png").is_file()
    network = read_parameters(parameters())
    one, other = (ForwardModel(heart).simulate(network) for heart in (coarse, fine))
    for tree, same in zip(one.trees, other.trees, strict=True):
        np.testing.assert_array_equal(tree.nodes, same.nodes)
    samples = min(one.leads.shape[1], other.leads.shape[1])
    difference = one.leads[:, :samples] - other.leads[:, :samples]
    assert np.linalg.norm(difference) < 0.08 * np.linalg.norm(other.leads)


def test_refused(refused, small_heart, outside):
    def refine(heart, out):
        return ["heart", "refine", heart, "--out", out]

    refused(refine(outside / "none", outside / "fine"), "none: no such heart folder; make one")
    refused(refine(small_heart, small_heart), "holds the input heart.toml, which would be lost")
    (outside / "notes").mkdir()
    (outside / "notes" / "a.txt").write_text("mine")
    refused(refine(small_heart, outside / "notes"), "holds files and is not a heart folder")
    assert not (outside / "fine").exists()
