"""Whether the mean beat is a QRS, and whether its chest leads fit one another."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import CHEST_LEADS, LEADS
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.recording.quality.check_result import Check, CheckResult, Severity
from fascicle.recording.window import spatial_velocity

SPEED = Check("fastest part of the QRS", "mV/ms", 0.01)
CHEST = Check("chest leads, misfit ratio", "", 1.5)
# V1 to V6 of a heart vector (left, down, back) in Frank's torso: G. E. Dower, H. Bastos Machado, J.
# A. Osborne, On deriving the electrocardiogram from vectorcardiographic leads, Clin. Cardiol. 3:87
# (1980)
DOWER = np.array(
    [
        [-0.515, 0.157, -0.917], [0.044, 0.164, -1.387], [0.882, 0.098, -1.277],
        [1.213, 0.127, -0.601], [1.125, 0.127, -0.086], [0.831, 0.076, 0.230],
    ]
)  # fmt: skip
# Standard deviations of what a lead holds besides, over those of the heart vector: shared with its
# neighbours, and its own; tuned, as the limits, on benchmarks/chest_leads.py
SHARED, OWN = 0.6, 0.3


def check_mean_beat(qrs: Floats, simultaneous: bool = True) -> tuple[CheckResult, CheckResult]:
    """Both checks of a mean QRS (12, n), mV, every `SAMPLING_STEP` ms; a T wave has no chest leads.

    `simultaneous` says that all leads were recorded at the same time.
    """
    speed = _check_speed(qrs)
    if speed.message:
        return speed, CHEST.found(np.nan, "not checked: no QRS", Severity.FINE)
    return speed, check_chest_leads(qrs, simultaneous)


def _check_speed(qrs: Floats) -> CheckResult:
    """Suspect a beat of being a T wave: nothing in it is as fast as the slowest QRS."""
    fastest = float(spatial_velocity(qrs, SAMPLING_STEP).max())
    message = (
        f"the fastest part of the beat moves by {fastest:.4f} mV/ms, slower than any QRS "
        f"({SPEED.limit:g} or more): a T or P wave was probably taken for the beat; look at the "
        "picture, choose another class by --class, or give a recording with QRS complexes"
    )
    return SPEED.found(fastest, message if fastest < SPEED.limit else "")


def check_chest_leads(qrs: Floats, simultaneous: bool = True) -> CheckResult:
    r"""Suspect two neighbouring chest leads of being exchanged, or one of being upside down.

    The chest leads V (6,) are :math:`V = D h + e`, of a heart vector h, by Dower's matrix D, and a
    rest e of other torsos, hearts and electrodes. With h and e normally distributed, of covariance
    1 and C, their misfit is :math:`V^T (D D^T + C)^{-1} V`, summed over the QRS. The figure is the
    misfit over the least that an exchange of neighbours or an inversion leaves. Limb leads take no
    part; reversed limb electrodes change no chest lead.

    Parameters
    ----------
    qrs : (12, n) array
        Mean QRS (mV), from the PR segment as zero; absent leads are NaN.
    simultaneous : bool
        Whether all leads were recorded at the same time.
    """
    chest = qrs[len(LEADS) - len(CHEST_LEADS) : len(LEADS)]
    if not (simultaneous and np.isfinite(chest).all()):
        message = "not checked: needs V1 to V6, recorded at the same time"
        return CHEST.found(np.nan, message, Severity.FINE)
    apart = np.subtract.outer(np.arange(6), np.arange(6))
    rest = SHARED**2 * np.exp(-(apart**2) / 2) + OWN**2 * np.eye(6)
    weight = np.linalg.inv(DOWER @ DOWER.T + rest)

    def misfit(leads: Floats) -> float:
        return float(np.sum(leads * (weight @ leads)))

    remedies = {}
    for k, lead in enumerate(CHEST_LEADS):
        sign = np.where(np.arange(6) == k, -1.0, 1.0)
        remedies[f"lead {lead} is probably upside down", f"--invert {lead}"] = misfit(
            sign[:, None] * chest
        )
    for k, (lead, other) in enumerate(pairwise(CHEST_LEADS)):
        order = [*range(k), k + 1, k, *range(k + 2, 6)]
        what = f"leads {lead} and {other} are probably exchanged"
        remedies[what, f"--swap {lead}-{other}"] = misfit(chest[order])
    what, option = min(remedies, key=remedies.__getitem__)
    ratio = misfit(chest) / remedies[what, option]
    message = (
        f"{what}: with that undone the chest leads fit one another {ratio:.1f} times better; look "
        f"at the picture; to undo it: {option}"
    )
    return CHEST.found(ratio, message if ratio > CHEST.limit else "")
