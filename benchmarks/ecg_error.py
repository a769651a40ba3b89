"""Error of the computed ECG against the exact one of the same activation, by source.

    python -m benchmarks.ecg_error --data CRTDEMO_FOLDER

For the crtdemo heart and the packaged one. Each row changes one thing: the bins of the activation
histogram (against bins eight times finer), the quadrature of the lead fields (against one on eight
times as many points), the mesh (against one refined once and twice: the same activation, linear in
each original element, and the same fibres), the sampling (1 ms, against 1/8 ms). Percentages are of
the L2 norm over all leads, mV the largest difference in any.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from benchmarks.references import unbounded
from fascicle.build.refinement import in_eight
from fascicle.forward.electrocardiogram import (
    Electrocardiograph,
    build_electrocardiograph,
    nodal_gradients,
    unbounded_gradients,
)
from fascicle.forward.template import default_template
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import barycentric_gradients, signed_volumes

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FINER_BINS = 16  # per ms
SUBSAMPLES = 8
BLOCK = 50_000  # elements at a time


@dataclass(frozen=True)
class ActivatedMesh:
    """A mesh, its fibres and an activation, linear in each element.

    Attributes
    ----------
    vertices, corners : (n, 3) and (m, 4) arrays
        The mesh (mm).
    fibres : (m, 3) array
        Unit fibre of each tetrahedron.
    activation : (n,) array
        Time at each vertex (ms).
    """

    vertices: Array
    corners: Indices
    fibres: Array
    activation: Array

    def refined(self) -> ActivatedMesh:
        """Mesh with each tetrahedron cut in eight, numbered together; the activation stays."""
        finer = in_eight(self.vertices, self.corners)
        return ActivatedMesh(
            finer.vertices,
            finer.tetrahedra,
            np.repeat(self.fibres, 8, axis=0),
            finer.at_vertices(self.activation),
        )

    def electrocardiograph(self, gradients: Array) -> Electrocardiograph:
        """Electrocardiograph as in `ForwardModel`, from lead-field gradients in each element."""
        return build_electrocardiograph(
            self.corners,
            barycentric_gradients(self.vertices, self.corners),
            np.abs(signed_volumes(self.vertices, self.corners)),
            Conduction().intracellular(self.fibres),
            gradients,
            default_template(),
        )

    def mean_gradients(self, electrodes: Array) -> Array:
        """Mean of ∇Z over each element, as `ForwardModel` takes it."""
        torso = Conduction().torso
        return unbounded_gradients(self.vertices, self.corners, electrodes, torso)

    def leads(self, electrodes: Array) -> Array:
        """The twelve leads (mV), added up over blocks of elements to bound the memory."""
        leads = 0.0
        for first in range(0, len(self.corners), BLOCK):
            block = slice(first, first + BLOCK)
            part = replace(self, corners=self.corners[block], fibres=self.fibres[block])
            heart = part.electrocardiograph(part.mean_gradients(electrodes))
            leads = leads + heart.leads(self.activation)
        return np.asarray(leads)

    def leads_nodal(self, electrodes: Array) -> Array:
        """The twelve leads (mV) with Z linear in each element."""
        barycentric = barycentric_gradients(self.vertices, self.corners)
        lead_fields = unbounded(self.vertices, electrodes, Conduction().torso)
        gradients = nodal_gradients(lead_fields, self.corners, barycentric)
        return self.electrocardiograph(gradients).leads(self.activation)


def norm_difference(leads: Array, reference: Array) -> float:
    """L2 norm over leads and time of the difference, as a part of the reference's."""
    return float(np.linalg.norm(leads - reference) / np.linalg.norm(reference))


def errors(mesh: ActivatedMesh, electrodes: Array) -> dict[str, tuple[float, float]]:
    """Relative L2 norm and largest difference (mV) of the ECG, by source of error."""
    once = mesh.refined()
    exact = once.refined().leads(electrodes)
    heart = mesh.electrocardiograph(mesh.mean_gradients(electrodes))
    leads = heart.leads(mesh.activation)
    parts = once.mean_gradients(electrodes).reshape(len(electrodes), -1, 8, 3)
    fine = _finely_sampled(heart, mesh.activation)
    pairs = {
        "bins of 1/2 ms": (
            leads, replace(heart, bins_per_step=FINER_BINS).leads(mesh.activation)
        ),
        "quadrature of lead fields": (
            leads, mesh.electrocardiograph(parts.mean(axis=2)).leads(mesh.activation)
        ),
        "mesh, against refined once": (leads, once.leads(electrodes)),
        "mesh, against refined twice": (leads, exact),
        "  nodal lead fields, the same": (mesh.leads_nodal(electrodes), exact),
        "1 ms samples, lines between": (_between(np.interp, fine), fine),
        "1 ms samples, cubic between": (_between(_cubic, fine), fine),
    }  # fmt: skip
    return {
        name: (
            norm_difference(approximate, reference),
            float(np.abs(approximate - reference).max()),
        )
        for name, (approximate, reference) in pairs.items()
    }


def _finely_sampled(heart: Electrocardiograph, activation: Array) -> Array:
    """Leads every 1/8 ms: a later activation is an earlier sample."""
    later = np.arange(SUBSAMPLES) / SUBSAMPLES
    curves = [heart.leads(activation + 1.0 - by) for by in later]
    samples = min(curve.shape[1] for curve in curves)
    return np.stack([curve[:, :samples] for curve in curves], axis=2).reshape(12, -1)


def _cubic(at: Array, times: Array, values: Array) -> Array:
    return np.asarray(CubicSpline(times, values)(at))


def _between(interpolate: Callable[[Array, Array, Array], Array], fine: Array) -> Array:
    """Samples interpolated from every eighth of them."""
    times = np.arange(fine.shape[1]) / SUBSAMPLES
    kept = slice(None, None, SUBSAMPLES)
    return np.array([interpolate(times, times[kept], lead[kept]) for lead in fine])


def activated(heart: Heart, parameters: dict[str, float]) -> ActivatedMesh:
    """The heart as the forward model activates it."""
    from fascicle.core.parameters import Infeasible
    from fascicle.forward.model import ForwardModel

    simulation = ForwardModel(heart).simulate(parameters)
    if isinstance(simulation, Infeasible):
        raise RuntimeError(f"the benchmark's parameters give no tree: {simulation.reason}")
    return ActivatedMesh(heart.vertices, heart.tetrahedra, heart.fibres, simulation.activation)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table of each heart."""
    import fascicle
    from benchmarks.forward import _heart, _named_parameters, build_case

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    arguments = parser.parse_args(argv)
    hearts = {"default": (fascicle.load_heart("default"), fascicle.EXAMPLE_PARAMETERS)}
    if arguments.data is not None:
        case = build_case(arguments.data)
        hearts["crtdemo"] = (_heart(case), _named_parameters(case))
    for name, (heart, parameters) in hearts.items():
        mesh = activated(heart, dict(parameters))
        peak = np.ptp(mesh.leads(heart.electrodes), axis=1).max()
        print(f"{name}: {len(heart.tetrahedra)} tetrahedra, largest QRS {peak:.2f} mV")
        for source, (relative, largest) in errors(mesh, heart.electrodes).items():
            print(f"  {source:<36}{100 * relative:>9.4f} %{largest:>11.2e} mV")


if __name__ == "__main__":
    main()
