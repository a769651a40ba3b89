"""Find a known network again.

Simulates the ECG of a known network, makes noisy beats of it, fits, and compares the
population with the truth. On the packaged heart:

    python examples/recover_known_network.py --out recovered

On a heart of your own, with the truth in a parameter file:

    python examples/recover_known_network.py --heart HEART --truth truth.toml --out recovered
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fascicle
from fascicle.core.parameters import read_parameters
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.recording.target import Target, smooth_noise
from fascicle.recording.window import qrs_window
from fascicle.reporting.parameters import pair_figure
from fascicle.reporting.study import drawings, write_figures
from fascicle.reporting.style import save
from fascicle.study.fit import fit
from fascicle.study.fitted import FittedStudy

MARGIN = 60  # samples before and after the simulated ECG

# Well inside the ranges; the left ventricle begins 20 ms after the right one, a left bundle branch
# delay. The sources are as the prior averages over them.
TRUTH = {
    "lv_initial_length": 12.0,
    "rv_initial_length": 47.0,
    "lv_fascicle_length_1": 35.0,
    "lv_fascicle_length_2": 12.0,
    "lv_fascicle_length_3": 35.0,
    "rv_fascicle_length_1": 17.0,
    "rv_fascicle_length_2": 17.0,
    "lv_fascicle_direction_1": 1.05,
    "lv_fascicle_direction_2": 0.0,
    "lv_fascicle_direction_3": -1.1,
    "rv_fascicle_angle_1": -1.0,
    "rv_fascicle_angle_2": 1.0,
    "interventricular_delay": -20.0,
    "cv": 2.5,
    "fibre_speed": 0.6,
    "rv_source": 0.35,
    "axial_source": 0.25,
}


def synthetic_target(
    leads: NDArray[np.float64],
    rng: np.random.Generator,
    beats: int = 10,
    noise: float = 0.03,
    amplitude_spread: float = 0.05,
) -> Target:
    """Beats of a simulated QRS that vary as recorded ones do: in amplitude and by noise.

    By default they vary by about 0.04 mV (standard deviation within the QRS), as in clinical
    10 s recordings.

    Parameters
    ----------
    leads : (12, n) array
        Simulated ECG (mV), every `SAMPLING_STEP`.
    rng : numpy.random.Generator
        Source of the variation.
    beats : int
        Number of beats.
    noise : float
        Standard deviation of additive noise (mV), smooth over a few ms.
    amplitude_spread : float
        Relative standard deviation of a beat's amplitude, all leads together.
    """
    clean = np.pad(leads, ((0, 0), (MARGIN, MARGIN)))
    onset, offset = qrs_window(clean)
    peak = int(np.argmax((clean**2).sum(axis=0)))
    smooth = smooth_noise(rng, (beats, *clean.shape), noise)
    amplitude = 1 + amplitude_spread * rng.standard_normal((beats, 1, 1))
    time = SAMPLING_STEP * (np.arange(clean.shape[1], dtype=np.float64) - peak)
    return Target(
        beats=amplitude * clean + smooth,
        time=time,
        qrs_onset=float(time[onset]),
        qrs_offset=float(time[offset]),
        heart_rate=60.0,
        provenance={"source": "simulated"},
    )


def recover(
    heart: str, truth: Mapping[str, float], out: Path, seed: int, **budget: int
) -> FittedStudy:
    model = fascicle.ForwardModel(fascicle.load_heart(heart))
    simulation = model.simulate(truth)
    if isinstance(simulation, fascicle.Infeasible):
        raise fascicle.InputError(f"truth: {simulation.reason}; choose another")
    target = synthetic_target(simulation.ecg.to_numpy(), np.random.default_rng(seed))
    return fit(model.heart, target, out, seed=seed, **budget)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", default="default")
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--effective", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    truth = read_parameters(arguments.truth) if arguments.truth else TRUTH
    fitted = recover(
        arguments.heart, truth, arguments.out, arguments.seed, effective=arguments.effective
    )
    population = fitted.population
    truth = dict.fromkeys(population.values, np.nan) | dict(truth)  # it may have other parameters
    print(fitted.verdict)
    print(f"{'':<22} {'true':>8} {'median':>8} {'5 %':>8} {'95 %':>8}")
    for parameter in fitted.simulator.prior.learnt.parameters:
        values = population.values[parameter.name]
        print(
            f"{parameter.name:<22} {truth[parameter.name]:8.3g} {np.median(values):8.3g} "
            f"{np.percentile(values, 5):8.3g} {np.percentile(values, 95):8.3g} {parameter.unit}"
        )
    drawn = drawings(fitted, fitted.networks())
    write_figures(drawn, fitted.folder / "figures", ["png"])
    pairs = pair_figure(fitted.simulator.prior.learnt, population.values, population.best, truth)
    save(pairs, fitted.folder / "figures" / "pairs_with_truth.png")


if __name__ == "__main__":
    main()
