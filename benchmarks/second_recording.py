"""Gain in precision by a paced beat beside the intrinsic one.

    python -m benchmarks.second_recording --out FOLDER [--heart HEART]

The known network of `examples.recover_known_network` gives two recordings, each of ten beats that
vary as recorded ones do: the intrinsic beat, and pacing of the right ventricular apex while no root
fires. Both are fitted together with default settings. For each parameter half the 90 % interval is
printed, of both recordings and of the first alone, with the truth and the median. Prior simulations
and emulators, one set for each scenario, are kept with the heart, and the study in the folder.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import fascicle
from examples.recover_known_network import TRUTH, synthetic_target
from fascicle.cli.output import TerminalProgress
from fascicle.forward.scenario_files import find_scenario, read_scenario
from fascicle.study.population import Posterior

PACED = "rv-apical-pacing"


def half_width(values: np.ndarray) -> float:
    lower, upper = np.percentile(values, [5, 95])
    return float(upper - lower) / 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--heart", default="default")
    arguments = parser.parse_args()
    model = fascicle.ForwardModel(fascicle.load_heart(arguments.heart))
    rng = np.random.default_rng(0)
    paced, _ = read_scenario(find_scenario(PACED))
    intrinsic, other = (
        synthetic_target(model.simulate(TRUTH, scenario).leads, rng) for scenario in (None, paced)
    )
    with TerminalProgress() as progress:
        fitted = fascicle.fit(
            model.heart, [intrinsic, (other, paced)], arguments.out, progress=progress
        )
    print(fitted.verdict)
    posterior = fitted.population
    assert isinstance(posterior, Posterior)
    alone = posterior.first_alone or {}
    print(f"{'':<22} {'both':>8} {'first':>8} {'truth':>8} {'median':>8}")
    for parameter in fitted.simulator.prior.learnt.parameters:
        name, values = parameter.name, posterior.values[parameter.name]
        first = half_width(alone[name]) if alone else np.nan
        print(
            f"{name:<22} {half_width(values):8.3g} {first:8.3g} {TRUTH[name]:8.3g} "
            f"{np.median(values):8.3g} {parameter.unit}"
        )


if __name__ == "__main__":
    main()
