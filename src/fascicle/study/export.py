"""Export of a study's networks, and of the tissue that they activate, to other software.

openCARP's parameters are those of its manual and of https://opencarp.org/parameters (Plank et al.,
Comput. Methods Programs Biomed. 208, 106223, 2021): lengths in µm, times in ms, conductivities in
S/m, speeds of its eikonal model in mm/s, transmembrane currents in µA/cm².
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fascicle.build.export import write_opencarp
from fascicle.core.arrays import Floats, Integers
from fascicle.core.files import write_text
from fascicle.forward.beat import Beat
from fascicle.forward.model import ForwardModel
from fascicle.forward.simulation_files import junctions, sites_table, write_beat
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import labelled_mesh
from fascicle.mesh.opencarp import write_values, write_vtx
from fascicle.networks.target_comparison import Network
from fascicle.purkinje.tree_files import directions, write_opencarp_tree

if TYPE_CHECKING:
    from pandas import DataFrame

Format = Literal["opencarp", "vtu", "csv"]
STIMULUS_STEP = 0.5  # ms; vertices that are stimulated within one step share a stimulus of openCARP


def write_networks(
    folder: Path, model: ForwardModel, networks: Mapping[str, Network], kind: Format
) -> None:
    """Write a heart, and a folder for each network by its name, as `FittedStudy.export` says.

    Of an atlas, each network's own heart is in the network's folder.
    """
    for name in networks:
        (folder / name).mkdir()
    if model.heart.atlas is None:
        _write_on_heart(folder, folder, model, networks, kind)
        return
    for name, network in networks.items():
        own = model.of_heart(network.parameters)
        _write_on_heart(folder / name, folder, own, {name: network}, kind)


def _write_on_heart(
    heart_folder: Path,
    folder: Path,
    model: ForwardModel,
    networks: Mapping[str, Network],
    kind: Format,
) -> None:
    """Write the heart of a model into its folder, and networks on it into theirs."""
    heart = model.heart
    conductions = {n: model.conduction.with_values(k.parameters) for n, k in networks.items()}
    if kind != "vtu":
        tags = tissue_tags(heart, conductions.values())
        if kind == "opencarp":
            tagged = replace(heart, regions=tags)
            write_opencarp(tagged, labelled_mesh(heart), heart_folder / "heart")
        else:
            _write_elements(heart_folder / "elements.csv", heart, tags)
    for name, network in networks.items():
        network_folder, simulation = folder / name, network.beat
        if kind == "vtu":
            write_beat(network_folder, heart, simulation)
            continue
        write_text(network_folder / "sites.csv", sites_table(simulation))
        tissues = tissue_table(heart, tags, conductions[name])
        if kind == "opencarp":
            mesh = "heart" if heart_folder == network_folder else "../heart"
            _write_opencarp_network(network_folder, model, simulation, tissues, mesh)
        else:
            _write_tables(network_folder, heart, simulation, tissues)


def tissue_tags(heart: Heart, conductions: Iterable[Conduction]) -> Integers:
    """Tags from 1 on (m,): elements of one tag have one region, and conduct alike in each network.

    A factor on the squared speeds, which varies through an endocardial layer, is rounded to 0.1.
    """
    tags = np.zeros(len(heart.tetrahedra), dtype=np.int64)
    if heart.regions is not None:
        tags = np.unique(heart.regions, return_inverse=True)[1]
    for conduction in conductions:
        scale = conduction.scale(heart)
        layer = conduction.diffusion_scale(heart) / np.where(scale > 0, scale, 1)
        if np.ptp(scale) or np.ptp(layer):
            rows = np.column_stack([tags, scale, layer.round(1)])
            tags = np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
    return np.asarray(tags + 1)


def tissue_table(heart: Heart, tags: Integers, conduction: Conduction) -> DataFrame:
    """Conductivities (S/m) and speeds (m/s) of each tag; those of scar are 0."""
    import pandas as pd

    _, first, which = np.unique(tags, return_index=True, return_inverse=True)
    scale = conduction.scale(heart)[first]
    squared = np.bincount(which, conduction.diffusion_scale(heart)) / np.bincount(which)
    along, across = conduction.speeds
    unit = 0.1  # S/m in 1 mS/cm
    return pd.DataFrame(
        {
            "tag": tags[first],
            "region": "" if heart.regions is None else heart.regions[first],
            "g_il_S_per_m": conduction.intracellular_l * scale * unit,
            "g_it_S_per_m": conduction.intracellular_t * scale * unit,
            "g_el_S_per_m": conduction.extracellular_l * scale * unit,
            "g_et_S_per_m": conduction.extracellular_t * scale * unit,
            "speed_along_m_per_s": along * np.sqrt(squared),
            "speed_across_m_per_s": across * np.sqrt(squared),
        }
    )


def fired_vertices(model: ForwardModel, simulation: Beat) -> tuple[Integers, Floats]:
    """Vertices through which junctions and stimuli activate the tissue, and the times (ms).

    The vertices are corners of the element around a junction or stimulus whose front arrives first.
    """
    myocardium, coupled = model.myocardium, simulation.coupled
    at_junctions = myocardium.owner[myocardium.on_surface(junctions(simulation)[0]).triangles]
    elements = np.concatenate([at_junctions, myocardium.inside(coupled.stimuli).elements])
    corners = myocardium.order[myocardium.mesh.corners[elements]]
    is_first = coupled.origin[corners] == np.arange(len(elements))[:, None]
    vertices = np.unique(corners[is_first])
    return vertices, simulation.activation[vertices]


def _write_opencarp_network(
    folder: Path, model: ForwardModel, simulation: Beat, tissues: DataFrame, mesh: str
) -> None:
    """Write openCARP's input for one network on a mesh, with times from 0 on."""
    vertices, times = fired_vertices(model, simulation)
    start = min(0.0, float(times.min()))
    steps, which = np.unique(np.rint((times - start) / STIMULUS_STEP), return_inverse=True)
    stimuli = {f"stimuli/{k:03d}.vtx": float(step * STIMULUS_STEP) for k, step in enumerate(steps)}
    for k, name in enumerate(stimuli):
        write_vtx(folder / name, vertices[which == k])
    activation = simulation.activation - start
    write_values(folder / "activation.dat", np.where(np.isfinite(activation), activation, -1))
    for tree, moments in zip(simulation.trees, simulation.coupled.trees, strict=True):
        stem = folder / f"{tree.side}_tree"
        write_opencarp_tree(stem, tree)
        moments = np.where(np.isfinite(moments), moments - start, -1)
        write_values(stem.with_name(f"{stem.name}_activation.dat"), moments)
    # 20 ms after the last activation
    end = float(np.ceil(activation[np.isfinite(activation)].max() + 20.0))
    conducting = tissues[tissues["g_il_S_per_m"] > 0]
    for kind in ("eikonal", "monodomain"):
        values = _parameters(kind == "eikonal", mesh, conducting, stimuli, end)
        lines = [
            f"# The {kind} model of one network. Run it in this folder: openCARP +F {kind}.par",
            f"# Time 0 is {start:g} ms in sites.csv.",
            *(f"{name} = {value}" for name, value in values),
        ]
        write_text(folder / f"{kind}.par", "\n".join(lines) + "\n")


