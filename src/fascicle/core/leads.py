"""The twelve standard leads, their nine electrodes, and additional leads and electrodes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers

LEADS: tuple[str, ...] = (
    "I", "II", "III", "aVR", "aVL", "aVF", "V1", "V2", "V3", "V4", "V5", "V6",
)  # fmt: skip
LIMB_LEADS, CHEST_LEADS = LEADS[:6], LEADS[6:]
INDEPENDENT_LEADS: tuple[str, ...] = ("I", "II", *CHEST_LEADS)
INDEPENDENT_ROWS = [LEADS.index(lead) for lead in INDEPENDENT_LEADS]
ELECTRODES: tuple[str, ...] = ("RA", "LA", "LL", "V1", "V2", "V3", "V4", "V5", "V6")
# Weights of the electrodes in E. Frank's leads, Circulation 13:737 (1956): X is positive to the
# left, Y to the feet, Z to the back
FRANK: dict[str, dict[str, float]] = {
    "X": {"A": 0.610, "C": 0.171, "I": -0.781},
    "Y": {"F": 0.655, "M": 0.345, "H": -1.000},
    "Z": {"A": 0.133, "M": 0.736, "I": -0.264, "E": -0.374, "C": -0.231},
}
FRANK_ELECTRODES = tuple(sorted({name for lead in FRANK.values() for name in lead}))
POSTERIOR_LEADS, RIGHT_LEADS = ("V7", "V8", "V9"), ("V2R", "V3R", "V4R", "V5R", "V6R")
ADDITIONAL_LEADS: tuple[str, ...] = (
    *POSTERIOR_LEADS,
    *RIGHT_LEADS,
    *FRANK,
)  # that have a standard name


def additional_leads(electrodes: Sequence[str]) -> dict[str, Mapping[str, float]]:
    """Leads besides the twelve that electrodes allow: weights of the electrodes for each.

    Every electrode makes a unipolar lead of its name, against Wilson's central terminal; Frank's
    electrodes make his three leads, which come last.
    """
    wilson = dict.fromkeys(ELECTRODES[:3], -1 / 3)
    unipolar = [name for name in electrodes if name not in FRANK_ELECTRODES]
    frank = FRANK if len(unipolar) < len(electrodes) else {}
    return {**{name: {name: 1.0} | wilson for name in unipolar}, **frank}


def lead_matrix(additional: Sequence[str] = ()) -> Floats:
    """Matrix (12 + k, 9 + a) that turns potentials of electrodes into leads.

    Columns follow `ELECTRODES`, then the `additional` ones; rows follow `LEADS`, then
    `additional_leads`. Every row sums to zero: no lead sees a common potential.
    """
    ra, la, ll, *chest = np.eye(len(ELECTRODES))
    wilson = (ra + la + ll) / 3
    limb = [la - ra, ll - ra, ll - la]
    augmented = [ra - (la + ll) / 2, la - (ra + ll) / 2, ll - (ra + la) / 2]
    twelve = np.array([*limb, *augmented, *(electrode - wilson for electrode in chest)])
    named = [*ELECTRODES, *additional]
    more = [[w.get(name, 0.0) for name in named] for w in additional_leads(additional).values()]
    padded = np.pad(twelve, ((0, 0), (0, len(additional))))
    return np.concatenate([padded, np.array(more).reshape(-1, len(named))])


def limb_leads_from(recorded: Collection[str]) -> Floats | None:
    """Matrix (6, 6) that computes the limb leads from two that were recorded.

    Two potential differences determine all six, by Einthoven's and Goldberger's laws. The first two
    in the order of `LIMB_LEADS` count; columns of the others are zero. None with fewer than two.
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
