"""What an electrocardiographer looks at, for simulated QRS complexes."""

from __future__ import annotations

import numpy as np

from fascicle.core.leads import LEADS
from fascicle.forward.beat import Beat

# Bundles and fascicles short enough for a patient's heart (crtdemo); EXAMPLE_PARAMETERS are not
SHORT_BUNDLES = {
    "lv_initial_length": 45.0, "rv_initial_length": 55.0,
    "lv_fascicle_length_1": 15.0, "lv_fascicle_length_2": 20.0,
    "rv_fascicle_length_1": 20.0, "rv_fascicle_length_2": 15.0,
    "lv_fascicle_angle_1": 0.9, "lv_fascicle_angle_2": -0.6,
    "rv_fascicle_angle_1": 0.7, "rv_fascicle_angle_2": -0.4,
    "root_time": 0.0, "cv": 3.0,
}  # fmt: skip


def curves(simulation: Beat) -> dict[str, np.ndarray]:
    """The twelve leads (mV) by name."""
    return dict(zip(LEADS, simulation.leads, strict=True))


def electrical_axis(simulation: Beat) -> float:
    """Axis in the frontal plane from the net deflections of I and aVF (degrees)."""
    leads = curves(simulation)
    net = {lead: leads[lead].max() + leads[lead].min() for lead in ("I", "aVF")}
    return float(np.degrees(np.arctan2(2 / np.sqrt(3) * net["aVF"], net["I"])))


def transition(simulation: Beat) -> int:
    """Number of the first chest lead whose R is larger than its S."""
    leads = curves(simulation)
    return next(k for k in range(1, 7) if leads[f"V{k}"].max() > -leads[f"V{k}"].min())


def assert_normal(simulation: Beat) -> None:
    """QRS 70 to 110 ms, axis -30 to 90 degrees, R growing, transition V3 to V5, 0.5 to 3 mV."""
    leads = curves(simulation)
    assert 70 <= simulation.qrs_duration <= 110
    assert -30 <= electrical_axis(simulation) <= 90
    ratio = [leads[f"V{k}"].max() / -leads[f"V{k}"].min() for k in range(1, 6)]
    assert (np.diff(ratio) > 0).all(), "R over S grows from V1 to V5"
    assert 3 <= transition(simulation) <= 5
    assert leads["aVR"].max() < 0.2 < -leads["aVR"].min()
    for lead in ("I", "II", *(f"V{k}" for k in range(1, 7))):
        assert 0.5 <= np.ptp(leads[lead]) <= 3.0, lead


def assert_left_bundle_branch_block(simulation: Beat) -> None:
    """QRS over 110 ms, dominant S in V1, broad R in I and V6."""
    leads = curves(simulation)
    assert simulation.qrs_duration > 110
    assert -leads["V1"].min() > 3 * leads["V1"].max()
    for lead in ("I", "V6"):
        assert leads[lead].max() > 3 * -leads[lead].min(), lead
        assert (leads[lead] > 0.3 * leads[lead].max()).sum() > 50, f"{lead} is broad (ms)"
