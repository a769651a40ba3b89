"""Effect on the ECG of the mesh that the activation is solved on.

    python -m benchmarks.activation_refinement [--data CRTDEMO_FOLDER]

A heart and a network in sinus rhythm and in left bundle branch block (root time -60 ms), against
the same heart with every tetrahedron cut into 8, and with --data also into 64. Trees, fibres and
the gradients of the lead fields stay as they are on the coarsest mesh, so nothing differs but the
activation times. Their share of the ECG has two parts:

- times: those at the vertices of the coarser mesh, against the finer mesh's at the same vertices,
  both interpolated linearly in the coarser mesh's elements;
- linear: what is left, since times on the finer mesh are not linear in the coarser one's elements.

Percentages are of the finer mesh's ECG, as L2 norm over leads and time, as they are and at the best
alignment. Without --data the packaged heart is measured, with it the crtdemo heart. Each takes two
to four minutes. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.build.refinement import refined
from fascicle.core.parameters import Infeasible
from fascicle.forward.eikonal.activation import solve
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.eikonal.myocardium import attach
from fascicle.forward.electrocardiogram import (
    build_electrocardiograph,
    nodal_gradients,
    unbounded_gradients,
)
from fascicle.forward.loss import align
from fascicle.forward.model import ForwardModel
from fascicle.forward.template import default_template
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import barycentric_gradients
from fascicle.torso.lead_fields import resolve_lead_fields

Array = NDArray[np.float64]

BLOCK = 64 * 800  # elements at a time, so that whole elements of the coarsest mesh are together
BLOCK_ROOT_TIME = -60.0  # ms


def lead_field_gradients(heart: Heart, conduction: Conduction) -> Array:
    """Mean ∇Z of each electrode in each tetrahedron (kΩ/mm), as the forward model has it."""
    fields = resolve_lead_fields(heart, conduction)
    if fields is None:
        torso = conduction.torso
        return unbounded_gradients(heart.vertices, heart.tetrahedra, heart.electrodes, torso)
    slopes = barycentric_gradients(heart.vertices, heart.tetrahedra)
    return nodal_gradients(fields.values, heart.tetrahedra, slopes)


def leads(heart: Heart, conduction: Conduction, gradients: Array, activation: Array) -> Array:
    """The twelve leads (mV), with the lead fields of a heart that this one is a refinement of."""
    children = len(heart.tetrahedra) // gradients.shape[1]
    total: Array | float = 0.0
    for first in range(0, len(heart.tetrahedra), BLOCK):
        part = slice(first, first + BLOCK)
        parents = slice(first // children, (first + BLOCK) // children)
        corners = heart.tetrahedra[part]
        block = build_electrocardiograph(
            corners,
            barycentric_gradients(heart.vertices, corners),
            heart.volumes[part],
            conduction.intracellular(heart.fibres[part]),
            np.repeat(gradients[:, parents], children, axis=1),
            default_template(),
        )
        total = total + block.leads(activation)
    return np.asarray(total)


def difference(ecg: Array, reference: Array) -> tuple[float, float]:
    """Norm of the difference as a part of the reference's, as they are and aligned."""
    samples = max(ecg.shape[1], reference.shape[1])
    ecg, reference = (
        np.pad(signal, ((0, 0), (0, samples - signal.shape[1]))) for signal in (ecg, reference)
    )
    norm = float(np.linalg.norm(reference))
    as_they_are = float(np.linalg.norm(ecg - reference)) / norm
    return as_they_are, float(np.sqrt(align(ecg, reference).loss * samples)) / norm


def compare(name: str, heart: Heart, parameters: dict[str, float], times: int) -> None:
    """Print the rows of one heart and all its refinements."""
    model = ForwardModel(heart)
    trees = model.grow(parameters)
    if isinstance(trees, Infeasible):
        raise RuntimeError(f"the benchmark's parameters give no tree: {trees.reason}")
    conduction = model.conduction
    gradients = lead_field_gradients(heart, conduction)
    hearts = [heart]
    for _ in range(times):
        hearts.append(refined(hearts[-1]))
    couplings = [attach(build_myocardium(mesh, conduction), trees) for mesh in hearts]
    rhythms = {"sinus rhythm": parameters["root_time"], "left block": BLOCK_ROOT_TIME}
    for rhythm, late in rhythms.items():
        roots = max(0.0, -late), max(0.0, late)
        solved = [solve(coupling, roots, parameters["cv"]).myocardium for coupling in couplings]
        ecgs = [
            leads(mesh, conduction, gradients, activation)
            for mesh, activation in zip(hearts, solved, strict=True)
        ]
        for coarse, fine in combinations(range(len(hearts)), 2):
            restricted = solved[fine][: len(solved[coarse])]
            between = leads(hearts[coarse], conduction, gradients, restricted)
            pairs = (ecgs[coarse], ecgs[fine]), (ecgs[coarse], between), (between, ecgs[fine])
            late_by = solved[coarse] - restricted
            figures = [100 * part for pair in pairs for part in difference(*pair)]
            print(
                f"{name}, {rhythm}, x{8**coarse} to x{8**fine}".ljust(38)
                + f"{np.abs(late_by).mean():>8.2f}"
                + "".join(f"{figure:>9.2f}" for figure in figures),
                flush=True,
            )


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    import fascicle
    from benchmarks.forward import _heart, _named_parameters, build_case

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the crtdemo heart")
    arguments = parser.parse_args(argv)
    print(f"{'':<38}{'times':>8}{'ECG':>9}{'aligned':>9}{'times':>9}{'aligned':>9}", end="")
    print(f"{'linear':>9}{'aligned':>9}\n{'':<38}{'ms':>8}" + f"{'%':>9}" * 6)
    if arguments.data is None:
        parameters = dict(fascicle.EXAMPLE_PARAMETERS)
        compare("default", fascicle.load_heart("default"), parameters, 1)
    else:
        case = build_case(arguments.data)
        compare("crtdemo", _heart(case), _named_parameters(case), 2)


if __name__ == "__main__":
    main()
