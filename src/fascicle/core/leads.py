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
    """Matrix that turns electrode potentials into leads.

    Returns
    -------
    (12, 9) array
        ``leads = lead_matrix() @ potentials`` with rows in the order of `LEADS` and columns in the
        order of `ELECTRODES`. Every row sums to zero: no lead sees a common potential.
    """
    ra, la, ll, *chest = np.eye(len(ELECTRODES))
    wilson = (ra + la + ll) / 3
    limb = [la - ra, ll - ra, ll - la]
    augmented = [ra - (la + ll) / 2, la - (ra + ll) / 2, ll - (ra + la) / 2]
    return np.array([*limb, *augmented, *(electrode - wilson for electrode in chest)])


def limb_leads_from(recorded: Collection[str]) -> Floats | None:
    """Matrix that computes the six limb leads from two that were recorded.

    Two potential differences determine all six, by Einthoven's and Goldberger's laws.

    Parameters
    ----------
    recorded : collection of str
        Names of limb leads; the first two in the order of `LEADS` that are there count, so that
        I and II are used where both exist.

    Returns
    -------
    (6, 6) array or None
        ``limb = matrix @ limb`` in the order of `LIMB_LEADS`; columns of unused leads are zero.
        None where fewer than two are recorded.
    """
    columns = [k for k, lead in enumerate(LIMB_LEADS) if lead in recorded][:2]
    if len(columns) < 2:
        return None
    from_potentials = lead_matrix()[: len(LIMB_LEADS), 1:3]  # the right arm is at zero
    matrix = np.zeros((len(LIMB_LEADS), len(LIMB_LEADS)))
    matrix[:, columns] = from_potentials @ np.linalg.inv(from_potentials[columns])
    return matrix


def independent_rows(present: Booleans) -> Integers:
    """Rows of leads that are no combination of one another, of those that are present.

    For sums of energies, in which no direction may count twice. Means over leads, such as the root
    mean square, take `fascicle.recording.detection.complete_leads`, which keeps all limb leads
    where I or II is missing.

    Parameters
    ----------
    present : (12,) array of bool
        Which leads there are.

    Returns
    -------
    (k,) array
        Two limb leads (I and II where both are there) and the chest leads, increasing.
    """
    limb = np.flatnonzero(present[: len(LIMB_LEADS)])[:2]
    chest = len(LIMB_LEADS) + np.flatnonzero(present[len(LIMB_LEADS) :])
    return np.concatenate([limb, chest])
