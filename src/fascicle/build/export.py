"""Hearts for other software: openCARP, ParaView (VTU) and Gmsh."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.errors import InputError
from fascicle.core.files import (
    MADE_WITH,
    as_path,
    atomic_folder,
    atomic_path,
    check_replaceable,
    write_text,
)
from fascicle.heart.electrodes import write_electrodes
from fascicle.heart.folder import cell_arrays, heart_mesh
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label, LabelledMesh, labelled_mesh
from fascicle.mesh import opencarp
from fascicle.mesh.mesh_file import GROUP
from fascicle.mesh.vtk import write_grid
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.purkinje.tree_files import write_opencarp_tree

# Names of the surfaces in files for other software
SURFACE_NAMES = {
    Label.LV_ENDOCARDIUM: "lv_endo",
    Label.RV_ENDOCARDIUM: "rv_endo",
    Label.EPICARDIUM: "epi",
    Label.BASE: "base",
}


def export_heart(
    heart: Heart, out: Path | str, kind: str, trees: Sequence[PurkinjeTree] = ()
) -> None:
    """Write a heart for other software, whole or not at all.

    openCARP and Gmsh files hold the whole boundary, labelled by
    `fascicle.heart.labelled_surface.labelled_mesh`, and 'heart build' reads them.

    The kind ``"opencarp"`` (µm) is a folder, see `write_opencarp`, whose files are called
    ``heart``, with the Purkinje networks of the trees; ``"vtu"`` (mm) a file of tetrahedra with the
    cell arrays ``fibre``, ``sheet`` and ``region`` and the point arrays ``lead_field_RA``, ...
    (kΩ), as far as the heart has them; ``"gmsh"`` (mm) a file, see `write_gmsh`.
    """
    out, suffixes = as_path(out, "out"), {"opencarp": "", "vtu": ".vtu", "gmsh": ".msh"}
    if kind not in suffixes:
        raise InputError(f"format '{kind}' is unknown; use one of {', '.join(suffixes)}")
    if kind == "opencarp":
        with atomic_folder(out) as temporary:
            write_opencarp(heart, labelled_mesh(heart), temporary / "heart", trees)
            content = {"heart": heart.name, "heart_sha256": heart.digest}
            write_text(temporary / "summary.json", json.dumps(content, indent=2) + "\n")
        return
    if out.suffix.lower() != suffixes[kind]:
        raise InputError(f"{out}: a {kind} file must end in {suffixes[kind]}; rename it (--out)")
    check_replaceable(out)
    if trees:
        raise InputError(
            f"{out}: Purkinje networks are exported for openCARP only; for other software use the "
            "VTU files of 'fascicle simulate'"
        )
    if kind == "vtu":
        write_grid(out, *heart_mesh(heart))
    else:
        write_gmsh(heart, out)


def write_gmsh(heart: Heart, path: Path) -> None:
    """Write a heart as a Gmsh file (2.2, binary, mm).

    The physical groups are a volume for each region (``region 3``; ``myocardium`` without regions)
    and the surfaces ``lv_endo``, ``rv_endo``, ``epi`` and ``base``, together the whole boundary.
    Element data are ``fibre``, ``sheet`` and ``region``; meshio wants them zero on triangles.
    """
    import meshio

    surface = labelled_mesh(heart)
    tags, groups = np.ones(len(heart.tetrahedra), dtype=np.int64), {"myocardium": np.array([1, 3])}
    if heart.regions is not None:  # numbers of groups start at 1, while regions may be 0 or less
        regions, which = np.unique(heart.regions, return_inverse=True)
        tags = which.astype(np.int64) + 1
        groups = {f"region {region}": np.array([k, 3]) for k, region in enumerate(regions, 1)}
    cells, numbers = [("tetra", heart.tetrahedra)], [tags]
    for label, name in SURFACE_NAMES.items():
        if len(triangles := surface.having(label)):
            cells.append(("triangle", triangles))
            numbers.append(np.full(len(triangles), int(label)))
            groups[name] = np.array([int(label), 2])
    data = {GROUP: numbers, "gmsh:geometrical": numbers}
    for name, values in cell_arrays(heart).items():
        data[name] = [np.asarray(values, dtype=float)]
        data[name] += [np.zeros((len(block), *values.shape[1:])) for _, block in cells[1:]]
    mesh = meshio.Mesh(heart.vertices, cells, cell_data=data, field_data=groups)
    with atomic_path(path) as temporary:
        meshio.gmsh.write(temporary, mesh, fmt_version="2.2", binary=True)
        with temporary.open("a", encoding="utf-8") as file:
            file.write(f"$Comments\n{MADE_WITH}\n$EndComments\n")


def write_opencarp(
    heart: Heart, surface: LabelledMesh, stem: Path, trees: Sequence[PurkinjeTree] = ()
) -> None:
    """Write a heart for openCARP.

    The files are ``<stem>.pts``, ``<stem>.elem`` (its tags are the regions, or 1), ``<stem>.lon``
    (fibres, and sheets if the heart has them) and ``electrodes.csv`` (mm). The boundary is
    in ``<stem>_lv_endo``, ``_rv_endo``, ``_epi`` and ``_base``, each as ``.surf`` and ``.vtx``. An
    endocardium whose vertices are not the mesh's is also in ``<stem>_lv_endocardium.pts`` and
    ``.elem``, without the triangles that span a valve opening. Purkinje networks are ``lv_tree``
    and ``rv_tree``; see `fascicle.purkinje.tree_files`.
    """
    opencarp.write_opencarp_mesh(stem, heart.vertices, "Tt", heart.tetrahedra, heart.regions)
    axes = [heart.fibres] if heart.sheets is None else [heart.fibres, heart.sheets]
    opencarp.write_directions(opencarp.opencarp_file(stem, ".lon"), axes)
    for label, name in SURFACE_NAMES.items():
        if len(triangles := surface.having(label)):
            part = stem.with_name(f"{stem.name}_{name}")
            opencarp.write_surf(opencarp.opencarp_file(part, ".surf"), triangles)
            opencarp.write_vtx(opencarp.opencarp_file(part, ".vtx"), np.unique(triangles))
    for e in heart.endocardia:
        wall = e.triangles if e.valves is None else e.triangles[~e.valves]
        used, corners = np.unique(wall, return_inverse=True)
        vertices = e.vertices[used]
        distance, _ = cKDTree(heart.vertices).query(vertices)
        if (distance > 1e-3).any():  # mm; text files hold rounded numbers
            part = stem.with_name(f"{stem.name}_{e.side}_endocardium")
            opencarp.write_opencarp_mesh(part, vertices, "Tr", corners.reshape(-1, 3))
    electrodes = heart.electrodes, heart.additional_electrodes
    write_electrodes(stem.with_name("electrodes.csv"), *electrodes)
    for tree in trees:
        write_opencarp_tree(stem.with_name(f"{tree.side}_tree"), tree)
