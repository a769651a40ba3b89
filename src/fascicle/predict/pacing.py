"""Conduction-system pacing: every network of a population, its roots fired at a given delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.progress import Progress, stage_progress
from fascicle.forward.ecg.electrocardiogram import STEP
from fascicle.forward.model import ForwardModel
from fascicle.forward.simulation import Simulation
from fascicle.recording.window import qrs_window
from fascicle.study.bank import prior_points
from fascicle.study.problem import Network, Problem

LEAD_IN = 10  # samples before the QRS onset
PRIOR_NETWORKS, PART = 60, 10  # networks, and how many at a time


@dataclass(frozen=True)
class Pacing:
    """What pacing changes in each network, as a table of arrays of shape (n,).

    Attributes
    ----------
    before, after : sequence of Simulation
        Every network as it is, and paced.
    qrs_before, qrs_after : (n,) arrays
        QRS duration (ms).
    tat_before, tat_after : (n,) arrays
        Total activation time, first to last vertex (ms).
    """

    before: Sequence[Simulation]
    after: Sequence[Simulation]
    qrs_before: Floats
    qrs_after: Floats
    tat_before: Floats
    tat_after: Floats

    def extremes(self) -> dict[str, int]:
        """Networks with the least, the median and the largest total activation time when paced."""
        order = np.argsort(self.tat_after, kind="stable")
        return {
            "minimum": int(order[0]),
            "median": int(order[(len(order) - 1) // 2]),
            "maximum": int(order[-1]),
        }


def pace(model: ForwardModel, networks: Sequence[Network], root_time: float) -> Pacing:
    """Fire both roots of every network at a given delay and compare.

    The trees stay as they were learnt; only when their roots fire changes, as in section 3.3 of
    the paper.

    Parameters
    ----------
    model : ForwardModel
        The heart that the networks were learnt on.
    networks : sequence of Network
        The n networks of a population.
    root_time : float
        t_RV − t_LV of the paced roots (ms); 0 fires both together.
    """
    before = [network.simulation for network in networks]
    after = [
        model.activate(
            network.simulation.trees,
            scenario=None,
            **{**network.parameters, "root_time": root_time},
        )
        for network in networks
    ]
    return Pacing(
        before,
        after,
        np.array([simulation.qrs_duration for simulation in before]),
        np.array([simulation.qrs_duration for simulation in after]),
        np.array([simulation.total_activation_time for simulation in before]),
        np.array([simulation.total_activation_time for simulation in after]),
    )


def paced_prior(
    problem: Problem, root_time: float, progress: Progress | None = None
) -> dict[str, Floats]:
    """Pace networks of the prior: what could be predicted without a recording.

    Parameters
    ----------
    problem : Problem
        Its space is the prior.
    root_time : float
        t_RV − t_LV of the paced roots (ms).
    progress : Progress, optional
        Called as networks are simulated.

    Returns
    -------
    dict of str to (n,) array
        ``qrs_after`` and ``tat_after`` (ms) of those that fit the heart.
    """
    points = prior_points(len(problem.space), PRIOR_NETWORKS)
    report = stage_progress(progress, "prior")
    paced = []
    for start in range(0, len(points), PART):
        part = list(points[start : start + PART])
        for point, found in zip(part, problem.simulate(part), strict=True):
            if isinstance(found, Simulation):
                values = {**problem.fixed, **problem.space.from_unit(point), "root_time": root_time}
                paced.append(problem.model.activate(found.trees, scenario=None, **values))
        report(start + len(part), len(points))
    return {
        "qrs_after": np.array([simulation.qrs_duration for simulation in paced]),
        "tat_after": np.array([simulation.total_activation_time for simulation in paced]),
    }


def qrs_aligned(simulations: Sequence[Simulation]) -> tuple[Floats, Floats]:
    """ECGs of several simulations from their QRS onsets on.

    Returns
    -------
    time : (t,) array
        Time from QRS onset (ms).
    ecgs : (n, 12, t) array
        Potentials (mV), padded with zeros, which is what follows a QRS here.
    """
    cut = []
    for simulation in simulations:
        values = simulation.leads
        onset, _ = qrs_window(values, STEP)
        padded = np.pad(values, ((0, 0), (LEAD_IN, 0)))
        cut.append(padded[:, onset:])
    length = max(values.shape[1] for values in cut)
    ecgs = np.stack([np.pad(v, ((0, 0), (0, length - v.shape[1]))) for v in cut])
    return (np.arange(length) - LEAD_IN) * STEP, ecgs
