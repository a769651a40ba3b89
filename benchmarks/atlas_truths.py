"""Fits on the atlas of recordings simulated on real hearts that it was not made of.

    python -m benchmarks.atlas_truths --data DATA_FOLDER --out FOLDER [--truths 30] [--first 0]
    python -m benchmarks.atlas_truths --data DATA_FOLDER --out FOLDER --origins 30

The hearts are a patient's (`crtdemo`) and one of a cohort (`rodero01`); no heart of the atlas is
made of them, and no constant is chosen on them. (The size of the atlas's discrepancy was chosen on
`--hearts default camps-dti004`.) Each truth is a network of the prior, normal or with a left bundle
branch block in turn, on one of the hearts, in a random variation of its torso, recorded with noise.
It is fitted on the atlas without a word of the person, its conduction state given. Printed is how
often the 90 % intervals hold the true parameters, the true change of the total activation time and
of the global QRS by pacing, and the true activation of vertices, carried to the atlas by
ventricular coordinates. With `--origins`, so many beats from places drawn uniformly in these hearts
are located instead; printed is how far from the true place, carried to the atlas, and how often the
regions hold it. Results are kept in a file a truth, so that the same command goes on where it
stopped.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

import fascicle
from benchmarks.calibration import coverage, recorded
from benchmarks.origins import print_accuracy
from fascicle.atlas.population import NETWORK_HEIGHTS
from fascicle.build.build_heart import TorsoOptions, build_heart, in_torso
from fascicle.build.read_anatomy import Source
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.files import write_text
from fascicle.emulation.heart_emulator import usual_prior
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import build_electrocardiograph, nodal_gradients
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import His, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.heart.assembly import assemble_heart
from fascicle.heart.atlas import with_bare_base
from fascicle.heart.conduction import Conduction
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import labelled_mesh
from fascicle.heart.sites import CoordinateSite
from fascicle.mesh.measures import barycentric_gradients
from fascicle.mesh.read import read_mesh
from fascicle.networks.prior import Prior
from fascicle.networks.settings import FitSettings
from fascicle.torso.conductor import torso_of
from fascicle.torso.training import lead_fields_in_torsos

HEARTS = ("crtdemo", "rodero01")
STATES = ("normal", "left bundle branch block")
# from the right apex, near the septum, at the same ventricular coordinates in all hearts
APEX = CoordinateSite("rv", apicobasal=0.1, rotational=0.9, transmural=1.0)
PACING = {
    "normal": Scenario((Stimulus(time=0.0, site=APEX), His(time=np.inf))),
    "left bundle branch block": fascicle.read_scenarios(["left-bundle-branch-pacing"]).popitem()[1],
}
TORSOS = 6
SEED = 52
GAINS = ("total_activation_time", "qrs_duration")


def heart_of(name: str, data: Path, out: Path) -> Heart:
    """One of the real hearts in its torso, built once."""
    folder = out / name
    if (folder / "heart.toml").exists():
        return load_heart(folder)
    files = data / "hearts" / name
    if name not in HEARTS:
        heart = fascicle.load_heart(name)
        heart = replace(heart, torso=heart.torso or torso_of(heart), folder=None)
    elif name == "rodero01":
        file = files / "rodero_01_fullheart_2.0mm.vtu"
        source = Source(file, regions={"lv": (1,), "rv": (2,), "septum": (7,)})
        # the rule for roots took the outflow tract of this whole heart for the right apex
        seeds = {"lv": (None, None), "rv": (None, (75.3, 39.6, 36.0))}
        heart = build_heart(source, seeds=seeds, name=name).heart
    else:
        heart = assemble_heart(
            mesh=read_mesh(files / "crtdemo_mesh_oriented.vtk", "mesh"),
            fibres=read_mesh(files / "crtdemo_f0_oriented.vtk", "fibres"),
            surfaces={
                side: read_mesh(files / f"crtdemo_{side.upper()}endo_heart_cut.obj", side)
                for side in ("lv", "rv")
            },
            seeds={"lv": (388, 412), "rv": (198, 186)},
            electrodes=files / "electrodes_mm.csv",
            name=name,
        )
        options = TorsoOptions(electrodes=files / "electrodes_mm.csv")
        heart, _ = in_torso(heart, labelled_mesh(heart), options)
    write_heart(heart, folder)
    return load_heart(folder)


@lru_cache(3)
def world(name: str, data: Path, out: Path) -> tuple[ForwardModel, list[Any]]:
    """Forward model of a heart, without Purkinje fibres at its base, and in random torsos."""
    height = np.random.default_rng([SEED, crc32(name.encode())]).uniform(*NETWORK_HEIGHTS)
    heart = with_bare_base(heart_of(name, data, out), height)
    model, conduction = ForwardModel(heart), Conduction.of(heart)
    fields = lead_fields_in_torsos(heart, conduction, np.random.default_rng(SEED), TORSOS)
    gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
    mesh = heart.tetrahedra, gradients, heart.volumes, conduction.intracellular(heart.fibres)
    return model, [
        build_electrocardiograph(
            *mesh, nodal_gradients(field, heart.tetrahedra, gradients), model.action_potential, []
        )
        for field in fields[1:]
    ]


def prior_of(heart: Heart, state: str) -> Prior:
    """Prior of a state in a heart, with the activation sequences of an atlas (`Prior.keeps`)."""
    prior = usual_prior(heart, CONDUCTION_STATES[state])
    count = len(prior.averaged.tissues)
    return replace(prior, averaged=replace(prior.averaged, weights=(1 / count,) * count))


def one_truth(number: int, options: argparse.Namespace) -> None:
    """Make a truth, fit its recording, and write where the truth lies among the draws."""
    result = options.out / f"{number:03d}.json"
    if result.exists():
        return
    rng = np.random.default_rng([SEED, number])
    names = options.hearts
    name, state = names[number % len(names)], STATES[number // len(names) % len(STATES)]
    model, torsos = world(name, options.data, options.out)
    prior = prior_of(model.heart, state)
    while True:
        point = prior.sample(rng, 1)[0]
        values = prior.from_unit(point)
        beat = model.simulate(values)
        if isinstance(beat, Beat) and prior.keeps(point, model.surfaces, beat):
            break
    torso = model.with_sources(torsos[rng.integers(TORSOS)], values)
    simulation = replace(beat, leads=torso.leads(beat.activation))
    target = recorded(simulation, FitSettings().gain_sd, rng)
    paced = model.activate(beat.trees, scenario=PACING[state], **values)
    paced = replace(paced, leads=torso.leads(paced.activation))
    atlas = fascicle.load_heart("atlas")
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fitted = fascicle.fit(
            atlas, target, Path(folder) / "study", parameters={"conduction": state},
            effective=options.effective, progress=None,
        )  # fmt: skip
        seconds = time.perf_counter() - began
        networks = fitted.networks(None)
        predicted = fascicle.predict(fitted, {"pacing": PACING[state]}, None, networks)
    draws = fitted.population.values
    ranks = {n: float((draws[n] < values[n]).mean()) for n in draws}
    change = {}
    for index in GAINS:
        true = getattr(paced, index) - getattr(simulation, index)
        drawn = predicted["pacing"].indices[index] - predicted["intrinsic"].indices[index]
        ranks[f"change of {index}"] = float((drawn < true).mean())
        change[index] = [float(true), *map(float, np.percentile(drawn, (5, 50, 95)))]
    true_map = beat.activation - beat.activation.min()
    carried = fascicle.transfer_map(true_map, model.heart, atlas)
    maps = np.array([n.beat.activation - n.beat.activation.min() for n in networks])
    low, median, high = np.percentile(maps, (5, 50, 95), axis=0)
    content = {
        "heart": name,
        "state": state,
        "verdict": fitted.verdict,
        "converged": fitted.statements.converged,
        "acceptable": fitted.statements.acceptable,
        "seconds": seconds,
        "ranks": ranks,
        "change": change,
        "map": float(((carried >= low) & (carried <= high)).mean()),
        "map_error": float(np.sqrt(((median - carried) ** 2).mean())),
        "map_bias": float((median - carried).mean()),
        "map_width": float((high - low).mean()),
    }
    write_text(result, json.dumps(content, indent=1) + "\n")
    print(f"{number}: {name}, {state}: {fitted.verdict}; map {content['map']:.0%}", flush=True)


def one_origin(number: int, options: argparse.Namespace) -> None:
    """Make a beat from anywhere in a real heart, locate it on the atlas, and write how well."""
    result = options.out / f"origin-{number:03d}.json"
    if result.exists():
        return
    rng = np.random.default_rng([SEED, number, 1])
    name = options.hearts[number % len(options.hearts)]
    model, torsos = world(name, options.data, options.out)
    prior, heart = usual_prior(model.heart), model.heart
    site = rng.choice(len(heart.tetrahedra), p=heart.volumes / heart.volumes.sum())
    place = heart.vertices[heart.tetrahedra[site]].mean(axis=0)
    stimulus = Stimulus(time=0.0, position=tuple(place.tolist()))
    scenario = Scenario((His(time=np.inf), stimulus))
    beat = None
    while not isinstance(beat, Beat):
        values = prior.from_unit(prior.sample(rng, 1)[0])
        beat = model.simulate(values, scenario)
    torso = model.with_sources(torsos[rng.integers(TORSOS)], values)
    beat = replace(beat, leads=torso.leads(beat.activation))
    target = recorded(beat, FitSettings().gain_sd, rng)
    atlas = fascicle.load_heart("atlas")
    origin = fascicle.locate(atlas, target, progress=None)
    away = np.linalg.norm(heart.vertices - place, axis=1)
    true = int(np.argmin(fascicle.transfer_map(away, heart, atlas)))
    content = {
        "heart": name,
        "verdict": origin.verdict,
        "unlike": origin.caution is not None,
        "distance": float(np.linalg.norm(origin.place - atlas.vertices[true])),
        "level": float(origin.levels[(atlas.tetrahedra == true).any(axis=1)].mean()),
    }
    write_text(result, json.dumps(content, indent=1) + "\n")
    print(f"{number}: {name}: {content['distance']:.0f} mm, {origin.verdict}", flush=True)


def summarise(results: list[dict[str, Any]]) -> None:
    """Print how often intervals hold the truth."""
    pacing = [n for n in results[0]["ranks"] if n.startswith("change")]
    parts = {
        "parameters": lambda n: not n.startswith("change"),
        **{n: (lambda m, n=n: m == n) for n in pacing},
    }
    for title, chosen in parts.items():
        ranks = np.array([v for r in results for n, v in r["ranks"].items() if chosen(n)])
        print(f"{title}: 90 % intervals hold {coverage(ranks, 0.9):.0%} of {len(ranks)}")
    for name in ("all", *sorted({r["heart"] for r in results})):
        share, error, bias, width = (
            np.mean([r[key] for r in results if name in ("all", r["heart"])])
            for key in ("map", "map_error", "map_bias", "map_width")
        )
        print(
            f"map, {name}: {share:.0%} of the vertices; intervals {width:.0f} ms wide, their "
            f"median off by {error:.0f} ms (root mean square), {bias:+.0f} ms on average"
        )
    print(
        f"{np.mean([r['converged'] for r in results]):.0%} converged, "
        f"{np.mean([r['acceptable'] for r in results]):.0%} acceptable; "
        f"{np.median([r['seconds'] for r in results]):.0f} s a fit (median)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--hearts", nargs="+", default=HEARTS)
    parser.add_argument("--truths", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--origins", type=int, default=0)
    parser.add_argument("--effective", type=int, default=100)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.origins:
        for number in range(options.origins):
            one_origin(number, options)
        paths = [options.out / f"origin-{number:03d}.json" for number in range(options.origins)]
        print_accuracy([json.loads(path.read_text(encoding="utf-8")) for path in paths])
        return
    numbers = range(options.first, options.first + options.truths)
    for number in numbers:
        one_truth(number, options)
    paths = [options.out / f"{number:03d}.json" for number in numbers]
    summarise([json.loads(path.read_text(encoding="utf-8")) for path in paths])


if __name__ == "__main__":
    main()