def _parameters(
    eikonal: bool, mesh: str, tissues: DataFrame, stimuli: Mapping[str, float], end: float
) -> Iterator[tuple[str, object]]:
    """Names and values of openCARP's parameters; units follow as comments."""
    yield "meshname", f'"{mesh}"'
    yield "simID", '"eikonal"' if eikonal else '"monodomain"'
    yield "tend", f"{end:g}  # ms"
    yield "dt", "20  # us"
    for group in ("phys_region", "imp_region"):
        yield f"num_{group}s", 1
        yield f"{group}[0].name", '"myocardium"'
        yield f"{group}[0].num_IDs", len(tissues)
        for k, tag in enumerate(tissues["tag"]):
            yield f"{group}[0].ID[{k}]", tag
    yield "phys_region[0].ptype", "2  # eikonal" if eikonal else "0  # intracellular domain"
    yield "imp_region[0].im", "tenTusscherPanfilov"
    if eikonal:
        yield "dream.solve", "0  # activation times only"
        yield "dream.fim.max_iter", 10_000_000
        yield "dream.fim.tol", 0.001
    else:
        yield "bidomain", 0
        yield "num_LATs", 1
        for name, value in (("ID", '"activation"'), ("all", 0), ("measurand", 0), ("mode", 0)):
            yield f"lats[0].{name}", value
        yield "lats[0].threshold", "-20  # mV"
    yield "num_gregions", len(tissues)
    for k, row in enumerate(tissues.to_dict("records")):
        region = f"gregion[{k}]"
        yield f"{region}.name", f'"region {row["region"]}"' if row["region"] != "" else '"tissue"'
        yield f"{region}.num_IDs", 1
        yield f"{region}.ID[0]", row["tag"]
        for name in ("il", "it", "in", "el", "et", "en"):  # n: across the sheets, as t here
            value = row[f"g_{name.replace('n', 't')}_S_per_m"]
            yield f"{region}.g_{name}", f"{value:.6g}  # S/m"
        if eikonal:
            for name, way in (("l", "along"), ("t", "across"), ("n", "across")):
                speed = 1000.0 * row[f"speed_{way}_m_per_s"]  # mm/s
                yield f"{region}.dream.vel_{name}", f"{speed:.6g}  # mm/s"
    yield "num_stim", len(stimuli)
    for k, (file, time) in enumerate(stimuli.items()):
        stimulus = f"stim[{k}]"
        yield f"{stimulus}.elec.vtx_file", f'"{file}"'
        yield f"{stimulus}.crct.type", "0  # transmembrane current"
        yield f"{stimulus}.pulse.strength", "250  # uA/cm2"
        yield f"{stimulus}.ptcl.start", f"{time:g}  # ms"
        yield f"{stimulus}.ptcl.duration", "2  # ms"
        yield f"{stimulus}.ptcl.npls", 1


