"""One simulation, drawn: its ECG and its activation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fascicle.core.leads import LEADS
from fascicle.forward.simulation import Simulation
from fascicle.heart.heart import Heart
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.figures import save
from fascicle.reporting.hearts import ActivationRow, activation_figure, total_time
from fascicle.reporting.style import VERMILION


def draw_simulation(
    heart: Heart, simulation: Simulation, folder: Path, kind: str, time_zero: str
) -> list[Path]:
    """Write ``ecg`` and ``activation`` into a simulation's folder.

    Parameters
    ----------
    heart, simulation : Heart, Simulation
        What was simulated.
    folder : Path
        Where to.
    kind : str
        Of the files: ``"png"``, ``"svg"`` or ``"pdf"``.
    time_zero : str
        What happens at time 0.

    Returns
    -------
    list of Path
        What was written.
    """
    ecg = simulation.ecg.sel(lead=list(LEADS))
    time, leads = ecg["time"].to_numpy(), ecg.to_numpy()[None]
    group = EcgGroup("simulated", "network", time, leads, VERMILION)
    trees = tuple(zip(simulation.trees, simulation.coupled.trees, strict=True))
    row = ActivationRow(
        total_time(simulation.total_activation_time), np.asarray(simulation.activation), trees
    )
    return [
        save(ecg_figure([group], "Simulated ECG", time_zero=time_zero), folder / f"ecg.{kind}"),
        save(
            activation_figure(heart, [row], f"activation (ms)\n0: {time_zero}"),
            folder / f"activation.{kind}",
        ),
    ]
