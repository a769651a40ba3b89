"""The twelve standard leads and the nine electrodes they are made of."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers

LEADS: tuple[str, ...] = (
    "I", "II", "III", "aVR", "aVL", "aVF", "V1", "V2", "V3", "V4", "V5", "V6",
)  # fmt: skip
LIMB_LEADS, CHEST_LEADS = LEADS[:6], LEADS[6:]
INDEPENDENT_LEADS: tuple[str, ...] = ("I", "II", *CHEST_LEADS)
INDEPENDENT_ROWS = [LEADS.index(lead) for lead in INDEPENDENT_LEADS]
ELECTRODES: tuple[str, ...] = ("RA", "LA", "LL", "V1", "V2", "V3", "V4", "V5", "V6")


def lead_matrix() -> Floats:
    """Matrix (12, 9) that turns potentials, as in `ELECTRODES`, into leads, as in `LEADS`.

    Every row sums to zero: no lead sees a common potential.
    """
    ra, la, ll, *chest = np.eye(len(ELECTRODES))
    wilson = (ra + la + ll) / 3
    limb = [la - ra, ll - ra, ll - la]
    augmented = [ra - (la + ll) / 2, la - (ra + ll) / 2, ll - (ra + la) / 2]
    return np.array([*limb, *augmented, *(electrode - wilson for electrode in chest)])


def limb_leads_from(recorded: Collection[str]) -> Floats | None:
    """Matrix (6, 6) that computes the limb leads from two that were recorded.

    Two potential differences determine all six, by Einthoven's and Goldberger's laws. The first two
    in the order of `LIMB_LEADS` count; columns of the others are zero. None where there are fewer.
    """
    columns = [k for k, lead in enumerate(LIMB_LEADS) if lead in recorded][:2]
    if len(columns) < 2:
        return None
    from_potentials = lead_matrix()[: len(LIMB_LEADS), 1:3]  # the right arm is at zero
    matrix = np.zeros((len(LIMB_LEADS), len(LIMB_LEADS)))
    matrix[:, columns] = from_potentials @ np.linalg.inv(from_potentials[columns])
    return matrix


def independent_rows(present: Booleans) -> Integers:
    """Rows of two limb leads (I and II where both are there) and the chest leads, if `present`.

    No lead is then a combination of others, for sums of energies. Means over leads, such as the
    root mean square, take `fascicle.recording.detection.complete_leads`, which keeps all limb leads
    where I or II is missing.
    """
    limb = np.flatnonzero(present[: len(LIMB_LEADS)])[:2]
    chest = len(LIMB_LEADS) + np.flatnonzero(present[len(LIMB_LEADS) :])
    return np.concatenate([limb, chest])
