"""The files of one simulation: activation, trees, ECG, summary."""

from __future__ import annotations

import json
from pathlib import Path

from fascicle.forward import Simulation
from fascicle.geometry.heart import Heart
from fascicle.io.atomic import atomic_folder, write_text
from fascicle.io.ecgs import write_ecg
from fascicle.io.meshes import TETRAHEDRON, write_grid
from fascicle.io.trees import write_tree


def summary(heart: Heart, simulation: Simulation, inputs: dict[str, object]) -> dict[str, object]:
    """A few numbers about a simulation, as written to `summary.json`."""
    sides: dict[str, object] = {}
    for tree, antidromic, distance in zip(
        simulation.trees,
        simulation.coupled.antidromic,
        simulation.coupled.junction_distances,
        strict=True,
    ):
        sides[tree.side] = {
            "nodes": len(tree.nodes),
            "length_mm": round(float(tree.lengths.sum()), 3),
            "junctions": len(tree.junctions),
            "antidromic_junctions": int(antidromic.sum()),
            "largest_junction_distance_mm": round(float(distance.max()), 4),
        }
    return {
        "heart": heart.name,
        "heart_sha256": heart.digest,
        "inputs": inputs,
        "qrs_duration_ms": simulation.qrs_duration,
        "total_activation_time_ms": round(simulation.total_activation_time, 3),
        "trees": sides,
    }


def write_simulation(
    heart: Heart, simulation: Simulation, folder: Path, inputs: dict[str, object]
) -> dict[str, object]:
    """Write a simulation's folder, whole or not at all; returns the summary."""
    content = summary(heart, simulation, inputs)
    with atomic_folder(folder) as temporary:
        write_activation(temporary / "activation.vtu", heart, simulation)
        for tree, times in zip(simulation.trees, simulation.coupled.trees, strict=True):
            write_tree(temporary / f"{tree.side}_tree.vtu", tree, times)
        write_ecg(temporary / "ecg.csv", simulation.ecg)
        write_text(temporary / "summary.json", json.dumps(content, indent=2) + "\n")
    return content


def write_activation(path: Path, heart: Heart, simulation: Simulation) -> None:
    """Write the activation map (ms) on the heart's mesh, with the fibres."""
    write_grid(
        path,
        heart.vertices,
        heart.tetrahedra,
        TETRAHEDRON,
        point_data={"activation": simulation.activation},
        cell_data={"fibre": heart.fibres},
    )
