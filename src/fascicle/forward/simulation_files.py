"""The example network of any heart, and the files of one simulation."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Singles
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_folder, write_text
from fascicle.core.parameters import EXAMPLE_PARAMETERS, Infeasible, read_parameters
from fascicle.core.quantities import checked, overridden
from fascicle.core.ranges import check_kind
from fascicle.forward.beat import Beat
from fascicle.forward.model import ForwardModel, without_heart
from fascicle.forward.scenario import Scenario
from fascicle.heart.folder import cell_arrays, heart_mesh, load_heart
from fascicle.heart.heart import Heart
from fascicle.mesh.mesh_file import TETRAHEDRON, VERTEX
from fascicle.mesh.vtk import pyvista_blocks, pyvista_grid, write_grid
from fascicle.purkinje.tree import FEW_JUNCTIONS, PurkinjeTree
from fascicle.purkinje.tree_files import read_tree, write_tree


def example_parameters(model: ForwardModel) -> dict[str, float]:
    """Parameters of a network with a plausible ECG, that grows on the heart of a model.

    A heart may have its own (`fascicle.Heart.example`), such as the packaged ones, which activate
    the ventricles in the sequence of mapped human hearts. On others it is the network of
    ``camps-dti004``, with lengths times the root of the endocardium's area over that of
    ``camps-dti004``; what then leaves the endocardium is shortened, and so is a bundle whose tree
    has few junctions: below 50, or fewer on an endocardium of less than half the area, which has
    less room. Where no length gives as many, it is the network with the most.

    Raises
    ------
    InputError
        If no network fits.

    Examples
    --------
    >>> import fascicle
    >>> model = fascicle.ForwardModel(fascicle.load_heart("default"))
    >>> fascicle.example_parameters(model)["interventricular_delay"]
    4.2
    """
    check_kind(model, ForwardModel, "model", "a fascicle.ForwardModel")
    if model.heart.example:
        return dict(model.heart.example)
    # its network is of human anatomy, and its ECG is normal
    subject = load_heart("camps-dti004")
    parameters, few = dict(subject.example), {}
    for endocardium, of_subject in zip(model.heart.endocardia, subject.endocardia, strict=True):
        side, share = endocardium.side, endocardium.area / of_subject.area
        factor, few[side] = round(math.sqrt(share), 2), FEW_JUNCTIONS * min(1.0, 2 * share)
        for name in parameters:
            if name.startswith(f"{side}_") and "length" in name:
                parameters[name] *= factor
    best, most = dict(parameters), 0
    shorter = 0.9  # share of the length that fits
    for _ in range(40):
        grown = model.grow(parameters)
        if isinstance(grown, Infeasible):
            parameters[grown.quantity] = max(shorter * grown.most, 0.1)  # mm
            continue
        junctions = {tree.side: len(tree.junctions) for tree in grown}
        if min(junctions.values()) > most:
            best, most = dict(parameters), min(junctions.values())
        sparse = [side for side, count in junctions.items() if count < few[side]]
        if not sparse:
            return parameters
        for side in sparse:  # tree that ends close to the base, with no room for branches
            parameters[f"{side}_initial_length"] *= shorter
    if most:
        return best
    raise InputError(
        f"{model.heart.name}: no example network was found that fits; choose other roots and "
        "directions for the bundles, or give parameters"
    )


def simulate_inputs(
    make_model: Callable[[], ForwardModel],
    params: Path | None = None,
    lv_tree: Path | None = None,
    rv_tree: Path | None = None,
    overrides: Mapping[str, float] | None = None,
    scenario: Scenario | None = None,
) -> tuple[Beat, dict[str, object], Heart]:
    """Run the forward model on the user's parameter file or two trees.

    Without either, the example network is simulated, scaled to the heart. `overrides` replace
    quantities of the file. Parameters are checked before the model is made, since a large heart
    takes a while. Returns the simulation, its inputs, for the summary, and the heart, which is one
    of an atlas if the parameters name it. InputError if files cannot be used, one tree is missing,
    or the parameters give no tree.
    """
    overrides = checked(overrides if overrides is not None else {})
    if lv_tree is None and rv_tree is None:
        from_file = read_parameters(params) if params is not None else None
        source = str(params) if params is not None else "example parameters"
        model = make_model()
        parameters = from_file if from_file is not None else example_parameters(model)
        parameters = overridden(parameters, overrides)
        with _naming(scenario):
            _check_trees(scenario, model)
            outcome = model.simulate(parameters, scenario)
        if isinstance(outcome, Infeasible):
            raise InputError(f"{source}: {outcome.reason}; {outcome.remedy}")
        return outcome, {"parameters": parameters}, model.of_heart(parameters).heart
    if params is not None:
        raise InputError("--params and --lv-tree/--rv-tree exclude each other; give one kind")
    if lv_tree is None or rv_tree is None:
        raise InputError("only one tree is given; give both --lv-tree and --rv-tree")
    physics = {name: EXAMPLE_PARAMETERS[name] for name in ("root_time", "cv")}
    physics = overridden(physics, overrides)
    trees, model = [], make_model().of_heart(physics)
    for path, endocardium in zip((lv_tree, rv_tree), model.heart.endocardia, strict=True):
        root = endocardium.vertices[endocardium.root]
        tree = read_tree(path, endocardium.side, root, file_first=True)
        _check_at_tissue(str(path), model, tree)
        _check_side(path, model.heart, tree)
        trees.append(tree)
    files: dict[str, object] = {"lv_tree": str(lv_tree), "rv_tree": str(rv_tree)}
    with _naming(scenario):
        _check_trees(scenario, model)
        simulation = model.activate(trees, scenario=scenario, **without_heart(physics))
    return simulation, files | physics, model.heart


@contextmanager
def _naming(scenario: Scenario | None) -> Iterator[None]:
    """Name the scenario's file in errors; errors of other inputs have been raised before."""
    try:
        yield
    except InputError as error:
        if scenario is None or scenario.source is None:
            raise
        raise InputError(f"{scenario.source}: {error}") from None


