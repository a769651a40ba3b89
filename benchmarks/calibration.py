"""Calibration of the posterior: how often its intervals hold the truth.

    python -m benchmarks.calibration --heart HEART --out FOLDER [--truths 100] [--processes 2]
                                     [--physics same|other]

Truths are drawn from the prior. Each gives a recording as the likelihood believes recordings to be:
the simulated ECG times a gain, with a discrepancy (its size is log-uniform from a quarter to all of
the signal, its correlation that of the likelihood), ten beats with noise of 0.03 mV, and QRS marks
that are off. A whole fit with default settings follows, but with `--bank` networks. Where the truth
lies among the draws is kept (`truth-0007.json`), so that the same command goes on where it stopped,
or adds truths.

With `--physics other` the truth is of another model than the one that is fitted: tetrahedra of half
the edge length, three left fascicles in every second truth, other anisotropy, a fast endocardial
layer, delays at the junctions, and electrodes that are off by some 10 mm and 8 degrees (in the
unbounded conductor). No discrepancy is added: the physics makes it.

Of the parameters and of four predictions: the total activation time; that with both roots fired
together, which no ECG of the fit has shown; where along the heart's longest axis the activation
ends; and the ECG's QRS duration. Of the activation map, the share of vertices whose time, from the
first activation on, lies within the interval at that vertex.

Printed are: coverage of the 50, 80 and 90 % intervals; for each quantity the largest distance of
the ranks' distribution from a uniform one, and what 95 % of calibrated methods stay below for all
quantities together; TARP (P. Lemos et al., "Sampling-based accuracy testing of posterior estimators
for general inference", ICML 2023); how many fits converged, and how often the alarm rang. The
figure (`calibration.png`) shows the ranks with the simultaneous band (T. Säilynoja et al.,
"Graphical test for discrete uniformity", Stat. Comput. 32, 2022). A bank of the heart is made first
if there is none.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

import fascicle
from fascicle.build.refinement import refined
from fascicle.cli.terminal_progress import TerminalProgress
from fascicle.core.files import write_text
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS, LIMB_LEADS, limb_leads_from
from fascicle.forward.likelihood import SHARES, discrepancy_in_time
from fascicle.forward.model import ForwardModel
from fascicle.forward.simulation import Simulation
from fascicle.heart.heart import Heart
from fascicle.recording.synthetic import smooth_noise
from fascicle.recording.target import Target
from fascicle.report.figures import new_figure, save
from fascicle.study.bank import Bank, make_bank
from fascicle.study.evaluations import Database, Journal
from fascicle.study.likelihood import PriorKnowledge, likelihood_of, prior_knowledge
from fascicle.study.posterior import Run
from fascicle.study.predictive import predict_recording
from fascicle.study.problem import Problem
from fascicle.study.settings import FitSettings
from fascicle.study.space import study_space
from fascicle.study.verdict import explained

LEVELS = (0.5, 0.8, 0.9)
BEATS, NOISE = 10, 0.03  # mV
ONSET_SD, OFFSET_SD = 4.0, 5.0  # ms
FIRST_ACTIVATION_SD = 3.0  # ms; as in the likelihood
PAD = 100  # samples before and after the simulated ECG
COLUMNS, PANEL = 6, 1.6  # of the figure; inch
MAPPED = 60  # draws whose activation is simulated
TOGETHER = {"root_time": 0.0}
PREDICTED = ("activation time", "with both roots together", "end along the axis", "QRS duration")


def truth_of(model: ForwardModel, space: Any, fixed: Any, rng: np.random.Generator) -> Any:
    """Parameters from the prior that give a network, and their simulation."""
    while True:
        point = rng.random(len(space))
        outcome = model.simulate({**fixed, **space.from_unit(point)})
        if isinstance(outcome, Simulation):
            return point, outcome


@lru_cache(1)
def finer(heart: str) -> Heart:
    """The heart with tetrahedra of half the edge length; the coarse vertices come first."""
    coarse = fascicle.load_heart(heart)
    fine = refined(coarse)
    if not np.allclose(fine.vertices[: len(coarse.vertices)], coarse.vertices):
        raise ValueError("the vertices of the coarser mesh are not the first of the finer one")
    return fine


def other_physics(heart: str, rng: np.random.Generator) -> tuple[ForwardModel, Any, Any]:
    """A model of the heart that is not the one that is fitted, and its own prior."""
    fine = finer(heart)
    if fine.lead_fields is None:
        turn = Rotation.from_rotvec(np.radians(rng.normal(0, 8 / np.sqrt(3), 3)))
        centre = fine.vertices.mean(axis=0)
        moved = turn.apply(fine.electrodes - centre) + centre + rng.normal(0, 10 / np.sqrt(3), 3)
        fine = replace(fine, electrodes=moved, folder=None)
    choices = {
        "anisotropy_ratio": rng.uniform(1.8, 3.5),
        "endocardial_layer": rng.uniform(1.0, 3.0),
        "endocardial_speed": rng.uniform(1.0, 2.0),
        "orthodromic_delay": rng.uniform(0.0, 3.0),
        "lv_fascicles": 2 + int(rng.integers(2)),
    }
    space, fixed = study_space("posterior", choices, fine)
    return ForwardModel(fine), space, fixed


def recorded(
    simulation: Simulation,
    known: PriorKnowledge,
    gain_sd: float,
    rng: np.random.Generator,
    discrepancy: bool = True,
) -> Target:
    """A recording of a simulation, as the likelihood believes it to be."""
    clean = rng.normal(1, gain_sd) * np.pad(
        simulation.leads[INDEPENDENT_ROWS], ((0, 0), (PAD, PAD))
    )
    times = np.arange(clean.shape[1]) - PAD + simulation.onset
    activated = simulation.activation[np.isfinite(simulation.activation)]
    first, last = float(activated.min()), float(activated.max())
    qrs = (times >= first) & (times <= last)
    share = np.exp(rng.uniform(np.log(SHARES[0]), np.log(SHARES[-1])))
    size = share * np.sqrt((clean[:, qrs] ** 2).mean())
    leads, within = (
        np.linalg.cholesky(known.pattern),
        np.linalg.cholesky(discrepancy_in_time(len(times)) + 1e-9 * np.eye(len(times))),
    )
    size *= discrepancy
    error = size * leads @ rng.standard_normal(clean.shape) @ within.T
    beats = clean + error + smooth_noise(rng, (BEATS, *clean.shape), NOISE)
    onset = first + rng.normal(0, np.hypot(ONSET_SD, FIRST_ACTIVATION_SD))
    end = max(last + rng.normal(0, OFFSET_SD), onset + 40)
    twelve = np.concatenate([_limb(beats[:, :2]), beats[:, 2:]], axis=1)
    return Target(twelve, times, onset, end, 60.0, {}, ONSET_SD, OFFSET_SD)


def _limb(first_two: np.ndarray) -> np.ndarray:
    padded = np.zeros((len(first_two), len(LIMB_LEADS), first_two.shape[2]))
    padded[:, :2] = first_two
    return np.asarray(limb_leads_from(INDEPENDENT_LEADS) @ padded)


def on_mesh(simulation: Simulation, count: int) -> Simulation:
    """The same with the activation of the first vertices only, those of the coarser mesh."""
    return replace(simulation, activation=simulation.activation[:count])


def predictions(simulation: Simulation, together: Simulation, axis: np.ndarray) -> np.ndarray:
    """The scalars of `PREDICTED`."""
    time = simulation.activation - simulation.activation.min()
    late = together.activation
    strength = np.sqrt((simulation.leads**2).sum(axis=0))
    above = np.flatnonzero(strength > 0.05 * strength.max())
    return np.array(
        [time.max(), late.max() - late.min(), axis[np.argmax(time)], above[-1] - above[0]]
    )


@lru_cache(1)
def prepared(heart_path: str, gain_sd: float) -> tuple[Any, ...]:
    """Heart, model, prior, bank, and what networks of the prior tell, once a process."""
    threadpool_limits(1)
    heart = fascicle.load_heart(heart_path)
    model = ForwardModel(heart)
    space, fixed = study_space("posterior", {}, heart)
    bank = Bank.beside(heart, space, fixed)
    # any target serves: what the prior tells depends on its leads, and on the length of its QRS
    rng = np.random.default_rng(0)
    _, some = truth_of(model, space, fixed, rng)
    flat = PriorKnowledge(np.eye(8), np.eye(8))
    target = recorded(some, flat, 0.0, rng)
    problem = Problem(model, target, space, gain_sd > 0, fixed=fixed)
    known = prior_knowledge(problem, np.array(INDEPENDENT_ROWS), rng)
    centred = heart.vertices - heart.vertices.mean(axis=0)
    axis = centred @ np.linalg.svd(centred[::50], full_matrices=False)[2][0]
    return model, space, fixed, bank, known, axis


def one_truth(heart: str, number: int, bank_size: int, physics: str) -> dict[str, Any]:
    """Make a truth, fit it, and say where it lies among the draws."""
    begun = time.perf_counter()
    settings = FitSettings(bank=bank_size)
    model, space, fixed, bank, known, axis = prepared(heart, settings.gain_sd)
    rng = np.random.default_rng([1, number])
    true = (model, space, fixed) if physics == "same" else other_physics(heart, rng)
    point, simulation = truth_of(*true, rng)
    target = recorded(simulation, known, settings.gain_sd, rng, physics == "same")
    likelihood = likelihood_of(target, known, settings.gain_sd)
    problem = Problem(model, target, space, True, fixed=fixed, likelihood=likelihood, bank=bank)
    with tempfile.TemporaryDirectory() as folder:
        database = Database(Path(folder) / "evaluations.sqlite")
        database.prepare()
        journal = Journal(database, problem, len(space), number, 1)
        posterior = Run(settings, space, journal).population()
    draws = {name: posterior.values[name] for name in space.names}
    truth = true[1].from_unit(point)
    chosen = rng.choice(len(posterior), MAPPED, replace=False)
    parameters = [posterior.parameters(int(k)) for k in chosen]
    networks = list(problem.networks(parameters))

    def together(values: Any) -> Simulation:
        return model.simulate({**fixed, **values, **TOGETHER})

    found = np.array([predictions(n.simulation, together(n.parameters), axis) for n in networks])
    paced = true[0].simulate({**true[2], **truth, **TOGETHER})
    expected = predictions(on_mesh(simulation, len(axis)), on_mesh(paced, len(axis)), axis)
    maps = np.array([n.simulation.activation - n.simulation.activation.min() for n in networks])
    true_map = simulation.activation[: len(axis)] - simulation.activation.min()
    checks = predict_recording(problem, likelihood, networks, rng).checks
    units = {name: space.parameters[k].to_unit(draws[name]) for k, name in enumerate(space.names)}
    return {
        "ranks": {
            **{name: _rank(draws[name], truth[name], rng) for name in space.names},
            **{name: _rank(found[:, k], expected[k], rng) for k, name in enumerate(PREDICTED)},
        },
        "map": [float(_within(maps, true_map, level)) for level in LEVELS],
        "tarp": _tarp(np.column_stack(list(units.values())), space.to_unit(truth), rng),
        "converged": posterior.converged,
        "explained": explained(checks),
        "evaluations": posterior.evaluations.tolist(),
        "effective": posterior.effective.tolist(),
        "contraction": {n: float(1 - 12 * np.var(u)) for n, u in units.items()},
        "seconds": time.perf_counter() - begun,
    }


def _rank(draws: np.ndarray, truth: float, rng: np.random.Generator) -> float:
    """Share of draws below the truth, with half an even chance for one more draw and for ties."""
    below, equal = (draws < truth).sum(), (draws == truth).sum()
    return float((below + rng.random() * (equal + 1)) / (len(draws) + 1))


def _within(maps: np.ndarray, truth: np.ndarray, level: float) -> float:
    lower, upper = np.quantile(maps, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return float(((truth >= lower) & (truth <= upper)).mean())


def _tarp(draws: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> float:
    """Share of draws that are nearer to a random reference point than the truth."""
    reference = rng.random(len(truth))
    apart = np.linalg.norm(draws - reference, axis=1)
    return _rank(apart, float(np.linalg.norm(truth - reference)), rng)


def coverage(ranks: np.ndarray, level: float) -> float:
    """Share of ranks within the central interval of a level."""
    return float((np.abs(ranks - 0.5) <= level / 2).mean())


def distance(ranks: np.ndarray) -> float:
    """Largest distance of the distribution of ranks from the uniform one (Kolmogorov)."""
    ordered, n = np.sort(ranks), len(ranks)
    return float(np.maximum(np.arange(1, n + 1) / n - ordered, ordered - np.arange(n) / n).max())


def simultaneous(count: int, quantities: int, rng: np.random.Generator) -> float:
    """Distance that 95 % of calibrated methods stay below in so many quantities at once."""
    drawn = [max(distance(rng.random(count)) for _ in range(quantities)) for _ in range(1000)]
    return float(np.quantile(drawn, 0.95))


def summarise(results: list[dict[str, Any]], folder: Path) -> None:
    """Print the tables and draw the figure."""
    names = list(results[0]["ranks"])
    ranks = {name: np.array([r["ranks"][name] for r in results]) for name in names}
    ranks["TARP"] = np.array([r["tarp"] for r in results])
    band = simultaneous(len(results), len(ranks), np.random.default_rng(0))
    print(f"{len(results)} truths; distance below {band:.3f} in all of {len(ranks)} quantities")
    print(f"{'':<26} {'50 %':>6} {'80 %':>6} {'90 %':>6} {'distance':>9} {'contraction':>12}")
    for name, values in ranks.items():
        shares = " ".join(f"{coverage(values, level):6.0%}" for level in LEVELS)
        narrowed = [r["contraction"][name] for r in results if name in r["contraction"]]
        mean = f"{np.mean(narrowed):12.2f}" if narrowed else f"{'':>12}"
        print(f"{name:<26} {shares} {distance(values):9.3f} {mean}")
    parameters = np.concatenate([ranks[name] for name in results[0]["contraction"]])
    predicted = np.concatenate([ranks[name] for name in PREDICTED])
    for name, values in (("all parameters", parameters), ("all predictions", predicted)):
        print(f"{name:<26} " + " ".join(f"{coverage(values, level):6.0%}" for level in LEVELS))
    maps = np.mean([r["map"] for r in results], axis=0)
    print(f"{'activation map, vertices':<26} " + " ".join(f"{share:6.0%}" for share in maps))
    for what in ("converged", "explained"):
        print(f"{what}: {np.mean([r[what] for r in results]):.0%}")
    evaluations = [sum(r["evaluations"]) for r in results]
    effective = [sum(r["effective"]) for r in results]
    seconds = [r["seconds"] for r in results]
    print(
        f"evaluations {np.median(evaluations):.0f} (median), effective sample "
        f"{np.median(effective):.0f}, {np.median(seconds):.0f} s on one core"
    )
    _draw(ranks, band, folder / "calibration.png")


def _draw(ranks: dict[str, np.ndarray], band: float, path: Path) -> None:
    """Distribution of the ranks less the uniform one, one panel a quantity."""
    rows = -(-len(ranks) // COLUMNS)
    figure = new_figure(COLUMNS * PANEL, rows * PANEL)
    axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True)
    grid = np.linspace(0, 1, 101)
    for (name, values), panel in zip(ranks.items(), axes.flat, strict=False):
        panel.axhspan(-band, band, color="0.9")
        apart = np.searchsorted(np.sort(values), grid, side="right") / len(values) - grid
        panel.plot(grid, apart)
        panel.set_title(name.replace("_", " "), fontsize=7)
        panel.set_ylim(-0.35, 0.35)
    for panel in list(axes.flat)[len(ranks) :]:
        panel.set_axis_off()
    figure.supxlabel("rank of the truth among the draws, share")
    figure.supylabel("share of truths below, less the share expected")
    save(figure, path)


def _run(arguments: tuple[str, int, int, str, str]) -> int:
    heart, number, bank, physics, path = arguments
    write_text(Path(path), json.dumps(one_truth(heart, number, bank, physics), indent=1) + "\n")
    return number


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--truths", type=int, default=100)
    parser.add_argument("--bank", type=int, default=FitSettings.model_fields["bank"].default)
    parser.add_argument("--physics", choices=("same", "other"), default="same")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with TerminalProgress() as progress:
        make_bank(given.heart, given.bank, progress=progress)
        paths = [given.out / f"truth-{number:04d}.json" for number in range(given.truths)]
        left = [
            (given.heart, number, given.bank, given.physics, str(path))
            for number, path in enumerate(paths)
            if not path.exists()
        ]
        with ProcessPoolExecutor(given.processes) as pool:
            for done, _ in enumerate(pool.map(_run, left), len(paths) - len(left) + 1):
                progress("truths", done, len(paths), "")
    summarise([json.loads(path.read_text()) for path in paths], given.out)


if __name__ == "__main__":
    main()
