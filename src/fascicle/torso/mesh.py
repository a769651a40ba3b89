"""Tetrahedral mesh of the torso outside the myocardium, conforming to the heart's mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.heart import Heart, Torso, TorsoTissue
from fascicle.heart.labelled_surface import ENDOCARDIA, LabelledMesh, labelled_mesh
from fascicle.mesh.measures import signed_volumes, winding_number
from fascicle.mesh.meshing import Interface, tetrahedralise
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.electrode_sites import FARTHEST
from fascicle.torso.idealised import FITTED, fitted_torso, idealised_torso
from fascicle.torso.lead_fields import place_electrodes
from fascicle.torso.surfaces import Surface


def torso_of(heart: Heart, progress: StageProgress = no_progress) -> Torso:
    """Torso of a heart; the idealised one if the heart is stored with lead fields only.

    The idealised torso is the standard one, or the one fitted to the heart's electrodes if its lead
    fields say `FITTED`. An error if electrodes are not on it: then it was another torso.
    """
    if heart.torso is not None:
        return heart.torso
    mesh = labelled_mesh(heart)
    if heart.lead_fields is not None and heart.lead_fields.torso == FITTED:
        surfaces, _ = fitted_torso(mesh, heart.electrodes, heart.name, {})
    else:
        surfaces = idealised_torso(mesh)
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs, progress)
    tetrahedra = np.concatenate([heart.tetrahedra, torso.tetrahedra])
    distance = place_electrodes(torso.vertices, tetrahedra, heart.electrodes).moved.max()
    if distance > FARTHEST:
        raise InputError(
            f"{heart.name}: its torso is not in the folder, and electrodes are {distance:.0f} mm "
            "from the skin of the idealised one; build the heart again with its torso"
        )
    return torso


def mesh_torso(
    mesh: LabelledMesh,
    skin: Surface,
    lungs: Sequence[Surface] = (),
    progress: StageProgress = no_progress,
) -> Torso:
    """Fill the space between myocardium, lungs and skin; the vertices begin with the heart's.

    No triangle of these surfaces, which `fascicle.torso.surfaces.check_within` accepts, is changed,
    so the result continues the heart's own mesh. Tetrahedra are blood if an endocardium and a lid
    over each of its openings enclose their centre: a winding number above one half (Jacobson, Kavan
    and Sorkine-Hornung 2013, ACM Trans Graph 32:33). The lid is not a surface of the mesh: the edge
    of a real heart's opening is too rough to hold one that nowhere cuts the tissue.
    """
    progress(0, 2)
    around, first_lung = 1, 2  # Netgen's numbers of the domains it fills; other lungs follow
    heart, triangles = without_unused_vertices(mesh.vertices, mesh.triangles)
    remedy = (
        "a surface crosses itself or another or is too rough; remesh the heart, the torso or the "
        "lungs more evenly"
    )
    # one optimisation step leaves no dihedral angle below 5 degrees around a good heart mesh
    vertices, tetrahedra, domains = tetrahedralise(
        [
            Interface(heart, triangles, 0, around),
            Interface(*skin, around),
            *(Interface(*lung, number, around) for number, lung in enumerate(lungs, first_lung)),
        ],
        f"{mesh.name}: the torso around it",
        remedy,
        maxh=15.0,
        grading=0.5,
        optsteps3d=1,
    )
    if flat := np.count_nonzero(signed_volumes(vertices, tetrahedra) <= 0):
        raise InputError(f"{mesh.name}: {flat} tetrahedra around it are flat; {remedy}")
    progress(1, 2)
    tissues = np.where(domains == around, int(TorsoTissue.OTHER), int(TorsoTissue.LUNG))
    centres = vertices[tetrahedra].mean(axis=1)
    for label in ENDOCARDIA:
        endocardium = mesh.having(label)
        lined = mesh.vertices[endocardium]
        low, high = lined.min(axis=(0, 1)), lined.max(axis=(0, 1))
        in_box = ((centres >= low) & (centres <= high)).all(axis=1)
        near = np.flatnonzero((domains == around) & in_box)
        within = winding_number(mesh.vertices, endocardium, centres[near]) > 0.5
        tissues[near[within]] = TorsoTissue.BLOOD
    used = np.unique(mesh.triangles)
    added = vertices[len(used) :]
    number = np.concatenate([used, len(mesh.vertices) + np.arange(len(added))])
    progress(2, 2)
    return Torso(np.concatenate([mesh.vertices, added]), number[tetrahedra], tissues)