def _write_elements(path: Path, heart: Heart, tags: Integers) -> None:
    columns: dict[str, NDArray[Any]]
    columns = {f"node_{k + 1}": heart.tetrahedra[:, k] for k in range(4)}
    for name, axes in (("fibre", heart.fibres), ("sheet", heart.sheets)):
        if axes is not None:
            columns |= {f"{name}_{x}": axes[:, k] for k, x in enumerate("xyz")}
    _write_table(path, "element", {**columns, "tag": tags})


def _write_tables(folder: Path, heart: Heart, simulation: Beat, tissues: DataFrame) -> None:
    times = {"time_ms": simulation.activation}
    _write_table(folder / "activation.csv", "node", _positions(heart.vertices) | times)
    for tree, moments in zip(simulation.trees, simulation.coupled.trees, strict=True):
        columns = {
            "parent": tree.parents,
            **_positions(tree.nodes),
            "length_mm": tree.lengths,
            "time_ms": moments,
            "direction": directions(tree, moments),
        }
        _write_table(folder / f"{tree.side}_tree.csv", "node", columns)
    tissues.to_csv(folder / "conductivities.csv", index=False, float_format="%.6g")


def _positions(points: Floats) -> dict[str, NDArray[Any]]:
    return {f"{x}_mm": points[:, k] for k, x in enumerate("xyz")}


def _write_table(path: Path, numbered: str, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table whose rows are numbered from 0; infinite times stay empty."""
    import pandas as pd

    table = pd.DataFrame(columns).replace(np.inf, np.nan)
    table.to_csv(path, index_label=numbered, float_format="%.6f")
