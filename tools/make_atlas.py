"""Make the hearts of the atlas and the simulations from which its emulators learn.

    python tools/make_atlas.py template --surface heart.vtp --out FOLDER
    python tools/make_atlas.py simulate --out FOLDER [--hearts 64] [--processes 2]

The surface is the mean of more than 1000 healthy hearts, `examples/geo1/heart.vtp` of Cobiveco
(Apache-2.0). Hearts are independent of each other; those that are there are not made again.
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from fascicle.atlas.population import AtlasHeart, drawn_hearts
from fascicle.atlas.shapes import HeartFamily
from fascicle.atlas.torsos import heart_in_torso, lead_fields_in_torsos
from fascicle.build.build_heart import TorsoOptions, heart_of, in_torso
from fascicle.build.labelled_files import Anatomy, labelled_surface
from fascicle.build.meshing import filled
from fascicle.build.surface_repair import prepared_surface
from fascicle.core.conduction_states import told_apart
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_ROWS
from fascicle.emulation.heart_emulator import usual_prior
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import build_electrocardiograph, nodal_gradients
from fascicle.forward.loss import placed
from fascicle.forward.model import ForwardModel
from fascicle.forward.preparation import build
from fascicle.forward.template import default_template
from fascicle.heart.conduction import Conduction
from fascicle.heart.coordinates import with_coordinates
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import LeadFields
from fascicle.mesh.measures import barycentric_gradients
from fascicle.mesh.read import read_mesh
from fascicle.networks.prior import TISSUES, AveragedOver
from fascicle.networks.prior_simulations import BEFORE
from fascicle.torso.lead_fields import key_of, torso_key

EDGE_LENGTH = 4.0  # mm
TORSOS = 8  # variations of each torso
NORMAL, MOST, OTHERS = 400, 1400, 150  # networks wanted, tried at most, and of each other state
LENGTH = 300  # samples (ms) of an ECG
SEED = 20261129


def template(surface: Path, out: Path) -> None:
    """Mesh the surface, coarsely: one tetrahedron across the right ventricle's free wall."""
    labelled = labelled_surface(read_mesh(surface, "anatomy"), None, None, None)
    mesh = filled(prepared_surface(labelled), EDGE_LENGTH)
    heart, _ = with_coordinates(heart_of(Anatomy(mesh), name="atlas"), mesh)
    heart, _ = in_torso(heart, mesh, TorsoOptions())
    write_heart(heart, out / "template")


def simulate(number: int, out: Path, described: AtlasHeart) -> str:
    """Make a heart of the atlas and simulate networks in it."""
    path = out / f"{number:03d}.npz"
    if path.exists():
        return f"{number}: there"
    began = time.perf_counter()
    rng = np.random.default_rng([SEED, number])
    family = HeartFamily.of(load_heart(out / "template"))
    try:
        heart = heart_in_torso(family, described, f"atlas {number}")
    except InputError as error:
        path.with_suffix(".txt").write_text(f"{error}\n", encoding="utf-8")
        return f"{number}: {error}"
    conduction = Conduction.of(heart).with_values(TISSUES[described.tissue])
    conduction = replace(conduction, alpha=Conduction.of(heart).alpha)
    fields = lead_fields_in_torsos(heart, conduction, rng, TORSOS)
    meshed = time.perf_counter() - began
    standard = LeadFields(fields[0], key_of(heart, conduction), torso_key(heart.torso))
    heart = replace(heart, lead_fields=standard)
    potential = default_template()
    prepared = build(heart, conduction, potential)
    model = ForwardModel(heart, conduction, prepared=prepared)
    gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
    torsos = [
        build_electrocardiograph(
            heart.tetrahedra, gradients, heart.volumes, conduction.intracellular(heart.fibres),
            nodal_gradients(field, heart.tetrahedra, gradients), potential, [],
        )  # fmt: skip
        for field in fields[1:]
    ]
    arrays: dict[str, np.ndarray] = {
        "vertices": heart.vertices.astype(np.float32),
        "fields": fields.astype(np.float32),
        "electrodes": heart.electrodes,
        "volumes": family.volumes(heart.vertices),
    }
    counts = {}
    for index, state in enumerate(told_apart()):
        usual = usual_prior(heart, state)
        averaged = AveragedOver(usual.averaged.space, (TISSUES[described.tissue],))
        prior = replace(usual, averaged=averaged)
        points, feasible, kept, ecgs, in_torsos, which, times = [], [], [], [], [], [], []
        wanted = NORMAL if prior.mapped else OTHERS
        while sum(kept) < wanted and len(points) < MOST:
            point = prior.sample(rng, 1)[0]
            values = prior.from_unit(point)
            beat = model.simulate(values)
            points.append(point)
            feasible.append(isinstance(beat, Beat))
            kept.append(False)
            if not isinstance(beat, Beat):
                continue
            kept[-1] = prior.keeps(point, model.surfaces, beat)
            which.append(int(rng.integers(TORSOS)))
            torso = model.with_sources(torsos[which[-1]], values)
            for leads, to in ((beat.leads, ecgs), (torso.leads(beat.activation), in_torsos)):
                begin = beat.first_activation - BEFORE
                to.append(placed(leads[[*INDEPENDENT_ROWS]], begin, LENGTH).astype(np.float16))
            times.append(float(beat.total_activation_time))
        arrays |= {
            f"{index} points": np.array(points), f"{index} feasible": np.array(feasible),
            f"{index} kept": np.array(kept), f"{index} ecgs": np.array(ecgs),
            f"{index} in torsos": np.array(in_torsos), f"{index} torsos": np.array(which),
            f"{index} times": np.array(times),
        }  # fmt: skip
        counts[state.name] = f"{sum(kept)}/{sum(feasible)}/{len(points)}"
    text = json.dumps({**asdict(described), "axis": [*described.axis], "shift": [*described.shift],
                       "trunk": [*described.trunk]})
    part = out / f".{number:03d}.npz"
    np.savez_compressed(part, described=np.array(text), **arrays)
    part.rename(path)
    whole = time.perf_counter() - began
    return f"{number}: torso {meshed:.0f} s, whole {whole:.0f} s, {counts}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("step", choices=("template", "simulate"))
    parser.add_argument("--surface", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--hearts", type=int, default=64)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.step == "template":
        template(options.surface, options.out)
        return
    hearts = zip(range(options.hearts), drawn_hearts(SEED, len(TISSUES)), strict=False)
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        runs = [pool.submit(simulate, number, options.out, heart) for number, heart in hearts]
        for run in runs:
            print(run.result(), flush=True)


if __name__ == "__main__":
    main()