def _check_trees(scenario: Scenario | None, model: ForwardModel) -> None:
    for tree, _ in () if scenario is None else scenario.trees:
        _check_at_tissue(f"tree '{tree.side}'", model, tree)


def _check_at_tissue(name: str, model: ForwardModel, tree: PurkinjeTree) -> None:
    distances = model.myocardium.on_surface(tree.nodes[tree.junctions]).distances
    furthest = 5.0  # mm; a leaf further from the tissue is not a junction
    if distances.max() > furthest:
        raise InputError(
            f"{name}: {int((distances > furthest).sum())} of {len(distances)} leaves lie "
            f"more than {furthest:g} mm from the tissue (up to {distances.max():.1f} mm); "
            "give the tree in the heart's frame, in mm"
        )


def _check_side(path: Path, heart: Heart, tree: PurkinjeTree) -> None:
    """Refuse a tree that lies on the other ventricle's endocardium."""
    stated, other = (heart.lv, heart.rv) if tree.side == "lv" else (heart.rv, heart.lv)
    to_stated, to_other = (
        float(np.median(cKDTree(endocardium.vertices).query(tree.nodes)[0]))
        for endocardium in (stated, other)
    )
    if to_other < to_stated:
        raise InputError(
            f"{path}: given as the {tree.side.upper()} tree, but lies {to_stated:.1f} mm (median) "
            f"from the {stated.side.upper()} endocardium and {to_other:.1f} mm from the "
            f"{other.side.upper()} one; swap the two trees"
        )


def summary(heart: Heart, simulation: Beat, inputs: dict[str, object]) -> dict[str, Any]:
    """Summary of a simulation of `simulate_inputs`, as written to `summary.json`."""
    sides: dict[str, object] = {}
    coupled = simulation.coupled
    for tree, times, retrograde, distance in zip(
        simulation.trees, coupled.trees, coupled.retrograde, coupled.junction_distances, strict=True
    ):
        fired = np.isfinite(times[tree.junctions])
        sides[tree.side] = {
            "root_ms": _fired(times[tree.root]),
            "nodes": len(tree.nodes),
            "length_mm": round(float(tree.lengths.sum()), 3),
            "junctions": len(tree.junctions),
            "retrograde_junctions": int(retrograde.sum()),
            "not_activated_junctions": int((~fired).sum()),
            "largest_junction_distance_mm": round(float(distance.max(initial=0.0)), 4),
        }
    return {
        "heart": heart.name,
        "heart_sha256": heart.digest,
        "inputs": inputs,
        "qrs_duration_ms": simulation.qrs_duration,
        "total_activation_time_ms": round(simulation.total_activation_time, 3),
        "unreached_vertices": int(simulation.unreached.sum()),
        "unreached_volume_ml": round(unreached_volume(heart, simulation), 4),
        "his_bundle_ms": _fired(coupled.his),
        "trees": sides,
    }


def _fired(time: float) -> float | None:
    """Firing time (ms) for JSON; None if infinite."""
    return round(float(time), 3) if np.isfinite(time) else None


def unreached_volume(heart: Heart, simulation: Beat) -> float:
    """Volume (ml) of the elements with unreached vertices, which the ECG leaves out."""
    untouched = simulation.unreached[heart.tetrahedra].any(axis=1)
    return float(heart.volumes[untouched].sum()) / 1000


def write_simulation(
    heart: Heart, simulation: Beat, folder: Path, inputs: dict[str, object]
) -> dict[str, Any]:
    """Write a simulation's folder, whole or not at all; returns its `summary`."""
    content = summary(heart, simulation, inputs)
    # callers may draw pictures of the results into the folder
    pictures = [
        f"{name}.{kind}" for name in ("ecg", "activation") for kind in ("png", "svg", "pdf")
    ]
    with atomic_folder(folder, disposable=pictures) as temporary:
        write_beat(temporary, heart, simulation)
        write_ecg(temporary / "ecg.csv", simulation.ecg)
        write_text(temporary / "summary.json", json.dumps(content, indent=2) + "\n")
    return content


