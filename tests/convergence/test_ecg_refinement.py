"""The ECG of one activation on ever finer bins and meshes."""

from dataclasses import replace

import numpy as np
import pytest
from builders import box, solve_without_trees
from clinical import SHORT_BUNDLES

from benchmarks import ecg_error
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.heart.conduction import Conduction

pytestmark = pytest.mark.slow

ELECTRODES = np.array(
    [
        [-80, 60, 90], [90, 50, 80], [60, -10, -90], [40, 30, 60],
        [60, 20, 50], [65, 0, 30], [70, 0, 20], [65, 0, 0], [60, 10, -20],
    ],
    dtype=float,
)  # fmt: skip


@pytest.fixture(scope="module")
def mesh():
    """A block of oblique fibres, activated from a corner."""
    block = box((36.0, 24.0, 24.0), (9, 6, 6), jitter=0.2, fibre=(1.0, 1.0, 0.3))
    activation = 5.0 + solve_without_trees(build_myocardium(block, Conduction()), {0: 0.0})
    return ecg_error.ActivatedMesh(block.vertices, block.tetrahedra, block.fibres, activation)


def test_error_of_the_bins_falls_with_the_fourth_power(mesh):
    """Histogram and response are both nearest in least squares; 16 per halving in the limit."""
    heart = mesh.electrocardiograph(mesh.mean_gradients(ELECTRODES))
    reference = replace(heart, bins_per_step=16).leads(mesh.activation)
    error = [
        np.linalg.norm(replace(heart, bins_per_step=count).leads(mesh.activation) - reference)
        for count in (1, 2, 4)
    ]
    assert error[0] / error[1] > 4  # bins of 1 ms do not resolve an upstroke of 1 ms
    assert error[1] / error[2] > 8
    assert error[1] < 1e-4 * np.linalg.norm(reference)


def test_error_of_the_mesh_falls_with_the_square(mesh):
    """∇Z varies in an element, its mean does not: second order, so 4 at each refinement."""
    once = mesh.refined()
    leads = [m.leads(ELECTRODES) for m in (mesh, once, once.refined())]
    ratio = np.linalg.norm(leads[0] - leads[1]) / np.linalg.norm(leads[1] - leads[2])
    assert 3.0 < ratio < 5.0


def test_patients_heart_refined_twice_gives_the_same_ecg(crtdemo, crtdemo_model):
    """Each tetrahedron in 64, the same activation, as L2 norms over time.

    Over all leads together 0.24 %, and each lead by itself below 0.5 %. With the gradient of the
    interpolated lead field in place of the mean of the gradient the former is 0.51 %.
    """
    simulation = crtdemo_model.simulate(SHORT_BUNDLES)
    coarse = simulation.ecg.to_numpy()
    mesh = ecg_error.ActivatedMesh(
        crtdemo.vertices, crtdemo.tetrahedra, crtdemo.fibres, simulation.activation
    )
    fine = mesh.refined().refined().leads(crtdemo.electrodes)
    assert ecg_error.norm_difference(coarse, fine) < 0.0025
    assert (np.linalg.norm(coarse - fine, axis=1) < 0.005 * np.linalg.norm(fine, axis=1)).all()
