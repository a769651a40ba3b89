"""Dependence of the template U on steps, cable, pacing, cell type, and where it stops.

    python -m benchmarks.cable

Two tables. The first changes one setting of `simulate_cable` at a time and prints how speed,
maximum upstroke and U change against the defaults, the baseline. The second puts templates into
the packaged heart with the example parameters and compares each QRS with that of the same template
until 350 ms, and prints the largest lead some ms after the last activation, where the ST segment
should be flat. The figures in the docstrings of `fascicle.forward.cable` are from here. Run from
the root of the repository.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.references import Upstroke
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.beat import Beat
from fascicle.forward.cable import max_upstroke, simulate_cable
from fascicle.forward.electrocardiogram import ActionPotential
from fascicle.forward.model import ForwardModel
from fascicle.forward.template import CableTemplate, template_of
from fascicle.heart.folder import load_heart
from fascicle.kernels.ten_tusscher import CELLS

CHANGES: dict[str, dict[str, float]] = {
    "defaults": {},
    "dt halved": {"step": 0.005, "duration": 100.0},
    "dx halved": {"spacing": 0.025, "duration": 100.0},
    "both halved": {"step": 0.005, "spacing": 0.025, "duration": 100.0},
    "30 mm": {"length": 30.0, "duration": 100.0},
    "5 beats": {"beats": 5, "duration": 100.0},
    "100 beats": {"beats": 100, "duration": 100.0},
}
TIMES = np.linspace(-4.0, 60.0, 6401)  # ms
PLATEAU = 2.0  # ms; from here on a shift of the upstroke no longer matters
LONGEST = 350.0  # ms, before any cell of the packaged heart repolarises within its QRS
UNTIL = (LONGEST, 60.0, 40.0, 25.0)  # ms
AFTER = (5, 10, 20)  # ms after the last activation


def print_settings() -> None:
    """First table."""
    print(f"{'':<14}{'speed':>9}{'upstroke':>10}{'U, largest':>12}{'after 2 ms':>12}")
    baseline = None
    for name, change in CHANGES.items():
        run = simulate_cable(CELLS["endocardial"], **change)
        potential = template_of(run, "endocardial")(TIMES)
        baseline = potential if baseline is None else baseline
        difference = np.abs(potential - baseline)
        print(
            f"{name:<14}{run.speed:>9.5f}{max_upstroke(run.time, run.potential)[0]:>10.2f}"
            f"{difference.max():>12.3f}{difference[TIMES > PLATEAU].max():>12.4f}",
            flush=True,
        )


def print_ecgs() -> None:
    """Second table."""
    heart = load_heart("default")
    header = "".join(f"{f'J + {after} ms':>12}" for after in AFTER)
    print(f"\n{'template':<24}{'peak, mV':>10}{'QRS change':>12}{header}")

    def show(name: str, potential: ActionPotential, before: Beat | None) -> Beat:
        model = ForwardModel(heart, action_potential=potential)
        simulation = model.simulate(EXAMPLE_PARAMETERS)
        last = int(simulation.activation[~simulation.unreached].max() - simulation.onset)
        leads = np.pad(simulation.leads, ((0, 0), (0, max(AFTER) + 1)))
        change = 0.0
        if before is not None:
            change = np.abs(leads[:, : last + 1] - before.leads[:, : last + 1]).max()
        segment = "".join(f"{np.abs(leads[:, last + after]).max():>12.4f}" for after in AFTER)
        print(f"{name:<24}{np.abs(leads).max():>10.3f}{change:>12.4f}{segment}", flush=True)
        return simulation

    show("tanh, 1 ms", Upstroke(), None)
    for cell in CELLS:
        template: CableTemplate = template_of(simulate_cable(CELLS[cell]), cell, LONGEST)
        longest = None
        for until in UNTIL:
            cut = replace(template, until=until)
            simulation = show(f"{cell}, {until:g} ms", cut, longest)
            longest = simulation if longest is None else longest


if __name__ == "__main__":
    print_settings()
    print_ecgs()
