"""Accuracy of the origin of a beat from its ECG: beats from anywhere, of another physics.

    python -m benchmarks.origins --heart HEART --out FOLDER [--physics 20] [--processes 1]

In each of so many draws of another physics (`benchmarks.calibration`: mesh, fibres, anisotropy,
endocardial layer, junction delays) ten networks are drawn from the prior; each has a beat from a
place of its own, drawn uniformly in the tissue, in a torso of its own. Kept is where `fascicle
locate` puts them, with default settings (`origins-000.json`), so that the same command goes on
where it stopped.

Printed are: the median distance from the most probable place, and how often it is below 10 and 20
mm; how often the regions of 50, 80 and 90 % hold the origin; how often the most probable ventricle,
wall and segment is the right one; how many are called unlike any simulated beat.
"""

from __future__ import annotations

import argparse
import gc
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import fascicle
from benchmarks.calibration import (
    HELD_OUT,
    SOURCES,
    another_torso,
    in_processes,
    other_physics,
    recorded,
)
from fascicle.cli.output import TerminalProgress
from fascicle.core.files import write_text
from fascicle.emulation.origin import Origin
from fascicle.forward.beat import Beat
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import His, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.heart.heart import Heart
from fascicle.networks.settings import FitSettings

SITES = 10  # in a draw of another physics
LEVELS = (0.5, 0.8, 0.9)


def one_physics(number: int, options: argparse.Namespace) -> None:
    """Make beats in a draw of another physics, and locate them."""
    path = options.out / f"origins-{number:03d}.json"
    if path.exists():
        return
    threadpool_limits(1)
    gc.collect()  # frees the gigabytes of the last draw
    rng = np.random.default_rng([HELD_OUT, number, 5])
    heart = fascicle.load_heart(options.heart)
    plain, (model, prior) = ForwardModel(heart), other_physics(options.heart, rng)
    # sources are as they are, as in the beats that `fascicle.locate` learns from
    fixed = {name: value for name, value in prior.fixed.items() if name not in SOURCES.names}
    centres = heart.vertices[heart.tetrahedra].mean(axis=1)
    judgements = []
    for site in rng.choice(len(centres), SITES, p=heart.volumes / heart.volumes.sum()):
        stimulus = Stimulus(time=0.0, position=tuple(centres[site].tolist()))
        beat = Scenario((His(time=np.inf), stimulus))
        simulation = None
        while not isinstance(simulation, Beat):
            values = {**fixed, **prior.space.from_unit(rng.random(len(prior.space)))}
            simulation = model.simulate(values, beat)
        if heart.lead_fields is not None:
            simulation = another_torso(plain, simulation, len(heart.vertices), rng, fixed)
        target = recorded(simulation, FitSettings().gain_sd, rng)
        judgements.append(
            judged(fascicle.locate(heart, target, workers=1, progress=None), int(site))
        )
    write_text(path, json.dumps(judgements, indent=1) + "\n")


def judged(origin: Origin, site: int) -> dict[str, Any]:
    """Distance of an answer from the true origin of the beat, and which of its parts are right."""
    heart: Heart = origin.heart
    centre = heart.vertices[heart.tetrahedra[site]].mean(axis=0)
    true = Origin(heart, np.eye(1, len(heart.tetrahedra), site)[0], 1.0, 0.0, {})
    right = {
        part: max(stated := getattr(origin, part), key=stated.__getitem__)
        == max(sure := getattr(true, part), key=sure.__getitem__)
        for part in ("ventricles", "walls", "segments")
    }
    return {
        "distance": float(np.linalg.norm(origin.place - centre)),
        "level": float(origin.levels[site]),
        "unlike": origin.caution is not None,
        **right,
    }


def print_accuracy(results: list[dict[str, Any]]) -> None:
    """Print how far from the true places beats are located, and how often regions hold them."""
    away = np.array([r["distance"] for r in results])
    level = np.array([r["level"] for r in results])
    shares = ", ".join(f"{name:.0%}: {np.mean(level < name):.0%}" for name in LEVELS)
    print(
        f"{len(results)} beats: median distance {np.median(away):.1f} mm, below 10 mm "
        f"{np.mean(away < 10):.0%}, below 20 mm {np.mean(away < 20):.0%}; regions {shares}"
    )
    for part in [name for name in ("ventricles", "walls", "segments") if name in results[0]]:
        print(f"most probable of the {part} right: {np.mean([r[part] for r in results]):.0%}")
    print(f"unlike any simulated beat: {np.mean([r['unlike'] for r in results]):.0%}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--physics", type=int, default=20, help="draws of it")
    parser.add_argument("--processes", type=int, default=1, help="2 GB each")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with TerminalProgress() as progress:
        judge = partial(one_physics, options=options)
        in_processes(judge, range(options.physics), options.processes, progress, "physics")
    paths = sorted(options.out.glob("origins-*.json"))
    print_accuracy([r for path in paths for r in json.loads(path.read_text())])


if __name__ == "__main__":
    main()