def write_beat(folder: Path, heart: Heart, simulation: Beat) -> None:
    """Write activation, trees and sites of a simulation into a folder (mm, ms).

    `activation.vtu`, the heart's mesh with times and their origins; `lv_tree.vtu` and so on;
    `junctions.vtu`, points with the arrays ``activation``, ``direction`` (1 anterograde, -1
    retrograde, 0 not activated) and ``site``, their row in `sites.csv`.
    """
    coupled = simulation.coupled
    origin = {"origin": coupled.origin}
    write_activation(folder / "activation.vtu", heart, simulation.activation, origin)
    for tree, times in zip(simulation.trees, coupled.trees, strict=True):
        write_tree(folder / f"{tree.side}_tree.vtu", tree, times)
    write_grid(folder / "junctions.vtu", *_junction_points(simulation))
    write_text(folder / "sites.csv", sites_table(simulation))


def write_activation(
    path: Path, heart: Heart, activation: Floats | Singles, others: Mapping[str, Any] | None = None
) -> None:
    """Write activation times (n,) (ms), and other point arrays, on a heart with its fibres."""
    points = {"activation": activation, **(others or {})}
    cells = cell_arrays(heart)
    write_grid(path, heart.vertices, heart.tetrahedra, TETRAHEDRON, points, cells)


def write_maps(path: Path, heart: Heart, maps: Mapping[str, Any]) -> None:
    """Write maps (n,) over networks as point arrays; of an atlas on its template, as it notes."""
    note = "" if heart.atlas is None else "maps over networks with other hearts, on the template"
    write_grid(path, heart.vertices, heart.tetrahedra, TETRAHEDRON, maps, note=note)


def beat_blocks(simulation: Beat, heart: Heart | None = None) -> Any:
    """Results of `write_beat` as `pyvista.MultiBlock`, with all arrays of the heart if given."""
    trees = zip(simulation.trees, simulation.coupled.trees, strict=True)
    blocks = {f"{tree.side}_tree": tree.to_pyvista(times) for tree, times in trees}
    blocks["junctions"] = pyvista_grid(*_junction_points(simulation))
    if heart is not None:
        blocks["heart"] = pyvista_grid(*heart_mesh(heart))
        blocks["heart"].point_data["activation_ms"] = simulation.activation
        blocks["heart"].point_data["origin"] = simulation.coupled.origin
    return pyvista_blocks(blocks)


def _junction_points(simulation: Beat) -> Any:
    """Points, cells and their kind, point arrays and cell arrays of junctions, for `write_grid`."""
    places, times = junctions(simulation)
    how = np.where(np.concatenate(simulation.coupled.retrograde), -1, 1) * np.isfinite(times)
    numbers = np.arange(len(times))
    arrays = {"activation": times, "direction": how, "site": numbers}
    return places, numbers[:, None], VERTEX, arrays, {}


def junctions(simulation: Beat) -> tuple[Floats, Floats]:
    """Positions (n, 3) (mm) and times (n,) (ms) of all junctions, tree by tree."""
    trees = list(zip(simulation.trees, simulation.coupled.trees, strict=True))
    places = [tree.nodes[tree.junctions] for tree, _ in trees]
    return np.concatenate(places), np.concatenate([times[t.junctions] for t, times in trees])


def write_ecg(path: Path, ecg: xr.DataArray) -> None:
    """Write an ECG (lead × time, mV) as CSV with the columns time_ms, I … V6, additional leads."""
    rows = np.column_stack([ecg["time"].to_numpy(), ecg.to_numpy().T])
    lines = [",".join(["time_ms", *ecg["lead"].to_numpy().tolist()])]
    lines += [",".join([f"{row[0]:g}", *(f"{value:.6f}" for value in row[1:])]) for row in rows]
    write_text(path, "\n".join(lines) + "\n")


def sites_table(simulation: Beat) -> str:
    """List as CSV what activated each site: a row for each junction, then for each stimulus."""
    lines = ["site,kind,tree,node,x_mm,y_mm,z_mm,time_ms,fired,entered_by"]
    coupled, site = simulation.coupled, 0
    for tree, times, retrograde, entered_by in zip(
        simulation.trees, coupled.trees, coupled.retrograde, coupled.entered_by, strict=True
    ):
        for node, backwards, by in zip(tree.junctions, retrograde, entered_by, strict=True):
            how = "retrograde" if backwards else "anterograde"
            lines.append(
                f"{site},junction,{tree.side},{node},{_position(tree.nodes[node])},"
                f"{_time(times[node])},{how if np.isfinite(times[node]) else 'never'},"
                f"{by if backwards else ''}"
            )
            site += 1
    for position, time, captured in zip(
        coupled.stimuli, coupled.stimulus_times, coupled.captured, strict=True
    ):
        how = "captured" if captured else "came too late"
        lines.append(f"{site},stimulus,,,{_position(position)},{_time(time)},{how},")
        site += 1
    return "\n".join(lines) + "\n"


def _position(point: Floats) -> str:
    return ",".join(f"{x:.4f}" for x in point)


def _time(time: float) -> str:
    return f"{time:.4f}" if np.isfinite(time) else ""
